from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.signal import lfilter

from beam_ident import FrequencyRecord, analyse_modes, fit_frequency_modes, stabilisation_chart
from beam_ident.noise.autoregression import (
    ColouredRows,
    ScoreCovariance,
    autoregression,
    excess_over_lines,
    line_autoregression,
    line_correlation,
    score_covariance,
)

HERTZES = np.array([12.0, 31.0])
OMEGAS, ZETAS = 2.0 * np.pi * HERTZES, np.array([0.02, 0.015])


def correlation(colour: np.ndarray, n: int) -> np.ndarray:
    """Return the correlation of an autoregression's noise at lags 0 .. n - 1 (Yule-Walker, then its recursion)."""
    order = len(colour) - 1
    equations, right = np.zeros((order + 1, order + 1)), np.zeros(order + 1)
    right[0] = 1.0
    for k in range(order + 1):
        for j, own in enumerate(colour):
            equations[k, abs(k - j)] += own
    found = np.linalg.solve(equations, right).tolist()
    while len(found) < n:
        found.append(-float(np.dot(colour[1:], found[: -order - 1 : -1])))
    return np.array(found[:n]) / found[0]


SLOW = np.poly([0.995 * np.exp(0.4j), 0.995 * np.exp(-0.4j), 0.9]).real  # rings on far beyond a short record
COLOURS = [np.array([1.0, -0.9]), np.array([1.0, -0.9, 0.3]), SLOW]


@pytest.mark.parametrize("n", [1, 2, 17, 60, 101])
@pytest.mark.parametrize("colour", COLOURS)
def test_the_covariance_of_a_score_is_that_of_the_full_correlation_matrix(n, colour):
    design = np.random.default_rng(n).standard_normal((n, 3))
    expected = design.T @ toeplitz(correlation(colour, n)) @ design
    np.testing.assert_allclose(score_covariance(design, colour), expected, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(score_covariance(design, np.ones(1)), design.T @ design, rtol=1e-12)


def windowed_noise(rng: np.random.Generator, n: int, decay: float, pad: int) -> np.ndarray:
    """Return the transform of noise under an exponential window that falls by ``e^-decay``, zero-padded."""
    values = rng.standard_normal(2 * n // pad) * np.exp(-decay * np.linspace(0.0, 1.0, 2 * n // pad))
    spectrum = np.fft.fft(values, 2 * n)[1 : n + 1]
    return spectrum / np.sqrt(np.sum(np.exp(-2.0 * decay * np.linspace(0.0, 1.0, 2 * n // pad))))


def test_white_errors_are_left_alone():
    rng = np.random.default_rng(0)
    values = rng.standard_normal(800) + 1j * rng.standard_normal(800)
    assert len(line_autoregression(values)) == 1
    design = rng.standard_normal((1600, 3))
    assert not np.any(excess_over_lines(design, np.concatenate([values.real, values.imag])))


def test_the_correlation_of_a_window_is_found():
    rng = np.random.default_rng(1)
    colour = line_autoregression(windowed_noise(rng, 4000, 4.6, 1))
    # The transform of the window's square: decay / (decay + j pi m) for m lines.
    lags = np.arange(6)
    expected = 4.6 / (4.6 + 1j * np.pi * lags)
    np.testing.assert_allclose(
        line_correlation(colour, 4000)[:6], expected, atol=0.1
    )  # three times the square root of 4.6 / 4000


def record(seed: int, decay: float, pad: int, n: int = 600) -> FrequencyRecord:
    omegas = 2.0 * np.pi * np.linspace(5.0, 45.0, n)
    s = 1j * omegas[:, None]
    clean = np.sum(OMEGAS**2 * np.array([1.0, 0.6]) / (s**2 + 2.0 * ZETAS * OMEGAS * s + OMEGAS**2), axis=1)
    rng = np.random.default_rng(seed)
    noise = 0.4 * np.stack([windowed_noise(rng, n, decay, pad) for _ in range(2)], axis=1)
    return FrequencyRecord(omegas, np.stack([clean, 0.5 * clean], axis=1) + noise, np.full((n, 2), 0.16))


@pytest.mark.slow
@pytest.mark.parametrize(("decay", "pad"), [(4.6, 1), (0.0, 8)])
@pytest.mark.parametrize("fit", ["search", "analysis"])
def test_intervals_cover_where_lines_share_their_errors(fit, decay, pad):
    scores = []
    for seed in range(24):
        lines = record(seed, decay, pad)
        if fit == "search":
            model = fit_frequency_modes(lines, "receptance", 2).model
            found = (
                model.natural_frequencies,
                model.damping_ratios,
                model.natural_frequency_sd,
                model.damping_ratio_sd,
            )
        else:
            modes = analyse_modes(stabilisation_chart(lines, max_order=16), HERTZES)
            found = (
                modes.natural_frequencies, modes.damping_ratios, modes.natural_frequency_sd, modes.damping_ratio_sd
            )  # fmt: skip
        scores += [(found[0] - OMEGAS) / found[2], (found[1] - ZETAS) / found[3]]
    # 96 scores scatter by 1 +- 0.07; independent lines would have been said to know 2 to 3 times as much.
    assert 0.8 < np.sqrt(np.mean(np.square(scores))) < 1.25


def test_a_score_that_comes_in_pieces_has_the_covariance_of_the_whole():
    design = np.random.default_rng(1).standard_normal((900, 3))
    pieces = ScoreCovariance(SLOW)
    for piece in np.split(design, [1, 5, 300, 600]):
        pieces.add(piece)
    expected = design.T @ toeplitz(correlation(SLOW, len(design))) @ design
    np.testing.assert_allclose(pieces.total, expected, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(pieces.white, design.T @ design, rtol=1e-12, atol=1e-12)


def test_what_a_model_took_up_of_slow_noise_is_given_back():
    # Twelve slow columns take up a good part of an AR(1) of 0.9 in 300 samples, known beforehand but for its level.
    n, pole = 300, 0.9
    t = np.linspace(0.0, np.pi, n)
    design = np.cos(np.arange(12) * t[:, None])
    root = np.linalg.cholesky(toeplitz(pole ** np.arange(n)))
    white = np.linalg.solve(root, design)
    doubt = design @ np.linalg.cholesky(np.linalg.inv(white.T @ white))
    found = []
    for seed in range(60):
        noise = lfilter([1.0], [1.0, -pole], np.random.default_rng(seed).standard_normal(n + 200))[200:]
        target = np.linalg.solve(root, noise)
        left = noise - design @ np.linalg.lstsq(white, target, rcond=None)[0]
        level = np.linalg.norm(np.linalg.solve(root, left)) / np.sqrt(n - 12)
        found.append([-autoregression(left, 1, own)[1] for own in (np.zeros((n, 1)), level * doubt)])
    alone, both = np.mean(found, axis=0)
    # One estimate scatters by 0.025, and is itself 3 / n too small.
    assert both == pytest.approx(pole - 3.0 / n, abs=0.012)
    assert alone < pole - 0.03


def test_rows_behind_a_colour_have_the_products_that_it_correlates():
    n, colour = 3000, np.array([1.0, -0.8])
    one, other = np.random.default_rng(5).standard_normal((2, n, 2))
    behind = [ColouredRows(colour).passed(own) for own in (one, other)]
    expected = one.T @ toeplitz(0.8 ** np.arange(n)) @ other
    # What rings on after the last of 3000 rows is left out.
    assert behind[0].T @ behind[1] == pytest.approx(expected, abs=0.01 * np.sqrt(n) * 9.0)
    pieces = ColouredRows(colour)
    joined = np.concatenate([pieces.passed(one[:1000]), pieces.passed(one[1000:])])
    assert joined == pytest.approx(behind[0], abs=1e-12)
