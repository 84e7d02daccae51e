"""The tracker's view of a frame, drawn into a colour copy of it: for people, never for measurement."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from beam_ros.arrays import ByteArray, ImageArray
from beam_ros.vision.tracking.tracker import FrameResult, SeenSpot

_VALID = (80, 220, 80)
_LOST = (60, 60, 255)
_CANDIDATE = (255, 180, 60)
_TEXT = cv2.FONT_HERSHEY_SIMPLEX
_SUB_PIXEL_BITS = 4


def draw_overlay(
    image: ImageArray,
    result: FrameResult,
    names: Sequence[str],
    *,
    marker_diameter_px: float,
    rows_px: Sequence[float] | None = None,
) -> ByteArray:
    """Draw what was measured into a colour copy of a frame.

    Parameters
    ----------
    image : ndarray, shape (height, width), uint8 or uint16
    result : FrameResult -- of this frame
    names : sequence of str -- of the markers, lowest first
    marker_diameter_px : float -- diameter of the circles [px]
    rows_px : sequence of float or None -- where to name markers that were not seen [px]

    Returns
    -------
    ndarray, shape (height, width, 3), uint8 -- blue, green, red
    """
    if image.dtype == np.uint16:
        peak = max(int(image.max()), 1)
        grey = np.asarray(image.astype(np.float32) * (255.0 / peak), dtype=np.uint8)
    else:
        grey = image
    canvas = np.ascontiguousarray(cv2.cvtColor(np.ascontiguousarray(grey), cv2.COLOR_GRAY2BGR))
    unit = 1 << _SUB_PIXEL_BITS
    radius = round((marker_diameter_px / 2 + 3) * unit)
    arm = round((marker_diameter_px / 2 + 7) * unit)
    for k, (name, marker) in enumerate(zip(names, result.markers, strict=True)):
        if marker.is_valid:
            x, y = round(marker.u_px * unit), round(marker.v_px * unit)
            cv2.circle(canvas, (x, y), radius, _VALID, 1, cv2.LINE_AA, _SUB_PIXEL_BITS)
            cv2.line(canvas, (x - arm, y), (x + arm, y), _VALID, 1, cv2.LINE_AA, _SUB_PIXEL_BITS)
            cv2.line(canvas, (x, y - arm), (x, y + arm), _VALID, 1, cv2.LINE_AA, _SUB_PIXEL_BITS)
            text = f"{name} {marker.u_px:.2f} +- {marker.sigma_px:.3f} px"
            place = (round(marker.u_px + marker_diameter_px), round(marker.v_px - marker_diameter_px / 2))
            cv2.putText(canvas, text, place, _TEXT, 0.4, _VALID, 1, cv2.LINE_AA)
        else:
            row = 14 * (k + 1) if rows_px is None else round(rows_px[k])
            cv2.putText(canvas, f"{name} {marker.reason}", (4, row), _TEXT, 0.4, _LOST, 1, cv2.LINE_AA)
    return np.asarray(canvas, dtype=np.uint8)


def draw_spots(picture: ByteArray, spots: Sequence[SeenSpot], names: Sequence[str]) -> ByteArray:
    """Mark what stands out in the markers' rows in a picture of ``draw_overlay``: as which marker, or why as none.

    Parameters
    ----------
    picture : ndarray, shape (height, width, 3), uint8 -- is drawn into
    spots : sequence of SeenSpot
    names : sequence of str -- of the markers, lowest first

    Returns
    -------
    ndarray -- the picture
    """
    for spot in spots:
        place = round(spot.u_px), round(spot.v_px)
        cv2.drawMarker(picture, place, _CANDIDATE, cv2.MARKER_TILTED_CROSS, 7, 1, cv2.LINE_AA)
        whose = "" if spot.marker is None else f"{names[spot.marker]}: "
        below = place[0] + 8, place[1] + 14
        cv2.putText(picture, f"{whose}{spot.word}", below, _TEXT, 0.35, _CANDIDATE, 1, cv2.LINE_AA)
    return picture
