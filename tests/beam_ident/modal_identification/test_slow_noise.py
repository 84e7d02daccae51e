"""Modes that slow noise hides from equal weights: the truth is SciPy's, the noise drawn."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from beam_ident import InputSignal, OutputSignal, TimeRecord, identify

PERIOD_S = 1.0 / 250.0
MODES = [(3.1, 0.012), (19.4, 0.006)]
GAINS = np.array([[1.0, 0.6], [0.5, -0.8]])
DRIVE = np.sign(np.random.default_rng(3).standard_normal(500)).repeat(5)
TIMES = PERIOD_S * np.arange(len(DRIVE))


def responses() -> np.ndarray:
    """Return two outputs under a held input, shape (n, 2), by exact steps."""
    total = np.zeros((len(DRIVE), 2))
    for (hertz, zeta), gains in zip(MODES, GAINS.T, strict=True):
        omega = 2.0 * np.pi * hertz
        system = ([1.0], [1.0, 2.0 * zeta * omega, omega**2])
        numerator, denominator, _ = cont2discrete(system, PERIOD_S)
        total += lfilter(numerator[0], denominator, DRIVE)[:, None] * gains
    return total


def slow(values: np.ndarray, share: float, seed: int, decay: float = 1.0) -> np.ndarray:
    """Return values with a random walk, or what decays to it, and a little white noise on them."""
    rng = np.random.default_rng(seed)
    walk = lfilter([1.0], [1.0, -decay], rng.standard_normal(values.shape), axis=0)
    return values + np.std(values, axis=0) * (share * walk + 0.003 * rng.standard_normal(values.shape))


def record(values: np.ndarray, times: np.ndarray = TIMES) -> TimeRecord:
    outputs = tuple(OutputSignal(name, "m", times, values[:, j]) for j, name in enumerate(("root", "tip")))
    return TimeRecord((InputSignal("u", "N", TIMES, DRIVE, "zoh"),), outputs)


def assert_both_are_found(found) -> None:
    model = found.model
    errors = [
        (model.natural_frequencies - [2.0 * np.pi * hertz for hertz, _ in MODES])
        / model.natural_frequency_sd,
        (model.damping_ratios - [zeta for _, zeta in MODES]) / model.damping_ratio_sd,
    ]
    assert np.max(np.abs(errors)) < 3.6


@pytest.mark.slow
@pytest.mark.parametrize(("share", "n_modes"), [(0.02, 2), (0.06, None)])
def test_a_drift_that_is_louder_than_a_mode_does_not_hide_it(share, n_modes):
    # With equal weights the search took the drift for a mode of 0.4 Hz, or saw the first mode alone.
    found = identify(record(slow(responses(), share, 7)), "receptance", n_modes)
    assert_both_are_found(found)
    kinds = [entry.weighed_by for entry in found.orders]
    assert kinds[0] == ""  # what compares with what is said
    assert next(own for own in found.orders if own.is_chosen).weighed_by == "slow noise of the outputs"


@pytest.mark.slow
def test_slow_noise_at_stamps_anywhere_hides_no_mode():
    kept = np.sort(np.random.default_rng(1).choice(len(TIMES), 1200, replace=False))
    assert_both_are_found(
        identify(record(slow(responses(), 0.08, 8, 0.999)[kept], TIMES[kept]), "receptance")
    )


@pytest.mark.slow
def test_records_of_unlike_slow_noise_are_searched_together():
    pair = [record(slow(responses(), share, seed)) for share, seed in ((0.05, 9), (0.15, 10))]
    assert_both_are_found(identify(pair, "receptance"))


@pytest.mark.slow
def test_a_drift_alone_is_no_mode():
    rng = np.random.default_rng(5)
    drift = record(slow(1e-3 * rng.standard_normal((len(TIMES), 2)), 0.3, 11))
    with pytest.raises(ValueError, match="no mode"):
        identify(drift, "receptance")
