"""The lightly damped beam as one transfer function, from no start: what subspace starts are for."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from beam_ident import estimate_transfer_function, subspace_model
from benchmarks.ident.forced_beam import ForcedBeam
from benchmarks.ident.study import AgainstBound, Outcome, Study


class StartCase(AgainstBound):
    """Frequencies and damping ratios at one point; beside them, how near the subspace alone came."""

    def __init__(self, snr_db: float, point: str) -> None:
        self.beam, self.snr_db, self.point = ForcedBeam(), snr_db, point
        self.truth = self.beam.truth
        quiet = estimate_transfer_function(self.beam.record(10**6, snr_db, quiet=1e-3).select([point]), 6, 4)
        self.bound = 1e3 * np.concatenate(quiet.model.modes()[2:])

    def run(self, seed: int) -> Outcome:
        """Identify one record with its numbers of poles and zeros given."""
        record = self.beam.record(seed, self.snr_db).select([self.point])
        start = time.perf_counter()
        found = estimate_transfer_function(record, 6, 4)
        seconds = time.perf_counter() - start
        start_omegas = subspace_model(record, 6).natural_frequencies
        is_near = len(start_omegas) == 3 and np.allclose(start_omegas, self.beam.omegas, rtol=0.03)
        figures = {"subspace is near": float(is_near)}
        omega, zeta, omega_sd, zeta_sd = found.model.modes()
        if len(omega) != 3:
            return Outcome(seconds, figures=figures)
        estimate, sd = np.concatenate([omega, zeta]), np.concatenate([omega_sd, zeta_sd])
        return Outcome(seconds, estimate, sd, figures)

    def summarise(self, outcomes: list[Outcome]) -> dict[str, Any]:
        """Return the figures against the bound, and how often the subspace alone was within 3 %."""
        near = np.mean([o.figures["subspace is near"] for o in outcomes])
        return super().summarise(outcomes) | {"subspace within 3 %": f"{100.0 * near:.1f} %"}


STUDIES = {
    f"start-{point}-{snr}": Study(
        f"transfer function from no start, {point} {snr} dB",
        400,
        lambda snr=snr, point=point: StartCase(float(snr), point),
    )
    for point in ("tip", "root")
    for snr in (20, 10, 0)
}
