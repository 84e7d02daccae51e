from __future__ import annotations

import numpy as np
import pytest

from beam_ros.vision.errors import VisionParameterError
from beam_ros.vision.measurement.beam_shape import BeamShapeFitter


def modes(z):
    """Two shapes with a clamp at 0, tip 1 at 0.3 m."""
    s = np.atleast_1d(np.asarray(z)) / 0.3
    return np.stack([s**2 * (3 - s) / 2, s**2 * (5 * s - 4)], axis=1)


MARKERS = modes([0.010, 0.225, 0.285])
HEIGHTS = np.linspace(0.0, 0.3, 13)
PRIOR = [0.02, 0.003]


def test_the_shape_is_recovered_and_its_uncertainty_true():
    rng = np.random.default_rng(1)
    fitter = BeamShapeFitter(MARKERS, PRIOR)
    scaled = []
    for _ in range(500):
        q, hub = rng.normal(0, PRIOR), rng.normal(0, 0.03)
        x = hub + MARKERS @ q + rng.normal(0, 1e-5, 3)
        u, sigma = fitter.fit(x, np.full(3, 1e-5)).displacement(modes(HEIGHTS))
        scaled.append((u - hub - modes(HEIGHTS) @ q) / sigma)
    # Standard deviations over 500 draws are known to 3.2 %.
    assert np.array(scaled).std(axis=0) == pytest.approx(np.ones(13), rel=0.13)


def test_a_known_hub_makes_up_for_a_hidden_marker():
    fitter = BeamShapeFitter(MARKERS, PRIOR)
    q, hub = np.array([0.015, -0.001]), 0.02
    x = hub + MARKERS @ q
    x[2] = np.nan
    sigma = np.array([1e-6, 1e-6, np.nan])
    blind = fitter.fit(x, sigma)
    told = fitter.fit(x, sigma, hub_m=hub, hub_sd_m=1e-7)
    _, sd_blind = blind.displacement(modes(0.3))
    u_told, sd_told = told.displacement(modes(0.3))
    assert sd_told[0] < sd_blind[0]
    assert abs(u_told[0] - hub - (modes(0.3) @ q)[0]) < 3 * sd_told[0]


def test_with_nothing_seen_the_prior_is_all_there_is():
    shape = BeamShapeFitter(MARKERS, PRIOR).fit(np.full(3, np.nan), np.full(3, np.nan), hub_m=0.01)
    u, sigma = shape.displacement(modes([0.0, 0.3]))
    assert u == pytest.approx([0.01, 0.01])
    assert sigma == pytest.approx([0.0, np.hypot(*PRIOR)], abs=1e-8)


def test_wrong_shapes_and_priors_are_refused():
    with pytest.raises(VisionParameterError, match="2 positive numbers"):
        BeamShapeFitter(MARKERS, [0.02, 0.0])
    with pytest.raises(VisionParameterError, match="finite"):
        BeamShapeFitter([[np.nan, 1.0]], PRIOR)
    with pytest.raises(VisionParameterError, match=r"expected \(3,\)"):
        BeamShapeFitter(MARKERS, PRIOR).fit([0.0], [1.0])
