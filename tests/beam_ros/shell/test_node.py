"""A node's executor takes from rclpy what it finds there, and is rclpy's own where that is missing."""

from __future__ import annotations

import sys

import pytest

PLAIN = """
import sys
import rclpy.executors
hidden = sys.argv.pop(1).split(",")
class Executor(rclpy.executors.SingleThreadedExecutor):
    def __getattribute__(self, name):
        if name in hidden and sys._getframe(1).f_globals["__name__"].startswith("beam_ros"):
            raise AttributeError(name)
        return super().__getattribute__(name)
rclpy.executors.SingleThreadedExecutor = Executor
from beam_ros.process.executables import run_executable
sys.exit(run_executable("simulator", sys.argv[1:]))
"""
"""A node whose rclpy keeps some names out of the suite's sight."""


@pytest.mark.slow
@pytest.mark.ros
@pytest.mark.parametrize("hidden", ["_guard", "_take_service", "_guard,_take_service"])
def test_a_node_answers_also_with_the_plain_executor(executables, graph, hidden: str) -> None:
    program = (sys.executable, "-c", PLAIN, hidden)
    arguments = ("--ros-args", "-p", "simulation.images:=false")
    hub = executables.start("simulator", *arguments, program=program)
    positions = []
    graph.listen("hub/state", lambda message: positions.append(message.position[0]))
    graph.wait(lambda: bool(positions), "a hub that speaks", 30.0)
    graph.switch_on()
    executables.interrupt()
    assert hub.wait(30.0) == 0, hub.output()
    assert "Traceback" not in hub.output()


@pytest.mark.ros
def test_the_executor_takes_the_time_of_a_request_where_rclpy_hands_it_over(graph) -> None:
    """With the names in sight nothing of rclpy is left as it was."""
    from rclpy.executors import SingleThreadedExecutor

    from beam_ros.shell.node import make_executor

    executor = make_executor()
    try:
        assert isinstance(executor, SingleThreadedExecutor)
        assert vars(executor).keys() >= {"_guard", "_take_service"}
        assert "trigger" in vars(executor._guard)
    finally:
        executor.shutdown(timeout_sec=0.0)
