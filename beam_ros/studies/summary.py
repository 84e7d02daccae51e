"""What a study says, for people: a page in the style of all reports, and a few lines for the terminal."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import datetime
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

from beam_ident.report.page import Cell, Page, Tone
from beam_ros.bags.apparatus import Apparatus, simulated_line
from beam_ros.excitation.recipes import describe_excitation
from beam_ros.studies.rows import Row, Settings
from beam_ros.studies.statistics import ModeStatistics, mode_statistics, rows_by_beam, values_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_FEW = 20  # rows, below which a share says nothing of a 95 % interval
_TONES: dict[str, Tone] = {"passed": "good", "doubtful": "doubt", "failed": "bad"}
_GATES = (("gates failed", "gates_failed"), ("gates doubtful", "gates_doubtful"))
_COLOURS = ("#1d4ed8", "#c2410c", "#0f766e", "#7e22ce", "#4b5563")


def format_study(rows: Sequence[Row]) -> str:
    """Say in a few lines what a study found."""
    counts = _counts(rows)
    lines = [f"{len(rows)} rows: " + ", ".join(f"{count} {verdict}" for verdict, count in counts.items())]
    groups = rows_by_beam(rows)
    for name, own in groups.items():
        if statistics := mode_statistics(own):
            lines += [f"{name}:"] if len(groups) > 1 else []
            lines += _lines_of(statistics)
    lines += [f"{row['bag']}: {row['error']}" for row in rows if row["error"]][:10]
    return "\n".join(lines)


def _lines_of(statistics: Sequence[ModeStatistics]) -> list[str]:
    lines = [
        "mode  quantity             median   scatter    stated   theory in 95 % intervals        off at most"
    ]
    for own in statistics:
        scale, unit = _scale(own)
        low, high = own.coverage_range
        share = (
            f"{own.covered} of {own.count}: {100 * own.coverage:.1f} % ({100 * low:.0f} to {100 * high:.0f})"
        )
        lines.append(
            f"{own.mode:>4}  {f'{own.quantity} [{unit}]':<15} {scale * own.median:>11.7g} "
            f"{_or_dash(scale * own.scatter):>9} {scale * own.stated_sd:>9.2g}   {share if own.judged else '–':<30} "
            f"{_or_dash(100 * own.largest_error):>9} %"
        )
    return lines


def study_page(rows: Sequence[Row], settings: Settings, table: Path) -> Page:
    """Return the page that sums a study up.

    Parameters
    ----------
    rows : sequence of Row
    settings : Settings
    table : Path -- the file with all columns, beside the page
    """
    counts = _counts(rows)
    page = Page(
        f"Study of {len(rows)} experiments",
        f"{counts['passed']} passed, {counts['doubtful']} doubtful and {counts['failed']} failed. "
        + " ".join(_lead_of_modes(mode_statistics(own)) for own in rows_by_beam(rows).values()),
        simulated_line(Apparatus(row["apparatus"]) for row in rows if "apparatus" in row),
    )
    groups = rows_by_beam(rows)
    if not mode_statistics(rows):
        page.section("Modes")
        page.warning("No mode was found in any row.", "Look at the errors below.")
    for name, own in groups.items():
        _modes_of_group(page, f"Modes of {name}" if len(groups) > 1 else "Modes", own)
    failed = [row for row in rows if row["error"]]
    if failed:
        page.section("Errors")
        page.table(
            ["experiment", "what was wrong"],
            [[row["bag"], row["error"]] for row in failed],
            "These rows have no poles; all others are not touched by that.",
        )
    page.section("Experiments")
    page.table(
        ["experiment", "verdict", "modes", "f1 [Hz]", "ζ1 [%]", "frames lost", "hub lost", "notes"],
        [_row_cells(row) for row in rows],
        f"All columns are in {table.name}. A row is doubtful where a gate of the data failed or is doubtful, "
        "a mode is doubted, the fit did not converge, or it has warnings.",
    )
    page.section("Provenance")
    page.table(
        ["what", "value"],
        [
            ["made", f"{datetime.now().astimezone():%Y-%m-%d %H:%M %Z} by beam_ros {version('beam_ros')}"],
            ["estimator", f"{settings.identifier.estimator}, structure {settings.identifier.structure}"],
            ["modes", str(settings.identifier.modes or "from the data")],
            ["rig", "as each bag says" if settings.rig is None else "the same for all (study.json)"],
            ["excitations", "; ".join(sorted({row.get("excitation") or "unknown" for row in rows}))]
            if settings.rig is None
            else ["excitation", describe_excitation({"rig": settings.rig.to_nested()})],
        ],
        "How the rows were made. Every row carries the checksum of its bag.",
    )
    return page


def _modes_of_group(page: Page, heading: str, rows: Sequence[Row]) -> None:
    """Add what the rows of one beam say together."""
    statistics = mode_statistics(rows)
    if not statistics:
        return
    page.section(heading)
    page.table(
        [
            "mode",
            "quantity",
            "rows",
            "median",
            "scatter",
            "stated",
            "scatter / stated",
            "in 95 %",
            "off at most",
        ],
        [_cells(own) for own in statistics],
        "Rows whose bags describe one beam. Scatter is the standard deviation over the rows, stated the median of "
        "what each fit states of itself. Their ratio is 1 where equal experiments differ by noise alone. The last "
        "columns count the rows whose 95 % interval holds the theory of their rig, and how far the worst is off: "
        "of simulated experiments that is the truth.",
    )
    for mode in sorted({own.mode for own in statistics if own.count > 1}):
        page.figure(
            partial(deviation_figure, rows, mode),
            f"Natural frequency of mode {mode} in every row, against the median of all, with 95 % intervals. An "
            "interval without ends goes beyond the figure, whose height follows the better half of the rows.",
            f"Deviations of the natural frequency of mode {mode} over the rows of the study",
        )


def deviation_figure(rows: Sequence[Row], mode: int) -> Figure:
    """Draw a mode's natural frequency in every row, as parts per million from the median, with 95 % intervals."""
    import numpy as np
    from matplotlib.figure import Figure

    values, sds, _ = values_of(rows, mode, "frequency")
    middle = float(np.median(values))
    figure = Figure(figsize=(8.0, 2.6), layout="constrained")
    axes = figure.add_subplot()
    colour = _COLOURS[(mode - 1) % len(_COLOURS)]
    order = np.arange(1, len(values) + 1)
    axes.errorbar(
        order,
        1e6 * (values / middle - 1.0),
        yerr=1.96e6 * sds / middle,
        fmt="o",
        markersize=3,
        linewidth=0.8,
        color=colour,
    )
    axes.axhline(0.0, color="#4b5563", linewidth=0.8)
    axes.set(xlabel="row", ylabel="from the median [ppm]")
    # One wild row must not make all others a line.
    reaches = 1e6 * (np.abs(values / middle - 1.0) + 1.96 * sds / middle)
    reach = min(float(np.max(reaches)), 4.0 * float(np.median(reaches)))
    axes.set_ylim(-1.2 * reach, 1.2 * reach)
    axes.set_xticks(order if len(order) <= _FEW else np.linspace(1, len(order), 11).round())
    axes.set_title(f"mode {mode}: {middle:.6g} Hz", fontsize=10)
    return figure


def _counts(rows: Sequence[Row]) -> dict[str, int]:
    return {verdict: sum(row["verdict"] == verdict for row in rows) for verdict in _TONES}


def _lead_of_modes(statistics: Sequence[ModeStatistics]) -> str:
    of = [own for own in statistics if own.quantity == "frequency"]
    if not of:
        return "No mode was found in any of them."
    return "Natural frequencies: " + ", ".join(f"{own.median:.5g} Hz in {own.count}" for own in of) + "."


def _cells(own: ModeStatistics) -> list[str | Cell]:
    scale, unit = _scale(own)
    low, high = own.coverage_range
    tone: Tone = "" if own.judged < _FEW else "good" if low <= 0.95 <= high else "doubt"
    return [
        str(own.mode),
        f"{own.quantity} [{unit}]",
        str(own.count),
        f"{scale * own.median:.6g}",
        _or_dash(scale * own.scatter),
        f"{scale * own.stated_sd:.2g}",
        _or_dash(own.scatter / own.stated_sd),
        Cell(f"{own.covered} ({100 * own.coverage:.1f} %)" if own.judged else "–", tone),
        f"{_or_dash(100 * own.largest_error)} %",
    ]


def _scale(own: ModeStatistics) -> tuple[float, str]:
    return (1.0, "Hz") if own.quantity == "frequency" else (100.0, "%")


def _or_dash(value: float) -> str:
    return f"{value:.2g}" if math.isfinite(value) else "–"


def _row_cells(row: Row) -> list[str | Cell]:
    def number(name: str, scale: float, digits: int) -> str:
        value = row.get(name)
        return "–" if value is None else f"{scale * value:.{digits}g}"

    gates = [f"{word}: {row[name]}" for word, name in _GATES if row.get(name)]
    notes = " | ".join(filter(None, (*gates, row.get("notes"), row.get("doubts"), row["error"])))
    return [
        _short(row["bag"]),
        Cell(row["verdict"], _TONES[row["verdict"]]),
        str(row.get("n_modes", "–")),
        number("mode1_frequency_hz", 1.0, 7),
        number("mode1_damping_ratio", 100.0, 4),
        number("frames_lost", 1.0, 6),
        number("hub_samples_lost", 1.0, 6),
        notes or "–",
    ]


def _short(name: str) -> str:
    """Return the last two parts of a path: a bag is often called "bag", and its folder tells which."""
    return "/".join(Path(name).parts[-2:])
