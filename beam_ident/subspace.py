"""State-space estimation without a start: past-output MOESP, and continuous-time poles from it.

A block Hankel matrix of future outputs, freed of future inputs and correlated with the
past, has the column space of the observability matrix (PO-MOESP; Verhaegen 1994).  One
QR decomposition and one singular value decomposition give its basis, and the
shift of the basis by one sample gives the poles, with no start, no iteration and no
prior knowledge.  Its window must cover 0.2 to 0.5 periods of the slowest mode: with a
given number of block rows, a longer window means averaging and decimating input and
output alike.  The poles are not efficient, but they lie in the basin of the refined
estimators, lightly damped modes under as much noise as signal included.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr, svd

from beam_ident.argument_checks import require_input, require_output, require_record, require_whole_number
from beam_ident.blas_threads import on_one_thread
from beam_ident.errors import EstimationError
from beam_ident.linear_solution import LinearSolution
from beam_ident.piecewise import FloatArray, Instants, PiecewisePolynomial
from beam_ident.pole_response import PoleResponses
from beam_ident.rational_response import RationalResponse, upper_roots
from beam_ident.records import TimeRecord
from beam_ident.stored_form import read, require_shapes, written
from beam_ident.structure_gates import criterion_of_nothing, information_criterion
from beam_ident.validation import Scores, Whiteness

ComplexArray = NDArray[np.complex128]

SCHEMA = 1
N_BLOCK_ROWS = 50

_MAX_ORDER = 40
_MAX_COLUMNS = 8000  # of the Hankel matrices, spread over longer records: a start needs no more
_COLUMNS_PER_ROW = 1.5
_WINDOW_STEP = 4  # between the windows of the portfolio
_N_WINDOWS = 4
_LEAST_DAMPING = 1e-6
_SURPLUS = 4  # poles beyond the order from which the best are chosen
_MAX_STATES = 2_000_000  # of pole responses at once: bounds the memory


@dataclass(frozen=True, eq=False)
class SubspaceModel:
    """What a subspace estimate found.

    Attributes
    ----------
    poles : ndarray, shape (order,) -- of the continuous-time system [rad/s], stable
    denominator : ndarray, shape (order + 1,) -- 1, a_1 .. a_n, descending powers of s
    numerators : ndarray, shape (n_outputs, n_inputs, order + 1)
        Descending powers of s; least squares on exact responses under the inputs' holds.
    singular_values : ndarray -- of the projected outputs; a gap tells the order
    period_s, window_s : float -- sampling of the Hankel matrices, and the time that half of one covers [s]
    scores : tuple of Scores -- of the simulated outputs
    input_names, output_names : tuple of str
    times_s, measured, modelled, residuals : tuple of ndarray
        For every output the samples that were used; offset and ramp are in ``modelled``.
    whiteness : tuple of Whiteness -- of the residuals
    warnings : tuple of str -- what a reader must know before trusting the numbers
    """

    poles: ComplexArray
    denominator: FloatArray
    numerators: FloatArray
    singular_values: FloatArray
    period_s: float
    window_s: float
    scores: tuple[Scores, ...]
    input_names: tuple[str, ...]
    output_names: tuple[str, ...]
    times_s: tuple[FloatArray, ...]
    measured: tuple[FloatArray, ...]
    modelled: tuple[FloatArray, ...]
    residuals: tuple[FloatArray, ...]
    whiteness: tuple[Whiteness, ...]
    warnings: tuple[str, ...]

    @property
    def converged(self) -> bool:
        """True: there is no iteration that could stop short."""
        return True

    @property
    def reason(self) -> str:
        """How the estimation ended."""
        return "decompositions only, no iteration"

    @property
    def iterations(self) -> int:
        """How many iterations were needed: none."""
        return 0

    @property
    def natural_frequencies(self) -> FloatArray:
        """Moduli of the complex pairs [rad/s], in order."""
        return np.asarray(np.sort(np.abs(self.poles[self.poles.imag > 0.0])))

    @property
    def damping_ratios(self) -> FloatArray:
        """Damping ratios of the complex pairs, in order of frequency."""
        pairs = self.poles[self.poles.imag > 0.0]
        pairs = pairs[np.argsort(np.abs(pairs))]
        return np.asarray(-pairs.real / np.abs(pairs))

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain lists and numbers, from which it is rebuilt exactly (also through JSON)."""
        return written(self, "subspace_model", SCHEMA)

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> SubspaceModel:
        """Rebuild what :meth:`to_dict` wrote.

        Raises
        ------
        ModelFormatError
            Another type or schema, a missing entry, or entries that do not agree.
        """
        found = read(SubspaceModel, data, "subspace_model", SCHEMA)
        order, n_outputs, n_inputs = len(found.poles), len(found.output_names), len(found.input_names)
        shapes = {"denominator": (order + 1,), "numerators": (n_outputs, n_inputs, order + 1)}
        require_shapes("subspace model", found, shapes)
        return found


@dataclass(frozen=True, eq=False)
class _Sampled:
    """Inputs and outputs on one regular grid from ``start_s`` on, shapes (n, n_inputs) and (n, n_outputs)."""

    inputs: FloatArray
    outputs: FloatArray
    period_s: float
    start_s: float

    def decimated(self, stride: int) -> _Sampled:
        """Return the means over every ``stride`` samples; the same filter on both sides keeps the poles."""
        if stride == 1:
            return self
        n = len(self.outputs) // stride * stride

        def mean(values: FloatArray) -> FloatArray:
            return np.asarray(values[:n].reshape(-1, stride, values.shape[1]).mean(axis=1))

        return _Sampled(mean(self.inputs), mean(self.outputs), self.period_s * stride, self.start_s)


@dataclass(frozen=True, eq=False)
class _Window:
    """What the Hankel matrices of one window say, or several windows together.

    ``surplus`` are the poles of a higher order, among which modes that noise has displaced may be found.
    """

    poles: ComplexArray
    surplus: ComplexArray
    singular_values: FloatArray
    period_s: float
    window_s: float


@on_one_thread
def subspace_model(
    record: TimeRecord, order: int, window_s: float | None = None, n_block_rows: int = N_BLOCK_ROWS
) -> SubspaceModel:
    """Estimate a model of given order from all inputs to all outputs, with common poles.

    Parameters
    ----------
    record : TimeRecord
        Outputs whose stamps are irregular or differ from output to output are interpolated
        on a regular grid: good enough to start from, not to end on.
    order : int -- number of poles, 1 to 40
    window_s : float or None
        Time that the future half of the Hankel matrices covers [s], 0.2 to 0.5 periods of
        the slowest mode; None tries several and takes the one that simulates best.
    n_block_rows : int -- of each half; fewer are taken for short records

    Raises
    ------
    EstimationError
        An impossible order or window, or too few samples for them.

    Notes
    -----
    M. Verhaegen, Automatica 30 (1994), 61-74.  Constant and ramp are projected out, so that
    offset and drift of an output do no harm.
    """
    require_record(record)
    require_whole_number("order", order, 1, _MAX_ORDER)
    if window_s is not None and not (math.isfinite(window_s) and window_s > 0.0):
        raise EstimationError(f"window_s is {window_s}; expected a time > 0, or None for a choice")
    require_whole_number("n_block_rows", n_block_rows, 2)
    for drive in record.inputs:
        require_input(drive)
    drives = [source.signal(margin_s=0.0) for source in record.inputs]
    first = max(drive.span_s[0] for drive in record.inputs)
    last = min(drive.span_s[1] for drive in record.inputs)
    signals = []
    for output in record.outputs:
        keep = output.is_valid & (output.times_s >= first) & (output.times_s <= last)
        if np.count_nonzero(keep) < 2:
            raise EstimationError(f"output {output.name!r} has no two samples while all inputs are known")
        require_output(output.name, output.values[keep])
        signals.append((output.times_s[keep], output.values[keep]))
    sampled = _on_one_grid(drives, signals)
    windows = [
        found
        for stride in _strides(sampled, order, window_s, n_block_rows)
        if (found := _estimate(sampled.decimated(stride), order, n_block_rows)) is not None
    ]
    if len(windows) > 1:
        windows.append(_combined(drives, sampled, windows, order))
    best: tuple[_Window, FloatArray, list[FloatArray]] | None = None
    best_misfit = math.inf
    for found in windows:
        numerators, residuals = _numerators(record, found.poles)
        misfit = sum(
            len(e) * math.log(max(float(e @ e), 1e-300) / float(np.sum((y - y.mean()) ** 2) or 1.0))
            for e, (_, y) in zip(residuals, signals, strict=True)
        )
        if best is None or misfit < best_misfit:
            best, best_misfit = (found, numerators, residuals), misfit
    if best is None:
        raise EstimationError(
            f"record {record.name!r} has {len(sampled.outputs)} samples, too few for a subspace of order {order} "
            f"with {len(drives)} inputs and {len(signals)} outputs. Record longer, or lower the order"
        )
    return _model(record, signals, *best)


def _model(
    record: TimeRecord,
    signals: list[tuple[FloatArray, FloatArray]],
    found: _Window,
    numerators: FloatArray,
    residuals: list[FloatArray],
) -> SubspaceModel:
    """Collect what a window says, beside what it leaves of every output."""
    n_parameters = len(found.poles) + len(record.inputs) * (len(found.poles) + 1) + 2
    warnings = [
        f"Output {output.name}: the model explains no more than chance would: by BIC none at all is better."
        for output, e, (t, y) in zip(record.outputs, residuals, signals, strict=True)
        if not information_criterion(e, n_parameters) < criterion_of_nothing(t, y, True, True)
    ]
    return SubspaceModel(
        poles=found.poles,
        denominator=np.real(np.poly(found.poles)),
        numerators=numerators,
        singular_values=found.singular_values,
        period_s=found.period_s,
        window_s=found.window_s,
        scores=tuple(Scores.of(y, e) for e, (_, y) in zip(residuals, signals, strict=True)),
        input_names=tuple(drive.name for drive in record.inputs),
        output_names=record.output_names,
        times_s=tuple(t for t, _ in signals),
        measured=tuple(y for _, y in signals),
        modelled=tuple(y - e for e, (_, y) in zip(residuals, signals, strict=True)),
        residuals=tuple(residuals),
        whiteness=tuple(Whiteness.of(e) for e in residuals),
        warnings=tuple(warnings),
    )


def subspace_poles(
    drives: Sequence[PiecewisePolynomial], times_s: FloatArray, values: FloatArray, order: int
) -> list[ComplexArray]:
    """Return sets of poles [rad/s] to start an estimator from, one for every window that the record allows.

    Parameters
    ----------
    drives : sequence of PiecewisePolynomial -- the inputs
    times_s : ndarray, shape (n,) -- stamps inside the span of the inputs [s]
    values : ndarray, shape (n, n_outputs)
    order : int -- number of poles
    """
    sampled = _on_one_grid(drives, [(times_s, column) for column in values.T])
    windows = [
        found
        for stride in _strides(sampled, order, None, N_BLOCK_ROWS)
        if (found := _estimate(sampled.decimated(stride), order, N_BLOCK_ROWS)) is not None
    ]
    if len(windows) > 1:
        windows.append(_combined(drives, sampled, windows, order))
    return [found.poles for found in windows]


def _on_one_grid(
    drives: Sequence[PiecewisePolynomial], signals: Sequence[tuple[FloatArray, FloatArray]]
) -> _Sampled:
    """Return outputs at regular instants, and the inputs' means from each instant to the next."""
    times = signals[0][0]
    period = float(np.median(np.diff(times)))
    start = max(float(t[0]) for t, _ in signals)
    end = min(float(t[-1]) for t, _ in signals)
    grid = start + period * np.arange(max(int((end - start) / period + 1e-6) + 1, 0))
    outputs = np.stack([np.interp(grid, t, y) for t, y in signals], axis=1)
    edges = np.asarray(start + period * np.arange(len(grid) + 1), dtype=np.float64)
    inputs = np.stack([np.diff(drive.antiderivative()(edges)) / period for drive in drives], axis=1)
    return _Sampled(inputs, outputs, period, start)


def _n_rows(sampled: _Sampled, order: int, n_block_rows: int) -> int:
    """Return how many block rows a record can fill, 0 when the order needs more."""
    width = sampled.inputs.shape[1] + sampled.outputs.shape[1]
    most = int(len(sampled.outputs) / (2.0 + 2.0 * width * _COLUMNS_PER_ROW))
    rows = min(n_block_rows, most)
    return rows if (rows - 1) * sampled.outputs.shape[1] >= order else 0


def _strides(sampled: _Sampled, order: int, window_s: float | None, n_block_rows: int) -> list[int]:
    """Return the decimations that are worth a try."""
    if window_s is not None:
        return [max(1, round(window_s / (n_block_rows * sampled.period_s)))]
    strides = [_WINDOW_STEP**k for k in range(_N_WINDOWS)]
    return [
        s for s in strides if s == 1 or _n_rows(sampled.decimated(s), order, n_block_rows) == n_block_rows
    ]


def _estimate(sampled: _Sampled, order: int, n_block_rows: int) -> _Window | None:
    """Return what one window says, None where the record is too short for the order."""
    rows = _n_rows(sampled, order, n_block_rows)
    if rows == 0:
        return None
    n_columns = len(sampled.outputs) - 2 * rows + 1
    at = np.arange(0, n_columns, max(1, n_columns // _MAX_COLUMNS))
    n_inputs, n_outputs = sampled.inputs.shape[1], sampled.outputs.shape[1]
    # A constant and a ramp in the outputs are two more rows that only the future shares.
    ramp = at / max(n_columns, 1) - 0.5
    inputs = sampled.inputs / np.maximum(np.std(sampled.inputs, axis=0), 1e-300)
    outputs = sampled.outputs / np.maximum(np.std(sampled.outputs, axis=0), 1e-300)
    stacked = np.concatenate(
        [
            np.ones((1, len(at))),
            ramp[None],
            _hankel(inputs, rows, at + rows),
            _hankel(inputs, rows, at),
            _hankel(outputs, rows, at),
            _hankel(outputs, rows, at + rows),
        ]
    )
    triangle = qr(stacked.T, mode="r", check_finite=False)[0]
    n_future_inputs = 2 + rows * n_inputs
    n_past = rows * (n_inputs + n_outputs)
    projected = triangle[n_future_inputs : n_future_inputs + n_past, n_future_inputs + n_past :].T
    left, values, _ = svd(projected, full_matrices=False, check_finite=False)

    def poles(n: int) -> ComplexArray:
        observability = left[:, :n] * np.sqrt(values[:n])
        shift = np.linalg.lstsq(observability[:-n_outputs], observability[n_outputs:], rcond=None)[0]
        return _continuous(np.linalg.eigvals(shift), sampled.period_s)

    more = min(order + _SURPLUS, (rows - 1) * n_outputs, len(values))
    return _Window(poles(order), poles(more), values, sampled.period_s, rows * sampled.period_s)


def _combined(
    drives: Sequence[PiecewisePolynomial], sampled: _Sampled, windows: Sequence[_Window], order: int
) -> _Window:
    """Return those poles of several windows that explain the outputs best together.

    Every window sees the modes of its own range of frequencies.  The poles are taken one by one
    (a pair counts as two), each time the one whose exact response lowers the misfit most (orthogonal
    matching pursuit; Pati, Rezaiifar and Krishnaprasad 1993).
    """
    pool = np.concatenate([poles for found in windows for poles in (found.poles, found.surplus)])
    pool = pool[pool.imag >= 0.0]
    at = np.arange(0, len(sampled.outputs), max(1, len(sampled.outputs) // _MAX_COLUMNS))
    times = np.asarray(sampled.start_s + sampled.period_s * at, dtype=np.float64)
    columns = np.concatenate([_pole_columns(drive, times, pool) for drive in drives], axis=1)
    outputs = sampled.outputs[at] / np.maximum(np.std(sampled.outputs, axis=0), 1e-300)
    drift = np.stack([np.ones_like(times), np.linspace(-0.5, 0.5, len(times))], axis=1)
    columns = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    # All that follows happens inside the span of these columns: on the triangle of their QR.
    triangle = qr(np.concatenate([drift, columns, outputs], axis=1), mode="r", check_finite=False)[0]
    triangle = triangle[: 2 + columns.shape[1] + outputs.shape[1]]
    parts = triangle[:, 2 : 2 + columns.shape[1]].reshape(len(triangle), len(drives), len(pool), 2)
    basis = np.eye(len(triangle), 2)
    residuals = triangle[:, 2 + columns.shape[1] :]
    residuals = residuals - basis @ (basis.T @ residuals)
    chosen: list[complex] = []
    left = set(range(len(pool)))
    while left:
        best, best_gain, best_basis = -1, 0.0, basis
        for k in left:
            block = parts[:, :, k, : 1 + int(pool[k].imag > 0.0)].reshape(len(triangle), -1)
            own = LinearSolution.of(block - basis @ (basis.T @ block)).basis
            gain = float(np.sum((own.T @ residuals) ** 2))
            if best < 0 or gain > best_gain:
                best, best_gain, best_basis = k, gain, own
        basis = np.concatenate([basis, best_basis], axis=1)
        residuals = residuals - best_basis @ (best_basis.T @ residuals)
        pole = complex(pool[best])
        chosen += [pole, pole.conjugate()] if pole.imag > 0.0 else [pole]
        room = order - len(chosen)
        left = {k for k in left - {best} if (2 if pool[k].imag > 0.0 else 1) <= room}
    if len(chosen) < order:  # no real pole is left for an odd order
        slowest = float(np.min(np.abs(pool)))
        chosen += [-slowest] * (order - len(chosen))
    first = windows[0]
    return _Window(np.array(chosen), pool, first.singular_values, first.period_s, first.window_s)


def _pole_columns(drive: PiecewisePolynomial, times: FloatArray, poles: ComplexArray) -> FloatArray:
    """Return real and imaginary parts of every pole's response, shape (n_times, 2 n_poles)."""
    instants = Instants.on(drive, times, 0.0)
    n_at_once = max(1, _MAX_STATES // len(drive.knots))
    responses = [
        PoleResponses(poles[k : k + n_at_once], drive, gradients=False).sample(instants, drive).values
        for k in range(0, len(poles), n_at_once)
    ]
    values = np.concatenate(responses)
    return np.asarray(np.stack([values.real, values.imag], axis=2).transpose(1, 0, 2).reshape(len(times), -1))


def _hankel(values: FloatArray, rows: int, at: NDArray[np.intp]) -> FloatArray:
    """Return the blocks values[at], values[at + 1] .. as rows."""
    return np.concatenate([values[at + i].T for i in range(rows)])


def _continuous(discrete: NDArray[np.generic], period_s: float) -> ComplexArray:
    """Return continuous-time poles, the unstable ones mirrored, as a set closed under conjugation.

    A negative real pole has no continuous counterpart of its own order; its real decay stands for it.
    """
    complex_ones = np.asarray(discrete, dtype=np.complex128)
    upper = complex_ones[complex_ones.imag > 0.0]
    real = complex_ones[complex_ones.imag == 0.0]
    poles = np.concatenate(
        [
            np.log(upper),
            np.conj(np.log(upper)),
            np.log(np.maximum(np.abs(real), 1e-12)).astype(np.complex128),
        ]
    )
    poles = poles / period_s
    least = _LEAST_DAMPING * np.maximum(np.abs(poles), 1e-9 / period_s)
    return np.asarray(-np.maximum(np.abs(poles.real), least) + 1j * poles.imag)


def _numerators(record: TimeRecord, poles: ComplexArray) -> tuple[FloatArray, list[FloatArray]]:
    """Return the numerators that fit best under given poles, and the residuals of every output."""
    order = len(poles)
    scale = float(np.exp(np.mean(np.log(np.abs(poles)))))
    upper = upper_roots(np.real(np.poly(poles / scale)))
    first = max(drive.span_s[0] for drive in record.inputs)
    last = min(drive.span_s[1] for drive in record.inputs)
    numerators = np.zeros((len(record.outputs), len(record.inputs), order + 1))
    residuals = []
    for j, output in enumerate(record.outputs):
        keep = output.is_valid & (output.times_s >= first) & (output.times_s <= last)
        times = output.times_s[keep]
        columns = []
        for drive in record.inputs:
            signal = drive.signal(margin_s=output.exposure_s, from_rest=True)
            instants = Instants.on(signal, times, output.exposure_s)
            response = RationalResponse(
                upper, scale, signal, signal.antiderivative(), instants, squares=False
            )
            columns += [response.over(power) for power in range(order, -1, -1)]
        columns += [np.ones_like(times), times - times.mean()]
        matrix = np.stack(columns, axis=1)
        found = LinearSolution.of(matrix).coefficients(output.values[keep])
        residuals.append(output.values[keep] - matrix @ found)
        units = scale ** np.arange(order + 1)  # in units of the scale, s^p / A carries scale^(n - p)
        numerators[j] = found[:-2].reshape(len(record.inputs), order + 1) * units
    return numerators, residuals
