"""The Rao-Garnier benchmark, fourth order with a fast and a slow mode."""

from __future__ import annotations

import time

from beam_ident import estimate_transfer_function
from benchmarks.ident.study import AgainstBound, Outcome, Study
from tests.beam_ident import rao_garnier


class RaoGarnier(AgainstBound):
    """2000 samples at one signal-to-noise ratio; the six coefficients."""

    def __init__(self, snr_db: float) -> None:
        self.snr_db = snr_db
        drive = rao_garnier.prbs(2000)
        self.truth = rao_garnier.PARAMETERS
        self.bound = rao_garnier.bound(drive, rao_garnier.noise_level(rao_garnier.response(drive), snr_db))

    def run(self, seed: int) -> Outcome:
        """Identify one record, with its numbers of poles and zeros given."""
        record = rao_garnier.benchmark_record(seed, self.snr_db)
        start = time.perf_counter()
        found = estimate_transfer_function(record, 4, 1)
        seconds = time.perf_counter() - start
        if not found.converged:
            return Outcome(seconds)
        return Outcome(seconds, found.model.parameters[:6], found.model.standard_deviations[:6])


STUDIES = {
    "rao-garnier-10": Study("Rao-Garnier 10 dB", 2000, lambda: RaoGarnier(10.0)),
    "rao-garnier-0": Study("Rao-Garnier 0 dB", 2000, lambda: RaoGarnier(0.0)),
}
