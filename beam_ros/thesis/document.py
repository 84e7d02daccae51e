"""The document: every table and figure of the reference work under its number, on one page and as files."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

from beam_ident import TransferFunctionResult
from beam_ident.quantities import sentence
from beam_ident.report.evidence import Unseen
from beam_ident.report.page import Page, write_whole
from beam_ident.report.verdict import Verdict, add_verdict, judge, worst_of
from beam_ros.process.strict_json import strict_json
from beam_ros.thesis.contents import BY_NUMBER, ENTRIES, REFERENCE
from beam_ros.thesis.data import AtPoint, ThesisData, hub_alone_fit_percent
from beam_ros.thesis.figures import DRAWN, simulation_fit_percent
from beam_ros.thesis.tables import MADE, Table

DOCUMENT_FILE = "thesis.html"
MODEL_FILE = "model.json"

_SCHEMA = 1
_ORDER = (
    ("Simulation", ("Table 4.1", "Figure 4.1", "Figure 4.2", "Figure 4.3")),
    ("Set-up and calibration", ("Figure 4.4", "Figure 4.8")),
    ("Experiments", ("Table 4.4", "Figure 4.9", "Figure 4.10", "Figure 4.11", "Figure 4.12")),
    ("Order of the models", ("Table 4.2", "Table 4.3")),
    ("Estimated models", ("Table 4.5", "Table 4.6", "Figure 4.13", "Figure 4.14", "Table 4.7")),
    ("Validation", ("Figure 4.15", "Figure 4.16", "Table 4.8", "Figure 4.17")),
)


def write_thesis(data: ThesisData, folder: Path) -> dict[str, Any]:
    """Write the page, the models, the tables as CSV and the figures as SVG.

    Parameters
    ----------
    data : ThesisData
    folder : Path -- earlier files of the same names are replaced

    Returns
    -------
    dict -- the tables by their numbers, what is missing, and the files
    """
    tables = {number: make(data) for number, make in MADE.items()}
    drawn = {number: draw(data) for number, draw in DRAWN.items() if _can_be_drawn(data, number)}
    page = Page(
        "Identification of a flexible cantilever beam, reproduced", _lead(data, tables), data.apparatus
    )
    page.section("Verdict")
    add_verdict(page, _verdict(data))
    if data.apparatus:
        page.paragraph(
            "Titles of the reference work say experiment and measured; what stands under them here is simulated."
        )
    page.paragraph(
        f"Tables and figures have the numbers of the reference work ({REFERENCE}). Of that work its list of tables "
        "and figures, its model and its method are reproduced here on a rig of its kind; its own measurements are "
        "not at hand, so no number of it is compared. Below each item stands what it could not say."
    )
    for heading, numbers in _ORDER:
        page.section(heading)
        for number in numbers:
            if number in tables:
                _show_table(page, number, tables[number])
            elif number in drawn:
                _show_figure(page, number, drawn[number], data)
            else:
                page.warning(
                    f"{number} is missing: {_why_missing(number)}",
                    "record the plan thesis with the camera's frames",
                    tone="doubt",
                )
    _contents(page, tables, drawn)
    _provenance(page, data)
    page.write(folder / DOCUMENT_FILE, overwrite=True)
    for number, table in tables.items():
        write_whole(folder / "tables" / f"{_stem(number)}.csv", _csv(table))
    for name, svg in page.figures.items():
        write_whole(folder / "figures" / f"{name}.svg", svg)
    write_whole(folder / MODEL_FILE, strict_json(_models(data), indent=1))
    return {
        "schema": _SCHEMA,
        "document": str(folder / DOCUMENT_FILE),
        "missing": [number for number in DRAWN if number not in drawn],
        "tables": {
            number: {
                "columns": list(table.columns),
                "rows": [list(row) for row in table.rows],
                "notes": list(table.notes),
            }
            for number, table in tables.items()
        },
    }


def _can_be_drawn(data: ThesisData, number: str) -> bool:
    return number != "Figure 4.8" or data.calibration is not None


def _why_missing(number: str) -> str:
    return f"there is no bag of the calibration ({BY_NUMBER[number].title})"


def _lead(data: ThesisData, tables: Mapping[str, Table]) -> str:
    result = data.modal["E1"]
    found = " and ".join(
        f"{hertz:.4f} Hz with {100.0 * zeta:.3f} % of damping"
        for hertz, zeta in zip(result.model.frequencies_hz[:2], result.model.damping_ratios[:2], strict=True)
    )
    beam = "the simulated beam" if data.apparatus else "the beam"
    return (
        f"{len(tables)} tables and {len(DRAWN)} figures from {len(data.experiments)} recordings: {beam} swings at "
        f"{found}, found from the chirp E1 and validated on data that the models have not seen."
    )


def _verdict(data: ThesisData) -> Verdict:
    """Judge the models of the document together, by the worst of them."""
    judged = []
    for name, result in data.modal.items():
        unseen = [Unseen(key[2], (own,)) for key, own in data.validations.items() if key[:2] == ("", name)]
        judged.append((f"all points at once, {name}", judge(result, (), unseen)))
    for at in data.points:
        for name, fitted in at.models.items():
            keys = (at.point.name, name)
            unseen = [Unseen(key[2], (own,)) for key, own in data.validations.items() if key[:2] == keys]
            judged.append(
                (f"transfer function at {at.point.label}, {name}", judge(_explained(at, fitted), (), unseen))
            )
    return worst_of(judged)


def _explained(at: AtPoint, fitted: TransferFunctionResult) -> TransferFunctionResult:
    """Return a result whose misfit is put down to what was left out by the choice of its order."""
    if not at.left_out or not fitted.warnings:
        return fitted
    n = fitted.model.n_poles
    cause = (
        f"the model has {n} poles, for the modes that all points show, where BIC takes {n + at.left_out} here: "
        "what it leaves out stands in the residuals"
    )
    return replace(fitted, warnings=(cause,))


def _show_table(page: Page, number: str, table: Table) -> None:
    entry = BY_NUMBER[number]
    page.table(table.columns, table.rows, f"{number}. {entry.title}", chosen=table.chosen)
    for note in table.notes:
        page.paragraph(note)
    if entry.beyond:
        page.paragraph(f"Beyond the reference work: {entry.beyond}")


def _show_figure(page: Page, number: str, figure: Any, data: ThesisData) -> None:
    entry = BY_NUMBER[number]
    title = entry.title if entry.title.endswith(".") else f"{entry.title}."
    caption = f"{title} {_said_of(number, data)} {entry.beyond}".strip()
    own = number.removeprefix("Figure ")
    if number == "Figure 4.4":
        caption = (
            "The rig, drawn to scale, in place of the photographs and the scheme of figures 4.4 to 4.7: hub with "
            "strip and markers, its rest and its first mode. The camera looks along the axis that the strip bends "
            "about; the reference sensor of the calibration measures the hub along x."
        )
        own = "4.4 to 4.7"
    page.figure(figure, caption, f"{number}: {entry.title}", name=_stem(number), number=own)


def _said_of(number: str, data: ThesisData) -> str:
    """Return what a figure's caption says of these data."""
    rig = data.rigs["E1"]
    if number == "Figure 4.2":
        return f"The dotted line is half the camera's {rig.camera.rate:g} frames a second."
    if number == "Figure 4.3":
        fits = (
            f"{simulation_fit_percent(data, k):.3f} % at {at.point.label}" for k, at in enumerate(data.points)
        )
        return f"Nothing but a constant is fitted here; FIT {' and '.join(fits)}."
    if number == "Figure 4.8" and data.calibration is not None:
        lines = data.calibration.lines
        scales = ", ".join(
            f"{name} {1e3 / abs(line.slope):.6f} ± {1.96e3 * line.covariance[0, 0] ** 0.5 / line.slope**2:.6f} mm/px"
            for name, line in zip(rig.markers.names, lines, strict=True)
        )
        return f"{scales} (95 %)."
    if number in ("Figure 4.15", "Figure 4.16"):
        at = data.points[0 if number == "Figure 4.15" else 1]
        output = data.validations[at.point.name, "E1", "V2"].output(at.point.name)
        alone = hub_alone_fit_percent(data, at.point.name, "V2")
        return f"{sentence(output.verdict)} The hub's own motion, without a beam, has a FIT of {alone:.2f} %."
    return ""


def _contents(page: Page, tables: Mapping[str, Table], drawn: Mapping[str, Any]) -> None:
    page.section("Beside the reference work's lists")
    page.table(
        ("reference work", "title there", "here"),
        [
            (
                entry.number,
                entry.title,
                entry.here if _is_here(entry.number, tables, drawn) else f"missing: {entry.here}",
            )
            for entry in ENTRIES
        ],
        "Its lists of figures and tables, line by line, and what stands here.",
    )


def _is_here(number: str, tables: Mapping[str, Table], drawn: Mapping[str, Any]) -> bool:
    return number not in {*MADE, *DRAWN} or number in tables or number in drawn


def _provenance(page: Page, data: ThesisData) -> None:
    page.section("Provenance")
    rows = [(f"bag {name}", experiment.path.name) for name, experiment in sorted(data.experiments.items())]
    rows += [
        (f"seed of the noise, {name}", str(own.simulation.seed)) for name, own in sorted(data.rigs.items())
    ]
    page.table(("what", "value"), [*rows, ("beam_ros", version("beam_ros"))], "Where the numbers come from.")
    for name, experiment in sorted(data.experiments.items()):
        for note in experiment.notes:
            page.warning(f"{name}: {note}", tone="doubt")


def _models(data: ThesisData) -> dict[str, Any]:
    return {
        "schema": _SCHEMA,
        "models": {
            **{f"modal_{name}": result.model.to_dict() for name, result in data.modal.items()},
            **{
                f"{at.point.name}_{name}": model.to_dict()
                for at in data.points
                for name, model in at.transfer_functions.items()
            },
        },
    }


def _stem(number: str) -> str:
    return number.lower().replace(" ", "-").replace(".", "-")


def _csv(table: Table) -> str:
    stream = io.StringIO()
    csv.writer(stream, lineterminator="\n").writerows([table.columns, *table.rows])
    return stream.getvalue()
