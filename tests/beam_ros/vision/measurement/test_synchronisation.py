from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest

from beam_model import BeamModel, BeamParameters, Damping
from beam_ros.vision.errors import SynchronisationError
from beam_ros.vision.measurement.synchronisation import _hermite, _robust_covariance, synchronise

PERIOD = 1e-3


@lru_cache(maxsize=1)
def experiment():
    """Hub and low marker (10 mm) of the default strip under a chirp of constant acceleration, at 1 kHz."""
    parameters = BeamParameters.from_section(
        length=0.30,
        width=0.025,
        thickness=0.0005,
        density=7850.0,
        youngs_modulus=200e9,
        hub_mass=0.8,
        gravity="upright",
        damping=Damping(ratios=(0.005,)),
    )
    model = BeamModel(parameters, n_modes=5)
    t = np.arange(0.0, 20.0, PERIOD)
    growth = np.log(40.0 / 1.0) / 20.0
    phase = 2 * np.pi * np.expm1(growth * t) / growth
    acceleration = 0.7 * np.sin(phase) * np.minimum(1.0, np.minimum(t / 0.5, (20.0 - t) / 0.5))
    acceleration = np.concatenate([np.zeros(2000), acceleration - acceleration.mean(), np.zeros(3000)])
    states = model.motion_stepper(PERIOD).run(acceleration)
    velocity = np.concatenate([[0.0], np.cumsum(acceleration) * PERIOD])
    position = np.concatenate([[0.0], np.cumsum(velocity[:-1] * PERIOD + acceleration * PERIOD**2 / 2)])
    shape, rest = model.shape([0.010])[0], model.residual_terms([0.010])[0]
    marker = position + states[:, :5] @ shape - rest * np.append(acceleration, 0.0)
    return np.arange(position.size) * PERIOD, position, marker


def film(offset_s, rng, drift=0.0, span=(1.0, 24.0), noise=5e-6, rate=100.0):
    """The low marker at a camera's frames, by the camera's own clock."""
    t, _, marker = experiment()
    hub_times = np.arange(span[0], span[1], 1 / rate)
    # A box of 5 ms about each frame
    box = np.convolve(marker, np.ones(5) / 5, mode="same")
    seen = np.interp(hub_times, t, box) + noise * rng.standard_normal(hub_times.size)
    return (hub_times - offset_s) / (1 + drift), seen


@pytest.mark.parametrize("offset_s", [0.0, 3.2104, -117.00037])
def test_the_offset_is_recovered_to_two_tenths_of_a_millisecond(offset_s):
    rng = np.random.default_rng(1)
    t, position, _ = experiment()
    camera_t, seen = film(offset_s, rng)
    found = synchronise(t, position + 0.1e-6 * rng.standard_normal(position.size), camera_t, seen)
    assert abs(found.offset_s - offset_s) < 0.2e-3
    assert abs(found.offset_s - offset_s) < 4 * found.offset_sd_s
    assert found.offset_sd_s < 0.3e-3
    assert found.gain == pytest.approx(1.0, abs=0.01)
    assert found.drift == found.drift_sd == 0.0
    assert found.hub_times(camera_t[0]) == pytest.approx(1.0, abs=0.2e-3)


def test_the_clocks_rates_are_fitted_on_request():
    rng = np.random.default_rng(2)
    t, position, _ = experiment()
    camera_t, seen = film(2.0, rng, drift=2e-4)
    found = synchronise(t, position, camera_t, seen, fits_drift=True)
    assert abs(found.drift - 2e-4) < 4 * found.drift_sd
    assert found.drift_sd < 1e-4
    assert abs(found.hub_times(camera_t[1000]) - (1.0 + 10.0)) < 0.3e-3


def test_a_part_of_the_experiment_and_lost_frames_are_enough():
    rng = np.random.default_rng(3)
    t, position, _ = experiment()
    camera_t, seen = film(0.5, rng, span=(3.0, 9.0))
    seen[50:90] = np.nan
    found = synchronise(t, position, camera_t, seen)
    assert abs(found.offset_s - 0.5) < 0.2e-3
    assert found.n_frames == 560


def test_a_scale_error_shows_in_the_gain_and_a_shift_in_the_zero():
    rng = np.random.default_rng(4)
    t, position, _ = experiment()
    camera_t, seen = film(0.5, rng)
    found = synchronise(t, position, camera_t, 1.05 * seen + 0.003)
    assert found.gain == pytest.approx(1.05, abs=0.01)
    assert found.zero_m == pytest.approx(0.003, abs=1e-4)
    assert abs(found.offset_s - 0.5) < 0.2e-3


def test_what_does_not_belong_together_is_refused():
    rng = np.random.default_rng(5)
    t, position, _ = experiment()
    camera_t, seen = film(0.5, rng)
    with pytest.raises(SynchronisationError, match=r"correlation of 0\.\d+ at best"):
        synchronise(t, position, camera_t, 1e-3 * rng.standard_normal(seen.size))
    with pytest.raises(SynchronisationError, match="right direction"):
        synchronise(t, position, camera_t, -np.abs(seen))
    with pytest.raises(SynchronisationError, match="never moved"):
        synchronise(t, np.zeros_like(t), camera_t, seen)
    with pytest.raises(SynchronisationError, match="0 frames"):
        synchronise(t, position, camera_t, np.full(seen.size, np.nan))
    with pytest.raises(SynchronisationError, match="rising times"):
        synchronise(t[::-1], position, camera_t, seen)


def test_a_film_that_is_mirrored_is_refused_also_where_half_a_period_later_it_looks_right():
    rng = np.random.default_rng(6)
    t = np.arange(0.0, 20.0, PERIOD)
    swing = 5e-3 * np.exp(-(((t - 10.0) / 3.0) ** 2)) * np.sin(4 * np.pi * t)
    camera_t = np.arange(1.0, 19.0, 0.01)
    seen = np.interp(camera_t, t, swing) + 5e-6 * rng.standard_normal(camera_t.size)
    assert abs(synchronise(t, swing, camera_t, seen).offset_s) < 1e-3
    with pytest.raises(SynchronisationError, match=r"against the hub .* set camera\.is_mirrored"):
        synchronise(t, swing, camera_t, -seen)


def test_between_samples_with_their_slopes_a_cubic_is_followed_exactly():
    def cubic(t):
        return 1.0 - 2.0 * t + 0.5 * t**2 + 3.0 * t**3, -2.0 + t + 9.0 * t**2

    knots = np.array([0.0, 0.1, 0.4, 0.5, 1.0])
    times = np.array([0.0, 0.03, 0.25, 0.4, 0.77, 1.0])
    value, slope = _hermite(knots, *cubic(knots), times)
    np.testing.assert_allclose(value, cubic(times)[0], atol=1e-12)
    np.testing.assert_allclose(slope, cubic(times)[1], atol=1e-12)


def test_residuals_weigh_with_each_other_by_bartletts_triangle():
    rng = np.random.default_rng(4)
    design, residual = rng.standard_normal((40, 2)), rng.standard_normal(40)
    found = _robust_covariance(design, residual, PERIOD * np.arange(40), 3.5 * PERIOD)
    # Newey and West (1987), eq. (5): lags up to m = 3 with weights 1 - lag / (m + 1), here as one matrix.
    lag = np.abs(np.subtract.outer(np.arange(40), np.arange(40)))
    noise = np.clip(1.0 - lag / 4.0, 0.0, None) * np.outer(residual, residual)
    gain = np.linalg.solve(design.T @ design, design.T)
    np.testing.assert_allclose(found, gain @ noise @ gain.T, rtol=1e-12)


@pytest.mark.parametrize("late_s", [0.0, 0.08, 0.15, 0.9, -0.4])
def test_late_stamps_are_found_whether_expected_or_not(late_s):
    rng = np.random.default_rng(20)
    t, position, _ = experiment()
    camera_t, seen = film(-late_s, rng, drift=-2e-4, span=(4.0, 14.0))
    found = synchronise(t, position, camera_t, seen, fits_drift=True, expected_s=0.1)
    middle = 9.0 + late_s
    assert found.hub_times(middle) == pytest.approx((1 - 2e-4) * middle - late_s, abs=0.5e-3)
    assert found.drift == pytest.approx(-2e-4, abs=5 * found.drift_sd)


def test_of_motions_that_repeat_themselves_the_expected_one_is_taken():
    rng = np.random.default_rng(21)
    t = np.arange(0.0, 25.0, PERIOD)
    hub = 1e-3 * np.sin(2 * np.pi * 2.0 * t)
    for _ in range(5):
        frames = np.arange(1.0, 20.0, 0.01)
        low = 1e-3 * np.sin(2 * np.pi * 2.0 * (frames - 0.03)) + 5e-6 * rng.standard_normal(frames.size)
        assert synchronise(t, hub, frames, low, expected_s=0.1).offset_s == pytest.approx(-0.03, abs=1e-3)


def held_back(places, band):
    """What a codec shows that leaves out changes within a band: it stays behind by so much."""
    shown = np.empty_like(places)
    last = places[0]
    for k, place in enumerate(places):
        last = min(max(last, place - band), place + band)
        shown[k] = last
    return shown


@pytest.mark.parametrize("band", [0.0, 10e-6])
def test_what_a_codec_holds_back_delays_no_time_and_both_ends_are_known_as_well_as_is_stated(band):
    t = np.arange(0.0, 12.0, PERIOD)
    # Fast at first, and slow in the end: there the film is later.
    hub = 5e-3 * np.exp(-t / 3.0) * np.sin(2 * np.pi * (1.5 * t - 0.04 * t**2))
    camera_t = np.arange(0.5, 10.5, 0.01)
    errors, plain = [], []
    for seed in range(20):
        rng = np.random.default_rng([22, seed])
        seen = held_back(np.interp(camera_t + 0.3, t, hub), band) + 20e-6 * rng.standard_normal(camera_t.size)
        ends = camera_t[[0, -1]]
        found = synchronise(t, hub, camera_t, seen, fits_drift=True, fits_lag=True)
        errors.append((found.hub_times(ends) - ends - 0.3) / found.hub_time_sds(ends))
        assert abs(found.lag_m - band) < 4 * found.lag_sd_m
        found = synchronise(t, hub, camera_t, seen, fits_drift=True)
        plain.append((found.hub_times(ends) - ends - 0.3) / found.hub_time_sds(ends))
    # Twenty squares scatter by a third.
    assert np.all(np.abs(np.sqrt(np.mean(np.square(errors), axis=0)) - 1.0) < 0.4)
    assert (np.abs(np.mean(plain, axis=0)).max() > 3.0) == (band > 0)


def test_times_are_known_as_well_from_wherever_they_are_counted():
    t, position, _ = experiment()
    camera_t, seen = film(2.0, np.random.default_rng(23), drift=2e-4)
    found = synchronise(t, position, camera_t, seen, fits_drift=True)
    other = found.begun_earlier(3.0)
    np.testing.assert_allclose(other.hub_times(camera_t - 3.0), found.hub_times(camera_t), rtol=0, atol=1e-12)
    np.testing.assert_allclose(other.hub_time_sds(camera_t - 3.0), found.hub_time_sds(camera_t), rtol=1e-9)
    # Least where the motion is, and larger at either end.
    sds = found.hub_time_sds(camera_t)
    assert sds[0] == pytest.approx(found.hub_time_sds(camera_t[0]))
    assert sds.min() < 0.8 * min(sds[0], sds[-1])
