"""The line that shows the beam: through the markers, along the modes, and no further than is known."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ros.measurements.beam_line import BeamLineFitter, line_marker
from beam_ros.messages import BagTypes
from beam_ros.rig.rig import Rig
from beam_ros.vision.calibration.linear import Displacement

RIG = Rig.from_file()
HEIGHTS = RIG.markers.heights
SIGMA = np.full(3, 4e-6)


def _bent(coordinates, hub: float = 0.004):
    """Displacements of a beam with given tip deflections of its first modes: at the markers, and as a function."""
    model = RIG.beam_model()
    tip = model.shape([0.3])[0]
    q = np.zeros(len(tip))
    q[: len(coordinates)] = np.array(coordinates) / tip[: len(coordinates)]
    return hub + model.shape(HEIGHTS) @ q, lambda z: hub + model.shape(z) @ q


def test_the_line_runs_through_the_markers_and_follows_two_modes_to_their_tip() -> None:
    x, truth = _bent([0.010, 0.001])
    line = BeamLineFitter(RIG).fit(Displacement(x, SIGMA))
    assert line.is_complete
    assert line.heights_m[[0, -1]] == pytest.approx([0.0, 0.3])
    error = line.x_m - truth(line.heights_m)
    assert np.all(np.abs(error) < 4 * line.sigma_m)
    # The third mode, which three markers do not tell from the others, may bend the strip between them.
    assert np.max(line.sigma_m) < 0.003
    assert np.interp(HEIGHTS, line.heights_m, line.x_m) == pytest.approx(x, abs=5e-5)


def test_the_line_ends_where_the_markers_no_longer_tell() -> None:
    x, _ = _bent([0.010])
    fitter = BeamLineFitter(RIG)
    without_top = fitter.fit(Displacement(np.array([x[0], x[1], np.nan]), SIGMA))
    assert not without_top.is_complete
    # Without the top marker nothing tells of the second mode, whose node is near the middle one.
    assert 0.05 < without_top.heights_m[-1] < 0.2
    nothing = fitter.fit(Displacement(np.full(3, np.nan), np.full(3, np.nan)))
    without_low = fitter.fit(Displacement(np.array([np.nan, x[1], x[2]]), SIGMA))
    assert len(nothing.x_m) == len(without_low.x_m) == 0


def test_the_marker_is_a_line_strip_in_the_rigs_frame_or_taken_away() -> None:
    types = BagTypes()
    x, _ = _bent([0.010])
    fitter = BeamLineFitter(RIG)
    name = "visualization_msgs/msg/Marker"
    message = types.deserialize(
        types.serialize(line_marker(types, 5, fitter.fit(Displacement(x, SIGMA))), name), name
    )
    assert (message.type, message.action, message.header.frame_id) == (4, 0, "rig")
    assert len(message.points) == 41
    assert message.points[0].x == pytest.approx(0.004, abs=1e-4)
    assert message.points[-1].z == pytest.approx(0.3)
    nothing = fitter.fit(Displacement(np.full(3, np.nan), np.full(3, np.nan)))
    assert line_marker(types, 5, nothing).action == 2
