"""A firmware that keeps the protocol passes every check; for every check there is a defect that fails it."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from beam_ros.hub.conformance.dialogue import Bench
from beam_ros.hub.conformance.suite import ALWAYS, CHECKS, CheckResult, run_checks
from beam_ros.hub.emulated.emulator import EmulatedFirmware
from beam_ros.hub.line import protocol
from beam_ros.hub.line.framing import FrameDecoder, cobs_decode, encode_frame
from beam_ros.hub.parameters import COMMAND_MODES, AxisParameters, SimulatedDevice
from beam_ros.hub.simulated.plant import RigidPlant
from tests.beam_ros.hub.conformance.virtual_line import VirtualLine

NAMES = [check.name for check in CHECKS] + list(ALWAYS)


class Defective(EmulatedFirmware):
    """A firmware with defects at its edges: what it hears, what it says, what it does now and then."""

    hears: Callable[[Defective, protocol.Message], protocol.Message | None] = lambda _self, message: message
    says: Callable[[Defective, protocol.Message], protocol.Message | None] = lambda _self, message: message
    lives: Callable[[Defective], None] = lambda _self: None

    def exchange(self, data: bytes, device_ns: int) -> bytes:
        self.lives()
        return super().exchange(data, device_ns)

    def _take(self, message: protocol.Message) -> None:
        heard = self.hears(message)
        if heard is not None:
            super()._take(heard)

    def _send(self, message: protocol.Message) -> None:
        said = self.says(message)
        if said is not None:
            super()._send(said)


def make(mode: str = "acceleration", kind: type[EmulatedFirmware] = EmulatedFirmware) -> EmulatedFirmware:
    parameters = AxisParameters(command_mode=mode)
    return kind(
        parameters, RigidPlant(0.8, parameters.period), SimulatedDevice(initial_position=0.01), boot_id=5
    )


class Untouchable:
    """An axis that nobody can interfere with, as a ``Bench``: what the checks do to it has no effect."""

    max_following_error = AxisParameters().max_following_error

    def __init__(self, firmware: EmulatedFirmware, offset: float = 0.0) -> None:
        self._firmware, self._offset = firmware, offset

    @property
    def true_position(self) -> float:
        return self._firmware.axis.true_position + self._offset

    def hold_signals(self, **signals: bool) -> None:
        pass

    def lie(self, offset: float, scale: float) -> None:
        pass

    def stick(self, *, is_stuck: bool) -> None:
        pass


def results(
    firmware: EmulatedFirmware, *names: str, moves: bool = True, bench: Bench | None = None
) -> dict[str, CheckResult]:
    found = run_checks(VirtualLine(firmware), moves=moves, names=names, bench=bench)
    return {result.name: result for result in found}


@pytest.mark.slow
@pytest.mark.parametrize("mode", COMMAND_MODES)
def test_the_emulator_keeps_the_protocol_in_every_command_mode(mode):
    found = results(make(mode))
    assert list(found) == NAMES
    # Its axis has no sensors that could be interfered with.
    left_out = {check.name for check in CHECKS if check.needs_bench}
    assert {name for name, result in found.items() if result.outcome == "skipped"} == left_out
    assert {name: result.reason for name, result in found.items() if result.outcome == "failed"} == {}


def test_without_motion_the_axis_is_never_asked_to_move():
    class Watched(Defective):
        def hears(self, message):
            is_move = isinstance(message, protocol.Request) and message.kind in ("enable", "home")
            assert not (is_move and self._session.has_limits)
            assert not isinstance(message, protocol.Arm) or self.axis.state != "enabled"
            return message

    firmware = make(kind=Watched)
    firmware.axis.obey(firmware.axis.parameters)
    found = results(firmware, moves=False)
    moving = {check.name for check in CHECKS if check.moves}
    assert {name for name, result in found.items() if result.outcome == "skipped"} == moving
    assert firmware.axis.state == "identified"


# Defects --------------------------------------------------------------------------------------------------


def says(kind: type, change: Callable[..., object]) -> dict[str, object]:
    """What the device says of a kind is another thing."""

    def said(self, message):
        if isinstance(message, kind):
            return change(self, message) if change.__code__.co_argcount == 2 else change(message)
        return message

    return {"says": said}


def hears(kind: type, change: Callable[..., object]) -> dict[str, object]:
    """What the device hears of a kind is another thing."""
    return {"hears": lambda self, m: change(self, m) if isinstance(m, kind) else m}


def decodes(kind: type[FrameDecoder]) -> dict[str, object]:
    """The device finds frames in its own way."""

    def lives(self):
        if type(self._decoder) is not kind:
            self._decoder = kind()

    return {"lives": lives}


class WithoutCrc(FrameDecoder):
    def _close(self):
        encoded = bytes(self._pending)
        self.reset()
        try:
            payload = cobs_decode(encoded)[:-4]
        except OSError:
            return None
        return payload or None


class DeadAfterNoise(FrameDecoder):
    def feed(self, data):
        return [] if self.n_bad else super().feed(data)


class DeadAfterLength(FrameDecoder):
    def reset(self):
        self._pending.clear()


class WithoutPatience(FrameDecoder):
    def feed(self, data):
        payloads = super().feed(data)
        self.reset()
        return payloads


class WithoutLongHello(FrameDecoder):
    def feed(self, data):
        return [payload for payload in super().feed(data) if payload[0] != 1 or len(payload) == 7]


class Tolerant(FrameDecoder):
    """Cuts or fills bodies that do not fit."""

    def feed(self, data):
        return [self._fitted(payload) for payload in super().feed(data)]

    def _fitted(self, payload):
        for tried in (payload, payload[:-1], payload + b"\0"):
            try:
                protocol.decode(tried)
            except OSError:
                continue
            return tried
        return payload


def feeds_while(*activities: str) -> dict[str, object]:
    def lives(self):
        if self.axis.activity in activities:
            self.axis.feed()

    return {"lives": lives}


def keep_setpoint(self):
    if self.axis.activity == "setpoint":
        self.axis.feed()
        self.axis._setpoint_tick = self.axis.tick


def rerun_requests(self, message):
    self._session.replies.pop(message.number, None)
    return message


def refresh(self, message):
    self._session.setpoint_number = 0
    return message


def fill_gaps(self, message):
    return replace(message, first=min(message.first, self.axis.n_received))


def keep_going(self, message):
    """Take a session's end or beginning, but leave the axis alone."""
    stop, self.axis.emergency_stop = self.axis.emergency_stop, lambda *_: None
    self._handlers[type(message)](message)
    self.axis.emergency_stop = stop


def forget_limits(self, message):
    self._send(protocol.LimitsReply(message.number, message.limits))
    self._session.has_limits = True


def obey_always(self, message):
    self.axis.obey(message.limits.narrowed(self._parameters))
    self._session.has_limits = True
    return message


def count_twice(self, batch):
    EmulatedFirmware._send(self, batch)
    return batch


def lose_some(batch):
    return None if batch.ticks.first_tick // 20 % 7 == 3 else batch


def rounded(batch):
    return protocol.Telemetry(
        replace(batch.ticks, applied=batch.ticks.applied.astype(np.float32).astype(float))
    )


def status(**changes: object) -> dict[str, object]:
    return says(protocol.Status, lambda m: replace(m, **changes))


def fault_instead(number: int) -> dict[str, object]:
    return says(protocol.Status, lambda m: replace(m, fault_number=number if m.fault_number else 0))


def speak_on(self):
    self._is_in_session = True


def say_nonsense(self):
    self._output += encode_frame(b"\x99")


def be_heard(self):
    self._heard_ns = self._now_ns


def obeys(name: str, share: float) -> dict[str, object]:
    """One of the limits is another than the one that it says."""

    def scaled(message, factor):
        limits = message.limits
        return replace(message, limits=replace(limits, **{name: getattr(limits, name) * factor}))

    return {
        **hears(protocol.SetLimits, lambda _, m: scaled(m, share)),
        **says(protocol.LimitsReply, lambda m: scaled(m, 1 / share)),
    }


def forget_ramp(self, message):
    self.axis.obey(self._parameters)
    return message


def hear_without_feeding(self, message):
    self._handlers[type(message)](message)


def wait_for_batch(self, message):
    """Tell that a sequence runs with a batch, and not before."""
    was_batch, self.said_batch = getattr(self, "said_batch", False), isinstance(message, protocol.Telemetry)
    is_early = isinstance(message, protocol.Status) and message.sequence_state == "running" and not was_batch
    return None if is_early else message


def a_tick_late(batch):
    counts = batch.ticks.position_counts
    return protocol.Telemetry(replace(batch.ticks, position_counts=np.concatenate([counts[:1], counts[:-1]])))


ANYTHING_GOES = says(protocol.RequestReply, lambda m: replace(m, phase="success"))

DEFECTS: dict[str, dict[str, object]] = {
    "handshake": says(protocol.Identity, lambda _: None),
    "identity": says(protocol.Identity, lambda m: replace(m, buffer_samples=0)),
    "versions": hears(protocol.Hello, lambda _, m: protocol.Hello()),
    "longer_hello": decodes(WithoutLongHello),
    "no_session": {"lives": speak_on},
    "new_session": status(setpoint_number=3),
    "no_limits": {"lives": lambda self: setattr(self._session, "has_limits", True)},
    "limits": says(
        protocol.LimitsReply, lambda m: replace(m, limits=replace(m.limits, travel=m.limits.travel / 2))
    ),
    "wide_limits": hears(protocol.SetLimits, forget_limits),
    "impossible_limits": hears(protocol.SetLimits, forget_limits),
    "limits_while_enabled": hears(protocol.SetLimits, obey_always),
    "noise": decodes(DeadAfterNoise),
    "flipped_bits": decodes(WithoutCrc),
    "odd_bodies": decodes(Tolerant),
    "long_frames": decodes(DeadAfterLength),
    "pieces": decodes(WithoutPatience),
    "watchdog_not_fed": {"lives": lambda self: self.axis.feed()},
    "clock": says(protocol.ClockReply, lambda m: replace(m, sent_ns=m.received_ns - 1)),
    "clock_rate": says(
        protocol.ClockReply,
        lambda m: replace(m, received_ns=int(m.received_ns * 1.01), sent_ns=int(m.sent_ns * 1.01)),
    ),
    "clock_and_ticks": says(protocol.Status, lambda m: replace(m, tick=m.tick + 100)),
    "telemetry": says(protocol.Telemetry, lose_some),
    "telemetry_ends": {"lives": be_heard},
    "no_fault": says(protocol.RequestReply, lambda m: replace(m, phase="failure")),
    "homing": says(protocol.Status, lambda m: replace(m, position_count=m.position_count + 10)),
    "enabling": status(fault_number=5),
    "repeated_request": hears(protocol.Request, rerun_requests),
    "setpoints": status(setpoint_number=0),
    "refused_setpoints": status(setpoints_refused=0),
    "old_setpoint": hears(protocol.Setpoint, refresh),
    "silence_at_rest": status(silences=0),
    "silence_while_holding": feeds_while("hold"),
    "silence_while_following": {"lives": keep_setpoint},
    "silence_while_running": fault_instead(9),
    "silence_while_homing": feeds_while("homing"),
    "hello_stops": hears(protocol.Hello, keep_going),
    "goodbye_stops": fault_instead(9),
    "sequence": says(protocol.Telemetry, rounded),
    "overlap_and_gap": hears(protocol.Samples, fill_gaps),
    "room": says(protocol.Status, lambda m: replace(m, free=m.free + 100)),
    "underrun": fault_instead(1),
    "refused_sequences": says(protocol.ArmReply, lambda m: replace(m, is_accepted=True)),
    "not_finite": fault_instead(6),
    "changes": {"says": wait_for_batch},
    "watchdog_fed": hears(protocol.ClockQuery, hear_without_feeding),
    "stop_ramp": obeys("stop_deceleration", 0.9),
    "session_ramp": hears(protocol.Hello, forget_ramp),
    "way_home": obeys("homing_speed", 1.01),
    "moves": hears(protocol.Setpoint, lambda _, m: replace(m, value=0.99 * m.value)),
    "limit_edges": obeys("max_speed", 1.01),
    "states_at_rest": ANYTHING_GOES,
    "states_in_motion": ANYTHING_GOES,
    "states_on_the_way_home": ANYTHING_GOES,
    "misfits_stop": feeds_while("hold"),
    "sensed": says(protocol.Telemetry, a_tick_late),
    "home_from_both_sides": {},
    "end_switches": {},
    "drive_alarm": {},
    "encoder_lost": {},
    "following_error": {},
    "steps_lost": {},
    "home_switch_dead": {},
    "beyond_travel": hears(protocol.SetLimits, forget_limits),
    "layouts": {"lives": say_nonsense},
    "no_restart": says(protocol.Identity, lambda self, m: replace(m, boot_id=self._now_ns // 10**8)),
    "never_by_itself": says(
        protocol.Status,
        lambda m: replace(m, state="enabled", activity="hold") if m.state == "homed" else m,
    ),
    "ticks_forward": says(
        protocol.Status, lambda m: replace(m, tick=m.tick - min(m.tick, m.tick % 50 * 3 // 2))
    ),
    "batches": says(protocol.Telemetry, count_twice),
    "fault_numbers": status(fault_number=70),
}


@pytest.mark.parametrize("name", NAMES)
def test_a_firmware_with_a_defect_fails_the_check_that_is_about_it(name):
    others = () if name not in ALWAYS else ("handshake", "telemetry", "enabling")
    firmware = make(kind=type("DefectiveOne", (Defective,), DEFECTS[name]))
    # Its axis ignores what is done to it, and is not where it should be: a defect as such.
    bench = Untouchable(firmware, offset=1e-6)
    found = results(firmware, name, *others, bench=bench)
    assert (found[name].outcome, bool(found[name].reason)) == ("failed", True)


def test_no_defect_is_about_a_check_that_is_not_there():
    assert set(DEFECTS) == set(NAMES)


# The page ---------------------------------------------------------------------------------------------------

DOCS = Path(__file__).parents[4] / "docs"


def plain(text: str) -> str:
    return " ".join(text.split())


def test_the_page_names_for_every_promise_the_checks_that_hold_it():
    table = (DOCS / "conformance.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (.*?) \| (.*?) \|$", table, re.M)[1:]
    assert len(rows) > 50
    page = plain((DOCS / "protocol.md").read_text(encoding="utf-8"))
    assert [promise for promise, _ in rows if plain(promise) not in page] == []
    named = {name for _, checks in rows for name in re.findall(r"`(\w+)`", checks)}
    assert named == set(NAMES)
    on_a_bench = {name for _, checks in rows for name in re.findall(r"\*`(\w+)`\*", checks)}
    assert on_a_bench == {check.name for check in CHECKS if check.needs_bench}
