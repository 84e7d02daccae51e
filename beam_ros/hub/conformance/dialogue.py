"""A host that talks with one device step by step, as the checks need it.

It speaks the codec and nothing else: no repetition, no repair, no clock map. So what a device does wrong is seen and
not made good. Whatever comes is also held against what must be true at all times (``Dialogue.oddities``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol, TypeVar

import numpy as np

from beam_ros.hub.contract import RequestKind
from beam_ros.hub.errors import ConformanceError, HubProtocolError
from beam_ros.hub.faults import DEVICE_FAULTS, FIRST_FREE_FAULT, FIRST_HOST_FAULT
from beam_ros.hub.line import protocol
from beam_ros.hub.line.framing import FrameDecoder
from beam_ros.hub.ticks import TickBatch

HEARTBEAT_NS = 30_000_000
ANSWER_S = 0.5
"""Patience for an answer that the device gives at once [s]; a busy host takes longer than a device."""
MOVE_S = 30.0
"""Patience for what takes a move: homing from the end of a long axis [s]."""
WATCHDOG_NS = 200_000_000
"""The silence that the checks ask the device to notice, where it can."""
SAME = 1e-6
"""Limits may differ by this share: a device may calculate with single precision."""
STOP_RATE = 10.0
"""Deceleration of the stop ramp that the checks ask for [travel/s^2]: from the speeds of their motions, at most 0.4
travels a second, a ramp then lasts some tens of milliseconds, and takes at most 0.8 % of the travel."""

_NUMBERS = {0, *(fault.number for fault in DEVICE_FAULTS)}
_ONE_SAMPLE = np.zeros(1)
_Answer = TypeVar("_Answer")


class DeviceLine(Protocol):
    """Bytes to and from a device, and the time that passes meanwhile."""

    def send(self, data: bytes) -> None:
        """Send bytes."""

    def receive(self, timeout_s: float) -> bytes:
        """Wait for bytes for a while; return those that are there."""

    def now_ns(self) -> int:
        """Return the steady time [ns]."""


class Bench(Protocol):
    """Hands on an axis that is not there: its sensors can be interfered with, and where its hub is, is known."""

    @property
    def true_position(self) -> float:
        """Where the hub is, seen from its home [m]."""

    @property
    def max_following_error(self) -> float:
        """How far the hub may be from its reference before the device stops it [m]."""

    def hold_signals(self, **signals: bool) -> None:
        """Let signals (fields of the plant port's ``Reading``) be on or off, and all others what is true."""

    def lie(self, offset: float, scale: float) -> None:
        """Let the encoder read ``scale`` times the position, and ``offset`` more [m]."""

    def stick(self, *, is_stuck: bool) -> None:
        """Let the hub stand still whatever is commanded, or move again."""


@dataclass(frozen=True)
class ClockExchange:
    """A device's answer to what its clock reads, with the middle of the exchange and its duration [ns]."""

    reply: protocol.ClockReply
    host_ns: int
    trip_ns: int


class Dialogue:
    """One host on one line.

    Parameters
    ----------
    line : DeviceLine
        To the device.
    bench : Bench, optional
        The axis behind the device, where it is not a real one.

    Attributes
    ----------
    status : Status or None
        The newest.
    limits : DeviceLimits
        What the checks ask the device to obey: the widest, with a watchdog that does not take long, and a stop
        ramp that lasts long enough to be measured.
    oddities : dict of str to str
        What was seen that must never be: by the name of the check, in words.
    """

    def __init__(self, line: DeviceLine, bench: Bench | None = None) -> None:
        self._bench = bench
        self._identity: protocol.Identity | None = None
        self.status: protocol.Status | None = None
        self.limits = protocol.DeviceLimits()
        self.oddities: dict[str, str] = {}
        self._line = line
        self._decoder = FrameDecoder()
        self._inbox: list[protocol.Message] = []
        self._batches: list[TickBatch] = []
        self._beat_ns = 0
        self._number = 0
        self._may_enable = False

    @property
    def identity(self) -> protocol.Identity:
        """What the device said last that it is."""
        if self._identity is None:
            raise ConformanceError("no Identity has come")
        return self._identity

    @property
    def bench(self) -> Bench:
        """The axis, for checks that need one which is not real."""
        assert self._bench is not None
        return self._bench

    # Talking ------------------------------------------------------------------------------------------

    def say(self, *messages: protocol.Message) -> None:
        """Send messages, in one go."""
        for message in messages:
            if isinstance(message, protocol.Request) and message.kind == "enable":
                self._may_enable = True
        self.say_bytes(b"".join(map(protocol.encode, messages)))

    def say_bytes(self, data: bytes) -> None:
        """Send any bytes."""
        self._line.send(data)
        self._beat_ns = self._line.now_ns()

    def listen(self, seconds: float, *, alive: bool = True) -> list[protocol.Message]:
        """Return all that comes within a time; ``alive``: a heartbeat is sent every 30 ms."""
        end_ns = self._line.now_ns() + round(seconds * 1e9)
        first = len(self._inbox)
        while self._line.now_ns() < end_ns:
            self._wait(end_ns, alive=alive)
        return self._inbox[first:]

    def mark(self) -> int:
        """Return a place in the stream of messages: what comes now comes after it."""
        return len(self._inbox)

    def since(self, mark: int) -> list[protocol.Message]:
        """Return what came after a mark."""
        return self._inbox[mark:]

    def until(
        self,
        pick: Callable[[protocol.Message], _Answer | None],
        what: str,
        seconds: float = ANSWER_S,
        *,
        alive: bool = True,
        since: int | None = None,
    ) -> _Answer:
        """Wait for a message that ``pick`` makes something of, among those after ``since``, a ``mark``.

        Raises
        ------
        ConformanceError
            It does not come in time; ``what`` says what it is.
        """
        end_ns = self._line.now_ns() + round(seconds * 1e9)
        seen = self.mark() if since is None else since
        while True:
            for message in self._inbox[seen:]:
                found = pick(message)
                if found is not None:
                    return found
            seen = len(self._inbox)
            if self._line.now_ns() >= end_ns:
                raise ConformanceError(f"{what} did not come within {seconds:g} s{self._standing()}")
            self._wait(end_ns, alive=alive)

    def next_number(self) -> int:
        """Return a number that no request, set-point or sequence has had."""
        self._number = self._number % 65535 + 1
        return self._number

    # What everybody needs -----------------------------------------------------------------------------

    def open_session(self) -> protocol.Identity:
        """Greet the device, and return what it says it is."""
        self.say(protocol.Hello())
        identity = self.until(only(protocol.Identity), "Identity")
        if identity.version != protocol.VERSION:
            raise ConformanceError(
                f"Identity names version {identity.version} for this connection: expected {protocol.VERSION}"
            )
        self.until(only(protocol.Status), "Status after Identity")
        widest = identity.widest
        self.limits = replace(
            widest,
            watchdog_ns=min(widest.watchdog_ns, WATCHDOG_NS),
            stop_deceleration=min(widest.stop_deceleration, STOP_RATE * widest.travel),
        )
        return identity

    def leave(self) -> None:
        """Leave the axis stopped, and end the session."""
        self.say(protocol.Request(self.next_number(), "disable"), protocol.Goodbye())

    def set_limits(self, limits: protocol.DeviceLimits) -> protocol.DeviceLimits:
        """Hand limits over, and return what the device answers."""
        number = self.next_number()
        self.say(protocol.SetLimits(number, limits))
        return self.until(only(protocol.LimitsReply, number=number), "LimitsReply").limits

    def obey(self, limits: protocol.DeviceLimits) -> None:
        """Hand limits over that the device must take."""
        answer = self.set_limits(limits)
        for name, wanted in vars(limits).items():
            obeyed = getattr(answer, name)
            if not abs(obeyed - wanted) <= SAME * wanted:
                raise ConformanceError(
                    f"{name} {obeyed:g} in LimitsReply: expected {wanted:g}{self._standing()}"
                )

    def ask(self, kind: RequestKind, number: int | None = None) -> protocol.RequestReply:
        """Make a request, and return how it ended."""
        number = self.next_number() if number is None else number
        self.say(protocol.Request(number, kind))
        return self.until(end_of(number), f"the end of the request {kind}", MOVE_S)

    def must(self, kind: RequestKind) -> None:
        """Make a request that must succeed."""
        reply = self.ask(kind)
        if reply.phase != "success":
            raise ConformanceError(f"the request {kind} failed: {reply.text!r}{self._standing()}")

    def prepare(self) -> protocol.Identity:
        """Open a session with an axis that rests and has limits; nothing moves but what moved before."""
        identity = self.open_session()
        self.wait_for_rest()
        self.obey(self.limits)
        if self.newest_status().state == "fault":
            self.must("clear_fault")
        return identity

    def go_home(self, within: float = 0.0) -> protocol.Identity:
        """Open a session with a homed axis, closer to home than a part of the travel."""
        identity = self.prepare()
        if self.newest_status().state == "identified" or abs(self.position()) > within * self.limits.travel:
            self.must("home")
        return identity

    def enable(self, within: float = 0.02) -> protocol.Identity:
        """Open a session with an enabled axis, closer to home than a part of the travel."""
        identity = self.go_home(within)
        self.must("enable")
        return identity

    def wait_for_rest(
        self, *, alive: bool = True, seconds: float | None = None, since: int | None = None
    ) -> protocol.Status:
        """Wait until the axis rests and is disabled; by default as long as its ramp and its watchdog may take.

        What came after ``since``, a ``mark``, counts; by default the newest status.
        """
        if since is None and self.status is not None and is_at_rest(self.status):
            return self.status
        if seconds is None:
            ramp_s = self.limits.max_speed / max(self.limits.stop_deceleration, 1e-9)
            seconds = min(ramp_s + 2e-9 * self.limits.watchdog_ns + 4 * ANSWER_S, MOVE_S)
        return self.until(
            lambda m: m if isinstance(m, protocol.Status) and is_at_rest(m) else None,
            "a Status with the axis at rest and disabled",
            seconds,
            alive=alive,
            since=since,
        )

    def newest_status(self) -> protocol.Status:
        """Return the newest status, which there must be."""
        if self.status is None:
            raise ConformanceError("no Status has come")
        return self.status

    def fresh_status(self) -> protocol.Status:
        """Ask for a status: one follows every ``Samples``, also those that belong to nothing.

        What was said before has been done when the device's clock has been answered.
        """
        self.clock()
        self.say(protocol.Samples(0, 0xFFFFFFFF, _ONE_SAMPLE))
        return self.until(only(protocol.Status), "Status after Samples")

    def clock(self, what: str = "ClockReply") -> ClockExchange:
        """Ask for the device's clock; ``what`` says what does not come."""
        number = self.next_number()
        begin_ns = self._line.now_ns()
        self.say(protocol.ClockQuery(number))
        reply = self.until(only(protocol.ClockReply, number=number), what)
        end_ns = self._line.now_ns()
        return ClockExchange(reply, (begin_ns + end_ns) // 2, end_ns - begin_ns)

    def position(self) -> float:
        """Return where the hub was by the newest status [m]."""
        return self.newest_status().position_count * self.identity.encoder_resolution

    def period_s(self) -> float:
        """Return the device's tick [s]."""
        return self.identity.period_ns * 1e-9

    def ticks(self, first: int, n: int, *, alive: bool = True) -> TickBatch:
        """Return ``n`` ticks of telemetry from ``first`` on; waits for them."""

        def there(_message: protocol.Message) -> TickBatch | None:
            return self._stretch(first, n)

        found = self._stretch(first, n)
        if found is not None:
            return found
        seconds = max(first + n - self.newest_status().tick, 0) * self.period_s() + 2 * ANSWER_S
        return self.until(there, f"Telemetry of the ticks {first} to {first + n - 1}", seconds, alive=alive)

    # Inside -------------------------------------------------------------------------------------------

    def _wait(self, end_ns: int, *, alive: bool) -> None:
        now_ns = self._line.now_ns()
        wait_ns = end_ns - now_ns
        if alive:
            if now_ns - self._beat_ns >= HEARTBEAT_NS:
                self.say(protocol.Heartbeat())
            wait_ns = min(wait_ns, self._beat_ns + HEARTBEAT_NS - now_ns)
        for payload in self._decoder.feed(self._line.receive(max(wait_ns, 0) * 1e-9)):
            try:
                self._take(protocol.decode(payload))
            except HubProtocolError as err:
                self.oddities.setdefault("layouts", str(err))

    def _take(self, message: protocol.Message) -> None:
        self._inbox.append(message)
        if isinstance(message, protocol.Identity):
            self._note_identity(message)
        elif isinstance(message, protocol.Status):
            self._note_status(message)
        elif isinstance(message, protocol.Telemetry):
            self._note_batch(message.ticks)

    def _note_identity(self, identity: protocol.Identity) -> None:
        if self._identity is not None and identity.boot_id != self._identity.boot_id:
            self.oddities.setdefault(
                "no_restart", f"the boot id changed from {self._identity.boot_id} to {identity.boot_id}"
            )
        if identity.version:
            self._identity = identity

    def _note_status(self, status: protocol.Status) -> None:
        before, self.status = self.status, status
        if status.state == "enabled" and not self._may_enable and status.activity != "stopping":
            self.oddities.setdefault("never_by_itself", f"enabled ({status.activity}) without being asked")
        if before is not None and before.state == "enabled" and status.state != "enabled":
            self._may_enable = False
        if before is not None and status.tick < before.tick:
            self.oddities.setdefault("ticks_forward", f"tick {status.tick} came after {before.tick}")
        number = status.fault_number
        if number not in _NUMBERS and not FIRST_FREE_FAULT <= number < FIRST_HOST_FAULT:
            self.oddities.setdefault(
                "fault_numbers",
                f"fault {number}: expected a device's of docs/hub-faults.md, or one from 32 to 63",
            )

    def _note_batch(self, batch: TickBatch) -> None:
        if self._identity is not None and len(batch) != self._identity.batch_ticks:
            self.oddities.setdefault(
                "batches",
                f"a batch of {len(batch)} ticks: expected {self._identity.batch_ticks} as Identity says",
            )
        if self._batches and batch.first_tick < self._batches[-1].first_tick + len(self._batches[-1]):
            self.oddities.setdefault("batches", f"tick {batch.first_tick} was sent twice")
        self._batches.append(batch)

    def _stretch(self, first: int, n: int) -> TickBatch | None:
        """Return the ticks if they have come without a gap."""
        parts: list[TickBatch] = []
        for batch in self._batches:
            if batch.first_tick + len(batch) <= first or batch.first_tick >= first + n:
                continue
            if parts and batch.first_tick != parts[-1].first_tick + len(parts[-1]):
                raise ConformanceError(
                    f"Telemetry goes from tick {parts[-1].first_tick + len(parts[-1])} to {batch.first_tick}: "
                    "expected no gap while the host reads"
                )
            parts.append(batch)
        if not parts or parts[0].first_tick > first:
            return None
        joined = TickBatch.join(parts)
        begin = first - joined.first_tick
        return joined[begin : begin + n] if len(joined) >= begin + n else None

    def _standing(self) -> str:
        if self.status is None:
            return ""
        reason = f", {self.status.reason!r}" if self.status.reason else ""
        return f" (the axis is {self.status.state}, {self.status.activity}{reason})"


def is_at_rest(status: protocol.Status) -> bool:
    """Whether the axis is disabled and rests."""
    return status.activity == "idle" and status.state != "enabled"


def only(kind: type[_Answer], **wanted: object) -> Callable[[protocol.Message], _Answer | None]:
    """Return what picks the messages of a type whose fields have these values."""

    def pick(message: protocol.Message) -> _Answer | None:
        if isinstance(message, kind) and all(
            getattr(message, name) == value for name, value in wanted.items()
        ):
            return message
        return None

    return pick


def end_of(number: int) -> Callable[[protocol.Message], protocol.RequestReply | None]:
    """Return what picks the last reply to a request."""
    reply = only(protocol.RequestReply, number=number)
    return lambda message: None if (found := reply(message)) is None or found.phase == "pending" else found
