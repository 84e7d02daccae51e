"""Records that begin in motion, of any energy from none to ten times what the input gives: nobody says so."""

from __future__ import annotations

import functools
import time
from abc import ABC, abstractmethod
from typing import Any

import numpy as np
from scipy.signal import max_len_seq

from beam_ident import (
    EstimationError,
    InputSignal,
    OutputSignal,
    TimeRecord,
    TransferFunctionModel,
    estimate_common_poles,
    estimate_transfer_function,
    identify,
)
from benchmarks.ident.study import AgainstBound, Outcome, Study

_QUIET = 1e-3  # of the noise: what the covariance states there is the bound
_PERIOD, _N = 0.01, 2000
_MOST_ENERGY = 10.0


class MovingStart(AgainstBound, ABC):
    """Two modes at 20 dB, seen at two points, from a start of random energy and phase.

    The bound knows which records begin in motion, and knows the state unknown.
    """

    omegas = 2.0 * np.pi * np.array([1.3, 5.1])
    zetas = np.array([0.02, 0.01])
    shapes = np.array([[1.0, 0.6], [0.5, -0.8]])

    def __init__(self) -> None:
        steps = np.repeat(2.0 * max_len_seq(10)[0] - 1.0, 2)[:_N]
        self.drive = InputSignal("force", "N", (0.0, _PERIOD), steps, "zoh")
        self.times = _PERIOD * np.arange(_N)
        parts = []
        for omega, zeta in zip(self.omegas, self.zetas, strict=True):
            denominator = np.array([1.0, 2.0 * zeta * omega, omega**2])
            mode = TransferFunctionModel(np.array([omega**2]), denominator, 0.0, np.zeros((4, 4)), 0.0)
            parts.append(mode.simulate(self.drive, self.times))
        self.forced = np.array(parts)
        self.clean = self.shapes @ self.forced
        self.noise_sd = 0.1 * np.std(self.clean, axis=1)
        self.truth = np.concatenate([self.omegas, self.zetas])

    def record(self, seed: int, quiet: float = 1.0) -> TimeRecord:
        """Return a record; every fourth one begins at rest."""
        rng = np.random.default_rng(seed)
        energy = 0.0 if seed % 4 == 0 else rng.uniform(0.0, _MOST_ENERGY)
        poles = self.omegas * (-self.zetas + 1j * np.sqrt(1.0 - self.zetas**2))
        phases = np.exp(2j * np.pi * rng.uniform(size=2))
        free = np.real(phases[:, None] * np.exp(poles[:, None] * self.times))
        free *= np.sqrt(2.0 * energy) * np.std(self.forced, axis=1)[:, None]
        noise = quiet * self.noise_sd[:, None] * rng.standard_normal(self.clean.shape)
        values = self.clean + self.shapes @ free + noise
        outputs = [OutputSignal(name, "m", self.times, y) for name, y in zip("ab", values, strict=True)]
        return TimeRecord((self.drive,), tuple(outputs))

    @functools.cached_property
    def bound(self) -> np.ndarray:
        """Root of the mean variance at the limit, over starts as the runs have them."""
        stated = [self.estimate(self.record(10**6 + seed, _QUIET), seed % 4 > 0)[1] for seed in range(12)]
        return np.asarray(np.sqrt(np.mean(np.square(stated), axis=0))) / _QUIET

    @abstractmethod
    def estimate(
        self, record: TimeRecord, is_moving: bool | None = None
    ) -> tuple[np.ndarray, np.ndarray, bool]:
        """Return frequencies and damping ratios, their standard deviations, and whether motion was found."""

    def run(self, seed: int) -> Outcome:
        """Estimate one record without a word on how it begins."""
        record = self.record(seed)
        start = time.perf_counter()
        try:
            values, sds, said = self.estimate(record)
        except EstimationError:
            return Outcome(time.perf_counter() - start)
        seconds = time.perf_counter() - start
        return Outcome(seconds, values, sds, {"moving": float(seed % 4 > 0), "found": float(said)})

    def summarise(self, outcomes: list[Outcome]) -> dict[str, Any]:
        """Add how often motion was missed, and how often rest was taken for motion."""
        good = [o.figures for o in outcomes if o.figures]
        rest = [o["found"] for o in good if not o["moving"]]
        moving = [o["found"] for o in good if o["moving"]]
        rates = {"motion missed": 1.0 - np.mean(moving), "rest taken for motion": np.mean(rest)}
        return super().summarise(outcomes) | {name: round(float(rate), 4) for name, rate in rates.items()}


def _modes(model: TransferFunctionModel) -> tuple[np.ndarray, np.ndarray]:
    found = model.modes()
    return np.concatenate(found[:2]), np.concatenate(found[2:])


class ByTransferFunction(MovingStart):
    """One point, four poles and two zeros."""

    def estimate(
        self, record: TimeRecord, is_moving: bool | None = None
    ) -> tuple[np.ndarray, np.ndarray, bool]:
        """Estimate a transfer function."""
        found = estimate_transfer_function(record, 4, 2, output_name="a", has_free_response=is_moving)
        return *_modes(found.model), found.initial_motion.is_estimated


class ByCommonPoles(MovingStart):
    """Both points with one denominator."""

    def estimate(
        self, record: TimeRecord, is_moving: bool | None = None
    ) -> tuple[np.ndarray, np.ndarray, bool]:
        """Estimate transfer functions with common poles."""
        found = estimate_common_poles(record, 4, 2, has_free_response=is_moving)
        return *_modes(found.models[0]), any("began in motion" in said for said in found.warnings)


class ByModes(MovingStart):
    """Both points in modal form, which always has the free motion."""

    def estimate(
        self, record: TimeRecord, is_moving: bool | None = None
    ) -> tuple[np.ndarray, np.ndarray, bool]:
        """Identify two modes."""
        del is_moving
        model = identify(record, "receptance", 2).model
        values = np.concatenate([model.natural_frequencies, model.damping_ratios])
        return values, np.concatenate([model.natural_frequency_sd, model.damping_ratio_sd]), True


STUDIES = {
    "initial-motion": Study("start of 0 to 10 times the forced energy, one output", 400, ByTransferFunction),
    "initial-motion-common": Study("the same, common poles of two outputs", 200, ByCommonPoles),
    "initial-motion-modes": Study("the same, modal", 200, ByModes),
}
