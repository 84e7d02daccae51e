"""What runs on the table of transitions: the axis's condition, its events and the answers to requests."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from beam_ros.hub.answers import Answers
from beam_ros.hub.contract import AxisEventKind, Outcome, RequestKind
from beam_ros.hub.faults import NO_FAULT, Fault
from beam_ros.hub.simulated.transitions import IDENTIFIED, TRANSITION_OF, Cause, Condition, Effect


@dataclass(frozen=True)
class AxisEvent:
    """Something that the axis did by itself.

    Parameters
    ----------
    tick : int
        When [device ticks].
    kind : str
        A sequence's fate, or a change of state.
    text : str
        The reason, or the new state.
    """

    tick: int
    kind: AxisEventKind
    text: str


@dataclass(frozen=True)
class _Happening:
    """A cause with what it brings along."""

    tick: int
    fault: Fault
    reason: str
    request: tuple[int, RequestKind]


class AxisStateMachine:
    """The axis's condition, changed by the table of transitions alone.

    Parameters
    ----------
    device_effects : mapping of str to callable
        What the device itself does on the effects that are not the machine's own.
    answers : Answers, optional
        Takes how requests ended.

    Attributes
    ----------
    condition : Condition
        State and activity now.
    fault : Fault
        Why the axis was disabled or stands in fault; ``NO_FAULT`` while all is well.
    reason : str
        The same with its numbers; empty while all is well.
    answers : Answers
        How requests ended.
    """

    def __init__(
        self, device_effects: Mapping[Effect, Callable[[], None]], answers: Answers | None = None
    ) -> None:
        self.condition: Condition = IDENTIFIED
        self.fault = NO_FAULT
        self.reason = ""
        self._events: list[AxisEvent] = []
        self.answers = answers or Answers()
        self._waiting_for_rest: list[tuple[int, RequestKind]] = []
        self._homing_request = 0
        self._device_effects = device_effects

    def react(
        self,
        cause: Cause,
        tick: int,
        reason: str = "",
        *,
        fault: Fault = NO_FAULT,
        request: tuple[int, RequestKind] = (0, "stop"),
        objection: str = "",
    ) -> Outcome:
        """Do what the table says of a cause in the present condition; return the answer.

        Parameters
        ----------
        cause : str
            What happened.
        tick : int
            When [device ticks].
        reason : str, optional
            Why, for the log and the host.
        fault : Fault, optional
            The same as a row of the table of faults.
        request : tuple of int and str, optional
            Number and kind of the request that is the cause.
        objection : str, optional
            Why the device refuses a command that the table allows here; then nothing changes.
        """
        origin = self.condition
        row = TRANSITION_OF[origin, cause]
        if objection and not row.is_refused:
            return Outcome(False, objection)
        answer = row.answer.format(condition=origin, state=origin.state, reason=self.reason)
        happening = _Happening(tick, fault, reason, request)
        for effect in row.effects:
            if effect in self._device_effects:
                self._device_effects[effect]()
            else:
                _EFFECTS[effect](self, happening)
        if row.goal is not None:
            self.condition = row.goal
            if row.goal.state != origin.state:
                state = row.goal.state
                self._tell(tick, "state", f"{state}: {self.reason}" if self.reason else state)
        return Outcome(not row.is_refused, answer)

    def ask(self, tick: int, request_id: int, kind: RequestKind) -> None:
        """Do what the table says of a request; an answer that is given at once is kept for the host."""
        outcome = self.react(kind, tick, f"{kind} was asked for", request=(request_id, kind))
        if outcome.message:
            self.answers.add(request_id, outcome)

    def take_events(self) -> list[AxisEvent]:
        """Return what the axis did by itself since the last call."""
        events, self._events = self._events, []
        return events

    # Effects ------------------------------------------------------------------------------------------

    def _clear_reason(self, _happening: _Happening) -> None:
        self.fault, self.reason = NO_FAULT, ""

    def _keep_reason(self, happening: _Happening) -> None:
        self.fault, self.reason = happening.fault, happening.reason

    def _begin_homing(self, happening: _Happening) -> None:
        self._homing_request = happening.request[0]

    def _fail_homing(self, happening: _Happening) -> None:
        self.answers.add(self._homing_request, Outcome(False, f"homing ended early: {happening.reason}"))

    def _answer_homing(self, _happening: _Happening) -> None:
        self.answers.add(self._homing_request, Outcome(True, "homed"))

    def _wait_for_rest(self, happening: _Happening) -> None:
        self._waiting_for_rest.append(happening.request)

    def _answer_waiting(self, happening: _Happening) -> None:
        """Answer who asked for a stop; a reason says why the hub will not be seen at rest."""
        for request_id, kind in self._waiting_for_rest:
            done = "stopped" if kind == "stop" else "disabled"
            self.answers.add(request_id, Outcome(not happening.reason, happening.reason or done))
        self._waiting_for_rest.clear()

    def _tell(self, tick: int, kind: AxisEventKind, text: str) -> None:
        self._events.append(AxisEvent(tick, kind, text))


def _sequence_event(kind: AxisEventKind) -> Callable[[AxisStateMachine, _Happening], None]:
    return lambda machine, happening: machine._tell(happening.tick, kind, happening.reason)


_EFFECTS: dict[Effect, Callable[[AxisStateMachine, _Happening], None]] = {
    "reason cleared": AxisStateMachine._clear_reason,
    "reason kept": AxisStateMachine._keep_reason,
    "homing begun": AxisStateMachine._begin_homing,
    "homing failed": AxisStateMachine._fail_homing,
    "homing answered": AxisStateMachine._answer_homing,
    "answered at rest": AxisStateMachine._wait_for_rest,
    "waiting answered": AxisStateMachine._answer_waiting,
    "sequence running": _sequence_event("sequence_running"),
    "sequence done": _sequence_event("sequence_done"),
    "sequence aborted": _sequence_event("sequence_aborted"),
    "sequence underrun": _sequence_event("sequence_underrun"),
}
