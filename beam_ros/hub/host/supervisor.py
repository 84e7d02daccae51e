"""What the host watches while it is connected, whatever the link: motion, telemetry, status, clock, its own stops.

The first thing that is wrong becomes the fault. It stays until it is cleared, which needs that its cause is gone.
From the moment on, the host tells the device to stop. A stop is a promise, the user's as well: until the axis is seen
at rest, nothing else is said; where it is not at rest in time, the host falls silent, so that the device's own
watchdog acts.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from beam_ros.arrays import FloatArray
from beam_ros.hub.contract import Activity, AxisState, HubStatus, Outcome, RequestKind
from beam_ros.hub.faults import NO_FAULT, Fault, fault
from beam_ros.hub.host.axis_watch import AxisWatch, Found
from beam_ros.hub.host.missing_messages import MissingMessages
from beam_ros.hub.host.motion_watch import Measuring
from beam_ros.hub.host.stop_promise import GONE_NS, StopPromise
from beam_ros.hub.host.waking_time import WakingTime
from beam_ros.hub.journal import Journal
from beam_ros.hub.parameters import AxisParameters
from beam_ros.hub.ticks import TickBatch

NO_NUMBERS = 3
"""So many ticks in a row of which the device says no number are a fault."""
LEISURE_NS = 100_000_000
"""By so much longer than a device's watchdog and stop ramp take does the host stay silent."""


class Supervisor:
    """Finds what is wrong with the axis, and sees to it that it stops.

    Parameters
    ----------
    parameters : AxisParameters
        Limits, tick and watchdog.
    journal : Journal
        Is told of faults.
    measuring : Measuring, optional
        How well positions are measured; by default as the axis's encoder does.

    Attributes
    ----------
    fault : Fault
        What was found first and has not been cleared; ``NO_FAULT`` while all is well.
    reason : str
        What was seen, with its numbers.
    has_lost_home : bool
        Whether the axis must be homed before it is enabled, whatever the device believes.
    """

    def __init__(
        self, parameters: AxisParameters, journal: Journal, measuring: Measuring | None = None
    ) -> None:
        self.fault: Fault = NO_FAULT
        self.reason = ""
        self.has_lost_home = False
        self._journal = journal
        self._watch = AxisWatch(parameters, measuring or Measuring.by_encoder(parameters))
        self._missing = MissingMessages(parameters)
        self._waking = WakingTime()
        self._n_no_numbers = 0
        self._seen_ns = self._told_ns = 0
        self._stop: StopPromise | None = None
        self._broken = ""
        self._is_stopped = True
        ramp_ns = round(parameters.max_speed / parameters.stop_deceleration * 1e9)
        self._silence_ns = round(parameters.watchdog_s * 1e9) + ramp_ns + 2 * parameters.batch_ns + LEISURE_NS
        self._silent_since_ns: int | None = None

    # What is seen -------------------------------------------------------------------------------------

    def connect(self) -> None:
        """Begin a connection."""
        self._watch.connect()
        self._missing.forget()
        self._stop = self._silent_since_ns = None

    def look(self, now_ns: int) -> None:
        """Take the steady time [ns], at least every 50 ms; who was put aside did not wait in the meantime."""
        self._waking.look(now_ns)
        if self._stop is None:
            return
        self._broken = self._stop.broken(
            self._waking.ns, is_moving=self._is_seen_moving, speed=self._watch.speed
        )
        if self._broken:
            self.report("stop_ignored", self._broken)
            self._journal.tell("error", f"{self._broken}: the host falls silent")
            self._stop, self._silent_since_ns = None, now_ns

    def hear(self, kind: str) -> None:
        """Take note of a message: ``telemetry``, ``status`` or ``other``; look for what is missing beside it."""
        self._report_found(self._missing.hear(kind, self._waking.ns))

    def note_applied(self, applied: FloatArray) -> None:
        """Take what the device says that it applied, number or not; what is none goes nowhere else."""
        are_numbers = np.isfinite(applied)
        if np.all(are_numbers):
            self._n_no_numbers = 0
            return
        for is_number in are_numbers.tolist():
            self._n_no_numbers = 0 if is_number else self._n_no_numbers + 1
            if self._n_no_numbers >= NO_NUMBERS:
                self.report("not_finite", f"{NO_NUMBERS} ticks in a row without a number of what was applied")

    def forget_motion(self) -> None:
        """Begin anew: where the hub is has another meaning from now on."""
        self._watch.forget()

    def note_measured(self, time: float, position: float, *, is_led: bool) -> None:
        """Take one measurement of a hub without ticks: when [s], where [m], and whether its speed is limited."""
        found = self._watch.note_measured(
            self._waking.ns, time, position, is_led=is_led, has_home=not self.has_lost_home
        )
        self._report_found(found)

    def note_led(self, now_ns: int, led: float, position: float) -> None:
        """Take where the host leads the hub and where it was measured last [m]; steady time [ns].

        On its way to rest the hub is held to the promise of the stop.
        """
        is_held_to_it = self._stop is None and self.fault is NO_FAULT
        self._report_found(self._watch.note_led(now_ns, led, position, is_held_to_it=is_held_to_it))

    def note_ticks(self, ticks: TickBatch, lost: int | None, *, is_homing: bool) -> None:
        """Take ticks.

        Parameters
        ----------
        ticks : TickBatch
            What was applied and measured.
        lost : int or None
            How many were lost before them; None: they cannot be true.
        is_homing : bool
            Whether the axis was asked to look for home: positions lose their meaning.
        """
        if lost is not None:
            found = self._watch.note_ticks(
                self._waking.ns, ticks, lost, is_homing=is_homing, has_home=not self.has_lost_home
            )
            self._report_found(found)

    def note_status(self, state: AxisState, activity: Activity, tick: int) -> None:
        """Take where the device says that it stands, and the tick that comes next [device ticks]."""
        if self._watch.is_homing and activity != "homing" and state == "homed":
            self.has_lost_home = False
        self._told_ns = self._waking.ns
        self._report_found(self._watch.note_status(state, activity, tick))
        is_over = not self._watch.is_led
        if self._stop is not None:
            self._stop.note_status(self._waking.ns, is_over=is_over)
        elif is_over and self.fault is not NO_FAULT:
            self._is_stopped = self._is_stopped or not self._is_seen_moving

    def note_fault(self, cause: Fault) -> None:
        """Take why the device says that it stopped; where that loses home, it does whatever the device believes."""
        self.has_lost_home = self.has_lost_home or cause.needs_home

    def note_done(self, kind: RequestKind | None) -> None:
        """Take note that the device did what it was asked for."""
        if kind == "home":
            self.has_lost_home = False
            self._watch.unsettle()

    # Stops --------------------------------------------------------------------------------------------

    def order_stop(self) -> None:
        """Take note that the host says stop from now on, and nothing else; said again, it gives no more time."""
        if self._stop is None:
            is_led = self._watch.is_led
            must_rest = is_led or self.fault is fault("stop_ignored")
            self._stop = StopPromise(must_rest=must_rest, is_over=not is_led)

    def note_stop_said(self, ramp_s: float = 0.0) -> None:
        """Take note that the stop leaves now: its time begins, which is that of the ramp from the present speed.

        Where the host itself leads the hub to rest, it knows how long that takes, ``ramp_s``.
        """
        if self._stop is not None:
            self._stop.say(self._waking.ns, max(ramp_s, self._watch.ramp_s))

    def note_stop_answered(self, *, is_over: bool = False) -> None:
        """Take note that the device says that it has stopped; ``is_over``: and that nothing moves the axis now."""
        if self._stop is not None:
            self._stop.answer(is_over=is_over)

    @property
    def is_stopping(self) -> bool:
        """Whether nothing but the stop may be said: the axis has not been seen at rest since it was told to stop."""
        return self._stop is not None

    def end_stop(self) -> bool:
        """Return whether the stop has acted: the device says so, and nothing that is seen says otherwise."""
        status_age_ns = self._waking.ns - self._told_ns
        if self._stop is None or not self._stop.has_acted(
            is_moving=self._is_seen_moving, status_age_ns=status_age_ns
        ):
            return False
        self._stop, self._is_stopped = None, True
        return True

    def take_broken(self) -> str:
        """Return what the axis did instead of stopping, once; else nothing."""
        broken, self._broken = self._broken, ""
        return broken

    @property
    def _is_seen_moving(self) -> bool:
        return self._watch.is_seen_moving(self._waking.ns)

    # What follows -------------------------------------------------------------------------------------

    def _report_found(self, found: Found) -> None:
        if found is not None:
            self.report(*found)

    def report(self, name: str, reason: str) -> None:
        """Take a fault and what was seen of it."""
        self._seen_ns = self._waking.ns
        self.has_lost_home = self.has_lost_home or fault(name).needs_home
        if self.fault is not NO_FAULT:
            return
        self.fault, self.reason = fault(name), reason
        self._is_stopped = False
        self._journal.tell(
            "error", f"{self.fault.sentence}: {reason}; the axis is stopped; {self.fault.remedy}"
        )

    @property
    def is_stop_due(self) -> bool:
        """Whether the device is to be told to stop now, because of the fault."""
        return not self._is_stopped and self._stop is None and self._silent_since_ns is None

    def must_be_silent(self, now_ns: int) -> bool:
        """Whether the host is silent now, because the device did not stop when it was told to."""
        if self._silent_since_ns is None:
            return False
        # A device holds its messages back from a host that is silent: none of them has stopped.
        self._missing.forget()
        if now_ns - self._silent_since_ns <= self._silence_ns:
            return True
        self._silent_since_ns = None
        return False

    def answer(self, kind: RequestKind, state: AxisState) -> Outcome | None:
        """Answer a request that the device must not hear, or need not; None where it shall.

        Parameters
        ----------
        kind : str
            What is asked for.
        state : str
            Where the device says that it stands.
        """
        if self.fault is NO_FAULT:
            if kind == "enable" and self.has_lost_home:
                return Outcome(False, "cannot enable: the axis is identified; home it first")
            return None
        if kind in ("enable", "home"):
            return Outcome(False, f"cannot {kind}: the axis is fault; clear the fault first ({self.reason})")
        if kind != "clear_fault":
            return None
        if self._waking.ns - self._seen_ns < GONE_NS or not self._is_stopped:
            still = "its cause is still there" if self._is_stopped else "the axis has not been seen at rest"
            return Outcome(False, f"cannot clear the fault: {still}: {self.reason}; {self.fault.remedy}")
        self.fault, self.reason = NO_FAULT, ""
        self._watch.forget_commands()
        return None if state == "fault" else Outcome(True, "fault cleared")

    def seen(self, status: HubStatus) -> HubStatus:
        """Return what the device says of itself as it has to be seen."""
        if self.fault is not NO_FAULT:
            return dataclasses.replace(
                status,
                state="fault",
                fault=self.fault,
                reason=self.reason,
                lacks_home=self.has_lost_home or status.state == "identified",
            )
        if self.has_lost_home and status.state == "homed":
            return dataclasses.replace(status, state="identified")
        return status
