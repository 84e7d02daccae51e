"""The recorder as a real process over DDS: what is on the wire is in the bag, however the process ends."""

from __future__ import annotations

import json
import signal

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader

from beam_ros import interfaces, messages
from beam_ros.bags.batches import encode_batch
from beam_ros.bags.errors import BagTruncatedError
from beam_ros.bags.reading import Bag
from beam_ros.bags.recovery import recover
from beam_ros.interfaces import QualityOfService
from beam_ros.messages import BagTypes
from tests.beam_ros.bags.small_bags import BATCH, PERIOD, START, batch

pytestmark = pytest.mark.ros
pytest.importorskip("rclpy")


@pytest.fixture
def graph():
    from tests.beam_ros.bags.graph import Graph

    with Graph() as graph:
        yield graph


def _start(executables, graph, path, *, at_launch=True, **parameters):
    """Start a recorder and wait until it is on the graph."""
    values = {"recorder.path": path, "recorder.start_at_launch": str(at_launch).lower(), **parameters}
    arguments = [word for name, value in values.items() for word in ("-p", f"{name}:={value}")]
    recorder = executables.start("bag_recorder", "--ros-args", *arguments)
    states = []
    graph.listen("recorder/state", lambda message: states.append(json.loads(message.data)))
    graph.wait(lambda: bool(states), "recorder/state")
    recorder.states = states
    return recorder


def _wait_for_subscribers(graph, *publishers):
    for publisher in publishers:
        graph.wait(lambda publisher=publisher: publisher.get_subscription_count() > 0, "a subscription")


def test_between_start_and_stop_the_bag_takes_the_wires_bytes_and_the_latched_past(
    executables, graph, tmp_path
):
    info = graph.publisher("excitation/info")
    info.publish(messages.json_text(graph.types, {"kind": "chirp"}))  # before any recorder is there
    recorder = _start(executables, graph, tmp_path / "run", at_launch=False)
    measured, state = graph.publisher("hub/measured"), graph.publisher("hub/state")
    images = graph.publisher("camera/image_raw")
    too_early = graph.call("recorder/stop")
    assert not too_early.success
    assert "recorder/start" in too_early.message
    assert graph.call("recorder/start").success
    assert "already recording" in graph.call("recorder/start").message
    _wait_for_subscribers(graph, measured, state)
    for k in range(20):
        measured.publish(encode_batch(batch(k)))
        state.publish(messages.hub_state(graph.types, messages.HubSample(START + k, 0.001 * k)))
        images.publish(messages.image(graph.types, START + k, np.zeros((8, 8), dtype=np.uint8)))
        graph.spin(0.01)
    graph.spin(0.2)
    hashes = {
        name: str(graph.node.get_publishers_info_by_topic(name)[0].topic_type_hash)
        for name in ("/hub/measured", "/hub/state", "/excitation/info")
    }
    stopped = graph.call("recorder/stop")
    assert stopped.success
    assert str(tmp_path / "run") in stopped.message
    again = graph.call("recorder/start")
    assert not again.success
    assert "exists already" in again.message

    with (tmp_path / "run" / "run_0.mcap").open("rb") as stream:
        recorded = [
            (channel.topic, message.data, message.log_time, message.publish_time)
            for _, channel, message in make_reader(stream, validate_crcs=True).iter_messages()
        ]
    wire = [data for topic, data, _, _ in recorded if topic == "/hub/measured"]
    assert wire == [encode_batch(batch(k)) for k in range(20)]
    assert "/camera/image_raw" not in {topic for topic, *_ in recorded}
    ages = [received - sent for topic, _, received, sent in recorded if topic == "/hub/measured"]
    assert all(0 <= age < 2 * 10**9 for age in ages)  # two stamps of one clock, on a busy machine
    with Reader(tmp_path / "run") as reader:
        digests = {c.topic: c.digest for c in reader.connections}
        offered = {c.topic: c.ext.offered_qos_profiles[0].durability.name for c in reader.connections}
    assert {name: digests[name] for name in hashes} == hashes
    assert offered["/excitation/info"] == "TRANSIENT_LOCAL"
    with Bag(tmp_path / "run") as bag:
        assert bag.excitation_info() == {"kind": "chirp"}
        assert bag.count("hub/state") == 20
        # What rclpy itself serialised, with empty arrays, reads back exactly.
        types = BagTypes()
        last = [m.data for m in bag.raw_messages("hub/state")][-1]
        sample = messages.read_hub_state(types.deserialize(last, interfaces.JOINT_STATE))
    assert (sample.stamp_ns, sample.position) == (START + 19, 0.019)
    assert recorder.states[-1]["lost"] == 0


def test_images_of_a_best_effort_camera_until_sigint_even_twice(executables, graph, tmp_path):
    images = graph.publisher("camera/image_raw", QualityOfService(5, is_reliable=False))
    recorder = _start(executables, graph, tmp_path / "run", **{"recorder.images": "true"})
    _wait_for_subscribers(graph, images)
    pixels = np.arange(64, dtype=np.uint8).reshape(8, 8)
    for k in range(10):
        images.publish(messages.image(graph.types, START + k, pixels))
        graph.spin(0.03)
    for _ in range(2):
        recorder.send_signal(signal.SIGINT)
    assert recorder.wait() == 0
    assert "Traceback" not in recorder.output()
    with Bag(tmp_path / "run") as bag:
        assert bag.count("camera/image_raw") >= 8  # best effort: none is lost on an idle machine


def test_a_killed_recorder_loses_less_than_a_second_and_is_repaired(executables, graph, tmp_path):
    recorder = _start(executables, graph, tmp_path / "run")
    measured = graph.publisher("hub/measured")
    _wait_for_subscribers(graph, measured)
    for k in range(100):
        measured.publish(encode_batch(batch(k)))
        graph.spin(0.02)
    recorder.send_signal(signal.SIGKILL)
    assert recorder.wait() == -signal.SIGKILL
    with pytest.raises(BagTruncatedError, match="beam recover"):
        Bag(tmp_path / "run")
    report = recover(tmp_path / "run")
    with Bag(report.target) as bag:
        samples = bag.hub_samples()
    np.testing.assert_array_equal(samples.stamps_ns, START + np.arange(len(samples.stamps_ns)) * PERIOD)
    # One batch of 20 ms left every 20 ms or a little more.
    assert (100 - len(samples.stamps_ns) / BATCH) * 0.02 < 1.0


def test_what_the_middleware_drops_is_counted(executables, graph, tmp_path):
    recorder = _start(executables, graph, tmp_path / "run")
    measured = graph.publisher("hub/measured", QualityOfService(50))
    _wait_for_subscribers(graph, measured)
    for k in range(10):
        measured.publish(encode_batch(batch(k)))
        graph.spin(0.1)  # meanwhile the recorder has looked at the publishers
    recorder.send_signal(signal.SIGSTOP)
    for k in range(10, 1500):
        measured.publish(encode_batch(batch(k)))
    recorder.send_signal(signal.SIGCONT)
    graph.spin(1.0)
    measured.publish(encode_batch(batch(1500)))
    graph.spin(1.0)
    assert graph.call("recorder/stop").success
    graph.wait(lambda: not recorder.states[-1]["recording"], "the end of the recording")
    with Bag(tmp_path / "run") as bag:
        samples = bag.hub_samples()
    assert recorder.states[-1]["lost"] > 0
    assert samples.lost == recorder.states[-1]["lost"] * BATCH


def test_an_existing_path_ends_with_one_line_and_status_2(executables, tmp_path):
    (tmp_path / "run").mkdir()
    recorder = executables.run("bag_recorder", "--ros-args", "-p", f"recorder.path:={tmp_path / 'run'}")
    assert recorder.process.returncode == 2
    assert "exists already" in recorder.output()
    assert len(recorder.output().strip().splitlines()) == 1
    assert list((tmp_path / "run").iterdir()) == []


def test_sigterm_even_twice_closes_the_bag_of_a_rig_in_a_namespace(executables, graph, tmp_path):
    path = tmp_path / "run"
    arguments = ("-r", "__ns:=/rig1", "-p", f"recorder.path:={path}")
    recorder = executables.start("bag_recorder", "--ros-args", *arguments)
    row = interfaces.TOPICS["hub/measured"]
    measured = graph.node.create_publisher(
        graph.types.message_class(row.type_name), "/rig1/hub/measured", row.qos.depth
    )
    _wait_for_subscribers(graph, measured)
    graph.spin(0.3)
    for k in range(30):
        measured.publish(encode_batch(batch(k)))
        graph.spin(0.005)
    graph.spin(0.3)
    for _ in range(2):
        recorder.send_signal(signal.SIGTERM)
    assert recorder.wait() == 0
    assert "Traceback" not in recorder.output()
    with Bag(path) as bag:
        assert bag.namespace == "rig1"
        assert len(bag.hub_samples().stamps_ns) == 30 * BATCH
