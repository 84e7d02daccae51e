from __future__ import annotations

import numpy as np
import pytest

from beam_model import BeamModel, Damping
from beam_model.galerkin.poles import (
    damping_ratios_of,
    eigenvalues_of,
    natural_frequencies_of,
    pole_pairs,
    sorted_by_mode,
)
from tests.beam_model.rigs import strip

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


def test_small_eigenvalues_keep_their_digits_beside_large_ones() -> None:
    rng = np.random.default_rng(1)
    values = np.array([-1e-3, -2e-3, -0.9, -3.0, -5e6, -4e9])
    T = np.linalg.qr(rng.standard_normal((6, 6)))[0]
    found = eigenvalues_of(T @ np.diag(values) @ T.T, T @ np.diag(1.0 / values) @ T.T)
    assert np.sort(found.real)[::-1] == pytest.approx(values, rel=1e-9)


@pytest.mark.parametrize(
    "damping",
    [
        Damping(internal=1.0),
        Damping(internal=1.0, viscous=1000.0, air=1000.0),
        Damping(viscous=1000.0),
        Damping(air=1e-9, internal=0.1),
        Damping(air=1e3),
    ],
)
@pytest.mark.parametrize("hub_mass", [0.8, 0.001])
def test_absurd_damping_leaves_what_the_determinant_says(damping: Damping, hub_mass: float) -> None:
    """The product of all poles is det K / det M, whatever the damping; their sum is -tr M^-1 C."""
    model = BeamModel(strip(gravity="upright", tip_mass=3e-3, damping=damping, hub_mass=hub_mass), 8)
    n = model.n_modes
    assert np.sum(np.log(model.natural_frequencies)) == pytest.approx(
        np.sum(np.log(model.basis.natural_frequencies)), abs=1e-9
    )
    M, C, K = model.matrices.M, model.matrices.C, model.matrices.K
    found = eigenvalues_of(*model.matrices.elastic_states())
    if damping.air == 0.0:
        reduced = M[1:, 1:] - np.outer(M[1:, 0], M[0, 1:]) / M[0, 0]
        expected = np.sum(np.log(np.diag(K)[1:])) - np.linalg.slogdet(reduced)[1]
    else:
        expected = np.sum(np.log(np.diag(K)[1:])) + np.log(C[0, 0]) - np.linalg.slogdet(M)[1]
    assert np.sum(np.log(np.abs(found))) == pytest.approx(expected, abs=1e-8 * n)
    assert np.sum(found).real == pytest.approx(-np.trace(np.linalg.solve(M, C)), rel=1e-9)
    assert np.all(found.real <= 0.0)
    assert np.all(np.isfinite(model.free_hub_damping_ratios))
