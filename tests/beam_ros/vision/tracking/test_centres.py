from __future__ import annotations

import numpy as np
import pytest

from beam_ros.vision.rendering.disturbances import Disturbances, Occluder
from beam_ros.vision.rendering.frames import SceneRenderer, _DiscTable
from beam_ros.vision.timing import exposure_weights
from beam_ros.vision.tracking.centres import (
    aperture_at,
    clipped_sums,
    clipped_sums_in_loops,
    compiled_clipped_sums,
    disc_steps,
    radial_symmetry_centre,
)
from beam_ros.vision.tracking.tracker import MarkerTracker
from tests.beam_ros.vision.packaged_rig import packaged_camera, packaged_tracker

DISC = _DiscTable(12.0, 0.8)
# Lens and pixel: hypot(0.8, sqrt(1 / 12)).
EDGE = 0.85


def canvas(u: np.ndarray, v: float, weights: np.ndarray) -> np.ndarray:
    coverage, top, left = DISC.average(u, np.full(u.size, v), weights)
    image = np.zeros((60, 80))
    image[top : top + coverage.shape[0], left : left + coverage.shape[1]] = 180.0 * coverage
    return image


def centre(image: np.ndarray, near_u: float, near_v: float, edge: float = EDGE, smear: float = 0.0):
    aperture, left, top, u, v = aperture_at(near_u, near_v, disc_steps(6.0, edge), smear)
    grey = image[top : top + aperture.height, left : left + aperture.width].ravel()
    mass, first_u, first_v = aperture.weights.astype(float) @ grey
    return u + first_u / (mass * aperture.gain_u), v + first_v / (mass * aperture.gain_v), mass


def test_the_pixel_grid_leaves_no_bias_at_any_phase():
    errors = []
    for phase in np.arange(32) / 32:
        u, v, _ = centre(canvas(np.array([40 + phase]), 30.3, np.ones(1)), 40 + phase, 30.3)
        errors.append((u - 40 - phase, v - 30.3))
    # Weights in single precision of 7 digits; the centre of a level-subtracted disc errs by up to 0.002 px.
    assert np.abs(np.array(errors)[:, 0]).max() < 5e-5
    # Along v the aperture stands up to 1/16 px off; its gain is known to 2 %.
    assert np.abs(np.array(errors)[:, 1]).max() < 1.3e-3


@pytest.mark.parametrize("edge", [0.75, 0.85, 1.0])
def test_the_centre_hardly_depends_on_where_it_is_looked_for(edge):
    image = canvas(np.array([40.37]), 30.0, np.ones(1))
    found = [centre(image, 40.37 + shift, 30.0, edge)[0] for shift in np.linspace(-0.03, 0.03, 13)]
    # A rim that is known to 15 % makes the gain wrong by 3 %, half a step of its table by 1 %, which acts on
    # 0.03 + 1/64 px.
    assert np.abs(np.array(found) - 40.37).max() < (6e-4 if edge == EDGE else 1.6e-3)


def test_a_smeared_marker_is_at_its_mean_position_however_it_moved():
    weights = exposure_weights(6)
    nodes = np.polynomial.legendre.leggauss(6)[0] / 2
    for turn in (0.0, 2.0, 4.0):
        # The velocity changes during the exposure: the mean is not the middle.
        positions = 40.2 + 6.0 * nodes + turn * nodes**2
        mean = float(weights @ positions)
        found = centre(canvas(positions, 30.0, weights), mean, 30.0, smear=6.0)[0]
        # What the aperture's ends cut off is 1 % of how far the mean is off the middle of the way; a level that is
        # subtracted with saturation costs 11 %.
        assert abs(found - mean) < 5e-5 + 0.012 * (mean - 40.2)


def test_the_stated_noise_is_that_of_the_centre():
    rng = np.random.default_rng(5)
    image = canvas(np.array([40.2]), 30.0, np.ones(1))
    aperture, *_ = aperture_at(40.2, 30.0, disc_steps(6.0, EDGE), 0.0)
    found = [centre(image + 2.0 * rng.standard_normal(image.shape), 40.2, 30.0) for _ in range(800)]
    u, _, mass = np.array(found).T
    # 800 values: 2.5 %.
    assert 2.0 * aperture.noise / mass.mean() == pytest.approx(u.std(), rel=0.08)
    assert u.std() < 0.0055


@pytest.mark.slow
def test_motion_below_a_pixel_about_a_pixel_centre_keeps_its_amplitude():
    camera = packaged_camera(noise_grey=0.5)
    heights = (0.010, 0.225, 0.285)
    renderer = SceneRenderer(camera, heights)
    tracker = MarkerTracker(packaged_tracker(camera, heights), 3)
    rng = np.random.default_rng(6)
    for amplitude_px in (0.1, 0.3):
        moved, seen = [], []
        for k in range(400):
            x = amplitude_px / 1500 * np.sin(0.7 * k + np.arange(3.0))
            result = tracker.process(renderer.render(x, rng), k)
            moved.append(camera.columns(x) - 320.0)
            seen.append([marker.u_px - 320.0 for marker in result.markers])
        moved, seen = np.array(moved[40:]), np.array(seen[40:])
        gain = np.sum(moved * seen) / np.sum(moved**2)
        # 0.0015 px over 1080 values: 0.0006 at an amplitude of 0.1 px.
        assert gain == pytest.approx(1.0, abs=0.00025 / amplitude_px)


def test_a_dark_object_beside_a_bright_marker_does_not_pull():
    camera = packaged_camera(noise_grey=1.0, background=60.0)
    renderer = SceneRenderer(camera, (0.1,))
    tracker = MarkerTracker(packaged_tracker(camera, (0.1,)), 1)
    rng = np.random.default_rng(7)
    u, v = float(camera.columns(0.0)), float(camera.rows(0.1))
    columns = {False: [], True: []}
    for k in range(120):
        wall = Occluder(u - 60, v - 30, u - 8.0, v + 30, 0.0)
        is_there = k >= 60
        frame = renderer.render(
            [0.0], rng, disturbances=Disturbances(occluders=(wall,)) if is_there else None
        )
        marker = tracker.process(frame, k).markers[0]
        if marker.is_valid and k % 60 >= 20:
            columns[is_there].append(marker.u_px)
    # Sixty grey levels of shade over the aperture's rim would pull by 0.04 px.
    assert len(columns[True]) > 20
    assert abs(np.mean(columns[True]) - np.mean(columns[False])) < 0.01


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("is_dark", [False, True])
@pytest.mark.parametrize("is_bounded", [True, False])
def test_loops_sum_clipped_grey_levels_as_products_do(dtype, is_dark, is_bounded):
    rng = np.random.default_rng(5)
    image = rng.integers(0, 256, (40, 50)).astype(dtype)
    image.flags.writeable = False
    weights = rng.standard_normal((13, 19 * 21)).astype(np.float32)
    beyond = np.where(rng.random(19 * 21) < 0.5, np.inf, 0.0).astype(np.float32)
    region = 7, 11, 7 + 21, 11 + 19
    # The same, pixel by pixel: within the rim only the side away from the disc is bounded.
    grey = image[11:30, 7:28].ravel().astype(float)
    low = 60.3 if is_bounded or not is_dark else -np.inf
    high = 150.7 if is_bounded or is_dark else np.inf
    within = np.isinf(beyond)
    if is_dark:
        grey = np.where(within, np.minimum(grey, high), np.clip(grey, low, high))
    else:
        grey = np.where(within, np.maximum(grey, low), np.clip(grey, low, high))
    for sums in (clipped_sums, clipped_sums_in_loops, compiled_clipped_sums()):
        if sums is not None:
            found = np.full(13, np.nan, np.float32)
            sums(image, *region, weights, beyond, low, high, is_dark, found)
            # Single precision: seven digits of some four hundred terms.
            assert (
                np.abs(found - weights.astype(float) @ grey).max()
                <= 1e-6 * 255 * np.abs(weights).sum(axis=1).max()
            )


ROUND_CAMERA = packaged_camera(noise_grey=2.0)
ROUND_RENDERER = SceneRenderer(ROUND_CAMERA, [0.1])


def rendered_spot(smear_px: float, seed: int):
    """A region of one rendered marker, and where its mean position lies in it."""
    camera, renderer = ROUND_CAMERA, ROUND_RENDERER
    rng = np.random.default_rng(seed)
    x = (np.linspace(-0.5, 0.5, 6)[:, None] * smear_px + rng.random()) / 1500
    frame = renderer.render(x, rng)
    u, v = float((renderer.exposure_weights @ camera.columns(x))[0]), float(camera.rows(0.1))
    column, row = round(u), round(v)
    return frame[row - 13 : row + 14, column - 13 : column + 14], u - column + 13, v - row + 13


@pytest.mark.parametrize("smear_px", [0.0, 6.0])
def test_radial_symmetry_finds_the_mean_position_within_its_standard_deviation(smear_px):
    errors, stated = [], []
    for seed in range(150):
        region, u, v = rendered_spot(smear_px, seed)
        centre = radial_symmetry_centre(region, u + 0.05, v - 0.05, 12.0, np.full(region.shape, 4.0 + 1 / 12))
        errors.append([centre[0] - u, centre[1] - v])
        stated.append(centre[2])
    errors = np.array(errors)
    # About 0.0075 px each with the longer smear; the mean of 150 is known to 0.0007 px, the RMS to 6 %.
    assert np.all(np.sqrt(np.mean(errors**2, axis=0)) < 0.009)
    assert np.all(np.abs(errors.mean(axis=0)) < 0.003)
    assert np.sqrt(np.mean((errors[:, 0] / stated) ** 2)) == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("region", [np.full((21, 21), 30, np.uint8), np.zeros((21, 21), np.uint8)])
def test_where_nothing_is_there_is_no_radial_symmetry(region):
    assert radial_symmetry_centre(region, 10.0, 10.0, 10.0, np.full(region.shape, 4.0)) is None


def test_an_edge_alone_has_no_radial_symmetry():
    region = np.zeros((21, 21), np.uint8)
    region[:, 11:] = 200
    assert radial_symmetry_centre(region, 10.0, 10.0, 10.0, np.full(region.shape, 4.0)) is None
