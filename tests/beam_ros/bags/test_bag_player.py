"""The player as a real process over DDS: the old bytes in the old rhythm, and never onto a live axis."""

from __future__ import annotations

import signal
import time

import numpy as np
import pytest

from beam_ros import messages
from beam_ros.bags.batches import encode_batch, encode_chunk
from beam_ros.bags.reading import Bag
from beam_ros.bags.writing import BagWriter
from tests.beam_ros.bags.small_bags import BATCH, START, TYPES, batch, write_experiment

pytestmark = pytest.mark.ros
pytest.importorskip("rclpy")


def _with_commands(path, *, batches=50):
    with BagWriter(path) as bag:
        for chunk in messages.split_sequence("chirp", START, 1_000_000, np.zeros(600)):
            bag.write("hub/sequence", START, encode_chunk(chunk, "acceleration"))
        for k in range(batches):
            bag.write_batch("hub/measured", START + k * BATCH * 1_000_000, batch(k))
        bag.write_message("excitation/info", START, messages.json_text(TYPES, {"kind": "chirp"}))
    return path


def _play(executables, path, **parameters):
    values = {"player.bag": path, **parameters}
    arguments = [word for name, value in values.items() for word in ("-p", f"{name}:={value}")]
    return executables.start("bag_player", "--ros-args", *arguments)


@pytest.mark.slow
def test_bytes_come_back_in_their_rhythm_without_commands(executables, graph, tmp_path):
    path = _with_commands(tmp_path / "run")
    measured, commands, infos = [], [], []
    graph.listen("hub/measured", lambda data: measured.append((time.monotonic(), data)), raw=True)
    graph.listen("hub/sequence", commands.append)
    graph.listen("excitation/info", lambda message: infos.append(messages.read_json(message)))
    player = _play(executables, path, **{"player.rate": 2.0})
    graph.wait(lambda: player.process.poll() is not None, "the end of the replay", 15.0)
    assert player.wait() == 0, player.output()
    assert [data for _, data in measured] == [encode_batch(batch(k)) for k in range(50)]
    assert commands == []
    assert infos == [{"kind": "chirp"}]
    times = np.array([moment for moment, _ in measured])
    ideal = np.arange(50) * 0.01  # a batch every 20 ms, at twice the speed
    # The middle half of the deviations: a busy machine delays some, never most, by milliseconds.
    late = times - times[0] - ideal
    assert np.quantile(np.abs(late - np.median(late)), 0.5) < 5e-3


@pytest.mark.slow
def test_commands_are_played_when_told(executables, graph, tmp_path):
    path = _with_commands(tmp_path / "run", batches=5)
    chunks = []
    graph.listen(
        "hub/sequence", lambda message: chunks.append(messages.read_sequence_chunk(message, 1_000_000))
    )
    player = _play(executables, path, **{"player.commands": "true"})
    graph.wait(lambda: player.process.poll() is not None, "the end of the replay", 15.0)
    assert player.wait() == 0, player.output()
    assert [(mode, chunk.index, chunk.start_ns) for mode, chunk in chunks] == [
        ("acceleration", 1, START),
        ("acceleration", 2, START),
    ]


@pytest.mark.slow
def test_a_live_hub_by_its_topic_is_refused(executables, graph, tmp_path):
    publisher = graph.publisher("hub/measured")
    player = _play(executables, write_experiment(tmp_path / "run"))
    assert player.wait() == 2
    assert "publisher of hub/measured" in player.output()
    assert "ROS_DOMAIN_ID" in player.output()
    assert "Traceback" not in player.output()
    graph.node.destroy_publisher(publisher)


@pytest.mark.slow
def test_a_live_hub_by_its_name_is_refused_even_when_it_comes_late(executables, tmp_path):
    from tests.graph import Graph

    player = _play(executables, write_experiment(tmp_path / "run", batches=500))
    player.wait_for("playing")
    with Graph("hub") as hub:
        hub.wait(lambda: player.process.poll() is not None, "the player's end")
    assert player.wait() == 2
    assert "node `hub`" in player.output()


@pytest.mark.slow
def test_a_signal_ends_the_replay(executables, tmp_path):
    player = _play(executables, write_experiment(tmp_path / "run", batches=500))
    player.wait_for("playing")
    player.send_signal(signal.SIGINT)
    player.send_signal(signal.SIGINT)
    assert player.wait() == 0
    assert "Traceback" not in player.output()


@pytest.mark.slow
def test_a_bag_that_is_not_there_is_one_line_and_status_2(executables, tmp_path):
    player = _play(executables, tmp_path / "nothing")
    assert player.wait() == 2
    assert "does not exist" in player.output()
    assert len(player.output().strip().splitlines()) == 1


@pytest.mark.slow
def test_a_replay_that_stands_still_goes_step_by_step_and_then_on(executables, graph, tmp_path):
    path = _with_commands(tmp_path / "run", batches=30)
    measured = []
    graph.listen("hub/measured", measured.append, raw=True)
    player = _play(executables, path, **{"player.paused": "true"})
    player.wait_for("playing")
    graph.spin(0.5)
    assert measured == []
    for _ in range(4):
        assert graph.call("player/step").success
    graph.spin(0.5)
    assert 2 <= len(measured) <= 4  # one of the steps is what is latched
    assert graph.call("player/pause", data=False).success
    graph.wait(lambda: player.process.poll() is not None, "the end of the replay", 15.0)
    assert measured == [encode_batch(batch(k)) for k in range(30)]
    assert "ms at most" in player.output()


@pytest.mark.slow
def test_a_replay_begins_later_over_and_over_and_makes_the_time(executables, graph, tmp_path):
    path = write_experiment(tmp_path / "run", batches=50)
    measured, clock = [], []
    graph.listen("hub/measured", measured.append, raw=True)
    graph.listen("/clock", lambda message: clock.append(messages.time_ns(message.clock)))
    settings = {"player.start": 0.7, "player.loop": "true", "player.clock": "true"}
    player = _play(executables, path, **settings)
    graph.wait(lambda: len(measured) > 40, "several rounds", 30.0)
    player.send_signal(signal.SIGINT)
    assert player.wait() == 0
    begin = next(k for k in range(50) if encode_batch(batch(k)) == measured[0])
    assert begin == pytest.approx(35, abs=1)
    one_round = [encode_batch(batch(k)) for k in range(begin, 50)]
    assert measured[: 2 * len(one_round)] == 2 * one_round
    assert START + 7 * 10**8 <= min(clock) < max(clock) <= START + 11 * 10**8


@pytest.mark.slow
def test_a_topic_is_played_under_another_name(executables, graph, tmp_path):
    path = write_experiment(tmp_path / "run", batches=10)
    renamed = []
    graph.listen("hub/measured", renamed.append, raw=True, namespace="/old")
    arguments = ["-p", f"player.bag:={path}", "-r", "hub/measured:=/old/hub/measured"]
    player = executables.start("bag_player", "--ros-args", *arguments)
    graph.wait(lambda: player.process.poll() is not None, "the end of the replay", 15.0)
    assert len(renamed) == 10


@pytest.mark.slow
def test_a_tracker_on_replayed_images_finds_the_displacements_that_it_found_live(
    executables, graph, tmp_path
):
    pytest.importorskip("cv2")
    bag, again = tmp_path / "film", []
    tracker = executables.start("vision_tracker")
    recorder = executables.start(
        "bag_recorder",
        "--ros-args",
        *("-p", f"recorder.path:={bag}", "-p", "recorder.images:=true"),
        timeout_s=120.0,
    )
    recorder.wait_for("recording to", 40.0)
    simulator = executables.start("simulator", timeout_s=120.0)
    states = []
    graph.listen("recorder/state", lambda message: states.append(messages.read_json(message)))
    graph.wait(
        lambda: bool(states) and states[-1]["topics"].get("/beam/displacement", 0) > 150, "frames", 60.0
    )
    for process in (simulator, recorder, tracker):
        process.send_signal(signal.SIGINT)
        assert process.wait() == 0, process.output()
    with Bag(bag) as recorded:
        live = recorded.displacements()

    graph.listen("beam/displacement", lambda message: again.append(messages.read_displacement(message)))
    tracker = executables.start("vision_tracker", timeout_s=120.0)
    renamed = [f"{topic}:=recorded/{topic}" for topic in ("beam/displacement", "beam/markers")]
    player = executables.start(
        "bag_player",
        "--ros-args",
        *("-p", f"player.bag:={bag}", "-p", "player.rate:=0.5", "-p", "player.paused:=true"),
        *(word for pair in renamed for word in ("-r", pair)),
        timeout_s=120.0,
    )
    # A tracker subscribes once it sees a camera.
    graph.wait(lambda: graph.node.count_subscribers("camera/image_raw") > 0, "a tracker that looks")
    player.wait_for("playing")
    graph.ask("player/pause", data=False)
    graph.wait(lambda: player.process.poll() is not None, "the end of the replay", 90.0)
    graph.spin(0.5)
    tracker.send_signal(signal.SIGINT)
    assert tracker.wait() == 0
    found = {item.stamp_ns: item for item in again}
    both = [k for k, stamp in enumerate(live.stamps_ns.tolist()) if stamp in found]
    assert len(both) > 100, (len(again), player.output(), tracker.output())
    columns = [live.names.index(name) for name in again[0].names]
    replayed = np.array([found[int(live.stamps_ns[k])].positions for k in both])
    off = np.abs(replayed - live.positions[both][:, columns])
    # The same pixels. The windows in them, and what was learned of the noise, depend on the frame in which the
    # markers were found first: a fifth of a displacement's standard deviation.
    assert np.nanmedian(off) < 6e-7
    assert np.nanmax(off) < 1e-5  # in the first frames, when little is learned
