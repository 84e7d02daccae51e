"""What a hub is to the rest of the suite: the ``Hub`` protocol and the values that cross it.

``SimulatedHub`` and ``DriverHub`` both implement ``Hub``, so that one node shell serves the simulator and the
real axis. Nothing here reads a clock: the caller passes a ``HostTime`` with every call.

Sign convention: positions, velocities, accelerations and forces of the hub are positive along +x of the
frame ``rig``; home is position 0.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal, Protocol, get_args, runtime_checkable

from beam_ros.arrays import FloatArray
from beam_ros.hub.faults import NO_FAULT, Fault

AxisState = Literal["disconnected", "identified", "homed", "enabled", "fault"]
Activity = Literal["idle", "homing", "hold", "setpoint", "armed", "sequence", "stopping"]
RequestKind = Literal["enable", "disable", "home", "stop", "clear_fault"]
SequenceState = Literal["loading", "ready", "refused", "running", "done", "aborted", "underrun"]
AxisEventKind = Literal["sequence_running", "sequence_done", "sequence_aborted", "sequence_underrun", "state"]
EventLevel = Literal["info", "warning", "error"]

REQUEST_KINDS: tuple[RequestKind, ...] = ("enable", "disable", "home", "stop", "clear_fault")
AXIS_STATES: tuple[AxisState, ...] = ("disconnected", "identified", "homed", "enabled", "fault")
ACTIVITIES: tuple[Activity, ...] = get_args(Activity)
ASK_AGAIN = "ask again"
"""How a refusal ends for which a freeze of the process is the only reason: who still waits may ask anew."""
MAX_CHUNK_POINTS = 500
"""Of a chunk of a sequence."""


@dataclass(frozen=True)
class HostTime:
    """One reading of the host's two clocks, taken together.

    Parameters
    ----------
    steady_ns : int
        CLOCK_MONOTONIC [ns]; everything is timed by it.
    unix_ns : int
        CLOCK_REALTIME [ns]; only names the instants in stamps.
    """

    steady_ns: int
    unix_ns: int


@dataclass(frozen=True)
class SampleBatch:
    """Consecutive device ticks, one sample each, without a gap.

    Parameters
    ----------
    stamp_ns : int
        Mapped host time of the first sample [ns, UNIX].
    period_ns : int
        Distance of the samples [ns of device time]; sample k lies at ``k * period_ns`` after the first. 0 for a
        single sample of a device without ticks, whose stamp is its own.
    epoch : int
        Counts the device's starts; stamps of different epochs come from different maps.
    positions, velocities, accelerations, efforts : ndarray, shape (n_samples,), or None
        [m], [m/s], [m/s^2], [N]; None where the batch has no such quantity.
    """

    stamp_ns: int
    period_ns: int
    epoch: int
    positions: FloatArray | None = None
    velocities: FloatArray | None = None
    accelerations: FloatArray | None = None
    efforts: FloatArray | None = None

    def __len__(self) -> int:
        """Return the number of samples."""
        for array in (self.positions, self.velocities, self.accelerations, self.efforts):
            if array is not None:
                return len(array)
        return 0


@dataclass(frozen=True)
class SequenceChunk:
    """Some consecutive samples of a sequence, as one message carries them.

    Parameters
    ----------
    sequence_id : str
        The sequence's name, without white space.
    index, count : int
        This is chunk ``index`` of ``count``, counted from 1.
    start_ns : int
        When the sequence's first sample is to be applied [ns, UNIX]; the same in all chunks.
    period_ns : int
        Distance of the samples [ns of device time], a multiple of the device's period.
    first_tick : int
        Number of this chunk's first sample in the sequence, counted from 0: its time from the start is
        ``first_tick * period_ns``.
    values : ndarray, shape (n_points,)
        Samples in the command mode's unit.
    fault : str, optional
        What is wrong with the message; such a chunk refuses its sequence, or the one that is loading where it does
        not even name one.
    """

    sequence_id: str
    index: int
    count: int
    start_ns: int
    period_ns: int
    first_tick: int
    values: FloatArray
    fault: str = ""


@dataclass(frozen=True)
class Outcome:
    """Whether a command was taken, and why or why not."""

    success: bool
    message: str


@dataclass(frozen=True)
class SequenceReport:
    """Where a sequence stands.

    Parameters
    ----------
    sequence_id : str
        The sequence's name.
    state : str
        loading, ready, refused, running, done, aborted or underrun.
    points : int
        Samples received so far.
    reason : str
        Why it was refused or ended early; empty otherwise.
    is_late : bool
        Refused for its time alone: made anew with a later start it may be taken.
    """

    sequence_id: str
    state: SequenceState
    points: int
    reason: str = ""
    is_late: bool = False


@dataclass(frozen=True)
class ClockSync:
    """One comparison of the device's clock with the host's, enough to redo the map offline.

    Parameters
    ----------
    host_ns : int
        The middle of the exchange on the host [ns, UNIX].
    device_ns : int
        What the device's clock read then [ns].
    epoch : int
        Counts the device's starts.
    rtt_ns : int
        Duration of the exchange [ns]; ``host_ns`` is wrong by half of it at the most.
    """

    host_ns: int
    device_ns: int
    epoch: int
    rtt_ns: int


@dataclass(frozen=True)
class HubStatus:
    """The newest the host knows of the axis.

    Parameters
    ----------
    state : str
        disconnected, identified, homed, enabled or fault.
    position : float
        Measured position [m].
    velocity : float
        Measured velocity [m/s].
    activity : str
        What the axis does in that state.
    fault : Fault
        Why the axis was stopped or cannot be reached; ``NO_FAULT`` while all is well.
    reason : str
        The same in the words of who noticed it, with its numbers; empty while all is well.
    counters : mapping of str to int
        For diagnostics: what was lost, refused, retried.
    lacks_home : bool
        Whether a fault hides that the axis has not been homed.
    """

    state: AxisState = "disconnected"
    position: float = 0.0
    velocity: float = 0.0
    activity: Activity = "idle"
    fault: Fault = NO_FAULT
    reason: str = ""
    counters: Mapping[str, int] = field(default_factory=dict)
    lacks_home: bool = False

    @property
    def way_back(self) -> tuple[RequestKind, ...]:
        """The requests that lead from the fault to an enabled axis; none while it moves or cannot be reached."""
        if self.fault is NO_FAULT or self.state in ("disconnected", "enabled"):
            return ()
        steps: list[RequestKind] = ["clear_fault"] if self.state == "fault" else []
        if self.state == "identified" or self.lacks_home or self.fault.needs_home:
            steps.append("home")
        return (*steps, "enable")

    @property
    def remedy(self) -> str:
        """What to do about the fault: about its cause, and then which services to ask; empty without one."""
        services = ", ".join(f"hub/{kind}" for kind in self.way_back)
        return f"{self.fault.remedy}; then {services}" if services else self.fault.remedy


@dataclass(frozen=True)
class HubEvent:
    """One line for the log: a change of state or a fault, never a sample."""

    level: EventLevel
    text: str


@dataclass(frozen=True)
class HubReport:
    """All that happened since the last poll, in the order in which it happened."""

    applied: list[SampleBatch]
    measured: list[SampleBatch]
    sequences: list[SequenceReport]
    clock: list[ClockSync]
    completed: list[tuple[int, Outcome]]
    status: HubStatus
    events: list[HubEvent]


@dataclass(frozen=True)
class HubCapabilities:
    """What an axis and the way to it can promise.

    Parameters
    ----------
    name : str
        Of the kind of link, for messages.
    modes : tuple of str
        Command modes that it takes: acceleration, velocity, position, effort.
    is_buffered : bool
        Whether whole sequences are handed over and clocked by the device; else the host paces every sample.
    has_device_clock : bool
        Whether the samples carry the device's own time; else they carry the time of their receipt.
    has_watchdog : bool
        Whether the device stops by itself when the host falls silent.
    keeps_limits : bool
        Whether the device keeps the rig's limits by itself.
    telemetry : {"push", "poll", "none"}
        How samples come.
    rate : float
        Samples a second that are measured and commanded at most [1/s].
    shortcomings : tuple of str
        What this axis cannot promise, one sentence each, for people.
    """

    name: str
    modes: tuple[str, ...]
    is_buffered: bool = True
    has_device_clock: bool = True
    has_watchdog: bool = True
    keeps_limits: bool = True
    telemetry: Literal["push", "poll", "none"] = "push"
    rate: float = 1000.0
    shortcomings: tuple[str, ...] = ()


@runtime_checkable
class NewsBearer(Protocol):
    """A hub that says when a poll is worth its while; one that does not is polled a hundred times a second."""

    def call_on_news(self, callback: Callable[[], None]) -> None:
        """Have a callback called, in a thread of the hub's own, when samples or answers wait for ``Hub.poll``."""


class Hub(Protocol):
    """A moving hub: the simulated one, or one behind an axis link."""

    @property
    def capabilities(self) -> HubCapabilities:
        """What the axis can promise."""

    def request(self, kind: RequestKind) -> int:
        """Ask for a change of state; its number appears in ``HubReport.completed`` when it is over."""

    def setpoint(self, stamp_ns: int, value: float, now: HostTime) -> Outcome:
        """Hand over one set-point in the command mode's unit, stamped [ns, UNIX] by who made it."""

    def load(self, chunk: SequenceChunk, now: HostTime) -> None:
        """Hand over one chunk of a sequence; what became of it appears in ``HubReport.sequences``."""

    def poll(self, now: HostTime) -> HubReport:
        """Say that the host is alive, and collect what happened; call it at least every 50 ms."""

    def close(self) -> None:
        """Leave the axis stopped and let go of it."""
