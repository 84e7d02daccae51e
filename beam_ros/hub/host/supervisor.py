"""What the host watches while it is connected, whatever the link: motion, telemetry, status, clock.

The first thing that is wrong becomes the fault. It stays until it is cleared, which needs that its cause is gone.
From the moment on, the device is asked to stop; where it does not say that the axis rests, the host falls silent, so
that the device's own watchdog acts.
"""

from __future__ import annotations

import dataclasses

from beam_ros.hub.contract import Activity, AxisState, HubStatus, Outcome, RequestKind
from beam_ros.hub.faults import NO_FAULT, Fault, fault
from beam_ros.hub.host.motion_watch import MotionWatch
from beam_ros.hub.journal import Journal
from beam_ros.hub.parameters import AxisParameters
from beam_ros.hub.ticks import TickBatch

MISSING_NS = 400_000_000
"""Other messages come for so long, and what is missing does not: then it has stopped."""
NAP_NS = 20_000_000
"""Between two looks at the clock no more than this counts as waiting: the process may have been put aside."""
GONE_NS = 250_000_000
"""A cause that was not seen for so long is gone."""
ANSWER_NS = 300_000_000
"""A stop is answered within this time and that of the ramp, or the host falls silent."""
UNSETTLED_BATCHES = 10
"""The ticks of a change come within so many batches after it was reported."""


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
        ramp_ns = round(parameters.max_speed / parameters.stop_deceleration * 1e9)
        self._answer_ns = ANSWER_NS + ramp_ns
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
        self._stop_asked_ns: int | None = None
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
        self._stop_asked_ns = self._silent_since_ns = None

    def look(self, now_ns: int) -> None:
        """Take the time, at least every 20 ms; a process that was put aside did not wait in the meantime."""
        if self._looked_ns is not None:
            self._awake_ns += min(max(0, now_ns - self._looked_ns), NAP_NS)
        self._looked_ns = now_ns

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
        if self.fault is not NO_FAULT and state != "enabled" and activity == "idle":
            self._is_stopped = True

    def note_done(self, kind: RequestKind | None) -> None:
        """Take note that the device did what it was asked for."""
        if kind == "stop":
            self._is_stopped = True
        elif kind == "home":
            self.has_lost_home = False
            self._unsettle()

    def report(self, name: str, reason: str) -> None:
        """Take a fault and what was seen of it."""
        self._seen_ns = self._awake_ns
        self.has_lost_home = self.has_lost_home or fault(name).needs_home
        if self.fault is not NO_FAULT:
            return
        self.fault, self.reason = fault(name), reason
        self._is_stopped = False
        self._stop_asked_ns = self._silent_since_ns = None
        self._journal.tell(
            "error", f"{self.fault.sentence}: {reason}; the axis is stopped; {self.fault.remedy}"
        )

    # What follows -------------------------------------------------------------------------------------

    def is_stop_due(self, now_ns: int) -> bool:
        """Whether the device is to be asked for a stop now."""
        if self._is_stopped or self._stop_asked_ns is not None:
            return False
        self._stop_asked_ns = now_ns
        return True

    def must_be_silent(self, now_ns: int) -> bool:
        """Whether the host falls silent now, because the device did not stop when it was asked to."""
        if self._is_stopped or self._stop_asked_ns is None:
            return False
        if self._silent_since_ns is None:
            if now_ns - self._stop_asked_ns <= self._answer_ns:
                return False
            self._silent_since_ns = now_ns
            self._journal.tell(
                "error", "the controller did not stop when it was asked to: the host falls silent"
            )
        if now_ns - self._silent_since_ns <= self._silence_ns:
            return True
        self._stop_asked_ns = self._silent_since_ns = None
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
