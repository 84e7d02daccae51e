"""The node `live_identifier` beside a rig that runs: it grows, ends with the bag's answer, and disturbs nobody."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from beam_ros import messages
from beam_ros.messages import LiveIdentification
from beam_ros.offline.identification import identification_of_bags

pytestmark = pytest.mark.ros
pytest.importorskip("rclpy")

RIG = ("-p", "simulation.images:=false", "-p", "hub.watchdog:=1.0")
OFTEN = ("-p", "live.share_of_core:=0.6")  # so that a busy computer, too, estimates before so short an end
SHORT = ("-p", "excitation.duration:=8.0", "-p", "excitation.still:=3.0")


def listen(graph) -> list[LiveIdentification]:
    said: list[LiveIdentification] = []
    graph.listen(
        "identification/live", lambda message: said.append(LiveIdentification.from_json(message.data))
    )
    return said


def test_it_grows_with_a_rig_and_ends_with_the_answer_of_the_recorded_bag(
    executables, graph, tmp_path: Path
) -> None:
    said, recorded = listen(graph), []
    graph.listen("recorder/state", lambda message: recorded.append(messages.read_json(message)))
    nodes = [
        executables.start("simulator", "--ros-args", *RIG),
        executables.start("excitation_generator", "--ros-args", *SHORT),
        executables.start("bag_recorder", "--ros-args", "-p", f"recorder.path:={tmp_path / 'bag'}"),
        executables.start("live_identifier", "--ros-args", *OFTEN, "-p", "live.aims:=f1:1%, zeta2:1e-9"),
    ]
    graph.wait(lambda: bool(said) and bool(recorded), "the nodes")
    assert said[0].state == "waiting"
    graph.switch_on()
    graph.call("excitation/start")
    graph.wait(lambda: said[-1].state == "ended", "the end of the excitation", 90.0)
    states = [own.state for own in said]
    assert {"waiting", "ended"} < set(states), states
    assert {"growing", "known"} & set(states), states
    last = said[-1]
    graph.call("recorder/stop")
    graph.wait(lambda: not recorded[-1]["recording"], "the end of the recording")
    assert recorded[-1]["lost"] == 0
    model = identification_of_bags(tmp_path / "bag").result.model
    assert len(last.modes) == model.n_modes
    for mode, omega_hz, sd in zip(last.modes, model.frequencies_hz, model.natural_frequency_sd, strict=True):
        # Both hear the same rig, and where the computer is busy not the same messages; on the same ones they agree to
        # the last digit (tests/beam_ros/offline/test_live_estimate.py).
        assert abs(mode.frequency_hz - omega_hz) < mode.frequency_sd_hz + sd / 6.2832
    for node in nodes:
        node.send_signal(signal.SIGINT)
    assert [node.wait(20.0) for node in nodes] == [0] * len(nodes), nodes[-1].output()
    assert "Traceback" not in nodes[-1].output()


def test_without_a_rig_it_says_what_it_waits_for_and_leaves_no_process(executables, graph) -> None:
    said = listen(graph)
    node = executables.start("live_identifier")
    graph.wait(lambda: any("Nothing on hub/measured" in own.sentence for own in said), "what is missing")
    children = Path(f"/proc/{node.process.pid}/task/{node.process.pid}/children").read_text().split()
    nice = [os.getpriority(os.PRIO_PROCESS, int(pid)) for pid in children]
    assert max(nice) == os.getpriority(os.PRIO_PROCESS, node.process.pid) + 10
    node.send_signal(signal.SIGINT)
    assert node.wait(20.0) == 0, node.output()
    # Python's own tracker of shared things ends a moment after those who shared them.
    graph.wait(lambda: not [pid for pid in children if Path(f"/proc/{pid}/exe").exists()], "the end of all")
    graph.wait(lambda: "The node has ended" in said[-1].sentence, "the last word")
    assert "Traceback" not in node.output()


def test_aims_that_are_none_end_the_node_with_one_line(executables) -> None:
    node = executables.run("live_identifier", "--ros-args", "-p", "live.aims:=fast", timeout_s=60.0)
    assert node.process.returncode == 2
    assert "expected f1:0.01%" in node.output()
    assert "Traceback" not in node.output()
