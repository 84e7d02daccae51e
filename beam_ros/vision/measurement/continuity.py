"""Whether every frame arrived once and in order, judged by stamps and sequence numbers.

A camera that drops a frame leaves a gap of about two periods, one that repeats a frame (or a transport that
delivers it twice) the same stamp or the same number again. Nothing is repaired here: what is missing stays
missing, what is repeated is to be thrown away, and both are counted. Frames have their places on a lattice of
periods: one that came so late that its place seemed empty is not missing. The period is measured: a camera whose
frames come evenly at another rate than it should have loses none, nor does one whose stamps jitter so much that they
lie on no lattice of periods, on which alone a loss could be seen.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from statistics import median
from typing import Literal

from beam_ros.vision.errors import VisionParameterError

Step = Literal["first", "next", "gap", "repeated", "backwards"]
"""How a frame follows the one before: first of all; next in line; after a gap; the same one again; with a
stamp before that of an earlier frame."""

_FOLLOWED = 0.25
"""Share by which a frame moves the lattice: stamps that jitter by 0.4 periods leave it by less than half a one, and a
period that is wrong by a tenth moves it by 0.4."""
_SLOW = _FOLLOWED**2 / 4.0
"""Share of its distance from the lattice by which a frame changes the period: both together are critically damped."""
_ANOTHER = 1.1
"""A period that differs by this factor is another one."""
_FAR = 2.0
"""Frames that come so many times faster in the mean are more than any that waited. Intervals that are all a small
part of a period would else pass for none of it, which is on the lattice, too."""
_EVEN_FRAMES = 9
"""So many intervals show that a camera has another rate, ..."""
_UNEVEN_FRAMES = 1
"""... of which so many may differ from their median by more than ..."""
_EVEN = 0.2
"""... this share of it: a transport that loses frames does not lose them so evenly."""
_JITTERY_FRAMES = 64
"""So many intervals show whether stamps that jitter lie on a lattice of periods: the mean cosine of their phases is 0
without one, 0.6 where each stamp is off by up to a fifth of a period, and known to 1 / sqrt(2 n), which is 0.09."""
_NO_LATTICE = 3.0 / math.sqrt(2 * _JITTERY_FRAMES)


@dataclass(frozen=True)
class FrameStep:
    """How a frame follows the last one that counted.

    Attributes
    ----------
    step : Step
    missing : int -- frames left out in between
    """

    step: Step
    missing: int = 0

    @property
    def is_usable(self) -> bool:
        """False for a frame that was seen before or comes from the past."""
        return self.step in ("first", "next", "gap")


class FrameContinuity:
    """Watches the stamps of one camera.

    Parameters
    ----------
    period_ns : int -- nominal frame period [ns]

    Attributes
    ----------
    frames, missing, repeated, backwards : int -- counts since the last reset
    """

    def __init__(self, period_ns: int) -> None:
        if period_ns <= 0:
            raise VisionParameterError(f"frame period is {period_ns} ns; expected a positive number")
        self._nominal_ns = period_ns
        self.reset()

    def reset(self) -> None:
        """Forget everything, the counts too; the next frame is the first."""
        self.frames = self.missing = self.repeated = self.backwards = 0
        self.restart()

    def restart(self) -> None:
        """Take the next frame as the first, because the camera or its clock began anew; the counts stay."""
        self._stamp_ns: int | None = None
        self._sequence: int | None = None
        self._period_ns = float(self._nominal_ns)
        self._late_ns = 0.0
        self._recent: deque[int] = deque(maxlen=_EVEN_FRAMES)
        self._judged: deque[tuple[int, int]] = deque(maxlen=_JITTERY_FRAMES)

    @property
    def nominal_hz(self) -> float:
        """Frame rate that the camera should have [Hz]."""
        return 1e9 / self._nominal_ns

    @property
    def rate_hz(self) -> float:
        """Frame rate by the stamps, averaged over about a hundred frames, gaps left out [Hz]."""
        return 1e9 / self._period_ns

    def _periods_since(self, interval_ns: int) -> int:
        """Periods from the last frame's place on the lattice to this one's, which follows it slowly."""
        late_ns = self._late_ns + interval_ns
        periods = max(round(late_ns / self._period_ns), 0)
        late_ns -= periods * self._period_ns
        self._late_ns = (1.0 - _FOLLOWED) * late_ns
        if periods:
            self._period_ns += _SLOW * late_ns / periods
        return periods

    def _measure_period(self, interval_ns: int, missing: int) -> bool:
        """Return whether the last intervals show another period, which is taken over then."""
        self._recent.append(interval_ns)
        self._judged.append((interval_ns, missing))
        middle = median(self._recent)
        if len(self._recent) < _EVEN_FRAMES or not self._is_another(middle):
            return False
        mean = sum(interval for interval, _ in self._judged) / len(self._judged)
        even = [interval for interval in self._recent if abs(interval / middle - 1) <= _EVEN]
        # Frames that waited come evenly, too, but not faster in the mean.
        if len(even) >= _EVEN_FRAMES - _UNEVEN_FRAMES and (
            middle > self._period_ns or mean < middle * _ANOTHER
        ):
            return self._take_over(sum(even) / len(even))
        if len(self._judged) < _JITTERY_FRAMES:
            return False
        return (mean * _FAR < self._period_ns or not self._has_lattice()) and self._take_over(mean)

    def _is_another(self, period_ns: float) -> bool:
        return not period_ns / _ANOTHER < self._period_ns < period_ns * _ANOTHER

    def _has_lattice(self) -> bool:
        """Whether the last intervals are whole multiples of the period, as far as their jitter lets that be seen."""
        turn = 2.0 * math.pi / self._period_ns
        return sum(math.cos(turn * interval) for interval, _ in self._judged) > _NO_LATTICE * _JITTERY_FRAMES

    def _take_over(self, period_ns: float) -> bool:
        """Believe this period where it is another one, and take back what seemed to be missing by the one before."""
        if not self._is_another(period_ns):
            return False
        self.missing -= sum(missing for _, missing in self._judged)
        self._period_ns, self._late_ns = period_ns, 0.0
        self._recent.clear()
        self._judged.clear()
        return True

    def observe(self, stamp_ns: int, sequence: int | None = None) -> FrameStep:
        """Judge the next frame.

        Parameters
        ----------
        stamp_ns : int -- its stamp [ns]
        sequence : int or None -- the camera's own frame number, where it gives one

        Returns
        -------
        FrameStep
        """
        last_ns, last_sequence = self._stamp_ns, self._sequence
        if last_ns is not None and (
            stamp_ns == last_ns or (sequence is not None and sequence == last_sequence)
        ):
            self.repeated += 1
            return FrameStep("repeated")
        if last_ns is not None and stamp_ns < last_ns:
            self.backwards += 1
            return FrameStep("backwards")
        self.frames += 1
        self._stamp_ns, self._sequence = stamp_ns, sequence
        if last_ns is None:
            return FrameStep("first")
        interval_ns = stamp_ns - last_ns
        periods = self._periods_since(interval_ns)
        if sequence is not None and last_sequence is not None and sequence > last_sequence:
            missing = sequence - last_sequence - 1
        else:
            missing = max(periods - 1, -self.missing)
        self.missing += missing
        if sequence is None and self._measure_period(interval_ns, missing):
            return FrameStep("next")
        if missing > 0:
            return FrameStep("gap", missing)
        return FrameStep("next")
