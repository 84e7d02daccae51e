"""Frames of a film that show the image of a frame beside them: a converter that fills a film up puts them in.

A codec that keeps what changes gives such a frame back with a residual of its own, so that it is no longer the other
one bit for bit (``vision.repeats``). But nothing in it steps, between two steps that are not small, where the frames
on either side say that all should have moved on. Single such frames may be a coincidence; where several stand apart
from all other steps, the film is filled up. A cubic through the frames around tells which of those that share an
image was taken at its own time: ffmpeg fills a gap with the frame behind it, cameras with the one before.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from beam_ros.arrays import FloatArray

_SAME = 0.1
"""Steps below this share of those beside them, and of what the frames around foretell, are none; ..."""
_APART = 0.3
"""... up to this share they would be common, too, if they were small by chance."""
_MIN_REPEATS = 3
_CLEAR, _MOVING = 4.0, 2.0
"""Steps beside a repeated image, in standard deviations of a place: to show that a film is filled up, and in one."""
_TAIL = 2.0
"""So many times the residual of those that are clear may be that of others."""
_MAX_LENGTH = 4
"""More frames in a row that are alike show things at rest."""
_BETTER = 2.0
"""An image that lies so many times nearer to the cubic at one of its times than at the other was taken then."""
_REACH = 4
"""Frames from a repeated image in which those are looked for that the cubic goes through."""


@dataclass(frozen=True)
class RepeatedFrames:
    """Which frames share an image.

    Attributes
    ----------
    is_copy : ndarray of bool, shape (n_frames,) -- shows the image of the frame before
    is_wrong : ndarray of bool, shape (n_frames,) -- of those that share an image, all but the one that was taken at
        its time; all, where nobody can tell which it was
    """

    is_copy: np.ndarray
    is_wrong: np.ndarray


def find_repeated_frames(
    times_s: FloatArray, places: FloatArray, sigma: FloatArray, is_known: np.ndarray
) -> RepeatedFrames:
    """Find frames that show another frame's image, and those of them that were not taken at their time.

    Parameters
    ----------
    times_s : ndarray, shape (n_frames,) -- rising [s]
    places, sigma : ndarray, shape (n_frames, n_points) -- where points are, and standard deviations, in one unit; NaN
        where not seen; known copies have the places of the frame before
    is_known : ndarray of bool, shape (n_frames,) -- is known to show the image of the frame before
    """
    n = len(times_s)
    seen = np.isfinite(places)
    usual = np.array([np.median(s[k]) if np.any(k) else np.nan for s, k in zip(sigma.T, seen.T, strict=True)])
    scaled = places / np.maximum(usual, 1e-12)
    is_copy, own = is_known.copy(), np.flatnonzero(~is_known)
    is_copy[own] = _unmoved(times_s[own], scaled[own], n - len(own))
    is_wrong = np.zeros(n, dtype=bool)
    groups = list(_runs(is_copy))
    shares = is_copy.copy()
    shares[:-1] |= is_copy[1:]
    right = [_right_one(times_s, scaled, shares, first, last) for first, last in groups]
    # Where all that can be told were made in one way, so were the others. Where none can, as every image comes twice,
    # the first is taken throughout: that is late, if at all, by one and the same time.
    ways = {where for where in right if where is not None} or {False}
    for (first, last), where in zip(groups, right, strict=True):
        chosen = next(iter(ways)) if where is None and len(ways) == 1 else where
        is_wrong[first : last + 1] = True
        if chosen is not None:
            is_wrong[last if chosen else first] = False
    return RepeatedFrames(is_copy, is_wrong)


def _runs(is_copy: np.ndarray) -> Iterator[tuple[int, int]]:
    """First and last frame of all that share an image."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], is_copy, [False]]).astype(int)))
    for first, behind in zip(edges[::2], edges[1::2], strict=True):
        yield max(int(first) - 1, 0), int(behind) - 1


def _size(values: FloatArray) -> float:
    """Root mean square, 0 of none."""
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0


def _unmoved(times_s: FloatArray, scaled: FloatArray, n_known: int) -> np.ndarray:
    """Frames into which nothing steps although all should, if these and known ones show that a film is filled up."""
    n = len(scaled)
    steps = np.diff(scaled, axis=0, prepend=scaled[:1])
    alike: list[tuple[int, int, float]] = []
    # Steps that clearly are none, and how many more are small only.
    none: list[float] = []
    n_small = 0
    for k, length in product(range(2, n - 1), range(1, _MAX_LENGTH)):
        behind = k + length
        if behind >= n:
            continue
        # Where a swing turns, nothing steps either, but then it has come back to where it was.
        travel = scaled[behind] - scaled[k - 2]
        seen = np.isfinite(travel) & np.isfinite(steps[k:behind]).all(axis=0)
        own, moved = max(_size(step[seen]) for step in steps[k:behind]), _size(travel[seen])
        if moved < _MOVING or own >= _APART * moved:
            continue
        if own < _SAME * moved:
            alike.append((k, behind, own))
        if length > 1 or k < 3 or k + 2 >= n:
            continue
        around = np.array([k - 3, k - 2, k + 1, k + 2])
        should = np.diff(_cubic(times_s, scaled, around, times_s[k - 1 : k + 1]), axis=0)[0]
        told = [values[seen & np.isfinite(values)] for values in (steps[k - 1], steps[k + 1], should)]
        # A point by itself may stand still by chance, as two modes' steps cancel.
        least = min(_size(values) if values.size > 1 else 0.0 for values in told)
        if least > _CLEAR and own < _SAME * least:
            none.append(own)
        elif least > _CLEAR and own < _APART * least:
            n_small += 1
    found = np.zeros(n, dtype=bool)
    if len(none) + n_known >= _MIN_REPEATS + 2 * n_small:
        # Others are about as much alike as the clear ones are.
        residual = _TAIL * max(none, default=0.0)
        for first, behind, own in alike:
            found[first:behind] |= own <= residual
    return found


def _cubic(times_s: FloatArray, values: FloatArray, nodes: np.ndarray, at_s: FloatArray) -> FloatArray:
    """Lagrange's polynomial through some frames, at some times, shape (n_times, n_points)."""
    t = times_s[nodes]
    weights = np.array(
        [
            [np.prod([(at - t[j]) / (t[i] - t[j]) for j in range(len(t)) if j != i]) for i in range(len(t))]
            for at in at_s
        ]
    )
    return np.asarray(weights @ values[nodes])


def _right_one(
    times_s: FloatArray, scaled: FloatArray, shares: np.ndarray, first: int, last: int
) -> bool | None:
    """Whether the last (True) or the first (False) of frames that share an image was taken then; None: unclear."""
    n = len(scaled)
    is_free = ~shares & np.isfinite(scaled).any(axis=1)
    before = [k for k in range(first - 1, max(first - 1 - _REACH, -1), -1) if is_free[k]][:2]
    behind = [k for k in range(last + 1, min(last + 1 + _REACH, n)) if is_free[k]][:2]
    if len(before) < 2 or len(behind) < 2 or last - first >= _MAX_LENGTH:
        return None
    foretold = _cubic(times_s, scaled, np.array([*before, *behind]), times_s[[first, last]])
    whole = np.isfinite(foretold).all(axis=0) & np.isfinite(scaled[first])
    if not np.any(whole):
        return None
    at_first, at_last = (_size((scaled[first] - one)[whole]) for one in foretold)
    if max(at_first, at_last) < _CLEAR:
        return None
    if at_first > _BETTER * at_last:
        return True
    return False if at_last > _BETTER * at_first else None
