"""Which spot of a row is the marker: a few hypotheses, weighed by motion, row, light and what hides things.

A hypothesis names the way of the marker and the ways of all other spots of its kind in its row. In every frame it
branches: each of these is one of the spots that are seen, is covered by something of another look, or is gone. The
remaining spots are new. The score of a branch is the sum of the log densities of the places and of the logs of the
probabilities of what became of each (D. B. Reid, "An algorithm for tracking multiple targets", 1979). The best
branches are kept. A marker is believed where the branches in which it is one and the same spot have all but
``DOUBT`` of the probability: nothing is invented, and identities are never exchanged.

While it is not certain which spot is the marker, it is expected where the other markers say (``carried``). What
moves as the beam does is explained by that, one that rests or passes by is not.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from heapq import nlargest
from typing import NamedTuple

import numpy as np

from beam_ros.arrays import FloatArray

DOUBT = 1e-4
"""A marker is believed where another spot is it with no more than this probability."""
COURSE_FRAMES = 25
"""Frames over which a way is remembered."""
FORGOTTEN_FRAMES = 100
"""A spot that is not the marker and is unseen for longer is forgotten."""
_APPEARS = math.log(1e-8)
"""Log density of what appears in a row, is like a marker, and is none [1/px per frame]: one in 10^5 frames of VGA."""
_ENTERS = math.log(1e-5)
"""The same at the edge of the picture [1/px per frame]."""
_APPEARS_UNLIKE = math.log(1e-2)
"""The same of what is of another brightness, where a marker is [1/px per frame]: one is as likely as the other."""
_RELIT = 1e-3
"""Probability that the light of one marker changes."""
_LEAPS, _LEAP_TOGETHER = 1e-10, 1e-4
"""Probability that a marker alone, and that most of them together, are anywhere in their rows in the next frame."""
_TOLD = 0.15
"""A marker moves as the others say with this probability at least."""
_SURE = 0.02
"""How something moves is never surer than up to this probability: it may change."""
_JUST_GONE = -4
"""Number of what is gone, and was not in the frame before."""
_TAIL = 0.05
"""Weight of the wide part of a distribution of places."""
_PLACE_SD_PX, _ROW_SD_PX = 0.03, 0.1
"""Least standard deviation of where a spot is foreseen, along u and across [px]: other spots are measured less
carefully than markers."""
_RATIO = 1.5
"""Standard deviation of a prediction over its mean error of late."""
_MIN_PLACES = 4
"""The others tell where a marker is from so many places."""
LEVERAGE = 2.5
"""A marker moves at most so many times as much as the others."""
_KEPT = 16
"""Branches that are kept."""
_NEGLIGIBLE = math.log(0.1 * DOUBT)
"""A branch is given up that is less likely by this than the best one."""

Place = tuple[int, float]
"""Number of a frame, and the column of something in it [px]."""

SEEN, COVERED, GONE = range(3)
"""What became of something: seen alone, in one with something else or under it, not to be seen."""
_BECOMES = (
    (math.log(0.95), math.log(0.05), math.log(1e-3)),
    (math.log(0.05), math.log(0.95), math.log(1e-5)),
    (math.log(0.1), math.log(0.05), math.log(0.85)),
)
"""Log probabilities with which what was seen, covered or gone becomes seen, covered or gone in the next frame. That
something vanishes where nothing covers it is rare; what vanishes together does so for one reason."""


class SpotPath(NamedTuple):
    """The way of a spot.

    Attributes
    ----------
    places : tuple of Place -- where it was in the last frames that showed it
    v : float -- row in which it was last seen [px]
    hold_error, linear_error : float -- how well it is predicted by staying, and by its last step [px]
    state : int -- what became of it: SEEN, COVERED or GONE
    is_relit : bool -- its light has changed
    trust : float -- probability that it moves as the other markers say
    rests : float -- probability that it rests, as far as it moves by itself
    """

    places: tuple[Place, ...]
    v: float
    hold_error: float = 1.0
    linear_error: float = 1.0
    state: int = SEEN
    is_relit: bool = False
    trust: float = 0.5
    rests: float = 0.5

    @property
    def frame(self) -> int:
        """Number of the frame in which it was last seen."""
        return self.places[-1][0]

    @property
    def u(self) -> float:
        """Column in which it was last seen [px]."""
        return self.places[-1][1]

    @property
    def velocity(self) -> float:
        """Its last step [px per frame]."""
        if len(self.places) < 2:
            return 0.0
        (before, u), (frame, now) = self.places[-2:]
        return (now - u) / (frame - before)

    def predicted(self, frame: int) -> tuple[float, float]:
        """Where it should be in a frame, and the standard deviation of that [px]."""
        n = frame - self.frame
        hold, linear = _RATIO * self.hold_error * n, _RATIO * self.linear_error * n * (n + 1) / 2
        if linear < hold:
            return self.u + self.velocity * n, _PLACE_SD_PX + linear
        return self.u, _PLACE_SD_PX + hold

    def foreseen(self, u: float, frame: int, wide: float, least: float) -> tuple[float, float]:
        """Density of its place in a frame by its own motion, to a wide and a least standard deviation [px].

        Returns
        -------
        (float, float) -- density [1/px], and the probability that it rests if it is there
        """
        at, sd = self.predicted(frame)
        moving = _mixture(u - at, max(sd, least), max(wide, sd))
        return _weighed(_mixture(u - self.u, max(_PLACE_SD_PX, least), wide), moving, self.rests)

    def extended(self, frame: int, seen: Possible, trust: float, rests: float) -> SpotPath:
        """Go on to a spot in a later frame."""
        n = frame - self.frame
        step = (seen.u - self.u) / n
        share = max(0.2, 1.0 / (len(self.places) + 1))
        hold = self.hold_error + share * (abs(step) - self.hold_error)
        linear = self.linear_error + share * (abs(step - self.velocity) - self.linear_error)
        places = *self.places[1 - COURSE_FRAMES :], (frame, seen.u)
        return SpotPath(places, seen.v, hold, linear, SEEN, not seen.is_lit, trust, rests)


class Possible(NamedTuple):
    """A spot that may be the marker: its place [px], and whether it has the light that the marker should have."""

    u: float
    v: float
    is_lit: bool = True


class View(NamedTuple):
    """What a frame says of a marker.

    Attributes
    ----------
    frame : int -- its number
    candidates : sequence of Possible
    things : sequence of float -- columns of what is of another look, and may cover the marker [px]
    left, right : float -- columns between which the beam reaches beside the markers that are seen [px]
    width : float -- of the picture [px]
    row : float -- of the marker [px]
    row_sd : callable -- of a column: standard deviation of the row there; infinity where nobody knows [px]
    row_reach : float -- how far from there spots are looked for [px]
    jump : callable -- how far it may come in so many frames, five standard deviations [px]
    diameter : float -- of a marker [px]
    stir : float -- least standard deviation with which its place is foreseen, as the other markers move [px]
    company : callable -- of its last places: where the other markers say that it is now, and the standard
        deviation [px]; None where they do not
    """

    frame: int
    candidates: Sequence[Possible]
    things: Sequence[float]
    left: float
    right: float
    width: float
    row: float
    row_sd: Callable[[float], float]
    row_reach: float
    jump: Callable[[int], float]
    diameter: float
    stir: float
    company: Callable[[tuple[Place, ...]], tuple[float, float] | None]

    def appears(self, seen: Possible) -> float:
        """Log density of what appears where a candidate is, and is none [1/px]."""
        if not seen.is_lit:
            return _APPEARS_UNLIKE
        edge = self.jump(1)
        return _APPEARS if edge < seen.u < self.width - edge else _ENTERS


@dataclass
class Hypothesis:
    """Which way is the marker's, and which are others', with the log of its weight."""

    weight: float
    marker: SpotPath
    others: tuple[SpotPath, ...] = ()


class Fate(NamedTuple):
    """What may have become of a way: gain over what appears, number of the candidate or -1 - state, and the way."""

    gain: float
    number: int
    path: SpotPath


class Belief:
    """What is known of which spot in a row is the marker.

    Attributes
    ----------
    hypotheses : list of Hypothesis -- best first; empty where nothing but the marker was ever seen in its row
    """

    def __init__(self) -> None:
        self.hypotheses: list[Hypothesis] = []

    @property
    def is_alone(self) -> bool:
        """True where nothing else of the marker's kind is known in its row."""
        return not self.hypotheses or (len(self.hypotheses) == 1 and not self.hypotheses[0].others)

    @property
    def others(self) -> tuple[SpotPath, ...]:
        """Ways of other spots, as is most likely."""
        return self.hypotheses[0].others if self.hypotheses else ()

    def is_watched(self, frame: int, memory_frames: int) -> bool:
        """True where it is not certain which spot is the marker, or another one was seen so many frames ago."""
        return len(self.hypotheses) > 1 or any(frame - path.frame <= memory_frames for path in self.others)

    def clear(self) -> None:
        """Forget all but the marker."""
        self.hypotheses = []

    def begin(self, paths: Sequence[SpotPath]) -> None:
        """Let each of some ways be the marker's, one as likely as the other."""
        self.hypotheses = [
            Hypothesis(0.0, path, (*paths[:k], *paths[k + 1 :])) for k, path in enumerate(paths)
        ]

    def is_new(self, u: float, frame: int) -> bool:
        """True where what is in a column is nothing else that was seen before a frame."""
        return (
            math.fsum(
                math.exp(own.weight)
                for own in self.hypotheses
                if any(path.u == u and path.places[0][0] < frame for path in own.others)
            )
            <= DOUBT
        )

    def take(self, u: float) -> None:
        """Let what is in a column be the marker."""
        for own in self.hypotheses:
            ways = own.marker, *own.others
            found = [path for path in ways if path.u == u]
            if found:
                others = tuple(path for path in own.others if path is not found[0])
                self.hypotheses = [Hypothesis(0.0, found[0], others)]
                return

    def join(self, marker: SpotPath | None, share: float) -> None:
        """Take note that what is seen of the marker may, with some probability, be two spots in one."""
        self._follow(marker)
        found = []
        for own in self.hypotheses:
            place = own.marker._replace(
                places=own.marker.places[-1:], hold_error=1.0, linear_error=1.0, state=COVERED
            )
            hidden = own.marker._replace(state=COVERED)
            found.append(Hypothesis(own.weight + math.log(share), hidden, (*own.others, place)))
            found.append(Hypothesis(own.weight + math.log1p(-share), hidden, own.others))
        self.hypotheses = found

    def update(self, marker: SpotPath | None, view: View) -> int | None:
        """Carry a frame into what is known.

        Parameters
        ----------
        marker : SpotPath or None -- the way of a marker, as far as it was seen for certain
        view : View

        Returns
        -------
        int or None -- number of the candidate that is the marker; None where that is not certain
        """
        self._follow(marker)
        if not self.hypotheses:
            return None
        branches = [branch for own in self.hypotheses for branch in self._branches(own, view)]
        merged: dict[object, Hypothesis] = {}
        for branch in nlargest(4 * _KEPT, branches, key=lambda own: own.weight):
            # What is at the same places now, and was told from each other so, has one future.
            key = (
                branch.marker.places[-1],
                branch.marker.state,
                frozenset(path.places[-1] for path in branch.others),
            )
            if key in merged:
                best = merged[key]
                best.weight = float(np.logaddexp(best.weight, branch.weight))
            else:
                merged[key] = branch
        kept = nlargest(_KEPT, merged.values(), key=lambda own: own.weight)
        total = math.fsum(math.exp(own.weight - kept[0].weight) for own in kept)
        offset = kept[0].weight + math.log(total)
        for own in kept:
            own.weight -= offset
        self.hypotheses = [own for own in kept if own.weight > _NEGLIGIBLE]
        shares = [0.0] * len(view.candidates)
        for own in self.hypotheses:
            for j, seen in enumerate(view.candidates):
                if own.marker.places[-1] == (view.frame, seen.u):
                    shares[j] += math.exp(own.weight)
        best_share = max(shares, default=0.0)
        return shares.index(best_share) if best_share >= 1.0 - DOUBT else None

    def _follow(self, marker: SpotPath | None) -> None:
        """Take over a way that goes on farther than the only one that is known."""
        if marker is not None and (
            not self.hypotheses
            or (len(self.hypotheses) == 1 and marker.frame > self.hypotheses[0].marker.frame)
        ):
            self.hypotheses = [Hypothesis(0.0, marker, self.others)]

    def _branches(self, own: Hypothesis, view: View) -> list[Hypothesis]:
        """What may have become of a hypothesis in a frame."""
        partial: list[tuple[float, tuple[Fate, ...]]] = [(own.weight, ())]
        for k, path in enumerate((own.marker, *own.others)):
            fates = self._fates(path, view, is_marker=k == 0)
            partial = nlargest(
                2 * _KEPT,
                (
                    # What is hidden together is so for one reason.
                    (score if fate.number < 0 and fate.number in used else score + fate.gain, (*before, fate))
                    for score, before in partial
                    for used in [[other.number for other in before]]
                    for fate in fates
                    if fate.number < 0 or fate.number not in used
                ),
                key=lambda branch: branch[0],
            )
        return [self._carried_on(score, fates, view) for score, fates in partial]

    @staticmethod
    def _carried_on(score: float, fates: tuple[Fate, ...], view: View) -> Hypothesis:
        """Go on with ways that did not leave, and begin with spots that belong to none."""
        used, edge = [fate.number for fate in fates], view.jump(1)
        others = [
            path
            for _, _, path in fates[1:]
            if path.state == SEEN
            or (
                view.frame - path.frame <= FORGOTTEN_FRAMES
                # What is last seen at the edge has left.
                and (view.frame - path.frame > 1 or view.left + edge < path.u < view.right - edge)
            )
        ]
        others += [
            SpotPath(((view.frame, seen.u),), seen.v, is_relit=not seen.is_lit)
            for j, seen in enumerate(view.candidates)
            if j not in used
        ]
        return Hypothesis(score, fates[0].path, tuple(others))

    def _fates(self, path: SpotPath, view: View, *, is_marker: bool) -> list[Fate]:
        """All that may have become of a way."""
        becomes = _BECOMES[path.state]
        if view.frame == path.frame:
            return [Fate(0.0, -1 - SEEN, path)]
        told = None
        if is_marker and (path.state != SEEN or len(self.hypotheses) > 1):
            told = view.company(path.places)
        fates = []
        for j, seen in enumerate(view.candidates):
            if is_marker and not view.left <= seen.u <= view.right:
                continue
            density, trust, rests = self._density(path, seen, view, told)
            row, row_sd = (view.row, view.row_sd(seen.u)) if is_marker else (path.v, _ROW_SD_PX)
            wide = 2.0 * row_sd if is_marker else view.row_reach
            if math.isinf(row_sd) and path.state == SEEN:
                row, row_sd, wide = path.v, _ROW_SD_PX, view.row_reach
            if is_marker:
                density = density * (_RELIT if seen.is_lit == path.is_relit else 1.0)
                density += _LEAPS / view.width if told is None else 0.0
            if math.isfinite(row_sd):
                density *= 2.0 * view.row_reach * _mixture(seen.v - row, row_sd, wide)
            if density > 0.0:
                gain = math.log(density) - view.appears(seen) + becomes[SEEN]
                fates.append(Fate(gain, j, path.extended(view.frame, seen, trust, rests)))
        return fates + self._hidden(path, view, told, is_marker=is_marker)

    @staticmethod
    def _density(
        path: SpotPath, seen: Possible, view: View, told: tuple[float, float] | None
    ) -> tuple[float, float, float]:
        """Density of a spot on a way [1/px]; and the probabilities that this moves as told, and that it rests."""
        wide, least = view.jump(view.frame - path.frame) / 5.0, view.stir if told else 0.0
        own, rests = path.foreseen(seen.u, view.frame, wide, least)
        if told is None:
            return own, path.trust, rests
        at, sd = told[0], math.hypot(told[1], view.stir)
        together = _mixture(seen.u - at, sd, 4.0 * sd + 1.0)
        if path.state != SEEN:
            return together, path.trust, rests
        density, trust = _weighed(together, own, path.trust)
        return density, max(trust, _TOLD), rests

    @staticmethod
    def _hidden(
        path: SpotPath, view: View, told: tuple[float, float] | None, *, is_marker: bool
    ) -> list[Fate]:
        """Ways of being hidden: in one with something or under it, or gone."""
        becomes = _BECOMES[path.state]
        at, sd = told or path.predicted(view.frame)
        unlike = [*view.things, *(seen.u for seen in view.candidates if not seen.is_lit)]
        fates = []
        if any(abs(u - at) <= view.diameter + 3.0 * sd for u in unlike):
            fates.append(Fate(becomes[COVERED], -1 - COVERED, path._replace(state=COVERED)))
        gone, number = becomes[GONE], -1 - GONE if path.state == GONE else _JUST_GONE
        if is_marker and path.state == SEEN and not view.left < path.u < view.right:
            gone += 2.0 * math.log(_RELIT)  # what leaves the reach of the beam is no marker
        return [*fates, Fate(gone, number, path._replace(state=GONE))]


def _weighed(one: float, other: float, share: float) -> tuple[float, float]:
    """Density by two models, the first of which has some share; and its share afterwards (Bayes' rule)."""
    density = share * one + (1.0 - share) * other
    return density, min(max(share * one / density, _SURE), 1.0 - _SURE) if density > 0.0 else share


def _mixture(away: float, sd: float, wide: float) -> float:
    """Density of a normal distribution with a wide part."""
    narrow = (1.0 - _TAIL) / sd * math.exp(-0.5 * (away / sd) ** 2)
    return (narrow + _TAIL / wide * math.exp(-0.5 * (away / wide) ** 2)) / math.sqrt(2.0 * math.pi)


def carried(
    own: Sequence[Place], companies: Sequence[tuple[Sequence[Place], float]], frame: int
) -> tuple[float, float] | None:
    """Tell where a marker is by where the others are, as all moved together until it was lost.

    Parameters
    ----------
    own : sequence of Place -- where it was in the last frames that showed it
    companies : sequence of (sequence of Place, float) -- where each of the others was then, and is now [px]
    frame : int -- number of the frame now

    Returns
    -------
    (float, float) or None -- its column, and the standard deviation [px]; None where no other was seen with it

    Notes
    -----
    Since it was seen last it moved as the others did, u = sum_j b_j u_j, and astray, as a random walk with the
    variance q per frame. All that is known of b before is that a marker moves as another one does, give or take
    ``LEVERAGE`` times. The last frames tell b and q. A motion of another kind than in these is foreseen poorly, and
    the deviation says so.
    """
    places = dict(own)
    beside = [
        (way, at)
        for way, at in ((dict(way), at) for way, at in companies)
        if len(places.keys() & way) >= _MIN_PLACES
    ]
    frames = [number for number in places if all(number in way for way, _ in beside)]
    if len(frames) < _MIN_PLACES or not beside:
        return None
    last = frames[-1]
    lags = last - np.array(frames[:-1], dtype=float)
    moved = np.array([[way[number] - way[last] for way, _ in beside] for number in frames[:-1]])
    now = np.array([at - way[last] for way, at in beside])
    columns = np.array([places[number] - places[last] for number in frames[:-1]])
    before = np.full(len(beside), 1.0 / len(beside))
    astray = 0.0
    for _ in range(3):
        noise = 2.0 * _PLACE_SD_PX**2 + astray * lags
        information = (moved.T / noise) @ moved + np.eye(len(beside)) / LEVERAGE**2
        found = before + np.linalg.solve(information, (moved.T / noise) @ (columns - moved @ before))
        astray = max(0.0, float(np.mean(((columns - moved @ found) ** 2 - 2.0 * _PLACE_SD_PX**2) / lags)))
    variance = (
        2.0 * _PLACE_SD_PX**2 + astray * (frame - last) + float(now @ np.linalg.solve(information, now))
    )
    return places[last] + float(now @ found), math.sqrt(variance)


class Leap(NamedTuple):
    """How far along u and across the rows a marker, or what may be it, lies from where it was last seen [px]."""

    u: float
    v: float


class Room(NamedTuple):
    """How far markers may go in one leap: standard deviations [px].

    Attributes
    ----------
    n_markers : int -- on the beam
    width, bend, alone : float -- along u: of all alike, of the tip by bending, of each by itself
    rows, row_alone : float -- across the rows: of all alike, of each by itself
    """

    n_markers: int
    width: float
    bend: float
    alone: float
    rows: float
    row_alone: float


def moved_together(found: Mapping[int, Leap], seen: Mapping[int, Leap], room: Room) -> bool:
    """Decide whether most markers went elsewhere in one leap, where what was found in their rows shows them.

    Parameters
    ----------
    found : mapping of int to Leap -- lost markers with one new spot of their kind in their whole row
    seen : mapping of int to Leap -- markers that are seen where they may be
    room : Room -- how far they may go

    Notes
    -----
    A hub moves all markers alike, by h; a beam that bends moves the upper ones farther, by b times their number:

        d_k = h + b k / n + e_k        h, b, e_k normal, e_k alone as far as a marker is believed by itself

    The density of the moves that were found, given those that are seen, is compared with the one of as many spots
    that appear while the markers vanish for one reason.
    """
    moves = {**found, **seen}
    n_alike = sum(
        k in found
        or (abs(move.u) > room.alone and any(abs(move.u - at.u) <= 3.0 * room.alone for at in found.values()))
        for k, move in moves.items()
    )
    if not found or n_alike < 2 or 2 * n_alike <= room.n_markers:
        return False
    numbers = np.array([*seen, *found], dtype=float)
    height = (numbers + 1.0) / room.n_markers
    along = room.width**2 + np.outer(height, height) * room.bend**2 + np.eye(len(numbers)) * room.alone**2
    across = np.full(along.shape, room.rows**2) + np.eye(len(numbers)) * room.row_alone**2
    together = math.log(_LEAP_TOGETHER)
    for covariance, move in (
        (along, [moves[int(k)].u for k in numbers]),
        (across, [moves[int(k)].v for k in numbers]),
    ):
        known = len(seen)
        together += _log_normal(np.array(move), covariance)
        together -= _log_normal(np.array(move[:known]), covariance[:known, :known])
    apart = len(found) * (_APPEARS - math.log(2.0 * room.rows)) + _BECOMES[SEEN][GONE]
    return together - apart > -math.log(DOUBT)


def _log_normal(away: FloatArray, covariance: FloatArray) -> float:
    """Log density of a normal distribution of mean zero."""
    if not len(away):
        return 0.0
    _, log_det = np.linalg.slogdet(covariance)
    squared = float(away @ np.linalg.solve(covariance, away))
    return -0.5 * (squared + float(log_det) + len(away) * math.log(2.0 * math.pi))
