"""The line itself: noise, frames that are wrong, long or in pieces; the clock and the telemetry."""

from __future__ import annotations

import random

import numpy as np

from beam_ros.hub.conformance.check import Check, require
from beam_ros.hub.conformance.dialogue import ANSWER_S, Dialogue
from beam_ros.hub.line import protocol
from beam_ros.hub.line.framing import MAX_PAYLOAD, cobs_encode, encode_frame

CLOCK_PPM = 1000
"""Beyond this a device's second is no second; 100 ppm are usual."""
LATE_NS = 20_000_000
"""By how much a device may be behind its own ticks [ns]."""


def _answers(host: Dialogue, after: str) -> None:
    host.clock(f"ClockReply after {after}")


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


def _odd_bodies(host: Dialogue) -> None:
    host.prepare()
    in_force = host.set_limits(host.limits)
    for message in (
        protocol.SetLimits(host.next_number(), host.limits),
        protocol.ClockQuery(host.next_number()),
        protocol.Request(host.next_number(), "clear_fault"),
        protocol.Arm(host.next_number(), 0, 10),
    ):
        payload = protocol.encode_payload(message)
        host.say_bytes(encode_frame(payload[:-1]) + encode_frame(payload + b"\1"))
    host.say_bytes(encode_frame(b"\x04\1\0\5") + encode_frame(b"\x06" * 8) + encode_frame(b"\x07" + bytes(6)))
    for kind in (0x00, 0x0A, 0x7F, 0x82, 0x86, 0xFF):
        host.say_bytes(encode_frame(bytes((kind, 1, 2, 3))))
    came = host.listen(0.1)
    answers = [m for m in came if not isinstance(m, (protocol.Telemetry, protocol.Status))]
    require(not answers, f"it answers {answers[0] if answers else ''} to frames that fit no type")
    require(host.set_limits(host.limits) == in_force, "frames that fit no type changed the limits")


def _long_frames(host: Dialogue) -> None:
    host.prepare()
    host.say_bytes(encode_frame(b"\x7f" * MAX_PAYLOAD))
    _answers(host, "a frame of the greatest length")
    host.say_bytes(b"\0" + b"\x55" * (3 * MAX_PAYLOAD) + b"\0")
    _answers(host, "a frame that is too long")
    number = host.next_number()
    host.say(protocol.Samples(number, 0, np.zeros(protocol.MAX_SAMPLES)))
    host.until(lambda m: m if isinstance(m, protocol.Status) else None, "Status after 100 samples")


def _pieces(host: Dialogue) -> None:
    host.prepare()
    number, mark = host.next_number(), host.mark()
    for byte in protocol.encode(protocol.ClockQuery(number)):
        host.say_bytes(bytes((byte,)))
        host.listen(0.002, alive=False)
    host.until(
        lambda m: m if isinstance(m, protocol.ClockReply) and m.number == number else None,
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


def _silent_frames(host: Dialogue) -> None:
    """Frames that are not valid must not keep an axis alive."""
    host.prepare()
    before = host.fresh_status()
    watchdog_s = host.limits.watchdog_ns * 1e-9
    wrong = bytearray(protocol.encode(protocol.Heartbeat()))
    wrong[-2] ^= 1
    for _ in range(round((watchdog_s + 0.1) / 0.02)):
        host.say_bytes(bytes(wrong) + b"\0" + cobs_encode(b"junk") + b"\0")
        host.listen(0.02, alive=False)
    after = host.fresh_status()
    require(after.silences > before.silences, "frames that are not valid fed the watchdog")


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


def _telemetry_ends(host: Dialogue) -> None:
    host.prepare()
    host.say(protocol.Heartbeat())
    host.listen(1.0, alive=False)
    host.listen(0.2, alive=False)
    came = host.listen(0.5, alive=False)
    pushed = sum(isinstance(m, protocol.Telemetry) for m in came)
    require(pushed == 0, f"{pushed} Telemetry after more than a second of silence: expected none")
    host.say(protocol.Heartbeat())
    host.until(
        lambda m: m if isinstance(m, protocol.Telemetry) else None,
        "Telemetry after the silence",
        2 * ANSWER_S,
    )


CHECKS = (
    Check("noise", "goes on after noise, which changes nothing", _noise),
    Check("flipped_bits", "answers no frame with a wrong bit", _flipped_bits),
    Check("odd_bodies", "drops frames of unknown types, and with bodies that do not fit", _odd_bodies),
    Check("long_frames", "takes 2048 bytes, drops more, and goes on", _long_frames),
    Check("pieces", "takes frames byte by byte, and several in one piece", _pieces),
    Check("watchdog_not_fed", "counts a silence although frames come that are not valid", _silent_frames),
    Check("clock", "answers ClockQuery with a clock that never goes back", _clock),
    Check("clock_rate", "has seconds that are seconds", _clock_rate),
    Check("clock_and_ticks", "begins tick k at k periods by its own clock", _clock_and_ticks),
    Check("telemetry", "sends every tick once, in batches, each with a Status", _telemetry),
    Check("telemetry_ends", "pushes nothing when the host has been silent for a second", _telemetry_ends),
)
