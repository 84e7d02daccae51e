"""Jumps: whether spots far from where the markers were are the markers, moved together.

One spot of a marker's kind that appears where the marker was not proves nothing: it may be a twin, and the
marker hidden. But a kick of the camera, a cut in a video, a step of the hub or a wide swing moves several markers at
once, and each is alone in its row. That most of them have twins that appear while they are hidden, and so that they
lie as a beam may lie, is not to be expected.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

TOGETHER_FRAMES = 5
"""Markers that were lost within so many frames of each other may have been lost for the same reason."""
NEVER = -(10**9)
"""Number of the frame in which a marker was lost that never was."""

Move = tuple[float, float]
"""How far along u and across the rows a marker, or what may be it, lies from where it was last seen [px]."""


def is_common(n_together: int, n_markers: int) -> bool:
    """True when so many of the markers, lost together, can have one reason: most of them, and two at least."""
    return n_together >= 2 and 2 * n_together > n_markers


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
