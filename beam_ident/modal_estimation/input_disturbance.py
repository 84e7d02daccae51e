"""What noise on a measured input does to the outputs, as a filter that takes it out again.

White noise ``nu`` on an input passes through the poles like the input itself, so that what
it adds to the outputs is the output of a known linear system driven by white noise.  The
Kalman filter of that system turns the residuals of all outputs into innovations that
are white and independent: a fit to them weighs every stretch by what the input's noise
has left of it.  The same system run backwards gives the most likely true input
(Bryson and Frazier 1963; Kailath, Sayed and Hassibi, Linear Estimation, 2000, ch. 10):

    r = e - H nu,   Sigma = diag(sigma_j^2) + q H H^T,   nu = -q H^T Sigma^-1 r

with q the density of the noise, its variance times the sampling period.

Equation numbers are those of docs/identification.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.integrate import trapezoid
from scipy.linalg import block_diag, expm

from beam_ident.arrays import FloatArray, IndexArray
from beam_ident.data.records import InputSignal
from beam_ident.modal.structure import ModalStructure
from beam_ident.noise.input_noise import Smoothing

_SETTLED = 1e-9  # relative change from step to step below which the filter's gains are kept
_TIME_RESOLUTION_S = 1e-7  # steps between stamps that differ by less share a transition
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
        distinct = np.unique(np.concatenate(times))
        table = np.full((len(distinct), len(times)), -1, dtype=np.intp)
        for output, (instants, places) in enumerate(zip(times, rows, strict=True)):
            table[np.searchsorted(distinct, instants), output] = places
        return Observations(distinct, table)


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
        # What passes at once: a polynomial in s of the direct gain and of the residual term.
        self._direct = np.zeros((3, len(shared)))
        # s^2/d = 1 + (a proper part): the 1 is the sum of the residues, (I.5) with k = 2.
        if power == 2:
            self._direct[0] = gains + sign * np.sum(residues, axis=1)
        self._direct[power] += sign * terms

    def _transitions(self, steps: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return state transition and covariance of the driven state over every step (Van Loan 1978)."""
        size = len(self._dynamics)
        rounded = np.round(steps / _TIME_RESOLUTION_S).astype(np.int64)
        distinct, place = np.unique(rounded, return_inverse=True)
        # The longest step is divided so that the exponential of -A stays small.
        growth = float(np.max(np.abs(np.diag(self._dynamics)), initial=1e-12))
        durations = distinct * _TIME_RESOLUTION_S
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
        return transition[place.ravel()], covariance[place.ravel()]

    def direct_covariance(self) -> FloatArray:
        """Return the covariance of what passes to the outputs at once, shape (n_outputs, n_outputs)."""
        period = float(np.median(np.diff(self.drive.times_s)))
        # What passes without a state ends at the low-pass and is taken for white noise of its covariance,
        # q int |c_0 + c_1 s + c_2 s^2|^2 df over both signs of f, the exposure's box included.
        s = 2j * np.pi * np.linspace(0.0, self.smoothing.cutoff_hz(period), 400)
        passed = sum(np.outer(s**k, self._direct[k]) for k in range(3))
        passed = passed * np.sinc(s.imag[:, None] / (2.0 * np.pi) * self.exposures_s)
        product = np.real(passed[:, :, None] * np.conj(passed[:, None, :]))
        return np.asarray(2.0 * self.density * trapezoid(product, s.imag / (2.0 * np.pi), axis=0))

    def filter(self, observations: Observations, variances: FloatArray) -> DisturbanceFilter:
        """Return the filter that takes the disturbance out of this record's rows.

        Parameters
        ----------
        observations : Observations
        variances : ndarray, shape (n_outputs,) -- of the outputs' own noise
        """
        # Before the input's first sample there is no noise: the filter starts from P = 0.
        first = min(self.drive.times_s[0], observations.times[0] - 1e-3)
        steps = np.diff(observations.times, prepend=first)
        transitions, driven = self._transitions(steps)
        noise = self.direct_covariance() + np.diag(variances)
        return DisturbanceFilter(observations, transitions, driven, self._observation, noise)

    def most_likely(self, observations: Observations, weighted: list[FloatArray]) -> FloatArray:
        """Return what is to be added to the input's samples, shape (n_samples,).

        Parameters
        ----------
        observations : Observations
        weighted : list of ndarray -- ``Sigma^-1 r``, for every output all rows
        """
        times, rows = observations.times, observations.rows
        table = np.zeros(rows.shape)
        for output, values in enumerate(weighted):
            seen = rows[:, output] >= 0
            table[seen, output] = values[rows[seen, output]]
        transitions, _ = self._transitions(np.diff(times, append=times[-1] + 1e-3))
        # H^T of (I.14), of the states first: the adjoint of w' = A w + b nu runs backwards, from instant to
        # instant by F^T and, inside the interval, from the next instant back to each sample of the input.
        carried = table @ self._observation
        adjoint = np.zeros_like(carried)
        adjoint[-1] = carried[-1]
        for k in range(len(times) - 2, -1, -1):
            adjoint[k] = transitions[k].T @ adjoint[k + 1] + carried[k]
        instants = self.drive.times_s
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
        result *= inside
        for order in range(3):
            if np.any(self._direct[order]):
                result += self._spread(times, table * self._direct[order], order)
        # (I.14) with the low-pass in H: noise behind it is wanted, and reaches the outputs through it, so that
        # it acts twice.
        result *= self.drive.sigma**2 * float(np.median(np.diff(instants)))
        drive = self.drive
        once = InputSignal(drive.name, drive.unit, instants, result, drive.hold)
        return self.smoothing.of(self.smoothing.of(once)).values

    def _spread(self, times: FloatArray, table: FloatArray, order: int) -> FloatArray:
        """Return the adjoint of box average and derivative, as a density on the input's samples."""
        instants = self.drive.times_s
        step = np.gradient(instants)
        result = np.zeros(len(instants))
        for point, weight in zip(_BOX_POINTS, 0.5 * _BOX_WEIGHTS, strict=True):
            for output, exposure in enumerate(self.exposures_s):
                places = times + 0.5 * exposure * point
                left = np.clip(np.searchsorted(instants, places, side="right") - 1, 0, len(instants) - 2)
                share = np.clip((places - instants[left]) / (instants[left + 1] - instants[left]), 0.0, 1.0)
                np.add.at(result, left, weight * (1.0 - share) * table[:, output])
                np.add.at(result, left + 1, weight * share * table[:, output])
        result /= step
        for _ in range(order):
            result = -np.gradient(result, instants)
        return result


class DisturbanceFilter:
    """Kalman filter of a disturbance: residuals in, white innovations of unit variance out."""

    def __init__(
        self,
        observations: Observations,
        transitions: FloatArray,
        driven: FloatArray,
        observation: FloatArray,
        noise: FloatArray,
    ) -> None:
        self.observations = observations
        n, size = len(transitions), transitions.shape[1]
        covariance = np.zeros((size, size))
        self._steps = []
        seen = observations.rows >= 0
        is_same = np.zeros(n, dtype=bool)
        is_same[1:] = np.all(seen[1:] == seen[:-1], axis=1)
        is_same[1:] &= np.all(transitions[1:] == transitions[:-1], axis=(1, 2))
        is_settled = False
        for k, transition in enumerate(transitions):
            if not (is_settled and is_same[k]):
                selected = np.flatnonzero(seen[k])
                # One step of (I.16); once the gains have settled on a regular grid they are kept.
                rows, own = observation[selected], noise[np.ix_(selected, selected)]
                before = covariance
                covariance = transition @ covariance @ transition.T + driven[k]
                carried = covariance @ rows.T
                inverse = np.linalg.inv(np.linalg.cholesky(rows @ carried + own))
                scaled = carried @ inverse.T
                covariance = covariance - scaled @ scaled.T
                change = float(np.max(np.abs(covariance - before)))
                is_settled = bool(is_same[k]) and change <= _SETTLED * float(np.max(np.abs(covariance)))
            self._steps.append((transition, rows, inverse, scaled, selected))

    def whiten(self, columns: list[FloatArray]) -> None:
        """Replace this record's rows by innovations, in place.

        Parameters
        ----------
        columns : list of ndarray, shape (n_rows of the output, n_columns)
            The same quantities for every output.
        """
        table = self._gathered(columns)
        state = np.zeros((self._steps[0][0].shape[0], table.shape[2]))
        for k, (transition, rows, inverse, scaled, selected) in enumerate(self._steps):
            state = transition @ state
            # (I.16): v = G^-1 (r - O w).
            white = inverse @ (table[k, selected] - rows @ state)
            state = state + scaled @ white
            table[k, selected] = white
        self._scatter(table, columns)

    def weigh(self, white: list[FloatArray]) -> None:
        """Replace innovations by ``Sigma^-1 r`` in place: the adjoint of ``whiten``."""
        table = self._gathered(white)
        state = np.zeros((self._steps[0][0].shape[0], table.shape[2]))
        for k in range(len(self._steps) - 1, -1, -1):
            transition, rows, inverse, scaled, selected = self._steps[k]
            # (I.17), lambda in ``state``.
            weighed = inverse.T @ (table[k, selected] + scaled.T @ state)
            state = transition.T @ (state - rows.T @ weighed)
            table[k, selected] = weighed
        self._scatter(table, white)

    def _gathered(self, columns: list[FloatArray]) -> FloatArray:
        rows = self.observations.rows
        table = np.zeros((*rows.shape, columns[0].shape[1]))
        for output, values in enumerate(columns):
            seen = rows[:, output] >= 0
            table[seen, output] = values[rows[seen, output]]
        return table

    def _scatter(self, table: FloatArray, columns: list[FloatArray]) -> None:
        rows = self.observations.rows
        for output, values in enumerate(columns):
            seen = rows[:, output] >= 0
            values[rows[seen, output]] = table[seen, output]
