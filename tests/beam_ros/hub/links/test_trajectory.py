"""Whole motions for a JointTrajectoryController: their knots, and the emulated controller that takes them."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ros.hub.contract import HostTime
from beam_ros.hub.emulated.servo import ServoAxis
from beam_ros.hub.emulated.trajectory_controller import (
    EmulatedTrajectoryController,
    Waypoints,
    interpolate,
)
from beam_ros.hub.link_parameters import TrajectoryParameters
from beam_ros.hub.links.motion_plan import MotionPlan
from beam_ros.hub.links.trajectory import SILENCE_NS, Knots, TrajectoryHub, settings_objection
from beam_ros.hub.parameters import AxisParameters, SimulatedDevice
from beam_ros.hub.simulated.plant import RigidPlant
from tests.beam_ros.hub.hub_scenes import (
    STEADY_START,
    UNIX_START,
    PacedRig,
    VirtualTime,
    chunks_of,
    rest_to_rest,
)

ACCELERATION = AxisParameters()


def _joined(knots: Knots, times_ns: np.ndarray) -> np.ndarray:
    """Positions between knots, as the controller's documents say that it joins them."""
    out = []
    for time_ns in times_ns:
        k = min(int(np.searchsorted(knots.times_ns, time_ns, side="right")) - 1, len(knots.times_ns) - 2)
        ends = [
            (knots.positions[j],) if knots.velocities is None else (knots.positions[j], knots.velocities[j])
            for j in (k, k + 1)
        ]
        tau, span = time_ns - knots.times_ns[k], knots.times_ns[k + 1] - knots.times_ns[k]
        out.append(interpolate(tau * 1e-9, span * 1e-9, *ends)[0])
    return np.array(out)


@pytest.mark.parametrize("mode", ["acceleration", "velocity", "position"])
def test_the_controllers_interpolation_gives_the_design_back_exactly(mode: str) -> None:
    # Two equal commands in a row are one knot; the positions, which rise every other tick, have none in a row.
    accelerations = rest_to_rest(300)
    velocities = np.repeat(np.cumsum(accelerations) * 2e-3, 2)
    values = {
        "acceleration": np.repeat(accelerations, 2),
        "velocity": velocities,
        "position": np.concatenate(([0.0], np.arange(1, 601) // 2 * 2.0**-12)),
    }[mode]
    plan = MotionPlan.sequence(values, AxisParameters(command_mode=mode), 0.0)
    knots = Knots.of(plan, 0, 0.0, 1.0)
    # One for the start, one for the rest after the end.
    assert len(knots.times_ns) == (602 if mode == "position" else 302)
    assert (knots.velocities is None) == (mode != "acceleration")
    times_ns = np.arange(0, 600_000_000, 137_731)
    residual = np.max(np.abs(_joined(knots, times_ns) - plan.sample(times_ns * 1e-9)[0]))
    # Rounding of metres in doubles.
    assert residual < 1e-16 * 50


def test_a_quintic_through_the_samples_would_not_be_exact() -> None:
    """Accelerations at the knots cannot say that they jump there: why the knots carry none."""
    plan = MotionPlan.sequence(np.repeat([0.5, -0.5], 100), ACCELERATION, 0.0)
    start, end = (0.0, 0.0, 0.5), (plan.positions[1], plan.velocities[1], -0.5)
    assert abs(interpolate(0.05, 0.1, start, end)[0] - plan.at(0.05)[0]) > 1e-5


def test_knots_are_on_the_joints_own_scale_and_end_with_a_rest() -> None:
    plan = MotionPlan.ramps(0.01, 0.02, [(0.1, -0.2)])
    knots = Knots.of(plan, 7, 0.005, -0.5)
    np.testing.assert_allclose(knots.positions, [-0.03, -0.032, -0.032])
    np.testing.assert_allclose(knots.velocities, [-0.04, 0.0, 0.0])
    assert knots.times_ns.tolist() == [0, 100_000_000, 1_100_000_000]


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({}, ""),
        ({"joints": ["slider"], "allow_partial_joints_goal": False, "interpolation_method": "splines"}, ""),
        ({"joints": ["slider", "arm"], "allow_partial_joints_goal": True}, ""),
        (
            {"joints": ["slider", "arm"], "allow_partial_joints_goal": False},
            "allow_partial_joints_goal: true",
        ),
        ({"joints": ["arm"]}, "expected 'slider' among them; correct trajectory.joint"),
        ({"interpolation_method": "none"}, "jumps from knot to knot: expected splines"),
        ({"positions_upsampling.enable": True}, "bends straight lines into splines: expected false"),
    ],
)
def test_a_controller_that_would_not_follow_the_knots_is_refused_by_its_settings(settings, words) -> None:
    objection = settings_objection(settings, "slider", has_velocities=False)
    assert words in objection
    assert bool(objection) == bool(words)


def test_upsampling_of_positions_leaves_knots_with_velocities_alone() -> None:
    assert not settings_objection({"positions_upsampling.enable": True}, "slider", has_velocities=True)


@pytest.mark.parametrize(
    ("drive_watchdog_s", "words"),
    [
        (0.0, "silence stops nothing: the drive is not stated to stop"),
        (0.1, "that the drive stops 0.1 s after its master falls silent is stated, not proved"),
    ],
)
def test_what_the_drive_does_in_silence_is_a_statement_and_no_watchdog(drive_watchdog_s, words) -> None:
    hub = TrajectoryHub(ACCELERATION, TrajectoryParameters(drive_watchdog_s=drive_watchdog_s), lambda _: None)
    hub.close()
    assert hub.capabilities.shortcomings[-1].startswith(words)
    # This program's own silence still stops no sequence, whatever the drive does in its master's.
    assert not hub.capabilities.has_watchdog
    assert "runs to its end when this host dies" in hub.capabilities.shortcomings[0]


class ControllerRig(PacedRig):
    """A hub and the emulated controller, at 250 cycles a second."""

    CYCLE_NS = 4_000_000

    def __init__(
        self, parameters: AxisParameters = ACCELERATION, start: float = 0.0, **settings: object
    ) -> None:
        steady = VirtualTime()
        self.controller = EmulatedTrajectoryController(
            ServoAxis(parameters, RigidPlant(0.8, 1e-3), SimulatedDevice(clock_start_ns=UNIX_START)),
            metres_per_unit=0.02,
        )
        self.sent: list[Knots] = []
        self.stamps_ns: list[int] = []
        self.delay_ns = 0
        self.is_running = True
        self._cycled_ns = steady.ns
        moves = TrajectoryParameters(metres_per_unit=0.02, **settings)
        super().__init__(TrajectoryHub(parameters, moves, self._send, steady=steady), steady)
        self.connected()

    def _send(self, knots: Knots) -> None:
        self.sent.append(knots)
        way = Waypoints(knots.start_ns, knots.times_ns, knots.positions, knots.velocities)
        self.controller.receive(way, self.now.unix_ns)
        assert self.controller.rejected == []

    def turn(self) -> None:
        super().turn()
        while self._cycled_ns <= self.steady.ns - self.CYCLE_NS:
            self._cycled_ns += self.CYCLE_NS
            now = HostTime(self._cycled_ns, self._cycled_ns - STEADY_START + UNIX_START)
            position, velocity = self.controller.update(now.unix_ns)
            if self.is_running:
                self.stamps_ns.append(now.unix_ns - self.delay_ns)
                self.hub.joint_state(self.stamps_ns[-1], position, velocity, None, now)


def _run(rig: ControllerRig, values: np.ndarray) -> tuple[list, int]:
    start_ns = rig.now.unix_ns + 400_000_000
    for chunk in chunks_of(values, start_ns):
        rig.hub.load(chunk, rig.now)
    ends = ("done", "refused", "aborted", "underrun")
    reports = rig.until(lambda r: any(s.state in ends for s in r.sequences))
    return reports + rig.run(0.1), start_ns


def test_a_sequence_goes_over_in_one_message_and_is_reported_sample_for_sample() -> None:
    rig = ControllerRig()
    rig.enable()
    before = len(rig.sent)
    values = rest_to_rest(1000)
    reports, start_ns = _run(rig, values)
    assert [s.state for r in reports for s in r.sequences][-2:] == ["running", "done"]
    assert len(rig.sent) == before + 1
    assert rig.sent[-1].start_ns == start_ns
    applied = [b for r in reports for b in r.applied]
    stamps = np.concatenate([b.stamp_ns + b.period_ns * np.arange(len(b)) for b in applied])
    first = int(np.searchsorted(stamps, start_ns))
    assert stamps[first] == start_ns
    samples = np.concatenate([b.accelerations for b in applied])[first : first + 1000]
    np.testing.assert_array_equal(samples, values)
    # The hub went there, a cycle and the lag of a drive of some 50 Hz behind, at 50 mm/s and less.
    measured = [b for r in reports for b in r.measured]
    times = np.array([b.stamp_ns for b in measured])
    path = np.array([b.positions[0] for b in measured])
    plan = MotionPlan.sequence(values, ACCELERATION, 0.0)
    assert np.max(np.abs(path)) > 0.002
    assert np.max(np.abs(path - plan.sample((times - start_ns) * 1e-9)[0])) < (4e-3 + 4e-3) * 0.05


def test_every_joint_state_is_measured_with_its_own_stamp() -> None:
    rig = ControllerRig()
    stamps = [b.stamp_ns for r in rig.run(0.5) for b in r.measured]
    assert all(b.period_ns == 0 and len(b) == 1 for r in rig.reports for b in r.measured)
    first = rig.stamps_ns.index(stamps[0])
    assert len(stamps) > 5
    assert stamps == rig.stamps_ns[first : first + len(stamps)]


def test_a_set_point_of_a_host_that_dies_ends_in_a_ramp_by_itself() -> None:
    rig = ControllerRig()
    rig.enable()
    assert rig.hub.setpoint(rig.now.unix_ns, 0.2, rig.now).success
    rig.run(0.05)
    knots = rig.sent[-1]
    assert knots.velocities[-1] == 0.0
    # 0.25 s at 0.2 m/s^2, then 0.05 m/s at 10 m/s^2.
    assert knots.times_ns[-2] == pytest.approx(255_000_000, abs=1000)
    reports = rig.until(lambda r: r.status.state == "homed")
    assert reports[-1].status.fault.name == "setpoint_old"


def test_an_executor_that_stands_still_stops_the_axis() -> None:
    rig = ControllerRig(AxisParameters(command_mode="position"))
    rig.enable()
    assert rig.hub.setpoint(rig.now.unix_ns, 0.04, rig.now).success
    rig.run(0.1)
    rig.is_polled = False
    rig.run(0.6)
    rig.is_polled = True
    report = rig.run(0.05)[-1]
    assert (report.status.state, report.status.fault.name) == ("homed", "host_silent")
    stopped = report.status.position
    assert rig.run(0.2)[-1].status.position == pytest.approx(stopped, abs=2e-4)
    assert stopped < 0.03


def test_stop_brakes_a_running_sequence_at_the_limit() -> None:
    rig = ControllerRig()
    rig.enable()
    for chunk in chunks_of(rest_to_rest(2000), rig.now.unix_ns + 200_000_000):
        rig.hub.load(chunk, rig.now)
    rig.until(lambda r: r.status.activity == "sequence")
    rig.run(0.4)
    assert rig.ask("stop").message == "stopped"
    brake = rig.sent[-1]
    speed, duration_ns = abs(brake.velocities[0]) * 0.02, int(brake.times_ns[-2])
    assert duration_ns * 1e-9 == pytest.approx(speed / 10.0, rel=1e-3)
    assert [s.state for r in rig.reports for s in r.sequences][-1] == "aborted"
    rest = rig.run(0.3)[-1].status.position
    assert rig.run(0.3)[-1].status.position == pytest.approx(rest, abs=1e-6)


def test_a_hub_that_somebody_pushes_is_a_fault_and_one_beyond_its_travel_too() -> None:
    rig = ControllerRig(AxisParameters(travel=0.003))
    rig.enable()
    # Another program moves the joint: 6 mm away, and the travel ends at 1.5 mm.
    rig.controller.receive(
        Waypoints(0, np.array([300_000_000]), np.array([0.3]), np.array([0.0])), rig.now.unix_ns
    )
    status = rig.until(lambda r: r.status.state == "fault")[-1].status
    assert status.fault.name == "motion_unexplained"
    assert "from where it was led" in status.reason
    assert not rig.ask("enable").success
    rig.run(0.8)
    assert rig.ask("clear_fault").success
    assert "expected within +-0.0015 m" in rig.ask("enable").message
    assert rig.ask("home").success
    assert rig.ask("enable").success


def test_joint_states_that_stop_are_a_lost_controller_and_it_comes_back() -> None:
    rig = ControllerRig()
    rig.enable()
    rig.is_running = False
    reports = rig.until(lambda r: r.status.state == "disconnected")
    assert reports[-1].status.fault.name == "controller_silent"
    assert not rig.hub.setpoint(rig.now.unix_ns, 0.1, rig.now).success
    rig.is_running = True
    # The fault that stopped it outlasts the silence.
    status = rig.until(lambda r: r.status.state == "fault")[-1].status
    assert (status.fault.name, status.way_back) == ("telemetry_stopped", ("clear_fault", "home", "enable"))
    rig.run(0.3)
    for step in status.way_back:
        assert rig.ask(step).success


def test_a_process_that_was_frozen_does_not_take_its_controller_for_silent() -> None:
    """Its thread wakes before the executor has the joint states that came meanwhile."""
    rig = ControllerRig()
    rig.is_running = rig.is_polled = False
    rig.steady.wait(1.2e-9 * SILENCE_NS)
    rig.run(0.05)
    rig.is_running = rig.is_polled = True
    reports = rig.run(0.3)
    assert all(r.status.state == "identified" for r in reports)
    assert reports[-1].status.counters["connections"] == 1


def test_joint_states_that_stop_under_a_sequence_stop_it() -> None:
    rig = ControllerRig()
    rig.enable()
    for chunk in chunks_of(rest_to_rest(4000), rig.now.unix_ns + 200_000_000):
        rig.hub.load(chunk, rig.now)
    rig.until(lambda r: r.status.activity == "sequence")
    rig.run(0.3)
    rig.is_running = False
    reports = rig.until(lambda r: r.status.state == "disconnected")
    assert [s.state for r in reports for s in r.sequences] == ["aborted"]
    # The controller was told to brake, and is heard to rest again.
    assert rig.sent[-1].velocities[-1] == 0.0
    assert rig.sent[-1].times_ns[-2] < 100_000_000
    rig.run(0.2)
    assert rig.controller.update(rig.now.unix_ns)[1] == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize(
    ("shift_ns", "name"), [(-2_000_000_000, "clock_backwards"), (2_000_000_000, "clock_jumped")]
)
def test_joint_states_whose_clock_jumps_stop_the_axis(shift_ns, name) -> None:
    rig = ControllerRig(AxisParameters(command_mode="velocity"))
    rig.enable()
    rig.hub.setpoint(rig.now.unix_ns, 0.02, rig.now)
    rig.run(0.1)
    rig.delay_ns = -shift_ns
    status = rig.until(lambda r: r.status.state == "fault")[-1].status
    assert (status.fault.name, status.way_back) == (name, ("clear_fault", "home", "enable"))
    rig.run(0.5)
    assert rig.controller.update(rig.now.unix_ns)[1] == pytest.approx(0.0, abs=1e-9)
    assert rig.ask("clear_fault").success


def test_one_absurd_stamp_is_left_out_and_the_axis_goes_on() -> None:
    rig = ControllerRig()
    rig.enable()
    rig.hub.joint_state(rig.now.unix_ns + 10**15, 0.0, 0.0, None, rig.now)
    report = rig.run(0.3)[-1]
    assert (report.status.state, report.status.fault.number) == ("enabled", 0)
    assert report.status.counters["unstamped_states"] == 1
    assert report.measured


@pytest.mark.parametrize(
    ("settings", "delay_ns", "words"),
    [({"max_knots": 100}, 0, "needs 1002 knots"), ({}, 300_000_000, "behind this host's clock")],
)
def test_what_cannot_be_handed_over_is_refused_with_the_reason(settings, delay_ns, words) -> None:
    rig = ControllerRig(**settings)
    rig.run(0.2)
    rig.delay_ns = delay_ns
    rig.run(0.6)
    if delay_ns:
        assert rig.reports[-1].status.fault.name == "clock_backwards"
        assert rig.ask("clear_fault").success
    rig.enable()
    sent = len(rig.sent)
    reports, _ = _run(rig, rest_to_rest(1000))
    (report,) = [s for r in reports for s in r.sequences if s.state == "refused"]
    assert words in report.reason
    assert len(rig.sent) == sent
    assert reports[-1].status.state == "enabled"


def test_home_is_here_or_where_the_joint_is_zero() -> None:
    rig = ControllerRig(homes_here=False)
    rig.enable()
    rig.hub.setpoint(rig.now.unix_ns, 0.0, rig.now)
    assert rig.hub.axis.place.zero == 0.0
    other = ControllerRig()
    other.controller.receive(
        Waypoints(0, np.array([100_000_000]), np.array([0.5]), np.array([0.0])), other.now.unix_ns
    )
    other.run(0.6)
    assert other.run(0.05)[-1].status.position == pytest.approx(0.01, abs=1e-5)
    other.enable()
    assert other.run(0.05)[-1].status.position == pytest.approx(0.0, abs=1e-5)
    assert other.hub.axis.place.zero == pytest.approx(0.01, abs=1e-5)
    # The first trajectory holds the joint where it stands, on its own scale.
    assert other.sent[-1].positions == pytest.approx([0.5, 0.5], abs=5e-4)


def test_a_controller_whose_settings_are_refused_under_a_sequence_is_stopped_and_left() -> None:
    rig = ControllerRig()
    rig.enable()
    for chunk in chunks_of(rest_to_rest(4000), rig.now.unix_ns + 200_000_000):
        rig.hub.load(chunk, rig.now)
    rig.until(lambda r: r.status.activity == "sequence")
    rig.run(0.3)
    rig.hub.judge("it bends straight lines")
    status = rig.until(lambda r: r.status.state == "disconnected")[-1].status
    assert (status.fault.name, status.reason) == ("wrong_axis", "it bends straight lines")
    assert rig.sent[-1].velocities[-1] == 0.0
    assert rig.sent[-1].times_ns[-2] < 100_000_000
    # Joint states go on, and connect nothing until the settings are mended.
    rig.run(0.3)
    assert rig.hub.axis.state == "disconnected"
    rig.hub.judge("")
    status = rig.until(lambda r: r.status.state == "fault")[-1].status
    assert status.fault.name == "wrong_axis"
    for step in status.way_back:
        assert rig.ask(step).success
