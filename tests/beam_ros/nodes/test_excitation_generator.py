"""The node `excitation` offers every recipe by its parameters."""

from __future__ import annotations

import signal
import threading

import pytest

from beam_ros import messages
from beam_ros.interfaces.graph import SERVICES

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


def test_a_trajectory_of_ones_own_comes_from_its_file(executables, graph, tmp_path) -> None:
    path = tmp_path / "path.csv"
    path.write_text("t_ms,x_mm\n0,0\n500,2\n1000,0\n")
    infos: list[dict[str, object]] = []
    graph.listen("excitation/info", lambda message: infos.append(messages.read_json(message)))
    file = ("-p", f"excitation.file:={path}")
    executables.start("excitation_generator", "--ros-args", "-p", "excitation.kind:=file", *file)
    graph.wait(lambda: bool(infos), "the recipe", 20.0)
    recipe = infos[0]["recipe"]
    assert (recipe["quantity"], recipe["times"], recipe["values"]) == (
        "position",
        [0.0, 0.5, 1.0],
        [0.0, 2e-3, 0.0],
    )


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


QUICK = (
    *("-p", "excitation.acceleration:=0.2"),
    *("-p", "excitation.duration:=30.0"),
    *("-p", "excitation.start_delay:=5.0"),  # for a busy computer
)


def test_a_hub_that_is_killed_under_a_sequence_is_missed_and_another_one_takes_the_next(
    executables, graph
) -> None:
    states: list[dict[str, object]] = []
    sentences: list[str] = []
    spoken: list[bytes] = []
    graph.listen("hub/sequence_state", lambda message: states.append(messages.read_json(message)))
    graph.listen("hub/state", spoken.append, raw=True)
    graph.listen(
        "/diagnostics",
        lambda m: sentences.extend(s.message for s in messages.read_diagnostics(m) if "excitation" in s.name),
    )
    executables.start("excitation_generator", "--ros-args", *QUICK, timeout_s=120.0)

    def start() -> None:
        spoken.clear()
        graph.wait(lambda: bool(spoken), "a hub that speaks", 20.0)
        graph.switch_on()
        # The generator may discover the new hub some seconds after this process did.
        for _ in range(20):
            answer = graph.call("excitation/start")
            if answer.success or "silent" not in answer.message:
                break
            graph.spin(1.0)
        assert answer.success, answer.message
        graph.wait(lambda: states[-1]["state"] == "running", "a sequence that runs", 15.0)

    hub = executables.start("simulator", "--ros-args", "-p", "simulation.images:=false")
    start()
    hub.send_signal(signal.SIGKILL)
    hub.wait()
    sentences.clear()
    graph.wait(lambda: any(": lost: " in s for s in sentences), "the loss in the diagnostics")
    refusal = graph.call("excitation/start")
    assert not refusal.success
    assert "hub has been silent" in refusal.message or "nobody listens" in refusal.message
    executables.start("simulator", "--ros-args", "-p", "simulation.images:=false")
    start()


@pytest.mark.parametrize("minutes", [5, pytest.param(30, marks=pytest.mark.verify)])
def test_a_long_sequence_is_handed_over_and_starts(executables, graph, minutes: int) -> None:
    """Of 1 kHz, while set-points and services go on being answered."""
    states: list[dict[str, object]] = []
    spoken: list[bytes] = []
    graph.listen("hub/sequence_state", lambda message: states.append(messages.read_json(message)))
    graph.listen("hub/state", spoken.append, raw=True)
    long = ("-p", f"excitation.duration:={60.0 * minutes}", "-p", "excitation.acceleration:=0.05")
    executables.start("excitation_generator", "--ros-args", *long, timeout_s=150.0)
    executables.start("simulator", "--ros-args", "-p", "simulation.images:=false", timeout_s=150.0)
    graph.wait(lambda: bool(spoken), "a hub that speaks", 20.0)
    graph.switch_on()
    future = graph.request("excitation/start")
    graph.wait(lambda: bool(states) and states[-1]["state"] != "loading", "a verdict", 60.0)
    assert states[-1]["state"] == "ready", states[-1]
    assert states[-1]["points"] > 60_000 * minutes
    graph.wait(future.done, "an answer")
    assert future.result().success, future.result().message
    graph.wait(lambda: states[-1]["state"] == "running", "a sequence that runs", 40.0)
    assert graph.call("excitation/stop").success
    graph.wait(lambda: states[-1]["state"] == "aborted", "the end")


def test_a_stop_that_the_hub_does_not_answer_is_told_of(executables, graph) -> None:
    import rclpy
    from rclpy.task import Future

    async def silent(_request: object, _response: object) -> object:
        return await Future()

    hub = rclpy.create_node("silent_hub", context=graph.node.context)
    hub.create_service(graph.types.service_class(SERVICES["hub/stop"].type_name), "hub/stop", silent)
    executor = rclpy.executors.SingleThreadedExecutor(context=graph.node.context)
    executor.add_node(hub)
    thread = threading.Thread(target=executor.spin, daemon=True)
    thread.start()
    try:
        executables.start("excitation_generator", "--ros-args")
        answers = []
        # The generator may be asked before it has seen the hub.
        while not answers or "is not there" in answers[-1].message:
            asked = graph.request("excitation/stop")
            graph.wait(asked.done, "an answer", 30.0)
            answers.append(asked.result())
        assert not answers[-1].success
        assert "hub/stop has not answered in 5 s" in answers[-1].message
    finally:
        executor.shutdown()
        thread.join(5.0)
        hub.destroy_node()


def test_what_is_longer_than_an_hour_is_refused_before_it_is_sampled(executables) -> None:
    node = executables.run(
        "excitation_generator",
        "--ros-args",
        *("-p", "excitation.duration:=3600.0"),
        *("-p", "excitation.still:=3600.0"),
        timeout_s=20.0,
    )
    assert node.process.returncode == 2
    assert len(node.output().strip().splitlines()) == 1, node.output()
    assert "at most 3600000 ticks" in node.output()
