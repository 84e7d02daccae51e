"""What noise on a measured input does to the outputs, as a filter that takes it out again.

White noise ``nu`` on an input passes through the poles like the input itself, so that what
it adds to the outputs is the output of a known linear system driven by white noise.  The
Kalman filter of that system turns the residuals of all outputs into innovations that
are white and independent: a fit to them weighs every stretch by what the input's noise
has left of it.  The same system run backwards gives the most likely true input
(Bryson and Frazier 1963; Kailath, Sayed and Hassibi, Linear Estimation, 2000, ch. 10):

    r = e - H nu,   Sigma = diag(sigma_j^2) + q H H^T,   nu = -q H^T Sigma^-1 r

with q the density of the noise, its variance times the sampling period.

Equation numbers are those of docs/likelihood.md.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag, expm, lapack

from beam_ident.arrays import BoolArray, FloatArray, IndexArray
from beam_ident.data.records import InputSignal, TimeRecord
from beam_ident.modal.model import ModalModel
from beam_ident.modal.regression import ModalRegression
from beam_ident.modal.stacked_regression import StackedRegression
from beam_ident.modal.structure import ModalStructure
from beam_ident.noise.input_noise import Smoothing, input_noise_share, noise_grid
from beam_ident.noise.shared_noise import together
from beam_ident.numerics.state_recursion import StateRecursion
from beam_ident.numerics.trapezoid_rule import trapezoid_rule

NEGLIGIBLE_SHARE = 3e-4  # of an output's noise variance: more from the input widens some interval by 4 %

_SETTLED = 1e-9  # relative change from step to step below which the filter's gains are kept
_TIME_RESOLUTION_S = 1e-7  # steps between stamps that differ by less share a transition
_FINE_SHARE = 1e-4  # of the median step, where samples are as quick as that
_FEW_STEPS = 100  # of one kind in a row: fewer are taken together with those beside them
_AT_ONCE = 4096  # steps of different kinds
_KEPT = 32_768  # instants of a record: of more, what filters each stretch is made anew
_CHUNK = 1 << 18  # samples of an input at once
_ROUNDING = 1e-13  # of the largest eigenvalue of a covariance
_BOX_POINTS, _BOX_WEIGHTS = np.polynomial.legendre.leggauss(5)


@dataclass(frozen=True, eq=False)
class Observations:
    """Which rows of which outputs belong to one record, in order of time.

    Attributes
    ----------
    times : ndarray, shape (n_instants,) -- distinct instants on the input's clock [s]
    rows : ndarray, shape (n_instants, n_outputs)
        Row of each output at each instant, -1 where it was not seen.
    """

    times: FloatArray
    rows: IndexArray

    @staticmethod
    def of(times: Sequence[FloatArray], rows: Sequence[IndexArray]) -> Observations:
        """Merge the instants of all outputs; each has its times and the rows that they stand in."""
        return Observations(*together(times, rows))

    @staticmethod
    def of_record(
        regression: ModalRegression | StackedRegression, record: int, latency: float
    ) -> Observations:
        """Return where the outputs of one record are seen, on its input's clock but for the rate."""
        times: list[FloatArray] = []
        rows: list[IndexArray] = []
        for segments, stamps in zip(regression.segments, regression.times, strict=True):
            places = [np.arange(part.start, part.stop) for own, part in segments if own == record]
            rows.append(np.concatenate(places) if places else np.empty(0, dtype=np.intp))
            times.append(stamps[rows[-1]] - latency)
        return Observations.of(times, rows)

    def table(self, values: Sequence[FloatArray]) -> FloatArray:
        """Return rows of all outputs at every instant, shape (n_instants, n_outputs), zero where none was seen."""
        return _gathered([own[:, None] for own in values], self.rows)[:, :, 0]

    @cached_property
    def _instants(self) -> list[IndexArray]:
        """The instants at which every output was seen."""
        return [np.flatnonzero(own >= 0) for own in self.rows.T]

    def span(self, places: Sequence[slice]) -> slice:
        """Return the instants of a stretch of time, given the rows of every output that were seen in it."""
        first, last = len(self.times), 0
        for output, own in enumerate(places):
            if own.stop > own.start:
                instants = self._instants[output]
                begin = int(self.rows[instants[0], output])
                first = min(first, int(instants[own.start - begin]))
                last = max(last, int(instants[own.stop - 1 - begin]) + 1)
        return slice(first, last)


class InputDisturbance:
    """Noise on the input of one record, seen through a modal model.

    Parameters
    ----------
    drive : InputSignal -- with the ``sigma`` of its noise
    structure : ModalStructure
    omegas, zetas : ndarray, shape (n_modes,) -- [rad/s], [-]
    shared : ndarray, shape (n_outputs, n_shared)
        Gain, residual term and residues of every output, as the structure has them.
    exposures_s : ndarray, shape (n_outputs,)
    smoothing : Smoothing -- low-pass that the input has passed
    """

    def __init__(
        self,
        drive: InputSignal,
        structure: ModalStructure,
        omegas: FloatArray,
        zetas: FloatArray,
        shared: FloatArray,
        exposures_s: FloatArray,
        smoothing: Smoothing,
    ) -> None:
        self.drive, self.structure, self.smoothing = drive, structure, smoothing
        self.exposures_s = exposures_s
        # q of (I.13).
        self.density = drive.sigma**2 * float(np.median(np.diff(drive.times_s)))
        power, sign = structure.differentiations, structure.sign
        gains = shared[:, 0] if structure.has_direct else np.zeros(len(shared))
        residues = shared[:, len(shared[0]) - len(omegas) :]
        terms = shared[:, int(structure.has_direct)] if structure.has_residual else np.zeros(len(shared))
        poles = -zetas * omegas + 1j * omegas * np.sqrt(1.0 - zetas**2)
        half = 0.5 * poles * exposures_s[:, None]
        # (I.5): the output is Im(weight x), x the complex state of the pole under the noise.
        weights = residues * sign * poles**power / poles.imag
        # The mean of e^(p t) over an exposure E is sinh(p E/2) / (p E/2) of its middle. Noise that enters
        # during an exposure is counted by that middle: before it wholly, after it only in what follows.
        weights = weights * np.where(
            np.abs(half) > 1e-6, np.sinh(half) / np.where(half == 0.0, 1.0, half), 1.0
        )
        # States Re x, Im x: the real form of x' = p x + nu.
        blocks = [np.array([[p.real, -p.imag], [p.imag, p.real]]) for p in poles]
        observation = [np.stack([weights.imag, weights.real], axis=2).reshape(len(shared), -1)]
        entry = [1.0, 0.0] * len(poles)
        n_integrators = 2 - power if structure.has_direct else 0
        # c_j alpha from a velocity takes one integration, from an acceleration or a force two.
        if n_integrators:
            blocks.append(np.eye(n_integrators, k=-1))
            column = np.zeros((len(shared), n_integrators))
            column[:, -1] = gains
            observation.append(column)
            entry += [1.0] + [0.0] * (n_integrators - 1)
        self._poles, self._n_integrators = poles, n_integrators
        self._dynamics = block_diag(*blocks)
        self._observation = np.concatenate(observation, axis=1)
        self._entry = np.array(entry)
        self._known_steps: dict[bytes, tuple[FloatArray, FloatArray, IndexArray]] = {}
        # What passes at once: a polynomial in s of the direct gain and of the residual term.
        self._direct = np.zeros((3, len(shared)))
        # s^2/d = 1 + (a proper part): the 1 is the sum of the residues, (I.5) with k = 2.
        if power == 2:
            self._direct[0] = gains + sign * np.sum(residues, axis=1)
        self._direct[power] += sign * terms

    def _transitions(self, steps: FloatArray) -> tuple[FloatArray, FloatArray, IndexArray]:
        """Return transitions and covariances of the driven state (Van Loan 1978), and which goes with each step."""
        resolution = min(_TIME_RESOLUTION_S, _FINE_SHARE * float(np.median(steps)))
        rounded = np.round(steps / resolution).astype(np.int64)
        key = rounded.tobytes()
        if key not in self._known_steps:  # many draws pass through one filter
            self._known_steps[key] = self._driven_states(rounded, resolution)
        return self._known_steps[key]

    def _driven_states(
        self, rounded: IndexArray, resolution: float
    ) -> tuple[FloatArray, FloatArray, IndexArray]:
        size = len(self._dynamics)
        distinct, place = np.unique(rounded, return_inverse=True)
        # The longest step is divided so that the exponential of -A stays small.
        growth = float(np.max(np.abs(np.diag(self._dynamics)), initial=1e-12))
        durations = distinct * resolution
        n_halvings = max(int(np.ceil(np.log2(max(float(np.max(durations)) * growth, 1e-12)))), 0)
        # Van Loan: exp([-A, q b b^T; 0, A^T] h) = [.., F^-1 P_d; 0, F^T] holds F and P_d of (I.16).
        generator = np.zeros((2 * size, 2 * size))
        generator[:size, :size] = -self._dynamics
        generator[:size, size:] = self.density * np.outer(self._entry, self._entry)
        generator[size:, size:] = self._dynamics.T
        exponential = expm(generator * (durations / 2.0**n_halvings)[:, None, None])
        transition = np.swapaxes(exponential[:, size:, size:], 1, 2)
        covariance = transition @ exponential[:, :size, size:]
        for _ in range(n_halvings):
            # Two halves make a whole: P_d(2h) = P_d(h) + F P_d(h) F^T, F(2h) = F(h)^2.
            covariance = covariance + transition @ covariance @ np.swapaxes(transition, 1, 2)
            transition = transition @ transition
        return transition, covariance, place.ravel()

    def direct_covariance(self) -> FloatArray:
        """Return the covariance of what passes to the outputs at once, shape (n_outputs, n_outputs)."""
        period = float(np.median(np.diff(self.drive.times_s)))
        # What passes without a state ends at the low-pass and is taken for white noise of its covariance,
        # q int |c_0 + c_1 s + c_2 s^2|^2 df over both signs of f, the exposure's box included.
        frequencies = np.linspace(0.0, self.smoothing.cutoff_hz(period), 400)
        s = 2j * np.pi * frequencies
        passed = sum(np.outer(s**k, self._direct[k]) for k in range(3))
        passed = passed * np.sinc(frequencies[:, None] * self.exposures_s)
        product = np.real(passed[:, :, None] * np.conj(passed[:, None, :]))
        return np.asarray(2.0 * self.density * trapezoid_rule(product, frequencies))

    def filter(
        self, observations: Observations, variances: FloatArray, scatter: FloatArray | None = None
    ) -> DisturbanceFilter:
        """Return the filter that takes the disturbance out of this record's rows.

        Parameters
        ----------
        observations : Observations
        variances : ndarray, shape (n_outputs,) -- of the outputs' own noise
        scatter : ndarray or None, shape (n_instants, n_outputs)
            Standard deviation of what all outputs of an instant have in common: their speeds times the stamps'
            jitter; None where there is none.
        """
        # Before the input's first sample there is no noise: the filter starts from P = 0.
        first = min(self.drive.times_s[0], observations.times[0] - 1e-3)
        steps = np.diff(observations.times, prepend=first)
        half = self._half_window(float(np.min(steps[1:], initial=math.inf)))
        steps[0] += half
        observed, noise, shared = self._within_window(half)
        return DisturbanceFilter(
            observations, *self._transitions(steps), observed, noise + np.diag(variances), shared, scatter
        )

    @cached_property
    def _window(self) -> float:
        """How long a mean passes as much of the noise as low-pass and exposure do [s]."""
        period = float(np.median(np.diff(self.drive.times_s)))
        frequencies = np.linspace(0.0, self.smoothing.cutoff_hz(period), 400)
        exposure = float(np.median(self.exposures_s))
        return 0.5 / float(trapezoid_rule(np.square(np.sinc(frequencies * exposure)), frequencies))

    def _half_window(self, shortest: float) -> float:
        """Return half a window that ends where the next one begins, 0 where nothing passes at once [s]."""
        return 0.5 * min(self._window, shortest) if np.any(self._direct[0]) else 0.0

    def _within_window(self, half: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return O, the covariance of what passes at once, and that of it with the states, half a window later.

        Parameters
        ----------
        half : float -- of a window [s]

        Notes
        -----
        What passes at once is the mean of the noise over a window around the instant, and the same noise drives the
        states. So the states are taken at the window's end, from where the instant is seen as ``O exp(-A h)`` less
        what has come since: the noise g in the observation, over the window, is known together with the states.
        A window is cut where the next one begins, and what it loses is white.
        """
        passed = self._direct[0] / self._window
        # What a derivative of the noise passes as well, and what a window lost.
        white = self.direct_covariance() - self.density * 2.0 * half * np.outer(passed, passed)
        levels, axes = np.linalg.eigh(white)
        noise = (axes * np.maximum(levels, 0.0)) @ axes.T
        shared = np.zeros((len(self._dynamics), len(passed)))
        for side in (-1.0, 1.0):
            for point, weight in zip(_BOX_POINTS, 0.5 * half * _BOX_WEIGHTS, strict=True):
                since = 0.5 * half * (1.0 + point)  # the instant
                own = passed.copy()
                if side > 0.0:
                    own = own - self._observation @ expm(-self._dynamics * since) @ self._entry
                state = expm(self._dynamics * (half - side * since)) @ self._entry
                noise += self.density * weight * np.outer(own, own)
                shared += self.density * weight * np.outer(state, own)
        return self._observation @ expm(-self._dynamics * half), noise, shared

    def most_likely(self, observations: Observations, weighted: list[FloatArray]) -> FloatArray:
        """Return what is to be added to the input's samples, shape (n_samples,).

        Parameters
        ----------
        observations : Observations
        weighted : list of ndarray -- ``Sigma^-1 r``, for every output all rows
        """
        times = observations.times
        table = observations.table(weighted)
        transitions, _, kinds = self._transitions(np.diff(times, append=times[-1] + 1e-3))
        # H^T of (I.14), of the states first: the adjoint of w' = A w + b nu runs backwards, from instant to
        # instant by F^T and, inside the interval, from the next instant back to each sample of the input.
        adjoint = table @ self._observation
        identity = np.eye(adjoint.shape[1])
        after = np.zeros(adjoint.shape[1])
        for first, last in reversed(_runs(kinds)):
            transition = transitions[kinds[first]].T
            if last - first < _FEW_STEPS:
                for k in range(last - 1, first - 1, -1):
                    after = adjoint[k] = transition @ after + adjoint[k]
                continue
            backwards = StateRecursion(*(own[None] for own in (transition, identity, transition, identity)))
            found, _ = backwards.run(adjoint[first:last][::-1, :, None], after[:, None])
            adjoint[first:last] = found[::-1, :, 0]
            after = adjoint[first]
        instants = self.drive.times_s
        result = np.zeros(len(instants))
        for begin in range(0, len(instants), _CHUNK):
            some = slice(begin, begin + _CHUNK)
            result[some] = self._reached(instants[some], times, adjoint)
        for order in range(3):
            if np.any(self._direct[order]):
                result += self._spread(times, table * self._direct[order], order)
        # (I.14) with the low-pass in H: noise behind it is wanted, and reaches the outputs through it, so that
        # it acts twice.
        result *= self.drive.sigma**2 * float(np.median(np.diff(instants)))
        drive = self.drive
        once = InputSignal(drive.name, drive.unit, instants, result, drive.hold)
        return self.smoothing.of(self.smoothing.of(once)).values

    def _reached(self, instants: FloatArray, times: FloatArray, adjoint: FloatArray) -> FloatArray:
        """Return the adjoint of the states at samples of the input, from that at the stamps."""
        following = np.searchsorted(times, instants, side="left")
        inside = following < len(times)
        following = np.minimum(following, len(times) - 1)
        ahead = np.where(inside, times[following] - instants, 0.0)
        result = np.zeros(len(instants))
        for mode, pole in enumerate(self._poles):
            turned = np.exp(pole * ahead)
            pair = adjoint[following, 2 * mode : 2 * mode + 2]
            result += turned.real * pair[:, 0] + turned.imag * pair[:, 1]
        # The same for the integrators, whose transitions are 1 and h.
        for k in range(self._n_integrators):
            result += ahead**k * adjoint[following, 2 * len(self._poles) + k]
        return np.asarray(result * inside)

    def _spread(self, times: FloatArray, table: FloatArray, order: int) -> FloatArray:
        """Return the adjoint of box average and derivative, as a density on the input's samples."""
        instants, period = self.drive.times_s, self.drive.period_s
        step: FloatArray | float = np.gradient(instants) if period is None else period
        result = np.zeros(len(instants))
        for exposure in np.unique(self.exposures_s):
            values = np.sum(table[:, self.exposures_s == exposure], axis=1)
            for point, weight in zip(_BOX_POINTS, 0.5 * _BOX_WEIGHTS, strict=True):
                places = times + 0.5 * exposure * point
                left = np.clip(np.searchsorted(instants, places, side="right") - 1, 0, len(instants) - 2)
                share = np.clip((places - instants[left]) / (instants[left + 1] - instants[left]), 0.0, 1.0)
                np.add.at(result, left, weight * (1.0 - share) * values)
                np.add.at(result, left + 1, weight * share * values)
        result /= step
        for _ in range(order):
            result = -np.gradient(result, instants if period is None else period)
        return result


def noise_shares(model: ModalModel, drive: InputSignal, smoothing: Smoothing | None = None) -> FloatArray:
    """Return how much of every output's noise the noise on the input makes up, shape (n_outputs,)."""
    if drive.sigma == 0.0:
        return np.zeros(len(model.output_names))
    omegas = noise_grid(model.frequencies_hz, model.damping_ratios, drive, smoothing)
    return input_noise_share(model.frequency_response(omegas).response, omegas, drive, model.noise_sd)


def disturbances_by_record(
    regression: ModalRegression,
    records: Sequence[TimeRecord],
    omegas: FloatArray,
    zetas: FloatArray,
    shared: FloatArray,
    latency: float,
    smoothing: Smoothing,
) -> list[tuple[InputDisturbance, Observations]]:
    """Return the noise of every record's input as modes pass it to the outputs, and where it is seen.

    Parameters
    ----------
    shared : ndarray, shape (n_outputs, n_columns) -- linear parameters that all records share
    """
    result = []
    for index, (record, drive) in enumerate(zip(records, regression.drives, strict=True)):
        exposures = np.array(
            [
                record.output(name).exposure_s if name in record.output_names else 0.0
                for name in regression.output_names
            ]
        )
        disturbance = InputDisturbance(
            drive, regression.structure, omegas, zetas, shared, exposures, smoothing
        )
        result.append((disturbance, Observations.of_record(regression, index, latency)))
    return result


def _runs(kinds: IndexArray) -> list[tuple[int, int]]:
    """Return first and end of every run of equal numbers."""
    borders = np.flatnonzero(np.diff(kinds)) + 1
    return list(itertools.pairwise([0, *borders.tolist(), len(kinds)]))


@dataclass(frozen=True, eq=False)
class _Pattern:
    """Outputs that are seen at once, and what steps of (I.16) make of them."""

    selected: IndexArray
    rows: FloatArray  # of O
    noise: FloatArray  # of what passes at once, and of their own
    shared: FloatArray  # of it with the states
    gains: list[tuple[int, FloatArray, FloatArray]] = field(default_factory=list)  # number, G^-1, P O^T G^-T


class DisturbanceFilter:
    """Kalman filter of a disturbance: residuals in, white innovations of unit variance out."""

    def __init__(
        self,
        observations: Observations,
        transitions: FloatArray,
        driven: FloatArray,
        kinds: IndexArray,
        observation: FloatArray,
        noise: FloatArray,
        shared: FloatArray,
        scatter: FloatArray | None,
    ) -> None:
        self.observations = observations
        self._transitions, self._kinds = transitions, kinds
        n, size = len(kinds), transitions.shape[1]
        covariance = np.zeros((size, size))
        seen = observations.rows >= 0
        is_same = np.zeros(n, dtype=bool)
        is_same[1:] = np.all(seen[1:] == seen[:-1], axis=1) & (kinds[1:] == kinds[:-1])
        if scatter is not None:
            is_same[1:] &= np.all(scatter[1:] == scatter[:-1], axis=1)
        changes = np.flatnonzero(~is_same)
        patterns: dict[bytes, _Pattern] = {}
        # Every step has its gains; once they have settled on a regular grid they are kept.
        n_gains = 0
        self._gain_of = np.empty(n, dtype=np.intp)
        self._known_parts: dict[tuple[int, int], list[tuple[int, int]]] = {}
        self._recursions: dict[tuple[int, int], StateRecursion] = {}
        k = 0
        while k < n:
            # One step of (I.16).
            pattern = seen[k].tobytes()
            if pattern not in patterns:
                selected = np.flatnonzero(seen[k])
                rows = observation[selected]
                both = rows @ shared[:, selected]
                own = noise[np.ix_(selected, selected)] + both + both.T
                patterns[pattern] = _Pattern(selected, rows, own, shared[:, selected])
            now = patterns[pattern]
            rows, own = now.rows, now.noise
            if scatter is not None:
                # An error of the stamp moves what all outputs show by their speeds: R of (I.26).
                own = own + np.outer(scatter[k, now.selected], scatter[k, now.selected])
            before = covariance
            transition = transitions[kinds[k]]
            covariance = transition @ covariance @ transition.T + driven[kinds[k]]
            carried = covariance @ rows.T
            lower, failed = lapack.dpotrf(rows @ carried + own, lower=1)
            if failed:
                # Outputs that show 10^8 times as much of the input's noise as of their own leave the difference
                # of equal numbers.
                covariance = _raised(covariance, 0.0)
                carried = covariance @ rows.T
                lower = lapack.dpotrf(_raised(rows @ carried + own, _ROUNDING), lower=1)[0]
            carried = carried + now.shared
            inverse = lapack.dtrtri(lower, lower=1)[0]
            scaled = carried @ inverse.T
            covariance = covariance - scaled @ scaled.T
            if failed:
                covariance = _raised(covariance, 0.0)
            now.gains.append((n_gains, inverse, scaled))
            self._gain_of[k] = n_gains
            n_gains += 1
            if is_same[k] and abs(covariance - before).max() <= _SETTLED * abs(covariance).max():
                following = np.searchsorted(changes, k, side="right")
                last = int(changes[following]) if following < len(changes) else n
                self._gain_of[k:last] = n_gains - 1
                k = last
            else:
                k += 1
        # O, G^-1 and P O^T G^-T of every gain; zero for outputs that are not seen.
        self._observed = np.zeros((n_gains, *observation.shape))
        self._inverse = np.zeros((n_gains, *noise.shape))
        self._scaled = np.zeros((n_gains, *shared.shape))
        self._logarithms = np.empty(n_gains)
        for one in patterns.values():
            numbers, inverses, scaleds = zip(*one.gains, strict=True)
            places = np.array(numbers)[:, None]
            self._observed[places, one.selected] = one.rows
            self._inverse[places[:, :, None], one.selected[:, None], one.selected] = inverses
            self._scaled[places[:, :, None], np.arange(size)[:, None], one.selected] = scaleds
            self._logarithms[places[:, 0]] = -np.log(np.diagonal(inverses, axis1=1, axis2=2)).sum(axis=1)

    @property
    def log_determinant(self) -> float:
        """Logarithm of the determinant of what ``whiten`` divides by."""
        return float(np.sum(self._logarithms[self._gain_of]))

    def whiten(
        self,
        columns: Sequence[FloatArray],
        places: Sequence[slice] | None = None,
        state: FloatArray | None = None,
    ) -> FloatArray:
        """Replace this record's rows by innovations, in place, and return the state after the last of them.

        Parameters
        ----------
        columns : sequence of ndarray, shape (n_rows of the output, n_columns)
            The same quantities for every output.
        places : sequence of slice or None
            Which rows of every output the columns hold, those of a stretch of time; None for all there are.
        state : ndarray or None, shape (n_states, n_columns) -- after the rows before these
        """
        span, rows = self._stretch(places)
        table = _gathered(columns, rows)
        if state is None:
            state = np.zeros((self._transitions.shape[1], table.shape[2]))
        for first, last in self._parts(span):
            here = slice(first - span.start, last - span.start)
            table[here], state = self._recursion(first, last).run(table[here], state)
        _scatter(table, rows, columns)
        return state

    def weigh(self, white: Sequence[FloatArray]) -> None:
        """Replace innovations by ``Sigma^-1 r`` in place: the adjoint of ``whiten``."""
        span, rows = self._stretch(None)
        table = _gathered(white, rows)
        state = np.zeros((self._transitions.shape[1], table.shape[2]))
        for first, last in reversed(self._parts(span)):
            # (I.17), lambda in ``state``.
            backwards = self._recursion(first, last).adjoint()
            found, state = backwards.run(table[first:last][::-1], state)
            table[first:last] = found[::-1]
        _scatter(table, rows, white)

    def _recursion(self, first: int, last: int) -> StateRecursion:
        """Return (I.16) over some instants, from residuals of all outputs to innovations; of those not seen, nothing.

        Notes
        -----
        With w at the end of a step as its state, O F w is what the next residuals lack.
        """
        known = self._recursions.get((first, last))
        if known is not None:
            return known
        numbers, kinds = self._gain_of[first:last], self._kinds[first:last]
        if np.all(numbers == numbers[0]) and np.all(kinds == kinds[0]):
            numbers, kinds = numbers[:1], kinds[:1]
        inverse, scaled, transitions = self._inverse[numbers], self._scaled[numbers], self._transitions[kinds]
        seen = inverse @ self._observed[numbers] @ transitions
        found = StateRecursion(transitions - scaled @ seen, scaled @ inverse, -seen, inverse)
        if len(self._gain_of) <= _KEPT:
            self._recursions[first, last] = found
        return found

    def _parts(self, span: slice) -> list[tuple[int, int]]:
        """Return first and end of the parts of some instants that are whitened at once: long runs, and others."""
        known = self._known_parts.get((span.start, span.stop))
        if known is not None:
            return known
        parts: list[tuple[int, int]] = []
        is_open = False  # whether steps of another kind may join the last part
        for first, last in _runs(self._gain_of[span]):
            is_short = last - first < _FEW_STEPS
            if is_short and is_open and last + span.start - parts[-1][0] <= _AT_ONCE:
                parts[-1] = parts[-1][0], last + span.start
            else:
                parts.append((first + span.start, last + span.start))
            is_open = is_short
        self._known_parts[span.start, span.stop] = parts
        return parts

    def _stretch(self, places: Sequence[slice] | None) -> tuple[slice, IndexArray]:
        """Return instants, and which of the given rows were seen at them."""
        rows = self.observations.rows
        if places is None:
            return slice(0, len(rows)), rows
        span = self.observations.span(places)
        return span, np.where(rows[span] >= 0, rows[span] - np.array([own.start for own in places]), -1)


def _raised(covariance: FloatArray, least: float) -> FloatArray:
    """Return a covariance that rounding has left indefinite, its eigenvalues raised to a share of the largest."""
    levels, axes = np.linalg.eigh(0.5 * (covariance + covariance.T))
    return np.asarray((axes * np.maximum(levels, least * levels[-1])) @ axes.T)


def _gathered(columns: Sequence[FloatArray], rows: IndexArray) -> FloatArray:
    """Return the rows of all outputs at every instant, zero where none was seen."""
    table = np.zeros((*rows.shape, columns[0].shape[1]))
    for output, values in enumerate(columns):
        seen, taken = _taken(rows[:, output])
        table[seen, output] = values[taken]
    return table


def _scatter(table: FloatArray, rows: IndexArray, columns: Sequence[FloatArray]) -> None:
    """Put rows back where ``_gathered`` took them from."""
    for output, values in enumerate(columns):
        seen, taken = _taken(rows[:, output])
        values[taken] = table[seen, output]


def _taken(rows: IndexArray) -> tuple[BoolArray | slice, IndexArray | slice]:
    """Return at which instants an output was seen, and which rows of it; slices where none is missing."""
    n = len(rows)
    if n and rows[0] >= 0 and rows[-1] - rows[0] == n - 1 and np.min(rows) >= 0:
        return slice(0, n), slice(int(rows[0]), int(rows[0]) + n)
    seen = rows >= 0
    return seen, rows[seen]
