"""The driver as a real process, and what becomes of the axis when something dies: watched where the hub truly is.

The emulated controller lives in the test's own process, on a real pseudo-terminal, so that its hub can be seen at
exact instants, however busy the computer is.
"""

from __future__ import annotations

import dataclasses
import os
import random
import signal
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import Reader

from beam_ros import messages
from beam_ros.bags.batches import decode_batch
from beam_ros.excitation.plan import plan_excitation
from beam_ros.hub.emulated.controller import EmulatedController
from beam_ros.hub.emulated.injected_faults import read_schedule
from beam_ros.hub.simulated.plant import RigidPlant
from beam_ros.rig.rig import Rig
from benchmarks.axis_safety import LIES

pytestmark = [pytest.mark.ros, pytest.mark.verify]
pytest.importorskip("rclpy")

RIG = Rig.from_file().with_values({"hub.command_mode": "velocity"})
AXIS = RIG.axis_parameters()
SPEED = 0.01
REST_S = AXIS.watchdog_s + SPEED / AXIS.stop_deceleration
LATE_S = 0.1
"""For the emulated controller's own thread, which may have to wait for a processor before it hears anything."""
GRID_NS = 1_000_000

FREEZING = """
import signal, sys, time
signal.signal(signal.SIGUSR1, lambda *_: time.sleep(2.0))
from beam_ros.process.executables import run_executable
del sys.argv[0]
sys.exit(run_executable(sys.argv[0]))
"""
"""A driver whose executor is held up by SIGUSR1 for 2 s, while its other threads go on."""


class Scene:
    """A controller whose hub can be seen, its driver, and somebody who publishes set-points."""

    def __init__(self, executables, graph, folder: Path, watchdog_s: float = AXIS.watchdog_s) -> None:
        self.controller = EmulatedController(
            AXIS.widened(10.0), RigidPlant(0.8, AXIS.period), link=folder / "controller"
        )
        self.graph = graph
        self.modes: list[dict[str, object]] = []
        self.is_publishing = self.is_swinging = False
        graph.listen("hub/mode", lambda message: self.modes.append(messages.read_json(message)))
        self._publisher = graph.publisher("hub/setpoint")
        graph.node.create_timer(0.03, self._publish)
        self.driver = executables.start(
            "hub_driver",
            *("--ros-args", "-p", f"serial.port:={self.controller.port}"),
            *("-p", "hub.command_mode:=velocity", "-p", f"hub.watchdog:={watchdog_s}"),
            program=[sys.executable, "-c", FREEZING, "hub_driver"],
        )

    def _publish(self) -> None:
        if self.is_publishing:
            # Back and forth, the hub never comes to the end of its travel.
            speed = -SPEED if self.is_swinging and time.monotonic() % 2.0 < 1.0 else SPEED
            point = messages.StampedSetpoint(time.time_ns(), "velocity", speed)
            self._publisher.publish(messages.setpoint(self.graph.types, point))

    @property
    def state(self) -> object:
        return self.modes[-1]["state"] if self.modes else None

    def move(self) -> None:
        """Home, enable, and lead the hub away from home."""
        self.graph.wait(lambda: self.state == "identified", "a connection", 30.0)
        self.graph.switch_on()
        self.is_publishing = True
        self.graph.wait(lambda: abs(self.controller.axis.velocity - SPEED) < 1e-4, "movement")
        self.graph.spin(0.3)
        assert self.state == "enabled"

    def path(self, begin_ns: int, end_ns: int) -> np.ndarray:
        """True positions [m] every millisecond between two stamps [ns], both reached."""
        self.graph.wait(lambda: self.controller.reached_ns > end_ns, "the end of the path")
        return self.controller.snapshots(range(begin_ns, end_ns, GRID_NS)).positions

    def rest_s(self, begin_ns: int, seconds: float = 2.0) -> float:
        """Return how long after a stamp [ns] the hub still moved [s]; it must rest within `seconds`."""
        moving = np.flatnonzero(np.diff(self.path(begin_ns, begin_ns + round(seconds * 1e9))))
        return (moving[-1] + 1) * GRID_NS * 1e-9 if len(moving) else 0.0

    def stays_at_rest(self, seconds: float = 1.0) -> None:
        """Watch the hub for a while: it must not move."""
        begin_ns = time.time_ns()
        self.graph.spin(seconds)
        path = self.path(begin_ns, begin_ns + round(seconds * 0.9e9))
        assert np.all(path == path[0])


@pytest.fixture
def scene(executables, graph, tmp_path: Path):
    scene = Scene(executables, graph, tmp_path)
    yield scene
    scene.controller.close()


@pytest.fixture
def patient_scene(executables, graph, tmp_path: Path):
    """The same with a watchdog that lets a busy computer wait: not for figures."""
    scene = Scene(executables, graph, tmp_path, watchdog_s=2.0)
    yield scene
    scene.controller.close()


def _die(scene: Scene) -> None:
    scene.driver.send_signal(signal.SIGKILL)


def _freeze_executor(scene: Scene) -> None:
    scene.driver.send_signal(signal.SIGUSR1)


def _publish_no_more(scene: Scene) -> None:
    scene.is_publishing = False


def _fault(text: str):
    def bring_about(scene: Scene) -> None:
        scene.controller.bring_about(read_schedule(text, "test", scene.controller.elapsed))

    return bring_about


ACCIDENTS = {
    "kill -9": _die,
    "frozen executor": _freeze_executor,
    "dead publisher": _publish_no_more,
    "unplug": _fault("{fault: unplug, for: 1.2}"),
    "stall": _fault("{fault: stall, for: 1.2}"),
    "drop": _fault("{fault: drop, share: 1.0, for: 1.2}"),
}


@pytest.mark.parametrize("name", ACCIDENTS)
def test_after_an_accident_the_hub_rests_within_watchdog_and_ramp_and_stays_there(scene: Scene, name) -> None:
    scene.move()
    begin_ns = time.time_ns()
    ACCIDENTS[name](scene)
    scene.graph.spin(2.2)
    rest_s = scene.rest_s(begin_ns)
    print(f"{name}: at rest after {rest_s:.3f} s of {REST_S:.3f} s")  # noqa: T201 - the figures, with `pytest -s`
    assert rest_s < REST_S + LATE_S
    assert scene.controller.axis.state != "enabled"
    if name == "kill -9":
        return
    # Set-points go on, and the driver comes back: nothing moves before somebody enables the axis again.
    scene.is_publishing = True
    scene.graph.wait(lambda: scene.state in ("homed", "identified", "fault"), "the driver back")
    scene.stays_at_rest()
    if scene.state == "fault":
        scene.graph.ask("hub/clear_fault")
    scene.graph.switch_on()


@pytest.mark.parametrize("seed", range(20))
def test_a_device_that_lies_is_found_out_by_name_and_left_by_the_way_that_is_said(
    patient_scene: Scene, seed: int
) -> None:
    """Those of the benchmark in virtual time, which holds how soon; here nothing but a hang ends a wait."""
    rng, lie, scene = random.Random(seed), LIES[seed % len(LIES)], patient_scene
    scene.move()
    scene.is_swinging = True
    scene.graph.spin(rng.uniform(0.5, 1.5))  # at another place, and after another time
    if lie.kind == "lying_encoder":
        # A slow drift shows on a hub that is held.
        scene.is_publishing = False
        scene.graph.wait(lambda: scene.state == "homed", "the end of the set-points")
        scene.graph.ask("hub/enable", data=True)
    injected = lie.drawn(rng, scene.controller.elapsed)
    if lie.kind == "missed_ticks":
        # A slower loss hides for a minute behind the round trips of a busy computer.
        injected = dataclasses.replace(injected, amounts={"one_in": rng.uniform(50.0, 200.0)})
    scene.controller.bring_about([injected])
    if lie.kind == "ignored_stop":
        scene.graph.spin(0.2)
        answer = scene.graph.call("hub/stop")
        assert not answer.success, answer.message
    scene.graph.wait(lambda: scene.modes[-1]["fault"] is not None, "a fault", 60.0)
    scene.is_publishing = False
    assert scene.modes[-1]["fault"]["name"] in lie.names
    assert scene.modes[-1]["fault"]["remedy"]
    scene.graph.wait(lambda: scene.controller.axis.velocity == 0.0, "the hub at rest")
    scene.stays_at_rest()
    n_seen = len(scene.modes)
    scene.controller.restart()  # a new firmware, which does not lie; for a broken clock it is the remedy
    scene.graph.wait(
        lambda: any(mode["state"] == "disconnected" for mode in scene.modes[n_seen:]), "a restart", 20.0
    )
    for _ in range(30):
        # The driver comes back, proves the watchdog, and sees that the cause is gone.
        if scene.graph.call("hub/clear_fault").success:
            break
        scene.graph.spin(1.0)
    scene.graph.wait(lambda: scene.state == "identified", "the driver back", 20.0)
    scene.graph.switch_on()


def test_a_reset_of_the_controller_leaves_the_hub_where_it_is(scene: Scene) -> None:
    scene.move()
    _fault("{fault: reset}")(scene)
    scene.graph.wait(lambda: bool(scene.controller.take_notes()), "the reset")
    scene.graph.spin(0.1)
    scene.stays_at_rest(2.0)
    scene.graph.wait(lambda: scene.state == "identified", "the driver back")
    scene.stays_at_rest()


def test_a_process_stopped_for_3_s_leaves_the_hub_at_rest_and_nothing_asked_meanwhile_is_done(
    scene: Scene,
) -> None:
    scene.move()
    begin_ns = time.time_ns()
    scene.driver.send_signal(signal.SIGSTOP)
    try:
        scene.graph.spin(0.5)
        asked = {
            "enable": scene.graph.request("hub/enable", data=True),
            "home": scene.graph.request("hub/home"),
        }
        scene.graph.spin(1.5)
        rest_s = scene.rest_s(begin_ns)
        scene.graph.spin(3.0 - (time.time_ns() - begin_ns) * 1e-9)
    finally:
        scene.driver.send_signal(signal.SIGCONT)
    print(f"SIGSTOP: at rest after {rest_s:.3f} s of {REST_S:.3f} s")  # noqa: T201
    assert rest_s < REST_S + LATE_S
    # Set-points still go on.
    scene.stays_at_rest(2.0)
    assert scene.controller.axis.state in ("homed", "identified")
    for name, future in asked.items():
        scene.graph.wait(future.done, f"an answer of {name}")
        assert not future.result().success, name
        assert "was frozen for 3." in future.result().message
    scene.graph.wait(lambda: scene.state in ("homed", "identified"), "the hub's own word")
    scene.graph.ask("hub/enable", data=True)


def test_60_s_at_1_khz_are_applied_sample_for_sample_with_every_core_loaded(
    executables, graph, tmp_path: Path
) -> None:
    # A minute of the default amplitude would bend the beam too far.
    signal_words = ("excitation.duration:=60.0", "excitation.still:=1.0", "excitation.acceleration:=0.5")
    given = [word for text in signal_words for word in ("-p", text)]
    port = tmp_path / "controller"
    executables.start(
        "firmware_emulator", "--ros-args", "-p", f"emulator.port_link:={port}", timeout_s=200.0
    ).wait_for("motion controller on", 20.0)
    executables.start("hub_driver", "--ros-args", "-p", f"serial.port:={port}", timeout_s=200.0)
    executables.start("excitation_generator", "--ros-args", *given, timeout_s=200.0)
    recorder = executables.start(
        "bag_recorder", "--ros-args", "-p", f"recorder.path:={tmp_path / 'bag'}", timeout_s=200.0
    )
    states: list[dict[str, object]] = []
    graph.listen("hub/sequence_state", lambda message: states.append(messages.read_json(message)))
    modes: list[dict[str, object]] = []
    graph.listen("hub/mode", lambda message: modes.append(messages.read_json(message)))
    graph.wait(lambda: bool(modes) and modes[-1]["state"] == "identified", "a connection", 30.0)
    graph.switch_on()
    graph.spin(3.0)
    for _ in os.sched_getaffinity(0):
        executables.start("burner", program=[sys.executable, "-c", "while True: pass"], timeout_s=200.0)
    answer = graph.call("excitation/start")
    assert answer.success, answer.message
    graph.wait(
        lambda: bool(states) and states[-1]["state"] in ("done", "aborted", "underrun", "refused"),
        "the end of the sequence",
        100.0,
    )
    assert states[-1]["state"] == "done", states[-1]
    graph.spin(1.0)
    recorder.send_signal(signal.SIGINT)
    recorder.wait(60.0)
    with Reader(tmp_path / "bag") as reader:
        batches = [
            decode_batch(data)
            for connection, _, data in reader.messages()
            if connection.topic == "/hub/applied"
        ]
    design = plan_excitation(Rig.from_file().with_texts(signal_words)).values
    stamps = np.array([batch.stamp_ns for batch in batches])
    gaps = np.diff(stamps) - np.array([len(batch) * batch.period_ns for batch in batches[:-1]])
    applied = np.concatenate([batch.accelerations for batch in batches])
    first = np.flatnonzero(applied)[0] - np.flatnonzero(design)[0]
    assert np.array_equal(applied[first : first + len(design)], design)
    running = slice(first // len(batches[0]), (first + len(design)) // len(batches[0]))
    assert np.max(np.abs(gaps[running])) < batches[0].period_ns / 2, "batches were lost on the way to the bag"
