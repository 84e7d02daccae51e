from __future__ import annotations

import numpy as np
import pytest

from beam_ros.vision.errors import VisionParameterError
from beam_ros.vision.rendering.frames import SceneRenderer
from tests.beam_ros.vision.packaged_rig import packaged_camera

QUIET = packaged_camera(noise_grey=0.0, strip_contrast=0.0)


def centre_of_gravity(frame: np.ndarray, background: float) -> tuple[float, float, float]:
    grey = frame.astype(float) - background
    rows, columns = np.mgrid[: frame.shape[0], : frame.shape[1]]
    total = grey.sum()
    return (grey * columns).sum() / total, (grey * rows).sum() / total, total


@pytest.mark.parametrize("smear_px", [0.0, 0.7, 6.0])
def test_the_centre_of_gravity_is_the_mean_position_over_the_exposure(smear_px):
    rng = np.random.default_rng(3)
    renderer = SceneRenderer(QUIET, [0.1])
    for _ in range(20):
        x = 0.01 + (rng.random() + smear_px * np.sort(rng.random((6, 1)), axis=0)) / 1500
        z = 0.1 + rng.random() / 1500
        frame = renderer.render(x, rng, marker_z=np.full((6, 1), z))
        u, v, _ = centre_of_gravity(frame, QUIET.background)
        mean = float(renderer.exposure_weights @ QUIET.columns(x)[:, 0])
        # Rounding to whole grey levels along the rim (sd 0.29 grey, some 80 px, up to 9 px from the
        # centre) gives an sd of 0.6e-3 to 1e-3 px.
        assert u == pytest.approx(mean, abs=4e-3)
        assert v == pytest.approx(float(QUIET.rows(z)), abs=4e-3)


def test_a_marker_holds_the_light_of_its_disc():
    frame = SceneRenderer(QUIET, [0.1]).render([0.0], np.random.default_rng(0))
    _, _, total = centre_of_gravity(frame, QUIET.background)
    assert total == pytest.approx(QUIET.contrast * np.pi * 36.0, rel=2e-3)


def test_dark_markers_on_a_bright_background():
    camera = packaged_camera(noise_grey=0.0, strip_contrast=0.0, background=220.0, contrast=-180.0)
    frame = SceneRenderer(camera, [0.1]).render([0.0123], np.random.default_rng(0))
    u, v, _ = centre_of_gravity(frame, camera.background)
    assert frame.min() == 40
    assert (u, v) == pytest.approx((float(camera.columns(0.0123)), float(camera.rows(0.1))), abs=4e-3)


@pytest.mark.slow
def test_shot_noise_is_that_of_counted_electrons():
    # A grey level of g is N = g/255 full_well electrons, which vary by sqrt(N): sd 255 sqrt(g/255 / full_well).
    camera = packaged_camera(noise_grey=1.5, background=40.0)
    renderer = SceneRenderer(camera, [0.1], full_well=8000.0)
    rng = np.random.default_rng(7)
    frames = np.stack([renderer.render([0.0], rng) for _ in range(400)]).astype(float)
    row, column = round(float(camera.rows(0.1))), round(float(camera.columns(0.0)))
    places = {220.0: (slice(row - 2, row + 3), slice(column - 2, column + 3)), 40.0: np.s_[:40, :40]}
    for grey, place in places.items():
        # Own noise, shot noise, and rounding to whole grey levels.
        expected = np.sqrt(1.5**2 + 255.0 * grey / 8000.0 + 1 / 12)
        assert frames[(slice(None), *place)].std(axis=0).mean() == pytest.approx(expected, rel=0.03)
        assert frames[(slice(None), *place)].mean() == pytest.approx(grey, abs=0.15)


def test_noise_is_white_of_the_stated_size_at_the_marker_and_elsewhere():
    camera = packaged_camera(noise_grey=4.0)
    renderer = SceneRenderer(camera, [0.1])
    rng = np.random.default_rng(7)
    frames = np.stack([renderer.render([0.0], rng) for _ in range(100)]).astype(float)
    row, column = round(float(camera.rows(0.1))), round(float(camera.columns(0.0)))
    marker = frames[:, row - 3 : row + 4, column - 3 : column + 4]
    deviation = marker - marker.mean(axis=0)
    expected = np.sqrt(16 + 1 / 12)
    # 100 frames of 49 px: the sd is known to 1 %, the mean of each pixel takes 0.5 % of it, a correlation to 1.5 %.
    assert deviation.std(ddof=1) == pytest.approx(expected, rel=0.03)
    neighbours = (deviation[:, :, 1:] * deviation[:, :, :-1]).mean() / deviation.var()
    successive = (deviation[1:] * deviation[:-1]).mean() / deviation.var()
    assert abs(neighbours) < 0.05
    assert abs(successive) < 0.05
    assert frames[0, :100, :100].std() == pytest.approx(expected, rel=0.02)
    assert not np.array_equal(frames[0, :100, :100], frames[1, :100, :100])


def test_the_same_seed_gives_the_same_frame():
    camera = packaged_camera()
    first = SceneRenderer(camera, [0.1], seed=4).render([0.01], np.random.default_rng(9))
    second = SceneRenderer(camera, [0.1], seed=4).render([0.01], np.random.default_rng(9))
    assert np.array_equal(first, second)


def test_nothing_of_a_frame_is_left_in_the_next():
    heights = np.linspace(0.0, 0.3, 31)
    camera = packaged_camera(noise_grey=0.0)
    renderer = SceneRenderer(camera, [0.1, 0.2], strip_heights=heights)
    rng = np.random.default_rng(0)
    renderer.render([0.01, 0.02], rng, strip=heights * 0.1)
    later = renderer.render([-0.01, -0.02], rng, strip=-heights * 0.1)
    fresh = SceneRenderer(camera, [0.1, 0.2], strip_heights=heights).render(
        [-0.01, -0.02], rng, strip=-heights * 0.1
    )
    assert np.array_equal(later, fresh)


def test_the_strip_is_thin_dim_and_where_the_beam_is():
    heights = np.linspace(0.0, 0.3, 31)
    camera = packaged_camera(noise_grey=0.0)
    renderer = SceneRenderer(camera, [0.285], strip_heights=heights)
    frame = renderer.render([0.02], np.random.default_rng(0), strip=0.1 * heights).astype(float)
    frame -= camera.background
    row = round(float(camera.rows(0.15)))
    line = frame[row]
    # 0.75 px of strip at 12 grey levels, rounded to whole levels over some six pixels.
    assert line.sum() == pytest.approx(0.75 * 12, abs=2.0)
    height = (camera.origin_px[1] - row) / camera.pixels_per_metre
    assert (line @ np.arange(640)) / line.sum() == pytest.approx(
        float(camera.columns(0.1 * height)), abs=0.15
    )


def test_a_marker_at_the_edge_is_cut_and_one_outside_or_unknown_left_out():
    camera = packaged_camera(noise_grey=0.0)
    renderer = SceneRenderer(camera, [0.1, 0.2])
    rng = np.random.default_rng(0)
    edge = -320.0 / 1500
    assert renderer.render([edge, 0.0], rng)[315, 0] > 150
    assert renderer.render([1.0, np.nan], rng).max() == camera.background


def test_wrong_shapes_are_refused():
    renderer = SceneRenderer(QUIET, [0.1, 0.2])
    with pytest.raises(VisionParameterError, match=r"marker_x has shape \(1, 3\); expected \(6, 2\)"):
        renderer.render([0.0, 0.0, 0.0], np.random.default_rng(0))
    with pytest.raises(VisionParameterError, match="rising"):
        SceneRenderer(QUIET, [0.2, 0.1])
