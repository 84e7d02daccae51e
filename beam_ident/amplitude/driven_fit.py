"""The fit of one weakly nonlinear mode to driven records, several levels at once.

The linear model says what drives the mode. Its own motion x has amplitude and phase
a = x - i (x' + zeta omega x)/omega_d, and between instants h apart a_(k+1) = exp(lambda h) a_k + u_k, which gives u.
The same drive moves

    x'' + 2 zeta omega x' + omega^2 x + n(x, x') = drive,    n = 2 d_omega omega x + 2 d_g x' + kappa x^3
                                                                 + beta |x'| x' + mu sign(x')

by a' = lambda a + i n/omega_d + u, integrated as it is, without averaging, at 24 instants a cycle. The outputs are
x beside the linear columns of the other modes, gains, offsets and free motions, which are projected out (Golub and
Pereyra 1973). kappa, beta and mu are stated as the coefficients of ``slow_flow``, which have the units of rates.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import optimize
from scipy.interpolate import CubicSpline

from beam_ident.amplitude.decay_fit import LINEAR, DecayFit, Law, Start
from beam_ident.arrays import ComplexArray, FloatArray
from beam_ident.data.records import OutputSignal, TimeRecord, busiest_stretch
from beam_ident.errors import EstimationError
from beam_ident.modal.model import ModalModel
from beam_ident.modal.regression import ClockState, ModalRegression
from beam_ident.modal.structure import ModalStructure

LAW = Law(2, 3)
_MOST_SAMPLES = 30_000
_MOST_INSTANTS = 200_000  # of a record
_INSTANTS = 24.0  # of a cycle
_ITERATIONS = 30
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
    column : ndarray, shape (n_rows,)
    times : ndarray, shape (n_rows,)
    segments : list of (record, slice)
    factor : float -- of a swing at the mode's frequency that an exposure leaves
    """

    values: FloatArray
    known: FloatArray
    column: FloatArray
    times: FloatArray
    segments: list[tuple[int, slice]]
    factor: float


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
        self, records: Sequence[TimeRecord], model: ModalModel, mode: int, output: str | None = None
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
        regression = ModalRegression(records, ModalStructure(model.structure), model.input_names)
        blocks = regression.blocks(
            model.natural_frequencies, model.damping_ratios, model.clock, gradients=True
        )
        self._seen: list[_Seen] = []
        shares = []
        for j, values in enumerate(regression.values):
            block, at = blocks[regression.block_of[j]], self._column_of(regression)
            matrix = block.matrix
            assert block.by_time is not None
            found, _, _, _ = np.linalg.lstsq(matrix, values, rcond=None)
            shares.append(float(found[at]))
            # The latency was found with the linear model, and errs as that does: the speed is projected out, too.
            fixed = np.column_stack([np.delete(matrix, at, axis=1), block.by_time @ found])
            length = np.linalg.norm(fixed, axis=0)
            U, s, _ = np.linalg.svd(fixed / np.where(length > 0.0, length, 1.0), full_matrices=False)
            known = U[:, s > 1e-10 * s[0]]
            name = regression.output_names[j]
            exposure = next(o.exposure_s for r in records for o in r.outputs if o.name == name)
            self._seen.append(
                _Seen(
                    values - known @ (known.T @ values),
                    known,
                    np.array(matrix[:, at]),
                    regression.times[j] - model.latency,
                    regression.segments[j],
                    float(np.sinc(omega * exposure / (2.0 * math.pi))),
                )
            )
        names = regression.output_names
        self.reference = int(np.argmax(np.abs(shares))) if output is None else names.index(output)
        self._share = shares[self.reference]
        self._drives = [self._driven(record) for record in records]
        largest = max(float(np.max(np.abs(drive.motion))) for drive in self._drives)
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
            ModalStructure(self._model.structure),
            self._model.input_names,
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
        sigmas = np.ones(len(self._seen))
        # Beside the law: how much more the drive moves the mode than the linear fit says.
        theta = np.zeros(law.n_terms + 1)
        for _ in range(3):
            found = optimize.least_squares(
                lambda x, s=sigmas: np.concatenate(
                    [e / sd for e, sd in zip(self._residuals(x, scale, law), s, strict=True)]
                ),
                theta,
                method="trf",
                max_nfev=_ITERATIONS,
                ftol=1e-10,
                xtol=1e-8,
                gtol=1e-10,
            )
            theta = found.x
            residuals = self._residuals(theta, scale, law)
            before, sigmas = sigmas, self._deviations(residuals)
            if np.allclose(before, sigmas, rtol=1e-3):
                break
        rows = [np.full(len(e), b / s) for e, b, s in zip(residuals, before, sigmas, strict=True)]
        J = found.jac * np.concatenate(rows)[:, None]
        n = law.n_terms
        w, g = _terms(theta[:n] * scale, law, self.pole)
        sizes = np.array([len(e) for e in residuals])
        return DecayFit(
            Start(law, w, g, self.unit, np.array([1.0]), np.zeros(1), np.zeros((0, 2))),
            np.asarray(np.linalg.pinv(J.T @ J, rcond=1e-14, hermitian=True))[:n, :n] * scale**2,
            0.5 * self.n_samples + float(sizes @ np.log(sigmas)),
            n + sum(seen.known.shape[1] + 1 for seen in self._seen),
            self.n_samples,
            tuple(
                tuple(
                    e[rows]
                    for e, seen in zip(residuals, self._seen, strict=True)
                    for record, rows in seen.segments
                    if record == k
                )
                for k in range(len(self.decays))
            ),
            tuple(float(sd) for sd in sigmas),
            np.array([self._lowest]),
            bool(found.status > 0),
            int(found.nfev),
        )

    def _deviations(self, residuals: Sequence[FloatArray]) -> FloatArray:
        free = [
            max(len(e) - seen.known.shape[1] - 1, 1) for e, seen in zip(residuals, self._seen, strict=True)
        ]
        return np.array(
            [
                max(float(np.linalg.norm(e)), 1e-300) / math.sqrt(n)
                for e, n in zip(residuals, free, strict=True)
            ]
        )

    def _residuals(self, theta: FloatArray, scale: float, law: Law) -> list[FloatArray]:
        """Return what is left of every output.

        The reference output shows the amplitude itself; each other one has a share of its own in the mode.
        """
        w, g = _terms(theta[: law.n_terms] * scale, law, self.pole)
        share = self._share * math.exp(min(max(float(theta[-1]), -1.0), 1.0))
        size = abs(share) / self.unit
        changes = []
        for drive in self._drives:
            change = moved(self.pole, drive.times, size * drive.motion, w, g) / size - drive.motion
            changes.append(CubicSpline(drive.times, change.real))
        result = []
        for j, seen in enumerate(self._seen):
            own = seen.column.copy()
            for record, rows in seen.segments:
                own[rows] += seen.factor * changes[record](seen.times[rows])
            own -= seen.known @ (seen.known.T @ own)
            of_own = (
                share if j == self.reference else float(own @ seen.values) / max(float(own @ own), 1e-300)
            )
            result.append(seen.values - of_own * own)
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
    # n over omega_d, from the averaged coefficients (``slow_flow``).
    stiffness = 2.0 * omega * (float(w[0]) - pole.imag) / pole.imag
    cubic = 8.0 * omega * (float(w[1]) if len(w) > 1 else 0.0) / 3.0 / pole.imag
    viscous = 2.0 * (float(g[1]) + pole.real) / pole.imag
    dry = 0.5 * math.pi * omega * float(g[0]) / pole.imag
    quadratic = 0.75 * math.pi * (float(g[2]) if len(g) > 2 else 0.0) / omega / pole.imag
    rest, limit = _REST * omega, 1e3

    def force(a: complex) -> complex:
        x = min(max(a.real, -limit), limit)
        v = min(max(pole.real * a.real - pole.imag * a.imag, -limit * omega), limit * omega)
        size = abs(v)
        return 1j * (
            stiffness * x + cubic * x * x * x + (viscous + quadratic * size + dry / max(size, rest)) * v
        )

    result = np.empty(len(motion), dtype=np.complex128)
    now = complex(motion[0])
    result[0] = now
    for k, u in enumerate(drive, 1):
        here = force(now)
        # Heun's step in the frame that turns with the pole.
        ahead = turn * (now + h * here) + u
        now = turn * (now + 0.5 * h * here) + 0.5 * h * force(ahead) + u
        result[k] = now
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
