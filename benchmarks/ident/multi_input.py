"""Two inputs and one output: with common poles, and with poles of their own."""

from __future__ import annotations

import functools
import time

import numpy as np
from scipy.signal import max_len_seq

from beam_ident import InputSignal, MultiInputModel, OutputSignal, TimeRecord, estimate_transfer_function
from benchmarks.ident.study import AgainstBound, Outcome, Study

_QUIET = 1e-3  # of the noise: what the covariance states there is the bound


class MultiInput(AgainstBound):
    """A held PRBS and a slower, linearly joined random input on a clock of its own; 20 dB."""

    period = 0.01
    n = 2000

    def __init__(self, has_common_poles: bool) -> None:
        rng = np.random.default_rng(11)
        fast = np.repeat(2.0 * max_len_seq(10)[0] - 1.0, 4)[: self.n]
        slow = rng.standard_normal(int(self.n * self.period / 0.037) + 3)
        self.drives = (
            InputSignal("force", "N", (0.0, self.period), fast, "zoh"),
            InputSignal("base", "m", (0.0, 0.037), slow, "linear"),
        )
        first = np.polymul([1.0, 0.8, 64.0], [1.0, 1.0, 400.0])
        second = np.array([1.0, 2.0, 150.0])
        self.n_poles: int | tuple[int, ...] = 4 if has_common_poles else (4, 2)
        numerators = (
            np.array([30.0, 20.0, 9000.0]),
            np.array([40.0, 5000.0] if has_common_poles else [300.0]),
        )
        if has_common_poles:
            numerators = (numerators[0], np.array([2.0, 60.0, 9000.0, 12000.0]))
        denominators = (first,) if has_common_poles else (first, second)
        size = sum(len(a) - 1 for a in denominators) + sum(len(b) for b in numerators) + 2
        truth = MultiInputModel(
            numerators, denominators, (0.0, 0.0), np.zeros((size, size)), 0.0, ("force", "base")
        )
        self.n_zeros = tuple(len(b) - 1 for b in numerators)
        self.estimated = size - 2
        self.truth = truth.parameters[: self.estimated]
        # The camera's stamps scatter, and a tenth of them is lost.
        stamps = self.period * (np.arange(1, self.n - 20) + rng.uniform(-0.2, 0.2, self.n - 21))
        self.stamps = stamps[rng.uniform(size=len(stamps)) > 0.1]
        self.clean = truth.simulate(self.drives, self.stamps)
        self.noise_sd = float(np.std(self.clean)) / 10.0

    @functools.cached_property
    def bound(self) -> np.ndarray:
        """Standard deviations at the limit."""
        quiet = self.estimate(self.record(10**6, _QUIET))
        return quiet.standard_deviations[: self.estimated] / _QUIET

    def record(self, seed: int, quiet: float = 1.0) -> TimeRecord:
        """Return a noisy record; ``quiet`` scales the noise."""
        noise = quiet * self.noise_sd * np.random.default_rng(seed).standard_normal(len(self.clean))
        return TimeRecord(self.drives, (OutputSignal("y", "m", self.stamps, self.clean + noise),))

    def estimate(self, record: TimeRecord) -> MultiInputModel:
        """Estimate both transfer functions together, degrees given."""
        return estimate_transfer_function(record, self.n_poles, self.n_zeros).model

    def run(self, seed: int) -> Outcome:
        """Estimate from one record."""
        record = self.record(seed)
        start = time.perf_counter()
        model = self.estimate(record)
        seconds = time.perf_counter() - start
        k = self.estimated
        return Outcome(seconds, model.parameters[:k], model.standard_deviations[:k])


STUDIES = {
    "two-inputs": Study("two inputs, common poles, 20 dB", 400, lambda: MultiInput(True)),
    "two-inputs-own-poles": Study("two inputs, poles of their own, 20 dB", 400, lambda: MultiInput(False)),
}
