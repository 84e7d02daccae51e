"""Chirps, sines and moves: their frequencies, amplitudes, windows and limits."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ident import AxisLimits, LinearChirp, LogChirp, PointToPoint, Sine, SteppedSine


@pytest.mark.parametrize("down", [False, True])
def test_the_linear_chirp_passes_its_frequencies_in_equal_times(down):
    ends = (40.0, 4.0) if down else (4.0, 40.0)
    recipe = LinearChirp(
        start_frequency=ends[0], end_frequency=ends[1], duration=10.0, fade_in=0.5, fade_out=0.5
    )
    a = recipe.sample().accelerations
    middle = a[4900:5100]  # 22 Hz, half-way
    spectrum = np.abs(np.fft.rfft(middle * np.hanning(200), 20000))
    assert np.fft.rfftfreq(20000, 1e-3)[np.argmax(spectrum)] == pytest.approx(22.0, abs=0.5)
    assert np.max(np.abs(a[1000:9000])) == pytest.approx(0.7, rel=0.01)


def test_ceilings_hold_each_quantity_in_its_band():
    recipe = LogChirp(
        start_frequency=0.2,
        end_frequency=50.0,
        duration=60.0,
        acceleration=1.0,
        max_velocity=0.02,
        max_displacement=0.004,
    )
    excitation = recipe.sample(2e-3)
    assert np.max(np.abs(excitation.positions)) == pytest.approx(0.004, rel=0.05)
    assert np.max(np.abs(excitation.velocities)) == pytest.approx(0.02, rel=0.05)
    assert np.max(np.abs(excitation.accelerations)) == pytest.approx(1.0, rel=0.05)


def test_a_sine_is_a_sine_between_its_ramps():
    recipe = Sine(start_frequency=5.0, acceleration=0.4, duration=4.0, fade_cycles=2.0)
    excitation = recipe.sample()
    t = np.arange(len(excitation.positions)) * 1e-3
    steady = slice(450, 3550)
    columns = np.stack([np.sin(10 * np.pi * t), np.cos(10 * np.pi * t)], axis=1)[steady]
    fit, *_ = np.linalg.lstsq(columns, excitation.positions[steady], rcond=None)
    assert np.hypot(*fit) == pytest.approx(0.4 / (10 * np.pi) ** 2, rel=1e-3)
    np.testing.assert_allclose(columns @ fit, excitation.positions[steady], atol=1e-9)


def test_a_stepped_sine_holds_each_frequency_where_it_is_to_be_measured():
    recipe = SteppedSine(frequencies=(3.0, 7.0, 5.0), acceleration=0.2, measure_cycles=8)
    excitation = recipe.sample()
    t = np.arange(len(excitation.positions)) * 1e-3 - 1e-3  # samples begin one tick before the recipe
    assert len(recipe.measure_windows_s) == 3
    for (start, end), hz in zip(recipe.measure_windows_s, recipe.frequencies, strict=True):
        assert (end - start) * hz == pytest.approx(8.0, rel=1e-12)
        inside = (t >= start) & (t <= end)
        angle = 2 * np.pi * hz * t[inside]
        columns = np.stack([np.sin(angle), np.cos(angle)], axis=1)
        fit, *_ = np.linalg.lstsq(columns, excitation.positions[inside], rcond=None)
        assert np.hypot(*fit) == pytest.approx(0.2 / (2 * np.pi * hz) ** 2, rel=2e-3)
        np.testing.assert_allclose(columns @ fit, excitation.positions[inside], atol=1e-5 * np.hypot(*fit))
    # The passages are as smooth as the rest: the acceleration overshoots by the glide of the frequency alone.
    assert np.max(np.abs(excitation.accelerations)) < 1.4 * 0.2
    assert recipe.measure_windows_s[-1][1] < recipe.active_s


@pytest.mark.parametrize("profile", ["bounded_jerk", "quintic", "cycloidal"])
@pytest.mark.parametrize(
    ("speed", "acceleration", "jerk", "binding"),
    [(0.01, 1.0, 100.0, "speed"), (1.0, 0.1, 100.0, "acceleration"), (1.0, 10.0, 2.0, "jerk")],
)
def test_moves_are_as_quick_as_the_limit_that_binds(profile, speed, acceleration, jerk, binding):
    recipe = PointToPoint(
        waypoints=(0.01, 0.0), profile=profile, speed=speed, acceleration=acceleration, jerk=jerk, dwell=0.2
    )
    excitation = recipe.sample()
    # The third difference averages the jerk over three ticks: within the limit, but for rounding.
    excitation.check(AxisLimits(speed=speed, acceleration=acceleration, jerk=jerk * (1 + 1e-6)))
    peaks = excitation.peaks()
    limits = {"speed": speed, "acceleration": acceleration, "jerk": jerk}
    assert peaks[binding][0] == pytest.approx(limits[binding], rel=0.02)
    assert np.max(excitation.positions) == pytest.approx(0.01, rel=1e-9)


def test_the_bounded_jerk_profile_is_the_quickest():
    times = {
        profile: PointToPoint(waypoints=(0.01, 0.0), profile=profile).move_times_s[0]
        for profile in ("bounded_jerk", "quintic", "cycloidal")
    }
    assert times["bounded_jerk"] < min(times["quintic"], times["cycloidal"])


def test_way_points_are_reached_and_rested_at():
    recipe = PointToPoint(waypoints=(0.003, -0.002, 0.001, 0.0), dwell=0.5, still=1.0)
    positions = recipe.sample().positions
    start = 0.0
    for point, length in zip(recipe.waypoints, recipe.move_times_s, strict=True):
        rest = slice(round((start + length) * 1e3) + 5, round((start + length + 0.5) * 1e3) - 5)
        np.testing.assert_allclose(positions[rest], point, atol=1e-12)
        start += length + 0.5


@pytest.mark.parametrize(
    "recipe",
    [Sine(), SteppedSine(), LinearChirp(), LogChirp(), PointToPoint(waypoints=(0.01, 0.0))],
    ids=lambda recipe: recipe.kind,
)
def test_nothing_moves_before_the_start_and_after_the_end(recipe):
    end = recipe.total_s - recipe.still
    outside = np.array([-1.3, -0.01, 0.0, end, end + 0.7])
    np.testing.assert_allclose(recipe.displacement(outside), 0.0, atol=1e-15)


def test_a_move_that_its_jerk_alone_bounds_has_four_equal_pieces():
    recipe = PointToPoint(waypoints=(0.01, 0.0), speed=1.0, acceleration=10.0, jerk=2.0)
    # Jerk +, -, -, + for t each: half of the way is j t^3.
    assert recipe.move_times_s[0] == pytest.approx(4.0 * (0.01 / (2.0 * 2.0)) ** (1.0 / 3.0), rel=1e-12)
