"""A camera that is started again and again: stamps late by another time at every start, a clock of another rate.

    python -m benchmarks.camera_restarts [--runs N] [--seed S] [--json FILE]

Every run simulates the default experiment (a chirp of five seconds) with stamps that are late by 0.1 to 0.9 s and a
camera's clock within 200 ppm, and identifies the bag as `beam identify` does: nobody says anything about the camera.
Printed are the shares of runs in which latency, rate, frequencies and damping ratios lie within 95 % of what is
stated, the rms of error over standard deviation, and the frequencies' standard deviation over that of the same runs
with a camera that is on time.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from beam_ros.bags.reading import Bag
from beam_ros.offline.identification import identification_of_bags
from beam_ros.offline.simulation import simulate
from beam_ros.rig.rig import Rig

LATE_S = (0.1, 0.9)
RATE_PPM = 200.0
NOISE_M = 5e-6
_WITHIN_95 = 1.96
_COMPARED = 3  # runs that are repeated with a camera on time


@dataclass(frozen=True)
class Restart:
    """One start of the camera: truth, and errors over stated standard deviations.

    Attributes
    ----------
    late_s, rate_ppm : float -- truth
    latency_z, rate_z : float
    frequency_z, damping_z : tuple of float -- of the modes, the lowest first
    frequency_sd_hz : tuple of float -- as stated
    n_warnings : int
    """

    late_s: float
    rate_ppm: float
    latency_z: float
    rate_z: float
    frequency_z: tuple[float, ...]
    damping_z: tuple[float, ...]
    frequency_sd_hz: tuple[float, ...]
    n_warnings: int


def restart(folder: Path, late_s: float, rate_ppm: float, seed: int) -> Restart:
    """Simulate and identify one bag in a folder of its own."""
    rig = Rig.from_file().with_values(
        {
            "excitation.duration": 5.0,
            "simulation.stamp_offset": late_s,
            "simulation.camera_clock_ppm": rate_ppm,
            "simulation.displacement_noise": NOISE_M,
            "simulation.seed": seed,
        }
    )
    simulate(rig, folder / "bag")
    with Bag(folder / "bag") as bag:
        first_ns = int(bag.displacements().stamps_ns[0])
    found = identification_of_bags(folder / "bag")
    record, content = found.experiment.record, found.content
    # A latency is stated for the middle of the record, up to which the camera's clock ran away.
    ends_s = [(output.times_s[0], output.times_s[-1]) for output in record.outputs]
    middle_s = 0.5 * (min(first for first, _ in ends_s) + max(last for _, last in ends_s)) + late_s
    true_s = late_s + rate_ppm * 1e-6 * (middle_s - (first_ns - record.start_ns) * 1e-9)
    modes = content["modes"]
    return Restart(
        late_s,
        rate_ppm,
        (content["latency_s"] - true_s) / content["latency_sd_s"],
        (content["clock_rate"] - rate_ppm * 1e-6) / content["clock_rate_sd"],
        tuple(mode["frequency_z"] for mode in modes),
        tuple(mode["damping_ratio_z"] for mode in modes),
        tuple(mode["frequency_sd_hz"] for mode in modes),
        len(content["warnings"]),
    )


def summary(runs: list[Restart]) -> list[str]:
    """Shares within 95 %, and rms of error over standard deviation, of all that is estimated."""
    kinds = {
        "latency": [[run.latency_z] for run in runs],
        "clock rate": [[run.rate_z] for run in runs],
        "frequencies": [run.frequency_z for run in runs],
        "damping ratios": [run.damping_z for run in runs],
    }
    lines = [f"{len(runs)} restarts, {sum(run.n_warnings > 0 for run in runs)} with warnings"]
    for name, rows in kinds.items():
        z = np.array([value for row in rows for value in row])
        lines.append(
            f"{name:14s} {100 * np.mean(np.abs(z) < _WITHIN_95):5.1f} % of {z.size} within their 95 %, "
            f"rms {np.sqrt(np.mean(z**2)):.2f} sd, largest {np.max(np.abs(z)):.1f} sd"
        )
    return lines


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path, help="write every run here, too")
    arguments = parser.parse_args()
    rng = np.random.default_rng([14, arguments.seed])
    runs, ratios = [], []
    for number in range(arguments.runs):
        late_s, rate_ppm = rng.uniform(*LATE_S), rng.uniform(-RATE_PPM, RATE_PPM)
        seed = int(rng.integers(1, 2**31 - 1))
        with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryDirectory() as plain:
            run = restart(Path(folder), late_s, rate_ppm, seed)
            if number < _COMPARED:
                on_time = restart(Path(plain), 0.0, 0.0, seed)
                ratios.append(np.divide(run.frequency_sd_hz, on_time.frequency_sd_hz))
        runs.append(run)
        print(
            f"{number:3d} late {late_s:.3f} s, {rate_ppm:+7.1f} ppm: latency {run.latency_z:+5.2f} sd, rate "
            f"{run.rate_z:+5.2f} sd, frequencies {np.round(run.frequency_z, 2).tolist()} sd",
            flush=True,
        )
    print("\n".join(summary(runs)))
    print(
        f"standard deviation of the frequencies over that of a camera on time: {np.round(np.mean(ratios, axis=0), 3)}"
    )
    if arguments.json:
        arguments.json.write_text(json.dumps([asdict(run) for run in runs], indent=1) + "\n")


if __name__ == "__main__":
    main()
