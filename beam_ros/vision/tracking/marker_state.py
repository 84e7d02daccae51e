"""What the tracker knows of one marker between frames, and whether several have moved together.

One spot of a marker's kind that appears where the marker was not proves nothing: it may be a twin, and the
marker hidden. But a kick of the camera, a cut in a video, a step of the hub or a wide swing moves several markers at
once, and each is alone in its row. That most of them have twins that appear while they are hidden, and so that they
lie as a beam may lie, is not to be expected.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

from beam_ros.vision.parameters import TrackerParameters
from beam_ros.vision.repeats import LATELY, is_on_its_way
from beam_ros.vision.tracking.appearance import Appearance, Light
from beam_ros.vision.tracking.rivals import (
    APART,
    COURSE_FRAMES,
    FORGET_AFTER_FRAMES,
    Course,
    Place,
    Track,
    on_course,
)
from beam_ros.vision.tracking.spots import Gates, Spot

TOGETHER_FRAMES = 5
"""Markers that were lost within so many frames of each other may have been lost for the same reason."""
_FASTEST = math.pi / 2
"""A sine is no faster than so many times the longest of three steps in a row, the last one ending there."""
_RECENT_FRAMES = 4
"""Where a marker was before it was lost for so many frames does not tell its speed."""
NEVER = -(10**9)
"""Number of the frame in which a marker was lost that never was."""
LONELY_FRAMES = 25
"""Frames in which a spot must be the only one of its kind in its row, or what else is there must rest."""
SAME_PLACE_PX = 2.0
"""What lies so near to where something was seen before is the same [px]."""
CONFIRMED_FRAMES = 3
"""What tells a marker from other spots must have done so in so many frames in a row."""


class Foretold(NamedTuple):
    """Where a marker should be, by what moves it, and how far from there it may be (three sd) [px]."""

    u_px: float
    doubt_px: float

    def admits(self, u: float) -> bool:
        """True for a column where the marker may be, give or take as much again."""
        return abs(u - self.u_px) <= 2.0 * self.doubt_px


Move = tuple[float, float]
"""How far along u and across the rows a marker, or what may be it, lies from where it was last seen [px]."""


@dataclass
class Thing:
    """What is no marker, or not known to be one: its column [px], the first and the last frame that showed it."""

    u: float
    first: int
    last: int

    def is_new(self, frame: int) -> bool:
        """False for what has rested for long, and still does."""
        return self.last != frame or self.last - self.first < LONELY_FRAMES


@dataclass(slots=True)
class MarkerState:
    """State of one marker between frames.

    Attributes
    ----------
    known_row : float or None -- row in which the marker is looked for before it is acquired [px]
    light, appearance, gates : Light, Appearance, Gates or None -- what it looks like; None before it is acquired
    u, v : float -- where it was last seen [px]
    velocity : float -- its last step [px per frame]; in the frame that acquires it, the one since its sighting before
    acceleration : float -- by how much that step was longer than the one before [px per frame^2]
    steps : int -- how many it made since it was found
    hold_error, linear_error : float -- how well it is predicted by staying, and by its velocity [px]
    lost_frames : int -- frames in a row in which it was not valid
    centre, swing : float -- slow average of u, and how far it has been from there of late [px]
    row, row_swing : float -- the same of v [px]
    way : deque of Place -- where it was in the frames of late
    rivals : list of Track -- other spots of its kind in its row
    courses : list of Course -- the ways of those that were known when it was lost
    told_frames : int -- frames in a row in which these ways told which spot it is
    relit_way : list of float -- columns in the frames of late in which it alone may have another light [px]
    is_mixed : bool -- it met a rival, and which of the two is which is not known
    is_joined : bool -- since they met, the two have not been seen apart
    is_blind : bool -- since they met, nothing of the two was to be seen for a while
    lost_at : int -- number of the frame in which it last was not where it should have been
    company_u, company_v : tuple of float -- where all markers had been seen before that [px]
    company_ways : list of list of Place -- where all markers were in the frames of late before that
    sigma : float -- standard deviation of u where it was last seen [px]
    is_pulled : bool -- in the last frame that showed it, a second image of it may have lain over it
    behind : float -- how far, most likely, that frame showed it behind its true place [px]
    shown : float -- contrast that it had in the last frame; NaN where it was not seen [grey levels]
    company_contrast : tuple of float -- the same of all markers in the frame before that [grey levels]
    is_doubtful : bool -- since that frame a spot in its row may be another one
    alone_frames : int -- frames in a row in which, while it was lost, one spot of its kind was in its row
    acquired_at : int -- number of the frame in which it was acquired
    sighting : (int, float, float, float) or None -- before that: frame, column, excess and covariance of the spot in
        its row [px, px^2]
    clutter : list of Thing -- what else was in its row then
    foretold : Foretold or None -- where it should be in this frame; None where nobody foretells that
    is_foretold : bool -- in this frame that told it from other spots
    """

    known_row: float | None
    light: Light | None = None
    appearance: Appearance | None = None
    gates: Gates | None = None
    u: float = math.nan
    v: float = math.nan
    velocity: float = 0.0
    acceleration: float = 0.0
    steps: int = 0
    hold_error: float = 1.0
    linear_error: float = 1.0
    lost_frames: int = 0
    centre: float = math.nan
    swing: float = 0.0
    row: float = math.nan
    row_swing: float = 0.0
    way: deque[Place] = field(default_factory=lambda: deque(maxlen=COURSE_FRAMES))
    rivals: list[Track] = field(default_factory=list)
    courses: list[Course] = field(default_factory=list)
    told_frames: int = 0
    relit_way: list[float] = field(default_factory=list)
    is_mixed: bool = False
    is_joined: bool = False
    is_blind: bool = False
    lost_at: int = NEVER
    company_u: tuple[float, ...] = ()
    company_v: tuple[float, ...] = ()
    company_ways: list[list[Place]] = field(default_factory=list)
    sigma: float = math.inf
    is_pulled: bool = False
    behind: float = 0.0
    shown: float = math.nan
    company_contrast: tuple[float, ...] = ()
    is_doubtful: bool = False
    alone_frames: int = 0
    acquired_at: int = NEVER
    sighting: tuple[int, float, float, float] | None = None
    clutter: list[Thing] = field(default_factory=list)
    foretold: Foretold | None = None
    is_foretold: bool = False

    @property
    def is_followed(self) -> bool:
        """True once the marker is acquired."""
        return self.appearance is not None

    @property
    def is_seen(self) -> bool:
        """True where the last frame showed it."""
        return self.is_followed and self.lost_frames == 0

    @property
    def is_moving(self) -> bool:
        """True where it came farther than noise in its last steps."""
        steps = [abs(u - before) for (_, before), (_, u) in pairwise(list(self.way)[-LATELY - 1 :])]
        return self.is_followed and is_on_its_way(steps, self.sigma)

    @property
    def is_anywhere(self) -> bool:
        """True where it was lost for so long, with one spot alone in its row, that its old place says nothing."""
        return self.lost_frames > FORGET_AFTER_FRAMES and self.alone_frames >= LONELY_FRAMES

    @property
    def predicted(self) -> float:
        """Column where it should be in the frame after that in which it was last seen [px]."""
        if self.foretold is not None and self.foretold.doubt_px < self.usual_error:
            return self.foretold.u_px
        return self.u + (self.velocity if self.linear_error < self.hold_error else 0.0)

    @property
    def usual_error(self) -> float:
        """How far it is from where it should be, by its own motion of late [px]."""
        return min(self.hold_error, self.linear_error)

    def foretold_among(self, spots: list[Spot], frame: int, parameters: TrackerParameters) -> Spot | None:
        """Choose the one spot where it was foretold in a frame, out of reach of every rival that is not seen."""
        if self.foretold is None or 2 * self.foretold.doubt_px > parameters.marker_diameter_px:
            return None
        at, doubt = self.foretold
        unseen = [track for track in self.rivals if track.frame < frame]
        places = [place for track in unseen for place in (track.u, track.predicted(frame))]
        if any(abs(place - at) <= APART * doubt + SAME_PLACE_PX for place in places):
            return None
        return on_course(spots, at, doubt)

    def speed(self, u: float, frame: int) -> tuple[float, float]:
        """How fast it moves in a frame that shows it in a column, and how far that may be wrong [px per frame].

        Notes
        -----
        The derivative of the polynomial through this place and the last three, by backward differences D,

            u' = D u + D^2 u / 2 + D^3 u / 3

        is uncertain by as much as the larger one of its last two terms: of a motion that turns within few frames, one
        of them is large. No sine of up to 0.4 cycles per frame is faster than pi / 2 of the longest of these three
        steps; where all that the polynomial allows is faster, no more is known. Of fewer places since it was found,
        less is known; nothing where it was not seen of late.
        """
        if self.acquired_at == frame:
            return self.velocity, abs(self.velocity)
        step = u - self.u
        if self.lost_frames > 0 or self.steps == 0:
            mean = step / (self.lost_frames + 1) if self.lost_frames < _RECENT_FRAMES else 0.0
            return mean, abs(mean)
        change = step - self.velocity
        if self.steps == 1:
            return step + change / 2, abs(change)
        last = (change - self.acceleration) / 3
        speed, doubt = step + change / 2 + last, max(abs(change) / 2, abs(last))
        most = _FASTEST * max(abs(step), abs(self.velocity), abs(self.velocity - self.acceleration))
        if abs(speed) + doubt > most:
            lower = abs(speed) - doubt
            doubt = (most - lower) / 2 if 0.0 < lower < most else most / 2
            speed = math.copysign(most - doubt, speed)
        return speed, doubt

    def turn(self, u: float) -> float:
        """How its speed changes per frame, the most of late, in a frame that shows it in a column [px per frame^2].

        It must have made two steps since it was found.
        """
        return max(u - self.u - self.velocity, self.acceleration, key=abs)

    def remember(self, u: float, v: float, frame: int, *, is_fresh: bool) -> None:
        """Carry a valid measurement in a frame into the state; a fresh one is the first after a loss."""
        if is_fresh:
            self.velocity = self.acceleration = 0.0
            self.steps = 0
            self.hold_error = self.linear_error = 1.0
            self.lost_frames = self.alone_frames = 0
            self.is_mixed = self.is_joined = self.is_blind = False
        else:
            step = u - self.u
            change = step - self.velocity
            self.hold_error += 0.2 * (abs(step) - self.hold_error)
            self.linear_error += 0.2 * (abs(change) - self.linear_error)
            self.velocity, self.acceleration = step, change
            self.steps += 1
        self.u, self.v = u, v
        self.centre += 0.01 * (u - self.centre)
        self.row += 0.1 * (v - self.row)
        away, across = abs(u - self.centre), abs(v - self.row)
        swing, row_swing = 0.99 * self.swing, 0.99 * self.row_swing
        self.swing = swing if swing > away else away
        self.row_swing = row_swing if row_swing > across else across
        self.way.append((frame, u))

    def introduce(self, spot: Spot, light: Light, appearance: Appearance, gates: Gates, frame: int) -> None:
        """Start to follow a spot as this marker, as if it had always rested there."""
        self.light, self.appearance, self.gates = light, appearance, gates
        self.acquired_at, self.shown = frame, light.contrast
        self.u, self.v, self.centre, self.row = spot.u, spot.v, spot.u, spot.v
        self.swing = self.row_swing = 0.0
        self.way.clear()
        self.hold_error = self.linear_error = 1.0
        self.lost_frames = self.alone_frames = 0
        self.is_mixed = self.is_joined = self.is_blind = False

    def forget(self) -> None:
        """Take back that the marker was acquired."""
        self.appearance = self.light = self.gates = self.sighting = None

    def note_clutter(self, columns: list[float], frame: int) -> None:
        """Note what was seen in the row in a frame and is not known to be the marker."""
        kept = [thing for thing in self.clutter if frame - thing.last < LONELY_FRAMES]
        for u in columns:
            old = next((thing for thing in kept if abs(thing.u - u) <= SAME_PLACE_PX), None)
            if old is None:
                kept.append(Thing(u, frame, frame))
            else:
                old.last = frame
        self.clutter = kept


def beam_reach(columns: Iterable[float], max_bend_px: float) -> tuple[float, float]:
    """First and last column where a marker may be beside others that are seen in these columns [px]."""
    seen = list(columns)
    return max(seen, default=-math.inf) - max_bend_px, min(seen, default=math.inf) + max_bend_px


def is_taken(markers: list[MarkerState], spot: Spot, k: int, near: float) -> bool:
    """True when another marker than the one of this number is followed on this very spot, or as near to it [px]."""
    return any(
        other.is_followed
        and other.lost_frames == 0
        and max(abs(other.u - spot.u), abs(other.v - spot.v)) < near
        for j, other in enumerate(markers)
        if j != k
    )


def is_common(n_together: int, n_markers: int) -> bool:
    """True when so many of the markers, lost together, can have one reason: most of them, and two at least."""
    return n_together >= 2 and 2 * n_together > n_markers


def shared(changes: Sequence[float], n_markers: int) -> float:
    """The part of some markers' changes that most of all markers have in common; 0 where they have none."""
    most = max(n_markers // 2 + 1, 2)
    if len(changes) < most:
        return 0.0
    ordered = sorted(changes)
    return max(ordered[-most], 0.0) + min(ordered[most - 1], 0.0)


def moved_together(
    found: Mapping[int, Move],
    seen: Mapping[int, Move],
    n_markers: int,
    *,
    slack_px: float,
    row_slack_px: float,
) -> list[int]:
    """Choose the lost markers that are what was found in their rows.

    Parameters
    ----------
    found : mapping of int to Move -- lost markers with one spot of their kind in their whole row
    seen : mapping of int to Move -- markers that are seen where they may be
    n_markers : int -- number of markers on the beam
    slack_px : float -- by how much moves along u may differ and still be one move [px]
    row_slack_px : float -- the same across the rows [px]

    Returns
    -------
    list of int -- keys of ``found``: all or none

    Notes
    -----
    A hub moves all markers alike; a beam that bends moves the upper ones further, in the same direction. Where all
    markers were found, they may lie anyhow along u.
    """
    moves = {**found, **seen}
    if not found:
        return []
    across = [move[1] for move in moves.values()]
    if max(across) - min(across) > row_slack_px:
        return []
    if len(found) == n_markers >= 2:
        return list(found)
    n_moved = sum(
        k in found or any(abs(move[0] - other[0]) <= slack_px for other in found.values())
        for k, move in moves.items()
    )
    if not is_common(n_moved, n_markers):
        return []
    along = [moves[k][0] for k in sorted(moves)]
    is_beam = all(
        abs(lower) <= abs(upper) + slack_px
        and (lower * upper >= 0 or min(abs(lower), abs(upper)) <= slack_px)
        for lower, upper in pairwise(along)
    )
    return list(found) if is_beam else []
