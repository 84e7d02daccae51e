"""State-space estimation without a start: past-output MOESP, and continuous-time poles from it.

A block Hankel matrix of future outputs, freed of future inputs and correlated with the
past, has the column space of the observability matrix (PO-MOESP; Verhaegen 1994).  One
QR decomposition and one singular value decomposition give its basis, and the
shift of the basis by one sample gives the poles, with no start, no iteration and no
prior knowledge.  Its window must cover 0.2 to 0.5 periods of the slowest mode: with a
given number of block rows, a longer window means averaging and decimating input and
output alike.  The poles are not efficient, but they lie in the basin of the refined
estimators, lightly damped modes under as much noise as signal included.

Equation numbers are those of docs/transfer-function-equations.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import qr, svd

from beam_ident.arrays import AnyArray, ComplexArray, FloatArray
from beam_ident.numerics.linear_least_squares import LinearSolution, triangle_of_rows
from beam_ident.numerics.piecewise import Instants, PiecewisePolynomial
from beam_ident.numerics.pole_response import PoleResponses

N_BLOCK_ROWS = 50

_MAX_COLUMNS = 8000  # of the Hankel matrices, spread over longer records: a start needs no more
_COLUMNS_PER_ROW = 1.5
_WINDOW_STEP = 4  # between the windows of the portfolio
_N_WINDOWS = 4
_MIN_DAMPING = 1e-6
_SURPLUS = 4  # poles beyond the order from which the best are chosen
_MAX_STATES = 2_000_000  # of pole responses at once: bounds the memory


@dataclass(frozen=True, eq=False)
class Stretch:
    """What one record shows of a system.

    Attributes
    ----------
    drives : sequence of PiecewisePolynomial -- the inputs
    signals : sequence of (times, values) -- of every output, stamps inside the span of the inputs [s]
    level : float -- of the noise, in proportion to that of other records
    """

    drives: Sequence[PiecewisePolynomial]
    signals: Sequence[tuple[FloatArray, FloatArray]]
    level: float = 1.0


@dataclass(frozen=True, eq=False)
class _Sampled:
    """One record on a regular grid from ``start_s`` on, inputs (n, n_inputs) and outputs (n, n_outputs)."""

    inputs: FloatArray
    outputs: FloatArray
    period_s: float
    start_s: float
    level: float

    def decimated(self, stride: int) -> _Sampled:
        """Return the means over every ``stride`` samples; the same filter on both sides keeps the poles."""
        if stride == 1:
            return self
        n = len(self.outputs) // stride * stride

        def mean(values: FloatArray) -> FloatArray:
            return np.asarray(values[:n].reshape(-1, stride, values.shape[1]).mean(axis=1))

        return _Sampled(
            mean(self.inputs), mean(self.outputs), self.period_s * stride, self.start_s, self.level
        )


@dataclass(frozen=True, eq=False)
class Window:
    """What the Hankel matrices of one window say, or several windows together.

    ``surplus`` are the poles of a higher order, among which modes that noise has displaced may be found.
    """

    poles: ComplexArray
    surplus: ComplexArray
    singular_values: FloatArray
    period_s: float
    window_s: float


def subspace_poles(stretches: Sequence[Stretch], order: int) -> list[ComplexArray]:
    """Return sets of poles [rad/s] to start an estimator from, one for every window that the records allow.

    Parameters
    ----------
    stretches : sequence of Stretch -- one for every record
    order : int -- number of poles
    """
    return [found.poles for found in subspace_windows(stretches, order, None, N_BLOCK_ROWS)]


def subspace_windows(
    stretches: Sequence[Stretch], order: int, window_s: float | None, n_block_rows: int
) -> list[Window]:
    """Return what every window says that the records allow, and what several say together."""
    times = stretches[0].signals[0][0]
    period = float(np.median(np.diff(times)))
    sampled = [_on_one_grid(stretch, period) for stretch in stretches]
    windows = [
        found
        for stride in _strides(sampled, order, window_s, n_block_rows)
        if (found := _estimate([own.decimated(stride) for own in sampled], order, n_block_rows)) is not None
    ]
    if len(windows) > 1:
        windows.append(_combined(stretches, sampled, windows, order))
    return windows


def _on_one_grid(stretch: Stretch, period: float) -> _Sampled:
    """Return outputs at regular instants, and the inputs' means from each instant to the next."""
    drives, signals = stretch.drives, stretch.signals
    start = max(float(t[0]) for t, _ in signals)
    end = min(float(t[-1]) for t, _ in signals)
    grid = start + period * np.arange(max(int((end - start) / period + 1e-6) + 1, 0))
    outputs = np.stack([np.interp(grid, t, y) for t, y in signals], axis=1)
    edges = np.asarray(start + period * np.arange(len(grid) + 1), dtype=np.float64)
    inputs = np.stack([np.diff(drive.antiderivative()(edges)) / period for drive in drives], axis=1)
    return _Sampled(inputs, outputs, period, start, stretch.level)


def _n_rows(lengths: Sequence[int], width: int, n_outputs: int, order: int, n_block_rows: int) -> int:
    """Return how many block rows records of given lengths can fill, 0 when the order needs more."""
    rows = n_block_rows
    while rows and sum(max(n - 2 * rows, 0) for n in lengths) < 2.0 * width * _COLUMNS_PER_ROW * rows:
        rows -= 1
    return rows if (rows - 1) * n_outputs >= order else 0


def _strides(sampled: Sequence[_Sampled], order: int, window_s: float | None, n_block_rows: int) -> list[int]:
    """Return the decimations that are worth a try."""
    first = sampled[0]
    if window_s is not None:
        return [max(1, round(window_s / (n_block_rows * first.period_s)))]
    n_outputs = first.outputs.shape[1]
    width = first.inputs.shape[1] + n_outputs
    lengths = [len(own.outputs) for own in sampled]
    strides = [_WINDOW_STEP**k for k in range(_N_WINDOWS)]
    return [
        s
        for s in strides
        if s == 1 or _n_rows([n // s for n in lengths], width, n_outputs, order, n_block_rows) == n_block_rows
    ]


def _estimate(sampled: Sequence[_Sampled], order: int, n_block_rows: int) -> Window | None:
    """Return what one window says, None where the records are too short for the order."""
    first = sampled[0]
    n_inputs, n_outputs = first.inputs.shape[1], first.outputs.shape[1]
    lengths = [len(own.outputs) for own in sampled]
    rows = _n_rows(lengths, n_inputs + n_outputs, n_outputs, order, n_block_rows)
    if rows == 0:
        return None
    sampled = [own for own in sampled if len(own.outputs) >= 2 * rows]
    n_columns = sum(len(own.outputs) - 2 * rows + 1 for own in sampled)
    step = max(1, n_columns // _MAX_COLUMNS)
    input_sizes = np.maximum(_spread([own.inputs for own in sampled]), 1e-300)
    output_sizes = np.maximum(_spread([own.outputs for own in sampled]), 1e-300)
    counts = [-(-(len(own.outputs) - 2 * rows + 1) // step) for own in sampled]
    n_drifts = 2 * len(sampled)
    stacked = np.zeros((n_drifts + 2 * rows * (n_inputs + n_outputs), sum(counts)))
    first_column = 0
    for record, (own, count) in enumerate(zip(sampled, counts, strict=True)):
        here = slice(first_column, first_column + count)
        first_column = here.stop
        # A constant and a ramp in the outputs of a record are two more rows that only the future shares.
        n_own = len(own.outputs) - 2 * rows + 1
        stacked[2 * record, here] = 1.0 / own.level
        stacked[2 * record + 1, here] = (step * np.arange(count) / max(n_own, 1) - 0.5) / own.level
        # The rows in the order of (T.16): what is projected away, the past as instruments, the future outputs; every
        # column of a record weighs by that record's noise.
        inputs, outputs = own.inputs / (input_sizes * own.level), own.outputs / (output_sizes * own.level)
        row = n_drifts
        for values, begin in ((inputs, rows), (inputs, 0), (outputs, 0), (outputs, rows)):
            for k in range(begin, begin + rows):
                seen = values[k : k + step * (count - 1) + 1 : step].T
                stacked[row : row + len(seen), here] = seen
                row += len(seen)
    # The data's LQ factorisation; only L is needed, and its size does not grow with the record.
    triangle = triangle_of_rows(stacked)
    n_future_inputs = 2 * len(sampled) + rows * n_inputs
    n_past = rows * (n_inputs + n_outputs)
    # L_32 of (T.16): rows of the future outputs, columns of the past.
    projected = triangle[n_future_inputs : n_future_inputs + n_past, n_future_inputs + n_past :].T
    left, values, _ = svd(projected, full_matrices=False, check_finite=False)

    def poles(n: int) -> ComplexArray:
        # Gamma = U_n S_n^(1/2), and its shift by one block row.
        observability = left[:, :n] * np.sqrt(values[:n])
        shift = np.linalg.lstsq(observability[:-n_outputs], observability[n_outputs:], rcond=None)[0]
        return _continuous(np.linalg.eigvals(shift), first.period_s)

    # A few poles more: noise may have pushed a light mode out of the first n singular values.
    more = min(order + _SURPLUS, (rows - 1) * n_outputs, len(values))
    return Window(poles(order), poles(more), values, first.period_s, rows * first.period_s)


def _spread(parts: Sequence[FloatArray]) -> FloatArray:
    """Return the standard deviation of every column within records, over all of them."""
    squares = np.sum([len(part) * np.var(part, axis=0) for part in parts], axis=0)
    return np.asarray(np.sqrt(squares / sum(len(part) for part in parts)))


def _combined(
    stretches: Sequence[Stretch], sampled: Sequence[_Sampled], windows: Sequence[Window], order: int
) -> Window:
    """Return those poles of several windows that explain the outputs best together.

    Every window sees the modes of its own range of frequencies.  The poles are taken one by one
    (a pair counts as two), each time the one whose exact response lowers the misfit most (orthogonal
    matching pursuit; Pati, Rezaiifar and Krishnaprasad 1993).
    """
    pool = np.concatenate([poles for found in windows for poles in (found.poles, found.surplus)])
    pool = pool[pool.imag >= 0.0]
    step = max(1, sum(len(own.outputs) for own in sampled) // _MAX_COLUMNS)
    sizes = np.maximum(_spread([own.outputs for own in sampled]), 1e-300)
    n_inputs, n_drifts = len(stretches[0].drives), 2 * len(sampled)
    rows = []
    for record, (stretch, own) in enumerate(zip(stretches, sampled, strict=True)):
        at = np.arange(0, len(own.outputs), step)
        times = np.asarray(own.start_s + own.period_s * at, dtype=np.float64)
        drift = np.zeros((len(at), n_drifts))
        drift[:, 2 * record] = 1.0
        drift[:, 2 * record + 1] = np.linspace(-0.5, 0.5, len(times))
        # The exact responses of every candidate pole to every input, their real and imaginary parts.
        responses = [_pole_columns(drive, times, pool) for drive in stretch.drives]
        row = np.concatenate([drift, *responses, own.outputs[at] / sizes], axis=1)
        row /= own.level
        rows.append(row)
    everything = rows[0] if len(rows) == 1 else np.concatenate(rows)
    n_outputs = sampled[0].outputs.shape[1]
    columns = everything[:, n_drifts:-n_outputs]
    columns /= np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    # All that follows happens inside the span of these columns: on the triangle of their QR.
    triangle = qr(everything, mode="r", check_finite=False)[0]
    n_columns = n_drifts + columns.shape[1]
    triangle = triangle[: n_columns + n_outputs]
    parts = triangle[:, n_drifts:n_columns].reshape(len(triangle), n_inputs, len(pool), 2)
    basis = np.eye(len(triangle), n_drifts)
    residuals = triangle[:, n_columns:]
    residuals = residuals - basis @ (basis.T @ residuals)
    chosen: list[complex] = []
    left = {k for k in range(len(pool)) if order > 1 or pool[k].imag == 0.0}
    while left:
        best, best_gain, best_basis = -1, 0.0, basis
        for k in left:
            block = parts[:, :, k, : 1 + int(pool[k].imag > 0.0)].reshape(len(triangle), -1)
            # What the candidate adds to the span of those chosen, and how much of the outputs it explains
            # there.
            added = LinearSolution.of(block - basis @ (basis.T @ block)).basis
            gain = float(np.sum((added.T @ residuals) ** 2))
            if best < 0 or gain > best_gain:
                best, best_gain, best_basis = k, gain, added
        basis = np.concatenate([basis, best_basis], axis=1)
        residuals = residuals - best_basis @ (best_basis.T @ residuals)
        pole = complex(pool[best])
        chosen += [pole, pole.conjugate()] if pole.imag > 0.0 else [pole]
        # A pair needs room for two.
        room = order - len(chosen)
        left = {k for k in left - {best} if (2 if pool[k].imag > 0.0 else 1) <= room}
    if len(chosen) < order:  # no real pole is left for an odd order
        slowest = float(np.min(np.abs(pool)))
        chosen += [-slowest] * (order - len(chosen))
    first = windows[0]
    return Window(np.array(chosen), pool, first.singular_values, first.period_s, first.window_s)


def _pole_columns(drive: PiecewisePolynomial, times: FloatArray, poles: ComplexArray) -> FloatArray:
    """Return real and imaginary parts of every pole's response, shape (n_times, 2 n_poles)."""
    instants = Instants.on(drive, times, 0.0)
    n_at_once = max(1, _MAX_STATES // len(drive.knots))
    responses = [
        PoleResponses(poles[k : k + n_at_once], drive, gradients=False).sample(instants).values
        for k in range(0, len(poles), n_at_once)
    ]
    values = np.concatenate(responses)
    return np.asarray(np.stack([values.real, values.imag], axis=2).transpose(1, 0, 2).reshape(len(times), -1))


def _continuous(discrete: AnyArray, period_s: float) -> ComplexArray:
    """Return continuous-time poles, the unstable ones mirrored, as a set closed under conjugation.

    A negative real pole has no continuous counterpart of its own order; its real decay stands for it.
    """
    complex_ones = np.asarray(discrete, dtype=np.complex128)
    upper = complex_ones[complex_ones.imag > 0.0]
    real = complex_ones[complex_ones.imag == 0.0]
    poles = np.concatenate(
        [
            # p = log(z) / period of (T.16); complex eigenvalues come in pairs, so that one of each is enough.
            np.log(upper),
            np.conj(np.log(upper)),
            np.log(np.maximum(np.abs(real), 1e-12)).astype(np.complex128),
        ]
    )
    poles = poles / period_s
    least = _MIN_DAMPING * np.maximum(np.abs(poles), 1e-9 / period_s)
    return np.asarray(-np.maximum(np.abs(poles.real), least) + 1j * poles.imag)
