"""Two records in one fit: Rao-Garnier cut in two, a quiet and a loud part with offsets of their own."""

from __future__ import annotations

import time

import numpy as np

from beam_ident import (
    InputSignal,
    OutputSignal,
    TimeRecord,
    TransferFunctionModel,
    estimate_common_poles,
    estimate_transfer_function,
)
from benchmarks.ident.study import AgainstBound, Outcome, Study
from tests.beam_ident import rao_garnier

PERIOD_S = rao_garnier.PERIOD_S
_CUT = 1000  # of 2000 samples
_OFFSETS = (40.0, -250.0)
_START_S = 37.2  # of the second record, on a clock of its own
_STEP = 1e-5  # of a parameter, for central differences


class TwoRecords(AgainstBound):
    """The six coefficients from two records of ten seconds, the second in motion when it begins.

    The first is seen at a regular clock, the second at stamps of any spacing, with three times the noise.

    Parameters
    ----------
    snr_db : float -- of the first record; the second has 9.5 dB less
    has_common_poles : bool -- estimate by `estimate_common_poles`
    """

    def __init__(self, snr_db: float = 10.0, has_common_poles: bool = False) -> None:
        self.has_common_poles = has_common_poles
        self.drive = rao_garnier.prbs(2000)
        rng = np.random.default_rng(3)
        self.stamps = (
            PERIOD_S * np.arange(_CUT),
            PERIOD_S * _CUT + np.sort(rng.uniform(0.0, PERIOD_S * (_CUT - 1), 1100)),
        )
        self.truth = rao_garnier.PARAMETERS
        self.clean = self._responses(self.truth)
        quiet = rao_garnier.noise_level(self.clean[0], snr_db)
        self.sigmas = (quiet, 3.0 * quiet)
        self.bound = self._limit()

    def _responses(self, parameters: np.ndarray) -> list[np.ndarray]:
        denominator = np.concatenate([[1.0], parameters[:4]])
        model = TransferFunctionModel(parameters[4:], denominator, 0.0, np.zeros((7, 7)), 0.0)
        whole = InputSignal("u", "", (0.0, PERIOD_S), self.drive)
        return [model.simulate(whole, stamps) for stamps in self.stamps]

    def _limit(self) -> np.ndarray:
        """Return the joint bound, with an unknown offset and an unknown initial state in both records."""
        slopes = []
        for i, value in enumerate(self.truth):
            step = np.zeros(6)
            step[i] = _STEP * abs(value)
            ahead, behind = self._responses(self.truth + step), self._responses(self.truth - step)
            slopes.append([(a - b) / (2.0 * step[i]) for a, b in zip(ahead, behind, strict=True)])
        poles = np.roots(np.concatenate([[1.0], self.truth[:4]]))
        poles = poles[poles.imag > 0.0]
        information = np.zeros((6, 6))
        for record, (stamps, sigma) in enumerate(zip(self.stamps, self.sigmas, strict=True)):
            columns = np.stack([own[record] for own in slopes], axis=1)
            decays = np.exp(np.outer(stamps - stamps[0], poles))
            own = np.linalg.qr(np.column_stack([np.ones_like(stamps), decays.real, decays.imag]))[0]
            columns = (columns - own @ (own.T @ columns)) / sigma
            information += columns.T @ columns
        return np.sqrt(np.diag(np.linalg.inv(information)))

    def records(self, seed: int) -> tuple[TimeRecord, TimeRecord]:
        """Return the two noisy records of one seed."""
        rng = np.random.default_rng(seed)
        made = []
        parts = zip(self.stamps, self.clean, self.sigmas, _OFFSETS, (0.0, _START_S), strict=True)
        for number, (stamps, clean, sigma, offset, start) in enumerate(parts):
            first = number * _CUT
            shift = start - PERIOD_S * first
            held = self.drive[first : first + _CUT]
            drive = InputSignal("u", "V", (start, PERIOD_S), held)
            noisy = clean + offset + sigma * rng.standard_normal(len(clean))
            output = OutputSignal("y", "m", stamps + shift, noisy)
            made.append(TimeRecord((drive,), (output,), name=("quiet", "loud")[number]))
        return made[0], made[1]

    def run(self, seed: int) -> Outcome:
        """Estimate from both records of one seed."""
        records = self.records(seed)
        start = time.perf_counter()
        if self.has_common_poles:
            joint = estimate_common_poles(records, 4, 1, has_offset=True, has_free_response=True)
            model, converged = joint.models[0], joint.converged
        else:
            found = estimate_transfer_function(records, 4, 1, has_offset=True, has_free_response=True)
            model, converged = found.model, found.converged
        seconds = time.perf_counter() - start
        if not converged:
            return Outcome(seconds)
        return Outcome(seconds, model.parameters[:6], model.standard_deviations[:6])


STUDIES = {
    "two-records": Study("Rao-Garnier in two records of different noise", 1000, TwoRecords),
    "two-records-common-poles": Study(
        "the same by the estimator of common poles", 200, lambda: TwoRecords(has_common_poles=True)
    ),
}
