from __future__ import annotations

import numpy as np
import pytest

from beam_model.galerkin.poles import damping_ratios_of, natural_frequencies_of, pole_pairs, sorted_by_mode

OMEGA = np.array([10.0, 30.0, 90.0, 200.0])
RATIOS = np.array([1.5, 0.01, 1.0, 40.0])


def test_pairs_hold_frequency_and_ratio() -> None:
    pairs = pole_pairs(OMEGA, RATIOS)
    assert natural_frequencies_of(pairs) == pytest.approx(OMEGA, rel=1e-14)
    assert damping_ratios_of(pairs) == pytest.approx(RATIOS, rel=1e-14)
    for (first, second), omega, ratio in zip(pairs, OMEGA, RATIOS, strict=True):
        assert np.poly([first, second]) == pytest.approx([1.0, 2.0 * ratio * omega, omega**2], rel=1e-13)
    assert abs(pairs[3, 0]) < abs(pairs[3, 1])  # the slower first
    assert pairs[1, 0].imag > 0.0


@pytest.mark.parametrize("seed", range(5))
def test_eigenvalues_in_any_order_find_their_modes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    omega = np.sort(rng.uniform(1.0, 1000.0, 6))
    pairs = pole_pairs(omega, rng.choice([0.01, 0.5, 1.2, 3.0], 6))
    moved = pairs * 1.0001
    found = sorted_by_mode(rng.permutation(np.append(moved.ravel(), -5.0)), pairs, (-5.1,))
    assert found == pytest.approx(moved)


def test_a_mode_that_swings_with_what_was_the_hub_s_pole_is_put_together() -> None:
    expected = pole_pairs(np.array([10.0, 50.0]), np.array([5.0, 0.1]))  # -1.01 and -99 rad/s
    swinging = np.array([-1.5 + 2.0j, -1.5 - 2.0j])
    eigenvalues = np.concatenate([swinging, [-99.0], expected[1]])
    found = sorted_by_mode(eigenvalues, expected, (-2.5,))
    assert found[0] == pytest.approx(swinging)
    assert found[1] == pytest.approx(expected[1])
