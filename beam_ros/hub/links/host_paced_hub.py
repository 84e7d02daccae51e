"""What every hub with a ``HostAxis`` has in common: one lock, and the calls of ``Hub``."""

from __future__ import annotations

import threading
import time

from beam_ros.hub.contract import HostTime, HubCapabilities, HubReport, Outcome, RequestKind, SequenceChunk
from beam_ros.hub.links.host_axis import HostAxis
from beam_ros.hub.links.query_line import SteadyTime

CLOSE_S = 1.0
"""Longest wait for the axis to rest on closing [s]."""


class HostPacedHub:
    """A hub that the host leads; implements ``Hub``.

    A link derives its own from it, and leads the axis in a thread of its own, under ``lock``.

    Parameters
    ----------
    axis : HostAxis
        States and plan.
    capabilities : HubCapabilities
        What the controller can promise.
    steady : SteadyTime, optional
        The clock.
    """

    def __init__(
        self, axis: HostAxis, capabilities: HubCapabilities, steady: SteadyTime | None = None
    ) -> None:
        self.lock = threading.Lock()
        self.axis = axis
        self.steady = steady or SteadyTime()
        self._capabilities = capabilities

    @property
    def capabilities(self) -> HubCapabilities:
        """What the axis can promise."""
        return self._capabilities

    def request(self, kind: RequestKind) -> int:
        """Ask for a change of state; its number appears in ``HubReport.completed`` when it is over."""
        with self.lock:
            return self.axis.request(kind, self.steady.now_ns())

    def setpoint(self, stamp_ns: int, value: float, now: HostTime) -> Outcome:
        """Hand over one set-point in the command mode's unit, stamped [ns, UNIX] by who made it."""
        with self.lock:
            return self.axis.setpoint(stamp_ns, value, now)

    def load(self, chunk: SequenceChunk, now: HostTime) -> None:
        """Hand over one chunk of a sequence; what became of it appears in ``HubReport.sequences``."""
        with self.lock:
            self.axis.load(chunk, now)

    def poll(self, now: HostTime) -> HubReport:
        """Say that the host is alive, and collect what happened."""
        with self.lock:
            return self.axis.poll(now)

    def close(self) -> None:
        """Stop the axis and wait until it rests; a link then lets go of its controller."""
        self.request("stop")
        end = time.monotonic() + CLOSE_S
        while time.monotonic() < end:
            with self.lock:
                if not self.axis.is_powered:
                    return
            time.sleep(0.005)
