"""A state-space model without a start: PO-MOESP's poles, and the numerators that fit best under them.

Equation numbers are those of docs/transfer-function-equations.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import block_diag
from scipy.special import fdtrc as f_sf

from beam_ident.arrays import ComplexArray, FloatArray
from beam_ident.data.argument_checks import (
    require_input,
    require_output,
    require_records,
    require_whole_number,
    split_at_gaps,
)
from beam_ident.data.records import TimeRecord
from beam_ident.data.stored_form import read, require_shapes, written
from beam_ident.errors import EstimationError
from beam_ident.noise.record_fit import in_units_of_level, pooled_scores
from beam_ident.noise.relation import is_related
from beam_ident.noise.scores import Scores, Whiteness, is_coloured
from beam_ident.numerics.blas_threads import on_one_thread
from beam_ident.numerics.linear_least_squares import LinearSolution
from beam_ident.numerics.piecewise import Instants
from beam_ident.numerics.rational_response import RationalResponse, upper_roots
from beam_ident.sensing.damage import damage_warnings
from beam_ident.sensing.misfit_causes import misfit_warnings
from beam_ident.sensing.quantisation import clipped_warnings
from beam_ident.subspace.po_moesp import N_BLOCK_ROWS, Stretch, Window, subspace_windows
from beam_ident.summary import SummarisedModes, SummaryPart, modes_table, result_parts
from beam_ident.transfer_function.structure_gates import UNRELATED

SCHEMA = 1
_MAX_ORDER = 40
_INITIAL_MOTION_LEVEL = 0.01  # how often free motion is estimated along where there is none


@dataclass(frozen=True, eq=False, repr=False)
class SubspaceModel(SummarisedModes):
    """What a subspace estimate found.

    Attributes
    ----------
    poles : ndarray, shape (order,) -- of the continuous-time system [rad/s], stable
    denominator : ndarray, shape (order + 1,) -- 1, a_1 .. a_n, descending powers of s
    numerators : ndarray, shape (n_outputs, n_inputs, order + 1)
        Descending powers of s; least squares on exact responses under the inputs' holds.
    singular_values : ndarray -- of the projected outputs; a gap shows the order
    period_s, window_s : float -- sampling of the Hankel matrices, and the time that half of one covers [s]
    scores : tuple of Scores -- of the simulated outputs
    input_names, output_names : tuple of str
    times_s, measured, modelled, residuals : tuple of ndarray
        For every output the samples that were used, in the order of the records; offset and ramp of
        each record are in ``modelled``.
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

    def summary_parts(self) -> list[SummaryPart]:
        """Return the summary's tables and sentences."""
        table = modes_table(*self.modes())
        return [table, *result_parts(self, (), self.output_names)]

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

    def modes(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return natural frequencies [rad/s] and damping ratios; NaN stands for their standard deviations."""
        unknown = np.full(len(self.natural_frequencies), np.nan)
        return self.natural_frequencies, self.damping_ratios, unknown, unknown

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain lists and numbers, from which it is rebuilt exactly (also through JSON)."""
        return written(self, "subspace_model", SCHEMA)

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> SubspaceModel:
        """Rebuild what ``to_dict`` wrote.

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


@on_one_thread
def subspace_model(
    record: TimeRecord | Sequence[TimeRecord],
    order: int,
    window_s: float | None = None,
    n_block_rows: int = N_BLOCK_ROWS,
) -> SubspaceModel:
    """Estimate a model of given order from all inputs to all outputs, with common poles.

    Parameters
    ----------
    record : TimeRecord or sequence of TimeRecord
        One experiment, or several of one system, which count alike.  Outputs whose stamps are irregular
        or differ from output to output are interpolated on a regular grid: good enough to start from,
        not to end on.
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
    records = require_records(record)
    require_whole_number("order", order, 1, _MAX_ORDER)
    if window_s is not None and not (math.isfinite(window_s) and window_s > 0.0):
        raise EstimationError(f"window_s is {window_s}; expected a time > 0, or None for a choice")
    require_whole_number("n_block_rows", n_block_rows, 2)
    records, gaps = split_at_gaps(records, 4 * order)
    stretches = [_stretch(one, records[0]) for one in records]
    # Poles first, one set for every window; then each set is judged by what it leaves of the outputs.
    windows = subspace_windows(stretches, order, window_s, n_block_rows)
    measured = [
        np.concatenate([own.signals[j][1] for own in stretches]) for j in range(len(records[0].outputs))
    ]
    best: tuple[Window, FloatArray, list[FloatArray], bool] | None = None
    best_misfit = math.inf
    for found in windows:
        numerators, residuals, began = _numerators(records, found.poles)
        # The likelihood with a level of its own for every output.
        misfit = sum(
            len(e) * math.log(max(float(e @ e), 1e-300) / float(np.sum((y - y.mean()) ** 2) or 1.0))
            for e, y in zip(residuals, measured, strict=True)
        )
        if best is None or misfit < best_misfit:
            best, best_misfit = (found, numerators, residuals, began), misfit
    if best is None:
        raise EstimationError(
            f"record {records[0].name!r} has {len(stretches[0].signals[0][0])} samples, too few for a subspace of "
            f"order {order} with {len(stretches[0].drives)} inputs and {len(measured)} outputs. Record longer, or "
            "lower the order"
        )
    model = _model(records, stretches, *best)
    damage = [said for one in records for said in clipped_warnings(one.outputs)]
    damage += [said for one in records for said in damage_warnings(one.outputs, one.inputs)]
    return replace(model, warnings=(*gaps, *model.warnings, *damage))


def _model(
    records: Sequence[TimeRecord],
    stretches: Sequence[Stretch],
    found: Window,
    numerators: FloatArray,
    residuals: list[FloatArray],
    began: bool,
) -> SubspaceModel:
    """Collect what a window says, beside what it leaves of every output."""
    first = records[0]
    n_parameters = len(found.poles) + len(first.inputs) * (len(found.poles) + 1) + 2 * len(records)
    times, measured, scores, whiteness = [], [], [], []
    warnings = ["The record began in motion: its free motion was estimated along."] if began else []
    for j, output in enumerate(first.outputs):
        signals = [own.signals[j] for own in stretches]
        times.append(np.concatenate([t for t, _ in signals]))
        measured.append(np.concatenate([y for _, y in signals]))
        parts = np.split(residuals[j], np.cumsum([len(t) for t, _ in signals])[:-1])
        scores.append(pooled_scores([(y, e) for (_, y), e in zip(signals, parts, strict=True)]))
        whiteness.append(Whiteness.of(in_units_of_level(parts)))
        if not is_related(signals, parts, n_parameters, True, True):
            warnings.append(f"Output {output.name}: {UNRELATED}")
        warnings += misfit_warnings(
            [(output.name, [(t, y - e, e) for (t, y), e in zip(signals, parts, strict=True)])]
        )
        if is_coloured(whiteness[-1], measured[-1], residuals[j]):
            warnings.append(
                f"Output {output.name}: the residuals are not white: use the poles as a start, or ask for more."
            )
    return SubspaceModel(
        poles=found.poles,
        denominator=np.real(np.poly(found.poles)),
        numerators=numerators,
        singular_values=found.singular_values,
        period_s=found.period_s,
        window_s=found.window_s,
        scores=tuple(scores),
        input_names=tuple(drive.name for drive in first.inputs),
        output_names=first.output_names,
        times_s=tuple(times),
        measured=tuple(measured),
        modelled=tuple(y - e for e, y in zip(residuals, measured, strict=True)),
        residuals=tuple(residuals),
        whiteness=tuple(whiteness),
        warnings=tuple(warnings),
    )


def _stretch(record: TimeRecord, like: TimeRecord) -> Stretch:
    """Return a record's inputs and usable samples, signals in the order of another record."""
    sources = [record.input(drive.name) for drive in like.inputs]
    for drive in sources:
        require_input(drive)
    first = max(drive.span_s[0] for drive in sources)
    last = min(drive.span_s[1] for drive in sources)
    signals = []
    for name in like.output_names:
        output = record.output(name)
        keep = output.is_valid & (output.times_s >= first) & (output.times_s <= last)
        if np.count_nonzero(keep) < 2:
            raise EstimationError(f"output {output.name!r} has < 2 samples while all inputs are known")
        require_output(output.name, output.values[keep])
        signals.append((output.times_s[keep], output.values[keep]))
    return Stretch([source.signal(margin_s=0.0) for source in sources], signals)


def _numerators(
    records: Sequence[TimeRecord], poles: ComplexArray
) -> tuple[FloatArray, list[FloatArray], bool]:
    """Return the numerators that fit best under given poles, what every output leaves, and whether there was motion.

    Motion that was there at the beginning is estimated where an F test finds some.
    """
    order = len(poles)
    scale = float(np.exp(np.mean(np.log(np.abs(poles)))))
    upper = upper_roots(np.real(np.poly(poles / scale)))
    input_names = [drive.name for drive in records[0].inputs]
    output_names = records[0].output_names
    numerators = np.zeros((len(output_names), len(input_names), order + 1))
    residuals = []
    began = False
    for j, name in enumerate(output_names):
        rows, values, motions = [], [], []
        for number, record in enumerate(records):
            output, drives = record.output(name), [record.input(own) for own in input_names]
            first = max(drive.span_s[0] for drive in drives)
            last = min(drive.span_s[1] for drive in drives)
            keep = output.is_valid & (output.times_s >= first) & (output.times_s <= last)
            times = output.times_s[keep]
            columns = []
            for drive in drives:
                signal = drive.signal(margin_s=output.exposure_s, from_rest=True)
                instants = Instants.on(signal, times, output.exposure_s)
                response = RationalResponse(
                    upper, scale, signal, signal.antiderivative(), instants, squares=False
                )
                # Numerators are linear once the poles are known: the columns are s^i/A u, (T.2), under the
                # inputs' own holds.
                columns += [response.over(power) for power in range(order, -1, -1)]
            # Offset and ramp of every record, zero in the others.
            drifts = [np.zeros_like(times) for _ in range(2 * len(records))]
            drifts[2 * number], drifts[2 * number + 1] = np.ones_like(times), times - times.mean()
            rows.append(np.stack(columns + drifts, axis=1))
            values.append(output.values[keep])
            elapsed = times - times[0] + 0.5 * output.exposure_s
            free = RationalResponse.to_impulse(upper, scale, elapsed, output.exposure_s, False)
            motions.append(free.combined(np.eye(order)))
        matrix, measured = np.concatenate(rows), np.concatenate(values)
        found = LinearSolution.of(matrix).coefficients(measured)
        left = measured - matrix @ found
        whole = np.concatenate([matrix, block_diag(*motions)], axis=1)
        moving = LinearSolution.of(whole).coefficients(measured)
        n_free = len(measured) - whole.shape[1]
        with_motion = measured - whole @ moving
        rest = float(with_motion @ with_motion)
        if n_free > 0 and rest > 0.0:
            ratio = (float(left @ left) - rest) / (whole.shape[1] - matrix.shape[1]) / (rest / n_free)
            if f_sf(whole.shape[1] - matrix.shape[1], n_free, max(ratio, 0.0)) < _INITIAL_MOTION_LEVEL:
                found, left, began = moving[: matrix.shape[1]], with_motion, True
        residuals.append(left)
        units = scale ** np.arange(order + 1)  # in units of the scale, s^p / A carries scale^(n - p)
        numerators[j] = found[: -2 * len(records)].reshape(len(input_names), order + 1) * units
    return numerators, residuals, began
