"""What a firmware gets wrong on request, though its line and its axis are in order: the lies of ``KINDS``."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field

import numpy as np

from beam_ros.hub.emulated.injected_faults import InjectedFault
from beam_ros.hub.line.protocol import ReplyPhase
from beam_ros.hub.ticks import TickBatch

ANSWERS: tuple[ReplyPhase | None, ...] = (None, "success", "pending")
"""What a firmware says that ignores a stop, by the number in a schedule."""


@dataclass
class Lies:
    """The lies of the moment; at first none.

    Attributes
    ----------
    clock_step_ns, clock_wrap_ns : int
        What is added to every time that is named, and the time at which it begins anew, 0 for never [ns].
    ignores_stops : bool
        Whether stops are ignored, and answered with ``stop_answer``.
    stop_answer : str or None
        success, pending, or nothing.
    no_numbers : float
        Share of the ticks that say NaN for what was applied.
    misses : int
        One tick in so many is missed, and the others numbered as if it had not been; 0: none.
    """

    clock_step_ns: int = 0
    clock_wrap_ns: int = 0
    ignores_stops: bool = False
    stop_answer: ReplyPhase | None = None
    no_numbers: float = 0.0
    misses: int = 0
    _n_seen: int = 0
    _n_missed: int = 0
    _rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(1))

    def change(self, fault: InjectedFault, *, begins: bool) -> None:
        """Let a fault of the clock or the firmware begin or end."""
        amounts = fault.amounts
        if fault.kind == "step":
            self.clock_step_ns += round(amounts["seconds"] * 1e9)
        elif fault.kind == "wrap":
            self.clock_wrap_ns = 2 ** round(amounts["bits"]) if begins else 0
        elif fault.kind == "ignored_stop":
            self.ignores_stops, self.stop_answer = begins, ANSWERS[round(amounts["answer"])]
        elif fault.kind == "no_number":
            self.no_numbers = amounts["share"] if begins else 0.0
        elif fault.kind == "missed_ticks":
            self.misses = round(amounts["one_in"]) if begins else 0

    def told_ns(self, device_ns: int) -> int:
        """Return the time [ns] that is named for a true one."""
        told_ns = max(0, device_ns + self.clock_step_ns)
        return told_ns % self.clock_wrap_ns if self.clock_wrap_ns else told_ns

    def ahead_ns(self, told_ns: int, now_ns: int) -> int:
        """Return how far ahead of now [ns] a time is that the host names [ns]: of its names, the nearest."""
        ahead_ns, wrap_ns = told_ns - self.told_ns(now_ns), self.clock_wrap_ns
        return (ahead_ns + wrap_ns // 2) % wrap_ns - wrap_ns // 2 if wrap_ns else ahead_ns

    def told_tick(self, tick: int, period_ns: int) -> int:
        """Return the number that is named for a tick."""
        return (self.told_ns(tick * period_ns) // period_ns) - self._n_missed

    def told(self, ticks: TickBatch, period_ns: int) -> TickBatch:
        """Return ticks as they are reported."""
        first_tick = self.told_tick(ticks.first_tick, period_ns)
        if self.misses:
            before, self._n_seen = self._n_missed, self._n_seen + len(ticks)
            # A batch is at most one tick short: what it lacks was the first.
            self._n_missed += (self._n_seen // self.misses) > (self._n_seen - len(ticks)) // self.misses
            ticks = ticks[self._n_missed - before :]
        if self.no_numbers:
            is_none = self._rng.random(len(ticks)) < self.no_numbers
            ticks = dataclasses.replace(ticks, applied=np.where(is_none, np.nan, ticks.applied))
        return dataclasses.replace(ticks, first_tick=first_tick)
