from __future__ import annotations

import numpy as np

from beam_ident.numerics.linear_least_squares import LinearSolution, StackedTriangle


def test_a_triangle_of_pieces_solves_what_the_whole_solves_for_nearly_dependent_columns():
    rng = np.random.default_rng(1)
    matrix = rng.standard_normal((500, 4))
    # 1e-7 apart: the squared condition of normal equations, 1e14, would leave two digits.
    matrix[:, 3] = matrix[:, 0] + 1e-7 * matrix[:, 3]
    truth = np.array([1.0, -2.0, 3.0, 0.5])
    whole = np.column_stack([matrix, matrix @ truth])
    triangle = StackedTriangle()
    for piece in np.split(whole, [2, 3, 200]):  # also fewer rows than columns
        triangle.add(piece)
    assert triangle.rows.shape == (5, 5)
    np.testing.assert_allclose(triangle.rows.T @ triangle.rows, whole.T @ whole, rtol=1e-12, atol=1e-10)
    found = LinearSolution.of(triangle.rows[:, :4]).coefficients(triangle.rows[:, 4])
    np.testing.assert_allclose(found, truth, rtol=1e-7)
