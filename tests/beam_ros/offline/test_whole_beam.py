"""A strip seen by a pitched camera: heights and displacements in metres, by the markers' known heights."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from beam_ros.offline.whole_beam import follow_strip
from beam_ros.rig.rig import Rig
from beam_ros.vision.calibration.linear import LinearCalibration
from beam_ros.vision.calibration.perspective import Perspective
from beam_ros.vision.camera.video import VideoFile
from beam_ros.vision.errors import CalibrationError
from beam_ros.vision.strip.following import StripParameters
from tests.beam_ros.vision.strip.filmed_strip import camera_of, film

RIG = Rig.from_file()
CAMERA = camera_of(150.0, 2.0, 1.0)
RECESSION = 0.25
"""A camera at 0.6 m, pitched by 8.6 degrees: 1 / w falls by 7 % from the clamp to the tip."""
Z_SCALE = 0.985 * CAMERA.pixels_per_metre
AXIS = (90.0, 240.0)


def seen(x: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where a pinhole camera with the optical axis at AXIS sees places in the beam's plane [px]."""
    w = 1.0 + RECESSION * z
    u = AXIS[0] + (CAMERA.origin_px[0] - AXIS[0] + CAMERA.pixels_per_metre * x) / w
    return u, AXIS[1] + (CAMERA.origin_px[1] - AXIS[1] - Z_SCALE * z) / w


def calibration() -> LinearCalibration:
    heights = np.array(RIG.markers.heights)
    (zero, rows), (one, _) = seen(0.0 * heights, heights), seen(0.0 * heights + 1.0, heights)
    nominal = LinearCalibration.from_camera(CAMERA, len(heights))
    return replace(
        nominal,
        pixels_per_metre=tuple((one - zero).tolist()),
        zero_px=tuple(zero.tolist()),
        provenance={"heights_m": heights.tolist(), "rows_px": rows.tolist()},
    )


def test_two_markers_tell_heights_and_scales_all_along_the_beam():
    whole = calibration()
    pair = replace(
        whole,
        pixels_per_metre=whole.pixels_per_metre[::2],
        zero_px=whole.zero_px[::2],
        covariance=whole.covariance[::2],
        provenance={name: values[::2] for name, values in whole.provenance.items()},
    )
    z = np.linspace(0.0, 0.3, 7)
    (left, rows), (right, _) = seen(0.0 * z, z), seen(0.0 * z + 1.0, z)
    for known in (whole, pair):
        found = Perspective.of(known, [3e-4] * known.n_markers)
        assert found is not None
        assert found.heights(rows) == pytest.approx(z, abs=1e-6)
        assert found.rows(z) == pytest.approx(rows, abs=1e-3)
        assert found.scales(z) == pytest.approx(right - left, rel=1e-5)
    assert Perspective.of(replace(whole, provenance={}), [3e-4] * 3) is None
    with pytest.raises(CalibrationError, match=r"provenance.rows_px .* expected 3 numbers"):
        Perspective.of(replace(whole, provenance={**whole.provenance, "rows_px": [1.0]}), [3e-4] * 3)


@pytest.mark.slow
def test_a_film_from_below_gives_heights_and_displacements_as_one_from_the_front(tmp_path: Path):
    heights = np.linspace(0.0, RIG.beam.length, 61)
    strip = film(40, CAMERA.rows(heights), StripParameters(15.0, 465.0, 80.3, 1.0), CAMERA)
    x = (strip.truth - CAMERA.origin_px[0]) / CAMERA.pixels_per_metre
    corners = np.array([[-0.04, 0.0], [0.04, 0.0], [0.04, 0.3], [-0.04, 0.3]])
    front = np.stack([CAMERA.columns(corners[:, 0]), CAMERA.rows(corners[:, 1])], axis=1)
    below = np.stack(seen(corners[:, 0], corners[:, 1]), axis=1)
    turn = cv2.getPerspectiveTransform(front.astype(np.float32), below.astype(np.float32))
    path, rng = tmp_path / "film.avi", np.random.default_rng(8)
    size = CAMERA.width, CAMERA.height
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"FFV1"), CAMERA.rate_hz, size, False)
    for light in strip.light:
        picture = cv2.warpPerspective(
            light, turn, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
        )
        noisy = picture + CAMERA.noise_grey * rng.standard_normal(picture.shape)
        writer.write(np.clip(np.rint(noisy), 0, 255).astype(np.uint8))
    writer.release()
    known = calibration()
    points = follow_strip(VideoFile(path), CAMERA, RIG.beam.length, RIG.markers, known)
    assert len(points.heights) > 38
    rows = points.v_px[0]
    assert seen(0.0 * points.heights, points.heights)[1] == pytest.approx(rows, abs=0.01)
    truth = np.array([np.interp(points.heights, heights, frame) for frame in x])
    error = (points.x_m - truth)[10:]
    # Cubic interpolation of the picture leaves some hundredths of a pixel beside the noise.
    assert np.sqrt(np.nanmean(error**2)) < 0.06 / CAMERA.pixels_per_metre
    level = follow_strip(VideoFile(path), CAMERA, RIG.beam.length, RIG.markers, replace(known, provenance={}))
    assert np.abs(seen(0.0 * level.heights, level.heights)[1] - level.v_px[0]).max() > 5.0
