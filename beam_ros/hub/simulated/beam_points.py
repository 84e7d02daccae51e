"""What a camera sees of the beam: displacements of points on it, from the axis's snapshots."""

from __future__ import annotations

from collections.abc import Sequence

from beam_model import BeamModel
from beam_ros.arrays import FloatArray
from beam_ros.hub.simulated.motion import Snapshots


class BeamPoints:
    """Points of the beam that are filmed.

    Parameters
    ----------
    model : BeamModel
        Beam and hub.
    heights : sequence of float
        Above the clamp [m].
    """

    def __init__(self, model: BeamModel, heights: Sequence[float]) -> None:
        self._shape = model.shape(heights)
        self._residual = model.residual_terms(heights)

    def displacements(self, snapshots: Snapshots) -> FloatArray:
        """Return u = alpha + w in the frame ``rig``, shape (n_times, n_heights) [m]."""
        displacements: FloatArray = (
            snapshots.positions[:, None]
            + snapshots.coordinates @ self._shape.T
            - snapshots.residual_accelerations[:, None] * self._residual
        )
        return displacements
