"""The client against the emulated firmware over a line in virtual time: every accident, quickly."""

from __future__ import annotations

import dataclasses
import math
import random
import re
from collections import deque

import numpy as np
import pytest

from beam_ros.hub.emulated.unruly_line import UnrulyLine
from beam_ros.hub.faults import fault
from beam_ros.hub.line import protocol
from beam_ros.hub.line.framing import FrameDecoder
from beam_ros.hub.parameters import AxisParameters, LinkParameters
from tests.beam_ros.hub.hub_scenes import DRIFTING, LoopbackRig, SimulatedRig, chunks_of, rest_to_rest

PARAMETERS = AxisParameters()
VELOCITY = dataclasses.replace(PARAMETERS, command_mode="velocity")


def connected(parameters=PARAMETERS, **options) -> LoopbackRig:
    rig = LoopbackRig(parameters, **options)
    rig.connect()
    return rig


def load(rig, values, lead_ns=300_000_000, sequence_id="move"):
    start_ns = rig.now.unix_ns + lead_ns
    for chunk in chunks_of(values, start_ns, sequence_id):
        rig.hub.load(chunk, rig.now)
    return start_ns


def states(reports):
    return [s.state for r in reports for s in r.sequences]


def frames_of(kind):
    """Tell whether an encoded frame carries this type of message."""
    return lambda frame: FrameDecoder().feed(frame)[0][0] == kind


def filtered(keep):
    """Return a line that drops the frames for which `keep` is false."""

    def line(data: bytes) -> bytes:
        return b"".join(f + b"\0" for f in data.split(b"\0") if f and keep(f + b"\0"))

    return line


def late(kind, steps):
    """Return a line on which messages of a type come so many steps of 1 ms late."""
    is_late, under_way = frames_of(kind), deque([b""] * steps)

    def line(data: bytes) -> bytes:
        frames = [f + b"\0" for f in data.split(b"\0") if f]
        under_way.append(b"".join(f for f in frames if is_late(f)))
        return b"".join(f for f in frames if not is_late(f)) + under_way.popleft()

    return line


def test_nothing_is_said_before_the_first_poll_nor_after_the_executor_froze():
    rig = LoopbackRig(PARAMETERS)
    assert rig.client.transmit(rig.steady_ns) == b""
    rig.connect()
    rig.is_polled = False
    said = []
    rig.to_device = lambda data: said.append((rig.steady_ns, len(data))) or data
    start = rig.steady_ns
    rig.run(0.5)
    assert max(t for t, n in said if n) - start <= 200_000_000


def test_a_session_begins_with_the_devices_state_and_one_line_in_the_log():
    rig = connected()
    texts = [e.text for r in rig.reports for e in r.events]
    assert texts == ["connected: firmware emulator on ", "axis identified"]
    assert rig.reports[-1].status.counters["connections"] == 1


@pytest.mark.slow
def test_the_devices_drift_and_map_come_out():
    rig = connected()
    rig.run(10.0)
    counters = rig.reports[-1].status.counters
    assert counters["clock_drift_ppb"] == pytest.approx(35_000, abs=3000)
    assert counters["clock_sd_ns"] < 20_000
    batches = [b for r in rig.reports for b in r.measured]
    for batch in (batches[0], batches[-1]):
        ticks = (rig.device_ns(rig.steady_ns - rig.now.unix_ns + batch.stamp_ns)) / 1e6
        # Half the jitter of 0.1 ms one way bounds the error.
        assert abs(ticks - round(ticks)) < 0.05
    syncs = [s for r in rig.reports for s in r.clock]
    assert {s.epoch for s in syncs} == {1}
    assert len(syncs) > 100


@pytest.mark.slow
@pytest.mark.parametrize("buffer_samples", [128, 512])
def test_a_sequence_longer_than_the_buffer_is_streamed_and_applied_bit_for_bit(buffer_samples):
    rig = connected(device=dataclasses.replace(DRIFTING, buffer_samples=buffer_samples))
    rig.enable()
    values = rest_to_rest(3000)
    start_ns = load(rig, values)
    reports = rig.run(4.0)
    assert states(reports) == ["loading"] * 6 + ["ready", "running", "done"]
    applied = np.concatenate([b.accelerations for r in reports for b in r.applied])
    first = np.flatnonzero(applied == values[1])[0] - 1
    assert np.array_equal(applied[first : first + 3000], values)
    batch_starts = [b.stamp_ns for r in reports for b in r.applied]
    stamp = batch_starts[first // 20] + first % 20 * 1_000_000
    assert -100_000 < stamp - start_ns < 1_100_000
    assert reports[-1].status.counters["resent_samples"] == 0
    assert reports[-1].status.state == "enabled"


def test_lost_samples_are_sent_again():
    rig = connected()
    rig.enable()
    rng = random.Random(7)
    is_samples = frames_of(protocol.SAMPLES)
    rig.to_device = filtered(lambda f: not is_samples(f) or rng.random() > 0.2)
    values = rest_to_rest(2500)
    load(rig, values, 500_000_000)
    reports = rig.run(4.0)
    assert states(reports)[-1] == "done"
    assert reports[-1].status.counters["resent_samples"] > 0
    applied = np.concatenate([b.accelerations for r in reports for b in r.applied])
    first = np.flatnonzero(applied == values[1])[0] - 1
    assert np.array_equal(applied[first : first + 2500], values)


@pytest.mark.slow
@pytest.mark.parametrize(("late_ms", "is_resent"), [(40, False), (80, True)])
def test_samples_are_sent_again_when_none_was_acknowledged_for_60_ms_and_not_before(late_ms, is_resent):
    rig = connected()
    rig.enable()
    rig.to_host = late(protocol.STATUS, late_ms)
    sent = FrameDecoder()
    payloads = []
    rig.to_device = lambda data: payloads.extend(sent.feed(data)) or data
    values = rest_to_rest(2500)
    load(rig, values, 500_000_000)
    reports = rig.run(4.0)
    assert states(reports)[-1] == "done"
    samples = [len(m.values) for m in map(protocol.decode, payloads) if isinstance(m, protocol.Samples)]
    assert (sum(samples) > 2500) == is_resent
    assert reports[-1].status.counters["resent_samples"] == sum(samples) - 2500
    applied = np.concatenate([b.accelerations for r in reports for b in r.applied])
    first = np.flatnonzero(applied == values[1])[0] - 1
    assert np.array_equal(applied[first : first + 2500], values)


def test_samples_that_never_come_are_an_underrun():
    rig = connected()
    rig.enable()
    is_samples = frames_of(protocol.SAMPLES)
    sent = []
    rig.to_device = filtered(lambda f: not is_samples(f) or sent.append(f) or len(sent) <= 15)
    load(rig, rest_to_rest(2500))
    reports = rig.run(3.0)
    assert states(reports)[-2:] == ["running", "underrun"]
    assert "sample 750 of 2500" in [s for r in reports for s in r.sequences][-1].reason
    assert reports[-1].status.state == "homed"
    assert "underrun" in reports[-1].status.reason
    assert rig.firmware.axis.velocity == 0.0


def test_a_line_that_is_too_slow_for_the_samples_is_named_and_not_made_slower():
    rig = connected()
    rig.enable()
    slow, sent = UnrulyLine(40_000, 4096, 1), FrameDecoder()
    n_sent = 0

    def line(data: bytes) -> bytes:
        nonlocal n_sent
        payloads = [protocol.decode(payload) for payload in sent.feed(data)]
        n_sent += sum(len(m.values) for m in payloads if isinstance(m, protocol.Samples))
        slow.put(data, rig.steady_ns)
        return slow.take(rig.steady_ns)

    rig.to_device = line
    load(rig, rest_to_rest(3000), 500_000_000)
    reports = rig.until(lambda r: any(s.state == "underrun" for s in r.sequences), 6.0)
    reason = [s for r in reports for s in r.sequences][-1].reason
    # 4 kB/s: 416 bytes carry 50 samples.
    carried = float(re.search(r"the line carried (\d+) samples/s, expected more than 1000", reason)[1])
    assert carried == pytest.approx(480, rel=0.15)
    assert n_sent < 480 * 3
    assert slow.n_lost == 0


@pytest.mark.slow
def test_a_noisy_line_costs_frames_and_nothing_else():
    rig = connected()
    rig.enable()
    rng = random.Random(3)

    def noisy(data: bytes) -> bytes:
        if data and rng.random() < 0.05:
            data = bytearray(data)
            data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        if rng.random() < 0.02:
            data = bytes(data) + rng.randbytes(rng.randint(1, 40))
        return bytes(data)

    rig.to_device = rig.to_host = noisy
    values = rest_to_rest(3000)
    load(rig, values, 500_000_000)
    reports = rig.run(5.0)
    assert states(reports)[-2:] == ["running", "done"], reports[-1].status
    counters = reports[-1].status.counters
    assert counters["bad_frames"] > 10
    assert counters["lost_ticks"] % 20 == 0
    assert counters["lost_ticks"] > 0
    stamps = np.array([b.stamp_ns for r in reports for b in r.measured])
    gaps = np.diff(stamps)
    # What is lost is a gap of whole batches; nothing is filled in.
    assert np.all(np.abs(gaps - np.round(gaps / 20e6) * 20e6) < 50_000)
    assert np.sum(np.round(gaps / 20e6) - 1) * 20 <= counters["lost_ticks"]


@pytest.mark.parametrize("direction", ["to_device", "to_host"])
def test_a_lost_answer_or_question_is_repeated_and_done_once(direction):
    rig = connected()
    kinds = (protocol.REQUEST, protocol.REQUEST_REPLY)
    dropped = []

    def keep(frame: bytes) -> bool:
        is_dropped = FrameDecoder().feed(frame)[0][0] in kinds and len(dropped) < 3
        if is_dropped:
            dropped.append(frame)
        return not is_dropped

    setattr(rig, direction, filtered(keep))
    assert rig.ask("home").success
    assert len(dropped) == 3
    assert rig.ask("enable").message == "enabled"


def test_a_device_that_never_answers_a_request_fails_it_in_a_second():
    rig = connected()
    is_request = frames_of(protocol.REQUEST)
    rig.to_device = filtered(lambda f: not is_request(f))
    start = rig.steady_ns
    outcome = rig.ask("enable")
    assert not outcome.success
    assert "did not answer" in outcome.message
    assert 0.9 < (rig.steady_ns - start) * 1e-9 < 1.2


def test_a_dead_line_is_disconnected_and_everything_pending_fails():
    rig = connected(VELOCITY)
    rig.enable()
    load(rig, np.zeros(3000))
    rig.run(0.5)
    rig.to_host = rig.to_device = lambda data: b""
    request_id = rig.hub.request("clear_fault")
    reports = rig.run(0.8)
    assert reports[-1].status.state == "disconnected"
    assert states(reports) == ["aborted"]
    assert [(i, o.success) for r in reports for i, o in r.completed] == [(request_id, False)]
    assert rig.firmware.axis.state == "homed"
    assert "watchdog" in rig.firmware.axis.reason
    rig.hub.request("enable")
    assert "disconnected" in rig.run(0.01)[0].completed[0][1].message
    rig.to_host = rig.to_device = lambda data: data
    reports = rig.until(lambda r: r.status.state == "homed")
    rig.run(0.5)
    # The same boot: the map and the epoch go on.
    assert {b.epoch for r in rig.reports for b in r.measured} == {1}


def test_a_restarted_device_opens_a_new_epoch_with_later_stamps():
    rig = connected()
    rig.enable()
    load(rig, rest_to_rest(3000))
    rig.run(1.0)
    rig.start_device(2)
    reports = rig.run(2.0)
    assert "aborted" in states(reports)
    assert any("restarted" in e.text and e.level == "error" for r in reports for e in r.events)
    assert reports[-1].status.state == "identified"
    batches = [b for r in rig.reports for b in r.measured]
    assert [b.epoch for b in batches] == sorted(b.epoch for b in batches)
    assert {b.epoch for b in batches} == {1, 2}
    assert np.all(np.diff([b.stamp_ns for b in batches]) > 0)
    assert rig.ask("home").success


def test_a_new_host_finds_the_axis_stopped():
    rig = connected(VELOCITY)
    rig.enable()
    rig.hub.setpoint(rig.now.unix_ns, 0.1, rig.now)
    rig.run(0.1)
    assert rig.firmware.axis.velocity == pytest.approx(0.1)
    rig.firmware.exchange(protocol.encode(protocol.Hello()), rig.device_ns(rig.steady_ns))
    rig.run(0.1)
    assert rig.firmware.axis.velocity == 0.0
    assert rig.firmware.axis.state == "homed"


def test_a_frozen_executor_stops_the_axis_and_an_old_setpoint_is_not_sent_when_it_thaws():
    rig = connected(VELOCITY)
    rig.enable()
    rig.hub.setpoint(rig.now.unix_ns, 0.1, rig.now)
    rig.run(0.1)
    rig.is_polled = False
    rig.run(0.6)
    assert rig.firmware.axis.state == "homed"
    assert rig.firmware.axis.velocity == 0.0
    rig.hub.setpoint(rig.now.unix_ns, 0.1, rig.now)
    rig.is_polled = True
    reports = rig.run(1.0)
    assert reports[-1].status.state == "homed"
    assert rig.firmware.axis.velocity == 0.0


def test_a_request_that_waited_for_a_frozen_host_is_refused_and_a_stop_is_not():
    rig = LoopbackRig(PARAMETERS)
    rig.connect()
    assert rig.ask("home").success
    rig.is_polled = False
    rig.run(0.3)
    enable, stop = rig.hub.request("enable"), rig.hub.request("stop")
    rig.run(0.3)
    rig.is_polled = True
    completed = dict(rig.until(lambda r: stop in dict(r.completed))[-1].completed)
    completed |= {k: v for r in rig.reports[-20:] for k, v in r.completed}
    assert not completed[enable].success
    assert "ask again" in completed[enable].message
    assert completed[stop].success
    assert rig.firmware.axis.state == "homed"


def test_no_sequence_starts_on_a_map_that_is_not_known_well_enough():
    rig = LoopbackRig(PARAMETERS)
    is_clock = frames_of(protocol.CLOCK_QUERY)
    rig.to_device = filtered(lambda f: not is_clock(f))
    rig.until(lambda r: r.status.state != "disconnected")
    rig.enable()
    load(rig, rest_to_rest(400))
    assert states(rig.run(0.1)) == ["loading", "ready"]
    (report,) = [s for r in rig.run(0.3) for s in r.sequences]
    assert report.state == "refused"
    assert "standard deviation" in report.reason
    assert sum(len(r.measured) for r in rig.reports) == 0


@pytest.mark.slow
def test_a_sequence_waits_for_the_map_and_can_be_stopped_while_it_waits():
    rig = LoopbackRig(PARAMETERS)
    is_clock = frames_of(protocol.CLOCK_QUERY)
    rig.to_device = filtered(lambda f: not is_clock(f))
    rig.until(lambda r: r.status.state != "disconnected")
    rig.enable()
    load(rig, rest_to_rest(400), 2_000_000_000)
    rig.run(0.5)
    assert rig.ask("stop").success
    assert states(rig.reports)[-1] == "aborted"
    rig.enable()
    load(rig, rest_to_rest(400), 3_000_000_000, "second")
    rig.run(0.5)
    rig.to_device = lambda data: data
    assert states(rig.run(4.0)) == ["running", "done"]


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"period_ns": 2_000_000}, "period_ns is 2000000"),
        ({"command_mode": "velocity"}, "command mode is velocity"),
        ({"encoder_resolution": 1e-6}, "encoder resolution"),
        ({"max_acceleration": 5.0}, "lower hub.max_acceleration"),
    ],
)
def test_a_device_that_is_not_the_one_of_the_rig_file_is_not_used(change, word):
    rig = LoopbackRig(PARAMETERS, device_parameters=dataclasses.replace(PARAMETERS, **change))
    reports = rig.run(1.0)
    assert reports[-1].status.state == "disconnected"
    (event,) = [e for r in reports for e in r.events]
    assert event.level == "error"
    assert word in event.text


@pytest.mark.slow
def test_another_protocol_version_is_told_apart_from_silence(monkeypatch):
    rig = LoopbackRig(PARAMETERS)
    answer = protocol.encode(protocol.Identity(0, 3, 4, 99))
    rig.to_host = lambda data: answer if data else b""
    reports = rig.run(0.5)
    (event,) = [e for r in reports for e in r.events]
    assert "versions 3 to 4" in event.text
    rig = LoopbackRig(PARAMETERS)
    rig.to_host = lambda data: b""
    reports = rig.run(10.0)
    (event,) = [e for r in reports for e in r.events]
    assert "nobody answers" in event.text


def test_closing_stops_the_axis_without_polls():
    rig = connected(VELOCITY)
    rig.enable()
    rig.hub.setpoint(rig.now.unix_ns, 0.3, rig.now)
    rig.run(0.1)
    rig.is_polled = False
    rig.client.begin_close()
    rig.run(0.1)
    assert rig.client.is_closed
    assert rig.firmware.axis.velocity == 0.0
    assert rig.firmware.axis.state == "homed"


@pytest.mark.parametrize("mode", ["acceleration", "velocity", "position", "effort"])
def test_every_command_mode_moves_as_in_the_simulated_hub(mode):
    parameters = dataclasses.replace(PARAMETERS, command_mode=mode)
    k = np.arange(900)
    smooth = np.sin(np.pi * k / 899) ** 4
    values = {
        "acceleration": rest_to_rest(900),
        "velocity": 0.05 * smooth,
        "position": 0.01 * smooth,
        "effort": 0.8 * rest_to_rest(900),
    }[mode]
    if mode == "velocity":
        values[-1] = 0.0

    def path(rig):
        rig.enable()
        load(rig, values)
        reports = rig.until(lambda r: "done" in states([r])) + rig.run(0.1)
        assert reports[-1].status.state == "enabled"
        x = np.concatenate([b.positions for r in reports for b in r.measured])
        begin = np.flatnonzero(x)[0]
        return x[begin : begin + 880]

    real = path(connected(parameters))
    assert np.max(np.abs(real)) > 1e-3
    assert np.array_equal(real, path(SimulatedRig(parameters, device=DRIFTING)))


def test_a_position_setpoint_is_moved_to_and_held_over_the_line():
    rig = connected(dataclasses.replace(PARAMETERS, command_mode="position"))
    rig.enable()
    is_setpoint = frames_of(protocol.SETPOINT)
    came = []
    # The first copy is lost; of the repeated ones, only one is a new set-point.
    rig.to_device = filtered(lambda f: not is_setpoint(f) or came.append(f) or len(came) != 1)
    assert rig.hub.setpoint(rig.now.unix_ns, 0.02, rig.now).success
    rig.run(2.0)
    assert len(came) == 2
    assert rig.reports[-1].status.position == pytest.approx(0.02, abs=1e-7)
    assert rig.reports[-1].status.state == "enabled"


def test_the_last_words_are_said_while_the_link_is_up():
    rig = LoopbackRig(PARAMETERS)
    assert rig.client.goodbye() == b""
    rig.connect()
    assert rig.client.goodbye() == protocol.encode(protocol.Goodbye())


# Limits and the watchdog ------------------------------------------------------------------------------


def wide_device() -> AxisParameters:
    """A device that could do twenty times what the rig file allows."""
    return PARAMETERS.widened(20.0)


def test_a_device_that_could_do_more_obeys_the_rig_file():
    rig = connected(device_parameters=wide_device())
    rig.enable()
    assert rig.firmware.axis.parameters == PARAMETERS
    # 2 m/s^2 held: the device itself must stop short of its +-50 mm, whatever the host sends.
    for number in range(1, 201):
        rig.firmware.exchange(protocol.encode(protocol.Setpoint(number, 2.0)), rig.device_ns(rig.steady_ns))
        rig.run(0.01)
    assert rig.firmware.axis.state == "fault"
    assert rig.firmware.axis.fault.name == "travel_limit"
    assert 0.045 < abs(rig.firmware.axis.true_position) < 0.05 + 2e-5


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *[(name, value) for name in ("travel", "max_speed") for value in (math.nan, math.inf, 0.0, -1.0)],
        ("travel", 2.0),
        ("max_effort", 1e3),
        ("stop_deceleration", 1.0),
        ("watchdog_ns", 3_600_000_000),
        ("watchdog_ns", 0),
        ("max_speed", 0.25),
    ],
)
def test_a_device_that_will_obey_other_limits_is_never_connected(name, value):
    rig = LoopbackRig(PARAMETERS)
    wanted = protocol.DeviceLimits.of(PARAMETERS)
    answer = protocol.encode(protocol.LimitsReply(1, dataclasses.replace(wanted, **{name: value})))
    is_reply = frames_of(protocol.LIMITS_REPLY)
    rig.to_host = lambda data: b"".join(
        answer if is_reply(f + b"\0") else f + b"\0" for f in data.split(b"\0") if f
    )
    reports = rig.run(3.0)
    assert {r.status.state for r in reports} == {"disconnected"}
    assert reports[-1].status.fault.name == "limits_not_obeyed"
    (event,) = [e for r in reports for e in r.events]
    assert event.level == "error"
    assert name in event.text
    assert not rig.ask("enable").success


@pytest.mark.parametrize(
    "change",
    [
        *[
            {"widest": dataclasses.replace(protocol.DeviceLimits.of(PARAMETERS), travel=v)}
            for v in (math.nan, 0.0)
        ],
        {"widest": dataclasses.replace(protocol.DeviceLimits.of(PARAMETERS), watchdog_ns=0)},
        {"buffer_samples": 0},
        {"batch_ticks": 0},
    ],
)
def test_an_identity_that_no_axis_can_have_is_never_connected(change):
    rig = LoopbackRig(PARAMETERS)

    def lie(frame: bytes) -> bytes:
        payload = FrameDecoder().feed(frame)[0]
        if payload[0] != protocol.IDENTITY:
            return frame
        return protocol.encode(dataclasses.replace(protocol.decode(payload), **change))

    rig.to_host = lambda data: b"".join(lie(f + b"\0") for f in data.split(b"\0") if f)
    reports = rig.run(1.0)
    assert {r.status.state for r in reports} == {"disconnected"}
    (event,) = [e for r in reports for e in r.events]
    assert event.level == "error"


def test_a_device_without_limits_does_not_move():
    rig = LoopbackRig(PARAMETERS)
    firmware = rig.firmware
    firmware.exchange(protocol.encode(protocol.Hello()), rig.device_ns(rig.steady_ns))
    for number, kind in enumerate(("home", "enable"), start=1):
        answer = firmware.exchange(
            protocol.encode(protocol.Request(number, kind)), rig.device_ns(rig.steady_ns)
        )
        reply = protocol.decode(FrameDecoder().feed(answer)[0])
        assert (reply.phase, "set them first" in reply.text) == ("failure", True)


def test_the_watchdog_is_proved_at_rest_before_the_axis_takes_a_command():
    rig = LoopbackRig(PARAMETERS)
    said = []
    rig.to_device = lambda data: said.append(rig.steady_ns) or data if data else data
    rig.until(lambda r: r.status.state == "identified")
    assert max(np.diff(said)) * 1e-9 == pytest.approx(PARAMETERS.watchdog_s, abs=0.05)
    assert rig.firmware.axis.silences == 1
    assert rig.reports[-1].status.counters["watchdog_proved"] == 1


@pytest.mark.parametrize("watchdog_s", [0.4, 3.0])
def test_a_watchdog_that_acts_too_late_is_found_out(watchdog_s):
    # The device says 0.25 s, and keeps another time.
    rig = LoopbackRig(PARAMETERS)
    obey = rig.firmware.axis.obey
    rig.firmware.axis.obey = lambda p: obey(dataclasses.replace(p, watchdog_s=watchdog_s))
    true_limits = frames_of(protocol.LIMITS_REPLY)
    answer = protocol.encode(protocol.LimitsReply(1, protocol.DeviceLimits.of(PARAMETERS)))
    rig.to_host = lambda data: b"".join(
        answer if true_limits(f + b"\0") else f + b"\0" for f in data.split(b"\0") if f
    )
    reports = rig.run(4.0)
    assert {r.status.state for r in reports} == {"disconnected"}
    assert reports[-1].status.fault.name == "watchdog_unproved"
    (event,) = [e for r in reports for e in r.events]
    assert "prove_watchdog" in event.text


def test_without_the_proof_the_hub_says_what_it_cannot_promise():
    rig = LoopbackRig(PARAMETERS, link=LinkParameters(prove_watchdog=False))
    rig.connect()
    assert rig.firmware.axis.silences == 0
    assert rig.reports[-1].status.counters["watchdog_proved"] == 0
    (shortcoming,) = rig.hub.capabilities.shortcomings
    assert "watchdog" in shortcoming


@pytest.mark.slow
def test_an_answer_to_a_greeting_that_comes_late_does_not_end_the_session():
    rig = LoopbackRig(PARAMETERS)
    held: list[bytes] = []

    def late(data: bytes) -> bytes:
        # 0.45 s each way and nothing lost: three greetings are under way when the first answer comes.
        held.append(data)
        return held.pop(0) if len(held) > 450 else b""

    rig.to_host = late
    reports = rig.run(6.0)
    assert reports[-1].status.state == "identified"
    assert reports[-1].status.counters["connections"] == 1


def test_what_is_asked_while_the_connection_comes_up_is_done_when_it_is_up():
    rig = LoopbackRig(PARAMETERS)
    rig.run(0.1)
    assert rig.client._connection.state == "proof"
    assert rig.ask("home").success


@pytest.mark.parametrize("watchdog_s", [0.25, 1.2])
def test_samples_that_the_device_held_back_before_the_connection_was_up_are_not_lost(watchdog_s):
    rig = LoopbackRig(dataclasses.replace(PARAMETERS, watchdog_s=watchdog_s))
    # Answers come after 0.3 s: the host greets again, and the device begins its samples anew each time.
    late: list[tuple[int, bytes]] = []

    def wait(data: bytes) -> bytes:
        late.append((rig.steady_ns + 300_000_000, data))
        return b"".join(late.pop(0)[1] for _ in range(len([at for at, _ in late if at <= rig.steady_ns])))

    rig.to_host = wait
    rig.until(lambda r: r.status.state != "disconnected", 10.0)
    rig.until(lambda r: bool(r.measured), 10.0)
    counters = rig.reports[-1].status.counters
    assert counters["connections"] == 1
    assert counters["lost_ticks"] == counters["strange_ticks"] == 0


@pytest.mark.parametrize("watchdog_s", [1.5, 2.0, 4.0])
def test_a_device_that_held_its_samples_back_from_a_host_that_proves_its_watchdog_has_no_fault(watchdog_s):
    rig = LoopbackRig(dataclasses.replace(PARAMETERS, watchdog_s=watchdog_s))
    rig.until(lambda r: r.status.state != "disconnected", 10.0)
    rig.run(2.0)
    assert rig.reports[-1].status.state == "identified"
    assert "telemetry_stopped" not in {r.status.fault.name for r in rig.reports}


@pytest.mark.parametrize("wait_ms", [0, 5, 10, 15])
def test_a_sequence_of_positions_may_follow_at_once_after_homing(wait_ms):
    """What was applied on the way home counts from elsewhere."""
    parameters = dataclasses.replace(PARAMETERS, command_mode="position")
    rig = LoopbackRig(parameters, dataclasses.replace(DRIFTING, initial_position=0.02))
    rig.connect()
    rig.run(1e-3 * wait_ms)
    for kind in ("home", "enable"):
        assert rig.ask(kind).success
    values = 0.002 * np.sin(np.linspace(0.0, np.pi, 1001)) ** 2
    for chunk in chunks_of(values, rig.now.unix_ns + 300_000_000):
        rig.hub.load(chunk, rig.now)
    (report, *_) = reversed(rig.until(lambda r: any(own.state in ("done", "refused") for own in r.sequences)))
    assert report.sequences[-1].state == "done", report.sequences[-1].reason


@pytest.mark.parametrize("frozen_ms", [500, 900, 1500])
def test_a_host_that_is_frozen_while_it_waits_for_a_connection_takes_no_sample_for_strange(frozen_ms):
    rig = LoopbackRig(PARAMETERS)
    rig.connect()
    rig.client.line_lost(fault("port_lost"), "the cable was pulled")
    rig.run(0.5)
    rig.client.line_opened(rig.steady_ns)
    # The greeting leaves, and what answers it waits until the process goes on.
    answers = rig.firmware.exchange(rig.client.transmit(rig.steady_ns), rig.device_ns(rig.steady_ns))
    for _ in range(frozen_ms):
        rig.steady_ns += rig.STEP_NS
        answers += rig.firmware.exchange(b"", rig.device_ns(rig.steady_ns))
    rig.client.receive(answers, rig.steady_ns)
    rig.until(lambda r: r.status.state == "identified", 10.0)
    status = rig.run(1.0)[-1].status
    assert status.fault.name == "none", status.reason
    assert status.counters["strange_ticks"] == 0


@pytest.mark.parametrize("late_ms", [100, 300, 600])
def test_answers_that_were_late_while_a_connection_came_up_make_no_later_sample_strange(late_ms):
    """A computer with too much to do: the map of the clock can be wrong by half of what the answers took."""
    rig = LoopbackRig(PARAMETERS)
    late: list[tuple[int, bytes]] = []

    def wait(data: bytes) -> bytes:
        late.append((rig.steady_ns + late_ms * 1_000_000, data))
        return b"".join(late.pop(0)[1] for _ in range(len([at for at, _ in late if at <= rig.steady_ns])))

    rig.to_host = wait
    rig.until(lambda r: "clock_sd_ns" in r.status.counters, 10.0)
    rig.to_host = lambda data: b"".join(late.pop(0)[1] for _ in range(len(late))) + data
    rig.until(lambda r: r.status.state == "identified", 10.0)
    status = rig.run(2.0)[-1].status
    assert status.fault.name == "none", status.reason
    assert status.counters["strange_ticks"] == 0
