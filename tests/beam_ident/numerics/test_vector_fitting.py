from __future__ import annotations

import itertools

import numpy as np
import pytest

from beam_ident.numerics.vector_fitting import full_poles, relocated_poles, spread_poles

OMEGAS = np.linspace(1.0, 60.0, 300)


def response(poles: np.ndarray, residues: np.ndarray) -> np.ndarray:
    """Return the sum of residue / (s - pole) over pairs, and over real poles."""
    s = 1j * OMEGAS[:, None]
    return np.sum(
        residues / (s - poles) + np.where(poles.imag > 0.0, np.conj(residues) / (s - np.conj(poles)), 0.0),
        axis=1,
    )


@pytest.mark.parametrize("is_geometric", [True, False])
@pytest.mark.parametrize("direct", [0.0, 0.7])
def test_exact_poles_are_found_among_them_a_real_one(is_geometric, direct):
    truth = np.array([-3.0 + 0j, -0.1 + 5.0j, -0.4 + 22.0j, -0.3 + 41.0j])
    values = response(truth, np.array([2.0, 1.0 - 1.0j, -0.5 + 0.2j, 0.3j])) + direct
    moves = relocated_poles(
        1j * OMEGAS, values, np.ones(300), spread_poles(OMEGAS, 7, is_geometric), direct != 0.0
    )
    found = next(itertools.islice(moves, 15, None))
    np.testing.assert_allclose(np.sort_complex(found), np.sort_complex(truth), rtol=1e-8)
    assert len(full_poles(found)) == 7


def test_poles_on_the_right_are_mirrored():
    values = response(np.array([0.2 + 20.0j]), np.array([1.0j]))
    found = next(
        itertools.islice(
            relocated_poles(1j * OMEGAS, values, np.ones(300), spread_poles(OMEGAS, 2, True), False), 10, None
        )
    )
    np.testing.assert_allclose(found, [-0.2 + 20.0j], rtol=1e-8)
