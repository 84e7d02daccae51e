"""The fit of one weakly nonlinear mode to free decays, all of them at once.

Amplitude and phase follow ``slow_flow``; the samples are

    y_j(t) = Re[c_j A(t) e^(j phi(t))] + second and third harmonic + other modes + offset + drift

with c = 1 at the reference output, in whose unit the amplitude is; the part h A^3 cos(3 phi) of its third harmonic,
which raises its maxima, is estimated with the law. What else enters linearly is projected out (Golub and Pereyra
1973), so that the iteration moves frequencies, rates, h, and each decay's first amplitude and phase alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy import optimize

from beam_ident.amplitude.slow_flow import SlowFlow, slow_flow
from beam_ident.arrays import ComplexArray, FloatArray
from beam_ident.data.records import OutputSignal
from beam_ident.errors import EstimationError

_WINDOW_CYCLES = 4.0
_FEW_WINDOWS = 6
_WINDOW_SAMPLES = 8
_SEEN = 5.0  # standard deviations of a window's amplitude
_ITERATIONS = 60
_MOST_GROWTH = 50.0  # exponent of what a trial step may let grow
_N_COLUMNS = 8
"""Of every output: offset, drift, third harmonic but for its share in the maxima, second harmonic and shift."""


@dataclass(frozen=True)
class Law:
    """Which terms of frequency and decay rate are estimated.

    Attributes
    ----------
    n_frequency : int -- w_0, w_2, ..
    n_rate : int -- g_-1, g_0, g_1, ..
    """

    n_frequency: int = 2
    n_rate: int = 3

    @property
    def n_terms(self) -> int:
        """Terms of both."""
        return self.n_frequency + self.n_rate


_FIRST = Law()
LINEAR = Law(1, 1)
"""One pole: w_0 and g_0 alone."""


@dataclass(frozen=True, eq=False)
class Start:
    """Where the iteration begins.

    Attributes
    ----------
    law : Law
    omega_terms, rate_terms : ndarray -- coefficients over amplitude in units of ``reference``
    reference : float -- the unit of amplitude [unit of the reference output]
    amplitudes, phases : ndarray, shape (n_decays,) -- at each decay's first sample
    others : ndarray, shape (n_others, 2) -- frequencies [rad/s] and damping ratios of further modes
    third : float -- h of the third harmonic h A^3 cos(3 phi) of the reference output
    """

    law: Law
    omega_terms: FloatArray
    rate_terms: FloatArray
    reference: float
    amplitudes: FloatArray
    phases: FloatArray
    others: FloatArray
    third: float = 0.0

    def extended(self, law: Law) -> Start:
        """Return a start of a richer law, its new terms zero."""
        w, g = np.zeros(law.n_frequency), np.zeros(law.n_rate)
        w[: len(self.omega_terms)], g[: len(self.rate_terms)] = self.omega_terms, self.rate_terms
        return replace(self, law=law, omega_terms=w, rate_terms=g)


@dataclass(frozen=True, eq=False)
class DecayFit:
    """A fit of the law to all decays.

    Attributes
    ----------
    point : Start -- the estimates
    spread : ndarray, shape (n_terms + 1, n) -- S of the covariance S S^T of both groups of terms and h, for white
        noise; of terms that are hardly told apart it keeps twice as many digits
    cost : float -- half of the squared residuals over their variance, and the logarithms of that
    n_parameters, n_samples : int
    residuals : tuple of tuple of ndarray -- of every output of every decay
    noise_sd : tuple of float -- of every output
    last_amplitudes : ndarray, shape (n_decays,) -- at the ends, in units of the reference
    converged : bool
    iterations : int
    """

    point: Start
    spread: FloatArray
    cost: float
    n_parameters: int
    n_samples: int
    residuals: tuple[tuple[FloatArray, ...], ...]
    noise_sd: tuple[float, ...]
    last_amplitudes: FloatArray
    converged: bool
    iterations: int

    @property
    def covariance(self) -> FloatArray:
        """Of both groups of terms and h, shape (n_terms + 1, n_terms + 1)."""
        return np.asarray(self.spread @ self.spread.T)

    @property
    def criterion(self) -> float:
        """Bayesian information criterion."""
        return 2.0 * self.cost + self.n_parameters * math.log(self.n_samples)


class DecayProblem:
    """Free decays and what is asked of them.

    Parameters
    ----------
    decays : sequence of sequences of OutputSignal
        For every decay the same outputs, without missing values.
    reference : int -- index of the output whose amplitude is meant
    """

    def __init__(self, decays: Sequence[Sequence[OutputSignal]], reference: int) -> None:
        self.decays, self.reference = decays, reference
        self.starts = [min(float(s.times_s[0]) for s in decay) for decay in decays]
        self.n_outputs = len(decays[0])
        self.n_samples = sum(len(s.values) for decay in decays for s in decay)

    # Where to begin -------------------------------------------------------------------------------------

    def start(self, frequency_hz: float | None, law: Law = _FIRST) -> Start:
        """Return a start of a law, the first or one pole, from the amplitudes and phases of short windows.

        Raises
        ------
        EstimationError
            No decay holds enough cycles of anything that rings.
        """
        signals = [decay[self.reference] for decay in self.decays]
        omega = _highest_peak(signals) if frequency_hz is None else 2.0 * math.pi * frequency_hz
        turns = [_windows(signal, omega, begin) for signal, begin in zip(signals, self.starts, strict=True)]
        if not any(len(turn.times) >= _FEW_WINDOWS for turn in turns):
            longest = max(float(np.ptp(signal.times_s)) for signal in signals) * omega / (2.0 * math.pi)
            remedy = "record a longer decay, or one with a larger amplitude"
            if frequency_hz is not None:
                remedy += "; leave frequency_hz out if the mode is elsewhere"
            elif longest < _FEW_WINDOWS:
                remedy += (
                    "; where the structure also moves slower than the mode, name the mode with frequency_hz"
                )
            if any(turn.returns for turn in turns):
                remedy = (
                    "the swings begin late, or vanish and return. Where the structure was still moved, or struck, "
                    "give the stretch after it; where two modes beat, take an output where one of them does not "
                    "show, or release the structure so that one is larger"
                )
            raise EstimationError(
                f"output {signals[0].name!r} holds {longest:.0f} cycles at {omega / (2.0 * math.pi):.4g} Hz, of "
                f"which {max(len(turn.times) for turn in turns)} windows stand out of the noise; a curve over "
                f"amplitude needs {_FEW_WINDOWS} at least: {remedy}"
            )
        unit = max(float(turn.amplitudes.max()) for turn in turns if len(turn.times))
        w, g = _regressed(turns, omega, unit, law)
        first = np.array([turn.amplitudes[0] / unit if len(turn.times) else 1e-3 for turn in turns])
        phases = np.zeros(len(turns))
        for k, turn in enumerate(turns):
            if len(turn.times):
                middle = float(turn.times[0])
                first[k] += middle * float(np.polynomial.polynomial.polyval(first[k], g))
                turned = middle * float(np.polynomial.polynomial.polyval(first[k] ** 2, w))
                phases[k] = float(turn.phases[0]) - turned
        return Start(law, w, g, unit, first, phases, np.zeros((0, 2)))

    # The fit ----------------------------------------------------------------------------------------------

    def fit(self, start: Start) -> DecayFit:
        """Return the maximum of the likelihood next to a start."""
        theta, sigmas = _packed(start), np.ones(self.n_outputs)
        scale = self._scale(start)
        for _ in range(3):  # the noise of each output follows from its residuals
            # From zero the first step turns or lowers the decays by no more than 1, however little tells terms apart.
            found = optimize.least_squares(
                lambda x, at=theta, s=sigmas: np.concatenate(
                    self._whitened(_unpacked(at + x * scale, start), s)
                ),
                np.zeros(len(theta)),
                jac=lambda x, at=theta, s=sigmas: self._jacobian(_unpacked(at + x * scale, start), s) * scale,
                method="trf",
                max_nfev=_ITERATIONS,
                ftol=1e-8,  # of a cost of half the number of samples: invisible beside the noise
                xtol=1e-10,
                gtol=1e-10,
            )
            theta = theta + found.x * scale
            residuals = self._whitened(_unpacked(theta, start), np.ones(self.n_outputs))
            before, sigmas = sigmas, self._deviations(residuals, start)
            if np.allclose(before, sigmas, rtol=1e-3):
                break
        point = _unpacked(theta, start)
        J = found.jac * np.repeat(np.tile(before / sigmas, len(self.decays)), self._sizes())[:, None] / scale
        grouped = iter(residuals)
        sizes = np.array(self._sizes())
        per_output = sizes.reshape(len(self.decays), self.n_outputs).sum(axis=0)
        return DecayFit(
            point,
            spread_of(J)[: start.law.n_terms + 1],
            0.5 * self.n_samples + float(per_output @ np.log(sigmas)),
            len(theta) + self._n_linear(len(start.others)),
            self.n_samples,
            tuple(tuple(next(grouped) for _ in decay) for decay in self.decays),
            tuple(float(value) for value in sigmas),
            np.array([self._last_amplitude(point, k) for k in range(len(self.decays))]),
            bool(found.status > 0),
            int(found.nfev),
        )

    def _sizes(self) -> list[int]:
        return [len(s.values) for decay in self.decays for s in decay]

    def _n_linear(self, n_others: int) -> int:
        own = _N_COLUMNS + 2 * n_others
        return len(self.decays) * (self.n_outputs * own + 3 * (self.n_outputs - 1))

    def _deviations(self, residuals: list[FloatArray], start: Start) -> FloatArray:
        per_signal = _N_COLUMNS + 2 * len(start.others)
        squares = np.array([float(e @ e) for e in residuals]).reshape(len(self.decays), self.n_outputs)
        counts = np.array(self._sizes()).reshape(squares.shape) - per_signal
        variances = squares.sum(axis=0) / np.maximum(counts.sum(axis=0), 1)
        return np.asarray(np.sqrt(np.maximum(variances, 1e-300)))

    def _scale(self, start: Start) -> FloatArray:
        """Return steps that turn or lower the decays by about as much."""
        span = max(
            float(s.times_s[-1]) - begin for d, begin in zip(self.decays, self.starts, strict=True) for s in d
        )
        scale = np.ones(len(_packed(start)))
        scale[: start.law.n_terms] = 1.0 / span
        n = start.law.n_terms + 1 + 2 * len(self.decays)
        scale[n::2] = 1.0 / span
        scale[n + 1 :: 2] = 1.0 / (span * np.maximum(np.abs(start.others[:, 0]), 1e-300))
        return scale

    def _last_amplitude(self, point: Start, k: int) -> float:
        """Return the amplitude at the end of a decay."""
        end = np.array([max(float(s.times_s[-1]) for s in self.decays[k]) - self.starts[k]])
        return float(
            slow_flow(point.omega_terms, point.rate_terms, float(point.amplitudes[k]), end).amplitude[0]
        )

    def flows(self, point: Start, k: int, *, slopes: bool = False) -> list[SlowFlow]:
        """Return amplitude and phase at the stamps of every output of a decay."""
        known: dict[bytes, SlowFlow] = {}
        for signal in self.decays[k]:
            key = signal.times_s.tobytes()
            if key not in known:
                elapsed = signal.times_s - self.starts[k]
                known[key] = slow_flow(
                    point.omega_terms, point.rate_terms, float(point.amplitudes[k]), elapsed, slopes=slopes
                )
        return [known[signal.times_s.tobytes()] for signal in self.decays[k]]

    def _columns(self, point: Start, k: int, j: int, flow: SlowFlow) -> FloatArray:
        """Return what enters one output linearly, shape (n, n_columns); swings of the mode first, if they do."""
        signal = self.decays[k][j]
        t = signal.times_s - self.starts[k]
        A, phi = flow.amplitude, flow.phase + point.phases[k]
        columns = []
        if j != self.reference:
            columns = [*(self._seen(point, signal) * A * _turning(phi)), A**3 * np.cos(3.0 * phi)]
        columns += [np.ones(len(t)), t - 0.5 * t[-1]]
        # Odd forces that change with the place are even in time, those that change with the speed are odd.
        columns += [A**n * np.sin(3.0 * phi) for n in (2, 3)]
        # What is stiffer to one side shifts the middle of its swings and has a second harmonic.
        columns += [A**2, *(A**2 * _turning(2.0 * phi))]
        for omega, zeta in point.others:
            columns += list(np.exp(np.minimum(-zeta * omega * t, _MOST_GROWTH)) * _turning(omega * t))
        return np.stack(columns, axis=1)

    def _seen(self, point: Start, signal: OutputSignal, harmonic: int = 1) -> float:
        """Return what an exposure leaves of a harmonic's swing of 1, in the output's unit."""
        turned = harmonic * point.omega_terms[0] * signal.exposure_s
        return float(np.sinc(turned / (2.0 * np.pi))) * point.reference

    def _whitened(self, point: Start, sigmas: FloatArray) -> list[FloatArray]:
        """Return what is left of every output of every decay, over its noise."""
        result = []
        for k in range(len(self.decays)):
            for j, flow in enumerate(self.flows(point, k)):
                Q, _ = np.linalg.qr(self._columns(point, k, j, flow))
                values = self._unexplained(point, k, j, flow)
                result.append((values - Q @ (Q.T @ values)) / sigmas[j])
        return result

    def _unexplained(self, point: Start, k: int, j: int, flow: SlowFlow) -> FloatArray:
        """Return an output, the reference one less the mode's swing."""
        signal = self.decays[k][j]
        if j != self.reference:
            return signal.values
        A, phi = flow.amplitude, flow.phase + point.phases[k]
        swing = self._seen(point, signal) * A * np.cos(phi)
        higher = self._seen(point, signal, 3) * point.third * A**3 * np.cos(3.0 * phi)
        return np.asarray(signal.values - swing - higher)

    def _jacobian(self, point: Start, sigmas: FloatArray) -> FloatArray:
        """Return the derivatives of ``_whitened`` by ``_packed``, the projection held (Kaufman 1975)."""
        law, n_decays = point.law, len(self.decays)
        kept = [*range(law.n_frequency), *(law.n_frequency + np.arange(law.n_rate) + (law == LINEAR))]
        rows = []
        for k, decay in enumerate(self.decays):
            for j, (signal, flow) in enumerate(zip(decay, self.flows(point, k, slopes=True), strict=True)):
                t = signal.times_s - self.starts[k]
                columns = self._columns(point, k, j, flow)
                Q, R = np.linalg.qr(columns)
                found, _, _, _ = np.linalg.lstsq(R, Q.T @ self._unexplained(point, k, j, flow), rcond=1e-12)
                own = np.array([1.0, 0.0]) if j == self.reference else found[:2]
                phi = flow.phase + point.phases[k]
                cos, sin = self._seen(point, signal) * _turning(phi)
                # Of c_1 A cos(phi) + c_2 A sin(phi): by A and, over A, by phi.
                by_size, by_turn = own[0] * cos + own[1] * sin, flow.amplitude * (own[1] * cos - own[0] * sin)
                J = np.zeros((len(t), law.n_terms + 1 + 2 * n_decays + point.others.size))
                if j == self.reference:
                    cos3, sin3 = self._seen(point, signal, 3) * flow.amplitude**2 * _turning(3.0 * phi)
                    by_size, by_turn = (
                        by_size + 3.0 * point.third * cos3,
                        by_turn - 3.0 * point.third * flow.amplitude * sin3,
                    )
                    J[:, law.n_terms] = flow.amplitude * cos3
                J[:, : law.n_terms] = (flow.by_amplitude * by_size + flow.by_phase * by_turn)[kept].T
                at = law.n_terms + 1 + 2 * k
                start = float(point.amplitudes[k])
                J[:, at] = start * (flow.by_amplitude[-1] * by_size + flow.by_phase[-1] * by_turn)
                J[:, at + 1] = by_turn
                for m, (omega, zeta) in enumerate(point.others):
                    first = columns.shape[1] - 2 * (len(point.others) - m)
                    (c, s), (a, b) = columns[:, first : first + 2].T, found[first : first + 2]
                    at = law.n_terms + 1 + 2 * (n_decays + m)
                    J[:, at] = t * (b * c - a * s) - zeta * t * (a * c + b * s)
                    J[:, at + 1] = -omega * t * (a * c + b * s)
                rows.append((Q @ (Q.T @ J) - J) / sigmas[j])
        return np.concatenate(rows)


def spread_of(J: FloatArray) -> FloatArray:
    """Return S with S S^T = (J^T J)^-1, shape (n_parameters, n_parameters)."""
    length = np.linalg.norm(J, axis=0)
    length[length == 0.0] = 1.0
    _, sizes, Vt = np.linalg.svd(J / length, full_matrices=False)
    seen = sizes > 1e-13 * sizes[0]
    return np.asarray(Vt[seen].T / sizes[seen] / length[:, None])


def _turning(phi: FloatArray) -> FloatArray:
    """Return cosine and sine, shape (2, n)."""
    return np.stack([np.cos(phi), np.sin(phi)])


def _packed(point: Start) -> FloatArray:
    logs = np.log(np.maximum(point.amplitudes, 1e-12))
    per_decay = np.column_stack([logs, point.phases]).ravel()
    rates = point.rate_terms[1:2] if point.law == LINEAR else point.rate_terms
    return np.concatenate([point.omega_terms, rates, [point.third], per_decay, point.others.ravel()])


def _unpacked(theta: FloatArray, like: Start) -> Start:
    nf, n, m = like.law.n_frequency, like.law.n_terms, len(like.amplitudes)
    rates = theta[nf:n]
    per_decay = theta[n + 1 : n + 1 + 2 * m].reshape(m, 2)
    others = theta[n + 1 + 2 * m :].reshape(-1, 2)
    amplitudes = np.exp(np.clip(per_decay[:, 0], -30.0, 5.0))
    if like.law == LINEAR:
        rates = np.array([0.0, rates[0]])
    third = float(theta[n])
    return Start(like.law, theta[:nf], rates, like.reference, amplitudes, per_decay[:, 1], others, third)


@dataclass(frozen=True, eq=False)
class _Windows:
    times: FloatArray
    amplitudes: FloatArray
    phases: FloatArray
    returns: bool  # whether further windows stand out of the noise after one that does not


def _highest_peak(signals: Sequence[OutputSignal]) -> float:
    """Return where the decays have the most energy [rad/s]."""
    best, place = 0.0, math.nan
    for signal in signals:
        t, y = signal.times_s, signal.values
        n = len(t)
        even = np.interp(np.linspace(t[0], t[-1], n), t, y)
        even = even - np.polynomial.Polynomial.fit(np.arange(n), even, 1)(np.arange(n))
        power = np.abs(np.fft.rfft(even * np.hanning(n), 4 * n)) ** 2
        power[:8] = 0.0  # one cycle and less is drift
        k = int(np.argmax(power))
        if power[k] > best:
            best, place = float(power[k]), 2.0 * math.pi * k * (n - 1) / (4.0 * n * float(t[-1] - t[0]))
    if not best > 0.0:
        raise EstimationError(
            "nothing rings in these outputs; give the stretch in which the structure swings freely"
        )
    return place


def _windows(signal: OutputSignal, omega: float, begin: float) -> _Windows:
    """Return amplitude and phase of short windows, as long as they stand out of the noise."""
    t, period = signal.times_s - begin, 2.0 * math.pi / omega
    span = float(t[-1])
    cycles = min(_WINDOW_CYCLES, max(1.5, span / period / (4.0 * _FEW_WINDOWS)))
    edges = np.arange(0.0, span, cycles * period)
    rows: list[tuple[float, complex, float]] = []
    for low, high in pairwise(edges):
        inside = (t >= low) & (t < high)
        if np.count_nonzero(inside) < _WINDOW_SAMPLES:
            continue
        own, middle = t[inside], 0.5 * (low + high)
        base = np.stack([np.cos(omega * own), -np.sin(omega * own), np.ones(len(own)), own - middle], axis=1)
        found, _, _, _ = np.linalg.lstsq(base, signal.values[inside], rcond=None)
        left = signal.values[inside] - base @ found
        sd = float(np.linalg.norm(left)) / math.sqrt(max(len(own) - 5, 1)) * math.sqrt(2.0 / len(own))
        rows.append((middle, complex(found[0], found[1]), sd))
    z: ComplexArray = np.array([row[1] for row in rows], dtype=np.complex128)
    spread = np.array([row[2] for row in rows])
    is_hidden = np.abs(z) < _SEEN * spread
    hidden = np.flatnonzero(is_hidden)
    count = int(hidden[0]) if hidden.size else len(rows)
    times = np.array([row[0] for row in rows])[:count]
    returns = int(np.count_nonzero(~is_hidden[count:])) > _FEW_WINDOWS
    return _Windows(times, np.abs(z[:count]), np.unwrap(np.angle(z[:count])) + omega * times, returns)


def _regressed(
    turns: Sequence[_Windows], omega: float, unit: float, law: Law
) -> tuple[FloatArray, FloatArray]:
    """Return the terms of a law, the first or one pole, from what amplitude and phase do between windows."""
    rows_w, rows_g, right_w, right_g, weights = [], [], [], [], []
    for turn in turns:
        if len(turn.times) < 2:
            continue
        A, step = turn.amplitudes / unit, np.diff(turn.times)
        middle = 0.5 * (A[1:] + A[:-1])
        rows_w.append(np.stack([middle ** (2 * k) for k in range(law.n_frequency)], axis=1))
        right_w.append(np.diff(turn.phases) / step)
        weights.append(middle)
        powers = (1,) if law == LINEAR else range(law.n_rate)
        rows_g.append(np.stack([middle**k for k in powers], axis=1))
        right_g.append(-np.diff(A) / step)
    weight = np.concatenate(weights)
    w, _, _, _ = np.linalg.lstsq(
        np.concatenate(rows_w) * weight[:, None], np.concatenate(right_w) * weight, rcond=None
    )
    g, _, _, _ = np.linalg.lstsq(np.concatenate(rows_g), np.concatenate(right_g), rcond=None)
    first = np.zeros(law.n_frequency)
    first[0] = omega
    return np.asarray(w if w[0] > 0.0 else first), np.insert(g, 0, 0.0) if law == LINEAR else np.asarray(g)
