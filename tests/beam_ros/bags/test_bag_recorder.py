"""The recorder as a real process over DDS: what is on the wire is in the bag, however the process ends."""

from __future__ import annotations

import json
import signal
import time

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader

from beam_ros import messages
from beam_ros.bags.batches import encode_batch
from beam_ros.bags.errors import BagTruncatedError
from beam_ros.bags.reading import Bag
from beam_ros.interfaces.graph import JOINT_STATE, QualityOfService
from beam_ros.messages import BagTypes
from beam_ros.offline.recovery import recover
from tests.beam_ros.bags.small_bags import BATCH, PERIOD, START, batch

pytestmark = pytest.mark.ros
pytest.importorskip("rclpy")


class Recorder:
    """A recorder process with the states that it publishes."""

    def __init__(self, executables, graph, path, *, namespace="", at_launch=True, images=False, more=()):
        values = {
            "recorder.path": path,
            "recorder.start_at_launch": str(at_launch).lower(),
            "recorder.images": str(images).lower(),
            **dict(more),
        }
        arguments = [word for name, value in values.items() for word in ("-p", f"{name}:={value}")]
        if namespace:
            arguments += ["-r", f"__ns:={namespace}"]
        self.process = executables.start("bag_recorder", "--ros-args", *arguments, timeout_s=180.0)
        self.states = []
        self._graph = graph
        self._namespace = namespace
        graph.listen(
            "recorder/state",
            lambda message: self.states.append(json.loads(message.data)),
            namespace=namespace,
        )
        graph.wait(lambda: bool(self.states), "recorder/state")

    def warm_up(self, publisher, topic, make):
        """Publish make(0), make(1), .. until one is recorded; return the next number.

        Publisher and subscription find each other at different times, seconds apart in the worst case.
        """
        name = f"{self._namespace}/{topic}"
        for k in range(200):
            publisher.publish(make(k))
            self._graph.spin(0.05)
            if self.states[-1]["topics"].get(name):
                return k + 1
        pytest.fail(f"{name} was not recorded: {self.states[-1]}")

    def signal(self, number):
        self.process.send_signal(number)


def _encoded(k):
    return encode_batch(batch(k))


@pytest.mark.slow
def test_between_start_and_stop_the_bag_takes_the_wires_bytes_and_the_latched_past(
    executables, graph, tmp_path
):
    info = graph.publisher("excitation/info")
    info.publish(messages.json_text(graph.types, {"kind": "chirp"}))  # before any recorder is there
    recorder = Recorder(executables, graph, tmp_path / "run", at_launch=False)
    measured, state = graph.publisher("hub/measured"), graph.publisher("hub/state")
    images = graph.publisher("camera/image_raw")
    too_early = graph.call("recorder/stop")
    assert not too_early.success
    assert "recorder/start" in too_early.message
    assert graph.call("recorder/start").success
    assert "already recording" in graph.call("recorder/start").message
    first = recorder.warm_up(measured, "hub/measured", _encoded)

    def sample(k):
        return messages.hub_state(graph.types, messages.HubSample(START + k, 0.001 * k))

    recorder.warm_up(state, "hub/state", sample)
    for k in range(first, first + 20):
        measured.publish(_encoded(k))
        state.publish(sample(k))
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
    assert wire[-20:] == [_encoded(k) for k in range(first, first + 20)]
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
        # What rclpy itself serialised, with empty arrays, reads back exactly.
        types = BagTypes()
        last = [m.data for m in bag.raw_messages("hub/state")][-1]
        read = messages.read_hub_state(types.deserialize(last, JOINT_STATE))
    assert (read.stamp_ns, read.position) == (START + first + 19, 0.001 * (first + 19))
    assert recorder.states[-1]["lost"] == 0


@pytest.mark.slow
def test_images_of_a_best_effort_camera_until_sigint_even_twice(executables, graph, tmp_path):
    images = graph.publisher("camera/image_raw", QualityOfService(5, is_reliable=False))
    recorder = Recorder(executables, graph, tmp_path / "run", images=True)
    pixels = np.arange(64, dtype=np.uint8).reshape(8, 8)
    recorder.warm_up(images, "camera/image_raw", lambda k: messages.image(graph.types, START + k, pixels))
    for _ in range(2):
        recorder.signal(signal.SIGINT)
    assert recorder.process.wait() == 0
    assert "Traceback" not in recorder.process.output()
    with Bag(tmp_path / "run") as bag:
        assert bag.count("camera/image_raw") >= 1


@pytest.mark.slow
def test_a_killed_recorder_loses_less_than_a_second_and_is_repaired(executables, graph, tmp_path):
    recorder = Recorder(executables, graph, tmp_path / "run")
    measured = graph.publisher("hub/measured")
    first = recorder.warm_up(measured, "hub/measured", _encoded)
    for k in range(first, first + 60):
        measured.publish(_encoded(k))
        graph.spin(0.02)
    recorder.signal(signal.SIGKILL)
    assert recorder.process.wait() == -signal.SIGKILL
    with pytest.raises(BagTruncatedError, match="beam recover"):
        Bag(tmp_path / "run")
    report = recover(tmp_path / "run")
    with Bag(report.target) as bag:
        samples = bag.hub_samples()
    assert not samples.gaps
    end_ns = START + (first + 60) * BATCH * PERIOD
    # A batch of 20 ms left every 20 ms or a little later, so that this is also the loss in real time at most.
    assert (end_ns - PERIOD - samples.stamps_ns[-1]) * 1e-9 < 1.0


@pytest.mark.verify
def test_twenty_kills_at_any_moment_lose_a_second_at_most_of_every_topic(executables, graph, tmp_path):
    rng = np.random.default_rng(20)
    measured, state = graph.publisher("hub/measured"), graph.publisher("hub/state")
    for turn in range(20):
        path = tmp_path / f"run{turn}"
        recorder = Recorder(executables, graph, path)
        first = recorder.warm_up(measured, "hub/measured", _encoded)
        recorder.warm_up(state, "hub/state", lambda k: _state(graph, k))
        end = time.monotonic() + rng.uniform(0.2, 3.0)
        last = first
        while time.monotonic() < end:
            measured.publish(_encoded(last))
            state.publish(_state(graph, last))
            graph.spin(0.02)
            last += 1
        killed_ns = time.time_ns()
        recorder.signal(signal.SIGKILL)
        recorder.process.wait()
        with Bag(recover(path).target) as bag:
            for topic in ("hub/measured", "hub/state"):
                newest_ns = max(message.receive_ns for message in bag.raw_messages(topic))
                assert killed_ns - newest_ns < 1_000_000_000, (turn, topic)


@pytest.mark.verify
def test_a_minute_of_hub_displacements_and_images_is_recorded_without_a_loss(executables, graph, tmp_path):
    seconds, names = 60, ("z010", "z225", "z285")
    recorder = Recorder(executables, graph, tmp_path / "run", images=True)
    measured, seen = graph.publisher("hub/measured"), graph.publisher("beam/displacement")
    images = graph.publisher("camera/image_raw")
    pixels = np.zeros((480, 640), dtype=np.uint8)

    def image(k):
        pixels[0, :8] = np.frombuffer(np.int64(k).tobytes(), dtype=np.uint8)
        return messages.image(graph.types, START + k, pixels)

    first_image = recorder.warm_up(images, "camera/image_raw", image)
    first_batch = recorder.warm_up(measured, "hub/measured", _encoded)
    begun, sent = time.monotonic(), {"hub": 0, "camera": 0, "tracker": 0}
    while time.monotonic() < begun + seconds:
        elapsed = time.monotonic() - begun
        while sent["hub"] < 50 * elapsed:  # a batch of 20 ticks
            measured.publish(_encoded(first_batch + sent["hub"]))
            sent["hub"] += 1
        while sent["tracker"] < 200 * elapsed:
            stamp = START + sent["tracker"] * 5_000_000
            seen.publish(messages.displacement(graph.types, stamp, names, [float(sent["tracker"])] * 3))
            sent["tracker"] += 1
        while sent["camera"] < 30 * elapsed:
            images.publish(image(first_image + sent["camera"]))
            sent["camera"] += 1
        graph.spin(0.001)
    graph.spin(2.0)
    assert graph.call("recorder/stop").success
    types = BagTypes()
    with Bag(tmp_path / "run") as bag:
        ticks = np.round(bag.hub_samples().positions / 1e-6).astype(int)
        counter = bag.displacements().positions[:, 0]
        frames = [
            int(np.frombuffer(bytes(types.deserialize(m.data, m.type_name).data[:8]), dtype=np.int64)[0])
            for m in bag.raw_messages("camera/image_raw")
        ]
    assert recorder.states[-1]["lost"] == 0
    # The first messages of a warm-up may come before the recorder; from then on every number is there.
    assert np.array_equal(np.diff(ticks), np.ones(len(ticks) - 1))
    assert ticks[-1] == (first_batch + sent["hub"]) * BATCH - 1
    assert np.array_equal(np.diff(frames), np.ones(len(frames) - 1))
    assert frames[-1] == first_image + sent["camera"] - 1
    assert np.array_equal(np.diff(counter), np.ones(len(counter) - 1))
    assert counter[-1] == sent["tracker"] - 1
    assert len(counter) > 199 * seconds


def _state(graph, k):
    return messages.hub_state(graph.types, messages.HubSample(START + k, 0.001 * k))


@pytest.mark.slow
def test_what_is_needed_and_not_heard_is_named_after_two_seconds(executables, graph, tmp_path):
    values = {"recorder.operator": "'A. Person'", "recorder.max_duration": "1.0", "camera.name": "'cam 2'"}
    recorder = Recorder(executables, graph, tmp_path / "run", at_launch=False, more=values)
    measured = graph.publisher("hub/measured")
    path, process = tmp_path / "run", recorder.process
    assert graph.call("recorder/start").success
    for k in range(250):
        measured.publish(_encoded(k))
        graph.spin(0.02)
    process.send_signal(signal.SIGINT)
    assert process.wait() == 0
    assert "nothing on /beam/displacement after 2 s" in process.output()
    assert "nothing on /hub/measured" not in process.output()
    assert len(list(path.glob("*.mcap"))) > 1
    with Bag(path) as bag:
        said = bag.provenance()
    assert (said["operator"], said["camera"]) == ("A. Person", "cam 2")
    assert json.loads(said["rig"])["camera"]["name"] == "cam 2"


@pytest.mark.slow
def test_what_the_middleware_drops_is_counted(executables, graph, tmp_path):
    recorder = Recorder(executables, graph, tmp_path / "run")
    measured = graph.publisher("hub/measured", QualityOfService(50))
    first = recorder.warm_up(measured, "hub/measured", _encoded)
    for k in range(first, first + 10):
        measured.publish(_encoded(k))
        graph.spin(0.1)  # meanwhile the recorder has looked at the publishers
    recorder.signal(signal.SIGSTOP)
    for k in range(first + 10, first + 1500):
        measured.publish(_encoded(k))
    recorder.signal(signal.SIGCONT)
    graph.spin(1.0)
    measured.publish(_encoded(first + 1500))
    graph.spin(1.0)
    assert graph.call("recorder/stop").success
    graph.wait(lambda: not recorder.states[-1]["recording"], "the end of the recording")
    with Bag(tmp_path / "run") as bag:
        samples = bag.hub_samples()
    assert recorder.states[-1]["lost"] > 0
    assert samples.lost == recorder.states[-1]["lost"] * BATCH


@pytest.mark.slow
def test_an_existing_path_ends_with_one_line_and_status_2(executables, tmp_path):
    (tmp_path / "run").mkdir()
    recorder = executables.run("bag_recorder", "--ros-args", "-p", f"recorder.path:={tmp_path / 'run'}")
    assert recorder.process.returncode == 2
    assert "exists already" in recorder.output()
    assert len(recorder.output().strip().splitlines()) == 1
    assert list((tmp_path / "run").iterdir()) == []


@pytest.mark.slow
def test_sigterm_even_twice_closes_the_bag_of_a_rig_in_a_namespace(executables, graph, tmp_path):
    recorder = Recorder(executables, graph, tmp_path / "run", namespace="/rig1")
    measured = graph.publisher("hub/measured", namespace="/rig1")
    first = recorder.warm_up(measured, "hub/measured", _encoded)
    for k in range(first, first + 30):
        measured.publish(_encoded(k))
        graph.spin(0.005)
    graph.spin(0.3)
    for _ in range(2):
        recorder.signal(signal.SIGTERM)
    assert recorder.process.wait() == 0
    assert "Traceback" not in recorder.process.output()
    with Bag(tmp_path / "run") as bag:
        assert bag.namespace == "rig1"
        samples = bag.hub_samples()
    assert not samples.gaps
    assert samples.stamps_ns[-1] == START + ((first + 30) * BATCH - 1) * PERIOD
