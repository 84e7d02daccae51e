"""Simulator and driver are the same node to everybody else: compared on the graph, side by side.

The driver talks to the firmware emulator over a real pseudo-terminal; the two rigs live in namespaces.
"""

from __future__ import annotations

import contextlib
import json
import signal
import time
from pathlib import Path

import numpy as np
import pytest

from beam_ros import messages
from beam_ros.bags.batches import decode_batch
from beam_ros.interfaces.graph import JOINT_TRAJECTORY, NODES, SERVICES, STRING, TOPICS
from beam_ros.shell.node import qos_profile

pytestmark = pytest.mark.ros
pytest.importorskip("rclpy")


@pytest.fixture
def rigs(executables, graph, tmp_path: Path):
    """Both rigs running: namespaces `a` (simulator) and `b` (emulator and driver)."""
    patient = ("-p", "hub.watchdog:=1.0")  # a busy computer is not what is tested here
    quiet = ("-p", "simulation.images:=false", *patient)
    port = tmp_path / "controller"
    linked = ("-p", f"emulator.port_link:={port}", "-p", f"serial.port:={port}", *patient)
    executables.start("simulator", "--ros-args", "-r", "__ns:=/a", *quiet)
    executables.start("firmware_emulator", "--ros-args", "-r", "__ns:=/b", *linked).wait_for(
        "motion controller on"
    )
    executables.start("hub_driver", "--ros-args", "-r", "__ns:=/b", *linked)
    for rig in "ab":
        graph.wait(
            lambda rig=rig: ("hub", f"/{rig}") in graph.node.get_node_names_and_namespaces(),
            f"hub of {rig}",
            15.0,
        )
    expected = len(NODES["hub_driver"].publishes)
    graph.wait(lambda: all(len(_publishers(graph, rig)) >= expected for rig in "ab"), "topics", 15.0)
    return graph


def _publishers(graph, rig):
    """Topics of the hub with type and qualities of service, namespace taken off."""
    found = {}
    for topic, types in graph.node.get_publisher_names_and_types_by_node("hub", f"/{rig}"):
        if topic.startswith(f"/{rig}/hub/") or topic == "/diagnostics":
            for info in graph.node.get_publishers_info_by_topic(topic):
                if info.node_namespace == f"/{rig}" and info.node_name == "hub":
                    qos = info.qos_profile
                    row = (tuple(types), qos.reliability, qos.durability)
                    found[topic.removeprefix(f"/{rig}/")] = row
    return found


def _services(graph, rig):
    rows = graph.node.get_service_names_and_types_by_node("hub", f"/{rig}")
    return {(name.removeprefix(f"/{rig}/"), tuple(types)) for name, types in rows}


def _subscriptions(graph, rig):
    rows = graph.node.get_subscriber_names_and_types_by_node("hub", f"/{rig}")
    return {(name.removeprefix(f"/{rig}/"), tuple(types)) for name, types in rows}


def _settled(graph, look):
    """What both rigs show; discovery brings one thing after the other, so until it is the same or time is over."""
    with contextlib.suppress(AssertionError):
        graph.wait(lambda: look(graph, "a") == look(graph, "b"), "agreement")
    return look(graph, "a"), look(graph, "b")


def test_topics_types_qos_services_and_parameters_are_the_same(rigs) -> None:
    simulator, driver = _settled(rigs, _publishers)
    assert simulator == driver
    assert set(NODES["hub_driver"].publishes) == set(driver)
    for topic, (types, reliability, durability) in driver.items():
        profile = qos_profile(TOPICS[topic].qos)
        assert types == (TOPICS[topic].type_name,)
        assert (reliability, durability) == (profile.reliability, profile.durability)
    simulator, driver = _settled(rigs, _services)
    assert simulator == driver
    promised = {(name, (SERVICES[name].type_name,)) for name in NODES["hub_driver"].serves}
    assert promised <= driver
    simulator, driver = _settled(rigs, _subscriptions)
    assert simulator == driver
    assert set(NODES["hub_driver"].subscribes) <= {name for name, _ in driver}


def test_the_same_experiment_gives_the_same_applied_samples_and_states(rigs) -> None:
    """Home, enable, one short sequence: same answers, same states, same applied values, sample by sample."""
    applied = {"a": [], "b": []}
    states = {"a": [], "b": []}
    types = rigs.types
    trajectory = types.message_class(JOINT_TRAJECTORY)
    text = types.message_class(STRING)
    outputs = {}
    for rig in "ab":
        rigs.node.create_subscription(
            trajectory,
            f"/{rig}/hub/applied",
            applied[rig].append,
            qos_profile(TOPICS["hub/applied"].qos),
            raw=True,
        )
        rigs.node.create_subscription(
            text,
            f"/{rig}/hub/sequence_state",
            lambda m, rig=rig: states[rig].append(json.loads(m.data)),
            qos_profile(TOPICS["hub/sequence_state"].qos),
        )
        outputs[rig] = rigs.node.create_publisher(
            trajectory, f"/{rig}/hub/sequence", qos_profile(TOPICS["hub/sequence"].qos)
        )
        rigs.switch_on(f"/{rig}")
    values = 0.5 * np.sin(2 * np.pi * 5 * np.arange(600) * 1e-3) * np.hanning(600)
    values[-1] = 0.0
    values -= np.hanning(600) * values.sum() / np.hanning(600).sum()
    _wait_for_clock(rigs)
    starts = {}
    for rig in "ab":
        starts[rig] = rigs.node.get_clock().now().nanoseconds + 1_000_000_000
        for chunk in messages.split_sequence(f"run-{rig}", starts[rig], 1_000_000, values):
            outputs[rig].publish(messages.sequence_chunk(types, chunk, "acceleration"))
    rigs.wait(
        lambda: all(states[rig] and states[rig][-1]["state"] == "done" for rig in "ab"),
        f"both sequences ({states})",
        10.0,
    )
    rigs.spin(0.3)
    seen = {}
    for rig in "ab":
        order = [state["state"] for state in states[rig]]
        seen[rig] = [s for k, s in enumerate(order) if k == 0 or order[k - 1] != s]
        batches = [decode_batch(data) for data in applied[rig]]
        samples = np.concatenate([batch.accelerations for batch in batches])
        stamps = np.concatenate([b.stamp_ns + b.period_ns * np.arange(len(b)) for b in batches])
        moving = np.flatnonzero(samples)
        # The line carries single precision: 6e-8 of a value.
        np.testing.assert_allclose(
            samples[moving[0] - 1 : moving[0] - 1 + 600], values, rtol=1e-7, atol=1e-12
        )
        # A sequence begins with a tick of the device, 1 ms long; its clock is mapped to better than 0.2 ms.
        assert abs(stamps[moving[0] - 1] - starts[rig]) < 1_200_000
        assert np.all(np.abs(np.diff(stamps) - 1_000_000) < 100_000)
    # The topic keeps its last message only, so that a listener may miss a state, but never the order.
    assert seen["a"][-2:] == seen["b"][-2:] == ["running", "done"]


def test_a_clock_that_jumps_is_an_error_everywhere_and_the_state_is_published_no_more(rigs) -> None:
    modes, levels, states = [], [], []
    rigs.listen("hub/mode", lambda m: modes.append(json.loads(m.data)), namespace="/b")
    rigs.listen("hub/state", states.append, namespace="/b")
    rigs.listen(
        "/diagnostics",
        lambda m: levels.extend(s for s in messages.read_diagnostics(m) if s.name.endswith("hub_driver")),
    )
    _wait_for_clock(rigs)
    rigs.switch_on("/b")
    rigs.wait(lambda: modes and modes[-1]["state"] == "enabled" and states, "the enabled hub")
    set_class = rigs.types.service_class("rcl_interfaces/srv/SetParameters")
    parameter = rigs.types.message_class("rcl_interfaces/msg/Parameter")(name="faults.request")
    parameter.value.type, parameter.value.string_value = 4, "{fault: step, seconds: 30}"
    client = rigs.node.create_client(set_class, "/b/firmware_emulator/set_parameters")
    rigs.wait(client.service_is_ready, "the emulator's parameters")
    client.call_async(set_class.Request(parameters=[parameter]))
    rigs.wait(lambda: modes[-1]["state"] == "fault", f"the fault ({modes})")
    assert modes[-1]["fault"]["name"] == "clock_jumped"
    assert "expected" in modes[-1]["reason"]
    n_states = len(states)
    levels.clear()
    rigs.wait(lambda: bool(levels), "diagnostics")
    assert levels[-1].level == "ERROR"
    assert levels[-1].message.startswith("fault: ")
    rigs.spin(0.5)
    assert len(states) <= n_states + 1
    rigs.ask("hub/clear_fault", "/b")
    rigs.wait(lambda: modes[-1]["state"] == "identified", "the end of the fault")
    rigs.wait(lambda: len(states) > n_states + 5, "the state's return")


def _wait_for_clock(graph) -> None:
    """Wait until the driver has mapped the device's clock well enough to start a sequence."""
    sd = []

    def note(message) -> None:
        for status in messages.read_diagnostics(message):
            if status.name.endswith("hub_driver") and "clock_sd_ns" in status.values:
                sd.append(int(status.values["clock_sd_ns"]))

    graph.listen("/diagnostics", note)
    graph.wait(lambda: bool(sd) and sd[-1] < 50_000, "a mapped clock", 20.0)


def test_an_emulator_that_stood_still_for_longer_than_it_remembers_goes_on(
    executables, graph, tmp_path: Path
) -> None:
    emulator = executables.start(
        "firmware_emulator", "--ros-args", "-p", f"emulator.port_link:={tmp_path / 'port'}"
    )
    seen = []
    graph.listen("camera/camera_info", lambda message: seen.append(message.header.stamp.sec))
    graph.wait(lambda: bool(seen), "a first frame", 30.0)
    emulator.send_signal(signal.SIGSTOP)
    time.sleep(4.6)
    emulator.send_signal(signal.SIGCONT)
    before = seen[-1]
    graph.wait(lambda: seen[-1] > before + 5, "new frames", 20.0)
    assert emulator.process.poll() is None


@pytest.mark.parametrize("executable", ["simulator", "firmware_emulator"])
def test_a_simulation_that_cannot_keep_up_warns_in_the_diagnostics(
    executables, graph, executable: str
) -> None:
    said = []

    def note(message) -> None:
        said.extend(status for status in messages.read_diagnostics(message) if status.level != "OK")

    graph.listen("/diagnostics", note)
    # Two thousand frames a second of 2 megapixels are more than any computer draws.
    words = ("camera.rate:=2000.0", "camera.exposure:=0.0002", "camera.width:=1920", "camera.height:=1080")
    executables.start(executable, "--ros-args", *(part for word in words for part in ("-p", word)))
    graph.wait(lambda: any("frames were lost" in status.message for status in said), "a warning", 30.0)
    warning = next(status for status in said if "frames were lost" in status.message)
    assert warning.level == "WARN"
    assert int(warning.values["dropped frames"]) > 0
