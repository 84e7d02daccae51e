"""Time and memory of an identification against the length of its record.

    python -m benchmarks.ident_cost [--tasks TASK ...] [--sizes N ...] [--repeats N] [--json FILE]

Every size runs in a process of its own, whose peak of resident memory is read at its end; what the
imports alone take stands in the first line.  Times are processor seconds, so that a busy machine
disturbs them little; the best of the repeats counts.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from beam_ident import InputSignal, OutputSignal, TimeRecord, estimate_transfer_function, identify
from benchmarks.ident.forced_beam import PLAIN, ForcedBeam
from benchmarks.ident.rig import Rig
from tests.beam_ident import rao_garnier

SIZES = (1_000, 3_000, 10_000, 30_000, 100_000, 300_000, 1_000_000)
_KIB = 1024.0 if sys.platform != "darwin" else 1.0


def garnier_record(n_samples: int) -> TimeRecord:
    """Return Rao-Garnier at 10 dB."""
    return rao_garnier.benchmark_record(0, 10.0, n_samples)


def beam_record(n_samples: int) -> TimeRecord:
    """Return the three-mode beam at 20 dB, two points, its chirp as long as the record."""

    class Sized(ForcedBeam):
        n = n_samples

    return Sized().record(0, 20.0)


def filmed_record(n_samples: int, is_known: bool) -> TimeRecord:
    """Return the rig at three points, 200 frames a second, beside its hub at 1 kHz.

    The hub runs the rig's excitation over and over; the responses to single runs add up. The encoder counts 0.1 um,
    which is stated as noise or, where the input is known, left out.
    """
    rig, frame_s, ticks = Rig(), 5e-3, 5
    excitation = rig.excitation
    frames = int(np.ceil((excitation.duration_s + 0.5) / frame_s))
    run = np.full(frames * ticks, excitation.positions[-1])
    run[: len(excitation.positions)] = excitation.positions
    # A run and what is left of it during two more.
    accelerations = np.zeros(3 * len(run))
    accelerations[: len(excitation.accelerations)] = excitation.accelerations
    alone = np.zeros((3 * frames, 3))
    drive = InputSignal("hub", "m/s^2", (0.0, 1e-3), accelerations, "zoh")
    alone[1:-1] = rig.full.simulate(drive, frame_s * np.arange(1, 3 * frames - 1), 4e-3)
    n_runs = n_samples // frames + 1
    outputs = np.zeros(((n_runs + 3) * frames, 3))
    for number in range(n_runs):
        outputs[number * frames : (number + 3) * frames] += alone
    rng = np.random.default_rng(0)
    seen = slice(1, n_samples + 1)
    outputs = outputs[seen] + 5e-6 * rng.standard_normal((n_samples, 3))
    positions = np.tile(run, n_runs + 1)[: (n_samples + 2) * ticks]
    quantum = 1e-7
    if not is_known:
        positions = quantum * np.round(positions / quantum)
    hub = InputSignal(
        "hub", "m", (0.0, 1e-3), positions, "cubic", 0.0 if is_known else quantum / np.sqrt(12.0)
    )
    stamps = frame_s * np.arange(n_samples + 1)[seen]
    points = [
        OutputSignal(name, "m", stamps, own, 4e-3) for name, own in zip(rig.names, outputs.T, strict=True)
    ]
    return TimeRecord((hub,), tuple(points))


TASKS: dict[str, tuple[Callable[[int], TimeRecord], Callable[[TimeRecord], object]]] = {
    "estimate_transfer_function": (garnier_record, lambda record: estimate_transfer_function(record, 4, 1)),
    "identify": (beam_record, lambda record: identify(record, PLAIN, 3)),
    "identify-known-hub": (lambda n: filmed_record(n, True), identify),
    "identify-measured-hub": (lambda n: filmed_record(n, False), identify),
}


def measure(task: str, n_samples: int, repeats: int) -> dict[str, float]:
    """Run one size here and return seconds and peak memory [MB]; zero samples measure the imports alone."""
    seconds = [0.0]
    if n_samples:
        make, work = TASKS[task]
        record = make(n_samples)
        seconds = []
        for _ in range(repeats):
            start = time.process_time()
            work(record)
            seconds.append(time.process_time() - start)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * _KIB / 1e6
    return {"n": n_samples, "seconds": min(seconds), "peak_mb": peak}


def main() -> None:
    """Print the table and the exponents."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.ident_cost", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("--tasks", nargs="*", choices=TASKS, default=list(TASKS), metavar="TASK")
    parser.add_argument("--sizes", nargs="*", type=int, default=SIZES)
    parser.add_argument("--repeats", type=int, default=2)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--one", nargs=2, metavar=("TASK", "N"), help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.one:
        print(json.dumps(measure(arguments.one[0], int(arguments.one[1]), arguments.repeats)))
        return
    collected = {}
    print("| task | samples | time [s] | us per sample | peak memory [MB] |\n|---|---|---|---|---|")
    for task in arguments.tasks:
        rows = []
        for n_samples in (0, *arguments.sizes):
            command = [sys.executable, "-m", "benchmarks.ident_cost", "--one", task, str(n_samples)]
            # Long runs are their own repeats.
            command += ["--repeats", str(arguments.repeats if n_samples <= 100_000 else 1)]
            output = subprocess.run(command, check=True, capture_output=True, text=True).stdout
            row = json.loads(output.splitlines()[-1])
            rows.append(row)
            each = f"{1e6 * row['seconds'] / n_samples:.1f}" if n_samples else "-"
            print(
                f"| {task} | {n_samples or 'imports'} | {row['seconds']:.3g} | {each} | {row['peak_mb']:.0f} |",
                flush=True,
            )
        # Shorter records pay for the start as much as for their samples.
        long = [row for row in rows if row["n"] >= 100_000]
        if len(long) > 1:
            sizes = np.log([row["n"] for row in long])
            exponent = float(np.polyfit(sizes, np.log([row["seconds"] for row in long]), 1)[0])
            per_sample = (long[-1]["peak_mb"] - rows[0]["peak_mb"]) * 1e6 / long[-1]["n"]
            print(f"{task}: time ~ n^{exponent:.2f} from 100 000 samples on; {per_sample:.0f} bytes a sample")
            collected[task] = {"rows": rows, "exponent": exponent, "bytes_per_sample": per_sample}
        else:
            collected[task] = {"rows": rows}
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(collected, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
