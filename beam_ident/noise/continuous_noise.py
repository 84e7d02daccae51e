"""Coloured noise in continuous time, exact at stamps of any spacing.

Noise that is sampled at irregular stamps, or with samples missing, has no autoregression: what neighbours have in
common depends on how far apart they are.  Two processes in continuous time cover what is met: Ornstein-Uhlenbeck's,
CAR(1), and CARMA(2, 1), which has a resonance or two time constants; each alone or beside white noise.

Neither a Kalman filter nor a loop over samples is needed.  A free motion of order p is known everywhere from p
instants, so that p coefficients predict it from the p samples before.  What that prediction leaves is noise
driven since then: its covariance is banded, and its Cholesky factor is one call of LAPACK for all columns.

Equation numbers are those of docs/likelihood.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError, cholesky_banded
from scipy.linalg.lapack import dtbtrs
from scipy.optimize import minimize

from beam_ident.arrays import FloatArray
from beam_ident.noise.scores import Whiteness

_MAX_SAMPLES = 4096  # samples that choose a model: more tell nothing new of its form
_STRETCHES = 4  # in which these are taken from a long record
_TIMES = 9  # time constants that are tried
_ENOUGH = 0.01  # level of the whiteness test above which no further model is looked for
_BELOW_NYQUIST = 0.98
_MIN_WHITE, _MAX_WHITE = 1e-6, 0.999
_STEEPEST = 0.9999  # slope of a process by its decay
_IMPOSSIBLE = 1e300


@dataclass(frozen=True)
class ContinuousNoise:
    """A stationary process of variance one.

    Attributes
    ----------
    decay : float -- a of (I.21) [1/s]
    split : float or None
        d^2 of (I.21) [1/s^2], negative for a resonance; None for Ornstein-Uhlenbeck noise.
    slope : float -- k of (I.21) [1/s], between -a and a
    white : float -- share of the variance that is white noise, beside the process
    """

    decay: float
    split: float | None = None
    slope: float = 0.0
    white: float = 0.0

    @property
    def order(self) -> int:
        """Order of the process: samples from which its free motion is known."""
        return 1 if self.split is None else 2

    @property
    def n_parameters(self) -> int:
        """Number of parameters beside the variance."""
        return (1 if self.split is None else 3) + (self.white > 0.0)

    def __str__(self) -> str:
        """Return what the noise is, in words."""
        beside = f" beside {self.white:.0%} white noise" if self.white > 0.0 else ""
        if self.split is None:
            return f"Ornstein-Uhlenbeck noise of {1.0 / self.decay:.3g} s{beside}"
        if self.split < 0.0:
            hertz = math.sqrt(self.decay**2 - self.split) / (2.0 * math.pi)
            return f"CARMA(2, 1) noise with a resonance at {hertz:.3g} Hz{beside}"
        return f"CARMA(2, 1) noise{beside}"

    def correlation(self, lags_s: FloatArray) -> FloatArray:
        """Return the process's correlation (I.21) at lags [s], white noise left out."""
        lags = np.abs(lags_s)
        if self.split is None:
            return np.asarray((1.0 - self.white) * np.exp(-self.decay * lags))
        even, odd = self._free(lags)
        return np.asarray((1.0 - self.white) * (even + self.slope * odd))

    def _free(self, times_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return ``exp(-a t) cosh(d t)`` and ``exp(-a t) sinh(d t) / d`` for t >= 0, for either sign of d^2."""
        assert self.split is not None
        size = math.sqrt(abs(self.split))
        if size == 0.0:
            decayed = np.exp(-self.decay * times_s)
            return decayed, decayed * times_s
        if self.split < 0.0:
            decayed = np.exp(-self.decay * times_s)
            return decayed * np.cos(size * times_s), decayed * np.sin(size * times_s) / size
        slow, fast = np.exp((size - self.decay) * times_s), np.exp(-(size + self.decay) * times_s)
        return 0.5 * (slow + fast), -0.5 * slow * np.expm1(-2.0 * size * times_s) / size

    def predictors(self, times_s: FloatArray) -> FloatArray:
        """Return by which coefficients earlier samples predict the free motion, shape (order, n); (I.22)."""
        steps = np.diff(times_s)
        found = np.zeros((self.order, len(times_s)))
        if self.split is None:
            found[0, 1:] = np.exp(-self.decay * steps)
            return found
        # Free motions that vanish at one of the two instants have one coefficient each.
        before, after = steps[:-1], steps[1:]
        odd_before = self._free(before)[1]
        odd_before = np.where(odd_before == 0.0, 1e-300, odd_before)
        found[0, 2:] = self._free(before + after)[1] / odd_before
        found[1, 2:] = -np.exp(-2.0 * self.decay * before) * self._free(after)[1] / odd_before
        return found


class ContinuousWhitening:
    """The inverse of a process in continuous time at given stamps, exact from the first sample on.

    Parameters
    ----------
    noise : ContinuousNoise
    times_s : ndarray, shape (n,) -- rising, of any spacing [s]

    Raises
    ------
    numpy.linalg.LinAlgError
        A process that stamps so near cannot tell from a smooth curve.

    Notes
    -----
    ``R^-1 = W^T W`` with ``W = L^-1 T``: T predicts, (I.22), and L L^T is the banded covariance of what that
    leaves, (I.23).
    """

    coefficients = np.ones(1)  # of an autoregression: it has none

    def __init__(self, noise: ContinuousNoise, times_s: FloatArray) -> None:
        self.noise = noise
        order, n = noise.order, len(times_s)
        self._predictors = noise.predictors(times_s)
        taken = [np.ones(n), *(-row for row in self._predictors)]
        # Samples of two neighbouring predictions are at most so far apart: every distance is looked at once.
        common = [
            noise.correlation(times_s[lag:] - times_s[: n - lag]) for lag in range(min(2 * order + 1, n))
        ]
        common[0] = common[0] + noise.white
        band = np.zeros((order + 1, n))
        for apart in range(min(order + 1, n)):
            # cov(z_k, z_(k - apart)), every pair of samples in both; column k - apart of LAPACK's lower band.
            total = band[apart, : n - apart]
            for i, here in enumerate(taken):
                for j, there in enumerate(taken):
                    first = apart + max(i - apart, j, 0)  # of the predictions whose samples are both there
                    one, other = first - i, first - apart - j
                    if first < n:
                        pairs = common[abs(one - other)][min(one, other) :][: n - first]
                        total[first - apart :] += here[first:] * there[first - apart : n - apart] * pairs
        self._factor = cholesky_banded(band, lower=True, check_finite=False)
        diagonal = self._factor[0]
        if not (np.all(np.isfinite(diagonal)) and np.all(diagonal > 0.0)):
            raise LinAlgError("the covariance of the noise is not positive")
        self.log_determinant = float(np.sum(np.log(diagonal)))
        self._unit = math.exp(self.log_determinant / n)

    @property
    def n_parameters(self) -> int:
        """Number of parameters beside the variance."""
        return self.noise.n_parameters

    def __str__(self) -> str:
        """Return what the noise is, in words."""
        return str(self.noise)

    def apply(self, columns: FloatArray) -> FloatArray:
        """Return columns of shape (n, ...) as independent samples see them; of determinant one."""
        return self.continued(columns, 0, ())[0]

    def continued(
        self, columns: FloatArray, begin: int, memory: tuple[FloatArray, ...]
    ) -> tuple[FloatArray, tuple[FloatArray, ...]]:
        """Return the same of some rows, and what is to be known of them for the next ones.

        Parameters
        ----------
        columns : ndarray, shape (n, ...)
        begin : int -- number of the first of these rows
        memory : tuple of ndarray -- of the rows before; empty for the first ones
        """
        n, order = len(columns), self.noise.order
        if not columns.size:  # LAPACK writes where nothing is
            return columns, memory
        joined, known = columns, np.empty((0, *columns.shape[1:]))
        if memory:
            joined, known = np.concatenate([memory[0], columns]), memory[1]
        before = len(joined) - n
        left = np.array(columns, dtype=np.float64, order="F")
        for lag, row in enumerate(self._predictors, start=1):
            none = max(lag - before, 0)  # rows that nothing is before
            own = row[begin + none : begin + n].reshape(-1, *([1] * (left.ndim - 1)))
            left[none:] -= own * joined[before + none - lag : before + n - lag]
        # L white = left, (I.23): what rows before have in these is known.
        for back in range(1, len(known) + 1):
            for row in range(min(order - back + 1, n)):
                left[row] -= self._factor[row + back, begin - back] * known[-back]
        flat = left.reshape(n, -1)
        white = dtbtrs(self._factor[:, begin : begin + n], flat, uplo="L")[0].reshape(left.shape)
        following = joined[-order:].copy(), np.concatenate([known, white[-order:]])[-order:]
        return np.asarray(white * self._unit), following

    def score_covariance(self, design: FloatArray) -> FloatArray:
        """Return ``D^T R D`` for this noise's correlation R and the derivatives D, shape (n, n_parameters)."""
        n, order = len(design), self.noise.order
        if not design.size:
            return np.zeros((design.shape[1],) * 2)
        steps = np.zeros((order + 1, n))
        steps[0] = 1.0
        for lag, row in enumerate(self._predictors, start=1):
            steps[lag, : n - lag] = -row[lag:]
        # R = T^-1 L L^T T^-T, so that the product is |L^T T^-T D|^2.
        back = dtbtrs(steps, np.asfortranarray(design), uplo="L", trans="T")[0]
        spread = self._factor[0][:, None] * back
        for lag in range(1, order + 1):
            spread[:-lag] += self._factor[lag, : n - lag, None] * back[lag:]
        return np.asarray(spread.T @ spread)


def continuous_noise(
    residuals: FloatArray,
    times_s: FloatArray,
    doubt: FloatArray | None = None,
    near: ContinuousNoise | None = None,
    max_order: int = 2,
) -> ContinuousNoise | None:
    """Return the process that BIC prefers for residuals at stamps of any spacing, None for white noise.

    Parameters
    ----------
    residuals : ndarray, shape (n,)
    times_s : ndarray, shape (n,) -- rising [s]
    doubt : ndarray or None, shape (n, n_parameters)
        U of (I.24), what the model that left these residuals is not known by; their mean then counts as well.
    near : ContinuousNoise or None
        What was chosen for residuals almost like these: its form stays, and its parameters are found from there.
    max_order : int -- of the process; 1 has no resonance
    """
    every = np.reshape(residuals - np.mean(residuals), (-1, 1))
    if doubt is not None:
        every = np.concatenate([residuals[:, None], doubt], axis=1)
    every, times_s = _thinned(every, times_s)
    if Whiteness.of(every[:, 0]).p_value > _ENOUGH:
        return None
    choice = _Choice(every, times_s)
    return choice.among_forms(max_order) if near is None else choice.near(near)


class _Choice:
    """The choice of a process by BIC, among forms of rising freedom.

    Parameters
    ----------
    every : ndarray, shape (n, 1 + n_parameters) -- residuals, and what they are not known by
    times_s : ndarray, shape (n,)
    """

    def __init__(self, every: FloatArray, times_s: FloatArray) -> None:
        self.every, self.times_s = every, times_s
        self.period, self.length = float(np.median(np.diff(times_s))), float(times_s[-1] - times_s[0])
        self.highest = _BELOW_NYQUIST * math.pi / self.period
        self.best: ContinuousNoise | None = None
        self.least = 2.0 * self._half_log_power(every)

    def _half_log_power(self, rows: FloatArray) -> float:
        found = 0.5 * len(rows) * math.log(max(float(np.sum(np.square(rows))), 1e-300))
        return found if math.isfinite(found) else _IMPOSSIBLE

    def _cost(self, noise: ContinuousNoise) -> float:
        try:
            return self._half_log_power(ContinuousWhitening(noise, self.times_s).apply(self.every))
        except (LinAlgError, ValueError):
            return _IMPOSSIBLE

    def offer(
        self, form: Callable[[FloatArray], ContinuousNoise], starts: list[list[float]]
    ) -> ContinuousNoise:
        """Return the likeliest process of a form, from the best of some starts; keep it where BIC prefers it."""
        start = np.array(min((self._cost(form(np.array(own))), own) for own in starts)[1])
        simplex = np.vstack([start, *(start + 0.7 * row for row in np.eye(len(start)))])
        options = {"initial_simplex": simplex, "xatol": 0.02, "fatol": 0.05, "maxfev": 60 * len(start)}
        found = minimize(lambda p: self._cost(form(p)), start, method="Nelder-Mead", options=options)
        noise = form(found.x)
        criterion = 2.0 * float(found.fun) + noise.n_parameters * math.log(len(self.every))
        if criterion < self.least:
            self.least, self.best = criterion, noise
        return noise

    @property
    def is_enough(self) -> bool:
        """Whether the best process so far leaves white noise."""
        left = self.every[:, 0]
        white = left if self.best is None else ContinuousWhitening(self.best, self.times_s).apply(left)
        return Whiteness.of(white).p_value > _ENOUGH

    @staticmethod
    def first_order(p: FloatArray) -> ContinuousNoise:
        """Return an Ornstein-Uhlenbeck process, with white noise beside it where two numbers are given."""
        return ContinuousNoise(_exp(p[0]), white=_share(p[1]) if len(p) > 1 else 0.0)

    def second_order(self, p: FloatArray) -> ContinuousNoise:
        """Return a process from a pair at the Nyquist frequency to two real time constants far apart."""
        decay = _exp(p[0])
        split = _share(p[1]) * (decay**2 + self.highest**2) * 0.999 - self.highest**2
        white = _share(p[3]) if len(p) > 3 else 0.0
        return ContinuousNoise(decay, split, decay * math.tanh(p[2]), white=white)

    def near(self, known: ContinuousNoise) -> ContinuousNoise | None:
        """Return the best process of the form of another one, near it."""
        beside = [_logit((known.white - _MIN_WHITE) / (_MAX_WHITE - _MIN_WHITE))] * (known.white > 0.0)
        start = [math.log(known.decay)]
        if known.split is None:
            self.offer(self.first_order, [[*start, *beside]])
        else:
            share = _logit((known.split + self.highest**2) / (0.999 * (known.decay**2 + self.highest**2)))
            slope = math.atanh(min(max(known.slope / known.decay, -_STEEPEST), _STEEPEST))
            self.offer(self.second_order, [[*start, share, slope, *beside]])
        return self.best

    def among_forms(self, max_order: int) -> ContinuousNoise | None:
        """Return the first process that leaves white noise, or the best of all."""
        decays = np.log(np.geomspace(3.0 / self.length, 3.0 / self.period, _TIMES)).tolist()
        alone = self.offer(self.first_order, [[decay] for decay in decays])
        if self.is_enough:
            return self.best
        slow = math.log(alone.decay) - 1.0
        self.offer(self.first_order, [[slow, 0.0], [slow + 1.0, -3.0], [slow, 2.0]])
        if max_order == 1 or self.is_enough:
            return self.best
        places = []
        for decay in (slow + 1.5, slow - 1.0):
            size = _exp(decay)
            # Two real time constants, a double one, resonances over the band; d^2 of each as a share of its range.
            resonances = -(np.geomspace(2.0 * math.pi / self.length, 0.95 * self.highest, 7) ** 2)
            for split in (0.5 * size**2, *resonances):
                places.append([decay, _logit((split + self.highest**2) / (size**2 + self.highest**2))])
        self.offer(self.second_order, [[*place, 0.0] for place in places])
        if not self.is_enough:
            self.offer(self.second_order, [[*place, 0.0, w] for place in places for w in (-1.5, 0.5)])
        return self.best


def _thinned(every: FloatArray, times_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return a few stretches of a long record: the time between them only makes them independent."""
    n = len(every)
    if n <= _MAX_SAMPLES:
        return every, times_s
    size = _MAX_SAMPLES // _STRETCHES
    starts = np.linspace(0, n - size, _STRETCHES).astype(np.intp)
    kept = np.concatenate([np.arange(start, start + size) for start in starts])
    return every[kept], times_s[kept]


def _exp(value: float) -> float:
    return math.exp(min(max(float(value), -200.0), 200.0))


def _share(value: float) -> float:
    return _MIN_WHITE + (_MAX_WHITE - _MIN_WHITE) / (1.0 + _exp(-value))


def _logit(share: float) -> float:
    share = min(max(share, 1e-5), 1.0 - 1e-5)
    return math.log(share / (1.0 - share))
