"""What hub and beam foretell, beside a beam that SciPy integrates, and a film in which a marker meets its like."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

pytest.importorskip("cv2")
from beam_ros.rig.rig import Rig
from beam_ros.vision.calibration.linear import LinearCalibration
from beam_ros.vision.measurement.measuring_chain import MeasuringChain
from beam_ros.vision.measurement.motion_prediction import MotionPrediction
from beam_ros.vision.rendering.disturbances import Disturbances, Occluder, SecondSpot
from beam_ros.vision.rendering.frames import SceneRenderer

RIG = Rig.from_file().with_values({"tracker.prediction": "beam"})
HEIGHTS = np.asarray(RIG.markers.heights)
PERIOD_S, START_NS = 0.01, 10**18
RATES, SIZES = 2 * np.pi * np.array([0.9, 2.3, 6.1]), np.array([4e-3, 2e-3, 3e-4])


def hub_position(t):
    """Where the hub is [m]."""
    return np.sin(np.multiply.outer(t, RATES)) @ SIZES


def swinging_beam(duration_s: float, error: float):
    """Positions of the markers over time [m], of a beam whose frequencies differ by a share from the rig's."""
    motion = RIG.beam_motion()
    omega, modes = motion.frequencies[:2] * (1 + error), slice(0, 2)

    def slope(t, state):
        q, speed = np.split(state, 2)
        drive = motion.participation[modes] * float((SIZES * RATES**2) @ np.sin(RATES * t))
        return np.r_[speed, drive - omega**2 * q - 2 * motion.damping_ratios[modes] * omega * speed]

    found = solve_ivp(
        slope, (0, duration_s), [2e-3, 0, 0, 0], method="DOP853", dense_output=True, rtol=1e-9, atol=1e-12
    )
    return lambda t: hub_position(t) + motion.shapes[:, modes] @ found.sol(t)[:2]


def tell_hub(hear, begin_s: float, end_s: float) -> None:
    """Say where the hub is, every millisecond."""
    for k in range(round(begin_s * 1e3), round(end_s * 1e3)):
        hear(START_NS + k * 10**6, float(hub_position(k * 1e-3)))


@pytest.mark.slow
@pytest.mark.parametrize(("error", "readout_s"), [(0.0, 0.0), (0.04, 0.0), (-0.04, 0.008)])
def test_markers_that_are_hidden_stay_within_what_is_foretold_of_them(error, readout_s):
    scale, zeros, sigma = -1500.0, np.array([320.0, 327.0, 317.0]), 0.01
    prediction = MotionPrediction(RIG.beam_motion(), np.full(3, scale), PERIOD_S)
    beam, rng = swinging_beam(4.2, error), np.random.default_rng(2)
    errors, doubts = np.empty((400, 3)), np.empty((400, 3))
    for k in range(400):
        tell_hub(prediction.add_hub, k * PERIOD_S, (k + 1) * PERIOD_S)
        times = k * PERIOD_S + readout_s * np.array([1.0, 0.5, 0.0])
        u = zeros + scale * np.array([beam(t)[i] for i, t in enumerate(times)])
        foretold = prediction.foretell([START_NS + round(t * 1e9) for t in times])
        assert bool(foretold) == (k >= 10)
        errors[k] = np.abs([one.u_px for one in foretold] - u) if foretold else 0.0
        doubts[k] = [one.doubt_px for one in foretold] if foretold else np.inf
        hidden = [False, 150 <= k < 170, 150 <= k < 170]
        prediction.correct(np.where(hidden, np.nan, u + sigma * rng.standard_normal(3)), np.full(3, sigma))
    assert np.mean(errors < doubts) > 0.997
    assert np.sqrt(np.mean(errors[40:150] ** 2)) < 0.3  # they move by up to 25 px a frame
    assert np.median(doubts[40:150]) < 3.0


def test_a_jump_of_the_camera_is_doubted_and_a_gap_forgets():
    prediction = MotionPrediction(RIG.beam_motion(), np.full(3, 1500.0), PERIOD_S)
    for k in range(60):
        foretold = prediction.foretell([START_NS + k * 10**7] * 3)
        prediction.correct(np.full(3, 320.0 + 20.0 * (k == 50)), np.full(3, 0.01))
        if k in (50, 51):
            doubt = foretold[2].doubt_px
            assert (doubt < 6.0) == (k == 50)
    assert not prediction.foretell([START_NS + 2 * 10**9] * 3)


def seen_beside_a_twin(prediction: str) -> tuple[np.ndarray, int]:
    """Errors of a tip that a disc follows, both hidden for a while [px], and how often the model told them apart."""
    rig = RIG.with_values({"tracker.prediction": prediction})
    camera = rig.camera_parameters()
    calibration = LinearCalibration.from_camera(camera, 3)
    chain = MeasuringChain(camera, rig.tracker_parameters(), HEIGHTS.tolist(), calibration, rig.beam_motion())
    renderer, beam, rng = SceneRenderer(camera, HEIGHTS), swinging_beam(1.7, 0.03), np.random.default_rng(1)
    row = float(camera.rows(HEIGHTS)[2])
    errors = []
    for k in range(150):
        x = 2.5 * beam(k * PERIOD_S)
        u = float(camera.columns(x[2]))
        twin = SecondSpot(u + 24.0, row)
        cover = Occluder(u - 20, row - 12, u + 44, row + 12, 20.0)
        disturbances = Disturbances((twin,) if k >= 60 else (), (), (cover,) if 80 <= k < 92 else ())
        tell_hub(lambda at, x: chain.hear_hub(at, 2.5 * x), k * PERIOD_S, (k + 1) * PERIOD_S)
        stamp_ns = START_NS + k * 10**7
        assert chain.admit(stamp_ns)
        measured = chain.measure(stamp_ns, renderer.render(x, rng, disturbances=disturbances))
        errors.append(float(measured.u_px[2] - u))
    return np.array(errors), int(chain.foretold_frames[2])


@pytest.mark.slow
@pytest.mark.parametrize("prediction", ["none", "beam"])
def test_a_tip_that_was_hidden_with_its_twin_is_told_by_the_others_and_by_the_model(prediction):
    errors, foretold = seen_beside_a_twin(prediction)
    assert np.isnan(errors[80:92]).all()
    assert np.abs(errors[94:]).max() < 0.1
    assert bool(foretold) == (prediction == "beam")
