"""The node `excitation` offers every recipe by its parameters."""

from __future__ import annotations

import pytest

from beam_ros import messages

pytestmark = pytest.mark.ros
pytest.importorskip("rclpy")


def test_a_stepped_sine_comes_from_parameters_alone(executables, graph) -> None:
    infos: list[dict[str, object]] = []
    graph.listen("excitation/info", lambda message: infos.append(messages.read_json(message)))
    executables.start(
        "excitation_generator",
        "--ros-args",
        *("-p", "excitation.kind:=stepped_sine"),
        *("-p", "excitation.frequencies:=[3.0, 6.0]"),
        *("-p", "excitation.measure_cycles:=7"),
    )
    graph.wait(lambda: bool(infos), "the recipe", 20.0)
    recipe = infos[0]["recipe"]
    assert recipe["kind"] == "stepped_sine"
    assert recipe["frequencies"] == [3.0, 6.0]
    assert recipe["measure_cycles"] == 7


def test_a_recipe_that_makes_no_signal_is_one_line(executables) -> None:
    node = executables.run(
        "excitation_generator",
        "--ros-args",
        *("-p", "excitation.kind:=prbs"),
        *("-p", "excitation.clock_period:=0.0015"),
        timeout_s=20.0,
    )
    assert node.process.returncode == 2
    assert len(node.output().strip().splitlines()) == 1, node.output()
    assert "a whole number of periods" in node.output()
