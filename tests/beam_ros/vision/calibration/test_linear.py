from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from beam_ros.vision.calibration.linear import LinearCalibration
from beam_ros.vision.calibration.procedure import CalibrationPoint, CalibrationProcedure, fit_line
from beam_ros.vision.errors import CalibrationError
from tests.beam_ros.vision.packaged_rig import packaged_camera


def nominal(**changes) -> LinearCalibration:
    return LinearCalibration.from_camera(packaged_camera(**changes), 3)


def test_displacement_inverts_the_camera():
    for flip in (False, True):
        camera = packaged_camera(flip=flip)
        x = np.array([-0.01, 0.002, 0.03])
        found = LinearCalibration.from_camera(camera, 3).displacement(camera.columns(x), np.full(3, 0.0075))
        assert found.x_m == pytest.approx(x, abs=1e-15)
        assert found.sigma_m == pytest.approx(np.full(3, 5e-6))


def test_what_was_not_seen_stays_unknown():
    found = nominal().displacement([320.0, np.nan, 320.0], [0.01, np.nan, 0.01])
    assert np.isnan(found.x_m).tolist() == [False, True, False]
    assert np.isnan(found.sigma_m).tolist() == [False, True, False]


def test_uncertainty_of_scale_and_zero_travels_into_every_displacement():
    rng = np.random.default_rng(1)
    matrix = np.array([[4.0, 0.006], [0.006, 1e-4]])
    for flip in (False, True):
        calibration = LinearCalibration(
            (1500.0,), (320.0,), flip, ((tuple(matrix[0]), tuple(matrix[1])),), (640, 480), "", ""
        )
        u = 320.0 + (-1 if flip else 1) * 1500.0 * 0.02
        stated = calibration.displacement([u], [0.01]).sigma_m[0]
        scale, zero = rng.multivariate_normal([1500.0, 320.0], matrix, 200_000).T
        drawn = (-1 if flip else 1) * (u + 0.01 * rng.standard_normal(200_000) - zero) / scale
        # The sd of 200000 draws is known to 0.16 %; linearisation errs by less.
        assert stated == pytest.approx(drawn.std(), rel=0.01)


def test_tare_makes_the_mean_the_zero_and_states_its_uncertainty():
    rng = np.random.default_rng(2)
    u = 300.0 + 0.02 * rng.standard_normal((400, 3))
    u[5, 1] = np.nan
    tared = nominal().tare(u, np.full_like(u, 0.02))
    assert tared.zero_px == pytest.approx(np.nanmean(u, axis=0))
    assert tared.displacement(tared.zero_px, [0.0] * 3).sigma_m == pytest.approx(0.001 / 1500, rel=0.2)
    with pytest.raises(CalibrationError, match="marker 0: it was not seen in any of 2 frames"):
        nominal().tare(np.full((2, 3), np.nan), np.full((2, 3), np.nan))


def points(rng, n=24, sd_x=20e-6, sd_u=0.01, slope=1500.0, bend=0.0, lag=0.0):
    """Positions up and down again, with errors on both axes."""
    x = np.concatenate([np.linspace(-0.04, 0.04, n // 2), np.linspace(0.038, -0.038, n // 2)])
    side = np.concatenate([np.ones(n // 2), -np.ones(n // 2)])
    u = 320 + slope * x + bend * x**2 + lag / 2 * side + sd_u * rng.standard_normal(n)
    measured = x + sd_x * rng.standard_normal(n)
    return [CalibrationPoint(a, sd_x, b, sd_u, 100) for a, b in zip(measured, u, strict=True)]


def test_the_line_scatters_as_its_covariance_says():
    rng = np.random.default_rng(3)
    fits = [fit_line(points(rng)) for _ in range(600)]
    slopes = np.array([fit.slope for fit in fits])
    zeros = np.array([fit.intercept for fit in fits])
    # Stated with chi-squared never below one: 22 degrees of freedom make that 6 % too large on average.
    stated = np.sqrt(np.mean([np.diag(fit.covariance) for fit in fits], axis=0))
    assert slopes.mean() == pytest.approx(1500.0, abs=4 * slopes.std() / np.sqrt(600))
    assert zeros.mean() == pytest.approx(320.0, abs=4 * zeros.std() / np.sqrt(600))
    assert stated == pytest.approx([slopes.std(), zeros.std()], rel=0.15)
    assert np.mean([fit.chi_squared for fit in fits]) == pytest.approx(22, rel=0.05)


def test_points_that_scatter_more_than_they_say_widen_every_standard_deviation():
    rng = np.random.default_rng(8)
    fits = [
        fit_line(
            [replace(p, reference_sd_m=p.reference_sd_m / 3, u_sd_px=p.u_sd_px / 3) for p in points(rng)]
        )
        for _ in range(400)
    ]
    for value, stated in (
        ([fit.slope for fit in fits], [fit.covariance[0, 0] for fit in fits]),
        ([fit.intercept for fit in fits], [fit.covariance[1, 1] for fit in fits]),
        ([fit.curvature for fit in fits], [fit.curvature_sd**2 for fit in fits]),
        ([fit.hysteresis_px for fit in fits], [fit.hysteresis_sd_px**2 for fit in fits]),
    ):
        # A deviation is known to 3.5 % from 400.
        assert np.sqrt(np.mean(stated)) == pytest.approx(np.std(value), rel=0.15)


def test_errors_on_the_reference_do_not_flatten_the_line():
    rng = np.random.default_rng(4)
    sd = 0.004
    slopes = [fit_line(points(rng, sd_x=sd, sd_u=0.01, n=40)).slope for _ in range(400)]
    # Ordinary least squares would lose sd^2 / var(x) = 2.6 %.
    assert np.mean(slopes) == pytest.approx(1500.0, rel=0.006)


def test_curvature_and_hysteresis_are_found_and_not_invented():
    rng = np.random.default_rng(5)
    plain = [fit_line(points(rng)) for _ in range(200)]
    # Three standard deviations: 0.3 % of 200, at most 4 by chance (p < 0.002).
    assert sum(fit.is_curved for fit in plain) <= 4
    assert sum(fit.has_hysteresis for fit in plain) <= 4
    bent = fit_line(points(rng, bend=200.0))
    assert bent.is_curved
    assert bent.curvature == pytest.approx(200.0, abs=4 * bent.curvature_sd)
    loose = fit_line(points(rng, lag=0.2))
    assert loose.has_hysteresis
    assert loose.hysteresis_px == pytest.approx(0.2, abs=4 * loose.hysteresis_sd_px)


def test_the_procedure_recovers_scale_zero_and_direction():
    rng = np.random.default_rng(6)
    camera = packaged_camera(flip=True, pixels_per_metre=1480.0, name="cam")
    procedure = CalibrationProcedure(2, camera)
    for x in np.concatenate([np.linspace(-0.04, 0.04, 10), np.linspace(0.036, -0.036, 10)]):
        u = camera.columns([x, x])[None, :] + 0.02 * rng.standard_normal((50, 2))
        procedure.capture_point(u, np.full_like(u, 0.02), x + 2e-6 * rng.standard_normal(), 2e-6)
    fit = procedure.fit({"reference": "hub encoder"})
    calibration = fit.calibration
    assert fit.warnings == ()
    assert calibration.flip
    sd = np.sqrt([matrix[0][0] for matrix in calibration.covariance])
    assert np.all(np.abs(np.array(calibration.pixels_per_metre) - 1480.0) < 4 * sd)
    assert np.all(sd < 0.1)
    found = calibration.displacement(camera.columns([0.03, 0.03]), [0.0, 0.0])
    assert np.all(np.abs(found.x_m - 0.03) < 4 * found.sigma_m)
    assert calibration.provenance["reference"] == "hub encoder"


def test_a_calibration_survives_its_dictionary_exactly():
    calibration = nominal().tare([[320.1, 1 / 3, 319.7]], [[0.01, 0.02, 0.03]])
    text = json.dumps(calibration.to_dict())
    assert LinearCalibration.from_dict(json.loads(text)) == calibration


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"schema": 1}, "schema 1; expected 3"),
        ({"kind": "other"}, "no linear calibration"),
        ({"extra": 1}, "unknown keys"),
        ({"pixels_per_metre": [0.0, 1.0, 1.0]}, "scale of marker 0"),
        ({"pixels_per_metre": "abc"}, "cannot be read"),
        ({"zero_px": [1.0]}, "3 scales, 1 zeros"),
        ({"covariance": [[[1, 0], [0, -1]]] * 3}, "covariance of marker 0"),
    ],
)
def test_a_spoiled_dictionary_is_refused(change, message):
    with pytest.raises(CalibrationError, match=message):
        LinearCalibration.from_dict({**nominal().to_dict(), **change})


def test_another_camera_is_refused():
    calibration = nominal(name="left", focus="f8")
    calibration.require_camera(packaged_camera(name="left", focus="f8"))
    with pytest.raises(CalibrationError, match="images are 1920 x 1080; expected 640 x 480"):
        calibration.require_camera(packaged_camera(width=1920, height=1080))
    with pytest.raises(CalibrationError, match="camera is 'right'; expected 'left'"):
        calibration.require_camera(packaged_camera(name="right"))
    with pytest.raises(CalibrationError, match="focus is 'f4'; expected 'f8'"):
        calibration.require_camera(packaged_camera(name="left", focus="f4"))


def test_a_calibration_for_a_camera_and_focus_is_refused_where_nobody_says_what_is_in_use():
    calibration = nominal(name="left", focus="f8")
    with pytest.raises(CalibrationError, match=r"names no camera; expected 'left'.*set camera\.name"):
        calibration.require_camera(packaged_camera(focus="f8"))
    with pytest.raises(CalibrationError, match=r"names no focus; expected 'f8'.*set camera\.focus"):
        calibration.require_camera(packaged_camera(name="left"))


def test_a_calibration_that_leaves_camera_and_focus_open_is_doubtful_where_they_are_named():
    calibration = nominal(name="left")
    calibration.require_camera(packaged_camera(name="left", focus="f8"))
    assert "focus ('f8')" in calibration.doubt(packaged_camera(name="left", focus="f8"))
    assert (
        "camera" not in calibration.doubt(packaged_camera(name="left", focus="f8")).partition("expected")[2]
    )
    assert calibration.doubt(packaged_camera(name="left")) == ""
    assert nominal().doubt(packaged_camera()) == ""


def test_bad_captures_and_too_few_points_are_refused():
    procedure = CalibrationProcedure(1, packaged_camera())
    with pytest.raises(CalibrationError, match="not seen"):
        procedure.capture_point([[np.nan]], [[np.nan]], 0.0, 1e-6)
    with pytest.raises(CalibrationError, match="at rest"):
        procedure.capture_point(np.linspace(300, 340, 50)[:, None], np.full((50, 1), 0.01), 0.0, 1e-6)
    with pytest.raises(CalibrationError, match="reference is nan"):
        procedure.capture_point([[320.0]], [[0.01]], float("nan"), 1e-6)
    assert procedure.points == ()
    with pytest.raises(CalibrationError, match="0 points; expected at least 3"):
        procedure.fit()
    for _ in range(3):
        procedure.capture_point([[320.0]], [[0.01]], 0.01, 1e-6)
    with pytest.raises(CalibrationError, match="span"):
        procedure.fit()
    procedure.clear()
    for x in (0.0, 0.01, 0.02):
        procedure.capture_point([[320.0]], [[0.01]], x, 1e-6)
    with pytest.raises(CalibrationError, match="did not move"):
        procedure.fit()
