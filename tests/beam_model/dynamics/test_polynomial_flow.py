from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from beam_model.dynamics.polynomial_flow import PolynomialFlow, are_positive, first_zero, value_at

TERMS = 24


def powers(*values: float) -> np.ndarray:
    """Coefficients of a polynomial from its powers, rising."""
    result = np.zeros(TERMS)
    result[: len(values)] = values
    return result


def through(*roots: float) -> np.ndarray:
    """A polynomial that is positive at 0 and has these zeros."""
    coefficients = np.polynomial.polynomial.polyfromroots(roots)
    return powers(*(coefficients * np.sign(coefficients[0])))


@pytest.mark.parametrize("longest", [1e-3, 0.02])
def test_the_flow_is_the_matrix_exponential(longest: float) -> None:
    A = np.array([[0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0], [-4e4, 1e3, -1.0, 0.0], [1e3, -2e6, 0.0, -5.0]])
    B = np.array([0.0, 0.0, 1.0, -2.0])
    flow = PolynomialFlow(A, B, longest, np.array([200.0, 1500.0, 1.0, 1.0]))
    assert longest / flow.piece == pytest.approx(round(longest / flow.piece))
    start = np.array([1e-3, -2e-4, 0.1, 0.3])
    augmented = np.zeros((5, 5))
    augmented[:4, :4], augmented[:4, 4] = A, B
    for s in (0.0, 0.37, 1.0):
        truth = expm(augmented * s * flow.piece) @ np.append(start, 3.0)
        assert value_at(flow.coefficients(start, 3.0), s) == pytest.approx(truth[:4], rel=1e-11, abs=1e-15)


@pytest.mark.parametrize(
    ("roots", "end", "expected"),
    [
        ((0.3,), 1.0, 0.3),
        ((0.3,), 0.2, None),
        ((0.4, 0.41, 0.9), 1.0, 0.4),
        ((0.5, 0.500001), 1.0, 0.5),
        ((0.7, 1.5), 0.8, 0.7),
        ((-0.1, 1.1), 1.0, None),
    ],
)
def test_the_first_passage_is_found_and_only_a_passage(
    roots: tuple[float, ...], end: float, expected: float | None
) -> None:
    found = first_zero(through(*roots), end)
    assert found == (None if expected is None else pytest.approx(expected, abs=1e-9))


def test_a_polynomial_that_begins_at_zero_passes_it_only_if_it_falls() -> None:
    assert first_zero(powers(0.0, -1.0, 5.0), 1.0) == 0.0
    assert first_zero(powers(0.0, 1.0, -2.0), 1.0) == pytest.approx(0.5)
    assert first_zero(powers(0.0, 0.0, 1.0), 1.0) is None
    assert first_zero(powers(-1e-18, 1.0), 1.0) is None
    assert first_zero(powers(), 1.0) is None
    # (s - 0.4)^2 + 1e-8: as near as a tenth of a per mille of what it begins with, and no passage.
    assert first_zero(powers(0.16 + 1e-8, -0.8, 1.0), 1.0) is None


def test_what_is_called_positive_has_no_zero_however_it_swings() -> None:
    rng = np.random.default_rng(3)
    s = np.linspace(0.0, 1.0, 20_001)
    n_sure = 0
    for _ in range(300):
        swing = powers(*(rng.standard_normal(12) * 3.0 ** -np.arange(12)))
        swing[0] = abs(swing[0]) + 0.2
        values = np.polynomial.polynomial.polyval(s, swing)
        if are_positive(swing[:, None]):
            n_sure += 1
            assert values.min() > 0.0
        crossing = np.flatnonzero(values < 0.0)
        found = first_zero(swing, 1.0)
        assert (found is None) == (crossing.size == 0)
        if found is not None:
            assert found == pytest.approx(s[crossing[0]], abs=1e-4)
    assert n_sure > 50
