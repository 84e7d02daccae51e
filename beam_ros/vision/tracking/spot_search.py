"""Looking for a marker in a part of the image: which spots look like it, and why the others do not."""

from __future__ import annotations

from beam_ros.arrays import ImageArray
from beam_ros.vision.tracking.appearance import Appearance, Light
from beam_ros.vision.tracking.spots import Reason, Spot, SpotMeter

_THRESHOLD = 0.5
"""Fraction of a marker's own contrast at which it is looked for."""


def alike_spots(
    meter: SpotMeter,
    image: ImageArray,
    window: tuple[int, int, int, int],
    light: Light,
    appearance: Appearance,
    own: float,
    rows: tuple[float, float] | None = None,
) -> tuple[list[tuple[Spot, Light]], list[tuple[float, Reason]]]:
    """Find spots with a marker's appearance in a window of the image, each in its own light.

    Parameters
    ----------
    meter : SpotMeter
    image : ndarray, shape (height, width)
    window : (int, int, int, int) -- left, top, right, bottom, the last two exclusive [px]
    light, appearance : Light, Appearance -- of the marker
    own : float -- column of the spot that is the marker itself and is left out [px]; NaN for none
    rows : (float, float) or None -- rows between which the spots lie [px]; None: about the marker's own

    Returns
    -------
    alike : list of (Spot, Light)
    others : list of (float, Reason) -- column of every other spot [px], and why it is not the marker's image
    """
    left, top, right, bottom = window
    alike: list[tuple[Spot, Light]] = []
    others: list[tuple[float, Reason]] = []
    if right <= left or bottom <= top:
        return alike, others
    for x, y, is_crowded in meter.centres(
        image[top:bottom, left:right], light.background, _THRESHOLD * light.contrast
    ):
        u = left + x
        if abs(u - own) < meter.radius:
            continue
        candidate = meter.candidate(
            image, u, top + y, light.background, known_noise=1.2 * light.noise, is_narrow=is_crowded
        )
        if candidate is None:
            others.append((u, "shape"))
            continue
        spot, own_light = candidate
        gates = meter.gates(own_light, appearance)
        why = meter.judge(spot, gates if rows is None else gates._replace(row=rows))
        if abs(own_light.contrast / light.contrast - 1) > meter.parameters.brightness_tolerance:
            why = "brightness"
        if why != "ok":
            others.append((u, why))
        elif all(abs(spot.u - other.u) > 1.0 or abs(spot.v - other.v) > 1.0 for other, _ in alike):
            alike.append(candidate)
    return alike, others
