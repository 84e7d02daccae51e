"""The client against the emulated firmware over a line in virtual time: every accident, quickly."""

from __future__ import annotations

import dataclasses
import random

import numpy as np
import pytest

from beam_ros.hub.line import protocol
from beam_ros.hub.line.framing import FrameDecoder
from beam_ros.hub.parameters import AxisParameters
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
    assert "underrun" in reports[-1].status.fault
    assert rig.firmware.axis.velocity == 0.0


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


def test_another_protocol_version_is_told_apart_from_silence(monkeypatch):
    rig = LoopbackRig(PARAMETERS)
    answer = protocol.encode(protocol.Identity(0, 2, 4, 99))
    rig.to_host = lambda data: answer if data else b""
    reports = rig.run(0.5)
    (event,) = [e for r in reports for e in r.events]
    assert "versions 2 to 4" in event.text
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
