from __future__ import annotations

import numpy as np
import pytest

from beam_ident.numerics.linear_least_squares import LinearSolution, StackedTriangle, triangle_of_rows


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


@pytest.mark.parametrize("kind", ["apart", "nearly dependent", "zero", "few columns"])
def test_the_triangle_of_rows_has_their_lengths_and_angles(kind):
    rng = np.random.default_rng(3)
    rows = rng.standard_normal((7, 4 if kind == "few columns" else 400)) * 10.0 ** np.arange(-3, 4)[:, None]
    if kind == "nearly dependent":
        rows[5] = rows[4] + 1e-7 * rows[5]  # the squared condition leaves no digit of the difference
    if kind == "zero":
        rows[2] = 0.0
    triangle = triangle_of_rows(rows)
    assert triangle.shape == (min(rows.shape), 7)
    assert not np.any(np.tril(triangle[:, : len(triangle)], -1))
    expected = np.abs(np.linalg.qr(rows.T, mode="r"))
    np.testing.assert_allclose(np.abs(triangle), expected, rtol=1e-6, atol=1e-12 * np.max(expected))


def test_a_column_of_hardly_anything_is_left_out_and_its_inverse_square_never_formed():
    matrix = np.random.default_rng(0).standard_normal((20, 2)) * np.array([1.0, 1e-200])
    solution = LinearSolution.of(matrix)
    with np.errstate(all="raise"):
        gram = solution.inverse_gram()
    assert list(solution.kept) == [0]
    assert gram[0, 0] == pytest.approx(1.0 / float(matrix[:, 0] @ matrix[:, 0]))
    assert gram[1, 1] == 0.0
