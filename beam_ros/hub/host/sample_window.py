"""How many samples may be under way at once, and when they are taken for lost: the line itself shows it.

A line carries in order what it is given, at a speed that the host does not know: what is sent beyond it waits, and
makes the next word to the axis wait. So the window grows while frames are acknowledged about as soon as the quickest
was, and is halved where they wait for long (the idea of LEDBAT, RFC 6817).

Where nothing was acknowledged for longer than frames take by mean and deviation (RFC 6298), the host cannot know
whether they are lost or only late, and on a slow line everything sent twice would make it slower still. So it asks
first: half a frame is sent again, and in vain again at longer and longer intervals. A device that then has exactly
this half has lost the rest, for it takes no samples behind a gap; one that has more received the first frame late.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

SAMPLES_PER_FRAME = 50
MIN_PATIENCE_NS = 60_000_000
"""Half a frame is sent again when nothing has been acknowledged for this long, or longer on a slow line ..."""
MAX_PATIENCE_NS = 2_000_000_000
"""... but not longer than this."""
FIRST_FRAMES = 2
"""Under way at first: 80 ms of a line at 115 200 baud."""
MAX_FRAMES = 16
QUEUE_NS = 40_000_000
"""Frames that wait in the line for less leave room for more; those that wait for twice as long are too many."""
MAX_BUSY_NS = 1_000_000_000
"""A line that was never without samples for this long will not be soon."""


class _Frame(NamedTuple):
    end: int
    sent_ns: int
    fills: bool
    """Whether the window had no room after it."""


class _FrameTimes:
    """How long frames take until they are acknowledged: mean and deviation as RFC 6298 has them, and the shortest.

    Parameters
    ----------
    round_trip_ns : int
        What a short word takes [ns], for the patience with the first frame.
    """

    def __init__(self, round_trip_ns: int) -> None:
        self.patience_ns = MIN_PATIENCE_NS + round_trip_ns
        self._shortest_ns = self._mean_ns = self._deviation_ns = 0

    def learn(self, took_ns: int) -> int:
        """Take the time of a frame [ns]; return how much of it the frame waited."""
        if not self._mean_ns:
            self._shortest_ns, self._mean_ns, self._deviation_ns = took_ns, took_ns, took_ns // 2
        self._shortest_ns = min(self._shortest_ns, took_ns)
        self._deviation_ns += (abs(took_ns - self._mean_ns) - self._deviation_ns) // 4
        self._mean_ns += (took_ns - self._mean_ns) // 8
        self.patience_ns = max(self._mean_ns + 4 * self._deviation_ns, MIN_PATIENCE_NS)
        return took_ns - self._shortest_ns


class SampleWindow:
    """The samples of one sequence that are under way to the device, and what the line makes of them.

    Parameters
    ----------
    n_samples : int
        Of the whole sequence.
    round_trip_ns : int
        What the line takes for a short word and its answer [ns], as far as is known.

    Attributes
    ----------
    sent, received : int
        Samples that have been sent, and those that came without a gap.
    """

    def __init__(self, n_samples: int, round_trip_ns: int) -> None:
        self.sent = self.received = 0
        self._n_samples = n_samples
        self._frames: deque[_Frame] = deque()
        self._n_frames = FIRST_FRAMES
        self._times = _FrameTimes(round_trip_ns)
        self._n_in_vain = 0
        self._probe = 0
        self._farthest = self._halved = 0
        self._moved_ns = self._busy_since_ns = self._busy_ns = 0

    @property
    def rate(self) -> float:
        """Samples that the line carried in a second while some were under way [1/s]; 0 before the first came."""
        return self.received * 1e9 / self._busy_ns if self._busy_ns else 0.0

    def is_line_taken(self, now_ns: int) -> bool:
        """Whether samples are under way that others should wait for; they need not wait for a second."""
        return self.sent > self.received and now_ns - self._busy_since_ns < MAX_BUSY_NS

    def next_frame(self, edge: int, now_ns: int) -> tuple[int, int] | None:
        """Return which samples, from the first to before the second, are to be sent now; None where none are.

        Parameters
        ----------
        edge : int
            The device has room for the samples before this one.
        now_ns : int
            Steady time [ns].
        """
        patience_ns = min(self._times.patience_ns << max(0, self._n_in_vain - 1), MAX_PATIENCE_NS)
        if self.sent > self.received and now_ns - self._moved_ns > patience_ns:
            return self.received, self.received + max(1, (self._frames[0].end - self.received) // 2)
        end = min(self.sent + SAMPLES_PER_FRAME, edge, self._n_samples)
        # Whole frames, unless it is the end: a sample at a time would cost a frame each.
        is_whole = end == self.sent + SAMPLES_PER_FRAME or end == self._n_samples
        return (self.sent, end) if end > self.sent and is_whole and self._has_room else None

    def send(self, first: int, end: int, now_ns: int) -> int:
        """Note that ``next_frame`` is sent; return how many of its samples are sent again."""
        n_again = max(0, min(end, self._farthest) - first)
        self._farthest = max(self._farthest, end)
        if first < self.sent:
            self._busy_ns += now_ns - self._moved_ns
            self._moved_ns = now_ns
            self._n_in_vain += 1
            self._probe = end
            return n_again
        if self.sent == self.received:
            self._moved_ns = self._busy_since_ns = now_ns
        self.sent = end
        self._frames.append(_Frame(end, now_ns, not self._has_room))
        return n_again

    def receive(self, received: int, now_ns: int) -> None:
        """Note how many samples have come without a gap, as the device says at steady time ``now_ns``."""
        if received <= self.received:
            return
        self._busy_ns += now_ns - self._moved_ns
        self._moved_ns = now_ns
        self.received = received
        is_rest_lost = bool(self._frames) and self._probe == received < self._frames[0].end
        self._n_in_vain = self._probe = 0
        if is_rest_lost:
            self._frames.clear()
            self.sent = received
            self._n_frames = max(1, self._n_frames // 2)
        while self._frames and self._frames[0].end <= received:
            self._learn(self._frames.popleft(), now_ns)

    @property
    def _has_room(self) -> bool:
        return not self._probe and self.sent - self.received < self._n_frames * SAMPLES_PER_FRAME

    def _learn(self, frame: _Frame, now_ns: int) -> None:
        """Take from the time of one frame how many there may be."""
        waited_ns = self._times.learn(now_ns - frame.sent_ns)
        if waited_ns < QUEUE_NS and frame.fills:
            self._n_frames = min(self._n_frames + 1, MAX_FRAMES)
        elif waited_ns > 2 * QUEUE_NS and frame.end > self._halved:
            # All that is under way has seen the same queue: once for them.
            self._halved = self.sent
            self._n_frames = max(1, self._n_frames // 2)
