"""Faults on request and `hub/mode`, with the emulated controller and its driver as real processes."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from beam_ros import messages
from beam_ros.hub.faults import fault

pytestmark = pytest.mark.ros
pytest.importorskip("rclpy")


def _request(graph, text: str):
    """Set `faults.request`; return the node's answer."""
    from rcl_interfaces.srv import SetParameters
    from rclpy.parameter import Parameter

    client = graph.node.create_client(SetParameters, "firmware_emulator/set_parameters")
    graph.wait(client.service_is_ready, "the emulator's parameters", 20.0)
    value = Parameter("faults.request", value=text).to_parameter_msg()
    future = client.call_async(SetParameters.Request(parameters=[value]))
    graph.wait(future.done, "an answer")
    graph.node.destroy_client(client)
    return future.result().results[0]


def test_a_fault_on_request_shows_in_the_mode_with_its_row_and_what_is_no_fault_is_refused(
    executables, graph, tmp_path: Path
) -> None:
    port = tmp_path / "controller"
    modes: list[dict[str, object]] = []
    graph.listen("hub/mode", lambda message: modes.append(messages.read_json(message)))
    patient = ("--ros-args", "-p", "hub.watchdog:=1.0")  # a busy computer is not what is tested here
    emulator = executables.start("firmware_emulator", *patient, "-p", f"emulator.port_link:={port}")
    emulator.wait_for("motion controller on", 20.0)
    executables.start("hub_driver", *patient, "-p", f"serial.port:={port}")
    graph.wait(lambda: bool(modes) and modes[-1]["state"] == "identified", "a connection", 30.0)
    assert set(modes[-1]) == {"state", "activity", "fault", "since", "reason"}
    assert modes[-1]["activity"] == "idle"
    assert modes[-1]["fault"] is None

    for text, word in (
        ("{fault: unplugg}", "unplug"),
        ("{fault: drop, share: 2.0}", "0 to 1"),
        ("[", "YAML"),
    ):
        answer = _request(graph, text)
        assert not answer.successful
        assert "faults.request" in answer.reason
        assert word in answer.reason
    graph.spin(0.3)
    assert modes[-1]["state"] == "identified"

    modes.clear()
    asked = time.time()
    assert _request(graph, "{fault: unplug, for: 1.5}").successful
    emulator.wait_for("fault: unplug")
    graph.wait(lambda: bool(modes), "a change of mode")
    lost = modes[0]
    assert lost["state"] == "disconnected"
    row = fault("port_lost")
    assert lost["fault"] == {name: getattr(row, name) for name in ("number", "name", "sentence", "remedy")}
    assert str(port) in lost["reason"]
    assert 0 <= lost["since"] - asked < 5.0
    # Latched: who comes later hears at once where the hub stands.
    late: list[dict[str, object]] = []
    graph.listen("hub/mode", lambda message: late.append(messages.read_json(message)))
    graph.wait(lambda: bool(late), "the latched mode")
    assert late[0] in modes
    graph.wait(lambda: modes[-1]["state"] == "identified", "the driver back", 20.0)
    assert modes[-1]["fault"] is None
    assert modes[-1]["since"] > lost["since"]
