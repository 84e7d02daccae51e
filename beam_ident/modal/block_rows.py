"""The columns of outputs that share stamps, filled part by part: matrix, derivatives by poles and by time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from beam_ident.arrays import ComplexArray, FloatArray, IndexArray

Rows = IndexArray | slice


@dataclass(frozen=True, eq=False)
class ModeSlopes:
    """Derivatives of the columns of one mode, each (n_rows, n_columns)."""

    by_log_omega: FloatArray
    by_zeta: FloatArray


@dataclass(frozen=True, eq=False)
class ColumnBlock:
    """The linear problem of all outputs that share stamps.

    Attributes
    ----------
    matrix : ndarray, shape (n_rows, n_columns)
    mode_columns : ndarray, shape (n_modes, n_columns of a mode)
        Which columns belong to each mode.
    modes : tuple of ModeSlopes
        Derivatives by the poles; empty when none were asked for.
    by_time : ndarray or None, shape (n_rows, n_columns)
        Derivative by the instant of measurement.
    latency_factor, rate_factor : ndarray, shape (n_rows,)
        Derivative of the instant by latency and clock rate.
    by_rate : ndarray or None, shape (n_rows, n_columns)
        Derivative by the clock rate, where rows are not instants.
    turn : callable or None
        The linear map that the rows of ``matrix`` have passed, and those of the derivatives have not: of these, few
        sums are asked for.
    """

    matrix: FloatArray
    mode_columns: IndexArray
    modes: tuple[ModeSlopes, ...]
    by_time: FloatArray | None
    latency_factor: FloatArray
    rate_factor: FloatArray
    by_rate: FloatArray | None = None
    turn: Callable[[FloatArray], FloatArray] | None = None

    def slopes(self, found: FloatArray, latency_is_free: bool, rate_is_free: bool) -> FloatArray:
        """Return the derivative of one output's model by the nonlinear parameters, shape (n_rows, n_theta).

        Parameters
        ----------
        found : ndarray, shape (n_columns,) -- the output's linear parameters
        latency_is_free, rate_is_free : bool
            The order is log omega of all modes, zeta of all modes, then latency and clock rate where free.
        """
        n = len(self.modes)
        result = np.empty((len(self.matrix), 2 * n + latency_is_free + rate_is_free), order="F")
        for mode, (own, columns) in enumerate(zip(self.modes, self.mode_columns, strict=True)):
            share = found[columns]
            result[:, mode] = own.by_log_omega @ share
            result[:, n + mode] = own.by_zeta @ share
        if latency_is_free or rate_is_free:
            assert self.by_time is not None
            # The clock moves the instants (I.6), and the instants move the model.
            speed = self.by_time @ found
            if latency_is_free:
                result[:, 2 * n] = speed * self.latency_factor
            if rate_is_free:
                result[:, -1] = speed * self.rate_factor if self.by_rate is None else self.by_rate @ found
        return result if self.turn is None else self.turn(result)

    def turned(self, turn: Callable[[FloatArray], FloatArray]) -> ColumnBlock:
        """Return the block with all rows passed through a linear map."""
        return replace(self, matrix=np.asfortranarray(turn(self.matrix)), turn=turn)


class BlockRows:
    """A block of columns whose rows are filled part by part.

    Parameters
    ----------
    n_rows, n_columns, n_modes : int
    n_touched : int
        Columns that a mode touches: residues' columns and, in every record and after every restart, the two of its
        free motion. The rest of the derivative by its pole is zero and is not stored.
    gradients : bool -- whether derivatives are filled as well
    """

    def __init__(self, n_rows: int, n_columns: int, n_modes: int, n_touched: int, gradients: bool) -> None:
        self.matrix = np.zeros((n_rows, n_columns), order="F")
        self.by_time = np.zeros_like(self.matrix) if gradients else None
        self.slopes = [np.zeros((2, n_touched, n_rows)) for _ in range(n_modes)] if gradients else []
        self.mode_columns = np.zeros((n_modes, n_touched), dtype=np.intp)
        self.clock_factors = np.empty((2, n_rows))

    def begin_residues(self, first: int, n_inputs: int) -> None:
        """Say where residues stand: those of all modes under one input after the other."""
        n_modes = len(self.mode_columns)
        columns = first + np.arange(n_inputs * n_modes).reshape(n_inputs, n_modes)
        self.mode_columns[:, :n_inputs] = columns.T

    def begin_free_motions(self, places: Sequence[tuple[int, int]]) -> None:
        """Say where pairs of all modes begin, among the columns and among those that a mode touches."""
        pairs = np.arange(2 * len(self.mode_columns)).reshape(-1, 2)
        for column, touched in places:
            self.mode_columns[:, touched : touched + 2] = column + pairs

    def part(self, here: slice, rows: IndexArray, whole: FloatArray) -> BlockPart:
        """Return a part to be filled: rows of the block, from those of a grid of stamps."""
        is_whole = here.stop - here.start == len(whole)
        return BlockPart(self, here, slice(None) if is_whole else rows)

    def divide(self, here: slice, level: float) -> None:
        """Divide rows, and their derivatives, by the level of their noise."""
        if level == 1.0:
            return
        for columns in (self.matrix, self.by_time):
            if columns is not None:
                columns[here] /= level
        for slopes in self.slopes:
            slopes[:, :, here] /= level

    def done(self) -> ColumnBlock:
        """Return the block."""
        modes = tuple(ModeSlopes(by_log_omega.T, by_zeta.T) for by_log_omega, by_zeta in self.slopes)
        return ColumnBlock(self.matrix, self.mode_columns, modes, self.by_time, *self.clock_factors)


@dataclass(frozen=True, eq=False)
class BlockPart:
    """Rows of a block, and those of the grid of stamps that they are filled from."""

    block: BlockRows
    here: slice
    rows: Rows

    def set_clock(self, latency_factor: FloatArray, rate_factor: FloatArray) -> None:
        """Fill the derivatives of the instants by latency and clock rate."""
        for factors, own in zip(self.block.clock_factors, (latency_factor, rate_factor), strict=True):
            factors[self.here] = own[self.rows]

    def set(self, column: int, value: FloatArray | None = None, rate: FloatArray | None = None) -> None:
        """Fill a column that no pole changes, with ones by default, and its derivative by time."""
        block = self.block
        block.matrix[self.here, column] = 1.0 if value is None else value[self.rows]
        if block.by_time is not None and rate is not None:
            block.by_time[self.here, column] = rate[self.rows]

    def set_residues(self, first: int, forced: Sequence[FloatArray]) -> None:
        """Fill the columns of residues.

        Parameters
        ----------
        first : int -- column
        forced : sequence of ndarray, each (n_inputs n_modes, n) -- value[, by log omega, by zeta, by time]
        """
        block, n_modes = self.block, len(self.block.mode_columns)
        for place in range(len(forced[0])):
            block.matrix[self.here, first + place] = forced[0][place][self.rows]
            if block.by_time is not None:
                drive, mode = divmod(place, n_modes)
                for slopes, own in zip(block.slopes[mode], forced[1:3], strict=True):
                    slopes[drive, self.here] = own[place][self.rows]
                block.by_time[self.here, first + place] = forced[3][place][self.rows]

    def set_free_motions(self, first: int, touched: int, free: Sequence[ComplexArray]) -> None:
        """Fill real and imaginary parts of the free motion of every mode.

        Parameters
        ----------
        first : int -- column
        touched : int -- the same among those that a mode touches
        free : sequence of ndarray, each (n_modes, n) -- value[, by log omega, by zeta, by time]
        """
        block = self.block
        for mode in range(len(free[0])):
            pair = first + 2 * mode
            targets = [block.matrix.T[pair:, self.here]]
            if block.by_time is not None:
                slopes = block.slopes[mode][:, touched:, self.here]
                targets += [slopes[0], slopes[1], block.by_time.T[pair:, self.here]]
            for target, own in zip(targets, free, strict=True):
                values = own[mode][self.rows]
                target[0], target[1] = values.real, values.imag
