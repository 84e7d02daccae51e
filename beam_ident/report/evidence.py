"""What a report is given beside the result: theory, sources of error, other records, one view of all results.

Those who know the rig fill these in; the report draws them and weighs them, without knowing a beam or a bag.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.data.records import TimeRecord
from beam_ident.evaluation.hold_out import ValidationResult
from beam_ident.figures.identification import Fitted, FittedOutput
from beam_ident.modal.identification_result import IdentificationResult
from beam_ident.results import Result, TimeResult


@dataclass(frozen=True, eq=False)
class Theory:
    """The modes that theory predicts, with a budget of type B of its own.

    Attributes
    ----------
    source : str -- which theory, of which structure, in one sentence
    natural_frequencies, damping_ratios : ndarray, shape (n_modes,) -- of the ideal structure [rad/s], [-]
    predicted : ndarray, shape (n_modes,) -- with the shifts that the ideal leaves out [rad/s]
    contributions : mapping of str to ndarray, shape (n_modes,)
        Signed relative standard uncertainty of the prediction from each source; empty where there is no budget.
    chi_squared : float -- of all compared modes together, with their correlations; NaN where there is no budget
    residues, residue_sd : mapping from an output's name to ndarray, shape (n_modes,)
        The model's residues as theory has them, and their standard uncertainty from the output's place.
    heights : ndarray, shape (n_heights,) -- where the shapes are given [m]
    shapes : ndarray, shape (n_heights, n_modes) -- residues along the structure
    places : mapping from an output's name to its height and the standard uncertainty of that [m]
    over_amplitude : function or None
        From (output's name, frequency [Hz], amplitudes [m]) to frequencies [Hz] and damping ratios of the nearest
        mode there, or None where theory has no law for it.
    """

    source: str
    natural_frequencies: FloatArray
    damping_ratios: FloatArray
    predicted: FloatArray
    contributions: Mapping[str, FloatArray] = field(default_factory=dict)
    chi_squared: float = np.nan
    residues: Mapping[str, FloatArray] = field(default_factory=dict)
    residue_sd: Mapping[str, FloatArray] = field(default_factory=dict)
    heights: FloatArray = field(default_factory=lambda: np.empty(0))
    shapes: FloatArray = field(default_factory=lambda: np.empty((0, 0)))
    places: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    over_amplitude: Callable[[str, float, FloatArray], tuple[FloatArray, FloatArray] | None] | None = None

    @property
    def type_b(self) -> FloatArray:
        """Relative standard uncertainty of every predicted frequency, all sources together."""
        parts = list(self.contributions.values())
        return (
            np.asarray(np.sqrt(np.sum(np.square(parts), axis=0))) if parts else np.zeros(len(self.predicted))
        )


@dataclass(frozen=True)
class ErrorSources:
    """What the scatter of the samples cannot show, as standard uncertainties.

    Attributes
    ----------
    time_base : float -- relative, of the clock that all stamps rest on
    temperature_k : float or None -- of the structure against that of the conditions named [K]; None: not given
    frequency_per_kelvin : float -- relative change of the natural frequencies
    scale : mapping from an output's name to a relative standard uncertainty of its scale
    """

    time_base: float = 0.0
    temperature_k: float | None = None
    frequency_per_kelvin: float = 0.0
    scale: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Trial:
    """One record identified by itself, to be compared with others.

    Attributes
    ----------
    name : str
    model : a model of any kind
    amplitude : float -- largest deflection of the record, in the outputs' unit; NaN where it is not known
    source : str -- where it comes from
    """

    name: str
    model: Any
    amplitude: float = np.nan
    source: str = ""


@dataclass(frozen=True, eq=False)
class Unseen:
    """How a result does on a record that it was not fitted to.

    Attributes
    ----------
    name : str -- of the record
    results : tuple of ValidationResult -- one for each model of the result
    """

    name: str
    results: tuple[ValidationResult, ...]


class ModeRow(NamedTuple):
    """One identified mode: of which model and output, its number there from 1, and ``modes()`` of it."""

    model: Any
    output: str
    number: int
    omega: float
    zeta: float
    omega_sd: float
    zeta_sd: float

    @property
    def name(self) -> str:
        """How tables call it."""
        return f"{self.output} {self.number}".strip()


def mode_rows(models: Sequence[Any]) -> list[ModeRow]:
    """Return every mode of the models, each once; with the output's name where outputs have poles of their own."""
    distinct: dict[tuple[float, ...], Any] = {}
    for model in models:
        if hasattr(model, "modes"):
            distinct.setdefault(tuple(model.modes()[0]), model)
    rows = []
    for model in distinct.values():
        output = getattr(model, "output_name", "") if len(distinct) > 1 else ""
        for number, numbers in enumerate(zip(*model.modes(), strict=True), 1):
            rows.append(ModeRow(model, output, number, *map(float, numbers)))
    return rows


def fitted_outputs(result: Result, record: TimeRecord) -> Fitted:
    """Return what the figures of a fit draw, whatever estimated it; nothing of a result from lines.

    Parameters
    ----------
    result : Result
    record : TimeRecord -- that it was estimated from
    """
    if isinstance(result, IdentificationResult):
        return result.outputs
    if not isinstance(result, TimeResult):
        return ()
    parts = (result.times_s, result.measured, result.residuals, result.scores, result.whiteness)
    columns: list[tuple[Any, ...]] = [part if isinstance(part, tuple) else (part,) for part in parts]
    found = []
    for output, times, measured, residuals, scores, whiteness in zip(record.outputs, *columns, strict=True):
        found.append(
            FittedOutput(
                name=output.name,
                unit=output.unit,
                times_s=times,
                measured=measured,
                residuals=residuals,
                deflection=measured - np.mean(measured),
                scores=scores,
                deflection_scores=scores,
                whiteness=whiteness,
                noise_sd=float(np.std(residuals)),
            )
        )
    return found
