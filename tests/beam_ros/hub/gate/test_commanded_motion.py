"""Set-points against the truth: the simulated axis with its beam, in virtual time."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ros.hub.gate.command_gate import CommandGate
from beam_ros.hub.gate.commanded_motion import CommandedMotion
from beam_ros.hub.parameters import AxisParameters
from beam_ros.hub.simulated.plant import beam_on_axis
from beam_ros.rig.rig import Rig as RigFile
from tests.beam_ros.hub.hub_scenes import UNIX_START, SimulatedRig

RESONANCE_HZ = 4.38
MODES = ["acceleration", "velocity", "position", "effort"]


class StreamedRig(SimulatedRig):
    """A simulated rig with its beam, to which set-points are streamed, and the largest that was seen of it."""

    def __init__(self, **changes: object) -> None:
        self.file = RigFile.from_file().with_values({k.replace("__", "."): v for k, v in changes.items()})
        self.model = self.file.beam_model()
        parameters = self.file.axis_parameters()
        super().__init__(parameters, beam_on_axis(self.model, parameters), guard=self.file.beam_guard())
        self.tip = self.travel = 0.0
        self.tip_shape = self.model.shape([self.model.parameters.length])[0]
        self.refusals: list[str] = []
        self.enable()

    def watch(self, seconds: float) -> None:
        self.run(seconds)
        stamps = self.hub.reached_ns - np.arange(0, round(seconds * 1e9), 5_000_000)
        seen = self.hub.snapshots(stamps)
        self.tip = max(self.tip, float(np.abs(seen.coordinates @ self.tip_shape).max()))
        self.travel = max(self.travel, float(np.abs(seen.positions).max()))

    def send(self, value: float) -> bool:
        outcome = self.hub.setpoint(self.now.unix_ns, value, self.now)
        if not outcome.success:
            self.refusals.append(outcome.message)
        return outcome.success


@pytest.mark.first_case
@pytest.mark.parametrize(
    ("mode", "size"), [("acceleration", 0.6), ("velocity", 0.03), ("position", 0.001), ("effort", 0.5)]
)
def test_a_resonant_stream_is_refused_before_it_bends_the_tip_too_far(mode: str, size: float) -> None:
    rig = StreamedRig(hub__command_mode=mode)
    n_good = 0
    for k in range(250):
        n_good += rig.send(size * np.sin(2 * np.pi * RESONANCE_HZ * k * 0.02 + 0.3))
        rig.watch(0.02)
    rig.watch(1.0)
    assert n_good > 40
    assert any("predicted tip deflection" in reason for reason in rig.refusals), rig.refusals[:3]
    # Near the limit, or the test would prove nothing, and never beyond it.
    assert 0.024 < rig.tip < 0.030
    assert rig.travel < 0.050


def test_what_is_refused_as_a_sequence_is_refused_as_set_points() -> None:
    """4.4 Hz at 2.5 m/s^2: 169 mm at the tip."""
    rig = StreamedRig()
    good = []
    for k in range(150):
        good.append(rig.send(2.5 * np.sin(2 * np.pi * 4.4 * k * 0.02)))
        rig.watch(0.02)
    rig.watch(1.0)
    assert not all(good)
    assert rig.tip < 0.030
    assert rig.travel < 0.050


@pytest.mark.slow
@pytest.mark.parametrize("mode", MODES)
def test_whatever_is_streamed_hub_and_beam_stay_within_their_limits(mode: str) -> None:
    """Random streams that fall silent, stop and go on; the axis itself never had to stop at a limit."""
    rng = np.random.default_rng(MODES.index(mode))
    n_taken = 0
    for _ in range(2):
        rig = StreamedRig(hub__command_mode=mode)
        limit = rig.file.axis_parameters().command_limit
        for _ in range(25):
            kind, size, pause = rng.integers(3), limit * rng.uniform() ** 3, rng.choice([0.01, 0.02, 0.1])
            for k in range(rng.integers(3, 20)):
                wave = (1.0, np.sin(2 * np.pi * RESONANCE_HZ * k * pause), rng.uniform(-1, 1))[kind]
                n_taken += rig.send(size * wave)
                rig.watch(pause)
            if rng.uniform() < 0.2:
                rig.hub.request("stop")
            if rng.uniform() < 0.3:
                rig.watch(0.5)
            status = rig.reports[-1].status
            assert status.state != "fault", status.reason
            if status.state == "homed":
                assert rig.ask("enable").success
        assert rig.travel < 0.050 + 1e-5
        assert rig.tip < 0.030
    assert n_taken > 50


@pytest.mark.parametrize(
    ("mode", "good", "bad", "words"),
    [
        # From home, held for the watchdog's 0.25 s and a little, then stopped at 10 m/s^2 within 0.05 m:
        # v 0.261 = 0.05 at v = 0.192, since the stop makes up for the start;
        # a 0.261^2/2 + (a 0.261)^2/20 = 0.05 at a = 1.34.
        ("velocity", 0.188, 0.195, "travel"),
        ("acceleration", 1.25, 1.4, "travel"),
        ("position", 0.05, 0.0501, "within"),
    ],
)
def test_a_set_point_must_leave_room_for_its_hold_and_the_stop(mode, good, bad, words) -> None:
    parameters = AxisParameters(command_mode=mode)
    for value, is_good in ((good, True), (-good, True), (bad, False), (-bad, False)):
        outcome = CommandGate(parameters).check_setpoint(UNIX_START, value, UNIX_START, "enabled", 0.0, 0.0)
        assert outcome.success is is_good, outcome.message
        assert is_good or words in outcome.message


def test_the_axis_state_counts_and_a_shorter_watchdog_gives_room() -> None:
    def objection(position, velocity, value=0.1, **changes):
        parameters = AxisParameters(command_mode="velocity", **changes)
        return CommandedMotion(parameters).objection(value, UNIX_START, position, velocity)

    assert objection(0.0, 0.0) is None
    assert "it would take the hub to 0.0563 m" in objection(0.03, 0.1)
    assert "hub.watchdog (0.25 s)" in objection(0.03, 0.1)
    assert objection(0.03, 0.1, watchdog_s=0.1) is None
    # Beyond the travel, it may be led back but not further out.
    assert objection(0.0501, 0.0, value=-0.1) is None
    assert objection(0.0501, 0.0, value=0.0) is None
    assert "travel" in objection(0.0501, 0.0, value=1e-3)
    assert "expected finite numbers" in objection(float("nan"), 0.0)
    assert "expected finite numbers" in objection(0.0, float("inf"))


def test_a_hold_that_would_be_too_fast_is_refused() -> None:
    parameters = AxisParameters(travel=10.0)
    motion = CommandedMotion(parameters)
    assert motion.objection(1.85, UNIX_START, 0.0, 0.0) is None
    assert "the limit is 0.5 m/s" in str(motion.objection(2.0, UNIX_START, 0.0, 0.0))


def test_a_refused_set_point_leaves_the_one_before_it_to_age_and_the_axis_stops_within_its_travel() -> None:
    rig = StreamedRig(hub__command_mode="velocity")
    assert rig.send(0.1)
    rig.watch(0.1)
    assert not rig.send(0.4)
    rig.watch(1.0)
    assert rig.reports[-1].status.state == "homed"
    assert "not refreshed" in rig.reports[-1].status.reason
    assert 0.02 < rig.travel < 0.03


def test_a_link_without_samples_is_followed_by_what_was_written() -> None:
    """Nobody calls ``follow``: the model knows the set-points alone, and still refuses the resonant stream."""
    rig = RigFile.from_file().with_values({"hub.command_mode": "velocity"})
    gate = CommandGate(rig.axis_parameters(), rig.beam_guard())
    outcomes = []
    velocity = position = 0.0
    for k in range(300):
        now_ns = UNIX_START + k * 20_000_000
        value = 0.04 * np.sin(2 * np.pi * RESONANCE_HZ * k * 0.02)
        outcomes.append(gate.check_setpoint(now_ns, value, now_ns, "enabled", position, velocity))
        velocity = value
        position += velocity * 0.02
    first = next(k for k, outcome in enumerate(outcomes) if not outcome.success)
    assert "predicted tip deflection" in outcomes[first].message
    # 27 mm/s per 0.04 m/s of resonant drive: Gamma phi(L) v omega/2 = 1.57 * 0.04 * 27.5 / 2 a second.
    assert 0.3 < first * 0.02 < 1.5
