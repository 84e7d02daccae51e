"""Free decays: of many points with common poles, drift, and a mode at one point alone; and of bent sensors."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from beam_ident import OutputSignal, fit_free_decay
from beam_ident.errors import EstimationError
from benchmarks.ident.study import AgainstBound, Outcome, Study

LOCAL_HZ = 23.0
FREQUENCIES_HZ = np.array([3.1, 4.4, 9.0, LOCAL_HZ, 28.0])
OMEGAS = 2.0 * np.pi * FREQUENCIES_HZ
ZETAS = np.array([0.01, 0.008, 0.006, 0.004, 0.005])
SIZES = np.array([1.0, 0.3, 0.3, 0.04, 0.1])
LOCAL = 3


class ManyPoints(AgainstBound):
    """Fifteen points with drift; another number of modes is a failure. The bound leaves amplitudes and drift free."""

    n_points, rate_hz, duration_s, noise = 15, 100.0, 8.0, 0.02
    local_point = 4
    truth = np.concatenate([OMEGAS, ZETAS])

    def __init__(self) -> None:
        self.times = np.arange(round(self.rate_hz * self.duration_s)) / self.rate_hz
        places = np.linspace(0.05, 1.0, self.n_points)[:, None]
        self.amplitudes = SIZES * np.sin((np.arange(5) + 0.6) * np.pi * places) * np.exp(0.3j * np.arange(5))
        self.amplitudes[:, LOCAL] = 0.0
        self.amplitudes[self.local_point, LOCAL] = SIZES[LOCAL]
        self.drift = 0.5 * places[:, 0] * (self.times[:, None] / self.duration_s - 0.3)
        self.bound = self._bound()

    def _ringing(self, omegas: np.ndarray, zetas: np.ndarray) -> np.ndarray:
        poles = omegas * (-zetas + 1j * np.sqrt(1.0 - zetas**2))
        return np.exp(np.outer(self.times, poles))

    def _bound(self) -> np.ndarray:
        ringing = self._ringing(OMEGAS, ZETAS)
        linear = [np.ones(len(self.times)), self.times, *ringing.real.T, *ringing.imag.T]
        basis = np.linalg.qr(np.stack(linear, axis=1))[0]
        steps = 1e-6 * OMEGAS
        by_omega = (self._ringing(OMEGAS + steps, ZETAS) - self._ringing(OMEGAS - steps, ZETAS)) / (
            2.0 * steps
        )
        by_zeta = (self._ringing(OMEGAS, ZETAS + 1e-7) - self._ringing(OMEGAS, ZETAS - 1e-7)) / 2e-7
        information = np.zeros((10, 10))
        for own in self.amplitudes:
            design = np.real(np.concatenate([by_omega * own, by_zeta * own], axis=1)) / self.noise
            design -= basis @ (basis.T @ design)
            information += design.T @ design
        unit = 1.0 / np.sqrt(np.diag(information))
        return np.sqrt(np.diag(np.linalg.inv(information * np.outer(unit, unit)))) * unit

    def signals(self, seed: int) -> list[OutputSignal]:
        """Return the noisy decays of one seed."""
        clean = np.real(self._ringing(OMEGAS, ZETAS) @ self.amplitudes.T) + self.drift
        noisy = clean + self.noise * np.random.default_rng(seed).standard_normal(clean.shape)
        return [OutputSignal(f"p{k}", "m", self.times, values) for k, values in enumerate(noisy.T)]

    def run(self, seed: int) -> Outcome:
        """Fit the decays of one seed without a hint."""
        signals = self.signals(seed)
        start = time.perf_counter()
        try:
            found = fit_free_decay(signals)
        except EstimationError:
            return Outcome(time.perf_counter() - start)
        seconds = time.perf_counter() - start
        if len(found.natural_frequencies) != len(OMEGAS):
            return Outcome(seconds)
        return Outcome(
            seconds,
            np.concatenate([found.natural_frequencies, found.damping_ratios]),
            np.concatenate([found.natural_frequency_sd, found.damping_ratio_sd]),
        )


class BentSensor:
    """Two modes at random places, seen by two sensors of which every second pair is bent: x + a x^2 + b x^3."""

    times = np.arange(1600) / 100.0
    noise = 1e-3

    def run(self, seed: int) -> Outcome:
        """Fit one decay without a hint."""
        rng = np.random.default_rng([seed, 9])
        omegas = 2.0 * np.pi * np.array([rng.uniform(3.0, 8.0), rng.uniform(26.0, 45.0)])
        zetas = rng.uniform(0.003, 0.01, 2)
        poles = omegas * (-zetas + 1j * np.sqrt(1.0 - zetas**2))
        swings = (
            np.exp(np.outer(self.times, poles))
            * np.array([1.0, 0.02])
            * np.exp(1j * rng.uniform(0.0, 6.0, 2))
        )
        bent = seed % 2 == 1
        signals = []
        for name in ("a", "b"):
            x = np.real(swings).sum(axis=1)
            square, cube = (
                bent * np.exp(rng.uniform(np.log(0.02), np.log(0.1), 2)) * rng.choice([-1.0, 1.0], 2)
            )
            seen = x + square * x**2 + cube * x**3 + self.noise * rng.standard_normal(len(x))
            signals.append(OutputSignal(name, "m", self.times, seen))
        start = time.process_time()
        found = fit_free_decay(signals)
        figures = {"bent": float(bent), "modes": float(len(found.natural_frequencies))}
        figures |= {f"times {own.times[0]}": 1.0 for own in found.harmonics if own.makers == (0,)}
        figures["harmonics"] = float(len(found.harmonics))
        if figures["modes"] == 2.0:
            values = np.concatenate([found.natural_frequencies, found.damping_ratios])
            scores = (values - np.concatenate([omegas, zetas])) / np.sqrt(np.diag(found.covariance))
            figures |= {f"z{k}": float(score) for k, score in enumerate(scores)}
        return Outcome(time.process_time() - start, figures=figures)

    def summarise(self, outcomes: list[Outcome]) -> dict[str, Any]:
        """Return how often multiples were listed, how often others were, and how often intervals hold [%]."""
        bent = [own.figures for own in outcomes if own.figures["bent"]]
        straight = [own.figures for own in outcomes if not own.figures["bent"]]
        figures: dict[str, Any] = {}
        for kind, some in (("bent", bent), ("straight", straight)):
            scores = np.array([value for own in some for key, value in own.items() if key[0] == "z"])
            figures |= {
                f"{kind}: two modes [%]": 100.0 * float(np.mean([own["modes"] == 2.0 for own in some])),
                f"{kind}: coverage [%]": 100.0 * float(np.mean(np.abs(scores) < 1.96)),
                f"{kind}: any harmonic [%]": 100.0 * float(np.mean([own["harmonics"] > 0.0 for own in some])),
            }
        listed = {
            f"times {k} [%]": 100.0 * float(np.mean([f"times {k}" in own for own in bent])) for k in (2, 3)
        }
        return figures | listed


STUDIES = {
    "free-decays": Study("fifteen points, drift, one mode at one point alone", 200, ManyPoints),
    "bent-sensors": Study("decays seen by sensors that are bent", 200, BentSensor),
}
