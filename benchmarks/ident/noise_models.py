"""Coloured output noise: the refined estimator against the bound that knows the colour, the plain one beside it."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.signal import lfilter

from beam_ident import OutputSignal, TimeRecord, TransferFunctionModel, estimate_transfer_function
from benchmarks.ident.forced_beam import ForcedBeam
from benchmarks.ident.study import AgainstBound, Outcome, Study
from tests.beam_ident import rao_garnier

_SETTLING = 500  # samples after which the noise has forgotten its start
_QUIET = 1e-3


def coloured(seed: int, n: int, numerator: list[float], denominator: list[float]) -> np.ndarray:
    """Return noise of unit power from a filter on white noise."""
    impulse = np.zeros(20 * _SETTLING)
    impulse[0] = 1.0
    power = float(np.sum(lfilter(numerator, denominator, impulse) ** 2))
    white = np.random.default_rng(seed).standard_normal(n + _SETTLING)
    return np.asarray(lfilter(numerator, denominator, white)[_SETTLING:] / np.sqrt(power))


class ColouredCase(AgainstBound):
    """Parameters of one transfer function; the bound is that of the noise's own colour."""

    def __init__(
        self,
        record: Callable[[int, float], TimeRecord],
        degrees: tuple[int, int],
        read: Callable[[TransferFunctionModel], tuple[np.ndarray, np.ndarray]],
        truth: np.ndarray,
    ) -> None:
        self.record, self.degrees, self.read, self.truth = record, degrees, read, truth
        # A thousandth of the noise keeps its colour: deviations scale, and the estimate is the truth.
        quiet = estimate_transfer_function(record(10**6, _QUIET), *degrees, method="rivc")
        self.bound = read(quiet.model)[1] / _QUIET

    def run(self, seed: int) -> Outcome:
        """Identify one record with a noise model, and without."""
        record = self.record(seed, 1.0)
        start = time.perf_counter()
        found = estimate_transfer_function(record, *self.degrees, method="rivc")
        seconds = time.perf_counter() - start
        values, sd = self.read(found.model)
        if not found.converged or len(values) != len(self.truth):
            return Outcome(seconds)
        plain = self.read(estimate_transfer_function(record, *self.degrees, method="white").model)[0]
        if len(plain) != len(self.truth):
            plain = np.full(len(self.truth), np.nan)
        figures = {f"plain {k}": float(value) for k, value in enumerate(plain)}
        return Outcome(seconds, values, sd, figures)

    def summarise(self, outcomes: list[Outcome]) -> dict[str, Any]:
        """Return the figures against the bound, and the efficiency of the estimate without a noise model."""
        figures = super().summarise(outcomes)
        good = [o for o in outcomes if self.is_near(o)]
        plain = np.array([list(o.figures.values()) for o in good]) - self.truth
        figures["efficiency without noise model"] = [
            round(float(e), 3) for e in self.bound**2 / np.nanmean(plain**2, axis=0)
        ]
        ours = np.array([o.estimate for o in good]) - self.truth
        figures["rmse, without -> with"] = [
            f"{np.sqrt(np.nanmean(p**2)):.3g} -> {np.sqrt(np.mean(e**2)):.3g}"
            for p, e in zip(plain.T, ours.T, strict=True)
        ]
        return figures


def beam() -> ColouredCase:
    """Return the forced beam's tip under AR(1) noise of 20 dB; frequencies [Hz] and damping ratios."""
    truth = ForcedBeam()
    clean = truth.model.simulate(truth.drive, truth.period * np.arange(truth.n))[:, 0]

    def record(seed: int, quiet: float) -> TimeRecord:
        noise = quiet * np.std(clean) / 10.0 * coloured(seed, truth.n, [1.0], [1.0, -0.95])
        return TimeRecord((truth.drive,), (OutputSignal("tip", "m", (0.0, truth.period), clean + noise),))

    def read(model: TransferFunctionModel) -> tuple[np.ndarray, np.ndarray]:
        omega, zeta, omega_sd, zeta_sd = model.modes()
        hertz = 2.0 * np.pi
        return np.concatenate([omega / hertz, zeta]), np.concatenate([omega_sd / hertz, zeta_sd])

    return ColouredCase(record, (6, 4), read, np.concatenate([truth.omegas / (2.0 * np.pi), truth.zetas]))


def rao_garnier_coloured() -> ColouredCase:
    """Return Rao-Garnier at 10 dB under ARMA(2, 1) noise with a resonance; the six coefficients."""
    drive = rao_garnier.prbs(2000)
    clean = rao_garnier.response(drive)
    level = rao_garnier.noise_level(clean, 10.0)
    source = rao_garnier.benchmark_record(0, 10.0)

    def record(seed: int, quiet: float) -> TimeRecord:
        noise = quiet * level * coloured(seed, 2000, [1.0, 0.5], [1.0, -1.6, 0.8])
        return TimeRecord(source.inputs, (OutputSignal("y", "", (0.0, rao_garnier.PERIOD_S), clean + noise),))

    def read(model: TransferFunctionModel) -> tuple[np.ndarray, np.ndarray]:
        return model.parameters[:6], model.standard_deviations[:6]

    return ColouredCase(record, (4, 1), read, rao_garnier.PARAMETERS)


STUDIES = {
    "colour-beam": Study("forced beam, tip, noise AR(1) of 0.95, 20 dB", 400, beam),
    "colour-rao-garnier": Study("Rao-Garnier, noise ARMA(2, 1), 10 dB", 400, rao_garnier_coloured),
}
