"""A beam of six modes under force: order twelve, without a hint."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from beam_ident import identify
from benchmarks.ident.forced_beam import PLAIN, ForcedBeam
from benchmarks.ident.study import AgainstBound, Outcome, Study


class SixModeBeam(ForcedBeam):
    """The forced beam with three modes more, 500 samples a second, swept to 220 Hz."""

    omegas = 2.0 * np.pi * np.array([2.3, 14.4, 40.0, 79.0, 130.0, 195.0])
    zetas = np.array([0.02, 0.01, 0.005, 0.005, 0.004, 0.004])
    gains = np.array([[1.0, -0.25, 0.08, -0.04, 0.025, -0.015], [0.05, 0.08, -0.06, 0.05, -0.03, 0.02]])
    period = 0.002
    n = 25000
    sweep_hz = (0.5, 220.0)


class SixModesCase(AgainstBound):
    """All poles, and the share of the noise that is left in the residuals."""

    def __init__(self, snr_db: float) -> None:
        self.beam, self.snr_db = SixModeBeam(), snr_db
        self.truth = self.beam.truth
        quiet = identify(self.beam.record(10**6, snr_db, quiet=1e-3), PLAIN, 6).model
        self.bound = 1e3 * np.concatenate([quiet.natural_frequency_sd, quiet.damping_ratio_sd])

    def run(self, seed: int) -> Outcome:
        """Identify one record; another number of modes, or residuals unlike the noise, is a failure."""
        record = self.beam.record(seed, self.snr_db)
        exact = self.beam.record(seed, self.snr_db, quiet=0.0)
        start = time.perf_counter()
        found = identify(record, PLAIN)
        seconds = time.perf_counter() - start
        shares = [
            float(np.var(fit.residuals) / np.var(noisy.values - clean.values))
            for fit, noisy, clean in zip(found.outputs, record.outputs, exact.outputs, strict=True)
        ]
        figures = {"lowest": min(shares), "highest": max(shares)}
        model = found.model
        if model.n_modes != 6 or not (min(shares) >= 0.99 and max(shares) <= 1.001):
            return Outcome(seconds, figures=figures)
        return Outcome(
            seconds,
            np.concatenate([model.natural_frequencies, model.damping_ratios]),
            np.concatenate([model.natural_frequency_sd, model.damping_ratio_sd]),
            figures,
        )

    def summarise(self, outcomes: list[Outcome]) -> dict[str, Any]:
        """Add the extremes of the residual variance over that of the realised noise."""
        shares = [min(o.figures["lowest"] for o in outcomes), max(o.figures["highest"] for o in outcomes)]
        return super().summarise(outcomes) | {"residual over noise": [round(s, 5) for s in shares]}


STUDIES = {
    f"six-modes-{snr}": Study(
        f"twelfth order, six modes, {snr} dB", 400, lambda snr=snr: SixModesCase(float(snr))
    )
    for snr in (40, 20)
}
