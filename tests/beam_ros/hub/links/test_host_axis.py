"""The motion controller in the host, in virtual time: states, plans, lateness, faults."""

from __future__ import annotations

import time

import numpy as np
import pytest

from beam_ros.hub.contract import HostTime, HubReport, Outcome
from beam_ros.hub.links.host_axis import HostAxis
from beam_ros.hub.parameters import AxisParameters
from beam_ros.hub.simulated.plant import Plant, beam_on_axis
from beam_ros.rig.rig import Rig
from tests.beam_ros.hub.hub_scenes import chunks_of

MS = 1_000_000
START_NS = 7_000 * MS
UNIX = 1_700_000_000_000_000_000


class _Axis:
    """A host axis whose drive follows at once, stepped every 5 ms and polled every 10 ms."""

    def __init__(
        self,
        mode: str = "velocity",
        raw: float = 0.3,
        *,
        homes_here: bool = True,
        rig: Rig | None = None,
        deceleration: float = 2.0,
    ) -> None:
        parameters = AxisParameters(command_mode=mode, stop_deceleration=deceleration)
        self.axis = HostAxis(parameters, homes_here=homes_here, checks_in_background=False)
        self.tip = 0.0
        self.plant: Plant | None = None
        if rig is not None:
            rig = rig.with_values({"hub.command_mode": mode})
            parameters, model = rig.axis_parameters(), rig.beam_model()
            self.axis = HostAxis(parameters, rig.beam_guard(), checks_in_background=False)
            self.plant = beam_on_axis(model, parameters)
            self.tip_shape = model.shape([model.parameters.length])[0]
        self.now_ns = START_NS
        self.raw = raw
        self.follows = True
        self.coasting: float | None = None
        """The speed at which the hub goes on, whatever is written [m/s]."""
        self.is_polled = True
        self.reports: list[HubReport] = []
        self.axis.measure(raw, 0.0)
        self.poll()
        self.axis.connect("a drive")

    @property
    def now(self) -> HostTime:
        return HostTime(self.now_ns, UNIX + self.now_ns)

    def poll(self) -> HubReport:
        self.reports.append(self.axis.poll(self.now))
        return self.reports[-1]

    def run(self, ms: int) -> None:
        for _ in range(ms // 5):
            self._bend()
            self.now_ns += 5 * MS
            if self.axis.powering:
                self.axis.grant(self.now_ns)
            self.axis.step(self.now_ns)
            position, velocity, _ = self.axis.course.at(self.now_ns)
            if self.coasting is not None:
                self.raw, velocity = self.raw + self.coasting * 0.005, self.coasting
            elif self.axis.is_powered and self.follows:
                self.raw = position + self.axis.place.zero
            else:
                velocity = 0.0
            self.axis.measure(self.raw, velocity, UNIX + self.now_ns)
            if self.is_polled and self.now_ns // (5 * MS) % 2:
                self.poll()

    def _bend(self) -> None:
        """Let the beam follow the hub for the next 5 ms, in ticks of 1 ms."""
        for k in range(5) if self.plant is not None else ():
            before, after = (self.axis.course.at(self.now_ns + (k + j) * MS)[1] for j in (0, 1))
            acceleration = (after - before) / 1e-3
            self.plant.step_led(acceleration, acceleration)
            self.tip = max(self.tip, abs(float(self.plant.state()[: self.plant.n_modes] @ self.tip_shape)))

    def ask(self, kind: str) -> Outcome:
        number = self.axis.request(kind, self.now_ns)
        for _ in range(400):
            self.run(10)
            for report in self.reports[-2:]:
                if number in dict(report.completed):
                    return dict(report.completed)[number]
        raise AssertionError(f"{kind} did not end")

    def enabled(self) -> _Axis:
        for kind in ("home", "enable"):
            assert self.ask(kind).success
        return self

    def setpoint(self, value: float) -> Outcome:
        return self.axis.setpoint(UNIX + self.now_ns, value, self.now)


def test_home_is_here_or_the_controllers_own_zero() -> None:
    here = _Axis()
    assert here.ask("home").success
    assert (here.axis.place.position, here.axis.place.zero, here.raw) == (0.0, 0.3, 0.3)
    there = _Axis(raw=0.03, homes_here=False)
    assert there.ask("home").success
    assert there.axis.place.zero == 0.0
    assert there.raw == pytest.approx(0.0, abs=1e-12)
    # 30 mm at 20 mm/s, and what it takes to get there and to settle.
    assert there.axis.state == "homed"


def test_a_hub_beyond_its_travel_is_not_led_home_by_force() -> None:
    outcome = _Axis(raw=0.08, homes_here=False).ask("home")
    assert not outcome.success
    assert "stands at 0.080000 m, expected within +-0.05 m" in outcome.message


def test_set_points_age_and_silence_of_the_executor_stops() -> None:
    rig = _Axis().enabled()
    assert rig.setpoint(0.04).success
    rig.run(600)
    assert rig.reports[-1].status.fault.name == "setpoint_old"
    assert rig.axis.state == "homed"
    # 0.25 s at 0.04 m/s (of which 4 ms are the ramp up), then 0.04 m/s at 2 m/s^2.
    assert rig.axis.place.position == pytest.approx(0.04 * (0.25 - 0.002) + 0.04**2 / 4, abs=0.04 * 0.006)
    rig = _Axis("position").enabled()
    assert rig.setpoint(0.03).success
    rig.run(100)
    rig.is_polled = False
    rig.run(600)
    assert rig.poll().status.fault.name == "host_silent"
    assert rig.axis.state == "homed"
    assert rig.axis.place.position < 0.03


def test_what_would_leave_the_travel_before_it_stops_is_refused() -> None:
    rig = _Axis().enabled()
    outcome = rig.setpoint(0.3)
    assert not outcome.success
    assert "would take the hub to" in outcome.message
    assert rig.axis.activity == "hold"


@pytest.mark.slow
@pytest.mark.parametrize(("mode", "size"), [("acceleration", 0.6), ("velocity", 0.03), ("position", 0.001)])
def test_set_points_that_would_bend_the_beam_too_far_are_refused(mode: str, size: float) -> None:
    """At the first resonance, 4.38 Hz, the tip would reach far beyond hub.max_tip_deflection = 30 mm."""
    rig = _Axis(mode, rig=Rig.from_file()).enabled()
    outcomes = []
    for k in range(200):
        outcomes.append(rig.setpoint(size * np.sin(2 * np.pi * 4.38 * k * 0.02 + 0.3)))
        rig.run(20)
    rig.run(1000)
    assert any("predicted tip deflection" in outcome.message for outcome in outcomes)
    assert 0.02 < rig.tip < 0.030


@pytest.mark.slow
def test_the_beam_that_a_sequence_left_swinging_is_remembered() -> None:
    taken = []
    for ringing in (0.0, 1.0):
        rig = _Axis("acceleration", rig=Rig.from_file()).enabled()
        t = np.arange(2000) * 1e-3
        values = ringing * np.sin(2 * np.pi * 4.38 * t) * np.sin(np.pi * t / 2.0) ** 2
        values -= np.hanning(2000) * values.sum() / np.hanning(2000).sum()
        for chunk in chunks_of(values, UNIX + rig.now_ns + 500 * MS):
            rig.axis.load(chunk, rig.now)
        for _ in range(100):
            rig.run(100)
            if any(s.state == "done" for r in rig.reports[-10:] for s in r.sequences):
                break
            time.sleep(0.01)  # the check of the sequence runs in a thread, in real time
        taken.append(rig.setpoint(1.1).success)
    assert taken == [True, False]


def test_a_late_host_stops_the_hub_from_where_it_was_measured() -> None:
    rig = _Axis().enabled()
    for _ in range(4):
        assert rig.setpoint(0.1).success
        rig.run(50)
    measured = rig.axis.place.position
    late_ns = 80 * MS
    rig.now_ns += late_ns
    rig.axis.measure(rig.raw + 0.001, 0.05)
    rig.axis.note_late(late_ns, rig.now_ns)
    # Not from the plan, which is 8 mm further on.
    position, velocity, _ = rig.axis.course.at(rig.now_ns)
    assert (position, velocity) == pytest.approx((measured + 0.001, 0.05))
    rig.run(300)
    assert rig.reports[-1].status.fault.name == "underrun"
    assert rig.axis.state == "homed"


@pytest.mark.parametrize(("value", "late_ms"), [(0.0, 240), (0.02, 120)])
def test_lateness_that_moves_nothing_far_is_forgiven(value: float, late_ms: int) -> None:
    rig = _Axis().enabled()
    assert rig.setpoint(value).success
    rig.run(100)
    rig.now_ns += late_ms * MS
    rig.axis.note_late(late_ms * MS, rig.now_ns)
    assert rig.axis.activity == "setpoint"


def test_a_hub_that_does_not_follow_is_a_fault_that_stays() -> None:
    rig = _Axis().enabled()
    rig.follows = False
    for _ in range(20):
        rig.setpoint(0.03)
        rig.run(50)
    status = rig.reports[-1].status
    assert (status.state, status.fault.name) == ("fault", "motion_unexplained")
    assert "clear the fault first" in rig.ask("enable").message
    assert rig.ask("clear_fault").success
    rig.follows = True
    assert rig.ask("enable").success


@pytest.mark.parametrize("is_enabled", [False, True])
@pytest.mark.parametrize(
    ("ms", "metres", "name"),
    [
        # 2 x 0.5 m/s for 5 ms, and for 5 ms by which a stamp may be wrong, and 2 mm.
        (5, 0.0119, ""),
        (5, 0.0121, "position_jumped"),
        # The limit of 50 mm, and 2 mm.
        (100, 0.0519, ""),
        (100, 0.0521, "beyond_travel"),
    ],
)
def test_a_measurement_is_looked_at_by_itself(ms: int, metres: float, name: str, is_enabled: bool) -> None:
    rig = _Axis(raw=0.0).enabled()
    if not is_enabled:
        assert rig.ask("disable").success
    rig.axis.measure(0.0, 0.0, UNIX + rig.now_ns)
    rig.now_ns += ms * MS
    rig.axis.measure(metres, 0.0, UNIX + rig.now_ns)
    status = rig.poll().status
    if not name:
        assert status.state == ("enabled" if is_enabled else "homed")
        return
    assert (status.state, status.fault.name) == ("fault", name)
    rig.raw = 0.0
    rig.run(600)
    assert not rig.axis.is_powered
    assert "clear the fault first" in rig.ask("enable").message
    for step in rig.poll().status.way_back:
        assert rig.ask(step).success
    assert rig.axis.state == "enabled"


def test_a_hub_that_moves_faster_than_its_limit_is_a_fault() -> None:
    rig = _Axis(raw=0.0).enabled()
    for k in range(24):
        # No jump from one to the next; 0.1 s at 0.65 m/s are 65 mm, where 0.5 m/s and tolerances allow 57.
        metres = -0.04 + 0.65 * k * 0.005
        rig.axis.measure(metres, 0.65, UNIX + rig.now_ns)
        rig.now_ns += 5 * MS
    status = rig.poll().status
    assert status.fault.name == "motion_unexplained"
    assert "hub.max_speed" in status.reason


def test_a_lost_controller_ends_everything_and_nothing_comes_back_by_itself() -> None:
    rig = _Axis().enabled()
    rig.setpoint(0.03)
    rig.run(50)
    number = rig.axis.request("stop", rig.now_ns)
    rig.axis.disconnect("port_lost", "the port vanished")
    rig.axis.disconnect("port_lost", "the port is still away")
    report = rig.poll()
    assert [event.text for event in report.events if event.level == "error"] == ["the port vanished"]
    outcome = dict(report.completed)[number]
    assert outcome == Outcome(False, "the controller is disconnected: the port vanished")
    assert (report.status.state, report.status.fault.name) == ("disconnected", "port_lost")
    assert "disconnected: the port is still away" in rig.ask("enable").message
    rig.axis.connect("a drive")
    assert rig.poll().status.state == "identified"
    assert not rig.axis.is_powered
    assert not rig.setpoint(0.01).success


def test_what_waits_for_the_motor_is_answered_when_it_is_denied() -> None:
    rig = _Axis()
    number = rig.axis.request("home", rig.now_ns)
    rig.axis.deny("the drive is locked")
    assert dict(rig.poll().completed)[number] == Outcome(False, "cannot home: the drive is locked")
    assert rig.axis.state == "identified"


def _moving(speed: float = 0.04) -> _Axis:
    rig = _Axis().enabled()
    for _ in range(4):
        assert rig.setpoint(speed).success
        rig.run(50)
    return rig


@pytest.mark.parametrize("kind", ["stop", "disable"])
def test_a_stop_that_the_drive_ignores_is_a_fault_a_false_answer_and_silence(kind: str) -> None:
    rig = _moving()
    rig.coasting, ordered_ns = 0.04, rig.now_ns
    outcome = rig.ask(kind)
    waited_s = (rig.now_ns - ordered_ns) * 1e-9
    # The ramp, 0.3 s, and the polls that show it.
    assert waited_s <= 0.04 / 2.0 + 0.3 + 0.03
    assert not outcome.success
    assert "did not come to rest" in outcome.message
    assert rig.poll().status.fault.name == "stop_ignored"
    assert not rig.axis.is_powered
    assert rig.axis.must_be_silent(rig.now_ns)
    assert "has not been seen at rest" in rig.ask("clear_fault").message
    rig.coasting = None
    rig.run(1000)
    assert not rig.axis.must_be_silent(rig.now_ns)
    assert rig.ask("clear_fault").success
    assert not rig.ask("enable").success, "home is lost"


def test_the_stop_after_a_fault_is_the_same_promise() -> None:
    rig = _moving()
    rig.coasting = 0.04
    rig.run(100)
    rig.axis.fail("drive_alarm", "the drive is hot", rig.now_ns)
    rig.run(600)
    assert rig.axis.must_be_silent(rig.now_ns)
    assert not rig.axis.is_powered
    assert "has not been seen at rest" in rig.ask("clear_fault").message


def test_a_hub_that_comes_to_rest_late_but_in_time_has_stopped() -> None:
    rig = _moving()
    rig.coasting = 0.04
    number = rig.axis.request("stop", rig.now_ns)
    rig.run(150)
    rig.coasting = 0.0
    assert not any(number in dict(report.completed) for report in rig.reports)
    rig.run(100)
    assert next(outcome for r in rig.reports for n, outcome in r.completed if n == number).success
    assert rig.axis.state == "homed"


def test_a_ramp_of_two_seconds_is_waited_for() -> None:
    rig = _Axis(deceleration=0.1).enabled()
    for _ in range(60):
        rig.setpoint(0.05)
        rig.run(10)
    assert rig.ask("stop").success


def _armed() -> _Axis:
    rig = _Axis("acceleration").enabled()
    for chunk in chunks_of(np.zeros(200), UNIX + rig.now_ns + 2_000 * MS):
        rig.axis.load(chunk, rig.now)
    end = time.monotonic() + 30.0
    while rig.axis.activity != "armed":
        assert time.monotonic() < end
        time.sleep(0.01)  # the check of the sequence runs in a thread, in real time
        rig.poll()
    return rig


def test_a_fault_while_a_sequence_waits_for_its_start_stops_the_axis() -> None:
    rig = _armed()
    rig.axis.fail("drive_alarm", "the drive is hot", rig.now_ns)
    rig.run(600)
    assert not rig.axis.is_powered
    # What a measurement shows is acted upon in the next step.
    rig = _armed()
    rig.raw += 0.04
    rig.follows = False
    rig.run(600)
    assert not rig.axis.is_powered
    assert rig.poll().status.fault.name == "position_jumped"
