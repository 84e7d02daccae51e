"""A model against records that it was not estimated from.

Poles, residues, gains and clock stay as they are.  What belongs to the record and
not to the model (offset, ramp, the motion that was already there at its beginning, a clock that jumps)
is fitted to it, because it would otherwise be charged to the model.  How the model
does from rest, without a fitted motion, is said beside it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri as chi_squared_isf

from beam_ident.arrays import FloatArray
from beam_ident.data.argument_checks import require_input, require_output, require_records, split_at_gaps
from beam_ident.data.own_clocks import on_common_clock, with_low_passes
from beam_ident.data.records import TimeRecord
from beam_ident.data.stamp_jumps import ClockJump, possible_jumps, without_jumps
from beam_ident.errors import EstimationError
from beam_ident.modal.model import ModalModel
from beam_ident.modal.regression import ModalRegression
from beam_ident.modal.structure import ModalStructure
from beam_ident.noise.record_fit import in_units_of_level, pooled_scores
from beam_ident.noise.scores import InputCorrelation, Scores, Whiteness
from beam_ident.numerics.blas_threads import on_one_thread
from beam_ident.numerics.linear_least_squares import LinearSolution
from beam_ident.summary import Summarised, SummaryPart, SummaryTable
from beam_ident.transfer_function.model import TransferFunctionModel
from beam_ident.transfer_function.multi_input_model import MultiInputModel

_FAIR_FIT = 80.0
_MIN_SAMPLES = 20
_GOOD_FIT = 95.0
_JUMP_LEVEL = 1e-3  # how often a steady clock is taken to jump
_NO_MORE_THAN_NOISE = 1.2  # residuals over those of the estimation


@dataclass(frozen=True, eq=False)
class OutputValidation:
    """How a model predicts one output of another record.

    Attributes
    ----------
    name, unit : str
    times_s, measured, simulated, residuals : ndarray, shape (n_used,)
    simulated_from_rest : ndarray, shape (n_used,) -- the plain simulation, offset and ramp alone fitted
    scores : Scores -- on the output
    deflection_scores : Scores
        On the output less its direct part, offset and ramp: the sterner test where an
        output is mostly its input. The direct part of a transfer function between signals of one unit is what the
        input explains at once.
    simulation_scores : Scores
        On the output, of the plain simulation: from rest, with no motion fitted to the record.
    noise_ratio : float
        Residual standard deviation over that of the estimation: near 1 for a good model; NaN where the
        model states no noise.
    whiteness : Whiteness
    input_correlation : InputCorrelation
    verdict : str
    """

    name: str
    unit: str
    times_s: FloatArray
    measured: FloatArray
    simulated: FloatArray
    residuals: FloatArray
    simulated_from_rest: FloatArray
    scores: Scores
    deflection_scores: Scores
    simulation_scores: Scores
    noise_ratio: float
    whiteness: Whiteness
    input_correlation: InputCorrelation
    verdict: str


@dataclass(frozen=True, eq=False, repr=False)
class ValidationResult(Summarised):
    """A model against other records, output by output.

    Attributes
    ----------
    outputs : tuple of OutputValidation -- over all records, in their order; scores about each one's mean
    records : tuple of ValidationResult -- of every record by itself, where there are several
    clock_jumps : tuple of ClockJump -- steps of clocks that were taken out of the stamps, of a modal model's records
    """

    outputs: tuple[OutputValidation, ...]
    records: tuple[ValidationResult, ...] = ()
    clock_jumps: tuple[ClockJump, ...] = ()

    def summary_parts(self) -> list[SummaryPart]:
        """Return the summary's tables and sentences."""
        rows = (
            (
                own.name,
                f"{own.scores.fit_percent:.3f}",
                f"{own.simulation_scores.fit_percent:.3f}",
                own.verdict,
            )
            for own in self.outputs
        )
        return [SummaryTable(("output", "FIT [%]", "from rest [%]", "verdict"), tuple(rows))]

    def output(self, name: str) -> OutputValidation:
        """Return the validation of one output by its name."""
        for output in self.outputs:
            if output.name == name:
                return output
        raise EstimationError(
            f"no output {name!r} here; available: {', '.join(o.name for o in self.outputs)}"
        )


@on_one_thread
def validate(
    model: ModalModel | TransferFunctionModel | MultiInputModel, record: TimeRecord | Sequence[TimeRecord]
) -> ValidationResult:
    """Predict a record, or several, with a model that was estimated from others.

    Parameters
    ----------
    model : ModalModel, TransferFunctionModel or MultiInputModel
    record : TimeRecord or sequence of TimeRecord
        With the model's inputs and at least one of its outputs under their names.

    Raises
    ------
    EstimationError
        The record lacks an input or every output of the model, has too few samples, or an output
        that is constant; records whose signals differ in name or unit.
    """
    records = require_records(record, may_lack_outputs=True, takes_low_passes=isinstance(model, ModalModel))
    if not isinstance(model, ModalModel | TransferFunctionModel | MultiInputModel):
        raise EstimationError(
            f"model is a {type(model).__name__}; expected a ModalModel, a TransferFunctionModel or a MultiInputModel "
            "(.model of a result)"
        )
    if not isinstance(model, ModalModel):  # whose prediction steps over gaps by itself
        records, _ = split_at_gaps(records, _MIN_SAMPLES)
    found = [_steady(model, one, number) for number, one in enumerate(records)]
    predicted = [_predict(model, one) for one, _ in found]
    each = tuple(
        ValidationResult(tuple(_judged([part], jumps) for part in parts), (), jumps)
        for parts, (_, jumps) in zip(predicted, found, strict=True)
    )
    if len(each) == 1:
        return each[0]
    all_jumps = tuple(jump for _, jumps in found for jump in jumps)
    names = dict.fromkeys(part.name for parts in predicted for part in parts)
    together = [[part for parts in predicted for part in parts if part.name == name] for name in names]
    return ValidationResult(tuple(_judged(parts, all_jumps) for parts in together), each, all_jumps)


@dataclass(frozen=True, eq=False)
class _Prediction:
    """One output of one record beside what the model makes of it."""

    name: str
    unit: str
    times_s: FloatArray
    measured: FloatArray
    residuals: FloatArray
    plain_residuals: FloatArray
    deflection: FloatArray
    noise_sd: float
    drive: FloatArray


def _steady(
    model: ModalModel | TransferFunctionModel | MultiInputModel, record: TimeRecord, number: int
) -> tuple[TimeRecord, tuple[ClockJump, ...]]:
    """Return a record whose stamps do not jump, and the jumps that the model tells from lost samples.

    Notes
    -----
    A likelihood-ratio test over all places and sizes, with everything that belongs to the model held.
    """
    if not isinstance(model, ModalModel):
        return record, ()
    # Of several inputs one that is late moves a share of the outputs only.
    inputs = [drive.name for drive in record.inputs if model.input_names == (drive.name,)]
    places = possible_jumps(record, number, inputs)
    known: tuple[ClockJump, ...] = ()
    while places:
        tried = [known, *((*known, jump) for place in places for jump in place)]
        costs = np.array([_cost(model, without_jumps(record, number, jumps)) for jumps in tried])
        best = int(np.argmin(costs))
        if not 2.0 * (costs[0] - costs[best]) > chi_squared_isf(1, _JUMP_LEVEL / len(tried)):
            break
        known = tried[best]
        places = [place for place in places if known[-1] not in place]
    return without_jumps(record, number, known), known


def _cost(model: ModalModel, record: TimeRecord) -> float:
    """Return the negative log-likelihood of a record under a model, the level of its noise unknown."""
    cost = 0.0
    for part in _predict(model, record):
        # A few stamps more or fewer may be within the input's span.
        power = max(float(np.mean(np.square(part.residuals))), 1e-300)
        cost += 0.5 * len(record.output(part.name).times_s) * math.log(power)
    return cost


def _predict(
    model: ModalModel | TransferFunctionModel | MultiInputModel, record: TimeRecord
) -> list[_Prediction]:
    """Predict one record, output by output."""
    names = model.output_names if isinstance(model, ModalModel) else (model.output_name,)
    present = [name for name in names if name in record.output_names]
    inputs = (model.input_name,) if isinstance(model, TransferFunctionModel) else model.input_names
    if not present or not set(inputs) <= {drive.name for drive in record.inputs}:
        raise EstimationError(
            f"record {record.name!r} has the input(s) {', '.join(d.name for d in record.inputs)} and the "
            f"outputs {', '.join(record.output_names)}; the model goes from {', '.join(inputs)} to "
            f"{', '.join(names)}"
        )
    for name in inputs:
        require_input(record.input(name), is_needed=False)
    part = record.select(present)
    if isinstance(model, ModalModel):
        return _predict_modal(model, part)
    return [_predict_rational(model, part)]


def _predict_modal(model: ModalModel, record: TimeRecord) -> list[_Prediction]:
    structure = ModalStructure(model.structure)
    common = with_low_passes([on_common_clock(record, model.own_clocks)], model.low_passes)
    regression = ModalRegression(common, structure, model.input_names)
    blocks = regression.blocks(model.natural_frequencies, model.damping_ratios, model.clock, gradients=False)
    n_shared, parameters = regression.n_shared(model.n_modes), model.column_parameters()
    drive = record.input(model.input_name)
    signal = drive.signal()
    results = []
    for j, name in enumerate(regression.output_names):
        matrix = blocks[regression.block_of[j]].matrix
        row = model.output_names.index(name)
        values = regression.values[j]
        remainder = values - matrix[:, :n_shared] @ parameters[row]
        own = matrix[:, n_shared:]
        found = LinearSolution.of(own).coefficients(remainder)
        residuals = remainder - own @ found
        drifts = own[:, :2]
        plain_residuals = remainder - drifts @ LinearSolution.of(drifts).coefficients(remainder)
        rigid = drifts @ found[:2]
        if structure.has_direct:
            direct = slice(0, regression.n_shared_fixed, regression.n_fixed_of_input)
            rigid = rigid + matrix[:, direct] @ parameters[row, direct]
        output = record.output(name)
        results.append(
            _Prediction(
                name,
                output.unit,
                regression.times[j],
                values,
                residuals,
                plain_residuals,
                values - rigid,
                float(model.noise_sd[row]),
                signal(regression.times[j]),
            )
        )
    return results


def _predict_rational(model: TransferFunctionModel | MultiInputModel, record: TimeRecord) -> _Prediction:
    output = record.output(model.output_name)
    prediction = model.prediction(record)
    seen = np.isfinite(prediction.measured)
    times, values = prediction.times_s[seen], prediction.measured[seen]
    first = model.input_names[0] if isinstance(model, MultiInputModel) else model.input_name
    drive = record.input(first).signal()(times)
    deflection = values - prediction.offset
    if record.input(first).unit == output.unit:
        # As of a modal model: what a moved base carries along is no achievement of the dynamics.
        about = drive - np.mean(drive)
        deflection = deflection - about * float(about @ deflection) / max(float(about @ about), 1e-300)
    return _Prediction(
        output.name,
        output.unit,
        times,
        values,
        values - prediction.predicted[seen],
        values - prediction.simulated[seen],
        deflection,
        model.noise_sd,
        drive,
    )


def _judged(parts: Sequence[_Prediction], jumps: Sequence[ClockJump]) -> OutputValidation:
    """Return how well one output is predicted, over one record or several."""
    first = parts[0]
    for part in parts:
        require_output(part.name, part.measured)
        if len(part.measured) < _MIN_SAMPLES:
            raise EstimationError(
                f"output {part.name!r} has {len(part.measured)} samples that were seen while the input was known; "
                f"expected at least {_MIN_SAMPLES} to validate with"
            )
    scores = pooled_scores([(part.measured, part.residuals) for part in parts])
    of_deflection = pooled_scores([(part.deflection, part.residuals) for part in parts])
    simulation = pooled_scores([(part.measured, part.plain_residuals) for part in parts])
    noise = in_units_of_level([part.residuals for part in parts])
    drives = [part.drive for part in parts]
    if len(parts) > 1:
        drives = [drive - np.mean(drive) for drive in drives]
    correlation = InputCorrelation.of(noise, np.concatenate(drives))
    times, measured, residuals, plain_residuals = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("times_s", "measured", "residuals", "plain_residuals")
    )
    ratio = float(np.std(residuals)) / first.noise_sd if first.noise_sd > 0.0 else math.nan
    against = "" if math.isnan(ratio) else f", residuals {ratio:.2f} times those of the estimation"
    fit = of_deflection.fit_percent
    if fit >= _GOOD_FIT:
        word = "good"
    elif ratio <= _NO_MORE_THAN_NOISE and correlation.is_independent:
        word = "noise-limited"  # a small output is no fault of the model
    else:
        word = "fair" if fit >= _FAIR_FIT else "poor"
    verdict = (
        f"{word} prediction: FIT {scores.fit_percent:.2f} % ({fit:.2f} % of the deflection; "
        f"{simulation.fit_percent:.2f} % simulated from rest){against}; "
        f"{correlation.verdict}"
    )
    verdict = ". ".join([verdict, *(jump.sentence.rstrip(".") for jump in jumps)])
    return OutputValidation(
        first.name,
        first.unit,
        times,
        measured,
        measured - residuals,
        residuals,
        measured - plain_residuals,
        scores,
        of_deflection,
        simulation,
        ratio,
        Whiteness.of(noise),
        correlation,
        verdict,
    )
