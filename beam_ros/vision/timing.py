"""Which instants an image shows: from its stamp to the exposure of each of its rows.

The first row's exposure begins at t0. Row v is exposed from t0 + d(v) to t0 + d(v) + T, with T the exposure
and d(v) = readout v / (height - 1). What a stamp means is a parameter of the camera:

    start     t0                                 the first row opens
    mid       t0 + (readout + T) / 2             the middle of the middle row's exposure
    end       t0 + readout + T                   the last row closes
    arrival   t0 + readout + T                   the same, when the host stamps on receipt

each of them ``latency_s`` earlier than the stamp. What is measured in a row is the mean over that row's
exposure; its time is the middle of that exposure.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
import numpy.typing as npt

from beam_ros.arrays import FloatArray, StampArray
from beam_ros.vision.parameters import CameraParameters

_NS = 1_000_000_000


@lru_cache(maxsize=8)
def _quadrature(count: int) -> tuple[FloatArray, FloatArray]:
    """Gauss-Legendre nodes in [-1/2, 1/2] and their weights, which sum to 1."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return nodes / 2.0, weights / 2.0


@dataclass(frozen=True)
class FrameTiming:
    """From the stamp of a frame to the exposure of its rows, and back.

    Attributes
    ----------
    camera : CameraParameters -- exposure, readout, meaning of the stamp, latency
    """

    camera: CameraParameters

    @cached_property
    def _stamp_after_start_ns(self) -> int:
        camera = self.camera
        share = {"start": 0.0, "mid": 0.5, "end": 1.0, "arrival": 1.0}[camera.stamp]
        return round(((camera.readout_s + camera.exposure_s) * share + camera.latency_s) * _NS)

    def stamp(self, start_ns: int) -> int:
        """Stamp of the frame whose first row's exposure begins at ``start_ns`` [ns]."""
        return int(start_ns) + self._stamp_after_start_ns

    def start(self, stamp_ns: int) -> int:
        """Beginning of the first row's exposure of the frame with this stamp [ns]."""
        return int(stamp_ns) - self._stamp_after_start_ns

    def end(self, stamp_ns: int) -> int:
        """Instant at which the last row's exposure ends: the earliest that the image can exist [ns]."""
        camera = self.camera
        return self.start(stamp_ns) + round((camera.readout_s + camera.exposure_s) * _NS)

    def row_middle(self, stamp_ns: int, row_px: float) -> int:
        """Middle of a row's exposure.

        Parameters
        ----------
        stamp_ns : int -- stamp of the frame [ns]
        row_px : float -- row, sub-pixel [px]

        Returns
        -------
        int -- time [ns]
        """
        camera = self.camera
        delay = camera.readout_s * row_px / (camera.height - 1) + camera.exposure_s / 2
        return int(stamp_ns) - self._stamp_after_start_ns + round(delay * _NS)

    def exposure_instants(self, stamp_ns: int, marker_heights: npt.ArrayLike, count: int = 6) -> StampArray:
        """Instants at which positions are needed to render a frame.

        The instants are the Gauss-Legendre nodes of each marker's exposure: the weighted mean over six of
        them (``exposure_weights``) is the mean over the exposure to 1e-9 at 80 Hz and 10 ms.

        Parameters
        ----------
        stamp_ns : int -- stamp of the frame [ns]
        marker_heights : array_like, shape (n_markers,) -- heights at rest [m]
        count : int -- instants per exposure

        Returns
        -------
        ndarray of int64, shape (count, n_markers) -- times [ns]; the columns are equal without readout
        """
        middles = np.array(
            [
                self.row_middle(stamp_ns, float(row))
                for row in np.atleast_1d(self.camera.rows(marker_heights))
            ],
            dtype=np.int64,
        )
        nodes, _ = _quadrature(count)
        offsets = np.rint(nodes * (self.camera.exposure_s * _NS)).astype(np.int64)
        return np.asarray(middles[np.newaxis, :] + offsets[:, np.newaxis])


def exposure_weights(count: int = 6) -> FloatArray:
    """Weights of ``FrameTiming.exposure_instants`` for the mean over the exposure, shape (count,), sum 1."""
    return np.array(_quadrature(count)[1])
