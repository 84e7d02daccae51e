"""A long linear problem as a short one that says the same.

The columns X of a block, their derivatives and the values y of its outputs stand side by side, and an orthogonal
transformation of their rows makes them triangular: as many rows are left as there are columns.  Lengths and angles
stay, so that whatever least squares can say of the long problem (coefficients, sums of squares, gradients,
information) it says of the short one.  The rows are taken piece by piece, each triangle joined with the next piece
(Golub and Van Loan, Matrix Computations, 2013, section 6.5.3): nothing grows with their number, and unlike
normal equations this does not square the condition of the columns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.modal.block_rows import ColumnBlock, ModeSlopes
from beam_ident.modal.regression import ClockState
from beam_ident.numerics.linear_least_squares import StackedTriangle


class Piecewise(Protocol):
    """A linear problem whose rows may be taken piece by piece, each piece with the columns of the whole."""

    @property
    def values(self) -> Sequence[FloatArray]:
        """What was measured, of every output."""

    @property
    def block_of(self) -> Sequence[int]:
        """Which block of columns goes with each output."""

    @property
    def pieces(self) -> Sequence[Piecewise]:
        """The pieces, in the order of the rows."""

    def blocks(
        self, omegas: FloatArray, zetas: FloatArray, clock: ClockState, gradients: bool
    ) -> list[ColumnBlock]:
        """Return the columns of every block, and their derivatives where asked for."""


@dataclass(frozen=True, eq=False)
class CondensedColumns:
    """The linear problem of all outputs in as few rows as it has columns.

    Attributes
    ----------
    values : list of ndarray -- of every output, on the rows of its block
    blocks : list of ColumnBlock
    """

    values: list[FloatArray]
    blocks: list[ColumnBlock]

    @staticmethod
    def of(
        problem: Piecewise, omegas: FloatArray, zetas: FloatArray, clock: ClockState, gradients: bool = True
    ) -> CondensedColumns:
        """Condense the columns of given poles and a clock, and their derivatives where asked for.

        Parameters
        ----------
        problem : Piecewise
        omegas, zetas : ndarray, shape (n_modes,) -- [rad/s], [-]
        clock : ClockState
        gradients : bool
        """
        owners = [
            [j for j, own in enumerate(problem.block_of) if own == block]
            for block in range(max(problem.block_of) + 1)
        ]
        triangles = [StackedTriangle() for _ in owners]
        templates: list[ColumnBlock] = []
        for piece in problem.pieces:
            templates = piece.blocks(omegas, zetas, clock, gradients)
            for triangle, block, outputs in zip(triangles, templates, owners, strict=True):
                if len(block.matrix):
                    triangle.add(_side_by_side(block, [piece.values[j] for j in outputs]))
        values: list[FloatArray] = [np.empty(0)] * len(problem.block_of)
        blocks = []
        for triangle, block, outputs in zip(triangles, templates, owners, strict=True):
            for place, output in enumerate(outputs):
                values[output] = triangle.rows[:, place - len(outputs)]
            blocks.append(_apart(block, triangle.rows))
        return CondensedColumns(values, blocks)


def residuals_of(
    problem: Piecewise,
    omegas: FloatArray,
    zetas: FloatArray,
    clock: ClockState,
    coefficients: Sequence[FloatArray],
) -> list[FloatArray]:
    """Return what a model leaves of the values, of every output.

    Parameters
    ----------
    problem : Piecewise
    omegas, zetas : ndarray, shape (n_modes,) -- [rad/s], [-]
    clock : ClockState
    coefficients : sequence of ndarray -- linear parameters of every output
    """
    left: list[list[FloatArray]] = [[] for _ in coefficients]
    for piece in problem.pieces:
        blocks = piece.blocks(omegas, zetas, clock, gradients=False)
        for parts, values, block, found in zip(left, piece.values, piece.block_of, coefficients, strict=True):
            parts.append(values - blocks[block].matrix @ found)
    return [np.concatenate(parts) if len(parts) > 1 else parts[0] for parts in left]


def _side_by_side(block: ColumnBlock, values: Sequence[FloatArray]) -> FloatArray:
    """Return columns, their derivatives by latency, clock rate and poles where there are any, and values."""
    if block.by_time is None:
        return np.concatenate([block.matrix, np.stack(values, axis=1)], axis=1)
    n_rows, n_columns = block.matrix.shape
    n_modes, width = block.mode_columns.shape
    whole = np.empty((n_rows, 3 * n_columns + 2 * n_modes * width + len(values)), order="F")
    whole[:, :n_columns] = block.matrix
    np.multiply(block.by_time, block.latency_factor[:, None], out=whole[:, n_columns : 2 * n_columns])
    np.multiply(block.by_time, block.rate_factor[:, None], out=whole[:, 2 * n_columns : 3 * n_columns])
    first = 3 * n_columns
    for mode in block.modes:
        for slopes in (mode.by_log_omega, mode.by_zeta):
            whole[:, first : first + width] = slopes
            first += width
    for own in values:
        whole[:, first] = own
        first += 1
    return whole


def _apart(block: ColumnBlock, rows: FloatArray) -> ColumnBlock:
    """Return what ``_side_by_side`` joined, on the rows of the triangle."""
    n_columns = block.matrix.shape[1]
    n_modes, width = block.mode_columns.shape
    matrix = np.array(rows[:, :n_columns], order="F")
    if block.by_time is None:
        nothing = np.zeros(len(rows))
        return ColumnBlock(matrix, block.mode_columns, (), None, nothing, nothing)
    first = 3 * n_columns
    parts = [rows[:, first + k * width : first + (k + 1) * width] for k in range(2 * n_modes)]
    return ColumnBlock(
        matrix=matrix,
        mode_columns=block.mode_columns,
        modes=tuple(ModeSlopes(parts[2 * k], parts[2 * k + 1]) for k in range(n_modes)),
        by_time=rows[:, n_columns : 2 * n_columns],
        latency_factor=np.ones(len(rows)),
        rate_factor=np.zeros(len(rows)),
        by_rate=rows[:, 2 * n_columns : 3 * n_columns],
    )
