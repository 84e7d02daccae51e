from __future__ import annotations

import math

import numpy as np
import pytest

from beam_ros.vision.errors import VisionParameterError
from tests.beam_ros.vision.packaged_rig import RIG, packaged_camera, packaged_tracker


def test_image_axes_follow_the_written_convention():
    camera = packaged_camera(pixels_per_metre=1000.0, origin_px=(320.0, 465.0))
    assert camera.columns(0.01) == pytest.approx(330.0)
    assert camera.rows([0.0, 0.1]) == pytest.approx([465.0, 365.0])


def test_a_flipped_camera_mirrors_columns_only():
    camera = packaged_camera(pixels_per_metre=1000.0, flip=True)
    assert camera.columns(0.01) == pytest.approx(310.0)
    assert camera.rows(0.1) == pytest.approx(365.0)


@pytest.mark.parametrize(
    "change",
    [
        {"width": 0},
        {"width": 640.5},
        {"rate_hz": 0.0},
        {"rate_hz": math.nan},
        {"exposure_s": 0.011},
        {"readout_s": -0.001},
        {"origin_px": (1.0,)},
        {"origin_px": ("a", 1.0)},
        {"contrast": 0.0},
        {"contrast": 240.0},
        {"stamp": "middle"},
        {"marker_diameter_m": 1e-5},
        {"noise_grey": "2"},
    ],
)
def test_a_camera_that_cannot_be_is_refused_with_value_and_remedy(change):
    with pytest.raises(VisionParameterError, match=r"is .*; expected .*: correct it"):
        packaged_camera(**change)


def test_whole_numbers_are_accepted_for_real_ones():
    assert packaged_camera(rate_hz=100, contrast=180, origin_px=(320, 465)).period_s == 0.01


@pytest.mark.parametrize(
    "change",
    [
        {"polarity": "grey"},
        {"marker_diameter_px": 0.0},
        {"level_fraction": 0.9},
        {"expected_rows_px": (100.0, 300.0)},
        {"expected_rows_px": (300.0, 290.0)},
        {"noise_grey": -1.0},
    ],
)
def test_tracker_parameters_that_contradict_are_refused(change):
    with pytest.raises(VisionParameterError, match="expected"):
        packaged_tracker(**change)


@pytest.mark.parametrize(
    ("region", "said"),
    [
        ((0.0, 20.0, 0.0, 479.0), "at least 24 px apart"),
        ((0.0, 639.0, 479.0, 0.0), "at least 24 px apart"),
        ((0.0, 639.0, 0.0), "first and last column"),
        ((0.0, 639.0, 100.0, 479.0), r"rows that hold all markers \(outside lie \[37\.5\]\)"),
    ],
)
def test_a_region_without_room_or_without_a_markers_row_is_refused(region, said):
    with pytest.raises(VisionParameterError, match=rf"tracker\.region is .*{said}.*rig file"):
        packaged_tracker(packaged_camera(), [0.01, 0.285], region_px=region)


def test_tracker_parameters_follow_from_the_camera():
    camera = packaged_camera(contrast=-150.0, background=200.0)
    parameters = packaged_tracker(camera, [0.01, 0.285], area_tolerance=0.2)
    assert parameters.polarity == "dark"
    assert parameters.marker_diameter_px == pytest.approx(12.0)
    assert np.allclose(parameters.expected_rows_px, [450.0, 37.5])
    assert parameters.area_tolerance == 0.2


def test_the_gates_of_the_rig_are_metres_and_scale_with_the_picture():
    near, far = (RIG.with_values({"camera.pixels_per_metre": scale}) for scale in (3000.0, 1500.0))
    for name in ("max_jump_px", "max_gate_px", "gate_growth_px", "row_gate_px", "max_smear_px"):
        gates = [getattr(rig.tracker_parameters(), name) for rig in (near, far)]
        assert gates[0] == pytest.approx(2 * gates[1]), name


def test_markers_of_little_distance_have_the_tolerance_that_is_left_and_too_little_names_its_keys():
    camera = packaged_camera()
    close = packaged_tracker(camera, [0.2, 0.2 + 24 / 1500])
    assert close.expected_row_tolerance_px == pytest.approx(0.45 * 24)
    with pytest.raises(
        VisionParameterError, match=r"at least 22 px apart: correct markers.heights and camera"
    ):
        packaged_tracker(camera, [0.2, 0.2 + 21 / 1500])
