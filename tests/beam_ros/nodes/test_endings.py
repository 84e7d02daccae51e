"""SIGINT and SIGTERM, at any time and also twice, end every node with status 0, no traceback and nothing left."""

from __future__ import annotations

import signal
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from beam_ros import messages
from beam_ros.bags.batches import encode_chunk
from beam_ros.hub.contract import SequenceChunk
from beam_ros.interfaces.graph import NODES
from beam_ros.offline.simulation import simulate
from beam_ros.process.executables import command
from beam_ros.rig.rig import Rig

pytestmark = pytest.mark.ros
pytest.importorskip("rclpy")


def _parameters(executable: str, folder: Path) -> list[str]:
    """Parameters with which a node has something to do until it is told to end."""
    port = folder / "controller"
    return {
        "bag_player": ["-p", f"player.bag:={folder / 'bag'}"],
        "bag_recorder": ["-p", f"recorder.path:={folder / 'recording'}"],
        "firmware_emulator": ["-p", f"emulator.port_link:={port}"],
        "hub_driver": ["-p", f"serial.port:={port}", "-p", "serial.patience:=20.0"],
    }.get(executable, [])


@pytest.mark.parametrize(("number", "times"), [(signal.SIGINT, 2), (signal.SIGTERM, 1)])
def test_a_signal_ends_every_node_cleanly_also_when_it_comes_twice(
    executables: Any, graph: Any, tmp_path: Path, number: signal.Signals, times: int
) -> None:
    simulate(
        Rig.from_file().with_values({"excitation.duration": 1.0, "excitation.still": 25.0}), tmp_path / "bag"
    )
    # Each in a namespace of its own: simulator and driver are both `hub`, and no bag is played beside a hub.
    nodes = {
        name: executables.start(name, "--ros-args", "-r", f"__ns:=/{name}", *_parameters(name, tmp_path))
        for name in sorted(NODES)
    }
    wanted = {(NODES[name].name, f"/{name}") for name in nodes}
    graph.wait(lambda: wanted <= set(graph.node.get_node_names_and_namespaces()), "every node", 40.0)
    graph.spin(1.0)
    for _ in range(times):
        for node in nodes.values():
            if node.process.poll() is None:
                node.send_signal(number)
        time.sleep(0.02)
    for name, node in nodes.items():
        assert node.wait(60.0) == 0, f"{name}: {node.output()}"
        assert "Traceback" not in node.output(), node.output()
        assert "Error" not in node.output(), node.output()


@pytest.mark.parametrize("delay_s", [0.01, 0.05, 0.15, 0.35, 0.6, 1.0])
def test_ctrl_c_in_the_first_second_ends_every_command_without_a_traceback(
    executables: Any, tmp_path: Path, delay_s: float
) -> None:
    """All at once, so that each meets the signal somewhere else in its start."""
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    held_back = ("env", "--block-signal=INT")  # as the first line of the installed scripts says
    commands = {name: ("--ros-args", *_parameters(name, tmp_path)) for name in NODES}
    commands |= {"up": ("up", "--rig", "emulated"), "demo": ("demo", "--out", "run")}
    running = {}
    for name, words in commands.items():
        executable = name if name in NODES else "beam"
        environment = {"TMPDIR": str(scratch)}
        program = [*held_back, *command(executable)]
        running[name] = executables.start(executable, *words, environment=environment, program=program)
    time.sleep(delay_s)
    for started in running.values():
        started.send_signal(signal.SIGINT)
    for name, started in running.items():
        expected = 0 if name in NODES else 130
        # What needs a bag that is not there may have said so already.
        assert started.wait(60.0) in (expected, 2), (name, started.output())
        assert "Traceback" not in started.output(), (name, started.output())
    assert list(scratch.iterdir()) == []


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("executable", ["hub_driver", "simulator"])
def test_the_last_word_of_a_hub_is_that_nobody_leads_the_axis(
    executables: Any, graph: Any, tmp_path: Path, executable: str, number: signal.Signals
) -> None:
    modes, sequences, recordings = [], [], []
    graph.listen("hub/mode", lambda m: modes.append(messages.read_json(m)))
    graph.listen("hub/sequence_state", lambda m: sequences.append(messages.read_json(m)))
    graph.listen("recorder/state", lambda m: recordings.append(messages.read_json(m)))
    port = tmp_path / "controller"
    if executable == "hub_driver":
        executables.start("firmware_emulator", "--ros-args", "-p", f"emulator.port_link:={port}")
    hub = executables.start(
        executable,
        *("--ros-args", "-p", f"serial.port:={port}", "-p", "serial.patience:=20.0"),
        *("-p", "simulation.images:=false"),
    )
    recorder = executables.start("bag_recorder", "--ros-args", *_parameters("bag_recorder", tmp_path))
    graph.wait(lambda: modes and modes[-1]["state"] == "identified", "an axis", 30.0)
    graph.switch_on()
    chunk = SequenceChunk("half", 1, 2, time.time_ns() + 10**10, 1_000_000, 0, np.zeros(500))
    publisher = graph.publisher("hub/sequence")
    graph.wait(lambda: publisher.get_subscription_count() > 0, "a listener")
    publisher.publish(encode_chunk(chunk, "acceleration"))
    graph.wait(lambda: bool(sequences), "half a sequence")
    assert (modes[-1]["state"], sequences[-1]["state"]) == ("enabled", "loading")
    hub.send_signal(number)
    assert hub.wait(60.0) == 0
    graph.spin(0.5)
    assert (modes[-1]["state"], modes[-1]["activity"]) == ("disconnected", "idle")
    assert "the node has ended" in modes[-1]["reason"]
    assert sequences[-1]["state"] == "aborted"
    graph.wait(lambda: recordings and recordings[-1]["recording"], "a recording")
    recorder.send_signal(number)
    assert recorder.wait(60.0) == 0
    graph.spin(0.5)
    assert not recordings[-1]["recording"]


BUSY = """
import sys
from beam_ros.shell.node import RigNode, run_node

class Busy(RigNode):
    def __init__(self):
        super().__init__("identifier")
        self.create_timer(0.1, self._work)
    def _work(self):
        self.get_logger().info("busy")
        while True:
            self._publish_diagnostics()

sys.exit(run_node(Busy, []))
"""


def test_a_node_whose_callback_does_not_end_ends_all_the_same(executables: Any) -> None:
    node = executables.start("identifier", program=[sys.executable, "-c", BUSY])
    node.wait_for("busy")
    node.send_signal(signal.SIGINT)
    assert node.wait(60.0) == 0
    assert "Traceback" not in node.output()
