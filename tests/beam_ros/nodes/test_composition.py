"""Several nodes fit into one process: each takes a context, a namespace and parameters of its own, as rclpy's do."""

from __future__ import annotations

import inspect
import time
from collections.abc import Iterator
from importlib import import_module

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("cv2")

from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter

from beam_ros.interfaces.graph import NODES, TOPICS
from beam_ros.nodes.simulator import Simulator
from beam_ros.nodes.vision_tracker import VisionTracker
from beam_ros.process.executables import MODULES
from beam_ros.shell.node import RigNode, qos_profile

pytestmark = [pytest.mark.ros, pytest.mark.slow]

GUARD_S = 60.0


@pytest.fixture
def context() -> Iterator[Context]:
    own = Context()
    own.init(args=[])
    yield own
    own.try_shutdown()


def small(name: str, value: object) -> Parameter:
    return Parameter(name, value=value)


def test_tracker_and_simulator_work_in_one_process_with_one_executor(context: Context) -> None:
    camera = [small("camera.rate", 20.0)]
    simulator = Simulator(
        context=context, namespace="/bench", parameter_overrides=[*camera, small("simulation.seed", 7)]
    )
    tracker = VisionTracker(context=context, namespace="/bench", parameter_overrides=camera)
    listener = Node("listener", context=context, namespace="/bench")
    seen: dict[str, float] = {}
    row = TOPICS["beam/displacement"]
    listener.create_subscription(
        tracker.types.message_class(row.type_name),
        "beam/displacement",
        lambda message: seen.update(zip(message.name, message.position, strict=True)),
        qos_profile(row.qos),
    )
    executor = SingleThreadedExecutor(context=context)
    nodes = (simulator, tracker, listener)
    try:
        assert simulator.get_fully_qualified_name() == "/bench/hub"
        assert simulator.rig.simulation.seed == 7
        for node in nodes:
            executor.add_node(node)
        end = time.monotonic() + GUARD_S
        while not seen and time.monotonic() < end:
            executor.spin_once(timeout_sec=0.1)
        assert set(seen) == set(tracker.rig.markers.names)
    finally:
        executor.shutdown(timeout_sec=1.0)
        for node in nodes:
            if isinstance(node, RigNode):
                node.close()
            node.destroy_node()


def test_services_answer_under_an_executor_that_does_not_say_when_they_were_asked(context: Context) -> None:
    hub = Simulator(context=context, parameter_overrides=[small("simulation.images", False)])
    person = Node("person", context=context)
    service_class = hub.types.service_class("std_srvs/srv/Trigger")
    client = person.create_client(service_class, "hub/home")
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(hub)
    executor.add_node(person)
    try:
        end = time.monotonic() + GUARD_S
        while not client.service_is_ready() and time.monotonic() < end:
            executor.spin_once(timeout_sec=0.1)
        future = client.call_async(service_class.Request())
        executor.spin_until_future_complete(future, timeout_sec=GUARD_S)
        assert future.result().success, future.result().message
    finally:
        executor.shutdown(timeout_sec=1.0)
        hub.close()
        hub.destroy_node()
        person.destroy_node()


@pytest.mark.parametrize("executable", NODES)
def test_every_node_class_takes_the_keyword_arguments_of_rclpy(executable: str) -> None:
    module = import_module(MODULES[executable])
    classes = [
        value
        for value in vars(module).values()
        if inspect.isclass(value) and issubclass(value, RigNode) and value.__module__ == module.__name__
    ]
    assert classes
    for node_class in classes:
        parameters = inspect.signature(node_class).parameters.values()
        assert [parameter.kind for parameter in parameters] == [inspect.Parameter.VAR_KEYWORD]
