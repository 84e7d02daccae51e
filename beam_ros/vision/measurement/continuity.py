"""Whether every frame arrived once and in order, judged by stamps and sequence numbers.

A camera that drops a frame leaves a gap of about two periods, one that repeats a frame (or a transport that
delivers it twice) the same stamp or the same number again. Nothing is repaired here: what is missing stays
missing, what is repeated is to be thrown away, and both are counted. The period is measured: a camera whose frames
come evenly at another rate than it should have loses none.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from statistics import median
from typing import Literal

from beam_ros.vision.errors import VisionParameterError

Step = Literal["first", "next", "gap", "repeated", "backwards"]
"""How a frame follows the one before: first of all; next in line; after a gap; the same one again; with a
stamp before that of an earlier frame."""

_GAP_PERIODS = 1.5
_SLOW = 0.01
_EVEN_FRAMES = 9
"""So many intervals show that a camera has another rate, ..."""
_UNEVEN_FRAMES = 1
"""... of which so many may differ from their median by more than ..."""
_EVEN = 0.2
"""... this share of it: a transport that loses frames does not lose them so evenly."""


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
        self._recent: deque[tuple[float, int]] = deque(maxlen=_EVEN_FRAMES)

    @property
    def nominal_hz(self) -> float:
        """Frame rate that the camera should have [Hz]."""
        return 1e9 / self._nominal_ns

    @property
    def rate_hz(self) -> float:
        """Frame rate by the stamps, averaged over about a hundred frames, gaps left out [Hz]."""
        return 1e9 / self._period_ns

    def _measure_period(self, interval_ns: float, missing: int) -> bool:
        """Return whether the last intervals are even, and the period another one; it is taken over then."""
        self._recent.append((interval_ns, missing))
        if len(self._recent) < _EVEN_FRAMES:
            return False
        period = median(interval for interval, _ in self._recent)
        if period / _GAP_PERIODS < self._period_ns < period * _GAP_PERIODS:
            return False
        if sum(abs(interval / period - 1) > _EVEN for interval, _ in self._recent) > _UNEVEN_FRAMES:
            return False
        self._period_ns = period
        self.missing -= sum(missing for _, missing in self._recent)
        self._recent.clear()
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
        periods = (stamp_ns - last_ns) / self._period_ns
        if sequence is not None and last_sequence is not None and sequence > last_sequence:
            missing = sequence - last_sequence - 1
        else:
            missing = round(periods) - 1 if periods > _GAP_PERIODS else 0
        self.missing += missing
        if sequence is None and self._measure_period(stamp_ns - last_ns, missing):
            return FrameStep("next")
        if missing > 0:
            return FrameStep("gap", missing)
        if periods < _GAP_PERIODS:
            self._period_ns += _SLOW * (stamp_ns - last_ns - self._period_ns)
        return FrameStep("next")
