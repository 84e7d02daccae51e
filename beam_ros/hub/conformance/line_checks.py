"""The line itself: noise, frames that are wrong, long or in pieces; the clock and the telemetry."""

from __future__ import annotations

import random
from dataclasses import replace

import numpy as np

from beam_ros.hub.conformance.check import check, require
from beam_ros.hub.conformance.dialogue import ANSWER_S, Dialogue, only
from beam_ros.hub.conformance.misfits import misfits, valid_frames
from beam_ros.hub.line import protocol
from beam_ros.hub.line.framing import MAX_PAYLOAD, encode_frame

CLOCK_PPM = 1000
"""Beyond this a device's second is no second; 100 ppm are usual."""
SAID_S = 0.02
"""How often a frame is said again where nothing else is said [s]."""
LATE_NS = 20_000_000
"""By how much a device may be behind its own ticks [ns]."""


def _answers(host: Dialogue, after: str) -> None:
    host.clock(f"ClockReply after {after}")


@check("goes on after noise, which changes nothing")
def _noise(host: Dialogue) -> None:
    host.prepare()
    before = host.fresh_status()
    noise = random.Random(1)
    for _ in range(10):
        host.say_bytes(noise.randbytes(400))
        host.listen(0.02)
    _answers(host, "noise")
    after = host.fresh_status()
    require(after.state == before.state, f"noise made the axis {after.state}")


@check("answers no frame with a wrong bit")
def _flipped_bits(host: Dialogue) -> None:
    host.prepare()
    good = protocol.encode(protocol.Request(host.next_number(), "clear_fault"))
    flips = range(8, 8 * (len(good) - 1))
    for bit in flips:
        data = bytearray(good)
        data[bit // 8] ^= 1 << bit % 8
        host.say_bytes(bytes(data))
    came = host.listen(0.2)
    answers = sum(isinstance(m, protocol.RequestReply) for m in came)
    require(answers == 0, f"{answers} of {len(flips)} frames with one wrong bit were answered")
    _answers(host, "frames with wrong bits")


@check("drops frames of unknown types, and with bodies that do not fit")
def _odd_bodies(host: Dialogue) -> None:
    host.prepare()
    before = host.fresh_status()
    in_force = host.set_limits(host.limits)
    for name, frame in misfits(replace(host.limits, travel=host.limits.travel / 2)).items():
        mark = host.mark()
        host.say_bytes(frame)
        _answers(host, name)
        answers = [
            m
            for m in host.since(mark)
            if not isinstance(m, (protocol.Telemetry, protocol.Status, protocol.ClockReply))
        ]
        require(not answers, f"it answers {answers[0] if answers else ''} to {name}")
    require(host.set_limits(host.limits) == in_force, "frames that fit no type changed the limits")
    after = host.fresh_status()
    for field in ("state", "setpoint_number", "setpoints_refused", "sequence_number"):
        require(
            getattr(after, field) == getattr(before, field),
            f"frames that fit no type changed {field} in Status",
        )


@check("takes 2048 bytes, drops more, and goes on")
def _long_frames(host: Dialogue) -> None:
    host.prepare()
    host.say_bytes(encode_frame(b"\x7f" * MAX_PAYLOAD))
    _answers(host, "a frame of the greatest length")
    host.say_bytes(b"\0" + b"\x55" * (3 * MAX_PAYLOAD) + b"\0")
    _answers(host, "a frame that is too long")
    number = host.next_number()
    host.say(protocol.Samples(number, 0, np.zeros(protocol.MAX_SAMPLES)))
    host.until(only(protocol.Status), "Status after 100 samples")


@check("takes frames byte by byte, and several in one piece")
def _pieces(host: Dialogue) -> None:
    host.prepare()
    number, mark = host.next_number(), host.mark()
    for byte in protocol.encode(protocol.ClockQuery(number)):
        host.say_bytes(bytes((byte,)))
        host.listen(0.002, alive=False)
    host.until(
        only(protocol.ClockReply, number=number),
        "ClockReply to a frame that came byte by byte",
        since=mark,
    )
    numbers = [host.next_number() for _ in range(5)]
    # One zero byte between two frames is enough.
    frames = [protocol.encode(protocol.ClockQuery(k))[1:] for k in numbers]
    host.say_bytes(b"\0" + b"".join(frames))
    found: set[int] = set()

    def all_answered(message: protocol.Message) -> bool | None:
        if isinstance(message, protocol.ClockReply):
            found.add(message.number)
        return True if found >= set(numbers) else None

    host.until(all_answered, "ClockReply to each of five frames in one piece")


@check("counts a silence although frames come that do not fit, in every way")
def _watchdog_not_fed(host: Dialogue) -> None:
    """Frames that are not valid must not keep an axis alive, whatever is wrong with them."""
    host.prepare()
    for name, frame in misfits(host.limits).items():
        before = host.fresh_status()
        for _ in range(round((host.limits.watchdog_ns * 1e-9 + 0.1) / SAID_S)):
            host.say_bytes(frame)
            host.listen(SAID_S, alive=False)
        silences = host.newest_status().silences
        require(silences == (before.silences + 1) & 0xFFFF, f"{name} fed the watchdog")


@check("counts no silence while valid frames of any one type come")
def _watchdog_fed(host: Dialogue) -> None:
    host.prepare()
    number = host.next_number()
    for name, frame in valid_frames(host.limits, number).items():
        before = host.fresh_status()
        for _ in range(round(2e-9 * host.limits.watchdog_ns / SAID_S)):
            host.say_bytes(frame)
            host.listen(SAID_S, alive=False)
        require(host.newest_status().silences == before.silences, f"{name} did not feed the watchdog")


@check("answers ClockQuery with a clock that never goes back")
def _clock(host: Dialogue) -> None:
    host.prepare()
    readings = []
    for _ in range(40):
        reply = host.clock().reply
        require(
            reply.sent_ns >= reply.received_ns, "a reply left before its query came, by the device's clock"
        )
        readings += [reply.received_ns, reply.sent_ns]
        host.listen(0.02)
    require(readings == sorted(readings), "the device's clock ran backwards")


@check("has seconds that are seconds")
def _clock_rate(host: Dialogue) -> None:
    """The middle of an exchange is known to half its duration, at both ends of a second."""
    host.prepare()
    ends = []
    for _ in range(2):
        ends.append(min((host.clock() for _ in range(10)), key=lambda exchange: exchange.trip_ns))
        host.listen(1.0)
    first, last = ends
    elapsed_ns = last.host_ns - first.host_ns
    device_ns = last.reply.received_ns - first.reply.received_ns
    allowed_ns = CLOCK_PPM * 1e-6 * elapsed_ns + (first.trip_ns + last.trip_ns) / 2
    require(
        abs(device_ns - elapsed_ns) <= allowed_ns,
        f"{device_ns * 1e-9:.6f} s of the device in {elapsed_ns * 1e-9:.6f} s: expected the same to {CLOCK_PPM} ppm",
    )


@check("begins tick k at k periods by its own clock")
def _clock_and_ticks(host: Dialogue) -> None:
    identity = host.prepare()
    for _ in range(10):
        before_ns = host.clock().reply.received_ns
        status = host.fresh_status()
        after_ns = host.clock().reply.received_ns
        require(
            before_ns - LATE_NS <= status.tick * identity.period_ns <= after_ns + identity.period_ns,
            f"tick {status.tick} comes next when the clock reads {before_ns} to {after_ns} ns: expected "
            f"tick k at {identity.period_ns} k ns",
        )
        host.listen(0.013)


@check("sends every tick once, in batches, each with a Status")
def _telemetry(host: Dialogue) -> None:
    identity = host.prepare()
    first = host.fresh_status().tick
    n = round(1.0 / host.period_s())
    batch = host.ticks(first, n)
    require(len(batch) == n, f"{len(batch)} ticks of {n}")
    require(bool(np.isfinite(batch.applied).all()), "applied is not finite")
    statuses = sum(isinstance(m, protocol.Status) for m in host.listen(0.3))
    expected = int(0.3 / (identity.batch_ticks * host.period_s())) - 1
    require(statuses >= expected, f"{statuses} Status in 0.3 s: expected one with each of {expected} batches")


@check("pushes until the host has been silent for a second, and no longer")
def _telemetry_ends(host: Dialogue) -> None:
    host.prepare()
    host.say(protocol.Heartbeat())
    host.listen(0.8, alive=False)
    came = host.listen(0.15, alive=False)
    pushed = sum(isinstance(m, protocol.Telemetry) for m in came)
    require(pushed > 0, "no Telemetry 0.8 s after the host was heard: expected it for a second")
    host.listen(0.25, alive=False)
    came = host.listen(0.5, alive=False)
    pushed = sum(isinstance(m, protocol.Telemetry) for m in came)
    require(pushed == 0, f"{pushed} Telemetry after more than a second of silence: expected none")
    host.say(protocol.Heartbeat())
    host.until(
        only(protocol.Telemetry),
        "Telemetry after the silence",
        2 * ANSWER_S,
    )
