"""What the tracker knows of one marker between frames."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from beam_ros.vision.tracking.appearance import Appearance, Light
from beam_ros.vision.tracking.jumps import NEVER
from beam_ros.vision.tracking.rivals import Track
from beam_ros.vision.tracking.spots import Gates


@dataclass
class MarkerState:
    """State of one marker between frames.

    Attributes
    ----------
    known_row : float or None -- row in which the marker is looked for when it is not followed [px]
    light, appearance, gates : Light, Appearance, Gates or None -- what it looks like; None before it is acquired
    is_followed : bool -- it has a place: acquired, and not given up since
    u, v : float -- where it was last seen [px]
    velocity : float -- its last step [px per frame]
    hold_error, linear_error : float -- how well it is predicted by staying, and by its velocity [px]
    lost_frames : int -- frames in a row in which it was not valid
    centre, swing : float -- slow average of u, and how far it has been from there of late [px]
    lonely_since : int -- number of the frame since which it has been alone in its row, while given up
    is_mixed : bool -- it met a rival, and which of the two is which is not known
    rivals : list of Track
    is_accompanied : bool -- another spot of its kind was last in its whole row
    lost_at : int -- number of the frame in which it last was not where it should have been
    lost_u : float -- where it had been seen before that [px]
    moved : float -- how far from there it was found again [px]
    is_doubtful : bool -- since that frame a spot in its row may be another one
    sighting : (int, float) or None -- frame and column in which a spot was last seen alone in its whole row [px]
    """

    known_row: float | None
    light: Light | None = None
    appearance: Appearance | None = None
    gates: Gates | None = None
    is_followed: bool = False
    u: float = math.nan
    v: float = math.nan
    velocity: float = 0.0
    hold_error: float = 1.0
    linear_error: float = 1.0
    lost_frames: int = 0
    centre: float = math.nan
    swing: float = 0.0
    lonely_since: int = 0
    is_mixed: bool = False
    rivals: list[Track] = field(default_factory=list)
    is_accompanied: bool = False
    lost_at: int = NEVER
    lost_u: float = math.nan
    moved: float = 0.0
    is_doubtful: bool = False
    sighting: tuple[int, float] | None = None

    def note_loss(self, frame: int) -> None:
        """Note where and in which company the marker was last seen, once in a frame."""
        if self.lost_at != frame:
            self.lost_at, self.lost_u = frame, self.u
            self.is_doubtful = self.is_accompanied or bool(self.rivals)

    def remember(self, u: float, v: float) -> None:
        """Carry a valid measurement into the state."""
        if self.lost_frames > 0:
            self.velocity = 0.0
            self.hold_error = self.linear_error = 1.0
            self.lost_frames = 0
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
        self.lost_frames = 0
        self.is_followed = True
        self.is_mixed = self.is_accompanied = False
        self.rivals = []
        self.sighting = None
