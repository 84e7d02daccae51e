"""Whether the right orders are chosen: systems with a true order, and beams that have none."""

from __future__ import annotations

import collections
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.signal import cont2discrete, lfilter, max_len_seq

from beam_ident import (
    EstimationError,
    InputSignal,
    OutputSignal,
    TimeRecord,
    identify,
    select_transfer_function,
)
from benchmarks.ident.forced_beam import PLAIN, ForcedBeam
from benchmarks.ident.rig import Rig
from benchmarks.ident.study import Outcome, Study
from tests.beam_ident import rao_garnier

SNRS_DB = (20.0, 5.0)


def second_order(seed: int, snr_db: float) -> TimeRecord:
    """Return a record of one resonance with a zero."""
    return _record([12.0, 100.0], np.poly([-1.0 + 9.9j, -1.0 - 9.9j]), 0.02, 1500, 4, seed, snr_db)


def sixth_order(seed: int, snr_db: float) -> TimeRecord:
    """Return a record of three modes at 1.5, 4 and 9 Hz whose residues alternate."""
    omegas, zetas = 2.0 * np.pi * np.array([1.5, 4.0, 9.0]), np.array([0.04, 0.03, 0.02])
    factors = [np.array([1.0, 2.0 * z * w, w * w]) for w, z in zip(omegas, zetas, strict=True)]
    numerator = np.zeros(1)
    for residue, k in zip((1.0, -0.6, 0.5), range(3), strict=True):
        others = np.convolve(*(f for i, f in enumerate(factors) if i != k))
        numerator = np.polyadd(numerator, residue * omegas[k] ** 2 * others)
    denominator = np.convolve(np.convolve(factors[0], factors[1]), factors[2])
    return _record(numerator, denominator, 0.01, 2500, 2, seed, snr_db)


def _record(
    numerator: Any, denominator: np.ndarray, period: float, n: int, width: int, seed: int, snr_db: float
) -> TimeRecord:
    drive = np.resize(np.repeat(2.0 * max_len_seq(11)[0] - 1.0, width), n)
    above, below, _ = cont2discrete((numerator, denominator), period, "zoh")
    clean = lfilter(above[0], below, drive)
    noise = np.std(clean) / 10 ** (snr_db / 20) * np.random.default_rng(seed).standard_normal(n)
    return TimeRecord(
        (InputSignal("u", "", (0.0, period), drive),), (OutputSignal("y", "", (0.0, period), clean + noise),)
    )


class DegreesCase:
    """Degrees of a transfer function from a whole range, without a hint."""

    def __init__(
        self, make: Callable[[int, float], TimeRecord], snr_db: float, degrees: tuple[int, int], most: int
    ) -> None:
        self.make, self.snr_db, self.degrees, self.most = make, snr_db, degrees, most

    def run(self, seed: int) -> Outcome:
        """Choose the degrees for one record; YIC's favourite goes along."""
        record = self.make(seed, self.snr_db)
        start = time.perf_counter()
        try:
            selection = select_transfer_function(record, range(1, self.most + 1))
        except EstimationError:
            return Outcome(time.perf_counter() - start, figures={"poles": 0, "zeros": 0, "by YIC": 0})
        seconds = time.perf_counter() - start
        model = selection.chosen.model
        by_yic = min((e for e in selection.table if np.isfinite(e.yic)), key=lambda e: e.yic)
        figures = {
            "poles": model.n_poles,
            "zeros": len(model.numerator) - 1,
            "by YIC": float((by_yic.n_poles, by_yic.n_zeros) == self.degrees),
        }
        return Outcome(seconds, figures=figures)

    def summarise(self, outcomes: list[Outcome]) -> dict[str, Any]:
        """Return the share of right choices, by BIC with the gates and by YIC, and what was chosen else."""
        chosen = collections.Counter((int(o.figures["poles"]), int(o.figures["zeros"])) for o in outcomes)
        others = [f"{n}/{m} x {k}" for (n, m), k in chosen.most_common() if (n, m) != self.degrees]
        return {
            "right %": round(100.0 * chosen[self.degrees] / len(outcomes), 1),
            "right by YIC %": round(100.0 * float(np.mean([o.figures["by YIC"] for o in outcomes])), 1),
            "chosen else": ", ".join(others[:4]) or "none",
        }


class ModesCase:
    """Modes of a beam, which has more of them than are excited: all that are, and nothing else."""

    def __init__(self, identified: Callable[[int], np.ndarray], omegas: np.ndarray) -> None:
        self.identified, self.omegas = identified, omegas

    def run(self, seed: int) -> Outcome:
        """Compare the natural frequencies that were found with those excited, to 2 %."""
        start = time.perf_counter()
        found = np.sort(self.identified(seed))
        seconds = time.perf_counter() - start
        near = np.abs(found[:, None] / self.omegas - 1.0) < 0.02
        missed = float(np.count_nonzero(~near.any(axis=0)))
        spurious = float(len(found) - np.count_nonzero(near.any(axis=1)))
        return Outcome(seconds, figures={"missed": missed, "spurious": spurious})

    def summarise(self, outcomes: list[Outcome]) -> dict[str, Any]:
        """Return the share of records with all modes and no other."""
        missed = np.array([o.figures["missed"] for o in outcomes])
        spurious = np.array([o.figures["spurious"] for o in outcomes])
        return {
            "right %": round(100.0 * float(np.mean((missed == 0) & (spurious == 0))), 1),
            "modes missed": int(missed.sum()),
            "spurious": int(spurious.sum()),
        }


def forced_beam(snr_db: float) -> ModesCase:
    """Return the case of three modes under force, of which all are excited."""
    beam = ForcedBeam()
    return ModesCase(
        lambda seed: identify(beam.record(seed, snr_db), PLAIN).model.natural_frequencies, beam.omegas
    )


def rig() -> ModesCase:
    """Return the case of the rig, whose physics has 14 modes, three of them below the chirp's end."""
    room = Rig()
    return ModesCase(
        lambda seed: identify(room.record(seed)).model.natural_frequencies,
        room.full.natural_frequencies[:3],
    )


STUDIES = {
    **{
        f"orders-{name}-{snr:.0f}": Study(
            f"orders, {title} {snr:.0f} dB",
            200,
            lambda make=make, snr=snr, degrees=degrees, most=most: DegreesCase(make, snr, degrees, most),
        )
        for name, title, make, degrees, most in (
            ("second", "second order", second_order, (2, 1), 4),
            ("rao-garnier", "Rao-Garnier", rao_garnier.benchmark_record, (4, 1), 6),
            ("sixth", "sixth order", sixth_order, (6, 4), 7),
        )
        for snr in SNRS_DB
    },
    "orders-beam-20": Study("modes, forced beam 20 dB", 200, lambda: forced_beam(20.0)),
    "orders-beam-5": Study("modes, forced beam 5 dB", 200, lambda: forced_beam(5.0)),
    "orders-rig": Study("modes, rig", 200, rig),
}
