"""What every hub with a ``HostAxis`` has in common: one lock, and the calls of ``Hub``."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod

from beam_ros.hub.contract import HostTime, HubCapabilities, HubReport, Outcome, RequestKind, SequenceChunk
from beam_ros.hub.links.host_axis import HostAxis
from beam_ros.hub.links.query_line import SteadyTime

CLOSE_NS = 1_000_000_000
"""Longest wait for the axis to rest on closing [ns]."""


class HostPacedHub(ABC):
    """A hub that the host leads; implements ``Hub``.

    A link derives its own from it, and leads the axis in ``turn``, under ``lock``: in a thread of its own, or in the
    caller's time.

    Parameters
    ----------
    axis : HostAxis
        States and plan.
    capabilities : HubCapabilities
        What the controller can promise.
    steady : SteadyTime, optional
        A clock of the caller's, who then calls ``turn`` again and again; else a thread does.
    """

    def __init__(
        self, axis: HostAxis, capabilities: HubCapabilities, steady: SteadyTime | None = None
    ) -> None:
        self.lock = threading.Lock()
        self.axis = axis
        self.steady = steady or SteadyTime()
        self._capabilities = capabilities
        self._thread = threading.Thread(target=self._run, name=capabilities.name, daemon=True)

    def _begin(self, steady: SteadyTime | None) -> None:
        """Let a thread take the turns, where the caller brought no clock."""
        if steady is None:
            self._thread.start()

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
        """Stop the axis, wait until it rests, and let go of its controller."""
        if self.steady.is_over:
            return
        self.request("stop")
        end_ns = self.steady.now_ns() + CLOSE_NS
        while self.axis.is_powered and self.steady.now_ns() < end_ns:
            self.steady.wait(0.005)
        self.steady.end()
        if self._thread.is_alive():
            self._thread.join(timeout=2.0)

    @abstractmethod
    def turn(self) -> None:
        """Do what is due, and wait for what is due next."""

    @abstractmethod
    def _let_go(self) -> None:
        """Let go of the controller behind the last turn."""

    def _run(self) -> None:
        while not self.steady.is_over:
            self.turn()
        self._let_go()
