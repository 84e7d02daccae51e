"""Outputs that share their poles, fitted together: the Rao-Garnier system and a second point, and two inputs."""

from __future__ import annotations

import functools
import time

import numpy as np

from beam_ident import (
    InputSignal,
    MultiInputModel,
    OutputSignal,
    TimeRecord,
    TransferFunctionModel,
    estimate_common_poles,
)
from benchmarks.ident.multi_input import MultiInput
from benchmarks.ident.study import AgainstBound, Outcome, Study
from tests.beam_ident import rao_garnier

_QUIET = 1e-3  # of the noise: what the covariance states there is the bound


class TwoOutputs(AgainstBound):
    """Each output at irregular stamps of its own, 10 dB; the poles and both numerators."""

    numerators = (rao_garnier.PARAMETERS[4:], np.array([30.0, -50.0, 900.0]))
    snr_db = 10.0

    def __init__(self) -> None:
        denominator = np.concatenate([[1.0], rao_garnier.PARAMETERS[:4]])
        self.drive = InputSignal("u", "", (0.0, rao_garnier.PERIOD_S), rao_garnier.prbs(2000))
        rng = np.random.default_rng(5)
        self.stamps = [np.sort(rng.uniform(0.01, 19.9, n)) for n in (1900, 1200)]
        self.clean = []
        for numerator, stamps in zip(self.numerators, self.stamps, strict=True):
            size = 5 + len(numerator)
            model = TransferFunctionModel(numerator, denominator, 0.0, np.zeros((size, size)), 0.0)
            self.clean.append(model.simulate(self.drive, stamps))
        self.truth = np.concatenate([rao_garnier.PARAMETERS[:4], *self.numerators])

    @functools.cached_property
    def bound(self) -> np.ndarray:
        """Standard deviations at the limit."""
        return self.estimate(10**6, _QUIET)[1] / _QUIET

    def estimate(self, seed: int, quiet: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
        """Return estimate and standard deviations from one record."""
        rng = np.random.default_rng(seed)
        outputs = []
        for name, stamps, clean in zip(("fast", "slow"), self.stamps, self.clean, strict=True):
            sigma = quiet * rao_garnier.noise_level(clean, self.snr_db)
            noisy = clean + sigma * rng.standard_normal(len(clean))
            outputs.append(OutputSignal(name, "", stamps, noisy))
        models = estimate_common_poles(TimeRecord((self.drive,), tuple(outputs)), 4, (1, 2)).models
        parts = [(models[0].parameters[:4], models[0].standard_deviations[:4])]
        parts += [(m.parameters[4:-1], m.standard_deviations[4:-1]) for m in models]
        return np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts])

    def run(self, seed: int) -> Outcome:
        """Estimate from one record."""
        start = time.perf_counter()
        estimate, sd = self.estimate(seed)
        return Outcome(time.perf_counter() - start, estimate, sd)


class TwoInputsTwoOutputs(AgainstBound):
    """A held PRBS and a slower joined input, two points at irregular stamps with gaps, 20 dB."""

    numerators = (([30.0, 20.0, 9000.0], [2.0, 60.0, 9000.0, 12000.0]), ([50.0, 4000.0], [900.0]))

    def __init__(self) -> None:
        inputs = MultiInput(has_common_poles=True)
        self.drives, self.stamps = inputs.drives, inputs.stamps
        names = tuple(drive.name for drive in self.drives)
        denominator = np.polymul([1.0, 0.8, 64.0], [1.0, 1.0, 400.0])
        self.clean, truth = [], [denominator[1:]]
        for numerators in self.numerators:
            parts = tuple(np.array(own) for own in numerators)
            size = 4 + sum(map(len, parts)) + 2
            model = MultiInputModel(parts, (denominator,), (0.0, 0.0), np.zeros((size, size)), 0.0, names)
            self.clean.append(model.simulate(self.drives, self.stamps))
            truth += parts
        self.truth = np.concatenate(truth)

    @functools.cached_property
    def bound(self) -> np.ndarray:
        """Standard deviations at the limit."""
        return self.estimate(10**6, _QUIET)[1] / _QUIET

    def record(self, seed: int, quiet: float = 1.0) -> TimeRecord:
        """Return a noisy record; ``quiet`` scales the noise."""
        rng = np.random.default_rng(seed)
        outputs = []
        for name, clean in zip(("near", "far"), self.clean, strict=True):
            noise = 0.1 * quiet * float(np.std(clean)) * rng.standard_normal(len(clean))
            outputs.append(OutputSignal(name, "m", self.stamps, clean + noise))
        return TimeRecord(self.drives, tuple(outputs))

    def estimate(self, seed: int, quiet: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
        """Return estimate and standard deviations from one record."""
        degrees = [[len(own) - 1 for own in parts] for parts in self.numerators]
        models = estimate_common_poles(self.record(seed, quiet), 4, degrees).models
        parts = [(models[0].parameters[:4], models[0].standard_deviations[:4])]
        parts += [(m.parameters[4:-2], m.standard_deviations[4:-2]) for m in models]
        return np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts])

    def run(self, seed: int) -> Outcome:
        """Estimate from one record."""
        start = time.perf_counter()
        estimate, sd = self.estimate(seed)
        return Outcome(time.perf_counter() - start, estimate, sd)


STUDIES = {
    "two-outputs": Study("two outputs, common poles, 10 dB", 400, TwoOutputs),
    "two-inputs-two-outputs": Study(
        "two inputs and two outputs, common poles, 20 dB", 200, TwoInputsTwoOutputs
    ),
}
