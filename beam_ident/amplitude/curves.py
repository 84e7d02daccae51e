"""Frequency and damping ratio over amplitude, with bands that hold along the whole curve."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import fdtrc

from beam_ident.amplitude.decay_fit import LINEAR, DecayFit, DecayProblem, Law
from beam_ident.amplitude.driven_fit import LAW as DRIVEN_LAW
from beam_ident.amplitude.driven_fit import DrivenProblem
from beam_ident.amplitude.lack_of_fit import LEVEL as MISFIT_LEVEL
from beam_ident.amplitude.lack_of_fit import lack_of_fit, without_own_swings
from beam_ident.amplitude.linearity import linearity
from beam_ident.amplitude.slow_flow import ringing, ringing_slopes
from beam_ident.arrays import BoolArray, FloatArray
from beam_ident.data.argument_checks import require_output, require_signals
from beam_ident.data.records import OutputSignal, TimeRecord
from beam_ident.data.stored_form import ADDED_LATER, read, require_shapes, written
from beam_ident.errors import EstimationError
from beam_ident.modal.model import ModalModel
from beam_ident.modal_estimation.free_decay import end_of_rest, fit_free_decay
from beam_ident.noise.scores import Whiteness, colour_warning
from beam_ident.numerics.blas_threads import on_one_thread
from beam_ident.quantities import with_uncertainty
from beam_ident.sensing.damage import damage_warnings
from beam_ident.sensing.misfit_causes import misfit_warnings
from beam_ident.sensing.quantisation import clipped_warnings
from beam_ident.summary import Summarised, SummaryPart, SummaryTable

SCHEMA = 1

_LAWS = (Law(2, 3), Law(3, 3), Law(2, 4), Law(3, 4), Law(4, 4))
_POINTS = 60
_DRAWS = 4000
_LEVEL = 0.95
_ALONE = 0.2  # another mode within this of the frequency, or of three times it, is the nonlinearity's own
_MAX_OTHERS = 4
_SEEN_DECAY = 3.0  # standard deviations of the decay rate of one pole
_LOWEST = 3.0  # standard deviations of the noise over a decay: below that no amplitude is seen
_MIN_SAMPLES = 60


@dataclass(frozen=True, eq=False, repr=False)
class AmplitudeCurves(Summarised):
    """Instantaneous frequency and damping ratio of one mode over its amplitude.

    Attributes
    ----------
    amplitudes : ndarray, shape (n,)
        Half of a swing from side to side, rising from the smallest to the largest that the decays show [``unit``].
    frequencies_hz, frequency_band_hz : ndarray, shape (n,) and (2, n)
        Of the ringing; with 95 % the band holds the whole curve. It has room for what averaging leaves out, too:
        eta^3 of a frequency and eta^2 of a damping ratio, eta being how far stiffness and damping change a cycle.
    damping_ratios, damping_band : ndarray, shape (n,) and (2, n)
        ``-A'/(A omega)``: what a logarithmic decrement between two neighbouring maxima shows.
    frequency_sd_hz, damping_sd : ndarray, shape (n,)
        Standard deviations point by point.
    is_one_pole : bool
        Whether one frequency and one damping ratio describe the decays, at the level of 5 %.
    p_value : float
        Of the F-test for that.
    verdict : str
        The same in words, with how much the curves change.
    reference_amplitude : float
        Unit of the coefficients' amplitude [``unit``].
    frequency_coefficients : ndarray
        ``w_0, w_2, ..`` of ``phi' = w_0 + w_2 A^2 + ..`` [rad/s], to first order.
    rate_coefficients : ndarray
        ``g_-1, g_0, g_1, ..`` of ``-A' = g_-1 + g_0 A + g_1 A^2 + ..`` [1/s]: dry, linear and quadratic damping.
    covariance : ndarray, shape (n_terms, n_terms)
        Of both, one after the other.
    output_name, unit : str
        Whose amplitude is meant.
    noise_sd : ndarray, shape (n_outputs,)
    converged : bool
    reason : str
    iterations : int
    warnings : tuple of str
    third_harmonic : float
        h of the third harmonic h A^3 cos(3 phi), which raises the maxima above A, in units as of the coefficients.
    """

    amplitudes: FloatArray
    frequencies_hz: FloatArray
    frequency_band_hz: FloatArray
    damping_ratios: FloatArray
    damping_band: FloatArray
    frequency_sd_hz: FloatArray
    damping_sd: FloatArray
    is_one_pole: bool
    p_value: float
    verdict: str
    reference_amplitude: float
    frequency_coefficients: FloatArray
    rate_coefficients: FloatArray
    covariance: FloatArray
    output_name: str
    unit: str
    noise_sd: FloatArray
    converged: bool
    reason: str
    iterations: int
    warnings: tuple[str, ...]
    third_harmonic: float = field(default=0.0, metadata=ADDED_LATER)

    def summary_parts(self) -> list[SummaryPart]:
        """Return the summary's tables and sentences."""
        ends = (0, -1) if len(self.amplitudes) > 1 else (0,)
        rows = (
            (
                f"{self.amplitudes[k]:.4g}",
                with_uncertainty(float(self.frequencies_hz[k]), float(self.frequency_sd_hz[k])),
                with_uncertainty(100.0 * float(self.damping_ratios[k]), 100.0 * float(self.damping_sd[k])),
            )
            for k in ends
        )
        return [
            self.verdict,
            SummaryTable(
                (f"amplitude of {self.output_name} [{self.unit}]", "f [Hz]", "zeta [%]"), tuple(rows)
            ),
            *(f"warning: {said}" for said in self.warnings),
        ]

    def frequency_hz_at(self, amplitude: ArrayLike) -> FloatArray:
        """Return the frequency at amplitudes [``unit``]; NaN, with a warning, outside those of the decays [Hz]."""
        return np.asarray(self._ringing(amplitude)[0] / (2.0 * np.pi))

    def damping_ratio_at(self, amplitude: ArrayLike) -> FloatArray:
        """Return the damping ratio at amplitudes [``unit``]; NaN, with a warning, outside those of the decays."""
        return np.asarray(self._ringing(amplitude)[1])

    def _ringing(self, amplitude: ArrayLike) -> FloatArray:
        """Return frequencies [rad/s] and damping ratios, (2, *shape of the amplitudes)."""
        asked = np.asarray(amplitude, dtype=np.float64)
        noise = float(np.max(self.noise_sd))  # by which both ends are known
        known = np.asarray((asked >= self.amplitudes[0] - noise) & (asked <= self.amplitudes[-1] + noise))
        if not np.all(known):
            warnings.warn(
                f"amplitudes outside {self.amplitudes[0]:.4g} to {self.amplitudes[-1]:.4g} {self.unit}, which the "
                "decays show: NaN is returned there. Measure a decay that reaches them",
                stacklevel=3,
            )
        found = np.full((2, asked.size), np.nan)
        found[:, known.ravel()] = ringing(
            self.frequency_coefficients,
            self.rate_coefficients,
            self.third_harmonic,
            asked[known] / self.reference_amplitude,
        )
        return found.reshape(2, *asked.shape)

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain lists and numbers, from which it is rebuilt exactly (also through JSON)."""
        return written(self, "amplitude_curves", SCHEMA)

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> AmplitudeCurves:
        """Rebuild what ``to_dict`` wrote.

        Raises
        ------
        ModelFormatError
            Another type or schema, a missing entry, or entries that do not agree.
        """
        found = read(AmplitudeCurves, data, "amplitude_curves", SCHEMA)
        w = found.frequency_coefficients
        if "third_harmonic" not in data and len(w) > 1:  # before it was estimated, a cubic spring's was taken
            found = replace(found, third_harmonic=float(w[1] / (12.0 * w[0])))
        n = len(found.amplitudes)
        m = len(found.frequency_coefficients) + len(found.rate_coefficients)
        rows = ("frequencies_hz", "damping_ratios", "frequency_sd_hz", "damping_sd")
        bands = {"frequency_band_hz": (2, n), "damping_band": (2, n), "covariance": (m, m)}
        require_shapes("amplitude curves", found, {**dict.fromkeys(rows, (n,)), **bands})
        return found


@on_one_thread
def amplitude_curves(
    decays: OutputSignal | Sequence[OutputSignal] | Sequence[Sequence[OutputSignal]],
    *,
    frequency_hz: float | None = None,
    output: str | None = None,
    seed: int = 0,
) -> AmplitudeCurves:
    """Estimate frequency and damping of one mode over its amplitude, from one or several free decays.

    Parameters
    ----------
    decays : OutputSignal, sequence of them, or sequence of such sequences
        One output, the outputs of one decay, or those of several decays, each with the same outputs in the same
        order; at any stamps, NaN where nothing was seen. A rest before the swings is left out.
    frequency_hz : float, optional
        Roughly where the mode is; by default where the decays have the most energy.
    output : str, optional
        Whose amplitude is meant; by default the output that swings most.
    seed : int
        Of the draws that make the bands simultaneous.

    Returns
    -------
    AmplitudeCurves

    Raises
    ------
    EstimationError
        Too few samples or cycles, swings that do not decay, outputs that differ from decay to decay, or an unknown
        output.

    Notes
    -----
    The mode is followed by averaging (``slow_flow``): stiffness that changes with amplitude, dry, linear and
    quadratic damping; further powers where the Bayesian information criterion asks for them, and one more of
    frequency and of damping than it asks for, so that what it leaves unseen is inside the band. All decays share one
    law. Noise is found from the residuals; where it is coloured, its density at the mode's frequency counts. Bands
    are simultaneous by the largest of the standardised errors along the curve, drawn from the estimates' covariance,
    with the bound of what averaging leaves out as their bias (Armstrong and Kolesar 2018). The test for one pole
    compares it with the first of the laws, fixed in advance.
    """
    rows, warnings = _without_rest(_checked(decays))
    names = [signal.name for signal in rows[0]]
    if output is not None and output not in names:
        raise EstimationError(f"output is {output!r}; expected one of {', '.join(names)}")
    if frequency_hz is not None and not (math.isfinite(frequency_hz) and frequency_hz > 0.0):
        raise EstimationError(f"frequency_hz is {frequency_hz!r}; expected a number above 0, in Hz")
    largest = int(np.argmax([max(float(np.std(row[j].values)) for row in rows) for j in range(len(names))]))
    reference = largest if output is None else names.index(output)
    problem = DecayProblem(rows, reference)
    # Windows whose amplitudes hardly differ say little of a law: one pole may then be the better start of one.
    one_pole = problem.fit(problem.start(frequency_hz, LINEAR))
    _require_decay(problem, one_pole)
    base = problem.fit(problem.start(frequency_hz, _LAWS[0]))
    if not base.cost < one_pole.cost:
        base = problem.fit(one_pole.point.extended(_LAWS[0]))
    base = _with_other_modes(problem, base)
    if len(base.point.others):
        one_pole = problem.fit(replace(one_pole.point, others=base.point.others))
    fit = _richest(problem, base)
    if lack_of_fit(problem, fit) < MISFIT_LEVEL:
        beating = _with_near_mode(problem, one_pole, fit)
        if beating is not None:
            one_pole, base = beating
            fit = _richest(problem, base)
    # What the criterion does not ask for may still bend the curve by as much as its noise: the band is that of a law
    # with one more power of each, beside which what stays out is small. Amplitudes that hardly differ do not tell so
    # many powers apart, and do not need them. The test knows nothing of this choice.
    law = fit.point.law
    wide = problem.fit(fit.point.extended(Law(law.n_frequency + 1, law.n_rate + 1)))
    if _asks_for_more(problem, fit):
        warnings.append(
            "the frequency bends more sharply over the amplitude than the powers of the law do, as at a stop or a "
            "clearance: the bands do not hold there; give decays from below the bend, and others from above it"
        )
    fit = wide if wide.converged else fit
    warnings += _misfit(problem, fit)
    curves = _judged(problem, fit, (one_pole, base), "decay", seed)
    return replace(curves, warnings=(*warnings, *curves.warnings))


@on_one_thread
def driven_amplitude_curves(
    records: Sequence[TimeRecord],
    model: ModalModel,
    *,
    mode: int = 0,
    output: str | None = None,
    seed: int = 0,
) -> AmplitudeCurves:
    """Estimate frequency and damping of one mode over its amplitude, from driven records at several levels.

    Parameters
    ----------
    records : sequence of TimeRecord
        With the same outputs; what rings freely in them counts as well. Of long ones the stretches in which their
        inputs move most are read.
    model : ModalModel
        Identified from them: its pole is where the law begins, its other modes stand beside.
    mode : int
        Index from 0.
    output : str, optional
        Whose amplitude is meant; by default the output that the mode moves most.
    seed : int
        Of the draws that make the bands simultaneous.

    Returns
    -------
    AmplitudeCurves

    Raises
    ------
    EstimationError
        An unknown mode or output, one that never changes, or amplitudes that hardly differ.

    Notes
    -----
    The law is that of ``amplitude_curves`` with a cubic spring, dry, linear and quadratic damping, under the drive
    that the linear model knows (``driven_fit``): all records are one fit, with their noise.
    """
    require_signals(records)
    problem = DrivenProblem(records, model, mode, output)
    fit = problem.fit(DRIVEN_LAW)
    if problem.has_noisy_input:
        # What rings in the mode is in the covariance of the fit, and behind a filter in this test alone.
        p_value = linearity(records, model).modes[mode].p_value
        return _curves(problem, fit, 1.0, p_value, "data", np.random.default_rng(seed))
    return _judged(problem, fit, (problem.fit(LINEAR), fit), "data", seed)


def _judged(
    problem: DecayProblem | DrivenProblem,
    fit: DecayFit,
    nested: tuple[DecayFit, DecayFit],
    what: str,
    seed: int,
) -> AmplitudeCurves:
    """Return the curves with the verdict on one pole against a law that has one as a case."""
    one_pole, base = nested
    colour, n_lines = _colour(problem, fit)
    n, more = problem.n_samples, base.point.law.n_terms - LINEAR.n_terms
    # Where the noise's density was read off a few lines, these are all that is known of it.
    free = n - base.n_parameters if n_lines == 0 else min(2 * n_lines, n - base.n_parameters)
    gain = (
        math.expm1(min(2.0 * max(one_pole.cost - base.cost, 0.0) / n, 600.0))
        * (n - base.n_parameters)
        / colour
    )
    p_value = float(fdtrc(more, free, gain / more))
    return _curves(problem, fit, colour, p_value, what, np.random.default_rng(seed))


def _checked(decays: Any) -> list[list[OutputSignal]]:
    """Return decays as rows of outputs without missing values."""
    expected = "expected an OutputSignal, a sequence of them, or a sequence of such sequences"
    given = [decays] if isinstance(decays, OutputSignal) else decays
    if not isinstance(given, Sequence) or isinstance(given, str):
        raise EstimationError(f"decays is a {type(decays).__name__}; {expected}")
    if not given:
        raise EstimationError(f"there is no decay; {expected}")
    rows: Sequence[Any] = [given] if isinstance(given[0], OutputSignal) else given
    result = []
    for number, row in enumerate(rows):
        own = list(row) if isinstance(row, Sequence) else []
        if not own or not all(isinstance(signal, OutputSignal) for signal in own):
            raise EstimationError(f"decay {number} is no sequence of outputs; {expected}")
        if [signal.name for signal in own] != [signal.name for signal in rows[0]]:
            raise EstimationError(
                f"decay {number} has the outputs {', '.join(s.name for s in own)}, the first has "
                f"{', '.join(s.name for s in rows[0])}; expected the same in the same order"
            )
        for signal in own:
            if np.count_nonzero(signal.is_valid) < _MIN_SAMPLES:
                raise EstimationError(
                    f"output {signal.name!r} of decay {number} has {np.count_nonzero(signal.is_valid)} samples; a "
                    f"curve over amplitude needs at least {_MIN_SAMPLES}: record longer or more often"
                )
            require_output(signal.name, signal.values[signal.is_valid])
        result.append([replace(s, times_s=s.times_s[s.is_valid], values=s.values[s.is_valid]) for s in own])
    return result


def _without_rest(decays: list[list[OutputSignal]]) -> tuple[list[list[OutputSignal]], list[str]]:
    """Return decays from where they ring, and what was left out before."""
    rows, warnings = [], []
    for number, row in enumerate(decays):
        begin = end_of_rest(row)
        if begin is not None:
            warnings.append(f"decay {number} rested first: it is taken from {begin:.6g} s")
            kept = [s.times_s >= begin for s in row]
            row = [
                replace(s, times_s=s.times_s[k], values=s.values[k]) for s, k in zip(row, kept, strict=True)
            ]
        rows.append(row)
    return rows, warnings


def _require_decay(problem: DecayProblem, one_pole: DecayFit) -> None:
    """Raise EstimationError where the swings stay as they are, or grow: they show one level, or a drive."""
    rate = float(one_pole.point.rate_terms[1])
    sd = math.sqrt(_colour(problem, one_pole)[0]) * float(np.linalg.norm(one_pole.spread[1]))
    if rate < _SEEN_DECAY * sd:
        signal = problem.decays[0][problem.reference]
        first, last = (
            one_pole.point.reference * float(np.max(sizes))
            for sizes in (one_pole.point.amplitudes, one_pole.last_amplitudes)
        )
        raise EstimationError(
            f"the swings do not decay: those of {signal.name} go from {first:.3g} to {last:.3g} {signal.unit}; a "
            "curve needs amplitudes that differ: give the stretch after the structure is let go, or records driven "
            "at several levels to driven_amplitude_curves"
        )


def _richest(problem: DecayProblem, base: DecayFit) -> DecayFit:
    """Return the fit of the law that the Bayesian information criterion asks for."""
    fit = base
    for law in _LAWS[1:]:
        if problem.n_samples > 4 * (fit.n_parameters + 2):
            richer = problem.fit(base.point.extended(law))
            fit = richer if richer.converged and richer.criterion < fit.criterion else fit
    return fit


def _asks_for_more(problem: DecayProblem, fit: DecayFit) -> bool:
    """Return whether the criterion asks for more powers of frequency than there are."""
    law = fit.point.law
    if law.n_frequency < _LAWS[-1].n_frequency:
        return False
    richer = problem.fit(fit.point.extended(Law(law.n_frequency + 1, law.n_rate)))
    return richer.converged and richer.criterion < fit.criterion


def _with_other_modes(problem: DecayProblem, fit: DecayFit) -> DecayFit:
    """Return a fit in which further modes, that ring beside the one of the curve, have their own columns."""
    own = float(fit.point.omega_terms[0])
    try:
        beside = fit_free_decay(without_own_swings(problem, fit), max_modes=_MAX_OTHERS)
    except EstimationError:
        return fit
    others = np.stack([beside.natural_frequencies, beside.damping_ratios], axis=1)
    others = others[_are_apart(others, own)]
    if not len(others):
        return fit
    found = problem.fit(replace(fit.point, others=others))
    # What moves to the mode's own frequency takes up what the law leaves there, and is no mode.
    apart = _are_apart(found.point.others, own)
    if not np.any(apart):
        return fit
    if not np.all(apart):
        found = problem.fit(replace(fit.point, others=found.point.others[apart]))
        apart = _are_apart(found.point.others, own)
    return found if np.all(apart) and found.converged and found.criterion < fit.criterion else fit


def _are_apart(others: FloatArray, own: float) -> BoolArray:
    """Return which modes ring apart from the one of the curve and from its third harmonic."""
    share, zetas = others[:, 0] / own, others[:, 1]
    is_apart = (np.abs(share - 1.0) > _ALONE) & (np.abs(share / 3.0 - 1.0) > 0.5 * _ALONE)
    return np.asarray(is_apart & (share > 0.0) & (np.abs(zetas) < 1.0))


def _with_near_mode(
    problem: DecayProblem, one_pole: DecayFit, fit: DecayFit
) -> tuple[DecayFit, DecayFit] | None:
    """Return fits of one pole and of the first law beside another mode near it, None where no linear mode is there.

    Two linear modes must describe the decays better than a law alone, and as well as two modes with the law.
    """
    try:
        found = fit_free_decay(problem.decays[0], n_modes=2)
    except EstimationError:
        return None
    omegas, zetas = found.natural_frequencies, found.damping_ratios
    if not abs(omegas[1] / omegas[0] - 1.0) < _ALONE:
        return None
    swings = found.amplitudes[problem.reference]
    first = int(np.argmax(np.abs(swings) / np.sqrt(omegas * zetas)))  # the one of more energy
    point = one_pole.point
    sizes, phases = point.amplitudes.copy(), point.phases.copy()
    sizes[0], phases[0] = abs(swings[first]) / point.reference, np.angle(swings[first])
    near = np.array([[omegas[1 - first], zetas[1 - first]]])
    start = replace(
        point,
        omega_terms=omegas[first : first + 1] * np.sqrt(1.0 - zetas[first] ** 2),
        rate_terms=np.array([0.0, omegas[first] * zetas[first]]),
        amplitudes=sizes,
        phases=phases,
        others=np.concatenate([near, point.others]),
    )
    beating = problem.fit(start)
    if not (beating.converged and beating.criterion < fit.criterion):
        return None
    base = problem.fit(beating.point.extended(_LAWS[0]))
    return (beating, base) if beating.criterion < base.criterion else None


def _misfit(problem: DecayProblem, fit: DecayFit) -> list[str]:
    """Return what is known of outputs that a law does not describe, or that are no measurements."""
    own, modes = float(fit.point.omega_terms[0]), fit.point.others[:, 0]
    said = [
        f"two modes beat, at {own / (2.0 * math.pi):.5g} and {omega / (2.0 * math.pi):.5g} Hz: the curve is that "
        "of the first, beside which the second is taken for linear"
        for omega in modes[np.abs(modes / own - 1.0) < _ALONE]
    ]
    p_value = lack_of_fit(problem, fit)
    if p_value < MISFIT_LEVEL:
        said.append(
            f"the law does not follow the decay: what is left of it swings at the mode's own frequency (p = "
            f"{p_value:.1g}), and the bands do not hold. A stop or a clearance, a blow in mid-record, or another "
            "mode near this one may do that: give a stretch without it"
        )
    for j, signal in enumerate(problem.decays[0]):
        parts = [
            (row[j].times_s, row[j].values - e[j], e[j])
            for row, e in zip(problem.decays, fit.residuals, strict=True)
        ]
        said += misfit_warnings([(signal.name, parts)])
    for row in problem.decays:
        said += [*clipped_warnings(row), *damage_warnings(row)]
    return list(dict.fromkeys(said))


def _colour(problem: DecayProblem | DrivenProblem, fit: DecayFit) -> tuple[float, int]:
    """Return the noise's density about the mode over that of white noise of its variance, and from how many lines.

    It is 1, from none, where the noise of every output is white.
    """
    n_lines = 0
    omega = float(fit.point.omega_terms[0])
    ratios, weights = [], []
    for row, residuals in zip(problem.decays, fit.residuals, strict=True):
        for signal, e in zip(row, residuals, strict=True):
            if Whiteness.of(e).is_white:
                ratios.append(1.0)
            else:
                t = signal.times_s - signal.times_s[0]
                near = omega + 2.0 * np.pi * (np.arange(-12, 13) + 0.0) / float(t[-1])
                # The fit has emptied the lines that its own columns fill.
                near = near[np.abs(np.arange(-12, 13)) > 2]
                lines = np.exp(-1j * near[:, None] * t) @ e
                n_lines += len(near)
                ratios.append(float(np.mean(np.abs(lines) ** 2) / (e @ e)))
            weights.append(len(e))
    return max(float(np.average(ratios, weights=weights)), 1e-3), n_lines


def _curves(
    problem: DecayProblem | DrivenProblem,
    fit: DecayFit,
    colour: float,
    p_value: float,
    what: str,
    rng: np.random.Generator,
) -> AmplitudeCurves:
    point = fit.point
    signal = problem.decays[0][problem.reference]
    spread = math.sqrt(colour) * fit.spread
    density = max(len(row[problem.reference].values) for row in problem.decays)
    noise = fit.noise_sd[problem.reference] * math.sqrt(2.0 * colour / density) / point.reference
    w, g, third = point.omega_terms, point.rate_terms, point.third
    top = float(np.max(point.amplitudes))
    top *= 1.0 + third * top**2
    low = min(max(float(np.min(fit.last_amplitudes)), _LOWEST * noise, 1e-3 * top), 0.9 * top)
    A = np.geomspace(low, top, _POINTS)
    omega, zeta = ringing(w, g, third, A)
    by_frequency, by_damping = ringing_slopes(w, g, third, A)
    # Averaging is right to second order in eta.
    eta = np.abs(omega / w[0] - 1.0) + np.abs(zeta)
    left_out = (omega * eta**3, np.abs(zeta) * eta**2)
    bands, deviations = [], []
    draws = rng.standard_normal((spread.shape[1], _DRAWS))
    for values, slopes, own in ((omega, by_frequency, left_out[0]), (zeta, by_damping, left_out[1])):
        moved = slopes @ spread
        sd = np.linalg.norm(moved, axis=1)
        size = np.hypot(sd, own)[:, None]
        reach = float(np.quantile(np.max(np.abs(moved @ draws + own[:, None]) / size, axis=0), _LEVEL))
        bands.append(np.stack([values - reach * size[:, 0], values + reach * size[:, 0]]))
        deviations.append(sd)
    is_one_pole = p_value > 1.0 - _LEVEL
    names = [s.name for s in problem.decays[0]]
    measured = [np.concatenate([row[j].values for row in problem.decays]) for j in range(len(names))]
    left = [np.concatenate([row[j] for row in fit.residuals]) for j in range(len(names))]
    warnings = list(colour_warning(names, tuple(Whiteness.of(e) for e in left), measured, left))
    if np.any(zeta[0] < 0.0):
        warnings.append(
            "the smallest amplitudes seem to grow: the law does not describe them; leave out the end of the decay"
        )
    change = 100.0 * (omega[-1] / omega[0] - 1.0)
    words = (
        f"{point.reference * low:.3g} to {point.reference * top:.3g} {signal.unit} of {signal.name}: frequency "
        f"{omega[0] / (2.0 * math.pi):.6g} to {omega[-1] / (2.0 * math.pi):.6g} Hz ({change:+.2g} %), damping ratio "
        f"{100.0 * zeta[0]:.3g} to {100.0 * zeta[-1]:.3g} %"
    )
    chance = f"p = {p_value:.2g}" if p_value > 1e-9 else "p < 1e-9"
    verdict = f"one pole describes the {what} ({chance}) from {words}"
    if not is_one_pole:
        verdict = f"one pole does not describe the {what} ({chance}): from {words}"
    return AmplitudeCurves(
        amplitudes=A * point.reference,
        frequencies_hz=omega / (2.0 * np.pi),
        frequency_band_hz=bands[0] / (2.0 * np.pi),
        damping_ratios=zeta,
        damping_band=bands[1],
        frequency_sd_hz=deviations[0] / (2.0 * np.pi),
        damping_sd=deviations[1],
        is_one_pole=is_one_pole,
        p_value=p_value,
        verdict=verdict,
        reference_amplitude=point.reference,
        frequency_coefficients=w,
        rate_coefficients=g,
        covariance=colour * fit.covariance[:-1, :-1],
        output_name=signal.name,
        unit=signal.unit,
        noise_sd=np.array(fit.noise_sd),
        converged=fit.converged,
        reason="the steps became invisible" if fit.converged else "the iterations were used up",
        iterations=fit.iterations,
        warnings=tuple(warnings),
        third_harmonic=third,
    )
