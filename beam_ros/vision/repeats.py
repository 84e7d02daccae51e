"""Images that come again: a camera without a new one, or a film made longer, shows the one before once more.

Noise alone keeps two exposures from being alike, so that what is alike bit for bit is one exposure: it shows where
things were then. Of things at rest, in drawn films or behind a codec that leaves out what does not change, this is as
good as another; of things that move it is wrong by a step.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from beam_ros.arrays import ImageArray

STILL_FRAMES = 50
"""An image that comes so often in a row shows things at rest."""
_MOVING = 4.0
"""A step of so many standard deviations of a place is more than noise."""
LATELY = 3
"""Steps that tell whether something moves: two of so many."""


def is_on_its_way(steps: Sequence[float], sigma: float) -> bool:
    """Return whether something moves on, and was not moved just once.

    Parameters
    ----------
    steps : sequence of float -- how far it came in the last steps, LATELY at most
    sigma : float -- standard deviation of its place
    """
    return len(steps) >= 2 and sorted(steps)[-2] > _MOVING * sigma


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
