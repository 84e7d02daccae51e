"""The fit of one weakly nonlinear mode to driven records, several levels at once.

The linear model says what drives the mode. Its own motion x has amplitude and phase
a = x - i (x' + zeta omega x)/omega_d, and between instants h apart a_(k+1) = exp(lambda h) a_k + u_k, which gives u.
The same drive moves

    x'' + 2 zeta omega x' + omega^2 x + n(x, x') = drive,    n = d(omega^2) x + 2 d_g x' + kappa x^3
                                                                 + beta |x'| x' + mu sign(x')

by a' = lambda a + i n/omega_d + u, integrated as it is, without averaging, at 24 instants a cycle. The outputs are
x beside the linear columns of the other modes, gains, offsets and free motions, which are projected out (Golub and
Pereyra 1973). kappa, beta and mu are stated as the coefficients of ``slow_flow``, which have the units of rates.

Noise on a measured input rings in the mode. The estimates are least squares all the same, and their covariance has
what it adds: with J the derivatives of the residuals e = r + H nu by the parameters,

    cov = (J^T J)^-1 (J^T J + q J^T H H^T J) (J^T J)^-1.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import optimize

from beam_ident.amplitude.decay_fit import LINEAR, DecayFit, Law, Start, spread_of
from beam_ident.amplitude.measured_input import disturbances_of, noisy_band_hz
from beam_ident.arrays import ComplexArray, FloatArray
from beam_ident.data.records import OutputSignal, TimeRecord, busiest_stretch
from beam_ident.errors import EstimationError
from beam_ident.modal.model import ModalModel
from beam_ident.modal.regression import ClockState, ModalRegression
from beam_ident.modal.structure import ModalStructure
from beam_ident.noise.input_noise import Smoothing

LAW = Law(2, 3)
_MOST_SAMPLES = 30_000
_MOST_INSTANTS = 200_000  # of a record
_INSTANTS = 24.0  # of a cycle
_ITERATIONS = 30
_ROUNDS = 4
_STILL_CLOCK = 1e-7  # of the records' length
_FEW_LEVELS = 1.3
"""What the amplitude beyond which a quarter of the motion's energy lies is over that below which a twentieth does."""
_REST = 1e-3  # of the largest velocity: below it dry friction is taken to be proportional


@dataclass(frozen=True, eq=False)
class _Drive:
    """What the linear model knows of the mode in one record, for a residue of 1.

    Attributes
    ----------
    times : ndarray, shape (n_instants,) -- evenly spaced [s]
    motion : ndarray of complex, shape (n_instants,) -- a
    """

    times: FloatArray
    motion: ComplexArray


@dataclass(frozen=True, eq=False)
class _Seen:
    """One output: what is known of it, and the mode's linear motion there for a residue of 1.

    Attributes
    ----------
    values : ndarray, shape (n_rows,) -- less what the other columns explain
    known : ndarray, shape (n_rows, n_known) -- an orthonormal basis of these columns
    share : float -- the linear model's residue
    column, column_speed : ndarray, shape (n_rows,) -- and its derivative by the instant
    other_speed : ndarray, shape (n_rows,) -- of what the other columns explain
    by_clock : ndarray, shape (n_rows, 1 or 2) -- derivatives of the instants by latency and, where free, clock rate
    instants : ndarray, shape (n_rows,) -- on the input's clock [s]
    segments : list of (record, slice)
    factor : float -- of a swing at the mode's frequency that an exposure leaves
    """

    values: FloatArray
    known: FloatArray
    share: float
    column: FloatArray
    column_speed: FloatArray
    other_speed: FloatArray
    by_clock: FloatArray
    instants: FloatArray
    segments: list[tuple[int, slice]]
    factor: float

    @property
    def n_columns(self) -> int:
        """How many parameters of its own the output has."""
        return int(self.known.shape[1] + self.by_clock.shape[1] + 1)


class DrivenProblem:
    """Driven records of one model, and the mode whose law is asked for.

    Parameters
    ----------
    records : sequence of TimeRecord
    model : ModalModel -- identified from them
    mode : int -- index from 0
    output : str, optional -- whose amplitude is meant; None: the one that the mode moves most

    Raises
    ------
    EstimationError
        An unknown output or mode, a model of several inputs, or amplitudes that hardly differ.
    """

    def __init__(
        self,
        records: Sequence[TimeRecord],
        model: ModalModel,
        mode: int,
        output: str | None = None,
    ) -> None:
        if not 0 <= mode < model.n_modes:
            raise EstimationError(f"mode is {mode}; expected an index from 0 to {model.n_modes - 1}")
        if model.further_inputs:
            raise EstimationError(
                f"the model has the inputs {', '.join(model.input_names)}; expected one: record each by itself"
            )
        if output is not None and output not in model.output_names:
            raise EstimationError(f"output is {output!r}; expected one of {', '.join(model.output_names)}")
        most = max(_MOST_SAMPLES // max(len(records), 1), 2)
        records = [busiest_stretch(record, most) for record in records]
        self._model, self._mode = model, mode
        omega, zeta = float(model.natural_frequencies[mode]), float(model.damping_ratios[mode])
        self.pole = omega * complex(-zeta, math.sqrt(1.0 - zeta**2))
        self._records = records
        structure = ModalStructure(model.structure)
        regression = ModalRegression(records, structure, model.input_names)
        band_hz = noisy_band_hz(regression, model)
        self._smoothing = None if band_hz is None else Smoothing(band_hz)
        if self._smoothing is not None:
            regression = ModalRegression(records, structure, model.input_names, self._smoothing)
        self._regression = regression
        self._drives = [self._driven(record) for record in records]
        largest = max(float(np.max(np.abs(drive.motion))) for drive in self._drives)
        if not largest > 0.0:
            raise EstimationError(
                f"input {model.input_name!r} moves mode {mode + 1} in no record; expected records under drive. Of "
                "free decays take amplitude_curves()"
            )
        seen = self._seen(model.clock)
        self._shares = [each.share for each in seen]
        names = regression.output_names
        self.reference = int(np.argmax(np.abs(self._shares))) if output is None else names.index(output)
        self._share = self._shares[self.reference]
        self.unit = abs(self._share) * largest
        self.decays = [
            [
                OutputSignal(name, regression.units[j], regression.times[j][rows], regression.values[j][rows])
                for j, name in enumerate(names)
                for record, rows in regression.segments[j]
                if record == k
            ]
            for k in range(len(records))
        ]
        self.n_samples = sum(len(values) for values in regression.values)
        self._lowest = self._lowest_amplitude() / largest

    @property
    def has_noisy_input(self) -> bool:
        """Whether noise on the input rings in the mode; then it is in the covariance of a fit."""
        return self._smoothing is not None

    def _seen(self, clock: ClockState) -> list[_Seen]:
        """Return what is known of every output if its clock stands so."""
        model, regression = self._model, self._regression
        blocks = regression.blocks(model.natural_frequencies, model.damping_ratios, clock, gradients=True)
        result = []
        for j, values in enumerate(regression.values):
            block, at = blocks[regression.block_of[j]], self._column_of(regression)
            assert block.by_time is not None
            found, _, _, _ = np.linalg.lstsq(block.matrix, values, rcond=None)
            fixed, others = np.delete(block.matrix, at, axis=1), np.delete(block.by_time, at, axis=1)
            length = np.linalg.norm(fixed, axis=0)
            U, s, _ = np.linalg.svd(fixed / np.where(length > 0.0, length, 1.0), full_matrices=False)
            known = U[:, s > 1e-10 * s[0]]
            name = regression.output_names[j]
            exposure = next(o.exposure_s for r in self._records for o in r.outputs if o.name == name)
            by_clock = [block.latency_factor] + [block.rate_factor] * (model.clock_rate_sd > 0.0)
            result.append(
                _Seen(
                    values - known @ (known.T @ values),
                    known,
                    float(found[at]),
                    np.array(block.matrix[:, at]),
                    np.array(block.by_time[:, at]),
                    np.asarray(others @ np.delete(found, at)),
                    np.stack(by_clock, axis=1),
                    regression.times[j] - clock.latency + clock.rate * (1.0 + clock.rate) * block.rate_factor,
                    regression.segments[j],
                    float(np.sinc(abs(self.pole) * exposure / (2.0 * math.pi))),
                )
            )
        return result

    def _column_of(self, regression: ModalRegression) -> int:
        """Return which column is the mode's motion under the input."""
        return regression.n_fixed_of_input + self._mode

    def _driven(self, record: TimeRecord) -> _Drive:
        """Return the mode's linear motion at even instants."""
        first = min(float(output.times_s[0]) for output in record.outputs)
        last = max(float(output.times_s[-1]) for output in record.outputs)
        first, last = max(first, record.inputs[0].span_s[0]), min(last, record.inputs[0].span_s[1])
        step = 2.0 * math.pi / (self.pole.imag * _INSTANTS)
        n = int((last - first) / step) + 1
        if n > _MOST_INSTANTS:
            raise EstimationError(
                f"record {record.name!r} holds {n / _INSTANTS:.0f} cycles of mode {self._mode + 1}; a curve over "
                f"amplitude follows each of them, {_MOST_INSTANTS / _INSTANTS:.0f} at most: give a part of it"
            )
        times = np.asarray(first + step * np.arange(n), dtype=np.float64)
        place = OutputSignal("instants", "", times, np.zeros(n))
        regression = ModalRegression(
            [TimeRecord(record.inputs, (place,))],
            self._regression.structure,
            self._model.input_names,
            self._smoothing,
        )
        (block,) = regression.blocks(
            self._model.natural_frequencies, self._model.damping_ratios, ClockState(), True
        )
        assert block.by_time is not None
        at = self._column_of(regression)
        x, speed = block.matrix[:, at], block.by_time[:, at]
        motion = x - 1j * (speed - self.pole.real * x) / self.pole.imag
        return _Drive(regression.times[0], np.asarray(motion))

    def _lowest_amplitude(self) -> float:
        """Return below which amplitude a twentieth of the motion's energy lies, of a residue of 1."""
        size = np.sort(np.concatenate([np.abs(drive.motion) for drive in self._drives]))
        share = np.cumsum(size**2) / np.sum(size**2)
        low, high = (float(size[np.searchsorted(share, place)]) for place in (0.05, 0.75))
        signal = self.decays[0][self.reference]
        if high < _FEW_LEVELS * low:
            raise EstimationError(
                f"the amplitude of {signal.name!r} lies between {abs(self._share) * low:.3g} and "
                f"{abs(self._share) * high:.3g} {signal.unit} nearly all the time; expected records at several "
                "levels, or one whose amplitude varies: add records at half and at a quarter of this level, or let "
                "the structure ring freely"
            )
        return low

    def fit(self, law: Law) -> DecayFit:
        """Return the maximum of the likelihood under a law: ``LAW``, or ``LINEAR``."""
        span = max(float(drive.times[-1] - drive.times[0]) for drive in self._drives)
        scale = max(min(-self.pole.real, 2.0 * math.pi / span), 1e-3 / span)
        clock, seen = self._model.clock, self._seen(self._model.clock)
        # Beside the law: how much more the drive moves the mode than the linear fit says.
        theta = np.zeros(law.n_terms + 1)
        sigmas = self._deviations(seen, self._residuals(theta, scale, law, seen))
        for _ in range(_ROUNDS):
            found = optimize.least_squares(
                lambda x, at=seen, s=sigmas: np.concatenate(
                    [e / sd for e, sd in zip(self._residuals(x, scale, law, at), s, strict=True)]
                ),
                theta,
                method="trf",
                max_nfev=_ITERATIONS,
                ftol=1e-10,
                xtol=1e-8,
                gtol=1e-10,
            )
            theta = found.x
            # The linear model's latency and clock rate err as it does.
            at, clock = clock, self._corrected(theta, scale, law, seen, clock)
            seen = self._seen(clock)
            residuals = self._residuals(theta, scale, law, seen)
            before, sigmas = sigmas, self._deviations(seen, residuals)
            is_still = (
                abs(clock.latency - at.latency) + abs(clock.rate - at.rate) * span < _STILL_CLOCK * span
            )
            if is_still and np.allclose(before, sigmas, rtol=1e-3):
                break
        rows = [np.full(len(e), b / s) for e, b, s in zip(residuals, before, sigmas, strict=True)]
        J = found.jac * np.concatenate(rows)[:, None]
        n = law.n_terms
        w, g = _terms(theta[:n] * scale, law, self.pole)
        sizes = np.array([len(e) for e in residuals])
        # A cubic spring's third harmonic is known with it.
        is_cubic = law.n_frequency > 1
        own = np.eye(n + 1, n)
        own[n, 1] = is_cubic / (12.0 * w[0])
        third = float(w[1] / (12.0 * w[0])) if is_cubic else 0.0
        return DecayFit(
            Start(law, w, g, self.unit, np.array([1.0]), np.zeros(1), np.zeros((0, 2)), third),
            scale * own @ self._spread(J, sigmas)[:n],
            0.5 * self.n_samples + float(sizes @ np.log(sigmas)),
            n + sum(each.n_columns for each in seen),
            self.n_samples,
            tuple(
                tuple(
                    e[rows]
                    for e, each in zip(residuals, seen, strict=True)
                    for record, rows in each.segments
                    if record == k
                )
                for k in range(len(self.decays))
            ),
            tuple(float(sd) for sd in sigmas),
            np.array([self._lowest]),
            bool(found.status > 0),
            int(found.nfev),
        )

    def _spread(self, J: FloatArray, sigmas: FloatArray) -> FloatArray:
        """Return S of the covariance S S^T of least squares, with what noise on the input adds."""
        S = spread_of(J)
        if self._smoothing is None:
            return S
        ends = np.cumsum([0, *(len(values) for values in self._regression.values)])
        added = np.zeros((J.shape[1], J.shape[1]))
        for disturbance, seen in disturbances_of(
            self._regression, self._records, self._model, self._smoothing
        ):
            columns = [
                disturbance.most_likely(
                    seen,
                    [J[a:b, k] / sd for a, b, sd in zip(ends, ends[1:], sigmas, strict=False)],
                )
                for k in range(J.shape[1])
            ]
            # Each is q H^T J on the samples, a period apart: their products over the variance are those of (J^T H) q.
            passed = np.stack(columns, axis=1) / disturbance.drive.sigma
            added += passed.T @ passed
        sizes, axes = np.linalg.eigh(added)
        return np.hstack([S, S @ (S.T @ (axes * np.sqrt(np.maximum(sizes, 0.0))))])

    @staticmethod
    def _deviations(seen: Sequence[_Seen], residuals: Sequence[FloatArray]) -> FloatArray:
        return np.array(
            [
                max(float(np.linalg.norm(e)), 1e-300) / math.sqrt(max(len(e) - each.n_columns, 1))
                for e, each in zip(residuals, seen, strict=True)
            ]
        )

    def _residuals(
        self, theta: FloatArray, scale: float, law: Law, seen: Sequence[_Seen]
    ) -> list[FloatArray]:
        """Return what is left of every output, with what its clock would move projected out."""
        result = []
        for left, by_clock in self._left(theta, scale, law, seen):
            Q, _ = np.linalg.qr(by_clock)
            result.append(left - Q @ (Q.T @ left))
        return result

    def _corrected(
        self, theta: FloatArray, scale: float, law: Law, seen: Sequence[_Seen], clock: ClockState
    ) -> ClockState:
        """Return the clock as the reference output sees it under a law."""
        left, by_clock = self._left(theta, scale, law, seen)[self.reference]
        found, _, _, _ = np.linalg.lstsq(by_clock, left, rcond=None)
        return ClockState(clock.latency + found[0], clock.rate + (found[1] if len(found) > 1 else 0.0))

    def _left(
        self, theta: FloatArray, scale: float, law: Law, seen: Sequence[_Seen]
    ) -> list[tuple[FloatArray, FloatArray]]:
        """Return what is left of every output, and how its clock would move it.

        The reference output shows the amplitude itself; each other one has a share of its own in the mode.
        """
        from scipy.interpolate import CubicSpline  # here: linearity is looked at without it

        w, g = _terms(theta[: law.n_terms] * scale, law, self.pole)
        more = math.exp(min(max(float(theta[-1]), -1.0), 1.0))
        size = abs(self._share) * more / self.unit
        changes = []
        for drive in self._drives:
            change = moved(self.pole, drive.times, size * drive.motion, w, g) / size - drive.motion
            changes.append(CubicSpline(drive.times, change.real))
        result = []
        for j, each in enumerate(seen):
            own, speed = each.column.copy(), each.column_speed.copy()
            for record, rows in each.segments:
                own[rows] += each.factor * changes[record](each.instants[rows])
                speed[rows] += each.factor * changes[record](each.instants[rows], 1)
            share = self._shares[j] * more
            by_clock = (each.other_speed + share * speed)[:, None] * each.by_clock
            both = np.column_stack([own, by_clock])
            both -= each.known @ (each.known.T @ both)
            own, by_clock = both[:, 0], both[:, 1:]
            if j != self.reference:
                Q, _ = np.linalg.qr(both)
                R = Q.T @ both
                share = float(np.linalg.lstsq(R, Q.T @ each.values, rcond=None)[0][0])
            result.append((each.values - share * own, by_clock))
        return result


def moved(
    pole: complex, times: FloatArray, motion: ComplexArray, w: FloatArray, g: FloatArray
) -> ComplexArray:
    """Return how a weakly nonlinear mode moves under what drives its linear motion, shape (n,).

    Parameters
    ----------
    pole : complex -- of the linear motion [rad/s]
    times : ndarray, shape (n,) -- evenly spaced, many a cycle [s]
    motion : ndarray of complex, shape (n,) -- the linear motion a, over the reference amplitude
    w, g : ndarray -- w_0, w_2 and g_-1, g_0, g_1 of ``slow_flow``
    """
    omega, h = abs(pole), float(times[1] - times[0])
    turn = complex(np.exp(pole * h))
    drive = (motion[1:] - turn * motion[:-1]).tolist()
    # n over omega_d, from the averaged coefficients (``slow_flow``); w_0 is the frequency of the ringing.
    stiffness = (float(w[0]) ** 2 + float(g[1]) ** 2 - omega**2) / pole.imag
    cubic = 8.0 * omega * (float(w[1]) if len(w) > 1 else 0.0) / 3.0 / pole.imag
    viscous = 2.0 * (float(g[1]) + pole.real) / pole.imag
    dry = 0.5 * math.pi * omega * float(g[0]) / pole.imag
    quadratic = 0.75 * math.pi * (float(g[2]) if len(g) > 2 else 0.0) / omega / pole.imag
    rest, limit = _REST * omega, 1e3

    def force(a: complex) -> tuple[complex, float]:
        x = min(max(a.real, -limit), limit)
        v = min(max(pole.real * a.real - pole.imag * a.imag, -limit * omega), limit * omega)
        size = abs(v)
        return 1j * (
            stiffness * x + cubic * x * x * x + (viscous + quadratic * size + dry / max(size, rest)) * v
        ), v

    result = np.empty(len(motion), dtype=np.complex128)
    now = complex(motion[0])
    result[0] = now
    here, v = force(now)
    for k, u in enumerate(drive, 1):
        # Heun's step in the frame that turns with the pole.
        ahead, v_ahead = force(turn * (now + h * here) + u)
        now = turn * (now + 0.5 * h * here) + 0.5 * h * ahead + u
        if dry != 0.0 and v * v_ahead < 0.0:
            # Dry friction turns over where the velocity is zero, not half-way through the step.
            before, after = v / max(abs(v), rest), v_ahead / max(abs(v_ahead), rest)
            share = v / (v - v_ahead)
            early, late = cmath.exp(pole * h * (1.0 - 0.5 * share)), cmath.exp(pole * h * 0.5 * (1.0 - share))
            turned = share * early * before + (1.0 - share) * late * after
            now += 1j * dry * h * (turned - 0.5 * (turn * before + after))
        result[k] = now
        here, v = force(now)
    return result


def _terms(theta: FloatArray, law: Law, pole: complex) -> tuple[FloatArray, FloatArray]:
    """Return w and g from their changes against the linear pole."""
    w = theta[: law.n_frequency].copy()
    w[0] += pole.imag
    g = theta[law.n_frequency :].copy()
    if law == LINEAR:
        g = np.array([0.0, g[0]])
    g[1] -= pole.real
    return w, g
