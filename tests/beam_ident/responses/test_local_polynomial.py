from __future__ import annotations

import numpy as np
import pytest

from beam_ident import InputSignal, OutputSignal, TimeRecord, local_polynomial_response

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
