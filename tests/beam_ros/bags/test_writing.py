"""Written bags are what ROS 2 Jazzy's recorder writes, whole or marked, and outlive a killed writer."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from rosbags.interfaces import QosHistory
from rosbags.rosbag2 import Reader
from ruamel.yaml import YAML

from beam_ros.bags.batches import decode_batch
from beam_ros.bags.errors import BagError, BagExistsError, BagTruncatedError
from beam_ros.bags.reading import Bag
from beam_ros.bags.recording_mark import MARK_NAME, is_being_written, is_marked
from beam_ros.bags.writing import BagWriter, FileLimits
from beam_ros.interfaces import graph
from beam_ros.interfaces.graph import QualityOfService
from beam_ros.messages import BagTypes
from beam_ros.offline.recovery import recover
from tests.beam_ros.bags.small_bags import BATCH, START, TYPES, batch, write_experiment
from tests.whole_bags import messages_of_whole_bag


def test_rosbags_and_mcap_read_the_same_messages(tmp_path):
    path = write_experiment(tmp_path / "run")
    assert len(messages_of_whole_bag(path)) == 1 + 3 + 50 * 4 + 5


def test_the_folder_holds_the_file_and_metadata_alone(tmp_path):
    path = write_experiment(tmp_path / "run")
    assert sorted(file.name for file in path.iterdir()) == ["metadata.yaml", "run_0.mcap"]


def test_metadata_has_the_fields_of_jazzys_recorder(tmp_path):
    path = write_experiment(tmp_path / "run", custom_data={"rig": "simulated"})
    document = YAML(typ="safe").load(path / "metadata.yaml")
    assert list(document) == ["rosbag2_bagfile_information"]
    information = document["rosbag2_bagfile_information"]
    assert set(information) == {
        "version",
        "storage_identifier",
        "duration",
        "starting_time",
        "message_count",
        "topics_with_message_count",
        "compression_format",
        "compression_mode",
        "relative_file_paths",
        "files",
        "custom_data",
        "ros_distro",
    }
    assert information["version"] == 9
    assert information["storage_identifier"] == "mcap"
    assert information["starting_time"] == {"nanoseconds_since_epoch": START}
    assert information["duration"] == {"nanoseconds": 1_000_000_000}
    assert information["relative_file_paths"] == ["run_0.mcap"]
    assert information["files"] == [
        {
            "path": "run_0.mcap",
            "starting_time": {"nanoseconds_since_epoch": START},
            "duration": {"nanoseconds": 1_000_000_000},
            "message_count": 209,
        }
    ]
    assert information["custom_data"] == {"rig": "simulated"}
    topics = {t["topic_metadata"]["name"]: t for t in information["topics_with_message_count"]}
    assert topics["/hub/measured"]["message_count"] == 50
    (latched,) = topics["/hub/sequence_state"]["topic_metadata"]["offered_qos_profiles"]
    assert set(latched) == {
        "history",
        "depth",
        "reliability",
        "durability",
        "deadline",
        "lifespan",
        "liveliness",
        "liveliness_lease_duration",
        "avoid_ros_namespace_conventions",
    }
    assert (latched["durability"], latched["reliability"], latched["depth"]) == (
        "transient_local",
        "reliable",
        1,
    )


def test_an_unknown_depth_is_written_as_rosbag2_does(tmp_path):
    with BagWriter(tmp_path / "run") as writer:
        writer.add_topic("/text", "std_msgs/msg/String", (QualityOfService(0),))
        writer.add_topic("hub/measured")
    with Reader(tmp_path / "run") as reader:
        profiles = {c.topic: c.ext.offered_qos_profiles[0] for c in reader.connections}
    assert (profiles["/text"].history, profiles["/text"].depth) == (QosHistory.UNKNOWN, 0)
    assert profiles["/hub/measured"].history == QosHistory.KEEP_LAST


def test_the_file_carries_the_same_metadata_and_definitions(tmp_path):
    path = write_experiment(tmp_path / "run")
    outer = YAML(typ="safe").load(path / "metadata.yaml")["rosbag2_bagfile_information"]
    with (path / "run_0.mcap").open("rb") as stream:
        reader = make_reader(stream)
        assert reader.get_header().profile == "ros2"
        (record,) = (m for m in reader.iter_metadata() if m.name == "rosbag2")
        summary = reader.get_summary()
    assert YAML(typ="safe").load(record.metadata["serialized_metadata"]) == outer
    for channel in summary.channels.values():
        schema = summary.schemas[channel.schema_id]
        topic = graph.TOPICS[channel.topic.lstrip("/")]
        assert (schema.name, schema.encoding, channel.message_encoding) == (
            topic.type_name,
            "ros2msg",
            "cdr",
        )
        assert channel.metadata["topic_type_hash"] == TYPES.store.hash_rihs01(topic.type_name)
        assert "builtin_interfaces/Time" in schema.data.decode() or "string data" in schema.data.decode()


def test_type_hashes_in_the_metadata_are_rosbags_own(tmp_path):
    path = write_experiment(tmp_path / "run")
    with Reader(path) as reader:
        for connection in reader.connections:
            assert connection.digest == TYPES.store.hash_rihs01(connection.msgtype)


def test_same_bytes_in_as_out(tmp_path):
    data = BagTypes().serialize(TYPES.make(graph.STRING, data="x" * 1000), graph.STRING)
    with BagWriter(tmp_path / "run") as bag:
        bag.write("recorder/state", START + 5, data, publish_ns=START + 3)
    with (tmp_path / "run" / "run_0.mcap").open("rb") as stream:
        ((_, _, message),) = make_reader(stream).iter_messages()
    assert (message.data, message.log_time, message.publish_time) == (data, START + 5, START + 3)


def test_a_namespace_moves_relative_topics_only(tmp_path):
    with BagWriter(tmp_path / "run", namespace="/rig1/") as bag:
        bag.add_topic("hub/applied")
        bag.add_topic("/diagnostics")
        assert [topic.name for topic in bag.topics()] == ["/rig1/hub/applied", "/diagnostics"]


def test_an_empty_bag_is_a_bag(tmp_path):
    with BagWriter(tmp_path / "run") as bag:
        bag.add_topic("hub/applied")
    with Reader(tmp_path / "run") as reader:
        assert reader.message_count == 0
        assert [c.topic for c in reader.connections] == ["/hub/applied"]


def test_an_existing_path_is_refused_and_left_alone(tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "note").write_text("mine")
    with pytest.raises(BagExistsError, match="give another one"):
        BagWriter(tmp_path / "run")
    assert (tmp_path / "run" / "note").read_text() == "mine"


def test_an_unwritable_path_is_one_clear_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(BagError, match="check the path"):
        BagWriter(tmp_path / "file" / "run")


def test_an_unknown_type_is_refused(tmp_path):
    with BagWriter(tmp_path / "run") as bag, pytest.raises(BagError, match="leave this topic out"):
        bag.add_topic("/custom", "my_msgs/msg/Thing")


def test_a_failed_block_leaves_nothing_behind(tmp_path):
    with contextlib.suppress(RuntimeError), BagWriter(tmp_path / "run") as bag:
        bag.write_batch("hub/measured", START, batch(0))
        raise RuntimeError
    assert not (tmp_path / "run").exists()


def test_a_closed_bag_takes_nothing_more(tmp_path):
    bag = BagWriter(tmp_path / "run")
    bag.close()
    bag.close()
    with pytest.raises(BagError, match="closed"):
        bag.write_batch("hub/measured", START, batch(0))


def test_a_bag_in_the_making_is_marked_and_locked(tmp_path):
    bag = BagWriter(tmp_path / "run")
    assert is_marked(bag.path)
    assert is_being_written(bag.path)
    assert not (bag.path / "metadata.yaml").exists()
    assert json.loads((bag.path / MARK_NAME).read_text())["writer_pid"] == os.getpid()
    bag.close()
    assert not is_marked(bag.path)
    assert not is_being_written(bag.path)


def test_chunks_are_closed_at_least_every_second_of_receive_time(tmp_path):
    path = write_experiment(tmp_path / "run", batches=250)
    with (path / "run_0.mcap").open("rb") as stream:
        chunks = make_reader(stream).get_summary().chunk_indexes
    assert len(chunks) > 8
    assert max(c.message_end_time - c.message_start_time for c in chunks) <= 600_000_000


def test_a_clock_that_jumps_back_closes_the_chunk_too(tmp_path):
    with BagWriter(tmp_path / "run") as bag:
        bag.write_batch("hub/measured", START, batch(1))
        bag.write_batch("hub/measured", START - 10**12, batch(2))
        bag.write_batch("hub/measured", START - 10**12 + 1, batch(3))
    with Reader(tmp_path / "run") as reader:
        assert reader.message_count == 3
        assert reader.start_time == START - 10**12


_KILLED_WRITER = """
import sys, time
from beam_ros.bags.writing import BagWriter
from tests.beam_ros.bags.small_bags import batch

bag = BagWriter(sys.argv[1])
k = 0
while True:
    bag.write_batch("hub/measured", time.time_ns(), batch(k))
    print(k, flush=True)
    k += 1
    time.sleep(0.02)
"""


@pytest.mark.slow
def test_a_killed_writer_loses_less_than_a_second(tmp_path):
    path = tmp_path / "run"
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])}
    process = subprocess.Popen(
        [sys.executable, "-c", _KILLED_WRITER, str(path)], stdout=subprocess.PIPE, env=environment
    )
    assert process.stdout is not None
    try:
        written = 0
        end = time.monotonic() + 30
        while written < 110 and time.monotonic() < end:
            written = int(process.stdout.readline())
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait(10)
    written = max([written, *(int(line) for line in process.stdout.read().split())])

    assert is_marked(path)
    assert not is_being_written(path)
    saved = []
    with (path / "run_0.mcap").open("rb") as stream, contextlib.suppress(McapError):
        for record in StreamReader(stream, validate_crcs=True).records:
            if type(record).__name__ == "Message":
                saved.append(decode_batch(record.data))
    lost_s = (written + 1 - len(saved)) * 0.02
    assert lost_s < 1.0
    for k, got in enumerate(saved):
        np.testing.assert_array_equal(got.positions, batch(k).positions)


@pytest.mark.slow
@pytest.mark.parametrize("limits", [FileLimits(size=60_000), FileLimits(duration_ns=1_000_000_000)])
def test_a_bag_in_several_files_is_read_as_one_and_each_begins_with_what_is_latched(tmp_path, limits):
    one = write_experiment(tmp_path / "one", batches=250)
    several = write_experiment(
        tmp_path / "several", batches=250, limits=limits, provenance={"operator": "A. Person"}
    )
    files = sorted(file.name for file in several.glob("*.mcap"))
    assert len(files) >= 4
    document = YAML(typ="safe").load(several / "metadata.yaml")["rosbag2_bagfile_information"]
    assert sorted(document["relative_file_paths"]) == files
    assert [row["path"] for row in document["files"]] == document["relative_file_paths"]
    assert sum(row["message_count"] for row in document["files"]) == document["message_count"]
    for row in document["files"]:
        assert row["duration"]["nanoseconds"] <= limits.duration_ns + 600_000_000 or not limits.duration_ns
        with (several / row["path"]).open("rb") as stream:
            found = list(make_reader(stream, validate_crcs=True).iter_messages())
        assert len(found) == row["message_count"]
        # What holds until it is said anew stands in each file, before its other messages.
        assert {channel.topic for _, channel, _ in found} >= {"/excitation/info", "/hub/sequence_state"}
        with Bag(several / row["path"]) as bag:
            assert bag.excitation_info() == {"kind": "chirp", "seed": 1}
            assert bag.provenance() == {"operator": "A. Person"}
            assert "done" in {state["state"] for state in bag.sequence_states()}
    with Bag(one) as whole, Bag(several) as parts, Reader(several) as reader:
        np.testing.assert_array_equal(parts.hub_samples().positions, whole.hub_samples().positions)
        np.testing.assert_array_equal(parts.displacements().positions, whole.displacements().positions)
        assert parts.message_count == reader.message_count == len(messages_of_whole_bag(several))
        assert parts.message_count == whole.message_count + 2 * (len(files) - 1)
        assert not list(parts.damage())


@pytest.mark.slow
def test_a_bag_in_several_files_without_metadata_is_not_read_in_part(tmp_path):
    path = write_experiment(tmp_path / "run", batches=100, limits=FileLimits(duration_ns=500_000_000))
    (path / "metadata.yaml").unlink()
    with pytest.raises(BagTruncatedError, match="beam recover"):
        Bag(path)
    report = recover(path)
    with Bag(report.target) as bag:
        assert len(bag.hub_samples().positions) == 100 * BATCH
