"""Linear least squares on columns of very different size, shared by all estimators."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass

import numpy as np
from scipy.linalg import blas, lapack, qr, solve_triangular

from beam_ident.arrays import FloatArray, IndexArray

_RANK_TOLERANCE = 1e-10
_NOTHING = 1e-140  # length of a column, the inverse square of which is no number
_CHOLESKY_TOLERANCE = 1e-5
_WELL_APART = 1e-3  # sine of a row's angle to those before it; the square of rounding is left of it


def lengths(columns: FloatArray) -> FloatArray:
    """Return the length of every column, shape (n_rows, n_columns)."""
    return np.asarray(np.sqrt(np.einsum("ij,ij->j", columns, columns)))


@dataclass(frozen=True, eq=False)
class LinearSolution:
    """QR of a tall matrix, its columns scaled to unit length and dependent ones left out.

    Attributes
    ----------
    basis : ndarray, shape (n_rows, rank) -- orthonormal
    triangle : ndarray, shape (rank, rank) -- upper triangular
    kept : ndarray, shape (rank,) -- the columns that were kept, in the triangle's order
    scales : ndarray, shape (n_columns,) -- lengths of the columns
    """

    basis: FloatArray
    triangle: FloatArray
    kept: IndexArray
    scales: FloatArray

    @staticmethod
    def of(matrix: FloatArray) -> LinearSolution:
        """Decompose a tall matrix."""
        scales = lengths(matrix)
        scaled = matrix / np.where(scales < _NOTHING, np.inf, scales)
        scales[scales < _NOTHING] = 1.0
        # Columns of unit length: the rank is judged by directions, not by units.
        quick = _cholesky_qr(scaled)
        if quick is not None:
            return LinearSolution(quick[0], quick[1], np.arange(len(scales)), scales)
        basis, triangle, order = qr(scaled, mode="economic", pivoting=True, check_finite=False)
        diagonal = np.abs(np.diag(triangle))
        rank = int(np.count_nonzero(diagonal > _RANK_TOLERANCE * max(diagonal[0], 1e-300)))
        return LinearSolution(basis[:, :rank], triangle[:rank, :rank], order[:rank], scales)

    def coefficients(self, values: FloatArray) -> FloatArray:
        """Return ``A^+ values``, for one or several right-hand sides."""
        result = np.zeros((len(self.scales), *values.shape[1:]))
        if not len(self.kept):
            return result
        solved = solve_triangular(self.triangle, self.basis.T @ values, check_finite=False)
        scales = self.scales[self.kept]
        result[self.kept] = solved / (scales[:, None] if values.ndim > 1 else scales)
        return result

    def left_of(self, columns: FloatArray) -> FloatArray:
        """Return what the matrix does not explain of columns, shape (n_rows, n) or (n_rows,)."""
        if columns.ndim == 1:
            return np.asarray(columns - self.basis @ (self.basis.T @ columns))
        left = np.array(columns, order="F")
        if not left.size or not len(self.kept):
            return left
        return np.asarray(blas.dgemm(-1.0, self.basis, self.basis.T @ left, 1.0, left, overwrite_c=1))

    def inverse_gram(self) -> FloatArray:
        """Return ``(A^T A)^-1``, zero for columns left out."""
        if not len(self.kept):
            return np.zeros((len(self.scales), len(self.scales)))
        inverse = solve_triangular(self.triangle, np.eye(len(self.kept)), check_finite=False)
        inverse = inverse / self.scales[self.kept][:, None]
        result = np.zeros((len(self.scales), len(self.scales)))
        result[np.ix_(self.kept, self.kept)] = inverse @ inverse.T
        return result


def _cholesky_qr(matrix: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Return Q and R by two rounds of Cholesky, or None where columns are nearly dependent.

    Notes
    -----
    Orthogonal to rounding while the condition stays below 1e7 (Yamamoto et al. 2015),
    and several times quicker than Householder reflections on tall matrices.
    """
    basis, triangle = np.array(matrix, order="F"), np.eye(matrix.shape[1])
    if not matrix.shape[1]:
        return basis, triangle
    for _ in range(2):
        try:
            # A^T A = L L^T, Q = A L^-T; the second round removes what the squared condition cost the first.
            lower = np.linalg.cholesky(basis.T @ basis)
        except np.linalg.LinAlgError:
            return None
        if np.min(np.diag(lower)) < _CHOLESKY_TOLERANCE:
            return None
        basis = blas.dtrsm(1.0, lower, basis, side=1, lower=1, trans_a=1, overwrite_b=1)
        triangle = lower.T @ triangle
    return basis, triangle


def triangle_of_rows(matrix: FloatArray) -> FloatArray:
    """Return the triangle R of ``A^T = Q R`` for a wide matrix A, shape (n_rows, n_columns).

    Notes
    -----
    From the Cholesky factor of A A^T, ten times quicker than by reflections, where the rows point in so different
    directions that the squared condition leaves more digits than data have; else by reflections. Signs of rows of R
    are not fixed.
    """
    n_rows, n_columns = matrix.shape
    squares = matrix @ matrix.T
    scales = np.sqrt(np.diag(squares))
    if n_rows <= n_columns and np.all(scales > 0.0):
        with contextlib.suppress(np.linalg.LinAlgError):
            lower = np.linalg.cholesky(squares / np.outer(scales, scales))
            if np.min(np.diag(lower)) > _WELL_APART:
                return np.asarray(lower.T * scales)
    triangle = qr(matrix.T, mode="r", check_finite=False)[0]
    return np.asarray(triangle[: min(matrix.shape)])


class StackedTriangle:
    """The triangle R of ``A = Q R``, for a matrix A whose rows come piece by piece.

    Attributes
    ----------
    rows : ndarray, shape (min(n_rows, n_columns), n_columns) -- R; ``R^T R = A^T A``
    """

    def __init__(self) -> None:
        self.rows: FloatArray = np.empty((0, 0))

    def add(self, piece: FloatArray) -> None:
        """Take in more rows, shape (n, n_columns); always of the same columns."""
        if self.rows.size:
            # Q R of [R; piece]: the triangle so far stands for all rows before.
            joined = np.empty((len(self.rows) + len(piece), piece.shape[1]), order="F")
            joined[: len(self.rows)], joined[len(self.rows) :] = self.rows, piece
        else:
            joined = np.array(piece, order="F")
        factored = lapack.dgeqrf(joined, overwrite_a=True)[0]
        self.rows = np.triu(factored[: piece.shape[1]])


def scaled_solve(information: FloatArray, direction: FloatArray, damping: float) -> FloatArray:
    """Solve the damped normal equations on unit diagonal."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    scaled = information * np.outer(scale, scale)
    scaled[np.diag_indices_from(scaled)] += damping
    step = np.linalg.lstsq(scaled, direction * scale, rcond=1e-14)[0]
    return np.asarray(step * scale)
