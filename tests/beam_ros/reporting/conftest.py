"""Bags of a short experiment: two of different levels, and one with the frames in it."""

from __future__ import annotations

from pathlib import Path

import pytest

from beam_ros import messages
from beam_ros.bags.reading import Bag
from beam_ros.bags.writing import BagWriter
from beam_ros.messages import BagTypes
from beam_ros.offline.identification import Identification, identification_of_bags
from beam_ros.offline.simulation import simulate
from beam_ros.rig.rig import Rig

SHORT = {"excitation.duration": 6.0, "excitation.still": 1.0, "excitation.end_frequency": 45.0}
N_FRAMES = 60


@pytest.fixture(scope="session")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("reported") / "first"
    simulate(Rig.from_file().with_values(SHORT), path)
    return path


@pytest.fixture(scope="session")
def second_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("reported") / "second"
    rig = Rig.from_file().with_values({**SHORT, "simulation.seed": 7, "excitation.acceleration": 0.4})
    simulate(rig, path)
    return path


@pytest.fixture(scope="session")
def outcome(bag: Path, second_bag: Path) -> Identification:
    return identification_of_bags(bag, validation=second_bag)


@pytest.fixture(scope="session")
def filmed_bag(bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the first bag with the first frames of its experiment, as a camera would have taken them."""
    folder = tmp_path_factory.mktemp("filmed")
    frames = []
    rig = Rig.from_file().with_values(SHORT)
    simulate(rig, folder / "frames", on_frame=lambda exposure, image: frames.append((exposure, image)))
    with Bag(bag) as whole, BagWriter(folder / "bag") as written:
        types = BagTypes()
        stamps = set(whole.displacements().stamps_ns.tolist())
        for message in whole.raw_messages():
            written.write(message.topic.lstrip("/"), message.receive_ns, message.data)
        last = message.receive_ns
        chosen = [(e, i) for e, i in frames if e.stamp_ns in stamps][200 : 200 + N_FRAMES]
        for exposure, image in chosen:
            written.write_message("camera/image_raw", last, messages.image(types, exposure.stamp_ns, image))
    return folder / "bag"
