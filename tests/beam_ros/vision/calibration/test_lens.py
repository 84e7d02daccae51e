from __future__ import annotations

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from beam_ros.vision.calibration.lens import Lens
from beam_ros.vision.errors import CalibrationError
from beam_ros.vision.rendering.frames import SceneRenderer
from beam_ros.vision.tracking.tracker import MarkerTracker
from tests.beam_ros.vision.packaged_rig import packaged_camera, packaged_tracker

LENS = Lens((900.0, 905.0), (322.0, 238.0), (-0.21, 0.08, 0.0007, -0.0004, 0.01))


def camera_info(**changes):
    """The message of a camera with this lens, read out whole."""
    fields = {
        "width": 640,
        "height": 480,
        "distortion_model": "plumb_bob",
        "d": LENS.distortion,
        "k": [900.0, 0, 322.0, 0, 905.0, 238.0, 0, 0, 1],
        "binning_x": 0,
        "binning_y": 0,
        "roi": SimpleNamespace(x_offset=0, y_offset=0, width=0, height=0),
    }
    return SimpleNamespace(**{**fields, **changes})


def test_distortion_is_that_of_opencv():
    u, v = np.meshgrid(np.linspace(0, 639, 9), np.linspace(0, 479, 7))
    normalised = np.stack([(u - 322.0) / 900.0, (v - 238.0) / 905.0, np.ones_like(u)], axis=-1)
    matrix = np.array([[900.0, 0, 322.0], [0, 905.0, 238.0], [0, 0, 1]])
    expected, _ = cv2.projectPoints(
        normalised.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), matrix, np.array(LENS.distortion)
    )
    found = np.stack(LENS.distort(u, v), axis=-1).reshape(-1, 2)
    assert found == pytest.approx(expected.reshape(-1, 2), abs=1e-9)


def test_undistortion_inverts_it_and_leaves_the_unknown_unknown():
    u, v = np.meshgrid(np.linspace(0, 639, 9), np.linspace(0, 479, 7))
    back = LENS.undistort(*LENS.distort(u, v))
    assert back[0] == pytest.approx(u, abs=1e-6)
    assert back[1] == pytest.approx(v, abs=1e-6)
    assert np.isnan(LENS.undistort([np.nan], [10.0])[0][0])


def test_beyond_the_models_range_nothing_is_invented():
    fisheye = Lens((300.0, 300.0), (320.0, 240.0), (-0.35, 0.0, 0.0, 0.0, 0.0))
    # x (1 - 0.35 x^2) has its largest value, 0.65, at x = 0.976: nothing is imaged beyond column 515.
    assert np.isnan(fisheye.undistort([600.0], [240.0])[0][0])
    assert np.isfinite(fisheye.undistort([480.0], [240.0])[0][0])


def test_a_lens_comes_from_camera_info():
    assert Lens.from_camera_info(camera_info(), (640, 480)) == LENS
    assert Lens.from_camera_info(camera_info(d=[0.0] * 5), (640, 480)) is None
    assert Lens.from_camera_info(camera_info(distortion_model="", d=[], k=[0.0] * 9), (640, 480)) is None
    with pytest.raises(CalibrationError, match="'equidistant' with 4"):
        Lens.from_camera_info(camera_info(distortion_model="equidistant", d=[0.1] * 4), (640, 480))
    with pytest.raises(CalibrationError, match="3 numbers"):
        Lens.from_camera_info(camera_info(d=[0.1], k=[1.0, 2.0, 3.0]), (640, 480))


def test_the_lens_of_a_part_of_the_sensor_holds_for_that_part():
    roi = SimpleNamespace(x_offset=100, y_offset=60, width=400, height=300)
    info = camera_info(roi=roi, binning_x=2, binning_y=3)
    assert Lens.from_camera_info(info, (200, 100)) == LENS.seen_through((100, 60), (2, 3))
    for size in ((400, 300), (640, 480)):
        with pytest.raises(CalibrationError, match=r"for images of 200 x 100; expected .*calibrate the lens"):
            Lens.from_camera_info(info, size)


def test_a_camera_info_without_a_size_is_that_of_a_camera_that_is_not_calibrated():
    silent = camera_info(width=0, height=0, d=[], k=[0.0] * 9)
    assert Lens.from_camera_info(silent, (640, 480)) is None
    with pytest.raises(CalibrationError, match="for images of 0 x 0"):
        Lens.from_camera_info(camera_info(width=0, height=0), (640, 480))


def test_markers_seen_through_a_lens_are_where_they_were_once_undistorted():
    camera = packaged_camera()
    heights = (0.010, 0.225, 0.285)
    renderer = SceneRenderer(camera, heights, lens=LENS)
    tracker = MarkerTracker(packaged_tracker(camera, heights), 3)
    rng = np.random.default_rng(1)
    errors = []
    for x in np.linspace(-0.1, 0.1, 41):
        result = tracker.process(renderer.render([x, x, x], rng), 0)
        assert result.is_complete, result
        seen = np.array([[marker.u_px, marker.v_px] for marker in result.markers])
        assert np.abs(seen[:, 0] - camera.columns(x)).max() > (1.5 if abs(x) > 0.08 else 0.0)
        errors.append(LENS.undistort(seen[:, 0], seen[:, 1])[0] - camera.columns(x))
    # 0.0055 px of noise
    assert np.sqrt(np.mean(np.square(errors))) < 0.008
