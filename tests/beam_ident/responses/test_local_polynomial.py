from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from beam_ident import (
    EstimationError,
    InputSignal,
    OutputSignal,
    TimeRecord,
    local_polynomial_response,
)

N_LINES = 200
LINES = np.arange(1, N_LINES)


def parabola(lines: np.ndarray) -> np.ndarray:
    """A response that a polynomial of degree 2 follows exactly."""
    share = lines / N_LINES
    return (1.0 + 2.0j) + (-3.0 + 1.0j) * share + (4.0 - 5.0j) * share**2


def circular_record(seed: int, noise: float) -> TimeRecord:
    """Pass a random input through the parabola line by line, as if it went on for ever."""
    rng = np.random.default_rng(seed)
    drive = rng.standard_normal(2 * N_LINES)
    output = np.fft.irfft(np.fft.rfft(drive) * parabola(np.arange(N_LINES + 1)), 2 * N_LINES)
    output += noise * rng.standard_normal(2 * N_LINES)
    # A zero-order hold and no exposure: the input at the stamps is its samples.
    return TimeRecord(
        (InputSignal("u", "N", (0.0, 0.01), drive, "zoh"),), (OutputSignal("y", "m", (0.0, 0.01), output),)
    )


@pytest.mark.parametrize("half_width", [4, None, 12])
def test_a_parabola_is_found_exactly_up_to_the_first_and_the_last_line(half_width):
    found = local_polynomial_response(circular_record(0, 0.0), 2, half_width)
    np.testing.assert_allclose(found.omegas, 2 * np.pi * LINES / (2 * N_LINES * 0.01), rtol=1e-12)
    np.testing.assert_allclose(found.response[:, 0, 0], parabola(LINES), rtol=1e-8)


@pytest.mark.slow
def test_the_standard_deviation_holds_at_the_edges_where_all_lines_lie_on_one_side():
    errors, sds = [], []
    for seed in range(150):
        found = local_polynomial_response(circular_record(seed, 0.3))
        errors.append(found.response[:, 0, 0] - parabola(LINES))
        sds.append(found.sd[:, 0, 0])
    # Mean squares over 150 draws, of 3 lines at each edge and 150 within; an estimated variance of
    # 7 degrees of freedom makes the mean 7/(7 - 1): a complex chi-squared of nu has the mean inverse nu/(nu - 1).
    ratio = np.mean(np.abs(errors) ** 2 / np.square(sds), axis=0)
    assert np.mean(ratio[20:170]) == pytest.approx(7 / 6, rel=0.05)
    for edge in (slice(0, 3), slice(-3, None)):
        assert np.mean(ratio[edge]) == pytest.approx(7 / 6, rel=0.25)
        assert np.mean(np.square(sds)[:, edge]) > 2.0 * np.mean(np.square(sds)[:, 100:103])


def record_of_two_light_modes(drive: np.ndarray, period: float) -> TimeRecord:
    """Pass a held input through modes at 2.3 and 14.4 Hz from rest on; noise of a hundredth."""
    states = [discrete_mode(2.3, 0.02, 1.0, period), discrete_mode(14.4, 0.01, -0.4, period)]
    output = sum(lfilter(numerator, denominator, drive) for numerator, denominator in states)
    output += 0.01 * np.std(output) * np.random.default_rng(1).standard_normal(len(drive))
    return TimeRecord(
        (InputSignal("u", "N", (0.0, period), drive, "zoh"),),
        (OutputSignal("y", "m", (0.0, period), output),),
    )


def discrete_mode(frequency: float, zeta: float, gain: float, period: float) -> tuple[np.ndarray, np.ndarray]:
    omega = 2.0 * np.pi * frequency
    found = cont2discrete(([gain * omega**2], [1.0, 2.0 * zeta * omega, omega**2]), period, "zoh")
    return np.squeeze(found[0]), found[1]


def test_lines_at_which_a_sweep_is_as_smooth_as_the_transient_are_marked_as_not_measured():
    period, n = 0.005, 4000
    t = period * np.arange(n)
    sweep = np.sin(2 * np.pi * (0.5 * t + 29.5 * t**2 / (2.0 * t[-1])))
    record = record_of_two_light_modes(sweep, period)
    found = local_polynomial_response(record)
    told = np.isfinite(found.response[:, 0, 0])
    assert not np.any(
        told[found.frequencies_hz < 4.0]
    )  # where the mode at 2.3 Hz was a hundred times too large
    assert np.all(told[(found.frequencies_hz > 5.0) & (found.frequencies_hz < 25.0)])
    assert sum("not measured" in said for said in found.warnings) == 1
    shift = np.exp(1j * found.omegas * period)
    truth = sum(
        np.polyval(b, shift) / np.polyval(a, shift)
        for b, a in (discrete_mode(2.3, 0.02, 1.0, period), discrete_mode(14.4, 0.01, -0.4, period))
    )
    error = np.abs(found.response[:, 0, 0] - truth)[told]
    assert np.max(error) < 0.25 * np.max(np.abs(truth[told]))  # on the resonance, which holds three lines
    with pytest.raises(EstimationError, match="first or last moments"):
        local_polynomial_response(record_of_two_light_modes(np.where(t < 0.02, 1.0, 0.0), period))


@pytest.mark.first_case
@pytest.mark.parametrize("n_samples", [400, 4000, 40_000])
def test_random_and_periodic_inputs_lose_no_line(n_samples):
    rng = np.random.default_rng(n_samples)
    square = np.where(np.arange(n_samples) % 40 < 20, 1.0, -1.0)
    for drive in (
        rng.standard_normal(n_samples),
        np.repeat(rng.choice([-1.0, 1.0], n_samples // 4), 4),
        square,
    ):
        found = local_polynomial_response(record_of_two_light_modes(drive, 0.005))
        assert np.all(np.isfinite(found.response))
