"""What a camera sees beside the beam: other bright spots, glare, and objects in between."""

from __future__ import annotations

import math
from dataclasses import dataclass

from beam_ros.vision.errors import VisionParameterError


@dataclass(frozen=True)
class SecondSpot:
    """A spot like the markers' that is no marker.

    Attributes
    ----------
    u_px, v_px : float -- centre [px]
    """

    u_px: float
    v_px: float


@dataclass(frozen=True)
class Glare:
    """A soft patch of light, added to what is there.

    Attributes
    ----------
    u_px, v_px : float -- centre [px]
    radius_px : float -- standard deviation of its Gaussian [px]
    grey : float -- height at the centre [grey levels of 255]
    """

    u_px: float
    v_px: float
    radius_px: float
    grey: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.radius_px) and self.radius_px > 0):
            raise VisionParameterError(f"Glare.radius_px is {self.radius_px!r}; expected a number > 0")


@dataclass(frozen=True)
class Occluder:
    """An upright rectangle before the camera.

    Attributes
    ----------
    left_px, top_px, right_px, bottom_px : float -- edges, sub-pixel [px]
    grey : float -- its grey level [of 255]
    """

    left_px: float
    top_px: float
    right_px: float
    bottom_px: float
    grey: float = 0.0

    def __post_init__(self) -> None:
        if not (self.left_px < self.right_px and self.top_px < self.bottom_px):
            raise VisionParameterError(
                f"Occluder spans columns {self.left_px!r} to {self.right_px!r} and rows {self.top_px!r} to "
                f"{self.bottom_px!r}; expected left < right and top < bottom"
            )


@dataclass(frozen=True)
class Disturbances:
    """Everything that does not belong to the beam, in one frame.

    Attributes
    ----------
    spots : tuple of SecondSpot
    glares : tuple of Glare
    occluders : tuple of Occluder -- drawn last
    """

    spots: tuple[SecondSpot, ...] = ()
    glares: tuple[Glare, ...] = ()
    occluders: tuple[Occluder, ...] = ()
