"""Looking for a marker in its row: which spots look like it, why others do not, and what one disc explains."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from beam_ros.arrays import ImageArray
from beam_ros.vision.parameters import TrackerParameters
from beam_ros.vision.tracking.appearance import Appearance, Light
from beam_ros.vision.tracking.spots import Reason, Spot, SpotMeter, disc_scatter, upright_spot

_THRESHOLD = 0.5
"""Fraction of a contrast at which a marker is looked for."""
_OTHER_LIGHT = 0.25
"""Where the row's strongest contrast differs by more than this from the marker's, both are tried."""
_SIGNIFICANT = 5.0
"""Standard deviations of noise and texture that are left to a spot: one beyond them that rests before a texture is
never acquired."""


class RowSpots(NamedTuple):
    """What lies in a marker's row.

    Attributes
    ----------
    alike : list of (Spot, Light) -- spots with the marker's appearance, each in its own light
    others : list of (float, Reason) -- column of every other spot [px], and why it is not the marker's image
    changed : list of Spot -- those of the others that are as bright as the marker, and of another size or shape
    """

    alike: list[tuple[Spot, Light]]
    others: list[tuple[float, Reason]]
    changed: list[Spot]

    def nearest(self, u: float) -> Reason:
        """Why the other spot nearest to a column is not the marker's image; "hidden" where there is none."""
        nearest: tuple[float, Reason] = min(
            self.others, key=lambda other: abs(other[0] - u), default=(u, "hidden")
        )
        return nearest[1]


def spots_in_row(
    meter: SpotMeter,
    image: ImageArray,
    row: float,
    reach: float,
    light: Light,
    appearance: Appearance,
    own: float,
    shear: Callable[[float], float],
) -> RowSpots:
    """Find spots with a marker's appearance in a band of the image from edge to edge.

    Parameters
    ----------
    meter : SpotMeter
    image : ndarray, shape (height, width)
    row, reach : float -- middle of the band, and how far from it spots may lie [px]
    light, appearance : Light, Appearance -- of the marker
    own : float -- column of the spot that is the marker itself and is left out [px]; NaN for none
    shear : callable -- of a spot in a column, by a rolling shutter, at most [px/px]
    """
    top = max(0, math.floor(row - reach) - meter.half)
    bottom = min(image.shape[0], math.ceil(row + reach) + meter.half + 1)
    found = RowSpots([], [], [])
    if bottom <= top:
        return found
    band, contrasts = image[top:bottom], [light.contrast]
    if not math.isnan(own) and meter.is_alone(band, light, _THRESHOLD * light.contrast, own):
        return found
    relief = meter.relief(band)
    if math.isnan(own):
        most = relief.most
        if abs(most / light.contrast - 1) > _OTHER_LIGHT and most >= meter.parameters.min_contrast_grey:
            contrasts.append(most)
    for contrast in contrasts:
        for x, y, background, is_crowded in meter.centres(relief, _THRESHOLD * contrast):
            v = top + y
            if abs(x - own) < meter.radius or abs(v - row) > reach + meter.radius:
                continue
            noise = 1.2 * light.noise * max(1.0, contrast / light.contrast)
            candidate = meter.candidate(image, x, v, background, known_noise=noise, is_narrow=is_crowded)
            if candidate is None:
                found.others.append((x, "shape"))
                continue
            spot, own_light, gates = meter.undimmed(image, *candidate, appearance, is_narrow=is_crowded)
            gates = gates._replace(row=(row - reach, row + reach))
            why = meter.judge(upright_spot(spot, 0.0, shear(spot.u)), gates)
            if why == "jump":
                continue
            if why != "ok":
                found.others.append((x, why))
                if why in ("area", "shape"):
                    found.changed.append(spot)
            elif all(math.dist(spot[:2], other[:2]) > 1.0 for other, _ in found.alike):
                found.alike.append((spot, own_light))
    return found


@dataclass(frozen=True)
class OneDisc:
    """Whether one disc explains a spot that was never seen before.

    Attributes
    ----------
    reason : Reason -- "ok", or why no disc does, at rest or smeared along u
    excess : float -- second moment along u beyond that along v, which a smear must explain [px^2]
    covariance : float -- which the shear of a rolling shutter must explain [px^2]
    tolerance : float -- of both, for a disc at rest [px^2]
    """

    reason: Reason
    excess: float
    covariance: float
    tolerance: float


def one_disc(
    spot: Spot,
    light: Light,
    disc: Appearance,
    parameters: TrackerParameters,
    narrower: float = 0.0,
    shear: float = 0.0,
) -> OneDisc:
    """Compare a spot with the image of one disc, and with what that would be at rest.

    The second moments of discs are greater by so much than their areas say, or less where it is negative [px^2]; a
    rolling shutter shears them by so much at most [px/px].

    Notes
    -----
    A blurred disc of area S, seen with the aspect q, has second moments q S / (4 pi) + b^2 along u and
    S / (4 pi q) + b^2 along v, b the blur. A smear of length s adds s^2 / 12 along u, and leaves of the area and of
    the moment along v what is known of it. A second disc that touches adds area, which the moment along v does not
    follow.
    """
    scatter = disc_scatter(light, disc.area)
    tolerance = (parameters.shape_tolerance + _SIGNIFICANT * 1.6 * scatter) * disc.variance_v
    uniform = disc.area / (4 * math.pi)
    excess = spot.variance_u - disc.variance_v + uniform * (1 / parameters.aspect - parameters.aspect)
    is_round = (
        excess >= -tolerance
        and abs(spot.covariance) <= tolerance + shear * disc.variance_v
        and disc.variance_v - uniform / parameters.aspect >= narrower - tolerance
    )
    return OneDisc("ok" if is_round else "shape", excess, spot.covariance, tolerance)
