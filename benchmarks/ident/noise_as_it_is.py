"""Rao-Garnier under noise as laboratories have it, by the default estimator: slow at any stamps, outliers, few bits.

The bound of every study knows the noise: its covariance, the density with outliers, or the likelihood of a
rounded value.  It is computed from the true gradients.
"""

from __future__ import annotations

import functools
import time
from abc import ABC, abstractmethod

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.special import ndtr

from beam_ident import (
    InputSignal,
    OutputSignal,
    TimeRecord,
    TransferFunctionModel,
    estimate_transfer_function,
    select_transfer_function,
)
from benchmarks.ident.study import AgainstBound, Outcome, Study
from tests.beam_ident import rao_garnier

PERIOD_S = rao_garnier.PERIOD_S
_N = 2000
_STEP = 1e-5  # of a parameter, for central differences


class _RaoGarnier(AgainstBound, ABC):
    """The six coefficients from one record of 2000 samples, without a hint."""

    snr_db = 10.0

    def __init__(self, is_regular: bool = True) -> None:
        end = PERIOD_S * (_N - 1)
        scattered = np.sort(np.random.default_rng(3).uniform(0.0, end, _N))
        self.stamps = PERIOD_S * np.arange(_N) if is_regular else scattered
        self.drive = InputSignal("u", "", (0.0, PERIOD_S), rao_garnier.prbs(_N))
        self.truth = rao_garnier.PARAMETERS
        self.clean = self._response(self.truth)
        self.sigma = rao_garnier.noise_level(self.clean, self.snr_db)
        slopes = []
        for i, value in enumerate(self.truth):
            step = np.zeros(6)
            step[i] = _STEP * abs(value)
            ahead, behind = self._response(self.truth + step), self._response(self.truth - step)
            slopes.append((ahead - behind) / (2.0 * step[i]))
        self.gradient = np.stack(slopes, axis=1)

    def _response(self, parameters: np.ndarray) -> np.ndarray:
        denominator = np.concatenate([[1.0], parameters[:4]])
        model = TransferFunctionModel(parameters[4:], denominator, 0.0, np.zeros((7, 7)), 0.0)
        return model.simulate(self.drive, self.stamps)

    def _limit(self, white: np.ndarray) -> np.ndarray:
        """Return the bound from gradients of unit noise."""
        scale = np.linalg.norm(white, axis=0)
        return np.sqrt(np.diag(np.linalg.inv((white / scale).T @ (white / scale)))) / scale

    @abstractmethod
    def seen(self, seed: int) -> np.ndarray:
        """Return the noisy samples of one seed."""

    def record(self, seed: int) -> TimeRecord:
        """Return the record of one seed."""
        stamps = (0.0, PERIOD_S) if self.stamps[1] == PERIOD_S else self.stamps
        return TimeRecord((self.drive,), (OutputSignal("y", "", stamps, self.seen(seed)),))

    def run(self, seed: int) -> Outcome:
        """Estimate from the record of one seed."""
        record = self.record(seed)
        start = time.perf_counter()
        found = estimate_transfer_function(record, 4, 1)
        seconds = time.perf_counter() - start
        if not found.converged:
            return Outcome(seconds)
        return Outcome(seconds, found.model.parameters[:6], found.model.standard_deviations[:6])


class SlowNoise(_RaoGarnier):
    """Ornstein-Uhlenbeck noise, an AR(1) at the stamps of a clock.

    Parameters
    ----------
    pole : float -- of the AR(1) at 100 samples a second
    is_regular : bool -- stamps of a clock, or anywhere

    Notes
    -----
    A summary also has the coverage of the linear estimator that knows the noise, from the same draws: what an
    honest estimate has in so few runs.
    """

    def __init__(self, pole: float, is_regular: bool) -> None:
        super().__init__(is_regular)
        self.kept = pole ** (np.diff(self.stamps) / PERIOD_S)
        correlation = pole ** (np.abs(self.stamps[:, None] - self.stamps[None, :]) / PERIOD_S)
        root = cholesky(correlation + 1e-13 * np.eye(_N), lower=True)
        white = solve_triangular(root, self.gradient, lower=True) / self.sigma
        self.bound = self._limit(white)
        scale = np.linalg.norm(white, axis=0)
        self.known = np.linalg.pinv(white / scale) / (self.bound * scale)[:, None]

    def seen(self, seed: int) -> np.ndarray:
        """Return the noisy samples of one seed."""
        noise = np.random.default_rng(seed).standard_normal(_N)
        for k, share in enumerate(self.kept, start=1):
            noise[k] = share * noise[k - 1] + np.sqrt(1.0 - share**2) * noise[k]
        return self.clean + self.sigma * noise

    def summarise(self, outcomes: list[Outcome]) -> dict[str, object]:
        """Return the figures of all runs, and the coverage where the noise is known."""
        drawn = [np.random.default_rng(seed).standard_normal(_N) for seed in range(len(outcomes))]
        scores = np.abs([self.known @ own for own in drawn])
        return super().summarise(outcomes) | {
            "coverage, noise known": round(float(np.mean(scores < 1.96)), 4)
        }


class Outliers(_RaoGarnier):
    """White noise, in which a share of the samples has twenty times the deviation."""

    size = 20.0

    def __init__(self, share: float) -> None:
        super().__init__()
        self.share = share
        z = np.linspace(-8.0 * self.size, 8.0 * self.size, 400_001)
        inner, outer = np.exp(-0.5 * z**2), np.exp(-0.5 * (z / self.size) ** 2) / self.size
        density = ((1.0 - share) * inner + share * outer) / np.sqrt(2.0 * np.pi)
        slope = np.gradient(density, z)
        information = np.sum(slope**2 / np.maximum(density, 1e-300)) * (z[1] - z[0])
        self.bound = self._limit(self.gradient / self.sigma) / np.sqrt(information)

    def seen(self, seed: int) -> np.ndarray:
        """Return the noisy samples of one seed."""
        rng = np.random.default_rng(seed)
        sd = np.where(rng.uniform(size=_N) < self.share, self.size, 1.0)
        return self.clean + self.sigma * sd * rng.standard_normal(_N)


class FewBits(_RaoGarnier):
    """White noise of 20 dB, rounded to so many bits over the range of the output."""

    snr_db = 20.0

    def __init__(self, bits: int) -> None:
        super().__init__()
        self.quantum = 1.2 * float(np.ptp(self.clean)) / 2**bits
        # Of a rounded value: the sum over levels of (dP/dm)^2 / P.
        place = self.clean / self.quantum
        edges = np.round(place)[:, None] + np.arange(-12, 13) + 0.5
        z = (edges - place[:, None]) * self.quantum / self.sigma
        chance, slope = np.diff(ndtr(z), axis=1), np.diff(np.exp(-0.5 * z**2), axis=1) / np.sqrt(2.0 * np.pi)
        information = np.sum(slope**2 / np.maximum(chance, 1e-30), axis=1)
        self.bound = self._limit(self.gradient * np.sqrt(information)[:, None] / self.sigma)

    def seen(self, seed: int) -> np.ndarray:
        """Return the noisy samples of one seed."""
        noisy = self.clean + self.sigma * np.random.default_rng(seed).standard_normal(_N)
        return self.quantum * np.round(noisy / self.quantum)


class OrdersUnderSlowNoise(SlowNoise):
    """Which degrees the default choice of orders takes under slow noise; the truth has four poles and one zero."""

    def __init__(self) -> None:
        super().__init__(0.95, True)

    def run(self, seed: int) -> Outcome:
        """Choose the degrees for the record of one seed."""
        start = time.perf_counter()
        model = select_transfer_function(self.record(seed), (2, 3, 4, 5), (0, 1, 2, 3)).chosen.model
        degrees = {"poles": float(model.n_poles), "zeros": float(len(model.numerator) - 1)}
        return Outcome(time.perf_counter() - start, figures=degrees)

    def summarise(self, outcomes: list[Outcome]) -> dict[str, object]:
        """Return the share of right degrees, and the others."""
        chosen = [(int(o.figures["poles"]), int(o.figures["zeros"])) for o in outcomes]
        others = sorted({degrees for degrees in chosen if degrees != (4, 1)})
        return {
            "right": round(float(np.mean([degrees == (4, 1) for degrees in chosen])), 4),
            "others": ", ".join(f"{n}/{m} x {chosen.count((n, m))}" for n, m in others) or "none",
        }


_POLES = (0.5, 0.9, 0.99)

STUDIES = {
    **{
        f"ar-noise-{str(pole)[2:]}{'' if is_regular else '-scattered'}": Study(
            f"Rao-Garnier, 10 dB, AR(1) noise of {pole}{'' if is_regular else ' at stamps anywhere'}",
            200,
            functools.partial(SlowNoise, pole, is_regular),
        )
        for pole in _POLES
        for is_regular in (True, False)
    },
    **{
        f"outliers-{share}": Study(
            f"Rao-Garnier, 10 dB, {share} % of the samples with twenty times the noise",
            200,
            functools.partial(Outliers, share / 100.0),
        )
        for share in (1, 5, 10)
    },
    **{
        f"quantised-{bits}": Study(
            f"Rao-Garnier, 20 dB, rounded to {bits} bits", 200, functools.partial(FewBits, bits)
        )
        for bits in (3, 4, 6, 8)
    },
    "orders-ar-noise": Study("orders under AR(1) noise of 0.95, 10 dB", 40, OrdersUnderSlowNoise),
}
