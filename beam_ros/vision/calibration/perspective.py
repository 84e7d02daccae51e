"""Heights and scales along the beam where the camera looks at it from above or below, from its markers.

A pinhole camera that is pitched sees the upper end of the beam from farther away than the lower. With w = 1 + c z,
where c is the change of the distance with the height over the distance to the clamp (Hartley and Zisserman, Multiple
View Geometry, chapter 2: a line under a projective map),

    v(z) = (v0 - s_z z) / w,      s_x(z) = s_0 / w

Calibrated markers at known heights have a row v and a scale s_x each; two of them give all four numbers. A camera
whose pixels are not square, or whose height scale is another for any other reason, shows it in s_z.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from beam_ros.arrays import FloatArray
from beam_ros.vision.calibration.linear import LinearCalibration
from beam_ros.vision.errors import CalibrationError

_ROW_SD_PX = 0.05
"""What print and light leave of a marker's row, whatever is known of its height [px]."""
_SCALE_SD = 1e-4
"""What a swinging beam and the lens leave of a scale, relative."""


@dataclass(frozen=True)
class Perspective:
    """Rows and scales along the beam.

    Attributes
    ----------
    row_px : float -- row of the clamp [px]
    height_scale, travel_scale : float -- s_z and s_0: along the beam and along the hub's travel, at the clamp [px/m]
    recession : float -- c [1/m]
    """

    row_px: float
    height_scale: float
    travel_scale: float
    recession: float

    @classmethod
    def of(cls, calibration: LinearCalibration, height_sd_m: npt.ArrayLike) -> Perspective | None:
        """Fit the markers of a calibration that says at which heights and in which rows they were.

        Parameters
        ----------
        calibration : LinearCalibration
        height_sd_m : array_like, shape (n_markers,) -- standard deviations of the markers' heights [m]

        Returns
        -------
        Perspective or None -- None where it does not say, or there is one marker only

        Raises
        ------
        CalibrationError -- heights or rows are no numbers, or not one for each marker
        """
        provenance = calibration.provenance
        if "rows_px" not in provenance or calibration.n_markers < 2:
            return None
        heights, rows = _numbers(calibration, "heights_m"), _numbers(calibration, "rows_px")
        scales = np.asarray(calibration.pixels_per_metre)
        mean = float(np.mean(scales))
        scale_sd = np.sqrt(np.asarray(calibration.covariance)[:, 0, 0] + (_SCALE_SD * mean) ** 2)
        row_sd = np.hypot(_ROW_SD_PX, mean * np.asarray(height_sd_m, dtype=np.float64))

        def misfit(values: FloatArray) -> FloatArray:
            row, along, across, recession = values
            found = cls(row, along * mean, across * mean, recession)
            return np.concatenate(
                [(found.rows(heights) - rows) / row_sd, (found.scales(heights) - scales) / scale_sd]
            )

        slope, row = np.polyfit(heights, rows, 1)
        row, along, across, recession = least_squares(misfit, [row, -slope / mean, 1.0, 0.0], x_scale="jac").x
        return cls(float(row), float(along * mean), float(across * mean), float(recession))

    def rows(self, heights_m: npt.ArrayLike) -> FloatArray:
        """Rows of heights above the clamp [px]."""
        z = np.asarray(heights_m, dtype=np.float64)
        return np.asarray((self.row_px - self.height_scale * z) / (1.0 + self.recession * z))

    def heights(self, rows_px: npt.ArrayLike) -> FloatArray:
        """Heights above the clamp that are seen in rows [m]."""
        v = np.asarray(rows_px, dtype=np.float64)
        return np.asarray((self.row_px - v) / (self.height_scale + self.recession * v))

    def scales(self, heights_m: npt.ArrayLike) -> FloatArray:
        """Scales along the hub's travel at heights above the clamp [px/m]."""
        return np.asarray(
            self.travel_scale / (1.0 + self.recession * np.asarray(heights_m, dtype=np.float64))
        )


def _numbers(calibration: LinearCalibration, name: str) -> FloatArray:
    """Read one number for each marker from where a calibration comes from."""
    given: Any = calibration.provenance.get(name)
    try:
        values = np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError):
        values = np.empty(0)
    if values.shape != (calibration.n_markers,) or not np.all(np.isfinite(values)):
        raise CalibrationError(
            f"provenance.{name} of the calibration is {given!r}; expected {calibration.n_markers} numbers, one for "
            "each marker: calibrate again"
        )
    return values
