"""The compiled core in virtual time: the protocol, the path of the emulator, accidents, and a million samples."""

from __future__ import annotations

import random
import re
from dataclasses import replace

import numpy as np
import pytest

from beam_ros.hub.conformance.suite import run_checks
from beam_ros.hub.emulated.emulator import EmulatedFirmware
from beam_ros.hub.faults import fault
from beam_ros.hub.line import protocol
from beam_ros.hub.line.framing import FrameDecoder
from beam_ros.hub.parameters import COMMAND_MODES, AxisParameters, SimulatedDevice
from beam_ros.hub.simulated.plant import RigidPlant
from beam_ros.hub.ticks import TickBatch
from tests.beam_ros.hub.conformance.virtual_line import Firmware, VirtualLine
from tests.beam_ros.hub.hub_scenes import rest_to_rest
from tests.firmware.builds import VirtualCore

pytestmark = pytest.mark.slow

LIMITS = protocol.DeviceLimits.of(AxisParameters())


class Host:
    """Says what a test says, at half ticks, and keeps what the device answered."""

    def __init__(self, firmware: Firmware) -> None:
        self._firmware = firmware
        self._decoder = FrameDecoder()
        self.tick = 0
        self.messages: list[protocol.Message] = []

    def say(self, *messages: protocol.Message, ticks: int = 0) -> list[protocol.Message]:
        """Let ticks pass, then say something; return what is heard."""
        self.tick += ticks
        data = b"".join(map(protocol.encode, messages))
        answer = self._firmware.exchange(data, self.tick * 1_000_000 + 500_000)
        heard = [protocol.decode(payload) for payload in self._decoder.feed(answer)]
        self.messages += heard
        return heard

    def enable(self) -> None:
        """Home and enable, and go on at tick 2000."""
        self.say(protocol.Hello())
        self.say(protocol.SetLimits(1, LIMITS), protocol.Request(60001, "home"))
        while self.tick < 2000:
            self.say(protocol.Heartbeat(), ticks=50)
        self.say(protocol.Request(60002, "enable"), ticks=2000 - self.tick)
        assert self.status().state == "enabled"

    def status(self) -> protocol.Status:
        """The newest status, asked for."""
        heard = self.say(protocol.Samples(0, 0xFFFFFFFF, np.zeros(1)))
        return next(m for m in reversed(heard) if isinstance(m, protocol.Status))

    def rest(self, ticks: int = 400) -> protocol.Status:
        """Live on for a while; return how the axis stands then."""
        for _ in range(ticks // 20):
            self.say(protocol.Heartbeat(), ticks=20)
        return self.status()

    def telemetry(self, first: int = 0) -> TickBatch:
        """All ticks from one on; those of the sessions before are left out."""
        batches = [m.ticks for m in self.messages if isinstance(m, protocol.Telemetry)]
        whole = TickBatch.join([batch for batch in batches if batch.first_tick >= first])
        assert len(whole) == batches[-1].first_tick + len(batches[-1]) - whole.first_tick, "a gap"
        return whole


def emulated(mode: str) -> EmulatedFirmware:
    parameters = AxisParameters(command_mode=mode)
    device = SimulatedDevice(initial_position=0.01, buffer_samples=2048)
    return EmulatedFirmware(parameters, RigidPlant(0.8, parameters.period), device, boot_id=5)


@pytest.mark.parametrize("mode", COMMAND_MODES)
def test_the_core_keeps_the_protocol_in_every_command_mode(mode):
    with VirtualCore(COMMAND_MODES.index(mode)) as core:
        found = list(run_checks(VirtualLine(core), moves=True, bench=core))
    assert {result.name: result.reason for result in found if result.outcome != "passed"} == {}


# The same as the emulator ---------------------------------------------------------------------------------


def draw(rng: random.Random, mode: str, tick: int, number: int) -> protocol.Message:
    """A command as a host gives it, sometimes a wrong one."""
    limit = AxisParameters(command_mode=mode).command_limit
    kind = rng.choice(["setpoint"] * 6 + ["arm"] * 2 + ["samples"] * 4 + ["request"] * 4 + ["hello"])
    if kind == "setpoint":
        return protocol.Setpoint(number, limit * rng.choice([0.01, -0.02, 0.3, -0.3, 0.9, 1.2, float("nan")]))
    if kind == "arm":
        return protocol.Arm(
            rng.randrange(1, 4), (tick + rng.randrange(-5, 60)) * 1_000_000, rng.randrange(0, 200)
        )
    if kind == "samples":
        values = limit * rng.choice([0.01, 0.05, 1.5]) * np.sin(np.arange(rng.randrange(1, 101)) / 9.0)
        return protocol.Samples(rng.randrange(1, 4), rng.choice([0, 0, 0, 50, 100]), values)
    if kind == "request":
        return protocol.Request(number, rng.choice(["enable", "enable", "disable", "stop", "clear_fault"]))
    return rng.choice([protocol.Hello(), protocol.Goodbye(), protocol.SetLimits(number, LIMITS)])


def without_numbers(text: str) -> str:
    """A sentence without its figures, which the core writes in its own way."""
    return re.sub(r"-?\d+(\.\d+)?(e[+-]\d+)?|nan", "#", text)


def answers(messages: list[protocol.Message]) -> list[tuple[int, str, str]]:
    """The answers to requests and sequences, whose order is free where several end together."""
    return sorted(
        (
            m.number,
            m.phase if isinstance(m, protocol.RequestReply) else str(m.is_accepted),
            without_numbers(m.text),
        )
        for m in messages
        if isinstance(m, (protocol.RequestReply, protocol.ArmReply))
    )


def by_tick(host: Host) -> dict[int, tuple[float, int]]:
    """What was applied and where the encoder stood, by tick."""
    batches = [m.ticks for m in host.messages if isinstance(m, protocol.Telemetry)]
    return {b.first_tick + k: (b.applied[k], b.position_counts[k]) for b in batches for k in range(len(b))}


@pytest.mark.parametrize("mode", ["acceleration", "velocity", "position"])
@pytest.mark.parametrize("seed", range(6))
def test_the_core_does_what_the_emulator_does_on_random_commands(mode, seed):
    rng = random.Random(f"{mode} {seed}")
    with VirtualCore(COMMAND_MODES.index(mode)) as core:
        both = Host(core), Host(emulated(mode))
        for host in both:
            host.enable()
            host.messages.clear()
        for number in range(1, 250):
            ticks = rng.choice([0, 1, 3, 10, 40, 40, 300])
            command = draw(rng, mode, both[0].tick + ticks, number)
            ours, theirs = (host.say(command, ticks=ticks) for host in both)
            assert answers(ours) == answers(theirs)
            if isinstance(command, protocol.Goodbye):
                for host in both:
                    host.say(protocol.Hello())
            ours, theirs = (host.status() for host in both)
            # The core has measured at the last tick's beginning, the emulator knows its end: see the telemetry.
            same = {"velocity_count": 0, "position_count": 0, "reason": "", "sequence_reason": ""}
            if ours.sequence_state == "none":
                same |= {"received": 0}  # What an earlier session received, one of them has forgotten.
            assert replace(ours, **same) == replace(theirs, **same)
            assert without_numbers(ours.reason) == without_numbers(theirs.reason)
            assert without_numbers(ours.sequence_reason) == without_numbers(theirs.sequence_reason)
            if ours.state in ("homed", "fault") and rng.random() < 0.7:
                # Up again, as a host would bring it.
                for host in both:
                    host.say(protocol.Hello(), protocol.SetLimits(number, LIMITS))
                    host.say(protocol.Request(30000 + number, "clear_fault"))
                    host.say(protocol.Request(31000 + number, "enable"))
        ours, theirs = map(by_tick, both)
        shared = sorted(ours.keys() & theirs.keys())
        assert len(shared) > 1000
        assert [ours[tick][0] for tick in shared] == [theirs[tick][0] for tick in shared]
        assert max(abs(ours[tick][1] - theirs[tick][1]) for tick in shared) <= 1


def test_the_core_does_not_drift_from_the_emulator_over_a_long_sequence():
    """The bound that docs/firmware.md gives: nothing; both calculate in the same order."""
    values = np.tile(rest_to_rest(997), 20)
    ends = []
    with VirtualCore() as core:
        for firmware in (core, emulated("acceleration")):
            host = Host(firmware)
            host.enable()
            ends.append(play(host, values))
    assert np.array_equal(ends[0].applied, values)
    assert np.array_equal(ends[0].applied, ends[1].applied)
    assert np.abs(ends[0].position_counts - ends[1].position_counts).max() <= 1
    # The core's speed is half the way of two ticks, which rounds twice; the acceleration changes little in between.
    assert np.abs(ends[0].velocity_counts - ends[1].velocity_counts).max() <= 2


def test_a_forced_hub_is_as_fast_as_the_core_believes():
    """The emulator knows the speed; the core has it from the encoder, and a tick changes it by 5 mm/s."""
    speeds = []
    with VirtualCore(COMMAND_MODES.index("effort")) as core:
        for firmware in (core, emulated("effort")):
            host = Host(firmware)
            host.enable()
            for number in range(1, 60):
                host.say(protocol.Setpoint(number, 4.0), ticks=3)
            status = host.rest()
            assert (status.state, status.fault_number) == ("fault", fault("speed_limit").number)
            speeds.append(float(re.search(r"limit: speed ([\d.]+) m/s", status.reason)[1]))
    assert speeds[0] == pytest.approx(speeds[1], abs=1e-3)


@pytest.mark.parametrize("forces", [[20.0], [20.0, -12.0, 20.0], [3.0, 20.0]])
def test_no_force_drives_the_cores_hub_beyond_its_speed_limit(forces):
    # The core has the speed from the encoder, which shows three quarters of a jump of the force within its tick.
    with VirtualCore(COMMAND_MODES.index("effort")) as core:
        host = Host(core)
        host.enable()
        for number in range(1, 120):
            host.say(protocol.Setpoint(number, forces[number % len(forces)]), ticks=7)
        status = host.rest()
    assert status.fault_number == fault("speed_limit").number
    speeds = host.telemetry(2000).velocity_counts * 1e-7 / 1e-3
    assert 0.46 < np.max(np.abs(speeds)) <= 1.005 * 0.5


def play(host: Host, values: np.ndarray) -> TickBatch:
    """Play a sequence; return its ticks."""
    start = host.tick + 100
    host.messages.clear()
    host.say(protocol.Arm(1, start * 1_000_000, len(values)))
    sent = 0
    while host.status().sequence_state in ("armed", "running"):
        status = host.status()
        sent = max(sent, status.received)
        while sent < min(len(values), status.received + status.free):
            part = values[sent : min(sent + 100, status.received + status.free)]
            host.say(protocol.Samples(1, sent, part))
            sent += len(part)
        host.say(protocol.Heartbeat(), ticks=100)
    assert host.status().sequence_state == "done", host.status()
    host.rest(40)
    ticks = host.telemetry()
    return ticks[start - ticks.first_tick : start - ticks.first_tick + len(values)]


@pytest.mark.verify
def test_the_core_does_not_drift_over_a_million_samples():
    values = np.tile(rest_to_rest(1_000), 1_000)
    with VirtualCore() as core:
        host = Host(core)
        host.enable()
        ticks = play(host, values)
    assert np.array_equal(ticks.applied, values)
    # The same sums in extended precision: what the host's model says of these samples.
    speeds = np.concatenate([[0.0], np.cumsum(values, dtype=np.longdouble)[:-1]]) * np.longdouble(1e-3)
    ways = speeds * np.longdouble(1e-3) + values * np.longdouble(5e-7)
    path = np.concatenate([[0.0], np.cumsum(ways)[:-1]])
    counts = ticks.position_counts - ticks.position_counts[0]
    assert np.abs(counts * 1e-7 - path).max() < 1.5e-7


# Accidents ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", COMMAND_MODES)
def test_homing_ends_where_the_home_switch_never_changes(mode):
    with VirtualCore(COMMAND_MODES.index(mode), position=-0.03) as core:
        core.hold_signals(is_below_home=True)
        host = Host(core)
        host.say(protocol.Hello())
        host.say(protocol.SetLimits(1, LIMITS), protocol.Request(7, "home"))
        status = host.rest(6000)
        assert (status.state, status.fault_number) == ("identified", fault("homing_failed").number)
        (reply,) = [m for m in host.messages if isinstance(m, protocol.RequestReply) and m.phase != "pending"]
        assert (reply.phase, reply.text.startswith("homing ended early")) == ("failure", True)
        # The way of the search, and the ramp.
        assert -0.03 + 0.1 <= core.true_position < -0.03 + 0.1 + 1e-3
