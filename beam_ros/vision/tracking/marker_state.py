"""What the tracker knows of one marker between frames."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from beam_ros.vision.tracking.appearance import Appearance, Light
from beam_ros.vision.tracking.jumps import NEVER
from beam_ros.vision.tracking.rivals import Track
from beam_ros.vision.tracking.spots import Gates

LONELY_FRAMES = 25
"""Frames in which a spot must be the only one of its kind in its row, or what else is there must rest."""
SAME_PLACE_PX = 2.0
"""What lies so near to where something was seen before is the same [px]."""


@dataclass
class Thing:
    """What is no marker, or not known to be one: its column [px], the first and the last frame that showed it."""

    u: float
    first: int
    last: int

    def is_new(self, frame: int) -> bool:
        """False for what has rested for long, and still does."""
        return self.last != frame or self.last - self.first < LONELY_FRAMES


@dataclass
class MarkerState:
    """State of one marker between frames.

    Attributes
    ----------
    known_row : float or None -- row in which the marker is looked for before it is acquired [px]
    light, appearance, gates : Light, Appearance, Gates or None -- what it looks like; None before it is acquired
    u, v : float -- where it was last seen [px]
    velocity : float -- its last step [px per frame]
    hold_error, linear_error : float -- how well it is predicted by staying, and by its velocity [px]
    lost_frames : int -- frames in a row in which it was not valid
    centre, swing : float -- slow average of u, and how far it has been from there of late [px]
    rivals : list of Track -- other spots of its kind in its row
    is_mixed : bool -- it met a rival, and which of the two is which is not known
    is_joined : bool -- since they met, the two have not been seen apart
    is_blind : bool -- since they met, nothing of the two was to be seen for a while
    lost_at : int -- number of the frame in which it last was not where it should have been
    lost_u : float -- where it had been seen before that [px]
    company_u : tuple of float -- where all markers had been seen then [px]
    shown : float -- contrast that it had in the last frame; NaN where it was not seen [grey levels]
    company_contrast : tuple of float -- the same of all markers in the frame before that [grey levels]
    is_doubtful : bool -- since that frame a spot in its row may be another one
    alone_frames : int -- frames in a row in which, while it was lost, one spot of its kind was in its row
    acquired_at : int -- number of the frame in which it was acquired
    sighting : (int, float, float) or None -- before that: frame, column and excess of the spot in its row [px, px^2]
    clutter : list of Thing -- what else was in its row then
    """

    known_row: float | None
    light: Light | None = None
    appearance: Appearance | None = None
    gates: Gates | None = None
    u: float = math.nan
    v: float = math.nan
    velocity: float = 0.0
    hold_error: float = 1.0
    linear_error: float = 1.0
    lost_frames: int = 0
    centre: float = math.nan
    swing: float = 0.0
    rivals: list[Track] = field(default_factory=list)
    is_mixed: bool = False
    is_joined: bool = False
    is_blind: bool = False
    lost_at: int = NEVER
    lost_u: float = math.nan
    company_u: tuple[float, ...] = ()
    shown: float = math.nan
    company_contrast: tuple[float, ...] = ()
    is_doubtful: bool = False
    alone_frames: int = 0
    acquired_at: int = NEVER
    sighting: tuple[int, float, float] | None = None
    clutter: list[Thing] = field(default_factory=list)

    @property
    def is_followed(self) -> bool:
        """True once the marker is acquired."""
        return self.appearance is not None

    def remember(self, u: float, v: float, *, is_fresh: bool) -> None:
        """Carry a valid measurement into the state; a fresh one is the first after a loss."""
        if is_fresh:
            self.velocity = 0.0
            self.hold_error = self.linear_error = 1.0
            self.lost_frames = self.alone_frames = 0
            self.is_mixed = False
        else:
            step = u - self.u
            self.hold_error += 0.2 * (abs(step) - self.hold_error)
            self.linear_error += 0.2 * (abs(step - self.velocity) - self.linear_error)
            self.velocity = step
        self.u, self.v = u, v
        self.centre += 0.01 * (u - self.centre)
        self.swing = max(0.99 * self.swing, abs(u - self.centre))

    def place(self, u: float, v: float) -> None:
        """Start to follow the marker at a place, as if it had always rested there."""
        self.u, self.v, self.centre = u, v, u
        self.velocity = self.swing = 0.0
        self.hold_error = self.linear_error = 1.0
        self.lost_frames = self.alone_frames = 0
        self.is_mixed = False
        self.rivals = []

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
