"""Make the recordings of this folder anew, each with the truth that it was made from.

    python bags/make_bags.py [FOLDER]

The simulation is seeded and led by a made-up clock, so that the bags come out the same on every machine with
the same versions of NumPy and SciPy.
"""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np

from beam_ros.offline.simulation import simulate
from beam_ros.rig.rig import Rig

RECORDINGS: dict[str, dict[str, Any]] = {
    "chirp_6s": {
        "excitation.duration": 5.0,
        "excitation.still": 1.5,
        "excitation.start_frequency": 2.0,
        "excitation.end_frequency": 45.0,
        "simulation.seed": 20,
    },
}


def truth_of(rig: Rig) -> dict[str, Any]:
    """Return what a recording of this rig was made from: poles, residues and residual terms (SI)."""
    model = rig.beam_model()
    heights = list(rig.markers.heights)
    return {
        "natural_frequencies": model.natural_frequencies.tolist(),
        "damping_ratios": model.damping_ratios.tolist(),
        "outputs": list(rig.markers.names),
        "residues": np.asarray(model.motion_residues(heights)).tolist(),
        "residual_terms": np.asarray(model.residual_terms(heights)).tolist(),
        "displacement_noise": rig.simulation.displacement_noise,
        "rig": rig.to_nested(),
    }


def make(folder: Path) -> None:
    """Write every recording and its truth into a folder."""
    for name, changes in RECORDINGS.items():
        rig = Rig.from_file().with_values(changes)
        path = folder / name
        if path.exists():
            shutil.rmtree(path)
        count = simulate(rig, path)
        (folder / f"{name}.truth.json").write_text(
            json.dumps(truth_of(rig), indent=1) + "\n", encoding="utf-8"
        )
        print(f"{path}: {count} messages")


if __name__ == "__main__":
    make(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
