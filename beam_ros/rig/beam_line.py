"""The deflected beam as a line for people to look at: from the markers' displacements, as far as these determine it.

    u(z) = alpha + sum_i phi_i(z) q_i

with the mode shapes of the rig's model. A few markers cannot determine many modes. Every coordinate q_i therefore has
a prior of zero: the first mode may deflect the tip as far as the rig allows, the others as far as the same energy
takes them, which falls with their frequency. The hub's position is what the markers say. The fit is then linear,
always solvable, and its covariance says where it knows nothing: the line ends there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from beam_ros.arrays import FloatArray
from beam_ros.rig.rig import Rig
from beam_ros.vision.errors import VisionParameterError

_POINTS = 41
_KNOWN_SHARE = 0.1
"""The line is drawn where its standard deviation is below this share of the largest tip deflection."""
_UNKNOWN_HUB_SD_M = 1.0
"""Prior standard deviation of the hub's position [m]: farther than any rig travels."""


@dataclass(frozen=True)
class BeamShape:
    """A fitted shape.

    Attributes
    ----------
    hub_m : float -- alpha [m]
    coordinates : ndarray, shape (n_modes,) -- q, in the units of the mode shapes
    covariance : ndarray, shape (1 + n_modes, 1 + n_modes) -- of (alpha, q)
    """

    hub_m: float
    coordinates: FloatArray
    covariance: FloatArray

    def displacement(self, mode_shapes: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Absolute displacement at other heights.

        Parameters
        ----------
        mode_shapes : array_like, shape (n_heights, n_modes) -- phi_i(z) there

        Returns
        -------
        u, sigma : ndarray, shape (n_heights,) -- displacement and its standard deviation [m]
        """
        shapes = np.atleast_2d(np.asarray(mode_shapes, dtype=np.float64))
        design = np.hstack([np.ones((shapes.shape[0], 1)), shapes])
        u = self.hub_m + shapes @ self.coordinates
        variance = np.einsum("ij,jk,ik->i", design, self.covariance, design)
        return np.asarray(u), np.sqrt(np.maximum(variance, 0.0))


class BeamShapeFitter:
    """Fits mode shapes to marker displacements.

    Parameters
    ----------
    mode_shapes : array_like, shape (n_markers, n_modes) -- phi_i at the markers' heights
    coordinate_sd : array_like, shape (n_modes,) -- prior standard deviations of q, in units of the mode shapes
    """

    def __init__(self, mode_shapes: npt.ArrayLike, coordinate_sd: npt.ArrayLike) -> None:
        self._shapes = np.atleast_2d(np.asarray(mode_shapes, dtype=np.float64))
        prior = np.atleast_1d(np.asarray(coordinate_sd, dtype=np.float64))
        if not np.all(np.isfinite(self._shapes)):
            raise VisionParameterError("mode_shapes are not all finite; expected phi_i(z) at every marker")
        if prior.shape != (self._shapes.shape[1],) or not np.all(np.isfinite(prior) & (prior > 0)):
            raise VisionParameterError(
                f"coordinate_sd is {prior.tolist()}; expected {self._shapes.shape[1]} positive numbers, "
                "one per mode"
            )
        self._coordinate_sd = prior

    def fit(self, x_m: npt.ArrayLike, sigma_m: npt.ArrayLike) -> BeamShape:
        """Fit one frame.

        Parameters
        ----------
        x_m, sigma_m : array_like, shape (n_markers,) -- displacements and standard deviations; NaN where not
            seen [m]

        Returns
        -------
        BeamShape
        """
        x, sigma = np.asarray(x_m, dtype=np.float64), np.asarray(sigma_m, dtype=np.float64)
        n_markers, n_modes = self._shapes.shape
        if x.shape != (n_markers,) or sigma.shape != (n_markers,):
            raise VisionParameterError(
                f"displacements have shape {x.shape} and {sigma.shape}; expected ({n_markers},), one per "
                "marker"
            )
        seen = np.isfinite(x) & np.isfinite(sigma) & (sigma > 0)
        # Deviations from the prior in units of its standard deviations: well scaled rows of a least squares.
        scale = np.concatenate([[_UNKNOWN_HUB_SD_M], self._coordinate_sd])
        design = np.hstack([np.ones((n_markers, 1)), self._shapes])[seen] * scale / sigma[seen, None]
        target = x[seen] / sigma[seen]
        rows = np.vstack([design, np.eye(1 + n_modes)])
        values = np.concatenate([target, np.zeros(1 + n_modes)])
        orthogonal, triangular = np.linalg.qr(rows)
        estimate = np.linalg.solve(triangular, orthogonal.T @ values) * scale
        inverse = np.linalg.inv(triangular) * scale[:, None]
        return BeamShape(float(estimate[0]), np.asarray(estimate[1:]), np.asarray(inverse @ inverse.T))


@dataclass(frozen=True)
class BeamLine:
    """The beam in one frame.

    Attributes
    ----------
    heights_m : ndarray, shape (n_points,) -- above the clamp [m]; empty where the markers do not determine it
    x_m, sigma_m : ndarray, shape (n_points,) -- absolute displacement and its standard deviation [m]
    is_complete : bool -- every marker was seen
    """

    heights_m: FloatArray
    x_m: FloatArray
    sigma_m: FloatArray
    is_complete: bool


def marker_shape_fitter(rig: Rig, heights: npt.ArrayLike) -> BeamShapeFitter:
    """Return the fitter of a rig's mode shapes to displacements at some heights.

    Parameters
    ----------
    rig : Rig
    heights : array_like, shape (n_markers,) -- above the clamp [m]
    """
    model = rig.beam_model()
    frequencies = model.natural_frequencies
    tip = np.abs(model.shape([rig.beam.length])[0])
    return BeamShapeFitter(
        model.shape(heights), rig.hub.max_tip_deflection / tip * frequencies[0] / frequencies
    )


class BeamLineFitter:
    """Fits the line to the markers of one rig.

    Parameters
    ----------
    rig : Rig
    """

    def __init__(self, rig: Rig) -> None:
        length, allowed = rig.beam.length, rig.hub.max_tip_deflection
        self._fitter = marker_shape_fitter(rig, rig.markers.heights)
        self._heights = np.linspace(0.0, length, _POINTS)
        self._shapes = rig.beam_model().shape(self._heights)
        self._known_m = _KNOWN_SHARE * allowed

    def fit(self, x_m: FloatArray, sigma_m: FloatArray) -> BeamLine:
        """Fit the line to one frame.

        Parameters
        ----------
        x_m, sigma_m : ndarray, shape (n_markers,) -- displacements and standard deviations; NaN where not seen [m]
        """
        shape = self._fitter.fit(x_m, sigma_m)
        x, sigma = shape.displacement(self._shapes)
        unknown = np.flatnonzero(sigma > self._known_m)
        end = int(unknown[0]) if unknown.size else _POINTS
        return BeamLine(self._heights[:end], x[:end], sigma[:end], bool(np.isfinite(x_m).all()))
