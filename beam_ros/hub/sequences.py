"""Sequences of samples and set-points: what may reach the axis.

A sequence arrives in chunks named ``<id> <k>/<n>``. It is assembled whole and checked whole, against the
axis's limits and against where the hub stands, before anything of it may run. ``CommandGate`` is the host's
side of that for both hubs; the axis guards its own limits once more by itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from beam_ros.arrays import FloatArray
from beam_ros.hub.contract import (
    AxisEventKind,
    AxisState,
    EventLevel,
    HubEvent,
    Outcome,
    SequenceChunk,
    SequenceReport,
    SequenceState,
)
from beam_ros.hub.parameters import AxisParameters

MAX_CHUNK_POINTS = 500
MAX_CHUNKS = 20_000
MAX_AGE_NS = 200_000_000
"""Stamps older than this are refused: a replayed bag must never move a live axis."""
MAX_LEAD_NS = 600_000_000_000
"""Stamps further ahead than this are refused: they come from another clock."""
MIN_START_LEAD_NS = 100_000_000
"""A sequence must be complete this long before its start, so that the device's buffer can be filled."""

POSITION_TOLERANCE = 2e-6
"""How far the first position may lie from where the hub is [m]; also the slack on the travel."""
REST_SPEED = 1e-5
"""A slower hub counts as being at rest [m/s]."""
RELATIVE_TOLERANCE = 1e-6
"""Slack on speed and acceleration, for what rounding does to a design that uses its limits fully."""

Guard = Callable[[FloatArray], str | None]
"""A further check of a whole sequence (samples at device ticks), which returns a reason to refuse it."""


@dataclass(frozen=True)
class Sequence:
    """A complete sequence on the device's own grid.

    Parameters
    ----------
    sequence_id : str
        Its name.
    start_ns : int
        When its first sample is to be applied [ns, UNIX].
    values : ndarray, shape (n_ticks,)
        One sample for each device tick, in the command mode's unit.
    """

    sequence_id: str
    start_ns: int
    values: FloatArray


def expand_to_ticks(values: FloatArray, multiple: int, parameters: AxisParameters) -> FloatArray:
    """Return the samples at every device tick, as the mode's hold continues them.

    Parameters
    ----------
    values : ndarray, shape (n_points,)
        Samples, ``multiple`` ticks apart.
    multiple : int
        Ticks between two samples.
    parameters : AxisParameters
        Gives the hold.

    Returns
    -------
    ndarray, shape (n_ticks,)
        ``n_points * multiple`` ticks where values are held, ``(n_points - 1) * multiple + 1`` where they
        are joined by lines.
    """
    if multiple == 1:
        return values
    if parameters.hold == "zoh":
        return np.repeat(values, multiple)
    ticks = np.arange((len(values) - 1) * multiple + 1)
    return np.interp(ticks, np.arange(len(values)) * multiple, values)


def check_sequence(values: FloatArray, parameters: AxisParameters, position: float) -> str | None:
    """Return why the axis must not run these samples from rest at ``position``, or None.

    Parameters
    ----------
    values : ndarray, shape (n_ticks,)
        Samples at device ticks, in the command mode's unit.
    parameters : AxisParameters
        The axis's limits.
    position : float
        Where the hub rests now [m].

    Notes
    -----
    With the period T and samples c_k, the motion is integrated as the device does it: acceleration mode
    x_{k+1} = x_k + v_k T + c_k T^2/2, v_{k+1} = v_k + c_k T; velocity mode x_{k+1} = x_k + c_k T; position
    mode moves from c_k to c_{k+1} during tick k. Effort mode cannot be predicted without the plant: there
    only the samples' size is checked, and the axis's own guards do the rest.
    """
    period = parameters.period
    unit = parameters.command_unit
    if len(values) < 2:
        return f"{len(values)} samples: expected at least 2"
    if not np.all(np.isfinite(values)):
        k = int(np.flatnonzero(~np.isfinite(values))[0])
        return f"sample {k} is {values[k]}: expected finite numbers"

    mode = parameters.command_mode
    if mode == "effort":
        return _exceeded("effort", values, parameters.max_effort, unit)
    if mode == "acceleration":
        accelerations = values
        velocities = np.concatenate(([0.0], np.cumsum(values) * period))
        positions = position + np.concatenate(
            ([0.0], np.cumsum((velocities[:-1] + velocities[1:]) * (period / 2)))
        )
        # The device guards every instant; between two ticks v may pass through zero and x turn round.
        turning = velocities[:-1] * velocities[1:] < 0.0
        turns = positions[:-1][turning] - velocities[:-1][turning] ** 2 / (2 * values[turning])
        positions = np.concatenate((positions, turns))
        end_speed = float(velocities[-1])
    elif mode == "velocity":
        velocities = np.concatenate(([0.0], values))
        accelerations = np.diff(velocities) / period
        positions = position + np.cumsum(values) * period
        end_speed = float(values[-1])
    else:
        if abs(values[0] - position) > POSITION_TOLERANCE:
            return (
                f"starts at {values[0]:.6f} m, but the hub is at {position:.6f} m: expected the first "
                f"sample within {POSITION_TOLERANCE * 1e6:g} um; move there first"
            )
        positions = np.concatenate(([position], values[1:]))
        velocities = np.concatenate(([0.0], np.diff(positions) / period))
        accelerations = np.diff(velocities) / period
        end_speed = float(velocities[-1])

    if mode == "velocity" and abs(values[0]) > parameters.max_acceleration * period * (
        1 + RELATIVE_TOLERANCE
    ):
        return f"starts with {values[0]:.6g} m/s, but the hub is at rest: expected a start from rest"
    rest_speed = parameters.max_acceleration * period if mode == "position" else REST_SPEED
    for name, array, limit, array_unit in (
        ("acceleration", accelerations, parameters.max_acceleration, "m/s^2"),
        ("speed", velocities, parameters.max_speed, "m/s"),
    ):
        reason = _exceeded(name, array, limit, array_unit)
        if reason:
            return reason
    if np.max(np.abs(positions)) > parameters.position_limit + POSITION_TOLERANCE:
        extreme = positions[int(np.argmax(np.abs(positions)))]
        return (
            f"would take the hub to {extreme:.6f} m: the travel ends at +-{parameters.position_limit:g} m; "
            "make it smaller or start elsewhere"
        )
    if abs(end_speed) > rest_speed * (1 + RELATIVE_TOLERANCE):
        return f"ends with {end_speed:.3g} m/s: expected to end at rest (below {rest_speed:g} m/s)"
    return None


def _exceeded(name: str, array: FloatArray, limit: float, unit: str) -> str | None:
    k = int(np.argmax(np.abs(array)))
    if abs(array[k]) <= limit * (1 + RELATIVE_TOLERANCE):
        return None
    return f"{name} reaches {array[k]:.6g} {unit} at sample {k}: the limit is {limit:g} {unit}"


class SequenceAssembler:
    """Puts the chunks of one sequence together.

    Parameters
    ----------
    first : SequenceChunk
        Whichever chunk came first.
    parameters : AxisParameters
        The axis's limits.
    """

    def __init__(self, first: SequenceChunk, parameters: AxisParameters) -> None:
        self._parameters = parameters
        self._head = first
        self._chunks: dict[int, SequenceChunk] = {}
        self.points = 0

    @property
    def sequence_id(self) -> str:
        """Name of the sequence."""
        return self._head.sequence_id

    @property
    def start_ns(self) -> int:
        """When the first sample is to be applied [ns, UNIX]."""
        return self._head.start_ns

    @property
    def is_complete(self) -> bool:
        """Whether all chunks have come."""
        return len(self._chunks) == self._head.count

    def missing(self) -> str:
        """Say how much has come so far."""
        return f"{len(self._chunks)} of {self._head.count} chunks came"

    def add(self, chunk: SequenceChunk) -> str | None:
        """Take a chunk, or return why it does not belong to this sequence."""
        head = self._head
        if not 1 <= chunk.index <= chunk.count <= MAX_CHUNKS:
            return f"chunk {chunk.index}/{chunk.count}: expected 1 <= k <= n <= {MAX_CHUNKS}"
        if not 1 <= len(chunk.values) <= MAX_CHUNK_POINTS:
            return f"chunk {chunk.index} has {len(chunk.values)} points: expected 1 to {MAX_CHUNK_POINTS}"
        if chunk.period_ns <= 0 or chunk.period_ns % self._parameters.period_ns:
            return (
                f"period {chunk.period_ns} ns: expected a multiple of the device's "
                f"{self._parameters.period_ns} ns"
            )
        if chunk.first_tick < 0:
            return f"chunk {chunk.index} begins at sample {chunk.first_tick}: expected 0 or more"
        for name in ("count", "start_ns", "period_ns"):
            if getattr(chunk, name) != getattr(head, name):
                return (
                    f"chunk {chunk.index} has {name} {getattr(chunk, name)}, another chunk has "
                    f"{getattr(head, name)}: expected the same in all chunks"
                )
        known = self._chunks.get(chunk.index)
        if known is not None:
            if known.first_tick == chunk.first_tick and np.array_equal(known.values, chunk.values):
                return None
            return f"chunk {chunk.index} came twice with different samples"
        self._chunks[chunk.index] = chunk
        self.points += len(chunk.values)
        return None

    def assemble(self) -> Sequence | str:
        """Return the whole sequence at device ticks, or why the chunks do not make one."""
        expected = 0
        for index in range(1, self._head.count + 1):
            chunk = self._chunks[index]
            if chunk.first_tick != expected:
                return (
                    f"chunk {index} begins at sample {chunk.first_tick}, the chunks before it hold "
                    f"{expected}: expected no gap and no overlap"
                )
            expected += len(chunk.values)
        values = np.concatenate(
            [np.asarray(self._chunks[k].values, dtype=np.float64) for k in range(1, self._head.count + 1)]
        )
        multiple = self._head.period_ns // self._parameters.period_ns
        return Sequence(self.sequence_id, self.start_ns, expand_to_ticks(values, multiple, self._parameters))


class CommandGate:
    """The host's side of set-points and sequences: what it lets through to the axis.

    The gate knows one sequence at a time. It learns the axis's state with every call and a sequence's
    fate by ``note`` and ``finish``; it gathers reports until ``take_reports``.

    Parameters
    ----------
    parameters : AxisParameters
        The axis's limits and command mode.
    guard : callable, optional
        A further check of a complete sequence, for limits that need a model of the beam.
    """

    def __init__(self, parameters: AxisParameters, guard: Guard | None = None) -> None:
        self._parameters = parameters
        self._guard = guard
        self._assembler: SequenceAssembler | None = None
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

    def check_setpoint(self, stamp_ns: int, value: float, now_ns: int, state: AxisState) -> Outcome:
        """Say whether a set-point may go to the axis.

        Parameters
        ----------
        stamp_ns, now_ns : int
            When it was made, and the time now [ns, UNIX].
        value : float
            The set-point in the command mode's unit.
        state : str
            The axis's state.
        """
        parameters = self._parameters
        reason = _stale(stamp_ns, now_ns, ahead_ns=MAX_AGE_NS)
        if reason:
            return Outcome(False, f"set-point refused: {reason}")
        if not math.isfinite(value) or abs(value) > parameters.command_limit:
            return Outcome(
                False,
                f"set-point refused: {value} {parameters.command_unit} in {parameters.command_mode} mode, "
                f"expected within +-{parameters.command_limit:g} {parameters.command_unit}",
            )
        if self._assembler is not None:
            return Outcome(
                False,
                f"set-point refused: sequence {self.sequence_id} is loaded; wait for its end or call "
                "hub/stop",
            )
        if state != "enabled":
            return Outcome(False, f"set-point refused: {_not_enabled(state)}")
        return Outcome(True, "set-point taken")

    def add(
        self,
        chunk: SequenceChunk,
        now_ns: int,
        state: AxisState,
        position: float,
        speed: float,
    ) -> Sequence | None:
        """Take a chunk; return the sequence when this chunk completed it and it passed every check.

        Parameters
        ----------
        chunk : SequenceChunk
            The chunk.
        now_ns : int
            The time now [ns, UNIX].
        state, position, speed
            The axis's state, measured position [m] and speed [m/s].
        """
        if self._assembler is None:
            if (chunk.sequence_id, chunk.start_ns) == self._refused:
                return None
            self._assembler = SequenceAssembler(chunk, self._parameters)
            self._is_released = False
        assembler = self._assembler
        if chunk.sequence_id != assembler.sequence_id:
            if (chunk.sequence_id, chunk.start_ns) != self._refused:
                self._refused = (chunk.sequence_id, chunk.start_ns)
                reason = f"sequence {assembler.sequence_id} is loaded; wait for its end or call hub/stop"
                self._reports.append(SequenceReport(chunk.sequence_id, "refused", len(chunk.values), reason))
            return None
        if self._is_released:
            return None
        objection = _stale(chunk.start_ns, now_ns, ahead_ns=MAX_LEAD_NS) or assembler.add(chunk)
        if objection:
            self._refuse(objection)
            return None
        self._report("loading")
        if not assembler.is_complete:
            return None
        sequence = assembler.assemble()
        if isinstance(sequence, str):
            self._refuse(sequence)
            return None
        objection = self._check(sequence, now_ns, state, position, speed)
        if objection:
            self._refuse(objection)
            return None
        self._is_released = True
        self._report("ready")
        return sequence

    def _check(
        self, sequence: Sequence, now_ns: int, state: AxisState, position: float, speed: float
    ) -> str | None:
        if state != "enabled":
            return _not_enabled(state)
        lead_ns = sequence.start_ns - now_ns
        if lead_ns < MIN_START_LEAD_NS:
            return (
                f"complete {lead_ns * 1e-9:.3f} s before its start: expected at least "
                f"{MIN_START_LEAD_NS * 1e-9:g} s; give it a later start stamp"
            )
        # One encoder count in one period is the least speed that the measurement can show.
        moving = max(REST_SPEED, 1.5 * self._parameters.encoder_resolution / self._parameters.period)
        if abs(speed) > moving:
            return f"the hub moves with {speed:.3g} m/s: expected it at rest"
        reason = check_sequence(sequence.values, self._parameters, position)
        if reason is None and self._guard is not None:
            reason = self._guard(sequence.values)
        return reason

    def expire(self, now_ns: int) -> None:
        """Refuse a sequence whose start has passed before all of its chunks came."""
        if self._assembler is not None and not self._is_released and now_ns > self._assembler.start_ns:
            self._refuse(f"{self._assembler.missing()} before its start")

    def note(self, kind: AxisEventKind, text: str) -> HubEvent | None:
        """Note what the axis did by itself; return it as a line for the log where it is one."""
        if kind == "state":
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

    def finish(self, state: SequenceState, reason: str = "") -> None:
        """Note the end of the sequence, if there is one, and unload it."""
        self._report(state, reason)
        self._assembler = None

    def _refuse(self, reason: str) -> None:
        if self._assembler is not None:
            self._refused = (self._assembler.sequence_id, self._assembler.start_ns)
        self.finish("refused", reason)

    def _report(self, state: SequenceState, reason: str = "") -> None:
        if self._assembler is not None:
            self._reports.append(
                SequenceReport(self._assembler.sequence_id, state, self._assembler.points, reason)
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


def _stale(stamp_ns: int, now_ns: int, ahead_ns: int) -> str | None:
    if stamp_ns <= 0:
        return "stamp 0; expected the time at which it was made"
    age_ns = now_ns - stamp_ns
    if age_ns > MAX_AGE_NS:
        return f"its stamp is {age_ns * 1e-9:.3f} s old; expected at most {MAX_AGE_NS * 1e-9:g} s"
    if -age_ns > ahead_ns:
        return f"its stamp is {-age_ns * 1e-9:.3f} s ahead; expected at most {ahead_ns * 1e-9:g} s"
    return None
