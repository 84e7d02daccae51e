"""From frames to metres: nothing measured twice, nothing made up, and calibrations of other cameras refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beam_ros.vision.calibration.lens import Lens
from beam_ros.vision.calibration.linear import LinearCalibration
from beam_ros.vision.errors import ImageFormatError

pytest.importorskip("cv2")
from beam_ros.vision.calibration.lens import lens_to_dict
from beam_ros.vision.measurement.measuring_chain import MeasuringChain
from beam_ros.vision.parameters import CameraParameters
from beam_ros.vision.rendering.disturbances import Disturbances, Occluder
from beam_ros.vision.rendering.frames import SceneRenderer
from tests.beam_ros.vision.packaged_rig import packaged_camera, packaged_tracker

CAMERA = packaged_camera()
HEIGHTS = (0.010, 0.225, 0.285)
PERIOD_NS = 10_000_000
LENS = Lens((900.0, 905.0), (322.0, 238.0), (-0.21, 0.08, 0.0007, -0.0004, 0.01))


def _chain(calibration: LinearCalibration | None = None, camera: CameraParameters = CAMERA) -> MeasuringChain:
    given = calibration or LinearCalibration.from_camera(CAMERA, 3)
    return MeasuringChain(camera, packaged_tracker(CAMERA, HEIGHTS), HEIGHTS, given)


def _frame(x: float, lens: Lens | None = None):
    return SceneRenderer(CAMERA, HEIGHTS, lens=lens).render(np.full(3, x), np.random.default_rng(0))


def test_a_frame_becomes_metres_with_a_standard_deviation() -> None:
    measured = _chain().measure(PERIOD_NS, _frame(2e-3))
    assert measured.displacement.x_m == pytest.approx([2e-3] * 3, abs=2e-5)
    assert np.all((measured.displacement.sigma_m > 1e-6) & (measured.displacement.sigma_m < 1e-5))
    assert measured.reasons == ("ok",) * 3


def test_a_frame_of_another_size_is_refused_and_an_unread_one_says_nothing() -> None:
    chain = _chain()
    with pytest.raises(ImageFormatError, match=r"100 x 50; expected 640 x 480.*camera.width"):
        chain.measure(PERIOD_NS, np.zeros((50, 100), np.uint8))
    nothing = chain.unread(PERIOD_NS)
    assert np.all(np.isnan(nothing.displacement.x_m))
    assert nothing.stamps_ns == (PERIOD_NS,) * 3  # mid-exposure stamps, global shutter


def test_repeated_and_past_frames_are_left_out_until_the_clock_was_plainly_set_back() -> None:
    chain = _chain()
    assert [chain.admit(k * PERIOD_NS) for k in (1000, 1001, 1001, 1000, 1002)] == [
        True,
        True,
        False,
        False,
        True,
    ]
    admitted = [chain.admit(k * PERIOD_NS) for k in range(1, 41)]
    assert admitted == [False] * 19 + [True] * 21
    assert (chain.clock_steps, chain.continuity.repeated) == (1, 1)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"image_size": (1280, 960)}, "1280 x 960"),
        ({"camera_name": "other, f = 16 mm"}, "other, f = 16 mm"),
        (
            {"pixels_per_metre": (1500.0,), "zero_px": (320.0,), "covariance": (((0.0, 0.0), (0.0, 0.0)),)},
            "1 markers",
        ),
    ],
)
def test_a_calibration_of_another_camera_leaves_pixels_and_takes_the_metres(change, words) -> None:
    camera = replace(CAMERA, name="lab, f = 25 mm")
    chain = _chain(replace(LinearCalibration.from_camera(camera, 3), **change), camera)
    assert words in chain.calibration_fault
    measured = chain.measure(PERIOD_NS, _frame(0.0))
    assert np.all(np.isfinite(measured.u_px))
    assert np.all(np.isnan(measured.displacement.x_m))
    chain.calibration = LinearCalibration.from_camera(CAMERA, 3)
    assert chain.calibration_fault == ""
    assert np.all(np.isfinite(chain.measure(2 * PERIOD_NS, _frame(0.0)).displacement.x_m))


def test_distortion_is_undone_before_metres_and_its_stretch_is_in_the_deviation() -> None:
    # Near the left edge of the image the barrel is strong: 13 px, and pixels are 10 % wider than they look.
    frame = _frame(-0.19, LENS)
    distorted = _chain().measure(PERIOD_NS, frame)
    chain = _chain()
    chain.lens = LENS
    measured = chain.measure(PERIOD_NS, frame)
    assert np.all(np.abs(distorted.displacement.x_m + 0.19) > 2e-3)
    assert measured.displacement.x_m == pytest.approx([-0.19] * 3, abs=3e-5)
    assert measured.u_px == pytest.approx(distorted.u_px, abs=0.02)
    u, v = measured.u_px, measured.v_px
    stretch = (LENS.undistort(u + 0.01, v)[0] - LENS.undistort(u - 0.01, v)[0]) / 0.02
    assert measured.sigma_px == pytest.approx(distorted.sigma_px * stretch, rel=0.02)
    assert np.all(stretch > 1.05)


def test_a_calibration_made_with_another_lens_is_noticed() -> None:
    made = LinearCalibration.from_camera(CAMERA, 3)
    with_lens = replace(made, provenance={"lens": lens_to_dict(LENS)})
    chain = _chain(with_lens)
    assert "another lens" in chain.lens_fault
    chain.lens = LENS
    assert chain.lens_fault == ""
    chain.calibration = replace(made, provenance={"lens": {"focal_px": "far"}})
    assert "calibrate again" in chain.calibration_fault


def test_a_part_of_the_sensor_has_the_same_lens() -> None:
    part = LENS.seen_through((100, 60), (2, 3))
    u, v = 412.0, 250.0
    part_u, part_v = (u - 100 - 0.5) / 2, (v - 60 - 1) / 3
    expected = LENS.undistort(u, v)
    found = part.undistort(part_u, part_v)
    assert 2 * found[0] + 0.5 + 100 == pytest.approx(expected[0], abs=1e-6)
    assert 3 * found[1] + 1 + 60 == pytest.approx(expected[1], abs=1e-6)


def test_after_a_long_gap_and_with_other_grey_levels_the_markers_are_found_at_once() -> None:
    chain = _chain()
    left = _frame(-0.01)
    for k in range(1, 41):
        chain.admit(k * PERIOD_NS)
        chain.measure(k * PERIOD_NS, left)
    chain.admit(100 * PERIOD_NS)
    moved = chain.measure(100 * PERIOD_NS, _frame(0.02))  # 45 px away
    assert moved.displacement.x_m == pytest.approx([0.02] * 3, abs=3e-5)
    wide = _frame(0.02).astype(np.uint16) * 257
    assert chain.measure(101 * PERIOD_NS, wide).displacement.x_m == pytest.approx([0.02] * 3, abs=3e-5)


@pytest.mark.parametrize("step", [1, 4, 30])
def test_missing_frames_and_other_rates_do_not_make_a_covered_marker_a_new_one(step) -> None:
    # A cover of a tenth of the disc moves its centre by a quarter of a pixel.
    chain, rng = _chain(), np.random.default_rng(4)
    renderer = SceneRenderer(CAMERA, HEIGHTS)
    row = float(CAMERA.rows(HEIGHTS[1]))
    cover = Disturbances(occluders=(Occluder(0.0, row - 20, 320.0 - 4.8, row + 20, 20.0),))
    for k in range(60):
        stamp = 10**18 + step * k * PERIOD_NS
        assert chain.admit(stamp)
        frame = renderer.render(np.zeros(3), rng, disturbances=cover if k > 30 else None)
        valid = [reason == "ok" for reason in chain.measure(stamp, frame).reasons]
        assert valid == [True, k <= 30, True]
