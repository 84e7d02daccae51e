"""What results and models say of themselves on a terminal and in a notebook: tables and sentences of one page."""

from __future__ import annotations

import html
import textwrap
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from beam_ident.quantities import r_squared, small, with_uncertainty

if TYPE_CHECKING:
    from beam_ident.arrays import FloatArray


@dataclass(frozen=True)
class SummaryTable:
    """A table whose cells are text.

    Attributes
    ----------
    columns : tuple of str
    rows : tuple of tuple of str
    """

    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def text(self, most_rows: int) -> list[str]:
        """Return the table as lines: its first column to the left, the others to the right."""
        rows = [self.columns, *self.rows[:most_rows]]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = [
            "  ".join(
                f"{cell:{'>' if place else '<'}{width}}"
                for place, (cell, width) in enumerate(zip(row, widths, strict=True))
            ).rstrip()
            for row in rows
        ]
        left_out = len(self.rows) - most_rows
        return [*lines, f"... {left_out} more"] if left_out > 0 else lines

    def html(self) -> str:
        """Return the table as HTML, with all its rows."""
        head = "".join(f"<th>{html.escape(name)}</th>" for name in self.columns)
        cells = ("".join(f"<td>{html.escape(cell)}</td>" for cell in row) for row in self.rows)
        return f"<table><tr>{head}</tr>{''.join(f'<tr>{row}</tr>' for row in cells)}</table>"


SummaryPart: TypeAlias = SummaryTable | str


class Summarised(ABC):
    """Prints as a summary of at most 40 lines, and shows the same as tables in a notebook."""

    @abstractmethod
    def summary_parts(self) -> list[SummaryPart]:
        """Return the summary's tables and sentences, the most important first."""

    def summary(self, most_lines: int = 40, width: int = 110) -> str:
        """Return what a reader should know first, as text.

        Parameters
        ----------
        most_lines : int -- a table takes a third of them at most, so that what comes after it is seen
        width : int -- of sentences, in characters
        """
        lines: list[str] = []
        for part in self.summary_parts():
            lines += (
                part.text(most_lines // 3) if isinstance(part, SummaryTable) else textwrap.wrap(part, width)
            )
        left_out = len(lines) - most_lines
        return "\n".join(
            [*lines[: most_lines - 1], f"... {left_out + 1} lines more"] if left_out > 0 else lines
        )

    def __str__(self) -> str:
        """Return ``summary()``."""
        return self.summary()

    def __repr__(self) -> str:
        """Return ``summary()``: the numbers themselves are in the attributes."""
        return self.summary()

    def _repr_html_(self) -> str:
        """Return the summary as HTML, for notebooks."""
        return "".join(
            part.html() if isinstance(part, SummaryTable) else f"<p>{html.escape(part)}</p>"
            for part in self.summary_parts()
        )


def models_of(result: Any) -> tuple[Any, ...]:
    """Return the models of a result: one, one for each output, or the result itself where it is a model."""
    several = getattr(result, "models", None)
    return several if isinstance(several, tuple) else (getattr(result, "model", result),)


class SummarisedModes(Summarised):
    """The summary of whatever has modes, or models that have: with their columns, and where they lie."""

    def mode_columns(self) -> dict[str, FloatArray]:
        """Return the modes of all models, one under the other, as columns that any table takes.

        Returns
        -------
        dict of str to ndarray, shape (n_modes,) -- ``model`` and ``mode``, both from 1, ``frequency_hz`` and
            ``damping_ratio`` with ``frequency_sd_hz`` and ``damping_ratio_sd``, NaN where none is known
        """
        models = [path for own in models_of(self) for path in getattr(own, "pole_sets", (own,))]
        found = [np.array(own.modes()) for own in models]
        omegas, zetas, omega_sd, zeta_sd = np.concatenate(found, axis=1)
        counts = [own.shape[1] for own in found]
        return {
            "model": np.repeat(np.arange(1, len(counts) + 1), counts),
            "mode": np.concatenate([np.arange(1, count + 1) for count in counts]),
            "frequency_hz": omegas / (2.0 * np.pi),
            "frequency_sd_hz": omega_sd / (2.0 * np.pi),
            "damping_ratio": zetas,
            "damping_ratio_sd": zeta_sd,
        }

    def to_dataframe(self) -> Any:
        """Return ``mode_columns`` as a pandas table; ImportError without pandas, which this alone needs."""
        try:
            pandas = import_module("pandas")
        except ImportError as err:
            raise ImportError(
                "to_dataframe needs pandas, which is not installed: `pip install pandas`, or take mode_columns()"
            ) from err
        return pandas.DataFrame(self.mode_columns())

    def _repr_html_(self) -> str:
        """Return the summary as HTML, for notebooks, with a picture of where the modes lie."""
        return super()._repr_html_() + modes_picture(self.mode_columns())


def modes_picture(columns: Mapping[str, FloatArray], width: int = 360, height: int = 130) -> str:
    """Return a small SVG: damping over frequency, with bars of two standard deviations where these are to be seen.

    Parameters
    ----------
    columns : mapping -- as of ``SummarisedModes.mode_columns``
    width, height : int -- [px]
    """
    hertz, percent = columns["frequency_hz"], 100.0 * columns["damping_ratio"]
    if not len(hertz):
        return ""
    left, foot, half = 46, height - 30, 3.0
    across = (width - left - 14) / (1.1 * float(np.max(hertz)))
    up = (foot - 10) / (1.2 * float(np.max(np.abs(percent))) or 1.0)
    bars, dots = [], []
    spreads = 2.0 * np.nan_to_num([columns["frequency_sd_hz"], 100.0 * columns["damping_ratio_sd"]])
    for f, z, (f_2sd, z_2sd) in zip(hertz, percent, spreads.T, strict=True):
        x, y = left + across * f, foot - up * z
        dx, dy = min(across * f_2sd, width), min(up * z_2sd, height)
        bars.append(f"M{x - dx:.1f} {y:.1f}H{x + dx:.1f}M{x:.1f} {y - dy:.1f}V{y + dy:.1f}")
        dots.append(
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{half}"><title>{f:.6g} Hz, {z:.4g} %</title></circle>'
        )
    words = [
        f'<text x="{left + across * f:.1f}" y="{foot + 13}" text-anchor="middle">{f:.4g}</text>'
        for f in (0.0, float(np.max(hertz)))
    ]
    words.append(f'<text x="{width // 2}" y="{height - 3}" text-anchor="middle">frequency [Hz]</text>')
    words += [
        f'<text x="{left - 4}" y="{foot - up * z + 4:.1f}" text-anchor="end">{z:.3g} %</text>'
        for z in (0.0, float(np.max(percent)))
    ]
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" viewBox="0 0 {width} {height}" '
        'role="img" aria-label="damping ratios over frequencies of the modes" fill="currentColor" '
        f'stroke="none" font-size="11"><path d="M{left} 6V{foot}H{width - 8}{"".join(bars)}" stroke="currentColor" '
        f'fill="none"/>{"".join(dots)}{"".join(words)}</svg>'
    )


def modes_table(
    omegas: FloatArray,
    zetas: FloatArray,
    omega_sd: FloatArray,
    zeta_sd: FloatArray,
    doubts: Sequence[str] = (),
) -> SummaryTable | str:
    """Return the table of modes, in Hz and per cent; a sentence where there is none.

    Parameters
    ----------
    omegas, zetas, omega_sd, zeta_sd : ndarray, shape (n_modes,) -- [rad/s] and ratios
    doubts : sequence of str -- of every mode why it cannot be trusted; empty where it can
    """
    if not len(omegas):
        return "no modes"
    turn = 2.0 * np.pi
    rows = [
        (
            str(k + 1),
            with_uncertainty(omega / turn, f_sd / turn),
            with_uncertainty(100.0 * zeta, 100.0 * z_sd),
            *([doubts[k]] if any(doubts) else []),
        )
        for k, (omega, zeta, f_sd, z_sd) in enumerate(zip(omegas, zetas, omega_sd, zeta_sd, strict=True))
    ]
    return SummaryTable(("mode", "f [Hz]", "zeta [%]", *(["doubt"] if any(doubts) else [])), tuple(rows))


def estimates_table(names: Sequence[str], values: FloatArray, sds: FloatArray) -> SummaryTable:
    """Return the table of parameters with their standard deviations; those of none are known."""
    rows = (
        (name, with_uncertainty(float(value), float(sd)))
        for name, value, sd in zip(names, values, sds, strict=True)
    )
    return SummaryTable(("parameter", "estimate"), tuple(rows))


def result_parts(result: Any, models: Sequence[Summarised], output_names: Sequence[str]) -> list[SummaryPart]:
    """Return the summary of a result: its models, how well they reproduce the data, and what is to be known.

    Parameters
    ----------
    result : Result -- from samples or from lines (see ``beam_ident.results``)
    models : sequence of Summarised -- what it found
    output_names : sequence of str -- of a result from samples
    """
    parts: list[SummaryPart] = [part for model in models for part in model.summary_parts()]
    if hasattr(result, "scores"):
        of_outputs = [own if isinstance(own, tuple) else (own,) for own in (result.scores, result.whiteness)]
        rows = (
            (name, f"{scores.fit_percent:.3f}", r_squared(scores.r_squared), "yes" if test.is_white else "no")
            for name, scores, test in zip(output_names, *of_outputs, strict=True)
        )
        parts.append(SummaryTable(("output", "FIT [%]", "R²", "white residuals"), tuple(rows)))
    elif hasattr(result, "misfit"):
        expected = result.misfit.expected
        parts.append(
            f"squared residuals {small(result.misfit.chi_squared / expected)} of what noise alone would leave"
        )
    if not result.converged:
        parts.append(f"NOT CONVERGED: {result.reason}")
    parts += [f"warning: {said}" for said in result.warnings]
    return parts
