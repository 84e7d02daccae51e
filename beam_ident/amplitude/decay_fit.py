"""The fit of one weakly nonlinear mode to free decays, all of them at once.

Amplitude and phase follow ``slow_flow``; the samples are

    y_j(t) = Re[c_j A(t) e^(j phi(t))] + third harmonic of A^2 and A^3 + other modes + offset + drift

with c = 1 at the reference output, in whose unit the amplitude is. What enters linearly is projected out (Golub and
Pereyra 1973), so that the iteration moves frequencies, rates, and each decay's first amplitude and phase alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy import linalg, optimize

from beam_ident.amplitude.slow_flow import slow_flow
from beam_ident.arrays import ComplexArray, FloatArray
from beam_ident.data.records import OutputSignal
from beam_ident.errors import EstimationError

_WINDOW_CYCLES = 4.0
_FEW_WINDOWS = 6
_WINDOW_SAMPLES = 8
_SEEN = 5.0  # standard deviations of a window's amplitude
_ITERATIONS = 60
_N_COLUMNS = 6  # of every output: offset, drift, and the third harmonic


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
    """

    law: Law
    omega_terms: FloatArray
    rate_terms: FloatArray
    reference: float
    amplitudes: FloatArray
    phases: FloatArray
    others: FloatArray

    def of_one_pole(self) -> Start:
        """Return the same with one frequency and one damping ratio."""
        return replace(self, law=LINEAR, omega_terms=self.omega_terms[:1], rate_terms=self.rate_terms[:2])


@dataclass(frozen=True, eq=False)
class DecayFit:
    """A fit of the law to all decays.

    Attributes
    ----------
    point : Start -- the estimates
    covariance : ndarray, shape (n_terms, n_terms) -- of both groups of terms, for white noise
    cost : float -- half of the squared residuals over their variance, and the logarithms of that
    n_parameters, n_samples : int
    residuals : tuple of tuple of ndarray -- of every output of every decay
    noise_sd : tuple of float -- of every output
    last_amplitudes : ndarray, shape (n_decays,) -- at the ends, in units of the reference
    converged : bool
    iterations : int
    """

    point: Start
    covariance: FloatArray
    cost: float
    n_parameters: int
    n_samples: int
    residuals: tuple[tuple[FloatArray, ...], ...]
    noise_sd: tuple[float, ...]
    last_amplitudes: FloatArray
    converged: bool
    iterations: int

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

    def start(self, frequency_hz: float | None) -> Start:
        """Return a start from the amplitudes and phases of short windows.

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
            raise EstimationError(
                f"output {signals[0].name!r} holds {longest:.0f} cycles at {omega / (2.0 * math.pi):.4g} Hz, of "
                f"which {max(len(turn.times) for turn in turns)} windows stand out of the noise; a curve over "
                f"amplitude needs {_FEW_WINDOWS} at least: record a longer decay, or one with a larger amplitude"
            )
        unit = max(float(turn.amplitudes.max()) for turn in turns if len(turn.times))
        w, g = _regressed(turns, omega, unit)
        first = np.array([turn.amplitudes[0] / unit if len(turn.times) else 1e-3 for turn in turns])
        phases = np.zeros(len(turns))
        for k, turn in enumerate(turns):
            if len(turn.times):
                middle = float(turn.times[0])
                first[k] += middle * float(np.polynomial.polynomial.polyval(first[k], g))
                turned = middle * float(np.polynomial.polynomial.polyval(first[k] ** 2, w))
                phases[k] = float(turn.phases[0]) - turned
        return Start(Law(), w, g, unit, first, phases, np.zeros((0, 2)))

    # The fit ----------------------------------------------------------------------------------------------

    def fit(self, start: Start) -> DecayFit:
        """Return the maximum of the likelihood next to a start."""
        theta, sigmas = _packed(start), np.ones(self.n_outputs)
        scale = self._scale(start)
        for _ in range(3):  # the noise of each output follows from its residuals
            found = optimize.least_squares(
                lambda x, s=sigmas: np.concatenate(self._whitened(_unpacked(x * scale, start), s)),
                theta / scale,
                jac="3-point",
                method="trf",
                max_nfev=_ITERATIONS,
                ftol=1e-10,
                xtol=1e-10,
                gtol=1e-10,
            )
            theta = found.x * scale
            residuals = self._whitened(_unpacked(theta, start), np.ones(self.n_outputs))
            before, sigmas = sigmas, self._deviations(residuals, start)
            if np.allclose(before, sigmas, rtol=1e-3):
                break
        point = _unpacked(theta, start)
        J = found.jac * np.repeat(np.tile(before / sigmas, len(self.decays)), self._sizes())[:, None] / scale
        n = start.law.n_terms
        covariance = linalg.pinvh(J.T @ J, atol=0.0, rtol=1e-14)[:n, :n]
        grouped = iter(residuals)
        sizes = np.array(self._sizes())
        per_output = sizes.reshape(len(self.decays), self.n_outputs).sum(axis=0)
        return DecayFit(
            point,
            np.asarray(covariance),
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
        return len(self.decays) * (self.n_outputs * own + 2 * (self.n_outputs - 1))

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
        n = start.law.n_terms + 2 * len(self.decays)
        scale[n::2] = 1.0 / span
        scale[n + 1 :: 2] = 1.0 / (span * np.maximum(start.others[:, 0], 1e-300))
        return scale

    def _last_amplitude(self, point: Start, k: int) -> float:
        """Return the amplitude at the end of a decay."""
        end = np.array([max(float(s.times_s[-1]) for s in self.decays[k]) - self.starts[k]])
        return float(slow_flow(point.omega_terms, point.rate_terms, float(point.amplitudes[k]), end)[0][0])

    def _whitened(self, point: Start, sigmas: FloatArray) -> list[FloatArray]:
        """Return what is left of every output of every decay, over its noise."""
        result = []
        for k, (decay, begin) in enumerate(zip(self.decays, self.starts, strict=True)):
            known: dict[bytes, tuple[FloatArray, FloatArray]] = {}
            for j, signal in enumerate(decay):
                t = signal.times_s - begin
                key = signal.times_s.tobytes()
                if key not in known:
                    known[key] = slow_flow(point.omega_terms, point.rate_terms, float(point.amplitudes[k]), t)
                A, turned = known[key]
                phi = turned + point.phases[k]
                # An exposure shows a swing smaller by its sinc.
                seen = np.sinc(point.omega_terms[0] * signal.exposure_s / (2.0 * np.pi)) * A * point.reference
                values = signal.values
                columns = [np.ones(len(t)), t - 0.5 * t[-1]]
                columns += [A**n * wave(3.0 * phi) for n in (2, 3) for wave in (np.cos, np.sin)]
                if j == self.reference:
                    values = values - seen * np.cos(phi)
                else:
                    columns += [seen * np.cos(phi), seen * np.sin(phi)]
                for omega, zeta in point.others:
                    fall = np.exp(-zeta * omega * t)
                    columns += [fall * np.cos(omega * t), fall * np.sin(omega * t)]
                Q, _ = np.linalg.qr(np.stack(columns, axis=1))
                result.append((values - Q @ (Q.T @ values)) / sigmas[j])
        return result


def _packed(point: Start) -> FloatArray:
    logs = np.log(np.maximum(point.amplitudes, 1e-12))
    per_decay = np.column_stack([logs, point.phases]).ravel()
    rates = point.rate_terms[1:2] if point.law == LINEAR else point.rate_terms
    return np.concatenate([point.omega_terms, rates, per_decay, point.others.ravel()])


def _unpacked(theta: FloatArray, like: Start) -> Start:
    nf, n, m = like.law.n_frequency, like.law.n_terms, len(like.amplitudes)
    rates = theta[nf:n]
    per_decay = theta[n : n + 2 * m].reshape(m, 2)
    others = theta[n + 2 * m :].reshape(-1, 2)
    amplitudes = np.exp(np.clip(per_decay[:, 0], -30.0, 5.0))
    if like.law == LINEAR:
        rates = np.array([0.0, rates[0]])
    return Start(like.law, theta[:nf], rates, like.reference, amplitudes, per_decay[:, 1], others)


@dataclass(frozen=True, eq=False)
class _Windows:
    times: FloatArray
    amplitudes: FloatArray
    phases: FloatArray


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
    hidden = np.flatnonzero(np.abs(z) < _SEEN * spread)
    count = int(hidden[0]) if hidden.size else len(rows)
    times = np.array([row[0] for row in rows])[:count]
    return _Windows(times, np.abs(z[:count]), np.unwrap(np.angle(z[:count])) + omega * times)


def _regressed(turns: Sequence[_Windows], omega: float, unit: float) -> tuple[FloatArray, FloatArray]:
    """Return w_0, w_2 and g_-1, g_0, g_1 from what amplitude and phase do between windows."""
    rows_w, rows_g, right_w, right_g, weights = [], [], [], [], []
    for turn in turns:
        if len(turn.times) < 2:
            continue
        A, step = turn.amplitudes / unit, np.diff(turn.times)
        middle = 0.5 * (A[1:] + A[:-1])
        rows_w.append(np.stack([np.ones(len(step)), middle**2], axis=1))
        right_w.append(np.diff(turn.phases) / step)
        weights.append(middle)
        rows_g.append(np.stack([np.ones(len(step)), middle, middle**2], axis=1))
        right_g.append(-np.diff(A) / step)
    weight = np.concatenate(weights)
    w, _, _, _ = np.linalg.lstsq(
        np.concatenate(rows_w) * weight[:, None], np.concatenate(right_w) * weight, rcond=None
    )
    g, _, _, _ = np.linalg.lstsq(np.concatenate(rows_g), np.concatenate(right_g), rcond=None)
    return np.asarray(w if w[0] > 0.0 else [omega, 0.0], dtype=np.float64), np.asarray(g)
