"""A camera that was started anew stamps late by another time: it is found and taken off without anybody's help."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from beam_ros import messages
from beam_ros.bags.reading import Bag
from beam_ros.bags.writing import BagWriter
from beam_ros.cli.main import main
from beam_ros.messages import BagTypes
from beam_ros.offline.identification import identification_of_bags

RECORDING = Path(__file__).parents[3] / "bags" / "chirp_6s"


def restarted(path: Path, late_s: float) -> Path:
    """The recording as a camera would have left it whose stamps are late."""
    types = BagTypes()
    with Bag(RECORDING) as bag, BagWriter(path) as writer:
        for message in bag.raw_messages():
            writer.add_topic(message.topic, message.type_name)
            if message.topic != "/beam/displacement":
                writer.write(message.topic, message.receive_ns, message.data)
                continue
            shown = types.deserialize(message.data, message.type_name)
            seen = messages.read_displacement(shown)
            writer.write_message(
                message.topic,
                message.receive_ns,
                messages.displacement(types, seen.stamp_ns + round(late_s * 1e9), seen.names, seen.positions),
            )
    return path


@pytest.mark.slow
def test_a_camera_that_is_late_by_six_tenths_of_a_second_changes_the_latency_alone(tmp_path: Path) -> None:
    on_time, late = (
        identification_of_bags(RECORDING).content,
        identification_of_bags(restarted(tmp_path / "late", 0.6)).content,
    )
    assert late["latency_s"] - on_time["latency_s"] == pytest.approx(0.6, abs=2 * on_time["latency_sd_s"])
    assert late["latency_sd_s"] == pytest.approx(on_time["latency_sd_s"], rel=0.1)
    for one, other in zip(late["modes"], on_time["modes"], strict=True):
        # The ends of the record are others by half a second.
        assert abs(one["frequency_hz"] - other["frequency_hz"]) < other["frequency_sd_hz"]
        assert one["frequency_sd_hz"] == pytest.approx(other["frequency_sd_hz"], rel=0.2)
    assert any("stamps are late by 0.6" in note for note in late["notes"])
    assert not any("late by" in note for note in on_time["notes"])


@pytest.mark.slow
def test_two_cameras_in_namespaces_are_one_fit_with_a_delay_of_its_own_for_each(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    types, path = BagTypes(), tmp_path / "two"
    with Bag(RECORDING) as bag, BagWriter(path) as writer:
        for message in bag.raw_messages():
            if message.topic != "/beam/displacement":
                writer.add_topic(message.topic, message.type_name)
                writer.write(message.topic, message.receive_ns, message.data)
                continue
            seen = messages.read_displacement(types.deserialize(message.data, message.type_name))
            for side, late_ms, marker in (("left", 12, 1), ("right", 31, 2)):
                stamp_ns = seen.stamp_ns + late_ms * 1_000_000
                shown = messages.displacement(types, stamp_ns, [seen.names[marker]], [seen.positions[marker]])
                writer.add_topic(f"/{side}/beam/displacement", message.type_name)
                writer.write_message(f"/{side}/beam/displacement", message.receive_ns, shown)
    sides = ("left/beam/displacement:position[z225]", "right/beam/displacement:position[z285]")
    assert (
        main(["identify", str(path), "--json", *(word for side in sides for word in ("--output", side))]) == 0
    )
    found = json.loads(capsys.readouterr().out)
    assert [abs(mode["frequency_z"]) < 3 for mode in found["modes"]] == [True, True]
    assert any(
        "19 ms later than those of the other" in note for note in [*found["warnings"], *found["notes"]]
    )
