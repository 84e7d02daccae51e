"""Accuracy of the identification in units of the Cramer-Rao bound, study by study.

    python benchmarks/ident.py [STUDY ...] [--runs N] [--json FILE]

Every study simulates seeded records with a known truth, identifies them without hints
and prints one line of a table: failures, efficiency (bound over mean-square error, 1 is
the limit; its own scatter is sqrt(2 / runs)), coverage of the 95 % intervals, the largest
|z| and the median time.  Set OPENBLAS_NUM_THREADS=1 for times that mean something.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import lfilter

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from beam_ident import (
    InputSignal,
    LogChirp,
    ModalModel,
    ModalStructure,
    OutputSignal,
    Prior,
    TimeRecord,
    estimate_transfer_function,
    identify,
)
from beam_model import BeamModel, BeamParameters, Damping
from tests.beam_ident import rao_garnier

FREE, FIXED = Prior(0.0, np.inf), Prior(0.0, 0.0)


class Tally:
    """Errors, stated standard deviations and times of one study."""

    def __init__(self, bound: np.ndarray) -> None:
        self.bound = bound
        self.errors: list[np.ndarray] = []
        self.scores: list[np.ndarray] = []
        self.times: list[float] = []
        self.failures = 0

    def add(
        self, estimate: np.ndarray | None, truth: np.ndarray, sd: np.ndarray | None, seconds: float
    ) -> None:
        """Note one run; an estimate of None is a failure."""
        self.times.append(seconds)
        if estimate is None or sd is None or np.any(np.abs(estimate - truth) > 10.0 * self.bound):
            self.failures += 1
            return
        self.errors.append(estimate - truth)
        self.scores.append((estimate - truth) / sd)

    def line(self, name: str) -> dict[str, Any]:
        """Return the study's figures."""
        efficiency = self.bound**2 / np.mean(np.square(self.errors), axis=0)
        scores = np.abs(self.scores)
        return {
            "study": name,
            "runs": len(self.times),
            "failures": self.failures,
            "efficiency": [round(float(e), 3) for e in efficiency],
            "coverage": round(float(np.mean(scores < 1.96)), 4),
            "worst coverage": round(float(np.min(np.mean(scores < 1.96, axis=0))), 4),
            "max |z|": round(float(np.max(scores)), 2),
            "median s": round(float(np.median(self.times)), 4),
        }


def rao_garnier_study(snr_db: float) -> Callable[[int], dict[str, Any]]:
    """Return the study of the Rao-Garnier benchmark at one signal-to-noise ratio."""

    def study(runs: int) -> dict[str, Any]:
        drive = rao_garnier.prbs(2000)
        level = rao_garnier.noise_level(rao_garnier.response(drive), snr_db)
        tally = Tally(rao_garnier.bound(drive, level))
        for seed in range(runs):
            record = rao_garnier.benchmark_record(seed, snr_db)
            start = time.perf_counter()
            found = estimate_transfer_function(record, 4, 1)
            seconds = time.perf_counter() - start
            sd = found.model.standard_deviations[:6]
            tally.add(
                found.model.parameters[:6] if found.converged else None, rao_garnier.PARAMETERS, sd, seconds
            )
        return tally.line(f"Rao-Garnier {snr_db:.0f} dB")

    return study


class ForcedBeam:
    """The three-mode beam under force: 2.3, 14.4 and 40 Hz, 200 samples a second, two points."""

    omegas = 2.0 * np.pi * np.array([2.3, 14.4, 40.0])
    zetas = np.array([0.02, 0.01, 0.005])
    gains = np.array([[1.0, -0.25, 0.08], [0.05, 0.08, -0.06]])
    period = 0.005
    n = 10000
    names = ("tip", "root")

    def __init__(self) -> None:
        times = self.period * np.arange(self.n)
        phase = 2.0 * np.pi * (0.5 * times + 0.5 * 49.5 / times[-1] * times**2)
        self.drive = InputSignal("force", "N", (0.0, self.period), np.sin(phase), "zoh")
        size = 2 * 3 + 2 + 2 * 5
        self.model = ModalModel(
            "receptance",
            "force",
            self.names,
            self.omegas,
            self.zetas,
            self.gains * self.omegas**2,
            np.zeros(2),
            np.zeros(2),
            0.0,
            0.0,
            np.zeros((size, size)),
            np.ones(2),
        )
        self.truth = np.concatenate([self.omegas, self.zetas])

    def record(
        self,
        seed: int,
        snr_db: float,
        stamps: np.ndarray | None = None,
        true_times: np.ndarray | None = None,
        drift: tuple[float, float] = (0.0, 0.0),
        start_s: float = 0.0,
        quiet: float = 1.0,
    ) -> TimeRecord:
        """Return a noisy record; ``quiet`` scales the noise, for the bound."""
        if stamps is None:
            stamps = self.period * np.arange(self.n)
        clean = self.model.simulate(self.drive, stamps if true_times is None else true_times)
        sigma = np.std(clean, axis=0) / 10 ** (snr_db / 20)
        noisy = clean + quiet * sigma * np.random.default_rng(seed).standard_normal(clean.shape)
        noisy = noisy + sigma * (drift[0] + drift[1] * (stamps / stamps[-1])[:, None])
        outputs = tuple(OutputSignal(name, "m", stamps, noisy[:, j]) for j, name in enumerate(self.names))
        record = TimeRecord((self.drive,), outputs)
        return record if start_s == 0.0 else record.between(start_s, 1e9)


PLAIN = ModalStructure("receptance", False, False, False, False)
DRIFTING = ModalStructure("receptance", False, True, True, True)


def forced_beam_study(
    name: str,
    structure: ModalStructure,
    clock: tuple[Prior, Prior],
    make: Callable[[ForcedBeam, int, float], TimeRecord],
) -> Callable[[int], dict[str, Any]]:
    """Return a study on the forced beam."""

    def study(runs: int) -> dict[str, Any]:
        beam = ForcedBeam()
        quiet = identify(make(beam, 10**6, 1e-3), structure, 3, *clock).model
        tally = Tally(1e3 * np.concatenate([quiet.natural_frequency_sd, quiet.damping_ratio_sd]))
        for seed in range(runs):
            record = make(beam, seed, 1.0)
            start = time.perf_counter()
            model = identify(record, structure, None, *clock).model
            seconds = time.perf_counter() - start
            fits = model.n_modes == 3
            estimate = np.concatenate([model.natural_frequencies, model.damping_ratios]) if fits else None
            sd = np.concatenate([model.natural_frequency_sd, model.damping_ratio_sd])
            tally.add(estimate, beam.truth, sd if fits else None, seconds)
        return tally.line(name)

    return study


def jittered(snr_db: float) -> Callable[[ForcedBeam, int, float], TimeRecord]:
    """Return records whose stamps scatter by a tenth of the period."""

    def make(beam: ForcedBeam, seed: int, quiet: float) -> TimeRecord:
        scatter = np.random.default_rng(77).uniform(-0.1, 0.1, beam.n)
        stamps = np.clip(beam.period * (np.arange(beam.n) + scatter), 0.0, None)
        stamps[0] = 0.0
        return beam.record(seed, snr_db, stamps, quiet=quiet)

    return make


def foreign_clock(beam: ForcedBeam, seed: int, quiet: float) -> TimeRecord:
    """Return records of a camera that is 2 ms late, runs fast by 0.1 % and drops ten frames."""
    times = beam.period * np.arange(10, beam.n - 30)
    dropped = np.random.default_rng(5).choice(len(times), 10, replace=False)
    times = np.delete(times, dropped)
    middle = 0.5 * (times[0] + times[-1])
    stamps = middle + 2e-3 + (times - middle) * 1.001
    return beam.record(seed, 20.0, stamps, times, quiet=quiet)


class Rig:
    """The default rig from its physics: 14 modes, hub held at 1 kHz, three points, 100 frames a second."""

    heights = (0.010, 0.225, 0.285)
    names = ("z010", "z225", "z285")
    exposure = 5e-3

    def __init__(self) -> None:
        parameters = BeamParameters.from_section(
            0.30,
            0.025,
            0.0005,
            7850.0,
            200e9,
            hub_mass=0.8,
            gravity="upright",
            damping=Damping(ratios=(0.005,)),
        )
        model = BeamModel(parameters, n_modes=14)
        heights = np.array(self.heights)
        residues = np.asarray(model.motion_residues(heights))
        size = 2 * 14 + 2 + 3 * 16
        self.full = ModalModel(
            "acceleration",
            "hub",
            self.names,
            model.natural_frequencies[:14],
            np.full(14, 0.005),
            residues,
            np.asarray(model.residual_terms(heights)),
            np.ones(3),
            0.0,
            0.0,
            np.zeros((size, size)),
            np.ones(3),
        )
        self.excitation = LogChirp().sample()
        self.stamps = 0.01 * np.arange(1, 2999)
        self.clean = self.full.simulate(
            self.excitation.input_signal("acceleration"), self.stamps, self.exposure
        )
        self.truth = np.concatenate(
            [self.full.natural_frequencies[:3], np.full(3, 0.005), residues[:, :3].ravel()]
        )

    def record(self, seed: int, quiet: float, encoder: float, colour: float) -> TimeRecord:
        """Return a record with camera noise of 5 um, an encoder's noise [m] and a colour of AR(1)."""
        rng = np.random.default_rng(seed)
        positions = self.excitation.positions
        if encoder > 2e-7:
            positions = positions + encoder * rng.standard_normal(len(positions))
        else:
            positions = encoder * np.round(positions / encoder + rng.uniform(-0.5, 0.5))
        sigma = encoder if encoder > 2e-7 else encoder / np.sqrt(12.0)
        drive = InputSignal("hub", "m", (0.0, 1e-3), positions, "cubic", sigma)
        white = rng.standard_normal((self.clean.shape[0] + 200, 3))
        noise = np.sqrt(1.0 - colour**2) * lfilter([1.0], [1.0, -colour], white, axis=0)[200:]
        values = self.clean + 5e-6 * quiet * noise
        outputs = [
            OutputSignal(n, "m", self.stamps, values[:, j], self.exposure) for j, n in enumerate(self.names)
        ]
        return TimeRecord((drive,), tuple(outputs))


def rig_study(name: str, encoder: float, colour: float) -> Callable[[int], dict[str, Any]]:
    """Return a study on the rig; the bound is that of white noise and an exact hub."""

    def study(runs: int) -> dict[str, Any]:
        rig = Rig()

        def flat(model: ModalModel) -> tuple[np.ndarray, np.ndarray]:
            parts = (model.natural_frequencies, model.damping_ratios, model.residues.ravel())
            sds = (model.natural_frequency_sd, model.damping_ratio_sd, model.residue_sd.ravel())
            return np.concatenate(parts), np.concatenate(sds)

        white = rig.record(10**6, 1.0, 1e-7, 0.0)
        tally = Tally(flat(identify(white, n_modes=3).model)[1])
        for seed in range(runs):
            record = rig.record(seed, 1.0, encoder, colour)
            start = time.perf_counter()
            model = identify(record).model
            seconds = time.perf_counter() - start
            if model.n_modes == 3:
                estimate, sd = flat(model)
                tally.add(estimate, rig.truth, sd, seconds)
            else:
                tally.add(None, rig.truth, None, seconds)
        return tally.line(name)

    return study


STUDIES: dict[str, tuple[int, Callable[[int], dict[str, Any]]]] = {
    "rao-garnier-10": (300, rao_garnier_study(10.0)),
    "rao-garnier-0": (300, rao_garnier_study(0.0)),
    **{
        f"beam-{snr:.0f}": (
            200,
            forced_beam_study(
                f"forced beam {snr:.0f} dB",
                PLAIN,
                (FIXED, FIXED),
                lambda beam, seed, quiet, snr=snr: beam.record(seed, snr, quiet=quiet),
            ),
        )
        for snr in (20.0, 10.0, 0.0)
    },
    "jitter-40": (100, forced_beam_study("jittered stamps 40 dB", PLAIN, (FIXED, FIXED), jittered(40.0))),
    "jitter-60": (100, forced_beam_study("jittered stamps 60 dB", PLAIN, (FIXED, FIXED), jittered(60.0))),
    "start": (
        100,
        forced_beam_study(
            "unknown start, offset and ramp 20 dB",
            DRIFTING,
            (FIXED, FIXED),
            lambda beam, seed, quiet: beam.record(seed, 20.0, drift=(20.0, 30.0), start_s=3.0, quiet=quiet),
        ),
    ),
    "clock": (
        100,
        forced_beam_study(
            "2 ms late, 0.1 % fast, 10 frames dropped 20 dB", PLAIN, (FREE, FREE), foreign_clock
        ),
    ),
    "rig": (100, rig_study("rig, 0.1 um encoder, white camera noise", 1e-7, 0.0)),
    "rig-colour": (100, rig_study("rig, camera noise AR(1) of 0.7", 1e-7, 0.7)),
    "rig-encoder": (50, rig_study("rig, 1 um of encoder noise", 1e-6, 0.0)),
}


def main() -> int:
    """Run the studies named on the command line, or all."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "studies", nargs="*", choices=[[], *STUDIES], metavar="STUDY", help=", ".join(STUDIES)
    )
    parser.add_argument("--runs", type=int, help="runs per study instead of each study's own number")
    parser.add_argument("--json", type=Path, help="write all figures to this file")
    arguments = parser.parse_args()
    lines = []
    for name in arguments.studies or STUDIES:
        runs, study = STUDIES[name]
        lines.append(study(arguments.runs or runs))
        print("| " + " | ".join(str(value) for value in lines[-1].values()) + " |", flush=True)
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(lines, indent=2) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
