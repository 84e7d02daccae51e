"""The strip among lines that look like it: a cable, a bar of the frame behind. The strip is the one that bends.

Where an image shows several lines, each is followed, and no point is valid (``doubtful``) until one of them has come
three times as far as any other, and farther than noise: a camera that shakes moves all of them alike. It must have
bent as well, as a cantilever does: its motion is fitted by

    u(z) - u_0(z) = c_0 + c_1 z + c_2 z^2 + c_3 z^3 + c_4 z^4,      z from 0 at the clamp to 1 at the tip

where the hub moves c_0, the strip bends in the last three, and only what is not clamped leans (c_1). A line that
leans more than it bends, as a cable that swings, is not the strip, nor is one that goes on above the tip where
another one ends; alone, that one is doubtful until it bends. The others are known from then on, and no search takes
them for the strip. As long as no line has moved, others are looked for again, ever more rarely. Where the strip had
to be searched, as behind a hand, what was found may be another line again; found in another place, it is doubtful
alone until it has moved, and so is a line for which a likelier one was given up, or beside which there is something.
With more than itself in its place it is doubtful until it has left that.
"""

from __future__ import annotations

import math

import numpy as np

from beam_ros.arrays import FloatArray, ImageArray
from beam_ros.vision.strip.cross_section import CrossSection
from beam_ros.vision.strip.following import REASONS, LineFollower, StripFrame, StripParameters

_MOST_LINES = 4
_TIMES = 3.0
"""The strip comes so many times as far as a line that does not move with it, bends so many times as far as it leans,
..."""
_SIGMAS, _FLOOR_PX = 6.0, 0.02
"""... and so many standard deviations of a place, which is no better known than that."""
_BENDING = (2, 3, 4)
"""Powers of the height in which a clamped strip bends: they hold two modes of a cantilever, but for a slope at the
clamp of a tenth of its bend; a clamp that is 3 % of the length elsewhere adds as much."""
_GONE_FRAMES = 10
"""A line that is out of sight for longer says nothing any more."""


class _Candidate:
    """A line, and how far it came while it was in sight; until it has moved it may be sure, if there is no other."""

    def __init__(
        self, line: LineFollower, frame: StripFrame, image: ImageArray, is_sure: bool = False
    ) -> None:
        self.line, self.goes_on = line, line.goes_on(image)
        self.is_sure = is_sure and not self.goes_on
        self._searches = line.searches
        self._lost = 0
        expected = line.parameters
        above = (expected.last_row - line.rows_px) / (expected.last_row - expected.first_row)
        self._shapes = above[:, None] ** np.array((0, 1, *_BENDING))
        self.compare_from(frame)

    def compare_from(self, frame: StripFrame) -> None:
        """Compare its places with those of this frame from now on."""
        self._from, self.way_px, self.sigma_px = frame.u_px, 0.0, _FLOOR_PX
        self._leant = self._bent = 0.0  # sums of squares over the frames

    @property
    def is_clamped(self) -> bool:
        """It bends as the strip does, which keeps its direction at the clamp."""
        return _TIMES**2 * self._leant < self._bent

    @property
    def is_hinged(self) -> bool:
        """It leans more than it bends, as a cable that swings."""
        return self._leant > self._bent

    def follow(self, image: ImageArray) -> StripFrame:
        """Follow it into the next frame."""
        frame = self.line.process(image)
        known = np.isfinite(frame.u_px)
        both = known & np.isfinite(self._from)
        way, shapes = (frame.u_px - self._from)[both], self._shapes[both]
        if len(way) >= 2 * shapes.shape[1]:
            parts = np.linalg.lstsq(shapes, way, rcond=None)[0]
            self._leant += float(np.mean((shapes[:, 1] * parts[1]) ** 2))
            self._bent += float(np.mean((shapes[:, 2:] @ parts[2:]) ** 2))
            self.way_px = max(self.way_px, math.sqrt(float(np.mean(way**2))))
            self.sigma_px = math.hypot(_FLOOR_PX, math.sqrt(float(np.mean(frame.sigma_px[known] ** 2))))
        self._lost = 0 if self.line.is_found else self._lost + 1
        return frame

    def is_missed(self) -> bool:
        """True where it was out of sight, but for too short a time to be gone; it may have become another line."""
        searches, self._searches = self._searches, self.line.searches
        return self._searches > searches and self._lost < _GONE_FRAMES


class StripFollower:
    """Follows the strip.

    Parameters
    ----------
    parameters : StripParameters
    shape : (int, int) -- height and width of the images [px]

    Attributes
    ----------
    rows_px : ndarray, shape (n_points,) -- row of every point, from the clamp upwards [px]
    """

    def __init__(self, parameters: StripParameters, shape: tuple[int, int]) -> None:
        self._of = parameters, shape
        self._line = LineFollower(parameters, shape)
        self.rows_px = self._line.rows_px
        self._candidates: list[_Candidate] = []  # none: that it moved has told the strip
        self._still: list[FloatArray] = []
        self._until_look = self._pause = 1  # frames

    @property
    def section(self) -> CrossSection:
        """Width and blur found in the first frames."""
        return self._line.section

    @property
    def searches(self) -> int:
        """How often the strip was searched."""
        return self._line.searches

    def process(self, image: ImageArray) -> StripFrame:
        """Find the strip in the next frame.

        Parameters
        ----------
        image : ndarray, shape (height, width), uint8 or uint16

        Returns
        -------
        StripFrame
        """
        if len(self._candidates) > 1:
            frames = []
            for candidate in self._candidates:
                candidate.line.avoided = self._elsewhere(candidate)
                frames.append(candidate.follow(image))
            missed = [candidate.is_missed() for candidate in self._candidates]
            if any(missed):
                for candidate, frame in zip(self._candidates, frames, strict=True):
                    candidate.compare_from(frame)
            self._choose()
            return self._doubtful()
        searches, before = self._line.searches, self._line.curve
        frame = self._candidates[0].follow(image) if self._candidates else self._line.process(image)
        if not self._line.is_found:
            return frame
        if self._line.searches > searches:
            is_other = self._line.is_second if before is None else self._line.has_left(before)
            is_sure = self._line.is_alone and not is_other
            self._candidates = [_Candidate(self._line, frame, image, is_sure)]
            self._until_look = self._pause = 1
            self._look_for_others(image)
        elif self._candidates and not self._choose():
            self._until_look -= 1
            if self._until_look == 0:
                self._until_look = self._pause = 2 * self._pause
                self._look_for_others(image)
        is_sure = not self._candidates or (len(self._candidates) == 1 and self._candidates[0].is_sure)
        return frame if is_sure else self._doubtful()

    def _doubtful(self) -> StripFrame:
        nothing = np.full(len(self.rows_px), np.nan)
        return StripFrame(
            nothing, nothing.copy(), np.full(len(nothing), REASONS.index("doubtful"), dtype=np.intp)
        )

    def _elsewhere(self, candidate: _Candidate) -> list[FloatArray]:
        """Where lines are that this one is not."""
        return self._still + [one.line.columns_px for one in self._candidates if one is not candidate]

    def _look_for_others(self, image: ImageArray) -> None:
        """Find all other lines that may be the strip."""
        while len(self._candidates) < _MOST_LINES:
            other = LineFollower(*self._of)
            other.avoided = self._still + [one.line.columns_px for one in self._candidates]
            frame = other.process(image)
            if other.is_disturbed and not other.is_found:
                self._candidates[0].is_sure = False
            if not other.is_found or any(other.is_at(columns) for columns in other.avoided):
                break
            self._candidates.append(_Candidate(other, frame, image))

    def _choose(self) -> bool:
        """Take the line that moves as the strip would, if there is one."""
        ending = [one for one in self._candidates if not one.goes_on] or self._candidates
        likely = [one for one in ending if not one.is_hinged] or ending
        most = max(likely, key=lambda one: one.way_px)
        others = [one for one in self._candidates if one is not most]
        other = max((one.way_px for one in likely if one is not most), default=0.0)
        least = _SIGMAS * most.sigma_px if most.line.is_alone else most.line.apart_px
        # Alone, and no longer than the strip, it need not show more than that: a codec lets it seem to lean.
        is_likely = most.is_clamped if others or most.goes_on else not most.is_hinged
        if most.way_px < _TIMES * other + least or not is_likely:
            return False
        self._still += [one.line.columns_px for one in others]
        self._line, self._candidates = most.line, []
        self._line.avoided = self._still
        return True
