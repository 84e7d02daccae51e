"""Parameters of the nodes: those that a node reads, in their types, refused in one line where they are wrong."""

from __future__ import annotations

import signal
import subprocess
import sys
from typing import Any

import pytest

from beam_ros.interfaces.graph import NODES
from beam_ros.interfaces.rig_parameters import RIG_PARAMETERS
from beam_ros.rig.rig import Rig
from beam_ros.rig.time_keeping import NO_CLOCK

pytestmark = pytest.mark.ros
rclpy = pytest.importorskip("rclpy")


class NodeParameters:
    """The parameter services of one node."""

    def __init__(self, graph, node: str) -> None:
        from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters

        self._graph = graph
        self._kinds = (DescribeParameters, GetParameters, ListParameters, SetParameters)
        names = ("describe_parameters", "get_parameters", "list_parameters", "set_parameters")
        self._clients = [
            graph.node.create_client(kind, f"{node}/{name}")
            for kind, name in zip(self._kinds, names, strict=True)
        ]
        graph.wait(lambda: all(c.service_is_ready() for c in self._clients), f"services of {node}", 20.0)

    def _ask(self, k, **fields):
        future = self._clients[k].call_async(self._kinds[k].Request(**fields))
        self._graph.wait(future.done, "an answer")
        return future.result()

    def describe(self, *names):
        return self._ask(0, names=names).descriptors

    def get(self, *names):
        from rclpy.parameter import parameter_value_to_python

        return [parameter_value_to_python(value) for value in self._ask(1, names=names).values]

    def names(self):
        return {name for name in self._ask(2).result.names if name in RIG_PARAMETERS}

    def set(self, name, value):
        from rclpy.parameter import Parameter

        return self._ask(3, parameters=[Parameter(name, value=value).to_parameter_msg()]).results[0]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("-p", "beam.lenght:=0.3"), "did you mean beam.length"),
        (("-p", "beam.length:=300"), "0.01 to 5 m"),
        (("-p", "excitation.kind:=multisin"), "did you mean multisine?"),
        (("-p", "hub.homing_speed:=0.9"), "at most 0.5 m/s, hub.max_speed"),
        (("--params-file", "nowhere.yaml"), "no such file"),
        (("--params-file", "broken.yaml"), "broken.yaml"),
        (("--params-file", "flat.yaml"), "expected `/**:` with `ros__parameters:` below it"),
        (("--params-file", "mixed.yaml"), "mixed.yaml"),
    ],
)
def test_a_wrong_parameter_ends_the_node_with_one_line(executables, tmp_path, words, expected) -> None:
    (tmp_path / "broken.yaml").write_text("/**: {ros__parameters: {beam: [")
    (tmp_path / "flat.yaml").write_text("beam:\n  length: 0.3\n")
    (tmp_path / "mixed.yaml").write_text("/**:\n  ros__parameters:\n    markers: {heights: [0.1, 1]}\n")
    node = executables.run("simulator", "--ros-args", *words, timeout_s=20.0)
    assert node.process.returncode == 2
    assert len(node.output().strip().splitlines()) == 1, node.output()
    assert expected in node.output()


def test_a_serial_port_without_a_name_is_one_line_and_status_2(executables) -> None:
    node = executables.run("hub_driver", timeout_s=30.0)
    assert node.process.returncode == 2
    assert len(node.output().strip().splitlines()) == 1, node.output()
    assert 'serial.port is ""' in node.output()


def test_a_serial_port_that_is_missing_is_waited_for(executables) -> None:
    node = executables.start("hub_driver", "--ros-args", "-p", "serial.port:=/dev/ttyNOWHERE0")
    assert "expected an existing port" in node.wait_for("/dev/ttyNOWHERE0 cannot be opened", 30.0)
    node.send_signal(signal.SIGINT)
    assert node.wait() == 0


def test_parameters_carry_descriptions_and_refuse_what_the_table_refuses(executables, graph) -> None:
    executables.start("excitation_generator", "--ros-args", "-p", "camera.rate:=50")
    node = NodeParameters(graph, "/excitation")
    length, duration = node.describe("beam.length", "excitation.duration")
    assert "[m]" in length.description
    assert length.read_only
    assert not duration.read_only
    assert (length.floating_point_range[0].from_value, length.floating_point_range[0].to_value) == (0.01, 5.0)
    refused = node.set("excitation.start_frequency", 500.0)
    assert not refused.successful
    assert "start below the end" in refused.reason
    assert not node.set("beam.length", 0.2).successful
    beyond = node.set("excitation.acceleration", 50.0)
    assert not beyond.successful
    assert "at most 10 m/s^2, hub.max_acceleration" in beyond.reason
    assert node.get("excitation.acceleration") == [0.7]


def test_a_whole_number_never_changes_the_type_of_a_number(executables, graph) -> None:
    words = ("-p", "beam.length:=1", "-p", "excitation.frequencies:=[2, 4]", "-p", "beam.gravity:=off")
    executables.start("excitation_generator", "--ros-args", *words)
    node = NodeParameters(graph, "/excitation")
    names = ("beam.length", "excitation.frequencies", "excitation.duration", "excitation.waypoints")
    assert node.get("beam.gravity") == ["off"]
    assert node.set("excitation.duration", 5).successful
    assert node.set("excitation.waypoints", [0, 0]).successful
    values = node.get(*names)
    assert [list(v) if hasattr(v, "__len__") else v for v in values] == [1.0, [2.0, 4.0], 5.0, [0.0, 0.0]]
    assert all(isinstance(v, float) for v in (values[0], values[2], *values[1], *values[3]))
    assert not any(descriptor.dynamic_typing for descriptor in node.describe(*names))
    wrong = node.set("excitation.duration", "long")
    assert not wrong.successful
    assert "DOUBLE" in wrong.reason


def test_a_node_declares_what_it_reads_and_refuses_all_else(executables, graph) -> None:
    executables.start("simulator", "--ros-args", "-p", "simulation.images:=false")
    node = NodeParameters(graph, "/hub")
    assert node.names() == set(NODES["simulator"].parameters)
    foreign = node.set("excitation.acceleration", 1.0)
    assert not foreign.successful
    assert "excitation.acceleration" in foreign.reason
    misspelt = node.set("hub.travle", 1.0)
    assert not misspelt.successful
    assert "did you mean hub.travel?" in misspelt.reason


def test_simulator_and_driver_share_the_parameters_of_the_hub(executables, graph, tmp_path) -> None:
    port = tmp_path / "controller"
    words = ("-p", "hub.travel:=0.08", "-p", "hub.max_speed:=1")
    linked = ("-p", f"emulator.port_link:={port}", "-p", f"serial.port:={port}", *words)
    executables.start("simulator", "--ros-args", "-r", "__ns:=/a", "-p", "simulation.images:=false", *words)
    executables.start("firmware_emulator", "--ros-args", "-r", "__ns:=/b", *linked).wait_for("controller on")
    executables.start("hub_driver", "--ros-args", "-r", "__ns:=/b", *linked)
    simulator, driver = NodeParameters(graph, "/a/hub"), NodeParameters(graph, "/b/hub")
    shared = sorted(simulator.names() & driver.names())
    of_links = ("axis.", "serial.", "trajectory.", "odrive.", "dynamixel.", "csv.")
    assert {name for name in driver.names() if not name.startswith(of_links)} == set(shared)
    assert {name for name in simulator.names() if name.startswith("hub.")} <= set(shared)
    assert simulator.get(*shared) == driver.get(*shared)
    assert simulator.describe(*shared) == driver.describe(*shared)


@pytest.mark.parametrize("name", ["nowhere.avi", "words.avi"])
def test_a_video_that_is_none_is_one_line_and_status_2(executables, tmp_path, name) -> None:
    (tmp_path / "words.avi").write_text("words")
    path = tmp_path / name
    words = ("-p", "tracker.source:=file", "-p", f"tracker.video:={path}")
    node = executables.run("vision_tracker", "--ros-args", *words, timeout_s=20.0)
    assert node.process.returncode == 2
    assert sum("vision_tracker:" in line for line in node.output().splitlines()) == 1, node.output()
    assert str(path) in node.output()
    assert "Traceback" not in node.output()


@pytest.mark.parametrize(
    ("executable", "parameter"),
    [
        ("hub_driver", "simulation.real_time_factor:=0.5"),
        ("firmware_emulator", "use_sim_time:=true"),
        ("simulator", "use_sim_time:=true"),
    ],
)
def test_a_node_that_cannot_keep_its_time_does_not_start(
    executables: Any, executable: str, parameter: str
) -> None:
    refused = executables.run("beam", "run", executable, "--ros-args", "-p", parameter)
    assert refused.process.returncode == 2
    (line,) = refused.output().strip().splitlines()
    assert f"{parameter.partition(':=')[0]} is" in line
    assert "expected" in line


@pytest.mark.parametrize("name", ["identifier", "vision_tracker", "bag_recorder", "bag_player"])
def test_a_node_is_there_before_what_it_only_needs_for_its_work(name: str) -> None:
    code = f"import beam_ros.nodes.{name}, sys; print(*sys.modules)"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert not {"scipy.signal", "scipy.optimize", "scipy.stats"} & set(ran.stdout.split())


def test_a_node_without_the_clock_that_it_follows_says_so(executables: Any, graph: Any) -> None:
    seen: list[tuple[str, str]] = []

    def note(message: Any) -> None:
        seen.extend((status.level, status.message) for status in message.status)

    graph.listen("/diagnostics", note)
    tracker = executables.start("vision_tracker", "--ros-args", "-p", "use_sim_time:=true")
    graph.wait(lambda: any(text == NO_CLOCK for _, text in seen), "a complaint in the diagnostics", 20.0)
    assert NO_CLOCK in tracker.wait_for("nobody publishes /clock")


def test_ros_reads_what_a_rig_writes_whatever_stands_in_its_texts(tmp_path) -> None:
    rig = Rig.from_file().with_values({"live.aims": "f1:0.01%, zeta1:2%", "serial.port": "socket://a:1"})
    rig.write(tmp_path / "rig.yaml")
    context = rclpy.context.Context()
    rclpy.init(args=["--ros-args", "--params-file", str(tmp_path / "rig.yaml")], context=context)
    context.shutdown()
