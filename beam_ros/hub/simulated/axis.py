"""The virtual axis: all that a motion controller and its axis do by themselves, tick by tick.

``VirtualAxis`` is the device behind the simulator and behind the firmware emulator alike. It has a state
machine, four command modes, a buffer for sequences, watchdogs, limits and stop ramps, and integrates the
hub exactly: within a tick either the acceleration is constant (acceleration mode, and effort mode while
the axis holds or brakes), or the velocity is (velocity and position mode), or the force is (effort mode).

Device time is tick number times period; the caller says how far to advance. Nothing is ever enabled
again by itself.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from beam_ros.arrays import Float32Array, FloatArray, StampArray
from beam_ros.hub.contract import AxisEventKind, AxisState, Outcome, RequestKind, SampleBatch
from beam_ros.hub.errors import SnapshotError
from beam_ros.hub.parameters import HubParameters
from beam_ros.hub.simulated.plant import Plant

Activity = Literal["idle", "hold", "setpoint", "sequence", "stopping", "homing"]

HISTORY_TICKS = 4096
"""Ticks of the past that ``VirtualAxis.snapshots`` can look into (4 s at 1 kHz)."""

_ARRIVED = 1e-12
"""A profiled move ends this close to its target [m]; what rounding leaves is smaller."""
_SLACK = 1e-5
"""Relative slack of the device's own limits over the host's, so that a checked sequence never trips them."""


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
class TickBatch:
    """What the axis did and measured at consecutive ticks.

    Parameters
    ----------
    first_tick : int
        Number of the first tick; tick k begins at device time ``k * period_ns``.
    applied : ndarray, shape (n_ticks,)
        Reference really applied from each tick on, in the command mode's unit.
    position_counts : ndarray of int64, shape (n_ticks,)
        Encoder at each tick [encoder_resolution].
    velocity_counts : ndarray of int64, shape (n_ticks,)
        Speed at each tick [encoder_resolution / period].
    efforts : ndarray of float32, shape (n_ticks,)
        Force on the hub from each tick on [N].
    """

    first_tick: int
    applied: FloatArray
    position_counts: StampArray
    velocity_counts: StampArray
    efforts: Float32Array

    def __len__(self) -> int:
        """Return the number of ticks."""
        return len(self.applied)

    @classmethod
    def join(cls, parts: Sequence[TickBatch]) -> TickBatch:
        """Return batches that follow each other as one."""
        return cls(
            parts[0].first_tick,
            np.concatenate([part.applied for part in parts]),
            np.concatenate([part.position_counts for part in parts]),
            np.concatenate([part.velocity_counts for part in parts]),
            np.concatenate([part.efforts for part in parts]),
        )

    def __getitem__(self, part: slice) -> TickBatch:
        """Return some of the ticks, which must follow each other."""
        return TickBatch(
            self.first_tick + part.indices(len(self))[0],
            self.applied[part],
            self.position_counts[part],
            self.velocity_counts[part],
            self.efforts[part],
        )


def sample_batches(
    ticks: TickBatch, stamp_ns: int, epoch: int, parameters: HubParameters
) -> tuple[SampleBatch, SampleBatch]:
    """Return a device's ticks as the batches for ``hub/applied`` and ``hub/measured``.

    Parameters
    ----------
    ticks : TickBatch
        Consecutive ticks.
    stamp_ns : int
        Host time of the first [ns, UNIX].
    epoch : int
        The device's clock epoch.
    parameters : HubParameters
        Command mode, resolution and period.
    """
    mode = parameters.command_mode
    resolution = parameters.encoder_resolution
    applied = SampleBatch(
        stamp_ns,
        parameters.period_ns,
        epoch,
        positions=ticks.applied if mode == "position" else None,
        velocities=ticks.applied if mode == "velocity" else None,
        accelerations=ticks.applied if mode == "acceleration" else None,
        efforts=ticks.applied if mode == "effort" else None,
    )
    measured = SampleBatch(
        stamp_ns,
        parameters.period_ns,
        epoch,
        positions=np.multiply(ticks.position_counts, resolution, dtype=np.float64),
        velocities=np.multiply(ticks.velocity_counts, resolution / parameters.period, dtype=np.float64),
        efforts=ticks.efforts.astype(np.float64),
    )
    return applied, measured


@dataclass(frozen=True)
class Snapshots:
    """Hub and beam at exact instants, as a camera needs them.

    Parameters
    ----------
    times_ns : ndarray of int64, shape (n_times,)
        Instants asked for [ns of device time].
    positions, accelerations : ndarray, shape (n_times,)
        Of the hub [m], [m/s^2]; the true ones, from home, not what the encoder says. Where the velocity
        jumps from tick to tick, the acceleration is the jump spread over the tick.
    residual_accelerations : ndarray, shape (n_times,)
        The acceleration that the modes left out of q follow [m/s^2]; the hub's, but for internal damping.
    coordinates : ndarray, shape (n_times, n_modes)
        Modal coordinates q [m]: w(z) = shape(z) @ q - residual(z) * residual_acceleration.
    """

    times_ns: StampArray
    positions: FloatArray
    accelerations: FloatArray
    residual_accelerations: FloatArray
    coordinates: FloatArray


class _TickStart(NamedTuple):
    """All that it takes to say where hub and beam are at any instant of one tick."""

    position: float
    velocity: float
    """After any jump at the tick's beginning."""
    elastic: FloatArray
    drive: float
    """Acceleration of a led hub, force on a free one."""
    is_free: bool
    mean_acceleration: float


def profile_velocity(
    distance: float, velocity: float, speed: float, acceleration: float, period: float, *, is_ramped: bool
) -> float:
    """Return the velocity for the end of the next tick of a time-optimal move that ends at rest on target.

    Parameters
    ----------
    distance, velocity : float
        Way still to go [m] and present velocity [m/s], both signed.
    speed, acceleration : float
        Limits of the move [m/s], [m/s^2].
    period : float
        The device's tick [s].
    is_ramped : bool
        Whether the velocity runs linearly through a tick, or jumps at its beginning and stays.

    Notes
    -----
    With u = v/(aT) and D = d/(a T^2), braking from u' by one unit a tick covers
    u' + (u' - 1) + ... = (n + 1) u' - n (n + 1)/2 with n = floor(u'), where the velocity jumps. Where it is
    ramped, the way of the coming tick, u/2, and half of each later one give the same sum for D - u/2. So
    u' = E/(n + 1) + n/2 with n = floor((sqrt(1 + 8 E) - 1)/2) lands on the target exactly.
    """
    unit = acceleration * period
    way = distance / (unit * period) - (velocity / (2 * unit) if is_ramped else 0.0)
    size = abs(way)
    n = math.floor((math.sqrt(1.0 + 8.0 * size) - 1.0) / 2.0)
    wanted = math.copysign(size / (n + 1) + n / 2, way) * unit
    wanted = min(max(wanted, -speed), speed)
    return min(max(wanted, velocity - unit), velocity + unit)


class VirtualAxis:
    """A motion controller with its axis.

    Parameters
    ----------
    parameters : HubParameters
        Limits, command mode, period, where the hub stands at power-on, what the clock reads then.
    plant : Plant
        What the hub carries, stepped with the same period.
    buffer_samples : int, optional
        Room for samples of a sequence; without it there is no limit.
    """

    def __init__(self, parameters: HubParameters, plant: Plant, *, buffer_samples: int | None = None) -> None:
        self.parameters = parameters
        self._plant = plant
        self._buffer_samples = buffer_samples
        self._period = parameters.period
        self._is_ramped = parameters.command_mode in ("acceleration", "effort")
        self._tick = -(-parameters.clock_start_ns // parameters.period_ns)
        self._first_tick = self._tick

        self._position = parameters.initial_position
        self._velocity = 0.0
        self._encoder_zero = parameters.initial_position

        self._state: AxisState = "identified"
        self._activity: Activity = "idle"
        self._reason = ""
        self._is_homed = False
        self._fed_tick = self._tick
        self._after_stop: AxisState = "homed"
        self._events: list[AxisEvent] = []
        self._completed: list[tuple[int, Outcome]] = []
        self._waiting_for_rest: list[tuple[int, RequestKind]] = []
        self._homing_request = 0

        self._setpoint = 0.0
        self._setpoint_tick = self._tick

        self._samples: deque[float] = deque()
        self._start_tick = 0
        self._n_samples = 0
        self._n_received = 0
        self._n_applied = 0
        self._is_armed = False

        self._history: list[_TickStart | None] = [None] * HISTORY_TICKS

    # What the host sees -------------------------------------------------------------------------------

    @property
    def tick(self) -> int:
        """The tick that comes next; all before it are done."""
        return self._tick

    @property
    def device_ns(self) -> int:
        """Device time up to which the axis has advanced [ns]."""
        return self._tick * self.parameters.period_ns

    @property
    def state(self) -> AxisState:
        """Identified, homed, enabled or fault."""
        return self._state

    @property
    def activity(self) -> Activity:
        """What the axis is doing now."""
        return self._activity

    @property
    def reason(self) -> str:
        """Why the axis was disabled or stands in fault; empty while all is well."""
        return self._reason

    @property
    def position(self) -> float:
        """Measured position [m]."""
        return self._position_count() * self.parameters.encoder_resolution

    @property
    def velocity(self) -> float:
        """Measured velocity [m/s]."""
        return self._velocity_count() * (self.parameters.encoder_resolution / self._period)

    @property
    def true_position(self) -> float:
        """Where the hub really is, seen from home [m]; no device knows that before it has homed."""
        return self._position

    @property
    def has_sequence(self) -> bool:
        """Whether a sequence is armed or running."""
        return self._is_armed or self._activity == "sequence"

    @property
    def n_received(self) -> int:
        """Samples of the present sequence that have come so far."""
        return self._n_received

    @property
    def buffer_free(self) -> int:
        """Samples that the buffer still has room for."""
        if self._buffer_samples is None:
            return max(0, self._n_samples - self._n_received)
        return self._buffer_samples - len(self._samples)

    def take_events(self) -> list[AxisEvent]:
        """Return what the axis did by itself since the last call."""
        events, self._events = self._events, []
        return events

    def take_completed(self) -> list[tuple[int, Outcome]]:
        """Return the requests that came to an end since the last call."""
        completed, self._completed = self._completed, []
        return completed

    # What the host asks for ---------------------------------------------------------------------------

    def feed(self) -> None:
        """Note a sign of life of the host."""
        self._fed_tick = self._tick

    def request(self, request_id: int, kind: RequestKind) -> None:
        """Begin a change of state; how it ended appears in ``take_completed``."""
        if kind in ("stop", "disable"):
            self._request_stop(request_id, kind)
        elif kind == "enable":
            self._complete(request_id, self._enable())
        elif kind == "home":
            self._request_home(request_id)
        else:
            self._complete(request_id, self._clear_fault())

    def setpoint(self, value: float) -> Outcome:
        """Take one set-point in the command mode's unit."""
        limit = self.parameters.command_limit
        if not math.isfinite(value) or abs(value) > limit:
            return Outcome(
                False, f"set-point {value}: expected within +-{limit:g} {self.parameters.command_unit}"
            )
        if self._state != "enabled" or self._activity == "stopping":
            return Outcome(False, f"set-point: the axis is {self._condition()}, expected enabled")
        if self.has_sequence:
            return Outcome(False, "set-point: a sequence is loaded")
        self._setpoint = value
        self._setpoint_tick = self._tick
        self._activity = "setpoint"
        return Outcome(True, "set-point taken")

    def arm(self, start_ns: int, n_samples: int) -> Outcome:
        """Announce a sequence: its first sample is to be applied at the first tick from ``start_ns`` on.

        Parameters
        ----------
        start_ns : int
            When to start [ns of device time].
        n_samples : int
            Samples that will come by ``append``, one for each tick.
        """
        start_tick = -(-start_ns // self.parameters.period_ns)
        if self._state != "enabled" or self._activity == "stopping":
            return Outcome(False, f"sequence: the axis is {self._condition()}, expected enabled")
        if self.has_sequence:
            return Outcome(False, "sequence: another one is loaded")
        if self._velocity != 0.0:
            return Outcome(
                False, f"sequence: the hub moves with {self._velocity:.3g} m/s, expected it at rest"
            )
        if start_tick < self._tick:
            late_s = (self._tick - start_tick) * self._period
            return Outcome(False, f"sequence: its start was {late_s:.3f} s ago")
        if n_samples < 2:
            return Outcome(False, f"sequence: {n_samples} samples, expected at least 2")
        self._samples.clear()
        self._start_tick = start_tick
        self._n_samples = n_samples
        self._n_received = 0
        self._n_applied = 0
        self._is_armed = True
        self._activity = "hold"
        return Outcome(True, "sequence armed")

    def append(self, first: int, values: Sequence[float]) -> Outcome:
        """Take the next samples of the armed sequence.

        Parameters
        ----------
        first : int
            Number of the first of them in the sequence; samples come in order, without a gap.
        values : sequence of float
            Samples in the command mode's unit.
        """
        if not self.has_sequence:
            return Outcome(False, "samples: no sequence is armed")
        if first != self._n_received:
            return Outcome(False, f"samples from {first} on: expected them from {self._n_received} on")
        if first + len(values) > self._n_samples:
            return Outcome(False, f"samples to {first + len(values)}: the sequence has {self._n_samples}")
        if len(values) > self.buffer_free:
            return Outcome(False, f"{len(values)} samples: the buffer has room for {self.buffer_free}")
        self._samples.extend(values)
        self._n_received += len(values)
        return Outcome(True, "samples taken")

    def emergency_stop(self, reason: str) -> None:
        """Decelerate at the limit to rest, then disable, because of something the device noticed."""
        self._stop(reason, "homed" if self._is_homed else "identified")

    # Requests -----------------------------------------------------------------------------------------

    def _enable(self) -> Outcome:
        if self._state == "enabled" and self._activity != "stopping":
            return Outcome(True, "already enabled")
        if self._state != "homed" or self._activity != "idle":
            remedy = {
                "identified": "home it first",
                "fault": f"clear the fault first ({self._reason})",
            }.get(self._state, "wait until it rests")
            return Outcome(False, f"cannot enable: the axis is {self._condition()}; {remedy}")
        self._reason = ""
        self._activity = "hold"
        self._fed_tick = self._tick
        self._set_state("enabled")
        return Outcome(True, "enabled")

    def _request_home(self, request_id: int) -> None:
        if self._state not in ("identified", "homed") or self._activity != "idle":
            remedy = {"enabled": "disable it first", "fault": "clear the fault first"}.get(
                self._state, "wait until it rests"
            )
            self._complete(
                request_id, Outcome(False, f"cannot home: the axis is {self._condition()}; {remedy}")
            )
            return
        self._is_homed = False
        self._reason = ""
        self._set_state("identified")
        self._activity = "homing"
        self._homing_request = request_id
        self._fed_tick = self._tick

    def _request_stop(self, request_id: int, kind: RequestKind) -> None:
        if self._activity == "idle":
            self._complete(request_id, Outcome(True, f"already {self._state} and at rest"))
            return
        self._waiting_for_rest.append((request_id, kind))
        if self._activity != "stopping":
            self._stop(f"{kind} was asked for", "homed" if self._is_homed else "identified", is_asked=True)

    def _clear_fault(self) -> Outcome:
        if self._state != "fault":
            return Outcome(True, "there is no fault")
        if self._activity != "idle":
            return Outcome(False, "cannot clear the fault: the hub still moves; wait until it rests")
        self._reason = ""
        self._set_state("homed" if self._is_homed else "identified")
        return Outcome(True, "fault cleared")

    def _stop(self, reason: str, after: AxisState, *, is_asked: bool = False) -> None:
        """Begin to decelerate; ``after`` is the state that follows at rest."""
        if self._activity == "idle":
            return
        self._unload("sequence_aborted", reason)
        if self._activity == "homing":
            self._complete(self._homing_request, Outcome(False, f"homing ended early: {reason}"))
        if not is_asked:
            self._reason = reason
        if self._activity != "stopping" or after == "fault":
            self._after_stop = after
        self._activity = "stopping"

    def _unload(self, kind: AxisEventKind, reason: str) -> None:
        if self.has_sequence:
            self._events.append(AxisEvent(self._tick, kind, reason))
        if self._activity == "sequence":
            self._activity = "hold"
        self._is_armed = False
        self._samples.clear()

    def _set_state(self, state: AxisState) -> None:
        if state != self._state:
            self._state = state
            text = f"{state}: {self._reason}" if self._reason else state
            self._events.append(AxisEvent(self._tick, "state", text))

    def _complete(self, request_id: int, outcome: Outcome) -> None:
        self._completed.append((request_id, outcome))

    def _condition(self) -> str:
        return self._state if self._activity in ("idle", "hold") else f"{self._state} ({self._activity})"

    # Ticks --------------------------------------------------------------------------------------------

    def advance(self, to_device_ns: int) -> TickBatch:
        """Do every tick that begins before ``to_device_ns``, and return them.

        Parameters
        ----------
        to_device_ns : int
            Device time [ns]; an earlier one than before does nothing.
        """
        first = self._tick
        end = -(-to_device_ns // self.parameters.period_ns)
        applied: list[float] = []
        positions: list[int] = []
        velocities: list[int] = []
        efforts: list[float] = []
        for _ in range(end - first):
            positions.append(self._position_count())
            velocities.append(self._velocity_count())
            reference, effort = self._do_tick()
            applied.append(reference)
            efforts.append(effort)
        return TickBatch(
            first,
            np.array(applied, dtype=np.float64),
            np.array(positions, dtype=np.int64),
            np.array(velocities, dtype=np.int64),
            np.array(efforts, dtype=np.float32),
        )

    def snapshots(self, times_ns: Sequence[int] | StampArray) -> Snapshots:
        """Return hub and beam at exact instants of the recent past, also inside ticks.

        Parameters
        ----------
        times_ns : sequence of int
            Instants [ns of device time], each within the last ``HISTORY_TICKS`` ticks that are done.

        Raises
        ------
        SnapshotError
            An instant lies ahead, or further back than the axis remembers.
        """
        times = np.asarray(times_ns, dtype=np.int64)
        positions = np.empty(len(times))
        accelerations = np.empty(len(times))
        residuals = np.empty(len(times))
        coordinates = np.empty((len(times), self._plant.n_modes))
        oldest = max(self._first_tick, self._tick - HISTORY_TICKS)
        for i, time_ns in enumerate(times.tolist()):
            tick, rest_ns = divmod(time_ns, self.parameters.period_ns)
            if tick == self._tick and rest_ns == 0 and tick > oldest:
                tick, rest_ns = tick - 1, self.parameters.period_ns
            entry = self._history[tick % HISTORY_TICKS] if oldest <= tick < self._tick else None
            if time_ns == self.device_ns and self._tick == self._first_tick:
                # Nothing has been done since power-on: hub and beam are where they stand.
                entry = _TickStart(self._position, self._velocity, self._plant.state(), 0.0, False, 0.0)
            if entry is None:
                raise SnapshotError(
                    f"snapshot at {time_ns} ns of device time: expected from "
                    f"{oldest * self.parameters.period_ns} to {self.device_ns} ns; advance first, ask sooner"
                )
            tau = rest_ns * 1e-9
            if entry.is_free:
                motion = self._plant.free_motion(
                    entry.elastic, entry.position, entry.velocity, tau, entry.drive
                )
                positions[i] = motion.position
                accelerations[i] = residuals[i] = motion.acceleration
                coordinates[i] = motion.coordinates
            else:
                positions[i] = entry.position + entry.velocity * tau + entry.drive * tau * tau / 2
                accelerations[i] = entry.mean_acceleration
                residuals[i] = self._plant.residual_acceleration(entry.elastic, tau, entry.mean_acceleration)
                coordinates[i] = self._plant.coordinates(entry.elastic, tau, entry.drive)
        return Snapshots(times, positions, accelerations, residuals, coordinates)

    def _position_count(self) -> int:
        return round((self._position - self._encoder_zero) / self.parameters.encoder_resolution)

    def _velocity_count(self) -> int:
        return round(self._velocity * self._period / self.parameters.encoder_resolution)

    def _do_tick(self) -> tuple[float, float]:
        """Decide, integrate one period; return the reference that was applied and the force."""
        if self._activity != "idle":
            self._watch()
        if self._is_armed and self._tick >= self._start_tick:
            self._is_armed = False
            self._activity = "sequence"
            self._events.append(AxisEvent(self._tick, "sequence_running", ""))

        command: float | None = None
        if self._activity == "sequence":
            command = self._next_sample()
        elif self._activity == "setpoint":
            command = self._follow_setpoint()
        if command is not None:
            reason = self._limit_reason(command)
            if reason is None:
                return self._apply(command)
            self._stop(reason, "fault")
        return self._lead(self._own_velocity())

    def _watch(self) -> None:
        """Stop on silence, of the host or of its set-points."""
        patience = self.parameters.watchdog_ticks
        if self._activity == "stopping":
            return
        if self._tick - self._fed_tick > patience:
            self.emergency_stop(f"watchdog: no word from the host for {self.parameters.watchdog_s:g} s")
        elif (
            self._activity == "setpoint"
            and self.parameters.command_mode != "position"
            and self._tick - self._setpoint_tick > patience
        ):
            self.emergency_stop(f"set-point not refreshed for {self.parameters.watchdog_s:g} s")

    def _next_sample(self) -> float | None:
        """Return this tick's command from the buffer, or None after its end or an underrun.

        Position mode needs the sample after this one, towards which it moves.
        """
        is_position = self.parameters.command_mode == "position"
        if self._n_applied == self._n_samples - (1 if is_position else 0):
            self._samples.clear()
            self._activity = "hold"
            self._events.append(AxisEvent(self._tick, "sequence_done", ""))
            return None
        if is_position and self._n_applied == 0 and self._samples:
            self._samples.popleft()
        if not self._samples:
            reason = (
                f"underrun: sample {self._n_applied + (1 if is_position else 0)} of {self._n_samples} "
                "did not come in time"
            )
            self._unload("sequence_underrun", reason)
            self.emergency_stop(reason)
            return None
        self._n_applied += 1
        return self._samples.popleft()

    def _follow_setpoint(self) -> float:
        """Return this tick's command on the way to the set-point."""
        parameters = self.parameters
        mode = parameters.command_mode
        if mode == "velocity":
            step = parameters.max_acceleration * self._period
            return min(max(self._setpoint, self._velocity - step), self._velocity + step)
        if mode != "position":
            return self._setpoint
        # Position commands name the end of the tick, as the samples of a sequence do.
        distance = self._setpoint - self._position
        velocity = profile_velocity(
            distance,
            self._velocity,
            parameters.move_speed,
            parameters.move_acceleration,
            self._period,
            is_ramped=False,
        )
        if abs(distance - velocity * self._period) < _ARRIVED:
            return self._setpoint
        return self._position + velocity * self._period

    def _limit_reason(self, command: float) -> str | None:
        """Return why the axis must stop instead of following a command, or None."""
        parameters = self.parameters
        period = self._period
        mode = parameters.command_mode
        if not math.isfinite(command):
            return f"limit: command {command}"
        acceleration = 0.0
        if mode == "acceleration":
            acceleration = command
            velocity = self._velocity + command * period
            position = self._position + (self._velocity + velocity) * (period / 2)
        elif mode == "velocity":
            velocity = command
            acceleration = (velocity - self._velocity) / period
            position = self._position + velocity * period
        elif mode == "position":
            velocity = (command - self._position) / period
            acceleration = (velocity - self._velocity) / period
            position = command
        else:
            if abs(command) > parameters.max_effort * (1 + _SLACK):
                return f"limit: effort {command:.6g} N beyond {parameters.max_effort:g} N"
            velocity = self._velocity
            position = self._position + velocity * period
        if abs(acceleration) > parameters.max_acceleration * (1 + _SLACK):
            return (
                f"limit: acceleration {acceleration:.6g} m/s^2 beyond {parameters.max_acceleration:g} m/s^2"
            )
        if abs(velocity) > parameters.max_speed * (1 + _SLACK):
            return f"limit: speed {velocity:.6g} m/s beyond {parameters.max_speed:g} m/s"
        braking = velocity * abs(velocity) / (2 * parameters.max_acceleration)
        slack = parameters.max_acceleration * period * period + _SLACK * parameters.travel
        if abs(position) > parameters.position_limit + slack or (
            abs(position + braking) > parameters.position_limit + slack
        ):
            return (
                f"limit: at {position:.6f} m with {velocity:.3g} m/s the hub can just be stopped within "
                f"+-{parameters.position_limit:g} m"
            )
        return None

    def _apply(self, command: float) -> tuple[float, float]:
        """Integrate one period under a command of the mode."""
        mode = self.parameters.command_mode
        if mode == "effort":
            return self._push(command)
        if mode == "acceleration":
            return self._lead(self._velocity + command * self._period, command)
        if mode == "velocity":
            return self._lead(command)
        reference = self._position
        _, effort = self._lead((command - self._position) / self._period)
        self._position = command
        return reference, effort

    def _own_velocity(self) -> float:
        """Return the velocity for the end of this tick where the axis itself decides: hold, brake, home."""
        parameters = self.parameters
        if self._activity == "homing":
            velocity = profile_velocity(
                -self._position,
                self._velocity,
                parameters.homing_speed,
                parameters.homing_acceleration,
                self._period,
                is_ramped=self._is_ramped,
            )
            if abs(self._position) < _ARRIVED and abs(self._velocity) < _ARRIVED / self._period:
                self._position = 0.0
                self._encoder_zero = 0.0
                self._is_homed = True
                self._activity = "idle"
                self._set_state("homed")
                self._complete(self._homing_request, Outcome(True, "homed"))
                return 0.0
            return velocity
        step = parameters.max_acceleration * self._period
        velocity = self._velocity
        if self._activity == "stopping" and velocity == 0.0:
            self._come_to_rest()
        if abs(velocity) <= step:
            return 0.0
        return velocity - math.copysign(step, velocity)

    def _come_to_rest(self) -> None:
        self._activity = "idle"
        self._set_state(self._after_stop)
        for request_id, kind in self._waiting_for_rest:
            self._complete(request_id, Outcome(True, f"{'stopped' if kind == 'stop' else 'disabled'}"))
        self._waiting_for_rest.clear()

    def _lead(self, velocity: float, acceleration: float | None = None) -> tuple[float, float]:
        """Integrate one period that leads the hub to a velocity; return reference and force."""
        period = self._period
        before = self._velocity
        reference_position = self._position
        if self._is_ramped:
            if acceleration is None:
                acceleration = (velocity - before) / period
            start_velocity = before
            mean_acceleration = acceleration
            mean_velocity = before + acceleration * (period / 2)
        else:
            acceleration = 0.0
            mean_acceleration = (velocity - before) / period
            if velocity != before:
                self._plant.kick(velocity - before)
            start_velocity = mean_velocity = velocity
        effort = self._plant.force_when_led(mean_acceleration)
        self._history[self._tick % HISTORY_TICKS] = _TickStart(
            reference_position, start_velocity, self._plant.state(), acceleration, False, mean_acceleration
        )
        self._plant.step_led(acceleration, mean_acceleration)
        self._position += mean_velocity * period
        self._velocity = velocity
        self._tick += 1
        mode = self.parameters.command_mode
        if mode == "acceleration":
            return acceleration, effort
        if mode == "velocity":
            return velocity, effort
        if mode == "position":
            return reference_position - self._encoder_zero, effort
        return effort, effort

    def _push(self, force: float) -> tuple[float, float]:
        """Integrate one period of the free hub under a force."""
        self._history[self._tick % HISTORY_TICKS] = _TickStart(
            self._position, self._velocity, self._plant.state(), force, True, 0.0
        )
        self._position, self._velocity = self._plant.step_free(self._position, self._velocity, force)
        self._tick += 1
        return force, force
