"""Samples on lines of every speed: how many are under way, how often they are sent, what is thought of the line."""

from __future__ import annotations

import random
from collections import deque
from itertools import pairwise

import pytest

from beam_ros.hub.host.sample_window import SAMPLES_PER_FRAME, SampleWindow

TURN_NS = 5_000_000
FRAME_BYTES = 416


class Line:
    """A line that carries so many bytes in a second, one after the other, and acknowledges each frame that fits."""

    def __init__(self, bytes_per_s: float, delay_s: float = 0.002, loss: float = 0.0) -> None:
        self.bytes_per_s = bytes_per_s
        self.delay_ns = round(delay_s * 1e9)
        self.window = SampleWindow(10**9, 2 * self.delay_ns)
        self.n_sent = self.n_again = self.most_under_way = 0
        self._rng, self._loss = random.Random(1), loss
        self._free_ns = 0
        self._under_way: deque[tuple[int, int, int]] = deque()
        self._acknowledged: deque[tuple[int, int]] = deque()
        self._received = 0
        self.now_ns = 0

    def turn(self, edge: int) -> None:
        """Send what may be sent, of the samples before ``edge``, and let 5 ms pass."""
        window, now_ns = self.window, self.now_ns
        while (frame := window.next_frame(edge, now_ns)) is not None:
            first, end = frame
            self.n_again += window.send(first, end, now_ns)
            self.n_sent += end - first
            self._free_ns = max(self._free_ns, now_ns) + round(
                (16 + 8 * (end - first)) / self.bytes_per_s * 1e9
            )
            self._under_way.append((self._free_ns + self.delay_ns, first, end))
        self.most_under_way = max(self.most_under_way, len(self._under_way))
        self.now_ns += TURN_NS
        while self._under_way and self._under_way[0][0] <= self.now_ns:
            came_ns, first, end = self._under_way.popleft()
            if self._rng.random() < self._loss:
                continue
            if first <= self._received:
                self._received = max(self._received, end)
            self._acknowledged.append((came_ns + self.delay_ns, self._received))
        while self._acknowledged and self._acknowledged[0][0] <= self.now_ns:
            answered_ns, received = self._acknowledged.popleft()
            window.receive(received, max(answered_ns, self.now_ns - TURN_NS))

    def carry(self, samples: int, timeout_s: float = 60.0) -> float:
        """Bring so many samples over; return how long it took [s]."""
        begun_ns = self.now_ns
        while self.window.received < samples:
            # What was sent by halves leaves no whole frame at the end.
            self.turn(samples + (self.window.sent - samples) % SAMPLES_PER_FRAME)
            assert self.now_ns - begun_ns < timeout_s * 1e9, "not within time"
        return (self.now_ns - begun_ns) * 1e-9


@pytest.mark.parametrize("bytes_per_s", [500, 3_000, 11_520, 30_000, 92_160, 1_000_000])
def test_a_line_of_any_speed_is_used_and_never_flooded(bytes_per_s):
    line = Line(bytes_per_s)
    frames = 200
    took_s = line.carry(frames * SAMPLES_PER_FRAME, 400.0)
    assert took_s < 1.2 * frames * FRAME_BYTES / bytes_per_s + frames * 0.006
    # What is sent twice is what was sent before the first answer.
    assert line.n_again <= 6 * SAMPLES_PER_FRAME
    assert line.n_sent == line.window.sent + line.n_again
    # Another word waits for a tenth of a second, or for some frames where one takes longer than that.
    assert line.most_under_way <= max(6, 0.13 * bytes_per_s / FRAME_BYTES)


def test_a_far_but_fast_line_has_more_under_way():
    line = Line(1_000_000, delay_s=0.15)
    line.carry(5_000)
    begun_ns = line.now_ns
    line.carry(20_000)
    assert 15_000 / ((line.now_ns - begun_ns) * 1e-9) > 2_000
    assert line.n_again == 0


def test_a_line_that_becomes_slow_is_given_less():
    line = Line(1_000_000)
    line.carry(20_000)
    line.bytes_per_s = 3_000
    line.most_under_way = 0
    for _ in range(2_000):
        line.turn(100_000)
    # Some 22 frames in 10 s; what was under way when it became slow has gone.
    assert line.n_again <= 12 * SAMPLES_PER_FRAME
    assert len(line._under_way) <= 4
    line.bytes_per_s = 1_000_000
    line.carry(60_000, 20.0)


@pytest.mark.parametrize("loss", [0.02, 0.2])
def test_lost_frames_are_sent_again_soon_each_time(loss):
    line = Line(92_160, loss=loss)
    took_s = line.carry(20_000)
    assert line.n_again > 0
    # A frame that was lost costs 60 ms, and so does half of it, and then 120 ms, and so on.
    assert took_s < 400 * 0.02 + 400 * loss / (1 - loss) * 0.14


def test_samples_without_an_answer_are_sent_again_at_longer_and_longer_intervals():
    window = SampleWindow(SAMPLES_PER_FRAME, 0)
    sent = []
    for now_ms in range(9_000):
        frame = window.next_frame(10_000, now_ms * 1_000_000)
        if frame is not None:
            window.send(*frame, now_ms * 1_000_000)
            sent.append((now_ms, frame))
    waits = [b - a for (a, _), (b, _) in pairwise(sent)]
    assert waits == [61, 61, 121, 241, 481, 961, 1921, 2001, 2001]
    assert [frame for _, frame in sent] == [(0, 50), *[(0, 25)] * 9]


def test_the_rate_is_the_lines_and_not_that_of_who_has_nothing_to_send():
    line = Line(10_000)
    for k in range(1, 41):
        line.carry(k * SAMPLES_PER_FRAME)
        line.now_ns += 500_000_000
    assert line.window.rate == pytest.approx(50 * 10_000 / FRAME_BYTES, rel=0.2)


def test_another_word_waits_for_samples_that_are_under_way_but_not_for_ever():
    window = SampleWindow(1_000, 0)
    assert not window.is_line_taken(0)
    window.send(0, 50, 1_000_000)
    assert window.is_line_taken(2_000_000)
    window.send(50, 100, 400_000_000)
    window.receive(50, 500_000_000)
    assert window.is_line_taken(999_000_000)
    assert not window.is_line_taken(1_002_000_000)
    window.receive(100, 1_100_000_000)
    window.send(100, 150, 1_200_000_000)
    assert window.is_line_taken(1_300_000_000)


def test_half_a_frame_shows_whether_the_rest_is_lost_or_late():
    for comes, then in ((25, (25, 75)), (50, (100, 150)), (100, (100, 150))):
        window = SampleWindow(1_000, 0)
        for now_ns in (0, 1):
            frame = window.next_frame(1_000, now_ns)
            assert frame is not None
            window.send(*frame, now_ns)
        assert window.next_frame(1_000, 60_000_000) is None
        assert window.next_frame(1_000, 61_000_000) == (0, 25)
        assert window.send(0, 25, 61_000_000) == 25
        assert window.next_frame(1_000, 62_000_000) is None
        window.receive(comes, 70_000_000)
        assert window.next_frame(1_000, 71_000_000) == then
