"""Rivals: spots that look like a marker, in its row, and are not known to be the marker.

They are watched so that a marker that meets one, or is lost beside one, is not exchanged for it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import NamedTuple

import numpy as np

from beam_ros.arrays import FloatArray
from beam_ros.vision.tracking.spots import Spot

FORGET_AFTER_FRAMES = 100
"""A rival unseen for longer is forgotten; a marker lost for longer is looked for in its whole row and in any
light."""
_MEMORY_FRAMES = 10
"""A rival that has gone from view says for so many frames where not to look for the marker that is seen."""
COURSE_FRAMES = 25
"""Frames over which the way of a spot is remembered."""
_MIN_PLACES = 4
"""A course is known from so many places."""
REST_PX = 0.3
"""What rests is seen at one place up to this [px]: rivals are measured less carefully than markers."""
_SIGNIFICANT = 4.0
_SWINGING_FRAMES = 12
"""A motion is compared with that of the beam over so many frames at least."""
_MIN_BEND_PX = 1.0
"""A motion that departs from a straight line by so much (RMS) shows that of the beam [px]."""
_EXPLAINED = 0.4
"""What the beam moves departs from its motion by less than this share of that (RMS)."""
LEVERAGE = 2.5
"""A marker moves at most so many times as much as the others."""
APART = 3.0
"""A spot so many times farther from where a rival leads than that is known cannot be the rival."""

Place = tuple[int, float]
"""Number of a frame, and the column of something in it [px]."""


@dataclass
class Track:
    """A spot of a marker's kind in the marker's row that is not (known to be) the marker.

    Attributes
    ----------
    u : float -- where it was last seen [px]
    velocity : float -- [px per frame]
    frame : int -- number of the frame in which it was last seen
    past : tuple of Place -- where it was seen in the frames before
    v : float -- row in which it was last seen [px]
    """

    u: float
    velocity: float
    frame: int
    past: tuple[Place, ...] = field(default=(), compare=False)
    v: float = field(default=math.nan, compare=False)

    @classmethod
    def of(cls, spot: Spot, frame: int) -> Track:
        """Begin with a spot that is seen for the first time."""
        return cls(spot.u, 0.0, frame, v=spot.v)

    @property
    def places(self) -> tuple[Place, ...]:
        """Where it was seen of late, the last included."""
        return *self.past, (self.frame, self.u)

    def predicted(self, frame: int) -> float:
        """Where it should be in a frame [px]."""
        return self.u + self.velocity * (frame - self.frame)


class Course(NamedTuple):
    """The straight way of a spot that rests, or moves evenly.

    Attributes
    ----------
    u : float -- column in its last frame [px]
    velocity : float -- [px per frame]
    frame, span : int -- the last frame, and how many frames it lasted
    scatter : float -- standard deviation of its places about it [px]
    """

    u: float
    velocity: float
    frame: int
    span: int
    scatter: float

    @classmethod
    def of(cls, track: Track) -> Course | None:
        """Fit a track's places; None where they are too few."""
        if len(track.places) < _MIN_PLACES:
            return None
        frames, columns = np.array(track.places).T
        velocity, u = np.polyfit(frames - track.frame, columns, 1)
        scatter = float(np.std(columns - u - velocity * (frames - track.frame)))
        return cls(float(u), float(velocity), track.frame, int(frames[-1] - frames[0]), scatter)

    def predicted(self, frame: int) -> float:
        """Where it leads in a frame [px]."""
        return self.u + self.velocity * (frame - self.frame)

    def doubt(self, frame: int) -> float:
        """How far from there the spot may be [px]: a bend that hides in the scatter grows with the square of time."""
        beyond = (frame - self.frame) / self.span
        return REST_PX + _SIGNIFICANT * self.scatter * (1.0 + 4.0 * beyond * beyond)


def on_course(spots: list[Spot], at: float, doubt: float) -> Spot | None:
    """Choose the one spot where something is bound for, to this doubt [px]; None where another may be it."""
    near = [spot for spot in spots if abs(spot.u - at) <= APART * doubt]
    return near[0] if len(near) == 1 and abs(near[0].u - at) <= doubt else None


def is_bound_for(courses: list[Course], spot: Spot, frame: int, known: float) -> bool:
    """True when a spot is where a rival was bound for, as far as that is known to these pixels."""
    return any(
        abs(spot.u - course.predicted(frame)) <= course.doubt(frame) <= known
        for course in courses
        if frame - course.frame <= FORGET_AFTER_FRAMES
    )


def left_over(courses: list[Course], spots: list[Spot], frame: int) -> Spot | None:
    """Choose the one spot that is no rival where each rival is seen where it was bound for; None where in doubt."""
    known = {on_course(spots, course.predicted(frame), course.doubt(frame)) for course in courses}
    free = [spot for spot in spots if spot not in known]
    return free[0] if None not in known and len(known) == len(courses) == len(spots) - 1 else None


def associated(
    tracks: list[Track], spots: list[Spot], frame: int, reach: float, own: float = math.nan
) -> tuple[list[Track], list[Spot]]:
    """Continue tracks by spots, the nearest first; returns the tracks and the spots that belong to none.

    A spot that is nearer to the column where the marker itself should be, ``own``, continues no track.
    """
    pairs = [
        (abs(spot.u - track.predicted(frame)), i, j)
        for i, track in enumerate(tracks)
        for j, spot in enumerate(spots)
    ]
    free = dict(enumerate(spots))
    found: dict[int, Track] = {}
    for away, i, j in sorted(pairs):
        if away > reach or i in found or j not in free or abs(spots[j].u - own) < away:
            continue
        track, spot = tracks[i], free.pop(j)
        u, elapsed = spot.u, frame - track.frame
        velocity = (u - track.u) / elapsed if elapsed > 0 else track.velocity
        past = track.places[-COURSE_FRAMES:] if elapsed > 0 else track.past
        found[i] = Track(u, velocity, frame, past, spot.v)
    return [found.get(i, track) for i, track in enumerate(tracks)], list(free.values())


def continued(tracks: list[Track], spots: list[Spot], frame: int, reach: float) -> list[Track]:
    """Tracks of these spots, with velocities where an earlier track leads to them; and of those gone from view."""
    tracks, free = associated(tracks, spots, frame, reach)
    return [track for track in tracks if frame - track.frame <= FORGET_AFTER_FRAMES] + [
        Track.of(spot, frame) for spot in free
    ]


def recent(tracks: list[Track], frame: int) -> list[Track]:
    """Tracks whose prediction still says where they are."""
    return [track for track in tracks if frame - track.frame <= _MEMORY_FRAMES]


def present(tracks: list[Track], frame: int, left: float, right: float, reach: float) -> list[Track]:
    """Tracks but those that have left the columns looked at, or have not been seen for long.

    One has left where these columns end in the first frame that does not show it. What vanishes elsewhere is hidden,
    and remains so wherever the beam swings meanwhile, and the columns with it.
    """
    return [
        track
        for track in tracks
        if track.frame == frame
        or (
            frame - track.frame <= FORGET_AFTER_FRAMES
            and (track.frame < frame - 1 or left + reach < track.u < right - reach)
        )
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
            tracks.append(Track(possible[0].u, 0.0, frame, track.places[-COURSE_FRAMES:], possible[0].v))
        else:
            tracks.append(track)
    return tracks, free


def may_be(tracks: list[Track], spot: Spot, frame: int, reach: float) -> bool:
    """True when a spot is in reach of a track that is hidden in this frame."""
    return any(track.frame < frame and abs(spot.u - track.u) <= reach for track in tracks)


def swinging(tracks: Sequence[Track], companies: Iterable[Sequence[Place]], frame: int) -> Track | None:
    """Choose the one spot that moves as the beam does, where every other rests or moves evenly.

    Parameters
    ----------
    tracks : list of Track -- the spots
    companies : iterable of sequence of Place -- where other markers were of late
    frame : int -- number of the frame, up to which the motions are compared

    Returns
    -------
    Track or None -- None where that is not plain, or only one is seen in this frame

    Notes
    -----
    A straight line is taken off from every motion. What is left of the spot's must be a positive multiple of what is
    left of another marker's, up to ``_EXPLAINED``, over frames in which no two of the spots were near enough to be
    exchanged.
    """
    tracks = [track for track in tracks if track.frame == frame]
    if len(tracks) < 2:
        return None
    ways = [dict(track.places) for track in tracks]
    first = frame
    while all(first - 1 in way for way in ways):
        first -= 1
    frames = range(first, frame)
    if len(frames) < _SWINGING_FRAMES:
        return None
    columns = np.array([[way[k] for k in frames] for way in ways])
    steps = np.abs(np.diff(columns)).max(axis=1)
    if any(
        np.abs(one - other).min() <= steps[i] + steps[j]
        for (i, one), (j, other) in combinations(enumerate(columns), 2)
    ):
        return None
    bends = _bends(columns)
    sizes = np.sqrt(np.mean(bends**2, axis=1))
    i = int(np.argmax(sizes))
    if sizes[i] < _MIN_BEND_PX or np.partition(sizes, -2)[-2] > REST_PX:
        return None
    for company in map(dict, companies):
        if all(k in company for k in frames):
            beside = _bends(np.array([[company[k] for k in frames]]))[0]
            share = float(bends[i] @ beside) / max(float(beside @ beside), 1e-12)
            if share > 0.0 and np.sqrt(np.mean((bends[i] - share * beside) ** 2)) <= _EXPLAINED * sizes[i]:
                return tracks[i]
    return None


def _bends(columns: FloatArray) -> FloatArray:
    """Departures of motions from straight lines, shape (n_motions, n_frames)."""
    times = np.arange(columns.shape[1])
    lines = np.polyfit(times, columns.T, 1)
    return np.asarray(columns - np.outer(lines[0], times) - lines[1][:, None])


def carried(
    own: Sequence[Place], companies: Sequence[tuple[Sequence[Place], float]]
) -> tuple[float, float] | None:
    """Tell where a marker is by where the others are, as all moved together until it was lost.

    Parameters
    ----------
    own : sequence of Place -- where it was in the last frames that showed it
    companies : sequence of (sequence of Place, float) -- where each of the others was then, and is now [px]

    Returns
    -------
    (float, float) or None -- its column, and three standard deviations [px]; None where no other was seen with it

    Notes
    -----
    Its column is a linear function of the others', u = c + sum_j b_j u_j. All that is known of b before is that a
    marker moves as another one does, give or take ``LEVERAGE`` times; the last frames tell the rest, as well as what
    they leave allows. A motion of another kind than in these frames is foreseen poorly, and the deviation says so.
    """
    places = dict(own)
    known = [(dict(way), at) for way, at in companies]
    beside = [(way, at) for way, at in known if len(places.keys() & way) >= _MIN_PLACES]
    ways = [way for way, _ in beside]
    frames = [frame for frame in places if all(frame in way for way in ways)]
    if len(frames) < _MIN_PLACES or not ways:
        return None
    last = places[frames[-1]]
    moved = np.array([[way[frame] - way[frames[-1]] for way in ways] for frame in frames])
    now = np.array([1.0, *(at - way[frames[-1]] for way, at in beside)])
    columns = np.array([places[frame] - last for frame in frames])
    design = np.column_stack([np.ones(len(frames)), moved])
    before = np.array([0.0, *[1.0 / len(ways)] * len(ways)])
    precision = np.diag([0.0, *[LEVERAGE**-2] * len(ways)])
    noise = REST_PX**2
    for _ in range(2):
        information = design.T @ design / noise + precision
        found = before + np.linalg.solve(information, design.T @ (columns - design @ before) / noise)
        noise = max(noise, float(np.sum((columns - design @ found) ** 2)) / max(1, len(frames) - len(now)))
    variance = noise + now @ np.linalg.solve(information, now)
    return last + float(now @ found), 3.0 * math.sqrt(float(variance))
