"""What a report is given beside the result: theory, sources of error, other records, one view of all results.

Those who know the rig fill these in; the report draws them and weighs them, without knowing a beam or a bag.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from scipy.special import chdtrc as chi_squared_tail

from beam_ident.arrays import FloatArray
from beam_ident.data.records import TimeRecord
from beam_ident.evaluation.hold_out import ValidationResult
from beam_ident.figures.identification import Fitted, FittedOutput
from beam_ident.modal.identification_result import IdentificationResult
from beam_ident.modal.model import ModalModel
from beam_ident.quantities import nearest_mode
from beam_ident.results import Result, TimeResult

_LEVEL = 0.01  # how often a sound theory is called doubtful: as residuals are called coloured


@dataclass(frozen=True, eq=False)
class Theory:
    """The modes that theory predicts, with a budget of type B of its own.

    Attributes
    ----------
    source : str -- which theory, of which structure, in one sentence
    natural_frequencies, damping_ratios : ndarray, shape (n_modes,) -- of the ideal structure [rad/s], [-]
    predicted : ndarray, shape (n_modes,) -- with the shifts that the ideal leaves out [rad/s]
    contributions : mapping of str to ndarray, shape (n_modes,)
        Signed relative standard uncertainty of the prediction from each source; empty where no budget is known.
    is_exact : bool -- whether the beam is known to be that of theory: a simulated one, which needs no budget
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
    is_exact: bool = False
    residues: Mapping[str, FloatArray] = field(default_factory=dict)
    residue_sd: Mapping[str, FloatArray] = field(default_factory=dict)
    heights: FloatArray = field(default_factory=lambda: np.empty(0))
    shapes: FloatArray = field(default_factory=lambda: np.empty((0, 0)))
    places: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    over_amplitude: Callable[[str, float, FloatArray], tuple[FloatArray, FloatArray] | None] | None = None

    @property
    def type_b(self) -> FloatArray:
        """Relative standard uncertainty of every predicted frequency, all sources together; NaN: not known."""
        parts = list(self.contributions.values())
        if parts:
            return np.asarray(np.sqrt(np.sum(np.square(parts), axis=0)))
        return np.full(len(self.predicted), 0.0 if self.is_exact else np.nan)


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

    @property
    def relative(self) -> float:
        """Relative standard uncertainty that all frequencies have in common."""
        return float(np.hypot(self.time_base, abs(self.frequency_per_kelvin) * (self.temperature_k or 0.0)))


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


class Budget(NamedTuple):
    """Standard uncertainties of one number, source by source; they add up in squares.

    Attributes
    ----------
    statistics : float -- from the scatter of the samples
    clock : float -- from what the fit does not know of the rate of one clock against the other
    time_base : float -- from the clock that all stamps rest on
    temperature : float -- NaN where nothing is said of it
    """

    statistics: float
    clock: float = 0.0
    time_base: float = 0.0
    temperature: float = np.nan

    @property
    def together(self) -> float:
        """Combined standard uncertainty."""
        return float(np.sqrt(np.nansum(np.square(self)))) if np.isfinite(self.statistics) else np.nan


class ModeRow(NamedTuple):
    """One identified mode, as every page, table, figure and file has it.

    Attributes
    ----------
    model : a model with ``modes()`` -- that it is of
    output : str -- that it is of, where outputs have poles of their own
    number : int -- in the model, from 1
    omega, zeta : float -- natural frequency [rad/s] and damping ratio
    of_omega, of_zeta : Budget -- what is not known of them
    """

    model: Any
    output: str
    number: int
    omega: float
    zeta: float
    of_omega: Budget
    of_zeta: Budget

    @property
    def omega_sd(self) -> float:
        """Standard uncertainty of the natural frequency [rad/s], all sources together."""
        return self.of_omega.together

    @property
    def zeta_sd(self) -> float:
        """Standard uncertainty of the damping ratio, all sources together."""
        return self.of_zeta.together

    @property
    def name(self) -> str:
        """How tables call it."""
        return f"{self.output} {self.number}".strip()


def mode_rows(models: Sequence[Any], sources: ErrorSources | None = None) -> list[ModeRow]:
    """Return every mode of the models, each once; with the output's name where outputs have poles of their own.

    Parameters
    ----------
    models : sequence of models
    sources : ErrorSources, optional -- what the scatter of the samples cannot show; None: the fit's own alone

    Notes
    -----
    What the clock rate contributes is the part of the variance that goes with it: its covariance with the number,
    squared, over its own variance.
    """
    known = ErrorSources() if sources is None else sources
    distinct: dict[tuple[float, ...], Any] = {}
    for model in models:
        if hasattr(model, "modes"):
            distinct.setdefault(tuple(model.modes()[0]), model)
    rows = []
    for model in distinct.values():
        output = getattr(model, "output_name", "") if len(distinct) > 1 else ""
        for number, (omega, zeta, *sds) in enumerate(zip(*model.modes(), strict=True), 1):
            shares = _clock_shares(model, number - 1)
            own = [float(np.sqrt(max(sd**2 - part, 0.0))) for sd, part in zip(sds, shares, strict=True)]
            of_clock = np.sqrt(shares)
            kelvin = known.temperature_k
            rows.append(
                ModeRow(
                    model,
                    output,
                    number,
                    float(omega),
                    float(zeta),
                    Budget(
                        own[0],
                        float(of_clock[0]),
                        known.time_base * float(omega),
                        np.nan if kelvin is None else abs(known.frequency_per_kelvin) * kelvin * float(omega),
                    ),
                    Budget(own[1], float(of_clock[1])),
                )
            )
    return rows


def _clock_shares(model: Any, mode: int) -> tuple[float, float]:
    """Return the variances of a mode's frequency and damping ratio that go with the rate of a clock."""
    if not isinstance(model, ModalModel):
        return 0.0, 0.0
    n, covariance = model.n_modes, model.covariance
    rate = 2 * n + 1
    if not covariance[rate, rate] > 0.0:
        return 0.0, 0.0
    of_omega, of_zeta = (
        float(covariance[place, rate] ** 2 / covariance[rate, rate]) for place in (mode, n + mode)
    )
    return of_omega, of_zeta


class BesideTheory(NamedTuple):
    """A mode beside that of theory.

    Attributes
    ----------
    mode : ModeRow
    number : int -- of theory's mode, from 1
    predicted, predicted_sd : float -- theory's natural frequency and its standard uncertainty [rad/s]
    deviation, uncertainty : float -- of the identified one from it, and the standard uncertainty of that, relative
    damping_ratio : float -- of theory
    """

    mode: ModeRow
    number: int
    predicted: float
    predicted_sd: float
    deviation: float
    uncertainty: float
    damping_ratio: float

    @property
    def z(self) -> float:
        """Deviation of the frequency over its uncertainty, of both sides together; NaN where that is not known."""
        return self.deviation / self.uncertainty if self.uncertainty > 0.0 else np.nan

    @property
    def damping_z(self) -> float:
        """The same of the damping ratio; theory takes its own as given."""
        sd = self.mode.zeta_sd
        return (self.mode.zeta - self.damping_ratio) / sd if sd > 0.0 else np.nan


@dataclass(frozen=True)
class Agreement:
    """Identified frequencies against theory, all together.

    Attributes
    ----------
    beside : tuple of BesideTheory -- of every mode that is near one of theory
    chi_squared : float -- with the correlations between the modes; NaN where no uncertainty is known
    p_value : float -- how often so much or more comes of the stated uncertainties alone
    is_exact : bool -- whether the beam is known to be that of theory
    """

    beside: tuple[BesideTheory, ...]
    chi_squared: float
    p_value: float
    is_exact: bool

    def of(self, mode: ModeRow) -> BesideTheory | None:
        """Return a mode beside theory, None where none of theory's is near."""
        return next((one for one in self.beside if one.mode is mode), None)

    @property
    def is_doubtful(self) -> bool:
        """Whether chance would hardly make such differences."""
        return self.p_value < _LEVEL

    @property
    def verdict(self) -> str:
        """The test in a sentence without its full stop."""
        n = len(self.beside)
        if not np.isfinite(self.chi_squared):
            return "the frequencies were not tested against theory: no uncertainty of theory is known"
        tested = f"chi-squared {self.chi_squared:.2f} over {n} modes, p = {self.p_value:.2g}"
        if not self.is_doubtful:
            return f"the frequencies agree with theory ({tested})"
        if self.is_exact:
            return (
                f"the frequencies differ from the simulated ones by more than they claim ({tested}): something acts "
                "that the linear model leaves out, or the uncertainties are too small"
            )
        return (
            f"the frequencies fit no mixture of the named sources of theory's uncertainty ({tested}): those move all "
            "modes together, so that each mode alone may look well while their pattern does not"
        )


def beside_theory(modes: Sequence[ModeRow], theory: Theory) -> Agreement:
    """Hold identified modes against theory, through the uncertainties of both."""
    found, own, common = [], [], []
    for mode in modes:
        k = nearest_mode(theory.natural_frequencies, mode.omega)
        if k is None:
            continue
        own_sd = float(np.nan_to_num(mode.omega_sd)) / mode.omega
        deviation = mode.omega / float(theory.predicted[k]) - 1.0
        type_b = float(theory.type_b[k])
        found.append(
            BesideTheory(
                mode,
                k + 1,
                float(theory.predicted[k]),
                type_b * float(theory.predicted[k]),
                deviation,
                float(np.hypot(own_sd, type_b)),
                float(theory.damping_ratios[k]),
            )
        )
        budget = np.nan_to_num(np.array(mode.of_omega)) / mode.omega
        own.append(budget[0])
        # Clock, time base and temperature move all modes together, as each source of theory does.
        common.append([*budget[1:], *(part[k] for part in theory.contributions.values())])
    chi_squared, p_value = np.nan, np.nan
    if found and all(one.uncertainty > 0.0 for one in found):
        deviations, shared = np.array([one.deviation for one in found]), np.array(common)
        covariance = np.diag(np.square(own)) + shared @ shared.T
        # Where all is common, a floor at rounding keeps the matrix invertible.
        covariance += 1e-12 * np.diag(np.diag(covariance))
        chi_squared = float(deviations @ np.linalg.solve(covariance, deviations))
        p_value = float(chi_squared_tail(len(found), chi_squared))
    return Agreement(tuple(found), chi_squared, p_value, theory.is_exact)


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
