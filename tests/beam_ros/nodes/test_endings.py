"""SIGINT and SIGTERM, also twice, end every node with status 0, no traceback and nothing left behind."""

from __future__ import annotations

import signal
import time

import pytest

from beam_ros.interfaces import NODES
from beam_ros.rig import Rig
from beam_ros.simulation import simulate

pytestmark = pytest.mark.ros
pytest.importorskip("rclpy")


def _arguments(executable: str, tmp_path) -> list[str]:
    if executable == "bag_player":
        bag = tmp_path / "bag"
        simulate(Rig.from_file().with_values({"excitation.duration": 1.0, "excitation.still": 20.0}), bag)
        return ["-p", f"player.bag:={bag}"]
    if executable == "bag_recorder":
        return ["-p", f"recorder.path:={tmp_path / 'recording'}"]
    return []


def _start(executables, graph, executable: str, tmp_path):
    words = _arguments(executable, tmp_path)
    if executable == "hub_driver":
        port = tmp_path / "controller"
        emulator = executables.start("firmware_emulator", "--ros-args", "-p", f"emulator.port_link:={port}")
        emulator.wait_for("motion controller on")
        words = ["-p", f"serial.port:={port}"]
    node = executables.start(executable, "--ros-args", *words)
    name = NODES[executable].name
    graph.wait(lambda: (name, "/") in graph.node.get_node_names_and_namespaces(), f"node {name}", 20.0)
    graph.spin(0.3)
    return node


@pytest.mark.parametrize("executable", sorted(NODES))
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_node_cleanly_also_when_it_comes_twice(
    executables, graph, tmp_path, executable: str, number: signal.Signals
) -> None:
    node = _start(executables, graph, executable, tmp_path)
    node.send_signal(number)
    if number is signal.SIGINT:
        time.sleep(0.02)
        node.send_signal(number)
    assert node.wait(8.0) == 0, node.output()
    assert "Traceback" not in node.output()
    assert "Error" not in node.output()
