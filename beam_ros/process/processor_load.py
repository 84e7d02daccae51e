"""How busy this computer is, and how much of its processors a process got: why something may have come too late."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

_BUSY_SHARE = 0.25
"""Processes that waited for more than this share of the time that they wanted were held up by others."""


@dataclass(frozen=True)
class ProcessorLoad:
    """What the processors were asked for.

    Attributes
    ----------
    load : float -- processes that ran or wanted to, in the mean over the last minute
    n_processors : int -- that this process may use
    waiting_share : float or None -- of the time in which some processes wanted a processor, how much they waited for
        one; None where the kernel does not say
    """

    load: float
    n_processors: int
    waiting_share: float | None = None

    @property
    def is_busy(self) -> bool:
        """Whether others took what was wanted."""
        if self.waiting_share is not None:
            return self.waiting_share > _BUSY_SHARE
        return self.load > self.n_processors

    def sentence(self) -> str:
        """Say it to a person, with the likely cause."""
        parts = [f"this computer has {self.n_processors} processors and a load of {self.load:.1f}"]
        if self.waiting_share is not None:
            parts.append(
                f"the nodes waited for {self.waiting_share:.0%} of the time that they wanted a processor"
            )
        parts.append(
            "end other programs that take the processors"
            if self.is_busy
            else "that is not too much, so that the cause is another one: look at the nodes' logs"
        )
        return "; ".join(parts)


def processor_load(pids: Iterable[int] = ()) -> ProcessorLoad:
    """Look at the load of this computer, and at what some running processes got of it since they started.

    Parameters
    ----------
    pids : iterable of int
    """
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    times = [_ran_and_waited_ns(pid) for pid in pids]
    ran_ns, waited_ns = (sum(column) for column in zip(*times, strict=True)) if times else (0, 0)
    wanted_ns = ran_ns + waited_ns
    return ProcessorLoad(os.getloadavg()[0], usable, waited_ns / wanted_ns if wanted_ns else None)


def _ran_and_waited_ns(pid: int) -> tuple[int, int]:
    """Return how long the threads of a process ran, and waited for a processor [ns]; zeros where nobody says."""
    ran_ns = waited_ns = 0
    for schedule in Path(f"/proc/{pid}/task").glob("*/schedstat"):
        try:
            ran, waited, _ = schedule.read_text().split()
        except (OSError, ValueError):
            continue  # The thread has ended meanwhile, or the kernel keeps no such figures.
        ran_ns += int(ran)
        waited_ns += int(waited)
    return ran_ns, waited_ns
