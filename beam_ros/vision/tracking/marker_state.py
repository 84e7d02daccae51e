"""What the tracker knows of one marker between frames: its look, how it moves, and which spots it may be."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

from beam_ros.vision.repeats import LATELY, is_on_its_way
from beam_ros.vision.tracking.appearance import Appearance, Light
from beam_ros.vision.tracking.association import COURSE_FRAMES, Belief, Place, SpotPath
from beam_ros.vision.tracking.spots import Gates, Spot

_FASTEST = math.pi / 2
"""A sine is no faster than so many times the longest of three steps in a row, the last one ending there."""
_RECENT_FRAMES = 4
"""Where a marker was before it was lost for so many frames does not tell its speed."""
NEVER = -(10**9)
"""Number of the frame in which a marker was lost that never was."""
LONELY_FRAMES = COURSE_FRAMES
"""What else is in the row of a marker that is acquired must rest for as many frames as a way is remembered."""
SAME_PLACE_PX = 2.0
"""What lies so near to where something was seen before is the same [px]."""
CONFIRMED_FRAMES = 3
"""What tells a marker from other spots must have done so in so many frames in a row."""


class Foretold(NamedTuple):
    """Where a marker should be, by what moves it, and how far from there it may be (three sd) [px]."""

    u_px: float
    doubt_px: float


@dataclass
class Thing:
    """What is no marker, or not known to be one: its column [px], the first and the last frame that showed it."""

    u: float
    first: int
    last: int

    def is_new(self, frame: int) -> bool:
        """False for what has rested for long, and still does."""
        return self.last != frame or self.last - self.first < LONELY_FRAMES


class Company(NamedTuple):
    """All markers as they were when one of them was lost.

    Attributes
    ----------
    u, v : tuple of float -- where they were [px]
    contrasts : tuple of float -- which they showed; NaN where not seen [grey levels]
    ways : tuple of tuple of Place -- where they were in the frames of late before that
    """

    u: tuple[float, ...]
    v: tuple[float, ...]
    contrasts: tuple[float, ...]
    ways: tuple[tuple[Place, ...], ...]


NOBODY = Company((), (), (), ())


@dataclass(slots=True)
class MarkerMotion:
    """How one marker moves.

    Attributes
    ----------
    u, v : float -- where it was last seen [px]
    sigma : float -- standard deviation of u there [px]
    velocity : float -- its last step [px per frame]; in the frame that acquires it, the one since its sighting before
    acceleration : float -- by how much that step was longer than the one before [px per frame^2]
    steps : int -- how many it made since it was found
    hold_error, linear_error : float -- how well it is predicted by staying, and by its velocity [px]
    centre, swing : float -- slow average of u, and how far it has been from there of late [px]
    row, row_swing : float -- the same of v [px]
    way : deque of Place -- where it was in the frames of late
    is_pulled : bool -- in the last frame that showed it, a second image of it may have lain over it
    behind : float -- how far, most likely, that frame showed it behind its true place [px]
    """

    u: float = math.nan
    v: float = math.nan
    sigma: float = math.inf
    velocity: float = 0.0
    acceleration: float = 0.0
    steps: int = 0
    hold_error: float = 1.0
    linear_error: float = 1.0
    centre: float = math.nan
    swing: float = 0.0
    row: float = math.nan
    row_swing: float = 0.0
    way: deque[Place] = field(default_factory=lambda: deque(maxlen=COURSE_FRAMES))
    is_pulled: bool = False
    behind: float = 0.0

    @property
    def is_going(self) -> bool:
        """True where it came farther than noise in its last steps."""
        steps = [abs(u - before) for (_, before), (_, u) in pairwise(list(self.way)[-LATELY - 1 :])]
        return is_on_its_way(steps, self.sigma)

    @property
    def usual_error(self) -> float:
        """How far it is from where it should be, by its own motion of late [px]."""
        return min(self.hold_error, self.linear_error)

    @property
    def predicted(self) -> float:
        """Column where it should be, by its own motion, in the frame after that in which it was last seen [px]."""
        return self.u + (self.velocity if self.linear_error < self.hold_error else 0.0)

    def begin(self, u: float, v: float) -> None:
        """Start at a place, as if it had always rested there."""
        self.u, self.v, self.centre, self.row = u, v, u, v
        self.swing = self.row_swing = 0.0
        self.hold_error = self.linear_error = 1.0
        self.way.clear()

    def speed(self, u: float, lost_frames: int) -> tuple[float, float]:
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
        if not self.way:  # it is being acquired
            return self.velocity, abs(self.velocity)
        step = u - self.u
        if lost_frames > 0 or self.steps == 0:
            mean = step / (lost_frames + 1) if lost_frames < _RECENT_FRAMES else 0.0
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


@dataclass(slots=True)
class MarkerState:
    """State of one marker between frames.

    Attributes
    ----------
    known_row : float or None -- row in which the marker is looked for before it is acquired [px]
    light, appearance, gates : Light, Appearance, Gates or None -- what it looks like; None before it is acquired
    motion : MarkerMotion -- where it was, and how it goes on
    belief : Belief -- which spots of its row it may be
    lost_frames : int -- frames in a row in which it was not valid
    lost_at : int -- number of the frame in which it last was not where it should have been
    company : Company -- all markers in the frame before that
    shown : float -- contrast that it had in the last frame; NaN where it was not seen [grey levels]
    acquired_at : int -- number of the frame in which it was acquired
    foretold : Foretold or None -- where it should be in this frame; None where nobody foretells that
    is_foretold : bool -- in this frame that told it from other spots
    """

    known_row: float | None
    light: Light | None = None
    appearance: Appearance | None = None
    gates: Gates | None = None
    motion: MarkerMotion = field(default_factory=MarkerMotion)
    belief: Belief = field(default_factory=Belief)
    lost_frames: int = 0
    lost_at: int = NEVER
    company: Company = NOBODY
    shown: float = math.nan
    acquired_at: int = NEVER
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
    def predicted(self) -> float:
        """Column where it should be in the frame after that in which it was last seen [px]."""
        if self.foretold is not None and self.foretold.doubt_px < self.motion.usual_error:
            return self.foretold.u_px
        return self.motion.predicted

    @property
    def path(self) -> SpotPath | None:
        """Its way, as the association continues it; None where it is not followed."""
        if not self.is_followed:
            return None
        motion = self.motion
        places = tuple(motion.way) or ((self.acquired_at - 1, motion.u),)  # as if it had rested there
        return SpotPath(places, motion.row, motion.hold_error, motion.linear_error)

    def introduce(self, spot: Spot, light: Light, appearance: Appearance, gates: Gates, frame: int) -> None:
        """Start to follow a spot as this marker."""
        self.light, self.appearance, self.gates = light, appearance, gates
        self.acquired_at, self.shown, self.lost_frames = frame, light.contrast, 0
        self.motion.begin(spot.u, spot.v)

    def forget(self) -> None:
        """Take back that the marker was acquired."""
        self.appearance = self.light = self.gates = None


def beam_reach(columns: Iterable[float], max_bend_px: float) -> tuple[float, float]:
    """First and last column where a marker may be beside others that are seen in these columns [px]."""
    seen = list(columns)
    return max(seen, default=-math.inf) - max_bend_px, min(seen, default=math.inf) + max_bend_px


def is_taken(markers: list[MarkerState], spot: Spot, k: int, near: float) -> bool:
    """True when another marker than the one of this number is followed on this very spot, or as near to it [px]."""
    return any(
        other.is_followed
        and other.lost_frames == 0
        and max(abs(other.motion.u - spot.u), abs(other.motion.v - spot.v)) < near
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
