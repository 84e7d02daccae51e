"""Jumps: whether spots far from where the markers were are the markers, moved together.

One spot of a marker's kind that appears where the marker was not proves nothing: it may be a twin, and the
marker hidden. But a kick of the camera, a cut in a video or a step of the hub moves all markers at once, and the
next frame shows each of them, alone in its row. That all of them, or most of them and by the same way, have
twins that appear while they are hidden is not to be expected.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

TOGETHER_FRAMES = 5
"""Markers that were lost within so many frames of each other may have been lost for the same reason."""
NEVER = -(10**9)
"""Number of the frame in which a marker was lost that never was."""


class Move(NamedTuple):
    """How a marker, or what may be it, lies to where the marker was last seen before it was lost.

    Attributes
    ----------
    lost_at : int -- number of the frame in which the marker was not where it should have been
    along, across : float -- move along u and along v [px]
    """

    lost_at: int
    along: float
    across: float


def is_common(n_together: int, n_markers: int) -> bool:
    """True when so many of the markers, lost together, can have one reason: most of them, and two at least."""
    return n_together >= 2 and 2 * n_together > n_markers


def moved_together(
    found: Mapping[int, Move],
    seen: Mapping[int, Move],
    n_markers: int,
    *,
    max_difference: float,
    max_row_difference: float,
) -> list[int]:
    """Choose the lost markers that are what was found in their rows.

    Parameters
    ----------
    found : mapping of int to Move -- lost markers with one spot of their kind in their whole row
    seen : mapping of int to Move -- markers that are seen
    n_markers : int -- number of markers on the beam
    max_difference : float -- largest difference of the moves from one of them along u, unless all markers
        are found: then they may have moved by different ways [px]
    max_row_difference : float -- the same along v, always [px]

    Returns
    -------
    list of int -- keys of ``found``
    """
    whole = n_markers >= 2 and len(found) == n_markers
    moves = {**found, **seen}
    best: list[int] = []
    for reference in found.values():
        members = [
            k
            for k, move in moves.items()
            if abs(move.across - reference.across) <= max_row_difference
            and (
                whole
                or (
                    abs(move.along - reference.along) <= max_difference
                    and abs(move.lost_at - reference.lost_at) <= TOGETHER_FRAMES
                )
            )
        ]
        if len(members) > len(best) and is_common(len(members), n_markers):
            best = members
    return [k for k in best if k in found]
