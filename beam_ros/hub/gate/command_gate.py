"""``CommandGate``: the host's side of set-points and sequences, for any axis link.

A sequence arrives in chunks named ``<id> <k>/<n>``. It is assembled whole and checked whole, against the
axis's limits, the beam's and where the hub stands, before anything of it may run. A set-point is checked against
the same limits, as if it were the last that is ever heard. The axis guards its own limits once more by itself.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable

from beam_ros.hub.contract import (
    AxisEventKind,
    AxisState,
    EventLevel,
    HubEvent,
    Outcome,
    SampleBatch,
    SequenceChunk,
    SequenceReport,
    SequenceState,
)
from beam_ros.hub.gate.beam_guard import BeamGuard
from beam_ros.hub.gate.commanded_motion import CommandedMotion
from beam_ros.hub.gate.sequence_assembly import Sequence, SequenceAssembler
from beam_ros.hub.gate.sequence_check import (
    POSITION_TOLERANCE,
    REST_SPEED,
    SequenceCheck,
)
from beam_ros.hub.gate.stamps import MAX_AGE_NS, MAX_LEAD_NS, MIN_START_LEAD_NS, READY_LEAD_NS, is_past, stale
from beam_ros.hub.parameters import AxisParameters


class CommandGate:
    """The host's side of set-points and sequences: what it lets through to the axis.

    The gate knows one sequence at a time. It learns the axis's state with every call, its samples by ``follow`` and
    a sequence's fate by ``note`` and ``finish``; it gathers reports until ``take_reports``.

    Parameters
    ----------
    parameters : AxisParameters
        The axis's limits and command mode.
    guard : BeamGuard, optional
        The beam on it; without one its limits are not checked.
    in_background : bool, optional
        Complete sequences are checked in a thread, so that no call takes long; else within ``add``, for callers
        whose time is not real.
    """

    def __init__(
        self, parameters: AxisParameters, guard: BeamGuard | None = None, *, in_background: bool = True
    ) -> None:
        self._parameters = parameters
        self._guard = guard
        self._in_background = in_background
        self._motion = CommandedMotion(parameters, guard)
        self._assembler: SequenceAssembler | None = None
        self._check: SequenceCheck | None = None
        self._refused: tuple[str, int] | None = None
        self._is_released = False
        self._reports: list[SequenceReport] = []

    @property
    def sequence_id(self) -> str | None:
        """Name of the sequence that is loading, ready or running."""
        return None if self._assembler is None else self._assembler.sequence_id

    def take_reports(self) -> list[SequenceReport]:
        """Return what happened to sequences since the last call."""
        reports, self._reports = self._reports, []
        return reports

    def follow(self, batches: Iterable[tuple[SampleBatch, SampleBatch]]) -> None:
        """Follow what the axis applied and measured since the last call, batch by batch.

        A link without such samples leaves this out: then the model of hub and beam follows the set-points alone.
        """
        for applied, measured in batches:
            self._motion.follow(applied, measured)

    def check_setpoint(
        self, stamp_ns: int, value: float, now_ns: int, state: AxisState, position: float, speed: float
    ) -> Outcome:
        """Say whether a set-point may go to the axis; one that may is taken for sent.

        Parameters
        ----------
        stamp_ns, now_ns : int
            When it was made, and the time now [ns, UNIX].
        value : float
            The set-point in the command mode's unit.
        state, position, speed
            The axis's state, measured position [m] and speed [m/s].

        Notes
        -----
        Nothing else happens when one is refused, also while the hub moves: the set-point before it, which was let
        through only because it may act until it ages and the axis stops, does just that. A stop at once would be
        harder on the beam, and would disable the axis for one slip of a joystick.
        """
        reason = self._setpoint_objection(stamp_ns, value, now_ns, state)
        if reason is None:
            reason = self._motion.objection(value, now_ns, position, speed)
        if reason:
            return Outcome(False, f"set-point refused: {reason}")
        self._motion.take(value, now_ns)
        return Outcome(True, "set-point taken")

    def _setpoint_objection(self, stamp_ns: int, value: float, now_ns: int, state: AxisState) -> str | None:
        reason = stale(stamp_ns, now_ns, ahead_ns=MAX_AGE_NS)
        if reason:
            return reason
        parameters = self._parameters
        limit, unit = parameters.command_limit, parameters.command_unit
        if not math.isfinite(value) or abs(value) > limit:
            return f"{value} {unit} in {parameters.command_mode} mode, expected within +-{limit:g} {unit}"
        if self._assembler is not None:
            return f"sequence {self.sequence_id} is loaded; wait for its end or call hub/stop"
        return None if state == "enabled" else _not_enabled(state)

    def add(
        self,
        chunk: SequenceChunk,
        now_ns: int,
        state: AxisState,
        position: float,
        speed: float,
    ) -> None:
        """Take a chunk; with the one that completes the sequence its check begins, whose end ``poll`` tells.

        Parameters
        ----------
        chunk : SequenceChunk
            The chunk.
        now_ns : int
            The time now [ns, UNIX].
        state, position, speed
            The axis's state, measured position [m] and speed [m/s].
        """
        if chunk.fault and not chunk.sequence_id:
            # Nobody knows whose chunk it was: the sequence that is loading will lack one.
            if self._is_loading:
                self._refuse(chunk.fault)
            return
        assembler = self._assembler_for(chunk)
        if assembler is None or not self._is_loading:
            return
        age = stale(chunk.start_ns, now_ns, ahead_ns=MAX_LEAD_NS)
        objection = chunk.fault or age or assembler.add(chunk)
        if objection:
            self._refuse(objection, is_late=objection == age and is_past(chunk.start_ns, now_ns))
            return
        self._report("loading")
        if assembler.is_complete:
            self._begin_check(assembler, now_ns, state, position, speed)

    @property
    def _is_loading(self) -> bool:
        return self._assembler is not None and self._check is None and not self._is_released

    def _assembler_for(self, chunk: SequenceChunk) -> SequenceAssembler | None:
        """Return what puts the chunk's sequence together; None where it is refused, which is said once."""
        name = (chunk.sequence_id, chunk.start_ns)
        if self._assembler is None and name != self._refused:
            self._assembler = SequenceAssembler(chunk, self._parameters)
            self._is_released = False
        if self._assembler is None or self._assembler.sequence_id == chunk.sequence_id:
            return self._assembler
        if name != self._refused:
            self._refused = name
            reason = f"sequence {self.sequence_id} is loaded; wait for its end or call hub/stop"
            self._reports.append(SequenceReport(chunk.sequence_id, "refused", len(chunk.values), reason))
        return None

    def _begin_check(
        self, assembler: SequenceAssembler, now_ns: int, state: AxisState, position: float, speed: float
    ) -> None:
        objection = self._unready(state, position, speed)
        lead_ns = assembler.start_ns - now_ns
        if objection:
            self._refuse(objection)
            return
        if lead_ns < MIN_START_LEAD_NS:
            late = (
                f"complete {lead_ns * 1e-9:.3f} s before its start: expected at least "
                f"{MIN_START_LEAD_NS * 1e-9:g} s; give it a later start stamp"
            )
            self._refuse(late, is_late=True)
            return
        loads = None
        if self._guard is not None:
            beam = self._motion.beam_at(assembler.start_ns)
            loads = functools.partial(self._guard.sequence, position, beam)
        self._check = SequenceCheck(assembler, self._parameters, position, loads)
        self._check.begin(in_background=self._in_background)

    def _unready(self, state: AxisState, position: float, speed: float) -> str | None:
        """Return why no sequence may start from here, or None."""
        if state != "enabled":
            return _not_enabled(state)
        # One encoder count in one period is the least speed that the measurement can show.
        moving = max(REST_SPEED, 1.5 * self._parameters.encoder_resolution / self._parameters.period)
        if abs(speed) > moving:
            return f"the hub moves with {speed:.3g} m/s: expected it at rest"
        if self._check is not None:
            way = position - self._check.position
            if abs(way) > POSITION_TOLERANCE + 1.5 * self._parameters.encoder_resolution:
                return f"the hub moved by {way:.3g} m while the sequence was checked: expected it at rest"
        return None

    def poll(self, now_ns: int, state: AxisState, position: float, speed: float) -> Sequence | None:
        """Return the sequence whose check has ended well since the last call; refuse one that is too late.

        Parameters
        ----------
        now_ns : int
            The time now [ns, UNIX].
        state, position, speed
            The axis's state, measured position [m] and speed [m/s].
        """
        assembler, check = self._assembler, self._check
        if assembler is None or self._is_released:
            return None
        if check is None:
            if now_ns > assembler.start_ns:
                self._refuse(f"{assembler.missing()} before its start", is_late=True)
            return None
        lead_ns = assembler.start_ns - now_ns
        if check.is_done and check.objection:
            self._refuse(check.objection)
        elif lead_ns < READY_LEAD_NS:
            self._refuse(
                f"its {assembler.points} samples could not be checked before its start; give it a start stamp that "
                "is some seconds later for every 1e6 ticks",
                is_late=True,
            )
        elif check.is_done:
            objection = self._unready(state, position, speed)
            if objection is None:
                self._check, self._is_released = None, True
                self._report("ready")
                return check.sequence
            self._refuse(objection)
        return None

    def note(self, kind: AxisEventKind, text: str) -> HubEvent | None:
        """Note what the axis did by itself; return it as a line for the log where it is one."""
        if kind == "state":
            if not text.startswith("enabled"):
                self._motion.forget_setpoints()
            level: EventLevel = "error" if text.startswith("fault") else "warning" if ":" in text else "info"
            return HubEvent(level, f"axis {text}")
        if kind == "sequence_running":
            self._report("running")
        else:
            self.finish(_ENDS[kind], text)
        return None

    def abort_loading(self, reason: str) -> None:
        """Unload a sequence that the axis does not know yet."""
        if not self._is_released:
            self.finish("aborted", reason)

    def finish(self, state: SequenceState, reason: str = "", *, is_late: bool = False) -> None:
        """Note the end of the sequence, if there is one, and unload it."""
        self._report(state, reason, is_late=is_late)
        if self._check is not None:
            self._check.cancel()
        self._assembler = self._check = None

    def _refuse(self, reason: str, *, is_late: bool = False) -> None:
        if self._assembler is not None:
            self._refused = (self._assembler.sequence_id, self._assembler.start_ns)
        self.finish("refused", reason, is_late=is_late)

    def _report(self, state: SequenceState, reason: str = "", *, is_late: bool = False) -> None:
        if self._assembler is not None:
            self._reports.append(
                SequenceReport(self._assembler.sequence_id, state, self._assembler.points, reason, is_late)
            )


_ENDS: dict[AxisEventKind, SequenceState] = {
    "sequence_done": "done",
    "sequence_aborted": "aborted",
    "sequence_underrun": "underrun",
}

_REMEDY: dict[str, str] = {
    "disconnected": "connect the controller",
    "identified": "call hub/home and hub/enable",
    "homed": "call hub/enable",
    "fault": "call hub/clear_fault, then hub/enable",
}


def _not_enabled(state: AxisState) -> str:
    return f"the axis is {state}, expected enabled; {_REMEDY[state]}"
