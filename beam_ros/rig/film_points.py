"""Points of a film of the strip in the place of the rig's markers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from beam_ros.rig.rig import Rig


def rig_with_points(rig: Rig, points: Mapping[str, Any]) -> Rig:
    """Return the rig whose markers are the points of a film, as ``tracker/video`` names them.

    Parameters
    ----------
    rig : Rig
    points : mapping -- ``names`` and ``heights_m`` of the points

    Notes
    -----
    The mass of every real marker stays where it is: at the nearest point.
    """
    names, heights = list(points["names"]), [float(height) for height in points["heights_m"]]
    masses = np.zeros(len(heights))
    for height, mass in zip(rig.markers.heights, rig.markers.masses, strict=True):
        masses[int(np.argmin(np.abs(np.array(heights) - height)))] += mass
    return rig.with_values(
        {
            "markers.names": names,
            "markers.heights": heights,
            "markers.height_uncertainties": [float(np.median(rig.markers.height_uncertainties))]
            * len(heights),
            "markers.masses": masses.tolist(),
        }
    )
