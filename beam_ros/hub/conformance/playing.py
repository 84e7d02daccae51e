"""Sequences as the checks send them: by the device's credit, and told back tick by tick."""

from __future__ import annotations

from dataclasses import dataclass

from beam_ros.arrays import FloatArray
from beam_ros.hub.conformance.check import require
from beam_ros.hub.conformance.dialogue import ANSWER_S, Dialogue, only
from beam_ros.hub.line import protocol

AHEAD_S = 0.25
"""How long before its start a sequence is armed [s]."""
TURN_S = 0.01
STUCK_S = 0.06
"""After this time without progress the host starts again from what was received [s]."""


@dataclass(frozen=True)
class Played:
    """A sequence that was sent.

    Parameters
    ----------
    number : int
        The sequence's.
    start_tick : int
        The tick of its first sample.
    """

    number: int
    start_tick: int


def arm(
    host: Dialogue,
    n_samples: int,
    start_tick: int | None = None,
    number: int | None = None,
    *,
    is_on_tick: bool = False,
) -> protocol.ArmReply:
    """Announce a sequence, and return the answer; ``is_on_tick``: for the tick's own time, not one before it."""
    identity = host.identity
    number = host.next_number() if number is None else number
    if start_tick is None:
        start_tick = start_in(host, AHEAD_S)
    # The first tick at or after the start is the sequence's.
    early_ns = 0 if is_on_tick else identity.period_ns // 3
    start_ns = max(start_tick * identity.period_ns - early_ns, 0)
    host.say(protocol.Arm(number, start_ns, n_samples))
    return host.until(only(protocol.ArmReply, number=number), "ArmReply")


def begin(
    host: Dialogue, n_samples: int, start_tick: int | None = None, *, is_on_tick: bool = False
) -> Played:
    """Announce a sequence that must be accepted; by default for a quarter of a second from now."""
    start_tick = start_in(host, AHEAD_S) if start_tick is None else start_tick
    number = host.next_number()
    answer = arm(host, n_samples, start_tick, number, is_on_tick=is_on_tick)
    require(answer.is_accepted, f"a sequence was refused: {answer.text!r}")
    return Played(number, start_tick)


def send(host: Dialogue, number: int, values: FloatArray) -> None:
    """Send the first samples of a sequence in one go, whatever the device has room for."""
    for first in range(0, len(values), protocol.MAX_SAMPLES):
        host.say(protocol.Samples(number, first, values[first : first + protocol.MAX_SAMPLES]))


def start_in(host: Dialogue, seconds: float) -> int:
    """Return the tick that begins in some seconds."""
    return host.fresh_status().tick + round(seconds / host.period_s())


def play(host: Dialogue, values: FloatArray, *, until_tick: int | None = None) -> Played:
    """Send a sequence by the device's credit, and wait until it is done, or has come to a tick of its own."""
    played = begin(host, len(values))
    stream(host, played.number, values, played.start_tick + (until_tick or 0), until_tick is None)
    return played


def stream(host: Dialogue, number: int, values: FloatArray, end_tick: int, to_end: bool) -> None:
    """Send what the device has room for until the sequence has ended, or a tick has come."""
    sent, known, stuck_s = 0, 0, 0.0
    patience_s = 2 * ANSWER_S + AHEAD_S + len(values) * host.period_s()
    while patience_s > 0:
        status = host.newest_status()
        is_ours = status.sequence_number == number
        if is_ours and status.sequence_state not in ("armed", "running"):
            return
        if not to_end and status.tick >= end_tick:
            return
        if is_ours:
            stuck_s = stuck_s + TURN_S if status.received == known else 0.0
            known = status.received
            if stuck_s > STUCK_S:
                sent, stuck_s = known, 0.0
            room_to = min(known + status.free, len(values))
            while sent < room_to:
                part = values[sent : min(sent + protocol.MAX_SAMPLES, room_to)]
                host.say(protocol.Samples(number, sent, part))
                sent += len(part)
        host.listen(TURN_S)
        patience_s -= TURN_S
    require(False, f"the sequence is {host.newest_status().sequence_state} although its time has passed")
