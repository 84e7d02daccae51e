from __future__ import annotations

import numpy as np
import pytest

from beam_ros.vision.rendering.frames import SceneRenderer
from beam_ros.vision.tracking.radial_symmetry import radial_symmetry_centre
from tests.beam_ros.vision.packaged_rig import packaged_camera

CAMERA = packaged_camera(noise_grey=2.0)
RENDERER = SceneRenderer(CAMERA, [0.1])


def spot(smear_px: float, seed: int):
    """A region of one rendered marker, and where its mean position lies in it."""
    camera, renderer = CAMERA, RENDERER
    rng = np.random.default_rng(seed)
    x = (np.linspace(-0.5, 0.5, 6)[:, None] * smear_px + rng.random()) / 1500
    frame = renderer.render(x, rng)
    u, v = float((renderer.exposure_weights @ camera.columns(x))[0]), float(camera.rows(0.1))
    column, row = round(u), round(v)
    return frame[row - 13 : row + 14, column - 13 : column + 14], u - column + 13, v - row + 13


@pytest.mark.parametrize("smear_px", [0.0, 6.0])
def test_the_mean_position_is_found_within_the_stated_standard_deviation(smear_px):
    errors, stated = [], []
    for seed in range(150):
        region, u, v = spot(smear_px, seed)
        centre = radial_symmetry_centre(region, u + 0.05, v - 0.05, 12.0, np.full(region.shape, 4.0 + 1 / 12))
        errors.append([centre[0] - u, centre[1] - v])
        stated.append(centre[2])
    errors = np.array(errors)
    # About 0.0075 px each with the longer smear; the mean of 150 is known to 0.0007 px, the RMS to 6 %.
    assert np.all(np.sqrt(np.mean(errors**2, axis=0)) < 0.009)
    assert np.all(np.abs(errors.mean(axis=0)) < 0.003)
    assert np.sqrt(np.mean((errors[:, 0] / stated) ** 2)) == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("region", [np.full((21, 21), 30, np.uint8), np.zeros((21, 21), np.uint8)])
def test_where_nothing_is_nothing_is_found(region):
    assert radial_symmetry_centre(region, 10.0, 10.0, 10.0, np.full(region.shape, 4.0)) is None


def test_an_edge_alone_has_no_centre():
    region = np.zeros((21, 21), np.uint8)
    region[:, 11:] = 200
    assert radial_symmetry_centre(region, 10.0, 10.0, 10.0, np.full(region.shape, 4.0)) is None
