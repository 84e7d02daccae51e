"""Two forces on a free structure with three modes, each with a hold and a clock of its own, seen at three points."""

from __future__ import annotations

import time
from functools import cached_property

import numpy as np

from beam_ident import InputSignal, ModalModel, OutputSignal, TimeRecord, identify
from beam_ident.errors import EstimationError
from benchmarks.ident.study import AgainstBound, Outcome, Study

_QUIET = 1e-3  # of the noise: what the covariance states there is the bound


def flat(model: ModalModel) -> tuple[np.ndarray, np.ndarray]:
    """Return frequencies, damping ratios, residues and gains of a model, and their standard deviations."""
    parts = (model.natural_frequencies, model.damping_ratios, model.residues, model.gains)
    sds = (model.natural_frequency_sd, model.damping_ratio_sd, model.residue_sd, model.gain_sd)
    return np.concatenate([p.ravel() for p in parts]), np.concatenate([s.ravel() for s in sds])


class TwoForces(AgainstBound):
    """A held random force and one joined by lines; irregular stamps, 20 dB; the third mode answers to one alone."""

    noise = 0.1  # of an output's standard deviation

    def __init__(self) -> None:
        rng = np.random.default_rng(3)
        shapes = np.array([[1.0, 0.6, 0.4], [0.7, -0.5, 0.3], [0.3, -0.8, -0.6]])
        participations = np.array([[1.0, 0.7, 0.5], [-0.4, 0.9, 0.0]])
        residues = shapes[:, None, :] * participations
        size = 2 * 3 + 2 + 3 * 2 * 5
        self.model = ModalModel(
            "receptance",
            "shaker",
            ("p1", "p2", "p3"),
            2.0 * np.pi * np.array([3.0, 7.5, 16.0]),
            np.array([0.015, 0.01, 0.008]),
            residues,
            np.full((3, 2), 1e-5),
            np.zeros((3, 2)),
            0.0,
            0.0,
            np.zeros((size, size)),
            np.ones(3),
            further_inputs=("hammer",),
        )
        self.drives = (
            InputSignal("shaker", "N", (0.0, 0.02), rng.standard_normal(760), "zoh"),
            InputSignal("hammer", "N", (0.0, 0.011), rng.standard_normal(1380), "linear"),
        )
        self.stamps = 0.01 * np.arange(1, 1500) + rng.uniform(-0.002, 0.002, 1499)
        self.clean = self.model.simulate(self.drives, self.stamps)
        self.truth = flat(self.model)[0][: 3 + 3 + 18]

    def record(self, seed: int, quiet: float = 1.0) -> TimeRecord:
        """Return a noisy record; ``quiet`` scales the noise."""
        rng = np.random.default_rng(seed)
        sd = quiet * self.noise * np.std(self.clean, axis=0)
        values = self.clean + sd * rng.standard_normal(self.clean.shape)
        names = self.model.output_names
        outputs = [OutputSignal(n, "m", self.stamps, values[:, j]) for j, n in enumerate(names)]
        return TimeRecord(self.drives, tuple(outputs))

    @cached_property
    def bound(self) -> np.ndarray:
        """Standard deviations at the limit."""
        found = identify(self.record(10**6, _QUIET), "receptance", n_modes=3).model
        return flat(found)[1][: len(self.truth)] / _QUIET

    def run(self, seed: int) -> Outcome:
        """Identify one record; another number of modes is a failure."""
        record = self.record(seed)
        start = time.perf_counter()
        try:
            model = identify(record, "receptance").model
        except EstimationError:
            return Outcome(time.perf_counter() - start)
        seconds = time.perf_counter() - start
        if model.n_modes != 3:
            return Outcome(seconds)
        estimate, sd = (own[: len(self.truth)] for own in flat(model))
        return Outcome(seconds, estimate, sd)


STUDIES = {"two-inputs-modes": Study("three modes under two forces, 20 dB", 200, TwoForces)}
