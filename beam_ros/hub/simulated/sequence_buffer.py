"""The device's buffer for the samples of one sequence."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from beam_ros.hub.contract import Outcome


class SequenceBuffer:
    """The samples of the present sequence that have come and were not applied yet.

    Parameters
    ----------
    capacity : int or None
        Room for samples; None: no limit.
    looks_ahead : bool
        Whether a tick's command is the sample after its own, towards which the hub moves (position mode).

    Attributes
    ----------
    start_tick : int
        The tick of the first sample.
    n_samples, n_received : int
        Samples of the sequence in all, and those that have come.
    """

    def __init__(self, capacity: int | None, *, looks_ahead: bool) -> None:
        self.start_tick = 0
        self.n_samples = 0
        self.n_received = 0
        self._n_applied = 0
        self._capacity = capacity
        self._ahead = 1 if looks_ahead else 0
        self._samples: deque[float] = deque()

    @property
    def free(self) -> int:
        """Samples that the buffer still has room for."""
        if self._capacity is None:
            return max(0, self.n_samples - self.n_received)
        return self._capacity - len(self._samples)

    @property
    def is_used_up(self) -> bool:
        """Whether every sample has been applied."""
        return self._n_applied == self.n_samples - self._ahead

    @property
    def awaited_sample(self) -> int:
        """Number of the sample that the next tick needs, counted from 0."""
        return self._n_applied + self._ahead

    def announce(self, start_tick: int, n_samples: int) -> None:
        """Make ready for a sequence."""
        self._samples.clear()
        self.start_tick, self.n_samples = start_tick, n_samples
        self.n_received = self._n_applied = 0

    def append(self, first: int, values: Sequence[float]) -> Outcome:
        """Take the next samples of the sequence.

        Parameters
        ----------
        first : int
            Number of the first of them in the sequence; samples come in order, without a gap.
        values : sequence of float
            Samples in the command mode's unit.
        """
        if first != self.n_received:
            return Outcome(False, f"samples from {first} on: expected them from {self.n_received} on")
        if first + len(values) > self.n_samples:
            return Outcome(False, f"samples to {first + len(values)}: the sequence has {self.n_samples}")
        if len(values) > self.free:
            return Outcome(False, f"{len(values)} samples: the buffer has room for {self.free}")
        self._samples.extend(values)
        self.n_received += len(values)
        return Outcome(True, "samples taken")

    def take(self) -> float | None:
        """Return the next tick's command, or None where it has not come."""
        if self._ahead and self._n_applied == 0 and self._samples:
            self._samples.popleft()
        if not self._samples:
            return None
        self._n_applied += 1
        return self._samples.popleft()

    def clear(self) -> None:
        """Throw away what was not applied."""
        self._samples.clear()
