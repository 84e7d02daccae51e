"""The table of the graph is what runs: every node's topics, services, types, qualities of service and parameters."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import pytest

from beam_ros.interfaces.graph import NODES, SERVICES, TOPICS
from beam_ros.shell.node import qos_profile
from tests.beam_ros.bags.small_bags import write_experiment

pytestmark = pytest.mark.ros
pytest.importorskip("rclpy")

READING_NODE = Path(__file__).with_name("reading_node.py")
OF_ROS = {"/rosout", "/parameter_events"}
OF_ROS_SERVICES = ("_parameters", "_parameter_types", "_parameters_atomically", "/get_type_description")
ONLY_OTHERWISE_READ = {
    *(f"tracker.{name}" for name in ("device", "device_format", "sets_exposure", "retry_period")),
    *("tracker.video", "tracker.video_rate", "tracker.save_calibration"),
    *("hub.max_tip_deflection", "beam.max_root_strain", "beam.air_temperature", "beam.air_pressure"),
    *(name for name in NODES["excitation_generator"].parameters if name.startswith("excitation.")),
    *(
        name
        for name in NODES["hub_driver"].parameters
        if name.startswith(("axis.", "trajectory.", "odrive.", "dynamixel.", "csv."))
    ),
    *("emulator.controller_rate", "faults.request", "camera.clock_tolerance"),
    *("live.share_of_core", "live.memory", "live.niceness"),
}
"""Parameters whose reading takes another camera source, excitation, axis link or beam than those of this test, or
which the process of the estimate reads."""
PLAYED = ("bag_player", "publishes")
IN_THE_BAG = {"hub/measured", "beam/displacement", "excitation/info", "/diagnostics"}
"""A player publishes what is in its bag."""


class Runs:
    """Nodes under watch, each in a namespace, and what the graph has shown of them so far."""

    def __init__(self, executables, graph, folder: Path) -> None:
        self._executables, self._graph, self._folder = executables, graph, folder
        self._running = []
        self.seen = {
            name: {"publishes": set(), "subscribes": set(), "serves": set(), "calls": set()} for name in NODES
        }

    def start(self, executable: str, namespace: str, *parameters: str):
        reads = self._folder / f"{len(self._running)}.json"
        words = [word for parameter in parameters for word in ("-p", parameter)]
        program = [sys.executable, str(READING_NODE), executable, str(reads)]
        arguments = ("--ros-args", "-r", f"__ns:=/{namespace}", *words)
        running = self._executables.start(executable, *arguments, program=program, timeout_s=180.0)
        self._running.append((executable, f"/{namespace}", running, reads))
        return running

    def look(self) -> None:
        """Add what is on the graph now."""
        node = self._graph.node
        for executable, namespace, _, _ in self._running:
            place = (NODES[executable].name, namespace)
            if place not in node.get_node_names_and_namespaces():
                continue
            found = {
                "publishes": node.get_publisher_names_and_types_by_node(*place),
                "subscribes": node.get_subscriber_names_and_types_by_node(*place),
                "serves": node.get_service_names_and_types_by_node(*place),
                "calls": node.get_client_names_and_types_by_node(*place),
            }
            for kind, rows in found.items():
                for name, types in rows:
                    if name in OF_ROS or name.endswith(OF_ROS_SERVICES):
                        continue
                    short = name.removeprefix(f"{namespace}/")
                    table = TOPICS if kind in ("publishes", "subscribes") else SERVICES
                    assert short in table, f"{executable} {kind} {name}, which the table does not hold"
                    assert types == [table[short].type_name], (executable, name)
                    self.seen[executable][kind].add(short)
            self._check_qualities(executable, *place)

    def _check_qualities(self, executable: str, name: str, namespace: str) -> None:
        node = self._graph.node
        for kind, ask in (
            ("publishes", node.get_publishers_info_by_topic),
            ("subscribes", node.get_subscriptions_info_by_topic),
        ):
            for topic in self.seen[executable][kind]:
                wanted = qos_profile(TOPICS[topic].qos)
                for info in ask(topic if topic.startswith("/") else f"{namespace}/{topic}"):
                    if (info.node_name, info.node_namespace) == (name, namespace):
                        seen = (info.qos_profile.reliability, info.qos_profile.durability)
                        assert seen == (wanted.reliability, wanted.durability), (executable, topic)

    def missing(self) -> dict[tuple[str, str], set[str]]:
        """What the table promises and the graph has not shown yet, by node and kind."""
        self.look()
        rows = {
            (name, kind): set(getattr(row, kind) if (name, kind) != PLAYED else IN_THE_BAG) - seen
            for name, row in NODES.items()
            for kind, seen in self.seen[name].items()
        }
        return {place: names for place, names in rows.items() if names}

    def reads(self) -> dict[str, set[str]]:
        """End the nodes and return what each has read."""
        found: dict[str, set[str]] = {name: set() for name in NODES}
        self._executables.interrupt()
        for executable, _, running, reads in self._running:
            running.wait(20.0)
            found[executable] |= set(json.loads(reads.read_text()))
        return found


def test_every_node_is_on_the_graph_as_its_row_says_and_reads_what_it_declares(
    executables, graph, tmp_path: Path
) -> None:
    runs = Runs(executables, graph, tmp_path)
    slow = ("camera.rate:=10.0", "camera.width:=480")
    port = tmp_path / "controller"
    linked = (f"emulator.port_link:={port}", f"serial.port:={port}", "serial.patience:=30.0", *slow)
    made_up = (
        *("simulation.images:=false", "simulation.real_time_factor:=1.5"),
        "simulation.preset:=realistic",
    )
    runs.start("simulator", "a", *slow)
    runs.start("vision_tracker", "a", *slow, "tracker.averaged_frames:=2")
    # The lens is listened to until it is known: here a camera never says it, and the subscription can be seen.
    for topic in ("camera/image_raw/compressed", "camera/camera_info"):
        graph.publisher(topic, namespace="/e")
    runs.start("vision_tracker", "e", *slow, "tracker.source:=compressed")
    runs.start("excitation_generator", "a", "excitation.duration:=2.0", "excitation.still:=1.0")
    runs.start("bag_recorder", "a", f"recorder.path:={tmp_path / 'recording'}", "recorder.images:=true")
    runs.start("identifier", "a", f"identifier.bag:={tmp_path / 'nowhere'}")
    runs.start("live_identifier", "a")
    runs.start("firmware_emulator", "b", *linked, "simulation.preset:=realistic")
    runs.start("hub_driver", "b", *linked)
    runs.start("simulator", "c", *made_up)
    bag = write_experiment(tmp_path / "bag", batches=1500)
    runs.start("bag_player", "d", f"player.bag:={bag}")
    end = time.monotonic() + 120.0
    while missing := runs.missing():
        assert time.monotonic() < end, f"not on the graph within two minutes: {missing}"
        graph.spin(0.1)
    graph.spin(1.0)
    runs.look()
    for name, row in NODES.items():
        for kind, seen in runs.seen[name].items():
            if (name, kind) != PLAYED:
                assert seen == set(getattr(row, kind)), (name, kind)
    assert runs.seen["bag_player"]["publishes"] <= set(NODES["bag_player"].publishes)
    graph.switch_on("/a")
    answers: list[object] = []
    graph.listen("identification/result", answers.append, namespace="/a")
    for service in (
        "tracker/capture_point",
        "excitation/start",
        "identifier/identify",
        "tracker/tare",
        "tracker/fit_calibration",
    ):
        graph.call(service, "/a")
    graph.wait(lambda: bool(answers), "what became of the identification", 60.0)
    undeclared, unread = set(), set()
    for name, reads in runs.reads().items():
        declared = set(NODES[name].parameters)
        undeclared |= {(name, parameter) for parameter in reads - declared}
        unread |= {(name, parameter) for parameter in declared - reads}
    assert undeclared == set()
    assert {parameter for _, parameter in unread} <= ONLY_OTHERWISE_READ, unread
