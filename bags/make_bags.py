"""Make the recordings of this folder anew, and `expected.json`: what each was made from, and what is found in it.

    python bags/make_bags.py [FOLDER]

The simulation is seeded and led by a made-up clock, so that the bags come out the same to the last byte with the same
versions of NumPy and SciPy.
"""

from __future__ import annotations

import json
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from beam_ros import messages
from beam_ros.bags.reading import Bag
from beam_ros.bags.writing import BagWriter
from beam_ros.interfaces.graph import JOINT_STATE
from beam_ros.messages import BagTypes
from beam_ros.offline.identification import identification_of_bags
from beam_ros.offline.simulation import simulate
from beam_ros.rig.rig import Rig

CHIRP: dict[str, Any] = {
    "excitation.duration": 5.0,
    "excitation.still": 1.5,
    "excitation.start_frequency": 2.0,
    "excitation.end_frequency": 45.0,
}

RECORDINGS: dict[str, dict[str, Any]] = {
    "chirp_6s": {**CHIRP, "simulation.seed": 20},
    "multisine": {
        "excitation.kind": "multisine",
        "excitation.acceleration": 1.5,
        "excitation.start_frequency": 2.0,
        "excitation.end_frequency": 40.0,
        "excitation.line_period": 2.5,
        "excitation.duration": 5.0,
        "excitation.still": 1.0,
        "simulation.seed": 21,
    },
    "step": {
        "excitation.kind": "step",
        "excitation.step_size": 0.003,
        "excitation.rise_time": 0.1,
        "excitation.duration": 2.5,
        "excitation.still": 3.5,
        "simulation.seed": 22,
    },
    "decay": {
        "excitation.kind": "doublet",
        "excitation.acceleration": 0.9,
        "excitation.width": 0.1,
        "excitation.gap": 0.1,
        "excitation.still": 5.5,
        "simulation.seed": 23,
    },
    "hammer": {
        "hub.command_mode": "effort",
        "excitation.kind": "pulse",
        "excitation.acceleration": 8.0,
        "excitation.width": 0.004,
        "excitation.gap": 1.0,
        "excitation.still": 3.5,
        "simulation.seed": 24,
    },
    "encoder_noise": {
        **CHIRP,
        "hub.encoder_resolution": 5e-7,
        "simulation.encoder_noise": 1e-6,
        "simulation.seed": 25,
    },
    "drifting": {
        **CHIRP,
        "simulation.hub_clock_ppm": 400.0,
        "simulation.camera_clock_ppm": -60.0,
        "simulation.stamp_jitter": 2e-4,
        "simulation.frame_drops": 0.02,
        "simulation.seed": 26,
    },
    "frames": {
        "excitation.kind": "multisine",
        "excitation.acceleration": 1.2,
        "excitation.start_frequency": 2.0,
        "excitation.end_frequency": 40.0,
        "excitation.duration": 2.5,
        "excitation.still": 1.5,
        "recorder.images": True,
        "camera.width": 48,
        "camera.height": 180,
        "camera.pixels_per_metre": 560.0,
        "camera.origin_u": 23.6,
        "camera.origin_v": 172.0,
        "camera.rate": 50.0,
        "markers.diameter": 0.010,
        "simulation.seed": 27,
    },
}
"""What of the packaged rig is different in each recording, by its name."""

LOST_MARKERS: dict[str, tuple[tuple[str, int, int], ...]] = {
    "drifting": (("z225", 150, 190), ("z285", 300, 330), ("z010", 480, 500), ("z285", 600, 601)),
}
"""Marker, first frame and end of what the tracker did not see: somebody stood in the light."""


def truth_of(rig: Rig) -> dict[str, Any]:
    """Return what a recording of this rig was made from: poles, residues and residual terms (SI)."""
    model, heights = rig.beam_model(), list(rig.markers.heights)
    if rig.hub.command_mode == "effort":
        return {
            "natural_frequencies": model.free_hub_natural_frequencies.tolist(),
            "damping_ratios": model.free_hub_damping_ratios.tolist(),
        }
    return {
        "natural_frequencies": model.natural_frequencies.tolist(),
        "damping_ratios": model.damping_ratios.tolist(),
        "outputs": list(rig.markers.names),
        "residues": np.asarray(model.motion_residues(heights)).tolist(),
        "residual_terms": np.asarray(model.residual_terms(heights)).tolist(),
    }


def found_in(path: Path) -> dict[str, Any]:
    """Return what `beam identify` finds in a recording: poles with standard deviations, the FIT of outputs."""
    found = identification_of_bags(path).content
    names = ("frequency_hz", "frequency_sd_hz", "damping_ratio", "damping_ratio_sd")
    return {
        "modes": [{name: float(f"{mode[name]:.9g}") for name in names} for mode in found["modes"]],
        "fit_percent": {name: round(own["fit_percent"], 4) for name, own in found["scores"].items()},
    }


def hide(path: Path, target: Path, lost: tuple[tuple[str, int, int], ...]) -> None:
    """Copy a bag, with NaN in the displacements for what the tracker did not see."""
    types, frame = BagTypes(), 0
    with Bag(path) as old, BagWriter(target) as new:
        for message in old.raw_messages():
            topic, data = message.topic.lstrip("/"), message.data
            if topic == "beam/displacement":
                seen = messages.read_displacement(types.deserialize(data, JOINT_STATE))
                for name, first, end in lost:
                    if first <= frame < end:
                        seen.positions[seen.names.index(name)] = np.nan
                frame += 1
                changed = messages.displacement(types, seen.stamp_ns, seen.names, seen.positions)
                data = types.serialize(changed, JOINT_STATE)
            new.write(topic, message.receive_ns, data)


def record(name: str, path: Path) -> int:
    """Simulate one recording and return the number of its messages."""
    rig = Rig.from_file().with_values(RECORDINGS[name])
    if name not in LOST_MARKERS:
        return simulate(rig, path, with_camera=rig.recorder.images)
    with tempfile.TemporaryDirectory() as scratch:
        count = simulate(rig, Path(scratch) / name)
        hide(Path(scratch) / name, path, LOST_MARKERS[name])
    return count


def make(folder: Path) -> None:
    """Write every recording, and what is expected of them, into a folder."""
    expected = {}
    for name, changes in RECORDINGS.items():
        path = folder / name
        if path.exists():
            shutil.rmtree(path)
        print(f"{path}: {record(name, path)} messages")
        rig = Rig.from_file().with_values(changes)
        expected[name] = {"truth": truth_of(rig), "identified": found_in(path)}
    (folder / "expected.json").write_text(json.dumps(expected, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    make(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
