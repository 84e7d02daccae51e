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
from beam_ros.hub.host.hold_watch import HoldWatch
from beam_ros.hub.host.motion_watch import MotionWatch
from beam_ros.hub.host.rest_watch import RestWatch
from beam_ros.hub.journal import Journal
from beam_ros.hub.parameters import AxisParameters
from beam_ros.hub.ticks import TickBatch

MISSING_NS = 400_000_000
"""Other messages come for so long, and what is missing does not: then it has stopped."""
NAP_NS = 20_000_000
"""Between two looks at the clock no more than this counts as waiting: the process may have been put aside."""
GONE_NS = 250_000_000
"""What was not seen for so long is gone."""
REST_NS = 300_000_000
"""A stop has acted, and is seen to have acted, within this time and that of the ramp: 50 ms of rest, the batches that
show it, and a line on which half of the frames are lost."""
UNANSWERED_NS = 1_000_000_000
"""A stop of an axis that rests has been answered by then."""
NO_NUMBERS = 3
"""So many ticks in a row of which the device says no number are a fault."""
UNSETTLED_BATCHES = 10
"""The ticks of a change come within so many batches after it was reported."""


@dataclasses.dataclass
class _Stop:
    """An order to stop; times of waking [ns]."""

    must_rest: bool
    is_over: bool
    said_ns: int | None = None
    rest_by_ns: int = 0
    is_answered: bool = False
    is_contradicted: bool = False


class Supervisor:
    """Finds what is wrong with the axis, and sees to it that it stops.

    Parameters
    ----------
    parameters : AxisParameters
        Limits, tick and watchdog.
    journal : Journal
        Is told of faults.

    Attributes
    ----------
    fault : Fault
        What was found first and has not been cleared; ``NO_FAULT`` while all is well.
    reason : str
        What was seen, with its numbers.
    has_lost_home : bool
        Whether the axis must be homed before it is enabled, whatever the device believes.
    """

    def __init__(self, parameters: AxisParameters, journal: Journal) -> None:
        self.fault: Fault = NO_FAULT
        self.reason = ""
        self.has_lost_home = False
        self._journal = journal
        self._motion = MotionWatch(parameters)
        self._hold = HoldWatch(parameters)
        ramp_ns = round(parameters.max_speed / parameters.stop_deceleration * 1e9)
        self._deceleration = parameters.stop_deceleration
        self._rest = RestWatch(parameters)
        self._silence_ns = (
            round(parameters.watchdog_s * 1e9) + ramp_ns + 2 * parameters.batch_ns + 100_000_000
        )
        self._missing_ns = max(MISSING_NS, 4 * parameters.batch_ns)
        self._state: AxisState = "disconnected"
        self._is_homing = False
        self._tick = 0
        self._unsettled: tuple[int, int] | None = None
        self._looked_ns: int | None = None
        self._awake_ns = 0
        self._seen_ns = 0
        self._without: dict[str, int] = {}
        self._stop: _Stop | None = None
        self._broken = ""
        self._measured_ns = self._told_ns = 0
        self._n_no_numbers = 0
        self._silent_since_ns: int | None = None
        self._is_stopped = True

    # What is seen -------------------------------------------------------------------------------------

    def connect(self) -> None:
        """Begin a connection."""
        self._state = "disconnected"
        self._is_homing = False
        self._unsettled = None
        self._without.clear()
        self._motion.forget()
        self._hold.forget()
        self._rest.forget()
        self._stop = self._silent_since_ns = None

    def look(self, now_ns: int) -> None:
        """Take the time, at least every 20 ms; a process that was put aside did not wait in the meantime."""
        if self._looked_ns is not None:
            self._awake_ns += min(max(0, now_ns - self._looked_ns), NAP_NS)
        self._looked_ns = now_ns
        if self._stop is not None:
            self._hold_to(self._stop, now_ns)

    def hear(self, kind: str) -> None:
        """Take note of a message: ``telemetry``, ``status`` or ``other``; look for what is missing beside it."""
        for missing in ("telemetry", "status"):
            if missing == kind:
                self._without.pop(missing, None)
                continue
            since_ns = self._without.setdefault(missing, self._awake_ns)
            if self._awake_ns - since_ns > self._missing_ns:
                self.report(
                    f"{missing}_stopped", f"no {missing} for {(self._awake_ns - since_ns) * 1e-9:.2f} s"
                )

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
        if lost is None:
            return
        self._rest.add(ticks)
        self._measured_ns = self._awake_ns
        if self._is_homing or is_homing:
            self._motion.forget()
            return
        if self._unsettled is not None:
            tick, patience = self._unsettled
            n_old = tick - ticks.first_tick
            if patience > 0 and n_old >= len(ticks):
                self._unsettled = tick, patience - 1
                return
            self._unsettled = None
            if 0 < n_old < len(ticks):
                ticks, lost = ticks[n_old:], 0
        found = self._motion.find(
            ticks,
            lost,
            is_homed=self._state in ("homed", "enabled", "fault") and not self.has_lost_home,
            is_enabled=self._state == "enabled",
        )
        self._hold.add(ticks, lost)
        if found is not None:
            self.report(*found)

    def note_status(self, state: AxisState, activity: Activity, tick: int) -> None:
        """Take where the device says that it stands, and the tick that comes next [device ticks]."""
        is_homing = activity == "homing"
        if self._is_homing and not is_homing and state == "homed":
            self.has_lost_home = False
        self._tick = tick
        is_first = self._state == "disconnected"
        if is_first or is_homing != self._is_homing or (state == "enabled") > (self._state == "enabled"):
            self._unsettle()
        self._state, self._is_homing = state, is_homing
        self._told_ns = self._awake_ns
        self._watch_hold(tick if state == "enabled" and activity == "hold" else None)
        self._watch_stop(is_over=state != "enabled" and activity == "idle")

    def _watch_hold(self, held_until: int | None) -> None:
        """Take until which tick the device says that it holds the hub; None where it does not."""
        if held_until is None:
            self._hold.forget()
        elif (crept := self._hold.find(held_until)) is not None:
            self.report(*crept)

    def _watch_stop(self, *, is_over: bool) -> None:
        """Take whether the device says that nothing moves the axis any more."""
        stop = self._stop
        if stop is not None:
            stop.is_over = is_over
            is_late = stop.said_ns is not None and self._awake_ns > stop.rest_by_ns
            stop.is_contradicted = is_late and stop.is_answered and not is_over
        elif is_over and self.fault is not NO_FAULT:
            self._is_stopped = self._is_stopped or not self._is_seen_moving

    def note_fault(self, cause: Fault) -> None:
        """Take why the device says that it stopped; where that loses home, it does whatever the device believes."""
        self.has_lost_home = self.has_lost_home or cause.needs_home

    def note_done(self, kind: RequestKind | None) -> None:
        """Take note that the device did what it was asked for."""
        if kind == "home":
            self.has_lost_home = False
            self._unsettle()

    # Stops --------------------------------------------------------------------------------------------

    def order_stop(self) -> None:
        """Take note that the host says stop from now on, and nothing else; said again, it gives no more time."""
        if self._stop is not None:
            return
        is_over = self._state != "enabled" and not self._is_homing
        # A hub whose drive is off may be pushed by hand, whatever it was told.
        must_rest = not is_over or self.fault is fault("stop_ignored")
        self._stop = _Stop(must_rest, is_over)

    def note_stop_said(self) -> None:
        """Take note that the stop leaves now: its time begins, which is that of the ramp from the present speed."""
        if self._stop is not None and self._stop.said_ns is None:
            ramp_ns = round(1e9 * self._rest.speed / self._deceleration)
            self._stop.said_ns, self._stop.rest_by_ns = self._awake_ns, self._awake_ns + ramp_ns + REST_NS

    def note_stop_answered(self) -> None:
        """Take note that the device says that it has stopped."""
        if self._stop is not None:
            self._stop.is_answered = True

    @property
    def is_stopping(self) -> bool:
        """Whether nothing but the stop may be said: the axis has not been seen at rest since it was told to stop."""
        return self._stop is not None

    def end_stop(self) -> bool:
        """Return whether the stop has acted: the device says so, and nothing that is seen says otherwise."""
        stop = self._stop
        if stop is None or not stop.is_answered or (stop.must_rest and self._is_seen_moving):
            return False
        if not stop.is_over and self._awake_ns - self._told_ns < GONE_NS:
            return False
        self._stop, self._is_stopped = None, True
        return True

    def take_broken(self) -> str:
        """Return what the axis did instead of stopping, once; else nothing."""
        broken, self._broken = self._broken, ""
        return broken

    @property
    def _is_seen_moving(self) -> bool:
        """Whether what was measured shows a motion, and is not too old to say so."""
        return self._rest.is_moving and self._awake_ns - self._measured_ns < GONE_NS

    def _hold_to(self, stop: _Stop, now_ns: int) -> None:
        """Look whether a stop has come to its time and the axis not to rest."""
        if stop.said_ns is None:
            return
        waited_s = (self._awake_ns - stop.said_ns) * 1e-9
        if self._awake_ns > stop.rest_by_ns and stop.must_rest and self._is_seen_moving:
            seen = f"it moves with {self._rest.speed:.3g} m/s"
        elif stop.is_contradicted:
            seen = "the controller says that it is stopped, and that it is enabled or at work"
        elif self._awake_ns > stop.said_ns + UNANSWERED_NS:
            seen = "the controller did not answer"
        else:
            return
        self._broken = f"the axis did not come to rest within {waited_s:.2f} s after it was told to: {seen}"
        self.report("stop_ignored", self._broken)
        self._journal.tell("error", f"{self._broken}: the host falls silent")
        self._stop, self._silent_since_ns = None, now_ns

    def report(self, name: str, reason: str) -> None:
        """Take a fault and what was seen of it."""
        self._seen_ns = self._awake_ns
        self.has_lost_home = self.has_lost_home or fault(name).needs_home
        if self.fault is not NO_FAULT:
            return
        self.fault, self.reason = fault(name), reason
        self._is_stopped = False
        self._journal.tell(
            "error", f"{self.fault.sentence}: {reason}; the axis is stopped; {self.fault.remedy}"
        )

    # What follows -------------------------------------------------------------------------------------

    @property
    def is_stop_due(self) -> bool:
        """Whether the device is to be told to stop now, because of the fault."""
        return not self._is_stopped and self._stop is None and self._silent_since_ns is None

    def must_be_silent(self, now_ns: int) -> bool:
        """Whether the host is silent now, because the device did not stop when it was told to."""
        if self._silent_since_ns is None:
            return False
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
        if self._awake_ns - self._seen_ns < GONE_NS or not self._is_stopped:
            still = "its cause is still there" if self._is_stopped else "the axis has not been seen at rest"
            return Outcome(False, f"cannot clear the fault: {still}: {self.reason}; {self.fault.remedy}")
        self.fault, self.reason = NO_FAULT, ""
        self._motion.forget()
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

    def _unsettle(self) -> None:
        """Take no notice of the motion before the newest status: positions or commands meant something else."""
        self._unsettled = self._tick, UNSETTLED_BATCHES
        self._motion.forget()
        self._hold.forget()
