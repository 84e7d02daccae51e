"""What cameras and codecs do to a film, looked for beside the tracker: a repair, a spread, or a refusal for each.

| ailment | found in | answer |
|---|---|---|
| defective pixels | the first images, and those after a loss | mended; a spread where they lay in a marker |
| an image shown again, bit for bit | two images | refused |
| the same with noise of its own | the markers' steps | refused |
| two fields in one image | the rows of a marker | a spread |
| temporal noise reduction | what rests between two images | a spread |
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence

from beam_ros.arrays import ImageArray
from beam_ros.vision.defects import LOOKS, DefectivePixels
from beam_ros.vision.fields import InterlacedFields
from beam_ros.vision.noise_reduction import NoiseReduction
from beam_ros.vision.repeats import LATELY, RepeatedImages, is_shown_again


class Ailments:
    """Looks for all of them.

    Attributes
    ----------
    fields, reduction : InterlacedFields, NoiseReduction -- what is known of these
    """

    def __init__(self) -> None:
        self.fields = InterlacedFields()
        self.reduction = NoiseReduction()
        self._defects = DefectivePixels()
        self._repeats = RepeatedImages()
        self._look_until, self._n_again = LOOKS, 0

    def is_repeated(self, image: ImageArray) -> bool:
        """True where an image is the one before, bit for bit."""
        return self._repeats.is_repeated(image)

    def is_shown_again(
        self, seen: Iterable[tuple[Sequence[tuple[int, float]], float, float]], frame: int
    ) -> bool:
        """True where an image is the one before with noise of its own, as in ``vision.repeats``; not for long."""
        is_again = self._n_again < LATELY and is_shown_again(seen, frame)
        self._n_again = self._n_again + 1 if is_again else 0
        return is_again

    def watch(self, frame: int) -> None:
        """Look for defective pixels in the images that follow a frame."""
        self._look_until = frame + LOOKS

    def mended(self, image: ImageArray, frame: int, contrast: Callable[[], float]) -> ImageArray:
        """Return an image without its defective pixels, of a contrast that is asked for where they are looked for."""
        return self._defects.mended(image, contrast() if frame <= self._look_until else 0.0)

    def spread_px(
        self,
        place: tuple[float, float],
        disc: tuple[float, float],
        light: tuple[float, float],
        step: tuple[float, float],
        tail: float,
    ) -> float:
        """Standard deviation that they add to a marker's place [px].

        Parameters
        ----------
        place : (float, float) -- u and v [px]
        disc : (float, float) -- radius of the marker, and standard deviation of its rim's blur [px]
        light : (float, float) -- contrast of the marker, and noise of a pixel [grey levels]
        step : (float, float) -- how far it moves per frame, and the error of its linear prediction [px]
        tail : float -- second moment along u beyond its own [px^2]
        """
        spread = 0.0
        if self.fields.likely_apart > 0.0:  # the mean of two instants is off the middle one
            spread = math.hypot(spread, self.fields.likely_apart**2 / 8 * step[1])
        if self._defects.count:
            spread = math.hypot(spread, self._defects.pull(*place, disc, *light))
        if self.reduction.share > 0.0:
            spread = math.hypot(spread, self.reduction.lag_px(step[0], tail))
        return spread
