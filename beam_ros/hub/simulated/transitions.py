"""The axis's conditions and every transition between them: the one table that the axis runs on.

A condition is a state and what the axis does in it. Each row of ``TRANSITIONS`` says from which conditions a
cause leads where, and with which effects; ``AxisStateMachine`` does what the rows say and nothing else, and
docs/protocol.md prints them. Two things can be checked by reading: only the request ``enable`` leads from a state
that is not enabled to one that is, and an enabled axis is disabled only when a stop has brought it to rest.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from beam_ros.hub.contract import Activity, AxisState

Cause = Literal[
    "enable",
    "disable",
    "home",
    "stop",
    "clear_fault",
    "set-point",
    "arm",
    "emergency stop",
    "start",
    "end",
    "underrun",
    "limit",
    "silence",
    "old set-point",
    "home reached",
    "rest",
]

CAUSES: dict[Cause, str] = {
    "enable": "request of the host",
    "disable": "request of the host",
    "home": "request of the host",
    "stop": "request of the host",
    "clear_fault": "request of the host",
    "set-point": "a set-point comes; refused beyond the command mode's limit",
    "arm": "a sequence is announced; refused while the hub moves, after its start, or with less than 2 samples",
    "emergency stop": "a session begins or ends",
    "start": "the tick of the sequence's start",
    "end": "the sequence's last sample was applied",
    "underrun": "a sample is missing at its tick",
    "limit": "the next command exceeds a limit, or the hub could not be stopped within its travel after it",
    "silence": "no valid frame for the watchdog's time; once for each silence",
    "old set-point": "not refreshed for the watchdog's time; position set-points do not age",
    "home reached": "the hub rests at home",
    "rest": "the hub has been decelerated to rest",
}
"""What each cause is, and when the device refuses it whatever the table says."""

Effect = Literal[
    "reason cleared",
    "reason kept",
    "watchdog fed",
    "homing begun",
    "homing failed",
    "homing answered",
    "zero set",
    "answered at rest",
    "waiting answered",
    "sequence running",
    "sequence done",
    "sequence aborted",
    "sequence underrun",
]


@dataclass(frozen=True)
class Condition:
    """A state, what the axis does in it, and a name for both."""

    name: str
    state: AxisState
    activity: Activity

    def __str__(self) -> str:
        """Return the state, and what is going on unless the axis stands still or follows."""
        return self.state if self.activity in ("idle", "hold", "armed") else f"{self.state} ({self.activity})"


IDENTIFIED = Condition("identified", "identified", "idle")
HOMING = Condition("homing", "identified", "homing")
HOMING_STOPS = Condition("homing stops", "identified", "stopping")
HOMED = Condition("homed", "homed", "idle")
HOLDING = Condition("holding", "enabled", "hold")
FOLLOWING = Condition("following", "enabled", "setpoint")
ARMED = Condition("armed", "enabled", "armed")
RUNNING = Condition("running", "enabled", "sequence")
STOPPING = Condition("stopping", "enabled", "stopping")
FAULTING = Condition("stopping to fault", "enabled", "stopping")
FAULT = Condition("fault", "fault", "idle")

CONDITIONS = (
    IDENTIFIED,
    HOMING,
    HOMING_STOPS,
    HOMED,
    HOLDING,
    FOLLOWING,
    ARMED,
    RUNNING,
    STOPPING,
    FAULTING,
    FAULT,
)

_AT_REST = (IDENTIFIED, HOMED, FAULT)
_FREE = (HOLDING, FOLLOWING)
_LOADED = (ARMED, RUNNING)
_STOPPING = (HOMING_STOPS, STOPPING, FAULTING)
_DISABLED = (IDENTIFIED, HOMING, HOMING_STOPS, HOMED, FAULT)


@dataclass(frozen=True)
class Transition:
    """One row of the table.

    Parameters
    ----------
    origins : tuple of Condition
        Where the row holds.
    causes : tuple of str
        What happens there.
    goal : Condition or None
        The condition that follows; None: it stays.
    effects : tuple of str
        What is done on the way, in this order.
    answer : str
        What the host is answered at once, with ``{condition}``, ``{state}`` and ``{reason}`` of the origin;
        empty where there is nothing to answer, or only later.
    is_refused : bool
        Whether the answer is a refusal; then nothing changes.
    """

    origins: tuple[Condition, ...]
    causes: tuple[Cause, ...]
    goal: Condition | None = None
    effects: tuple[Effect, ...] = ()
    answer: str = ""
    is_refused: bool = False


def _refused(origins: tuple[Condition, ...], cause: Cause, answer: str) -> Transition:
    return Transition(origins, (cause,), answer=answer, is_refused=True)


_STOP: tuple[Cause, ...] = ("stop", "disable")
_ALARM: tuple[Cause, ...] = ("emergency stop", "silence")

TRANSITIONS: tuple[Transition, ...] = (
    Transition((HOMED,), ("enable",), HOLDING, ("reason cleared", "watchdog fed"), "enabled"),
    Transition((*_FREE, *_LOADED), ("enable",), answer="already enabled"),
    _refused(
        (IDENTIFIED, HOMING, HOMING_STOPS), "enable", "cannot enable: the axis is {condition}; home it first"
    ),
    _refused((STOPPING, FAULTING), "enable", "cannot enable: the axis is {condition}; wait until it rests"),
    _refused((FAULT,), "enable", "cannot enable: the axis is {condition}; clear the fault first ({reason})"),
    Transition((IDENTIFIED, HOMED), ("home",), HOMING, ("reason cleared", "watchdog fed", "homing begun")),
    _refused((HOMING, HOMING_STOPS), "home", "cannot home: the axis is {condition}; wait until it rests"),
    _refused(
        (*_FREE, *_LOADED, STOPPING, FAULTING),
        "home",
        "cannot home: the axis is {condition}; disable it first",
    ),
    _refused((FAULT,), "home", "cannot home: the axis is {condition}; clear the fault first"),
    Transition((HOMING,), ("home reached",), HOMED, ("zero set", "homing answered")),
    Transition(_AT_REST, _STOP, answer="already {state} and at rest"),
    Transition((HOMING,), _STOP, HOMING_STOPS, ("homing failed", "answered at rest")),
    Transition(_FREE, _STOP, STOPPING, ("answered at rest",)),
    Transition(_LOADED, _STOP, STOPPING, ("sequence aborted", "answered at rest")),
    Transition(_STOPPING, _STOP, effects=("answered at rest",)),
    Transition((HOMING_STOPS,), ("rest",), IDENTIFIED, ("waiting answered",)),
    Transition((STOPPING,), ("rest",), HOMED, ("waiting answered",)),
    Transition((FAULTING,), ("rest",), FAULT, ("waiting answered",)),
    Transition((FAULT,), ("clear_fault",), HOMED, ("reason cleared",), "fault cleared"),
    Transition(
        tuple(condition for condition in CONDITIONS if condition is not FAULT),
        ("clear_fault",),
        answer="there is no fault",
    ),
    Transition(_FREE, ("set-point",), FOLLOWING, answer="set-point taken"),
    _refused(_LOADED, "set-point", "set-point: a sequence is loaded"),
    _refused(
        (*_DISABLED, STOPPING, FAULTING), "set-point", "set-point: the axis is {condition}, expected enabled"
    ),
    Transition((FOLLOWING,), ("old set-point",), STOPPING, ("reason kept",)),
    Transition((FOLLOWING,), ("limit",), FAULTING, ("reason kept",)),
    Transition(_FREE, ("arm",), ARMED, answer="sequence armed"),
    _refused(_LOADED, "arm", "sequence: another one is loaded"),
    _refused((*_DISABLED, STOPPING, FAULTING), "arm", "sequence: the axis is {condition}, expected enabled"),
    Transition((ARMED,), ("start",), RUNNING, ("sequence running",)),
    Transition((RUNNING,), ("end",), HOLDING, ("sequence done",)),
    Transition((RUNNING,), ("underrun",), STOPPING, ("sequence underrun", "reason kept")),
    Transition((RUNNING,), ("limit",), FAULTING, ("sequence aborted", "reason kept")),
    Transition(_AT_REST, _ALARM),
    Transition(_STOPPING, ("silence",)),
    Transition((HOMING,), _ALARM, HOMING_STOPS, ("homing failed", "reason kept")),
    Transition(_FREE, _ALARM, STOPPING, ("reason kept",)),
    Transition(_LOADED, _ALARM, STOPPING, ("sequence aborted", "reason kept")),
    Transition(_STOPPING, ("emergency stop",), effects=("reason kept",)),
)


def _by_pair() -> dict[tuple[Condition, Cause], Transition]:
    pairs: dict[tuple[Condition, Cause], Transition] = {}
    for row in TRANSITIONS:
        for origin in row.origins:
            for cause in row.causes:
                assert (origin, cause) not in pairs, f"two rows for {origin.name}, {cause}"
                pairs[origin, cause] = row
    return pairs


TRANSITION_OF = _by_pair()
"""The row of each pair of condition and cause; a pair without one cannot come about."""


def documentation() -> Iterator[str]:
    """Yield the lines of the tables of conditions, causes and transitions in docs/protocol.md."""
    yield "| condition | state | activity |"
    yield "|---|---|---|"
    for condition in CONDITIONS:
        yield f"| {condition.name} | {condition.state} | {condition.activity} |"
    yield ""
    yield "| cause | what it is |"
    yield "|---|---|"
    for cause, meaning in CAUSES.items():
        yield f"| {cause} | {meaning} |"
    yield ""
    yield "| in | cause | then | effects | answer |"
    yield "|---|---|---|---|---|"
    for row in TRANSITIONS:
        origins = ", ".join(origin.name for origin in row.origins)
        goal = "refused" if row.is_refused else "the same" if row.goal is None else row.goal.name
        answer = f"`{row.answer}`" if row.answer else ""
        yield f"| {origins} | {', '.join(row.causes)} | {goal} | {', '.join(row.effects)} | {answer} |"
