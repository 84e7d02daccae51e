"""Natural frequencies and damping from free decays: the logarithmic decrement without peak picking.

A structure that was let go rings as a sum of damped cosines,

    y_j(t) = Re sum_i a_ij e^(p_i t) + drift_j(t),      p_i = omega_i (-zeta_i + j sqrt(1 - zeta_i^2))

and the least-squares fit of that sum uses every sample, at any stamps and averaged over any
exposure, where the classical decrement uses two peaks.  Poles are common to all outputs.  The drift
is a straight line, which is also the rigid motion of a structure that nothing holds, or a cubic where
the data ask for one.
What bends on the way to the samples rings at multiples of a mode's frequency: such cosines are fitted like modes, and
listed apart (``harmonics``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.polynomial.legendre import legvander

from beam_ident.arrays import FloatArray
from beam_ident.data.argument_checks import require_output
from beam_ident.data.bandwidth import Band
from beam_ident.data.prior import Prior
from beam_ident.data.records import OutputSignal
from beam_ident.errors import EstimationError
from beam_ident.modal.fit import ModalFit
from beam_ident.modal.free_decay_result import FreeDecay
from beam_ident.modal.regression import modal_poles, pole_slopes
from beam_ident.modal.stacked_regression import ColumnBasis, Columns, Part, StackedRegression
from beam_ident.modal_estimation.harmonics import harmonic_sentences, harmonics_of
from beam_ident.modal_estimation.mode_gates import mode_warnings
from beam_ident.modal_estimation.mode_scan import Candidate, rivals
from beam_ident.modal_estimation.mode_search import (
    MAX_MODES,
    SHORT,
    SLOW_NOISE,
    ModeSearch,
    Weighed,
    checked_limit,
)
from beam_ident.modal_estimation.record_levels import SlowNoiseWeights, unturned
from beam_ident.modal_estimation.variable_projection import fit_modes
from beam_ident.modal_estimation.weighted_fit import WeightedFit
from beam_ident.noise.scores import Scores, Whiteness, colour_warning
from beam_ident.numerics.blas_threads import on_one_thread
from beam_ident.numerics.free_motion import free_motions
from beam_ident.sensing.damage import damage_warnings
from beam_ident.sensing.misfit_causes import misfit_warnings
from beam_ident.sensing.quantisation import clipped_warnings

_DAMPING = (0.0005, 0.002, 0.006, 0.02, 0.06, 0.2)
_PEAKS = 12
_MAX_FREQUENCIES = 2000
_MIN_SAMPLES = 12
_QUIETER = 10.0  # times in power: what a structure that stands still is below one that rings
_AT_ONCE = 1.5  # cycles after a rest in which a decay has its largest swing
_STRAIGHT, _BENT = 1, 3  # degrees of a drift; anything quicker has cycles enough to be a mode


class _DecayBasis(ColumnBasis):
    """Drift and damped cosines at the stamps of outputs that share them.

    Parameters
    ----------
    elapsed : ndarray, shape (n,) -- since the start of the decay [s]
    exposure_s : float
    degree : int -- of the drift
    """

    def __init__(self, elapsed: FloatArray, exposure_s: float, degree: int = 0) -> None:
        self.elapsed, self.exposure_s = elapsed, exposure_s
        # An exposure turns a polynomial into another one of the same degree.
        reach = max(float(np.ptp(elapsed)), 1e-300)
        self._drift = legvander(2.0 * (elapsed - elapsed[0]) / reach - 1.0, degree)

    def fixed(self, latency: float) -> Columns:
        """Return constant and drift."""
        del latency
        return Columns(self._drift, self._drift, self._drift)

    def modal(self, omega: float, zeta: float, latency: float) -> Columns:
        """Return cosine and sine of one mode with their derivatives."""
        del latency
        omegas, zetas = np.array([omega]), np.array([zeta])
        poles, slopes = modal_poles(omegas, zetas)[:, None], pole_slopes(omegas, zetas)
        found = free_motions(poles, self.elapsed, self.exposure_s, slopes)[:3]
        return Columns(*(np.stack([own[0].real, -own[0].imag], axis=1) for own in found))

    def scanned(self, omegas: FloatArray, zetas: FloatArray, latency: float) -> FloatArray:
        """Return cosines and sines of candidates."""
        del latency
        (found,) = free_motions(modal_poles(omegas, zetas)[:, None], self.elapsed, self.exposure_s, ())
        return np.stack([found.real, -found.imag], axis=1)


@on_one_thread
def fit_free_decay(
    outputs: OutputSignal | Sequence[OutputSignal],
    n_modes: int | None = None,
    start_s: float = -math.inf,
    end_s: float = math.inf,
    max_modes: int = MAX_MODES,
) -> FreeDecay:
    """Fit damped cosines with common poles to free decays, without hints.

    Parameters
    ----------
    outputs : OutputSignal or a sequence of them
        At any stamps; NaN where nothing was seen.
    n_modes : int or None
        None lets the Bayesian information criterion decide, and lists harmonics apart; a number of modes is what is
        returned, whatever they are.
    start_s, end_s : float
        The stretch that rings freely [s]; without a start, a rest before it is left out, and a warning says so.
    max_modes : int

    Raises
    ------
    EstimationError
        Too few samples, an output that is constant, or nothing that rings.

    Notes
    -----
    Frequencies are looked for up to half the mean rate of the stamps.  The noise may be coloured: the last
    fit weighs by the autocorrelation of the residuals.  A mode may ring at some of the outputs only: its share is
    charged by the Bayesian information criterion where it is more than noise (``_DecaySearch``), so that
    many points find what the best of them finds alone.
    """
    signals = tuple(outputs) if isinstance(outputs, list | tuple) else (outputs,)
    if not signals or not all(isinstance(signal, OutputSignal) for signal in signals):
        found = ", ".join(type(signal).__name__ for signal in signals) or "nothing"
        raise EstimationError(
            f"there is {found} to fit a decay to; expected an OutputSignal, or a list of them"
        )
    limit = checked_limit(n_modes, max_modes)
    kept = [(s.times_s >= start_s) & (s.times_s <= end_s) & s.is_valid for s in signals]
    for signal, keep in zip(signals, kept, strict=True):
        if np.count_nonzero(keep) < max(_MIN_SAMPLES, 3 * limit if n_modes is not None else 0):
            raise EstimationError(
                f"output {signal.name!r}: {np.count_nonzero(keep)} samples between {start_s} and {end_s} s; a "
                f"decay needs at least {_MIN_SAMPLES}, and three for each mode"
            )
        require_output(signal.name, signal.values[keep])
    seen = [
        OutputSignal(s.name, s.unit, s.times_s[keep], s.values[keep], s.exposure_s)
        for s, keep in zip(signals, kept, strict=True)
    ]
    if math.isinf(start_s) and (begin := end_of_rest(seen)) is not None:
        decay = fit_free_decay(signals, n_modes, begin, end_s, max_modes)
        said = f"The outputs rested first: the decay is taken from {begin:.6g} s (start_s says otherwise)."
        return replace(decay, warnings=(said, *decay.warnings))
    failure: EstimationError | None = None
    try:
        straight = _DecaySearch(seen, _STRAIGHT)
        decay = straight.result(n_modes, max_modes)
        if not straight.is_bent:
            return decay
    except EstimationError as err:
        failure = err
    try:
        return _DecaySearch(seen, _BENT).result(n_modes, max_modes)
    except EstimationError as err:
        raise failure or err from err


def end_of_rest(signals: Sequence[OutputSignal]) -> float | None:
    """Return when structures that stood still at first swing furthest, or None where they rang from the beginning.

    Notes
    -----
    Rest and ringing are normal samples of two means and two variances: the likelihood of the best cut between them
    decides (Maeda 1985, for the onset of seismic waves).  Rest may be under a static load, whose release begins the
    decay.  What rings does not stand still for a whole cycle, and a decay does not swell.
    """
    best, begin = 0.0, None
    for signal in signals:
        values = signal.values - np.mean(signal.values)
        n = len(values)
        counts = np.arange(_MIN_SAMPLES, n - _MIN_SAMPLES)
        if not len(counts):
            continue
        sums, squares = np.cumsum(values), np.cumsum(values**2)
        before, after = counts, n - counts
        quiet = squares[counts - 1] / before - (sums[counts - 1] / before) ** 2
        loud = (squares[-1] - squares[counts - 1]) / after - ((sums[-1] - sums[counts - 1]) / after) ** 2
        floor = (1e-9 * float(np.ptp(values))) ** 2
        quiet, loud = np.maximum(quiet, floor), np.maximum(loud, floor)
        gains = n * math.log(float(np.var(values))) - before * np.log(quiet) - after * np.log(loud)
        gains[_QUIETER * quiet > loud] = -math.inf
        place = int(np.argmax(gains))
        cut = int(counts[place])
        rest = values[:cut]
        # Mean crossings of what rings, half a cycle each; those of noise alone are no cycles.
        ringing = values[cut:] - np.mean(values[cut:])
        crossings = int(np.count_nonzero(np.diff(np.signbit(ringing[np.abs(ringing) > np.ptp(rest)]))))
        stood, rang = (float(np.ptp(signal.times_s[part])) for part in (slice(cut), slice(cut, None)))
        if gains[place] <= best or crossings < 2 or stood < (cycle := 2.0 * rang / crossings):
            continue
        peak = float(signal.times_s[cut + int(np.argmax(np.abs(ringing)))])
        if peak - float(signal.times_s[cut]) < _AT_ONCE * cycle:  # what swells does not decay
            best, begin = float(gains[place]), peak
    return begin


class _DecaySearch(ModeSearch[StackedRegression]):
    """The search in decays: where the residuals ring, over all outputs.

    Parameters
    ----------
    signals : sequence of OutputSignal -- the samples that are used, all of them valid
    degree : int -- of the drift
    """

    remedy = "Give the stretch of the free decay, or a longer one"

    def __init__(self, signals: Sequence[OutputSignal], degree: int) -> None:
        self.signals, self.degree, self.is_bent = signals, degree, False
        times = [s.times_s for s in signals]
        self.start = min(float(t[0]) for t in times)
        self.sizes = [max(float(np.std(s.values)), 1e-300) for s in signals]
        longest = max(float(t[-1] - t[0]) for t in times)
        rate = max((len(t) - 1) / float(t[-1] - t[0]) for t in times)
        count = min(max(int(longest * rate), 8), _MAX_FREQUENCIES)
        self.omegas = np.asarray(np.pi * rate * (np.arange(count) + 1.0) / count)
        problem = self._problem(degree)
        super().__init__(problem, Band.without_input(longest, rate), Prior(), Prior(), shows_clock=False)

    def _problem(self, degree: int) -> StackedRegression:
        """Return the regression with a drift of some degree, outputs in units of their size."""
        places: dict[tuple[bytes, float], int] = {}
        bases: list[_DecayBasis] = []
        outputs = []
        for signal, size in zip(self.signals, self.sizes, strict=True):
            key = (signal.times_s.tobytes(), signal.exposure_s)
            if key not in places:
                places[key] = len(bases)
                bases.append(_DecayBasis(signal.times_s - self.start, signal.exposure_s, degree))
            outputs.append([Part(places[key], signal.values / size, np.ones(len(signal.values)))])
        times = [signal.times_s for signal in self.signals]
        return StackedRegression(bases, outputs, False, is_sequence=True, n_forced=0, times=times)

    def _bic(self, fit: ModalFit) -> float:
        """Return the information criterion, in which a mode is charged at each output for what it explains there.

        Notes
        -----
        The two amplitudes of a mode at output j cost ``2 log n_j``, or, where leaving them out would cost less, that:
        chi-squared of the two (Wald). The criterion is then that of the best choice of outputs for every mode.
        Its poles cost ``2 log n`` of the longest output, as if it rang there alone: many points find what one finds.
        """
        sizes = [len(values) for values in self.problem.values]
        total = 2.0 * fit.cost + fit.n_theta * math.log(max(sizes))
        for size, found, explained in zip(sizes, fit.coefficients, _explained(fit), strict=True):
            total += (len(found) - 2 * len(explained)) * math.log(size)
            total += float(np.sum(np.minimum(explained, 2.0 * math.log(size))))
        return total

    def _target(self, current: ModalFit, n_modes: int | None) -> float:
        """Return the cost that a mode which rings at one output alone must reach."""
        if n_modes is not None:
            return math.inf
        sizes = [len(values) for values in self.problem.values]
        return current.cost - math.log(max(sizes)) - math.log(min(sizes))

    def propose(self, fit: ModalFit, excluded: Sequence[float]) -> list[Candidate]:
        """Return the best of the highest peaks of the residuals' periodogram, each with every damping."""
        power = np.zeros(len(self.omegas))
        for block in sorted(set(self.problem.block_of)):
            own = [j for j, other in enumerate(self.problem.block_of) if other == block]
            elapsed = self.signals[own[0]].times_s - self.signals[own[0]].times_s[0]
            residuals = np.stack([fit.residuals[j] for j in own], axis=1)
            residuals = residuals / np.maximum(np.linalg.norm(residuals, axis=0), 1e-300)
            # The frequencies are evenly spaced: those of every block are the first ones, shifted.
            turned = np.exp(-1j * (self.omegas[:256, None] - self.omegas[0]) * elapsed)
            for first in range(0, len(self.omegas), 256):
                shifted = np.exp(-1j * self.omegas[first] * elapsed)[:, None] * residuals
                found = turned[: len(self.omegas) - first] @ shifted
                power[first : first + 256] += np.sum(np.square(np.abs(found)), axis=1)
        padded = np.concatenate([[0.0], power, [0.0]])
        peaks = np.flatnonzero((power >= padded[:-2]) & (power >= padded[2:]))
        peaks = peaks[np.argsort(-power[peaks])][:_PEAKS]
        grid, damping = np.meshgrid(self.omegas[peaks], np.array(_DAMPING), indexing="ij")
        return rivals(self.problem, fit, [(grid.ravel(), damping.ravel())], excluded)

    def looks_behind_noise(self) -> bool:
        """Return whether slow noise makes up most of what the modes so far leave."""
        return not self.is_curved and SlowNoiseWeights.of(self.plain, self.chosen).is_loud

    def reweigh(self) -> None:
        """Look at rows in which slow noise is white, once the search is behind it."""
        if self.is_behind_noise:
            self.weighed_by = SLOW_NOISE
            weights = SlowNoiseWeights.of(self.plain, unturned(self.problem, self.chosen))
            self.problem = weights.turned(self.plain)
            self._refit()

    def weighed(self, fit: ModalFit) -> Weighed[StackedRegression]:
        """Return the fit, weighed by the colour of the noise, each mode at the outputs where it shows.

        Notes
        -----
        Amplitudes of a mode that does not ring at an output follow the noise there, and poles follow them: with many
        such outputs they scatter more than their information says.
        """
        fit, self.problem = unturned(self.problem, fit), self.plain
        limits = 2.0 * np.log([len(values) for values in self.plain.values])
        absent = _explained(fit) < limits[:, None]
        absent[:, np.all(absent, axis=0)] = False
        problem = self.plain.without(absent) if np.any(absent) else self.plain
        if np.any(absent):
            fit = fit_modes(problem, fit.omegas, fit.zetas, fit.clock, Prior(), Prior())
        last = WeightedFit([], problem, fit, self.latency, self.clock_rate)
        return Weighed(last.result(), problem, problem)

    def result(self, n_modes: int | None, max_modes: int) -> FreeDecay:
        """Search, and return what was found."""
        weighed = self.run(n_modes, max_modes)
        fit = weighed.fit
        bent = fit_modes(self._problem(_BENT), fit.omegas, fit.zetas, fit.clock, Prior(), Prior(), SHORT)
        self.is_bent = self._bic(bent) < self._bic(fit)
        n, signals, n_fixed = len(fit.omegas), self.signals, 1 + self.degree
        sd = np.sqrt(np.maximum(np.diag(fit.pole_covariance), 0.0))
        multiples = harmonics_of(fit, float(self.omegas[-1])) if n_modes is None else {}
        modes = [k for k in range(n) if k not in multiples]
        pairs = np.array([*modes, *(n + k for k in modes)])
        sizes = np.array(self.sizes)
        harmonics = tuple(
            replace(
                own,
                makers=tuple(modes.index(k) for k in own.makers),
                amplitudes=tuple((sizes * own.amplitudes).tolist()),
            )
            for _, own in sorted(multiples.items())
        )
        residuals = tuple(size * e for size, e in zip(self.sizes, fit.residuals, strict=True))
        measured = tuple(s.values for s in signals)
        whiteness = tuple(Whiteness.of(e) for e in residuals)
        coefficients = np.array(fit.coefficients)
        swings = coefficients[:, n_fixed::2] + 1j * coefficients[:, n_fixed + 1 :: 2]
        warnings = mode_warnings(fit, weighed.problem, self.band)
        for own, y, e in zip(signals, measured, residuals, strict=True):
            warnings += misfit_warnings([(own.name, [(own.times_s, y - e, e)])])
        warnings += colour_warning([s.name for s in signals], whiteness, measured, residuals)
        warnings += harmonic_sentences(harmonics)
        warnings += clipped_warnings(signals)
        warnings += damage_warnings(signals)
        return FreeDecay(
            natural_frequencies=fit.omegas[modes],
            natural_frequency_sd=sd[:n][modes],
            damping_ratios=fit.zetas[modes],
            damping_ratio_sd=sd[n:][modes],
            covariance=fit.pole_covariance[np.ix_(pairs, pairs)],
            amplitudes=sizes[:, None] * swings[:, modes],
            offsets=sizes * coefficients[:, 0],
            start_s=self.start,
            output_names=tuple(s.name for s in signals),
            times_s=tuple(s.times_s for s in signals),
            measured=measured,
            modelled=tuple(y - e for y, e in zip(measured, residuals, strict=True)),
            residuals=residuals,
            noise_sd=fit.sigmas * sizes,
            scores=tuple(Scores.of(y, e) for y, e in zip(measured, residuals, strict=True)),
            whiteness=whiteness,
            orders=self.orders,
            converged=fit.converged,
            reason=fit.reason,
            iterations=fit.iterations,
            warnings=tuple(warnings),
            harmonics=harmonics,
        )


def _explained(fit: ModalFit) -> FloatArray:
    """Return what leaving a mode out at an output would cost: chi-squared (Wald), shape (n_outputs, n_modes)."""
    result = np.zeros((len(fit.coefficients), len(fit.omegas)))
    place = fit.n_theta
    for output, (found, columns) in enumerate(zip(fit.coefficients, fit.mode_columns, strict=True)):
        for mode, own in enumerate(columns):
            spread = fit.covariance[np.ix_(place + own, place + own)]
            result[output, mode] = found[own] @ np.linalg.lstsq(spread, found[own], rcond=1e-12)[0]
        place += len(found)
    return result
