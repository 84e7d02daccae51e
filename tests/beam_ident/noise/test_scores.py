"""Whether a fit left something out: the test's error rates against a linear model whose truth is known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import kstest

from beam_ident.noise.scores import ScoreTest
from beam_ident.numerics.linear_least_squares import LinearSolution

N = 400


def p_values(effect: float, colour: float, runs: int = 300) -> np.ndarray:
    """Return the p-values of a test for two cosines of size ``effect`` that a fit of a line left out."""
    rng = np.random.default_rng(0)
    line = np.stack([np.ones(N), np.arange(N) / N], axis=1)
    waves = np.stack([np.cos(0.3 * np.arange(N)), np.sin(0.3 * np.arange(N))], axis=1)
    found = []
    for _ in range(runs):
        noise = lfilter([1.0], [1.0, -colour], rng.standard_normal(N + 200))[200:]
        values = line @ rng.standard_normal(2) + effect * waves[:, 0] + noise
        left = values - line @ np.linalg.lstsq(line, values, rcond=None)[0]
        found.append(ScoreTest.of([(waves, LinearSolution.of(line), left, values)]).p_value)
    return np.array(found)


@pytest.mark.parametrize("colour", [0.0, 0.8])
def test_chance_alone_gives_every_p_value_alike(colour: float) -> None:
    found = p_values(0.0, colour)
    assert kstest(found, "uniform").pvalue > 1e-3
    assert 0.01 < np.mean(found < 0.05) < 0.1  # 300 runs: 5 % +- 1.3 %


def test_what_was_left_out_is_found() -> None:
    assert np.mean(p_values(0.4, 0.0, 50) < 0.01) > 0.95


def test_what_the_model_could_explain_is_nothing_new() -> None:
    line = np.stack([np.ones(N), np.arange(N) / N], axis=1)
    noise = np.random.default_rng(1).standard_normal(N)
    assert (
        ScoreTest.of([(line @ np.array([[1.0], [2.0]]), LinearSolution.of(line), noise, noise)]).p_value
        == 1.0
    )
    assert ScoreTest.of([]).p_value == 1.0
