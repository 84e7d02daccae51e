"""The recordings of `bags/` hold what their truth says, and their script makes them."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader

from beam_ros.bags.reading import Bag
from beam_ros.offline.identification import identify_bag

FOLDER = Path(__file__).parent.parent / "bags"
RECORDINGS = sorted(path.name.removesuffix(".truth.json") for path in FOLDER.glob("*.truth.json"))


@pytest.mark.parametrize("name", RECORDINGS)
def test_a_recording_identifies_as_its_truth(name: str) -> None:
    truth = json.loads((FOLDER / f"{name}.truth.json").read_text())
    result = identify_bag(FOLDER / name)
    for mode in result["modes"]:
        k = mode["theory_mode"] - 1
        omega, zeta = truth["natural_frequencies"][k], truth["damping_ratios"][k]
        assert abs(mode["frequency_hz"] - omega / (2 * np.pi)) < 4 * mode["frequency_sd_hz"]
        assert abs(mode["damping_ratio"] - zeta) < 4 * mode["damping_ratio_sd"]


@pytest.mark.parametrize("name", RECORDINGS)
def test_both_libraries_read_the_same_messages(name: str) -> None:
    with Reader(FOLDER / name) as reader:
        first = [(connection.topic, bytes(data)) for connection, _, data in reader.messages()]
    with (FOLDER / name / f"{name}_0.mcap").open("rb") as stream:
        second = [
            (channel.topic, bytes(message.data))
            for _, channel, message in make_reader(stream).iter_messages()
        ]
    assert sorted(first) == sorted(second)


def test_the_script_makes_the_recordings_anew(tmp_path: Path) -> None:
    spec = importlib.util.spec_from_file_location("make_bags", FOLDER / "make_bags.py")
    assert spec is not None
    assert spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    assert set(script.RECORDINGS) == set(RECORDINGS)
    script.make(tmp_path)
    for name in RECORDINGS:
        with Bag(FOLDER / name) as kept, Bag(tmp_path / name) as made:
            positions = [bag.displacements().positions for bag in (kept, made)]
        # Other versions of NumPy and SciPy round differently: far below the 5 um of noise.
        np.testing.assert_allclose(positions[0], positions[1], atol=1e-9)
