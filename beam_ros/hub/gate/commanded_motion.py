"""Hub and beam as they follow what is commanded, and what one more set-point would do to them.

A model runs along. Where the link reports what the device applied, its samples lead the model, and what was
commanded since only bridges the way from the newest sample to now; where it does not, the model follows what was
written. A set-point is refused if, never refreshed, it would leave a limit before the axis rests again: held
until it ages, then stopped. So whatever comes after a set-point that was let through (a refused one, a stop, a dead
host, an unplugged cable), hub and beam stay within their limits.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from beam_model import PredictedLoads
from beam_ros.arrays import FloatArray
from beam_ros.hub.contract import SampleBatch
from beam_ros.hub.gate.beam_guard import BeamGuard
from beam_ros.hub.gate.sequence_check import POSITION_TOLERANCE, RELATIVE_TOLERANCE
from beam_ros.hub.kinematics import Phase, answer, in_ticks, ramp
from beam_ros.hub.parameters import AxisParameters

ARRIVAL_NS = 5_000_000
"""From a set-point's check to its effect on the axis, about."""
HOLD_SLACK_NS = 10_000_000
"""By how much longer than the watchdog's time a set-point may act, because nobody knows when it arrived."""
LOAD_MARGIN = 1.05
"""On what a set-point would do to the beam, because it may arrive some milliseconds sooner or later."""
OLD_SAMPLES_NS = 150_000_000
"""Older samples do not say where the hub is now; the axis's status does."""


@dataclass(frozen=True)
class _Instant:
    """Hub and beam at a time [ns, UNIX]; ``beam`` is a state of ``BeamGuard.led``, or empty."""

    ns: int
    position: float
    velocity: float
    beam: FloatArray


class CommandedMotion:
    """The model that runs along, and the check of set-points.

    Parameters
    ----------
    parameters : AxisParameters
        The axis's limits and command mode.
    guard : BeamGuard, optional
        The beam; without it only the hub's motion is checked, and of efforts only their size.
    """

    def __init__(self, parameters: AxisParameters, guard: BeamGuard | None = None) -> None:
        self._parameters = parameters
        self._guard = guard
        self._known = _Instant(0, 0.0, 0.0, np.zeros(0 if guard is None else guard.led.n_states))
        self._predicted = self._known
        self._setpoints: deque[tuple[int, float]] = deque()
        self._watchdog_ns = parameters.watchdog_ticks * parameters.period_ns
        self._hold_ticks = parameters.watchdog_ticks + 1 + HOLD_SLACK_NS // parameters.period_ns
        self._last_velocity = 0.0

    # What happens -------------------------------------------------------------------------------------

    def follow(self, applied: SampleBatch, measured: SampleBatch) -> None:
        """Follow what the device applied and measured, both of the same ticks."""
        if measured.positions is None or measured.velocities is None or len(measured) == 0:
            return
        period, start_ns = self._parameters.period, measured.stamp_ns
        known = self._known
        accelerations = self._accelerations(applied, measured)
        first_velocity, velocity = float(measured.velocities[0]), float(measured.velocities[-1])
        position = float(measured.positions[-1]) + velocity * period
        if start_ns < known.ns - self._parameters.batch_ns or not math.isfinite(position):
            return
        beam = known.beam
        if self._guard is not None and known.ns and np.all(np.isfinite(accelerations)):
            lost = round((start_ns - known.ns) / self._parameters.period_ns)
            if lost > 0:
                # Nobody knows what happened there, but by how much the hub's velocity changed.
                mean = (first_velocity - known.velocity) / (lost * period)
                beam = self._guard.led.after(beam, mean, lost)
            for drive, ticks in itertools.groupby(accelerations.tolist()):
                beam = self._guard.led.after(beam, drive, len(list(ticks)))
            beam = self._guard.with_velocity(beam, velocity)
        self._known = _Instant(
            start_ns + len(measured) * self._parameters.period_ns, position, velocity, beam
        )
        self._begin_from_known()

    def _begin_from_known(self) -> None:
        self._predicted = self._known
        while len(self._setpoints) > 1 and self._setpoints[1][0] <= self._known.ns:
            self._setpoints.popleft()

    def _accelerations(self, applied: SampleBatch, measured: SampleBatch) -> FloatArray:
        """Return the hub's acceleration in each tick, as exactly as the mode's samples give it."""
        if applied.accelerations is not None:
            return applied.accelerations
        velocities = applied.velocities if applied.velocities is not None else measured.velocities
        assert velocities is not None
        before, self._last_velocity = self._last_velocity, float(velocities[-1])
        return np.asarray(np.diff(velocities, prepend=before) / self._parameters.period)

    def take(self, value: float, now_ns: int) -> None:
        """Note a set-point that goes to the axis now [ns, UNIX]."""
        self._setpoints.append((now_ns + ARRIVAL_NS, value))

    def forget_setpoints(self) -> None:
        """Note that the axis follows no set-point any more."""
        self._setpoints.clear()
        self._predicted = self._known

    def beam_at(self, ns: int) -> FloatArray | None:
        """Return the beam's state at a time [ns, UNIX] at which a resting hub starts a sequence."""
        if self._guard is None:
            return None
        known = self._known
        n_ticks = (ns - known.ns) // self._parameters.period_ns if known.ns else 0
        return self._guard.led.after(self._guard.with_velocity(known.beam, 0.0), 0.0, max(0, n_ticks))

    # What would happen --------------------------------------------------------------------------------

    def objection(self, value: float, now_ns: int, position: float, velocity: float) -> str | None:
        """Return why the axis must not follow a set-point that comes now, or None.

        Parameters
        ----------
        value : float
            The set-point in the command mode's unit.
        now_ns : int
            The time now [ns, UNIX].
        position, velocity : float
            Of the hub, as the axis's status says [m], [m/s]; used where its samples are old or missing.
        """
        if not math.isfinite(position + velocity):
            return f"the hub is at {position} m with {velocity} m/s: expected finite numbers; look at its encoder"
        if abs(now_ns - self._known.ns) > OLD_SAMPLES_NS:
            bridged = self._advance(self._known, now_ns) if self._known.ns else self._known
            self._known = _Instant(now_ns, position, velocity, bridged.beam)
            self._begin_from_known()
        self._predicted = start = self._advance(self._predicted, now_ns + ARRIVAL_NS)
        parameters, mode = self._parameters, self._parameters.command_mode
        if mode == "effort" and self._guard is None:
            return None
        way = answer(value, start.position, start.velocity, parameters)
        if mode == "position":
            phases = in_ticks(way, parameters.period)
        else:
            phases = in_ticks(way, parameters.period, self._hold_ticks)
            # The stop may come sooner than the watchdog: looked at in the middle too.
            last = phases.pop()
            phases += [Phase(last.n_ticks // 2, last.drive), Phase(-(-last.n_ticks // 2), last.drive)]
        return _Future(parameters, self._guard, start).objection(phases)

    def _advance(self, instant: _Instant, until_ns: int) -> _Instant:
        """Return hub and beam later, under the set-points that were let through."""
        period_ns = self._parameters.period_ns
        setpoints = self._setpoints
        while instant.ns + period_ns / 2 < until_ns:
            end_ns = until_ns
            value: float | None = None
            for effect_ns, newer in setpoints:
                if effect_ns > instant.ns + period_ns / 2:
                    end_ns = min(end_ns, effect_ns)
                    break
                aged_ns = effect_ns + self._watchdog_ns
                if self._parameters.command_mode == "position":
                    value = newer
                elif aged_ns > instant.ns + period_ns / 2:
                    value, end_ns = newer, min(until_ns, aged_ns)
                else:
                    value, end_ns = None, until_ns
            n_ticks = max(1, round((end_ns - instant.ns) / period_ns))
            for phase in self._phases(value, instant, n_ticks):
                instant = moved(instant, phase, self._parameters, self._guard, is_pushed=value is not None)
        return instant

    def _phases(self, value: float | None, instant: _Instant, n_ticks: int) -> list[Phase]:
        parameters = self._parameters
        way = [ramp(instant.velocity, 0.0, parameters.stop_deceleration)]
        if value is not None:
            way = answer(value, instant.position, instant.velocity, parameters)
        return in_ticks(way, parameters.period, n_ticks)


def moved(
    instant: _Instant, phase: Phase, parameters: AxisParameters, guard: BeamGuard | None, *, is_pushed: bool
) -> _Instant:
    """Return hub and beam after a phase of a set-point (``is_pushed``) or of a stop."""
    n_ticks, drive = phase
    ns = instant.ns + n_ticks * parameters.period_ns
    x, v, beam = instant.position, instant.velocity, instant.beam
    if is_pushed and parameters.command_mode == "effort":
        if guard is None:
            return _Instant(ns, x + v * n_ticks * parameters.period, v, beam)
        return _Instant(ns, *guard.pushed_after(x, v, beam, drive, n_ticks))
    seconds = n_ticks * parameters.period
    if guard is not None:
        beam = guard.led.after(beam, drive, n_ticks)
    return _Instant(ns, x + (v + drive * seconds / 2) * seconds, v + drive * seconds, beam)


class _Future:
    """What follows when nothing else is commanded: the phases of a set-point, a stop, and the beam's ringing."""

    def __init__(self, parameters: AxisParameters, guard: BeamGuard | None, start: _Instant) -> None:
        self._parameters = parameters
        self._guard = guard
        self._instant = start
        # A hub that stands beyond a limit may be led back.
        slack = POSITION_TOLERANCE + parameters.encoder_resolution
        if parameters.command_mode == "position":
            slack += 2 * parameters.move_speed * parameters.period
        self._position_limit = max(parameters.position_limit, abs(start.position)) + slack
        self._speed_limit = max(parameters.max_speed, abs(start.velocity)) * (1 + RELATIVE_TOLERANCE)
        self._loads = np.zeros(3)

    def objection(self, phases: list[Phase]) -> str | None:
        for phase in phases:
            objection = self._follow(phase) or self._stopped()
            if objection:
                return objection
        if self._guard is None:
            return None
        tip, strain, force = (LOAD_MARGIN * self._loads).tolist()
        return self._guard.limits.objection(
            PredictedLoads(tip, np.zeros(0), strain, force), "the set-points, or let the beam come to rest,"
        )

    def _follow(self, phase: Phase) -> str | None:
        parameters, guard, before = self._parameters, self._guard, self._instant
        is_free = parameters.command_mode == "effort"
        if guard is not None:
            peaks = (
                guard.pushed_peaks(before.position, before.velocity, before.beam, phase.drive, phase.n_ticks)
                if is_free
                else guard.led.peaks(before.beam, phase.drive, phase.n_ticks)
            )
            np.maximum(self._loads, peaks, out=self._loads)
        self._instant = after = moved(before, phase, parameters, guard, is_pushed=True)
        if not abs(after.velocity) <= self._speed_limit:
            return (
                f"not refreshed, it would bring the hub to {after.velocity:.3g} m/s: the limit is "
                f"{parameters.max_speed:g} m/s; {self._remedy}"
            )
        extremes = [after.position]
        if before.velocity * after.velocity < 0.0:
            mean = (after.velocity - before.velocity) / (phase.n_ticks * parameters.period)
            extremes.append(before.position - before.velocity**2 / (2 * mean))
        return self._beyond(extremes)

    def _stopped(self) -> str | None:
        """Return why a stop from here would leave a limit, or None."""
        parameters, guard, instant = self._parameters, self._guard, self._instant
        speed = abs(instant.velocity)
        way = instant.velocity * speed / (2 * parameters.stop_deceleration)
        objection = self._beyond([instant.position + way])
        if objection or guard is None:
            return objection
        beam = instant.beam
        # The force of a stop is the axis's own: no set-point is the reason for it.
        for phase in in_ticks([ramp(instant.velocity, 0.0, parameters.stop_deceleration)], parameters.period):
            peaks = guard.led.peaks(beam, phase.drive, phase.n_ticks)
            np.maximum(self._loads[:2], peaks[:2], out=self._loads[:2])
            beam = guard.led.after(beam, phase.drive, phase.n_ticks)
        ringing = guard.led.peaks(beam, 0.0, guard.ring_ticks)
        np.maximum(self._loads[:2], ringing[:2], out=self._loads[:2])
        return None

    def _beyond(self, positions: list[float]) -> str | None:
        extreme = max(positions, key=abs)
        if abs(extreme) <= self._position_limit:
            return None
        return (
            f"not refreshed, it would take the hub to {extreme:.4f} m before it is stopped: the travel ends at "
            f"+-{self._parameters.position_limit:g} m; {self._remedy}"
        )

    @property
    def _remedy(self) -> str:
        if self._parameters.command_mode == "position":
            return "wait until the hub rests"
        return f"make it smaller, or shorten hub.watchdog ({self._parameters.watchdog_s:g} s)"
