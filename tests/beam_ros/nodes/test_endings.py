"""SIGINT and SIGTERM, also twice, end every node with status 0, no traceback and nothing left behind."""

from __future__ import annotations

import signal
import time
from pathlib import Path
from typing import Any

import pytest

from beam_ros.interfaces.graph import NODES
from beam_ros.offline.simulation import simulate
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
        assert node.wait(10.0) == 0, f"{name}: {node.output()}"
        assert "Traceback" not in node.output(), node.output()
        assert "Error" not in node.output(), node.output()
