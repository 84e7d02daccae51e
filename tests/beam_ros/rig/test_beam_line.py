"""The line that shows the beam: through the markers, along the modes, and no further than is known."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ros.messages import BagTypes, beam_shape
from beam_ros.rig.beam_line import BeamLineFitter, BeamShapeFitter
from beam_ros.rig.rig import Rig
from beam_ros.vision.errors import VisionParameterError

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
    line = BeamLineFitter(RIG).fit(x, SIGMA)
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
    without_top = fitter.fit(np.array([x[0], x[1], np.nan]), SIGMA)
    assert not without_top.is_complete
    # Without the top marker nothing tells of the second mode, whose node is near the middle one.
    assert 0.05 < without_top.heights_m[-1] < 0.2
    nothing = fitter.fit(np.full(3, np.nan), np.full(3, np.nan))
    without_low = fitter.fit(np.array([np.nan, x[1], x[2]]), SIGMA)
    assert len(nothing.x_m) == len(without_low.x_m) == 0


def test_the_marker_is_a_line_strip_in_the_rigs_frame_or_taken_away() -> None:
    types = BagTypes()
    x, _ = _bent([0.010])
    fitter = BeamLineFitter(RIG)
    name = "visualization_msgs/msg/Marker"
    line = fitter.fit(x, SIGMA)
    built = beam_shape(types, 5, line.heights_m, line.x_m, is_complete=True)
    message = types.deserialize(types.serialize(built, name), name)
    assert (message.type, message.action, message.header.frame_id) == (4, 0, "rig")
    assert len(message.points) == 41
    assert message.points[0].x == pytest.approx(0.004, abs=1e-4)
    assert message.points[-1].z == pytest.approx(0.3)
    nothing = fitter.fit(np.full(3, np.nan), np.full(3, np.nan))
    assert beam_shape(types, 5, nothing.heights_m, nothing.x_m, is_complete=False).action == 2


def modes(z):
    """Two shapes with a clamp at 0, tip 1 at 0.3 m."""
    s = np.atleast_1d(np.asarray(z)) / 0.3
    return np.stack([s**2 * (3 - s) / 2, s**2 * (5 * s - 4)], axis=1)


MARKERS = modes([0.010, 0.225, 0.285])
PLACES = np.linspace(0.0, 0.3, 13)
PRIOR = [0.02, 0.003]


def test_the_shape_is_recovered_and_its_uncertainty_true():
    rng = np.random.default_rng(1)
    fitter = BeamShapeFitter(MARKERS, PRIOR)
    scaled = []
    for _ in range(500):
        q, hub = rng.normal(0, PRIOR), rng.normal(0, 0.03)
        x = hub + MARKERS @ q + rng.normal(0, 1e-5, 3)
        u, sigma = fitter.fit(x, np.full(3, 1e-5)).displacement(modes(PLACES))
        scaled.append((u - hub - modes(PLACES) @ q) / sigma)
    # Standard deviations over 500 draws are known to 3.2 %.
    assert np.array(scaled).std(axis=0) == pytest.approx(np.ones(13), rel=0.13)


def test_with_nothing_seen_the_prior_is_all_there_is():
    shape = BeamShapeFitter(MARKERS, PRIOR).fit(np.full(3, np.nan), np.full(3, np.nan))
    u, sigma = shape.displacement(modes([0.0, 0.3]))
    assert u == pytest.approx([0.0, 0.0])
    assert sigma == pytest.approx([1.0, np.hypot(1.0, np.hypot(*PRIOR))])


def test_wrong_shapes_and_priors_are_refused():
    with pytest.raises(VisionParameterError, match="2 positive numbers"):
        BeamShapeFitter(MARKERS, [0.02, 0.0])
    with pytest.raises(VisionParameterError, match="finite"):
        BeamShapeFitter([[np.nan, 1.0]], PRIOR)
    with pytest.raises(VisionParameterError, match=r"expected \(3,\)"):
        BeamShapeFitter(MARKERS, PRIOR).fit([0.0], [1.0])
