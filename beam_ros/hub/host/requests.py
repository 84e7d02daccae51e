"""Requests and set-points on their way to the device: numbered, and repeated until they are heard."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass

from beam_ros.hub.answers import Answers
from beam_ros.hub.contract import ASK_AGAIN, REQUEST_KINDS, Outcome, RequestKind
from beam_ros.hub.gate.stamps import MAX_AGE_NS
from beam_ros.hub.parameters import AxisParameters

STOPS: tuple[RequestKind, ...] = ("stop", "disable")
"""What stops the axis: repeated without mercy, and never too old."""
STOP_RETRY_NS = 13_000_000
"""A stop is repeated after this time until it is done. It is out of step with the batches of samples (20 ms): on a
line that they flood, an answer finds room at some times of a batch only."""
RETRY_NS = 97_000_000
ASK_AGAIN_NS = 487_000_000
"""Another request is asked for again after this time once it was acknowledged, until then every ``RETRY_NS``."""
ANSWER_NS = 1_000_000_000
"""A request that the device has not acknowledged by then has failed."""
WAYS_HOME = 6
"""The way home is no longer than this many travels at homing speed: there, over the switch and back, with leisure."""
LEISURE_NS = 5_000_000_000
"""What a device may take beyond the time of the motion that was asked for."""
REPEAT_NS = 60_000_000
"""A set-point that has not come is sent again after this time."""


@dataclass
class _PendingRequest:
    request_id: int
    kind: RequestKind
    first_sent_ns: int | None = None
    last_sent_ns: int = 0
    is_acknowledged: bool = False
    outcome: Outcome | None = None

    @property
    def is_stop(self) -> bool:
        """Whether it ends when the axis is seen at rest, and not before."""
        return self.kind in STOPS

    @property
    def interval_ns(self) -> int:
        """After what time it is sent again [ns]."""
        if self.is_stop:
            return STOP_RETRY_NS
        return ASK_AGAIN_NS if self.is_acknowledged else RETRY_NS


class Requests:
    """The requests that the device has not answered yet.

    Parameters
    ----------
    parameters : AxisParameters
        Say how long the motions take that are asked for.
    report : callable
        Takes the name of a fault and what was seen: that the device works on a request for ever.

    Attributes
    ----------
    closing_id : int
        The stop that closing asked for, whose end only ``is_closed`` reports; 0 until then.
    answers : Answers
        How requests ended, by the device's word or the host's own.
    """

    def __init__(self, parameters: AxisParameters, report: Callable[[str, str], None]) -> None:
        home_s = WAYS_HOME * (
            parameters.travel / parameters.homing_speed
            + parameters.homing_speed / parameters.homing_acceleration
        )
        ramp_s = parameters.max_speed / parameters.stop_deceleration
        self._report = report
        self._patience_ns = {
            kind: LEISURE_NS + round(1e9 * (home_s if kind == "home" else ramp_s)) for kind in REQUEST_KINDS
        }
        self.closing_id = 0
        self.answers = Answers()
        self._pending: dict[int, _PendingRequest] = {}

    @property
    def is_closed(self) -> bool:
        """Whether the stop that closing asked for has ended."""
        return self.closing_id & 0xFFFF not in self._pending

    @property
    def are_pending(self) -> bool:
        """Whether the device has still to answer one."""
        return bool(self._pending)

    def begin(self, kind: RequestKind) -> int:
        """Take a request to be sent; return its id."""
        request_id = self.answers.begin()
        self._pending[request_id & 0xFFFF] = _PendingRequest(request_id, kind)
        return request_id

    def has(self, kind: RequestKind) -> bool:
        """Say whether a request of this kind is not answered yet."""
        return any(pending.kind == kind for pending in self._pending.values())

    def due(self, now_ns: int, *, stops_alone: bool = False) -> Iterator[tuple[int, RequestKind]]:
        """Yield number and kind of the requests that are to be sent now; fail those not answered in time."""
        for number, pending in list(self._pending.items()):
            if stops_alone and not pending.is_stop:
                continue
            if pending.first_sent_ns is None:
                pending.first_sent_ns = now_ns
            elif pending.is_stop:
                if now_ns - pending.last_sent_ns < pending.interval_ns:
                    continue
            elif not pending.is_acknowledged and now_ns - pending.first_sent_ns > ANSWER_NS:
                del self._pending[number]
                message = f"{pending.kind}: the controller did not answer within {ANSWER_NS * 1e-9:g} s"
                self._complete(pending, Outcome(False, message))
                continue
            elif now_ns - pending.first_sent_ns > self._patience_ns[pending.kind]:
                del self._pending[number]
                message = (
                    f"{pending.kind}: the controller has been working on it for "
                    f"{(now_ns - pending.first_sent_ns) * 1e-9:.1f} s: expected an end within "
                    f"{self._patience_ns[pending.kind] * 1e-9:.1f} s"
                )
                self._complete(pending, Outcome(False, message))
                self._report("never_done", message)
                continue
            elif now_ns - pending.last_sent_ns < pending.interval_ns:
                continue
            pending.last_sent_ns = now_ns
            yield number, pending.kind

    def acknowledge(self, number: int) -> None:
        """Note that the device works on a request."""
        if number in self._pending:
            self._pending[number].is_acknowledged = True

    def finish(self, number: int, outcome: Outcome) -> RequestKind | None:
        """Note how a request ended, by the device's word; return what it was, None where nobody waits for it.

        A stop that succeeded is kept, and said again, until ``end_stops``.
        """
        pending = self._pending.get(number)
        if pending is None:
            return None
        if pending.is_stop and outcome.success:
            pending.outcome = outcome
        else:
            del self._pending[number]
            self._complete(pending, outcome)
        return pending.kind

    def end_stops(self, broken: str = "") -> None:
        """End the stops: the axis is seen at rest, or did something else instead."""
        for number, pending in list(self._pending.items()):
            if pending.is_stop:
                del self._pending[number]
                kept = pending.outcome or Outcome(True, "the axis rests")
                self._complete(pending, Outcome(False, f"{pending.kind}: {broken}") if broken else kept)

    def drop_stale(self) -> None:
        """Fail what waited unsent for a frozen host, but what stops the axis."""
        for number, pending in list(self._pending.items()):
            if pending.first_sent_ns is None and pending.kind not in STOPS:
                del self._pending[number]
                message = f"{pending.kind} refused: the hub's process was frozen; {ASK_AGAIN}"
                self._complete(pending, Outcome(False, message))

    def fail_all(self, reason: str) -> None:
        """Fail what is pending, because the device cannot be reached any more."""
        for pending in self._pending.values():
            message = f"{pending.kind}: the controller is disconnected: {reason}"
            self._complete(pending, Outcome(False, message))
        self._pending.clear()

    def withdraw(self, kinds: Collection[RequestKind], reason: str) -> None:
        """Fail what is pending of some kinds, so that it is not asked for again."""
        for number, pending in list(self._pending.items()):
            if pending.kind in kinds:
                del self._pending[number]
                self._complete(pending, Outcome(False, f"{pending.kind}: the axis is stopped: {reason}"))

    def _complete(self, pending: _PendingRequest, outcome: Outcome) -> None:
        if pending.request_id != self.closing_id:
            self.answers.add(pending.request_id, outcome)


@dataclass
class _Setpoint:
    number: int
    value: float
    made_ns: int
    sent_ns: int | None = None


class SetpointRepeater:
    """The newest set-point, sent again until it has come or is too old."""

    def __init__(self) -> None:
        self._number = 0
        self._setpoint: _Setpoint | None = None

    def take(self, value: float, now_ns: int) -> None:
        """Take a set-point made now (steady time [ns]), in place of an older one."""
        self._number = self._number % 0xFFFF + 1
        self._setpoint = _Setpoint(self._number, value, now_ns)

    def drop(self) -> None:
        """Forget it."""
        self._setpoint = None

    def due(self, now_ns: int, newest_number: int | None) -> tuple[int, float] | None:
        """Return number and value where they are to be sent now.

        Parameters
        ----------
        now_ns : int
            Steady time [ns].
        newest_number : int or None
            Number of the set-point that came last to the device, as far as is known.
        """
        setpoint = self._setpoint
        if setpoint is None:
            return None
        if newest_number == setpoint.number or now_ns - setpoint.made_ns > MAX_AGE_NS:
            self._setpoint = None
        elif setpoint.sent_ns is None or now_ns - setpoint.sent_ns >= REPEAT_NS:
            setpoint.sent_ns = now_ns
            return setpoint.number, setpoint.value
        return None
