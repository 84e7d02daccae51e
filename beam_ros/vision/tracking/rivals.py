"""Rivals: spots that look like a marker, in its row, and are not known to be the marker.

They are watched so that a marker that meets one, or is lost beside one, is not exchanged for it.
"""

from __future__ import annotations

from dataclasses import dataclass

from beam_ros.vision.tracking.spots import Spot

FORGET_AFTER_FRAMES = 100
"""A rival unseen for longer is forgotten; a marker lost for longer is looked for in its whole row and in any
light."""
_MEMORY_FRAMES = 10
"""A rival that has gone from view says for so many frames where not to look for the marker that is seen."""


@dataclass
class Track:
    """A spot of a marker's kind in the marker's row that is not (known to be) the marker.

    Attributes
    ----------
    u : float -- where it was last seen [px]
    velocity : float -- [px per frame]
    frame : int -- number of the frame in which it was last seen
    """

    u: float
    velocity: float
    frame: int

    def predicted(self, frame: int) -> float:
        """Where it should be in a frame [px]."""
        return self.u + self.velocity * (frame - self.frame)


def associated(
    tracks: list[Track], spots: list[Spot], frame: int, reach: float
) -> tuple[list[Track], list[Spot]]:
    """Continue tracks by the nearest spots; returns the tracks and the spots that belong to none."""
    free = list(spots)
    continued = []
    for track in tracks:
        predicted = track.predicted(frame)
        nearest = min(free, key=lambda spot: abs(spot.u - predicted), default=None)
        if nearest is not None and abs(nearest.u - predicted) <= reach:
            free.remove(nearest)
            elapsed = frame - track.frame
            velocity = (nearest.u - track.u) / elapsed if elapsed > 0 else track.velocity
            continued.append(Track(nearest.u, velocity, frame))
        else:
            continued.append(track)
    return continued, free


def continued(tracks: list[Track], spots: list[Spot], frame: int, reach: float) -> list[Track]:
    """Tracks of these spots, with velocities where an earlier track leads to them; and of those gone from view."""
    tracks, free = associated(tracks, spots, frame, reach)
    return [track for track in tracks if frame - track.frame <= FORGET_AFTER_FRAMES] + [
        Track(spot.u, 0.0, frame) for spot in free
    ]


def recent(tracks: list[Track], frame: int) -> list[Track]:
    """Tracks whose prediction still says where they are."""
    return [track for track in tracks if frame - track.frame <= _MEMORY_FRAMES]


def present(tracks: list[Track], frame: int, left: float, right: float, reach: float) -> list[Track]:
    """Tracks but those that have left the columns looked at, or have not been seen for long."""
    return [
        track
        for track in tracks
        if track.frame == frame
        or (left + reach < track.u < right - reach and frame - track.frame <= FORGET_AFTER_FRAMES)
    ]


def unseen(tracks: list[Track], frame: int) -> list[Track]:
    """Tracks that were lost before the last frame, and whose velocity therefore says little."""
    return [track for track in tracks if track.frame < frame - 1]


def recognised(
    hidden: list[Track], spots: list[Spot], claimed: list[Spot], frame: int, reach: float
) -> tuple[list[Track], list[Spot]]:
    """Continue hidden tracks by the one spot in reach that nobody else claims; returns them and the other spots."""
    free = list(spots)
    tracks = []
    for track in hidden:
        possible = [spot for spot in free if abs(spot.u - track.u) <= reach]
        if len(possible) == 1 and possible[0] not in claimed:
            free.remove(possible[0])
            tracks.append(Track(possible[0].u, 0.0, frame))
        else:
            tracks.append(track)
    return tracks, free


def may_be(tracks: list[Track], spot: Spot, frame: int, reach: float) -> bool:
    """True when a spot is in reach of a track that is hidden in this frame."""
    return any(track.frame < frame and abs(spot.u - track.u) <= reach for track in tracks)
