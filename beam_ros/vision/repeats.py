"""Images that come again: a camera without a new one, or a film made longer, shows the one before once more.

Noise alone keeps two exposures from being alike, so that what is alike bit for bit is one exposure: it shows where
things were then. Of things at rest, in drawn films or behind a codec that leaves out what does not change, this is as
good as another; of things that move it is wrong by a step. An analogue link, or a converter, gives such an image
noise of its own: then nothing steps by more than noise, although something should have, by how it moved until then.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from statistics import median

import numpy as np

from beam_ros.arrays import ImageArray

STILL_FRAMES = 50
"""An image that comes so often in a row shows things at rest."""
_MOVING = 4.0
"""A step of so many standard deviations of a place is more than noise."""
LATELY = 3
"""Steps that tell whether something moves: two of so many. What stands still for longer, noise aside, has stopped."""


def is_on_its_way(steps: Sequence[float], sigma: float) -> bool:
    """Return whether something moves on, and was not moved just once.

    Parameters
    ----------
    steps : sequence of float -- how far it came in the last steps, LATELY at most
    sigma : float -- standard deviation of its place
    """
    return len(steps) >= 2 and sorted(steps)[-2] > _MOVING * sigma


def expected_step(places: Sequence[tuple[int, float]], frame: int, sigma: float) -> tuple[float, float]:
    """How far something should have come since its last place, and by how much that may be wrong.

    Parameters
    ----------
    places : sequence of (int, float) -- number of a frame, and its place in that, rising [px]
    frame : int -- number of the frame that is asked for
    sigma : float -- standard deviation of a place [px]

    Returns
    -------
    (float, float) -- [px]; the second is infinite where too few places tell

    Notes
    -----
    The parabola through the last three places errs by the third divided difference, which is as large as it usually
    was, or as it was last, and whose variance by noise is (1 + 9 + 9 + 1) sigma^2 / 3!^2 at most:

        e = |u[t_0, t_1, t_2, t_3]| prod (t - t_i)

    As often as not it is larger; but then a step would have to be nothing by chance, to a hundredth of its usual
    size.
    """
    if len(places) < 4:
        return 0.0, math.inf
    # Divided differences: the slopes, then the bends, then the cubes, each of one place more.
    times, values = [t for t, _ in places], [u for _, u in places]
    tables = [values]
    for order in range(1, 4):
        steps = zip(tables[-1], tables[-1][1:], times, times[order:], strict=False)
        tables.append([(later - sooner) / (t - s) for sooner, later, s, t in steps])
    (t0, t1, t2), noise = times[-3:], _MOVING * math.sqrt(20.0) / 6 * sigma
    step = (frame - t2) * (tables[1][-1] + (frame - t1) * tables[2][-1])
    cubes = [abs(cube) for cube in tables[3]]
    cube = max(median(cubes), cubes[-1]) + noise
    return step, cube * (frame - t0) * (frame - t1) * (frame - t2)


def is_shown_again(seen: Iterable[tuple[Sequence[tuple[int, float]], float, float]], frame: int) -> bool:
    """Return whether an image shows an earlier one with noise of its own: nothing steps, and most should have.

    Parameters
    ----------
    seen : iterable of (sequence of (int, float), float, float) -- of every thing that is seen, its last places, its
        place now, and its standard deviation [px]
    frame : int -- number of the frame
    """
    n_moving = n_seen = 0
    for places, u, sigma in seen:
        # A step is the difference of two places.
        noise = _MOVING * math.sqrt(2.0) * sigma
        if not places or abs(u - places[-1][1]) > noise:
            return False
        n_seen += 1
        if any(
            abs(places[k][1] - places[k - 1][1]) > noise for k in range(-1, max(-LATELY, 1 - len(places)), -1)
        ):
            step, doubt = expected_step(places, frame, sigma)
            n_moving += abs(step) > doubt
    return 2 * n_moving > n_seen


class RepeatedImages:
    """Compares every image with the one before."""

    def __init__(self) -> None:
        self._before: ImageArray | None = None
        self._count = 0

    def is_repeated(self, image: ImageArray) -> bool:
        """True where an image is the one before, bit for bit, and has not been for so long that nothing moves.

        An image in the memory of the one before has taken its place, and nothing is known of that one.
        """
        before, self._before, row = self._before, image, len(image) // 2
        if (
            before is None
            or before.dtype != image.dtype
            or before.shape != image.shape
            or before[row].tobytes() != image[row].tobytes()
            or np.may_share_memory(before, image)
            or not np.array_equal(before, image)
        ):
            self._count = 0
            return False
        self._count += 1
        return self._count < STILL_FRAMES
