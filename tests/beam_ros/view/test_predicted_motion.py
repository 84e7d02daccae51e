"""What the model predicts from the hub's samples, against the closed form of a driven oscillator."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ros.rig.rig import Rig
from beam_ros.view.predicted_motion import PredictedMotion


@pytest.fixture(scope="module")
def model():
    # Damped so strongly that the start is forgotten within the record.
    return Rig.from_file().with_values({"beam.damping_ratios": [0.1], "beam.modes": 2}).beam_model()


def moved(model, frequency_hz: float, step_ns: int, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Return times [s] and q over a hub that swings by 1 mm."""
    stamps = list(range(0, round(seconds * 1e9), step_ns))
    times = np.array(stamps) * 1e-9
    return times, PredictedMotion(model).add(stamps, 1e-3 * np.sin(2 * np.pi * frequency_hz * times))


@pytest.mark.parametrize("frequency_hz", [1.0, 4.0, 10.0])
def test_a_swinging_hub_bends_the_beam_as_a_driven_oscillator(model, frequency_hz):
    times, q = moved(model, frequency_hz, 1_000_000, 5.0)
    omega, drive = model.natural_frequencies, 2 * np.pi * frequency_hz
    # q'' + 2 zeta omega_i q' + omega_i^2 q = -Gamma alpha'' for alpha = a sin(drive t)
    response = drive**2 / (omega**2 - drive**2 + 2j * model.damping_ratios * omega * drive)
    late = times > 4.0
    expected = 1e-3 * np.imag(
        model.participation_factors * response * np.exp(1j * drive * times[late])[:, None]
    )
    # Straight lines between samples at 1 kHz leave (drive T)^2 / 12, below 4e-4 at 10 Hz.
    np.testing.assert_allclose(q[late], expected, atol=1e-3 * np.abs(expected).max())


def test_the_step_is_exact_at_any_period_for_a_hub_that_moves_in_straight_lines(model):
    stamps = list(range(0, 1_000_000_000, 1_000_000))
    ramp = np.minimum(np.array(stamps) * 1e-9, 0.5) * 0.02
    fine = PredictedMotion(model).add(stamps, ramp)
    coarse = PredictedMotion(model).add(stamps[::100], ramp[::100])
    np.testing.assert_allclose(coarse, fine[::100], atol=1e-9)


def test_batches_one_by_one_give_what_all_at_once_give(model):
    stamps = list(range(0, 200_000_000, 1_000_000))
    positions = 1e-3 * np.sin(np.arange(200) * 0.05)
    whole = PredictedMotion(model).add(stamps, positions)
    pieces = PredictedMotion(model)
    parts = [pieces.add(stamps[k : k + 20], positions[k : k + 20]) for k in range(0, 200, 20)]
    np.testing.assert_allclose(np.vstack(parts), whole, atol=1e-15)


@pytest.mark.parametrize("frequency_hz", [1.0, 2.0])
def test_lost_batches_leave_no_ringing(frequency_hz):
    model = Rig.from_file().beam_model()  # hardly damped: what strikes it is seen for many seconds
    stamps = np.arange(0, 3_000_000_000, 1_000_000)
    times = stamps * 1e-9
    positions = 1e-3 * np.sin(2 * np.pi * frequency_hz * times) ** 2
    whole = PredictedMotion(model).add(stamps.tolist(), positions)
    hears, last = PredictedMotion(model), np.zeros(0)
    for k in range(0, len(stamps), 20):
        if not 1.0 <= times[k] < 1.06:  # three batches in a row
            last = hears.add(stamps[k : k + 20].tolist(), positions[k : k + 20])[-1]
            np.testing.assert_allclose(last, whole[k + 19], atol=0.01 * np.abs(whole).max())


def test_a_beam_is_at_rest_at_first_and_after_a_long_gap_or_a_step_back(model):
    for later_ns in (5_000_000_000, -5_000_000_000):
        motion = PredictedMotion(model)
        motion.add([0, 1_000_000], np.array([0.0, 1e-3]))
        assert not motion.add([later_ns], np.array([0.02])).any()
