"""The virtual axis: all that a motion controller and its axis do by themselves, tick by tick.

``VirtualAxis`` is the device behind the simulator and behind the firmware emulator alike. It puts together the
state machine (which runs on the table in ``transitions``), the buffer for sequences, the limits and profiled
moves, and the exact motion of the hub; its own are the watchdogs and the order of things within a tick.

Device time is tick number times period; the caller says how far to advance. Nothing is ever enabled
again by itself.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from beam_ros.hub.contract import Activity, AxisState, Outcome, RequestKind
from beam_ros.hub.faults import NO_FAULT, Fault, fault
from beam_ros.hub.kinematics import ARRIVED, braked_velocity, command_towards, profile_velocity
from beam_ros.hub.parameters import AxisParameters, SimulatedDevice
from beam_ros.hub.simulated.limits import SpeedForecast, limit_reason
from beam_ros.hub.simulated.motion import CarriedHub, HubMotion
from beam_ros.hub.simulated.plant import Plant
from beam_ros.hub.simulated.sequence_buffer import SequenceBuffer
from beam_ros.hub.simulated.state_machine import AxisEvent, AxisStateMachine
from beam_ros.hub.simulated.transitions import (
    ARMED,
    FOLLOWING,
    HOMING,
    RUNNING,
    Cause,
    Condition,
)
from beam_ros.hub.ticks import TickBatch


class VirtualAxis(CarriedHub):
    """A motion controller with its axis.

    Parameters
    ----------
    parameters : AxisParameters
        Limits, command mode, period.
    plant : Plant
        What the hub carries, stepped with the same period.
    device : SimulatedDevice, optional
        Where the hub stands at power-on, what the clock reads then.
    buffer_samples : int, optional
        Room for samples of a sequence; without it there is no limit.

    Attributes
    ----------
    parameters : AxisParameters
        What it obeys now; see ``obey``.
    silences : int
        How often the watchdog's time has passed without a sign of life of the host.
    silence_tick : int
        When it last did, 0 if never.
    """

    def __init__(
        self,
        parameters: AxisParameters,
        plant: Plant,
        device: SimulatedDevice | None = None,
        *,
        buffer_samples: int | None = None,
    ) -> None:
        self.parameters = parameters
        self.device = device or SimulatedDevice()
        super().__init__(HubMotion(parameters, plant, self.device))
        self._machine = AxisStateMachine({"watchdog fed": self.feed, "zero set": self._motion.set_zero})
        self._forecast = SpeedForecast(parameters)
        self._buffer = SequenceBuffer(buffer_samples, looks_ahead=parameters.command_mode == "position")
        self.silences = 0
        self.silence_tick = 0
        self.feed()
        self._setpoint = 0.0
        self._setpoint_tick = self._motion.tick

    # What the host sees -------------------------------------------------------------------------------

    @property
    def tick(self) -> int:
        """The tick that comes next; all before it are done."""
        return self._motion.tick

    @property
    def condition(self) -> Condition:
        """State and activity now: a row's origin in the table of transitions."""
        return self._machine.condition

    @property
    def state(self) -> AxisState:
        """Identified, homed, enabled or fault."""
        return self._machine.condition.state

    @property
    def activity(self) -> Activity:
        """What the axis is doing now."""
        return self._machine.condition.activity

    @property
    def fault(self) -> Fault:
        """Why the axis was disabled or stands in fault; ``NO_FAULT`` while all is well."""
        return self._machine.fault

    @property
    def reason(self) -> str:
        """The same with its numbers; empty while all is well."""
        return self._machine.reason

    @property
    def position(self) -> float:
        """Measured position [m]."""
        return self._motion.position_count * self.parameters.encoder_resolution

    @property
    def velocity(self) -> float:
        """Measured velocity [m/s]."""
        return self._motion.velocity_count * (self.parameters.encoder_resolution / self.parameters.period)

    @property
    def reference_position(self) -> float:
        """Where the axis was last told to be [m]; a servo that friction or play holds back rests beside it."""
        return self._motion.position

    @property
    def has_sequence(self) -> bool:
        """Whether a sequence is armed or running."""
        return self.activity in ("armed", "sequence")

    @property
    def n_received(self) -> int:
        """Samples of the present sequence that have come so far."""
        return self._buffer.n_received

    @property
    def buffer_free(self) -> int:
        """Samples that the buffer still has room for."""
        return self._buffer.free

    def take_events(self) -> list[AxisEvent]:
        """Return what the axis did by itself since the last call."""
        return self._machine.take_events()

    def take_completed(self) -> list[tuple[int, Outcome]]:
        """Return the requests that came to an end since the last call."""
        return self._machine.answers.take()

    # What the host asks for ---------------------------------------------------------------------------

    def feed(self) -> None:
        """Note a sign of life of the host."""
        self._silent_at_tick = self._motion.tick + self.parameters.watchdog_ticks + 1

    def obey(self, parameters: AxisParameters) -> None:
        """Keep other limits from now on; for an axis that is disabled and at rest.

        Parameters
        ----------
        parameters : AxisParameters
            With the tick, the mode and the resolution of those before.
        """
        self.parameters = parameters
        self._forecast = SpeedForecast(parameters)
        self.feed()

    def request(self, request_id: int, kind: RequestKind) -> None:
        """Begin a change of state; how it ended appears in ``take_completed``."""
        self._machine.ask(self.tick, request_id, kind)
        self._forget_unloaded()

    def setpoint(self, value: float) -> Outcome:
        """Take one set-point in the command mode's unit."""
        limit = self.parameters.command_limit
        if not math.isfinite(value) or abs(value) > limit:
            return Outcome(
                False, f"set-point {value}: expected within +-{limit:g} {self.parameters.command_unit}"
            )
        outcome = self._react("set-point")
        if outcome.success:
            self._setpoint, self._setpoint_tick = value, self.tick
        return outcome

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
        outcome = self._react("arm", objection=self._arm_objection(start_tick, n_samples))
        if outcome.success:
            self._buffer.announce(start_tick, n_samples)
        return outcome

    def _arm_objection(self, start_tick: int, n_samples: int) -> str:
        if self._motion.velocity != 0.0:
            return f"sequence: the hub moves with {self._motion.velocity:.3g} m/s, expected it at rest"
        if start_tick < self.tick:
            late_s = (self.tick - start_tick) * self.parameters.period
            return f"sequence: its start was {late_s:.3f} s ago"
        return "" if n_samples >= 2 else f"sequence: {n_samples} samples, expected at least 2"

    def append(self, first: int, values: Sequence[float]) -> Outcome:
        """Take the next samples of the armed sequence; see ``SequenceBuffer.append``."""
        if not self.has_sequence:
            return Outcome(False, "samples: no sequence is armed")
        return self._buffer.append(first, values)

    def emergency_stop(self, cause: Fault, reason: str) -> None:
        """Decelerate to rest, then disable, because of something the device noticed."""
        self._react("emergency stop", reason, cause)

    # What goes wrong on request -----------------------------------------------------------------------

    def trip(self, cause: Fault, reason: str) -> None:
        """Stop with a fault that stays, as a device does that finds an end switch or a broken encoder."""
        if self.activity in ("setpoint", "sequence"):
            self._react("limit", reason, cause)
        else:
            self._react("emergency stop", reason, cause)

    # Ticks --------------------------------------------------------------------------------------------

    def advance(self, to_device_ns: int) -> TickBatch:
        """Do every tick that begins before ``to_device_ns``, and return them.

        Parameters
        ----------
        to_device_ns : int
            Device time [ns]; an earlier one than before does nothing.
        """
        motion = self._motion
        first = motion.tick
        end = -(-to_device_ns // self.parameters.period_ns)
        applied: list[float] = []
        positions: list[int] = []
        velocities: list[int] = []
        efforts: list[float] = []
        for _ in range(end - first):
            positions.append(motion.position_count)
            velocities.append(motion.velocity_count)
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

    def _do_tick(self) -> tuple[float, float]:
        """Watch, decide, integrate one period; return the reference that was applied and the force."""
        machine, motion = self._machine, self._motion
        if motion.tick == self._silent_at_tick:
            self._note_silence()
        if machine.condition is FOLLOWING:
            self._watch_setpoint()
        if machine.condition is ARMED and motion.tick >= self._buffer.start_tick:
            self._react("start")
        command: float | None = None
        if machine.condition is RUNNING:
            command = self._next_sample()
        elif machine.condition is FOLLOWING:
            command = command_towards(self._setpoint, motion.position, motion.velocity, self.parameters)
        if command is not None:
            change = 0.0
            if self.parameters.command_mode == "effort":
                change = self._forecast.change(command, motion.velocity)
            breach = limit_reason(command, motion.position, motion.velocity, self.parameters, change=change)
            if breach is None:
                return motion.follow(command)
            self._react("limit", breach[1], breach[0])
        self._forecast.forget()
        return motion.lead(self._own_velocity())

    def _note_silence(self) -> None:
        """Count that the host has said nothing for the watchdog's time, and stop."""
        self.silences += 1
        self.silence_tick = self._motion.tick
        patience = f"{self.parameters.watchdog_s:g} s"
        self._react("silence", f"watchdog: no word from the host for {patience}", fault("host_silent"))

    def _watch_setpoint(self) -> None:
        """Stop when the set-point is old; a position set-point is a move that holds."""
        parameters = self.parameters
        oldest_tick = self._motion.tick - parameters.watchdog_ticks
        if self._setpoint_tick < oldest_tick and parameters.command_mode != "position":
            reason = f"set-point not refreshed for {parameters.watchdog_s:g} s"
            self._react("old set-point", reason, fault("setpoint_old"))

    def _next_sample(self) -> float | None:
        """Return this tick's command from the buffer, or None after its end or an underrun."""
        buffer = self._buffer
        if buffer.is_used_up:
            self._react("end")
            return None
        command = buffer.take()
        if command is None:
            awaited = f"sample {buffer.awaited_sample} of {buffer.n_samples}"
            self._react("underrun", f"underrun: {awaited} did not come in time", fault("underrun"))
        return command

    def _own_velocity(self) -> float:
        """Return the velocity for the end of this tick where the axis itself decides: hold, brake, home."""
        parameters, motion = self.parameters, self._motion
        if self._machine.condition is HOMING:
            if abs(motion.position) < ARRIVED and abs(motion.velocity) < ARRIVED / parameters.period:
                self._react("home reached")
                return 0.0
            return profile_velocity(
                -motion.position,
                motion.velocity,
                parameters.homing_speed,
                parameters.homing_acceleration,
                parameters.period,
                is_ramped=parameters.is_ramped,
            )
        if self.activity == "stopping" and motion.velocity == 0.0:
            self._react("rest")
        return braked_velocity(motion.velocity, parameters)

    def _react(
        self, cause: Cause, reason: str = "", why: Fault = NO_FAULT, *, objection: str = ""
    ) -> Outcome:
        outcome = self._machine.react(cause, self.tick, reason, fault=why, objection=objection)
        self._forget_unloaded()
        return outcome

    def _forget_unloaded(self) -> None:
        if not self.has_sequence:
            self._buffer.clear()
