from __future__ import annotations

import numpy as np
import pytest

from beam_ros.vision.rendering.frames import SceneRenderer
from beam_ros.vision.tracking.refinement import fit_disc, radial_symmetry_centre
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
def test_both_find_the_mean_position(smear_px):
    errors = []
    for seed in range(60):
        region, u, v = spot(smear_px, seed)
        centre = radial_symmetry_centre(region, u + 0.05, v - 0.05, 12.0, 2.0)
        disc = fit_disc(
            region,
            u + 0.05,
            v - 0.05,
            radius=6.2,
            edge=1.0,
            background=32.0,
            contrast=170.0,
            noise=2.0,
            smear=smear_px,
        )
        errors.append([centre[0] - u, centre[1] - v, disc.u - u, disc.v - v])
    errors = np.array(errors)
    # About 0.0075 px each with the longer smear; the mean of 60 is known to 0.001 px.
    assert np.all(np.sqrt(np.mean(errors**2, axis=0)) < 0.009)
    assert np.all(np.abs(errors.mean(axis=0)) < 0.004)


def test_the_disc_finds_radius_and_edge():
    region, u, v = spot(0.0, 1)
    disc = fit_disc(region, u, v, radius=5.5, edge=0.6, background=30.0, contrast=180.0, noise=2.0, smear=0.0)
    # The blurred rim of a disc falls to one half sigma^2 / (2 R) = 0.06 px inside it.
    assert disc.radius == pytest.approx(5.94, abs=0.03)
    # Lens blur 0.8 px and a pixel's aperture
    assert disc.edge == pytest.approx(np.sqrt(0.64 + 1 / 12), abs=0.05)
    assert disc.sigma_u == pytest.approx(0.0045, rel=0.1)


@pytest.mark.parametrize("region", [np.full((21, 21), 30, np.uint8), np.zeros((21, 21), np.uint8)])
def test_where_nothing_is_nothing_is_found(region):
    assert radial_symmetry_centre(region, 10.0, 10.0, 10.0, 2.0) is None
    assert (
        fit_disc(
            region, 10.0, 10.0, radius=6.0, edge=0.8, background=30.0, contrast=180.0, noise=2.0, smear=0.0
        )
        is None
    )


def test_an_edge_alone_has_no_centre():
    region = np.zeros((21, 21), np.uint8)
    region[:, 11:] = 200
    assert radial_symmetry_centre(region, 10.0, 10.0, 10.0, 2.0) is None
