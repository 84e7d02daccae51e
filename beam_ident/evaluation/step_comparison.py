"""Several models on the same step: the table of fit percentages.

Models that were estimated from different records, by different methods or of different orders
may describe the same system with different numbers.  What they make of a step shows whether the difference
matters: the thesis compares its models by the fit percentage of their step responses (thesis table 4.8).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.data.records import InputSignal, TimeRecord
from beam_ident.errors import EstimationError
from beam_ident.evaluation.hold_out import validate
from beam_ident.modal.model import ModalModel
from beam_ident.noise.scores import Scores
from beam_ident.transfer_function.model import TransferFunctionModel

Model = ModalModel | TransferFunctionModel

_DECAYS = 5.0  # time constants of the slowest pole that a step response is followed for
_SAMPLES_PER_PERIOD = 20.0
_MAX_SAMPLES = 20_000


@dataclass(frozen=True, eq=False)
class StepComparison:
    """Responses of several models to one step, and how well each stands for the others.

    Attributes
    ----------
    names : tuple of str -- of the models
    output_name : str
    times_s : ndarray, shape (n_times,)
    responses : ndarray, shape (n_models, n_times) -- from rest
    fit_percent : ndarray, shape (n_models, n_models)
        ``[i, j]``: fit of model j, taken for the response of model i; 100 on the diagonal.
    measured_fit_percent : ndarray, shape (n_models,), or None
        Fit of each model to a measured record, with that record's own initial motion and offset.

    Notes
    -----
    ``FP = 100 (1 - ||y - y_hat|| / ||y - mean(y)||)`` over the times given.  It is not symmetric, as the
    scale is that of the reference; a response without oscillation has little scale, and small fits there mean
    little.
    """

    names: tuple[str, ...]
    output_name: str
    times_s: FloatArray
    responses: FloatArray
    fit_percent: FloatArray
    measured_fit_percent: FloatArray | None

    def __str__(self) -> str:
        """Return the table: a row for each reference, a column for each model."""
        width = max(9, *(len(name) for name in self.names))
        head = "reference".ljust(width) + "".join(f"  {name:>{width}}" for name in self.names)
        rows = [
            name.ljust(width) + "".join(f"  {value:>{width}.2f}" for value in row)
            for name, row in zip(self.names, self.fit_percent, strict=True)
        ]
        if self.measured_fit_percent is not None:
            rows.append(
                "measured".ljust(width) + "".join(f"  {v:>{width}.2f}" for v in self.measured_fit_percent)
            )
        return "\n".join([f"fit percentage of {self.output_name} on a step", head, *rows])


def compare_step_responses(
    models: Mapping[str, Model],
    drive: InputSignal | None = None,
    times_s: FloatArray | None = None,
    output_name: str | None = None,
    record: TimeRecord | None = None,
) -> StepComparison:
    """Compare the responses of several models to the same step.

    Parameters
    ----------
    models : mapping of str to ModalModel or TransferFunctionModel -- at least two, by the names to print
    drive : InputSignal, optional
        The step; by default a unit step at 0 s.  A model whose input is a position needs a smooth one, such as
        ``Step().sample().input_signal("position")``.
    times_s : ndarray, shape (n_times,), optional
        By default up to five time constants of the slowest pole of all models, or the end of the drive,
        twenty times in every period of the fastest.
    output_name : str, optional -- needed where a model has several outputs
    record : TimeRecord, optional -- a measured step, on which every model is scored too

    Raises
    ------
    EstimationError
        Fewer than two models, an output that a model lacks, a position that would jump, a model without a decay
        where no times are given.
    """
    if len(models) < 2:
        raise EstimationError(f"models: {len(models)} given; expected at least two to compare")
    name = _common_output(models, output_name)
    _refuse_jumps(models, drive)
    times = _default_times(models, drive) if times_s is None else np.asarray(times_s, dtype=np.float64)
    if times.ndim != 1 or len(times) < 2 or not np.all(np.isfinite(times)):
        raise EstimationError(f"times_s has shape {times.shape}; expected at least two finite instants")
    signal = drive or InputSignal(
        "step", "", np.array([0.0, max(float(np.max(times)), 1e-9)]), np.ones(2), "zoh"
    )
    responses = np.stack([_response(model, signal, times, name) for model in models.values()])
    fits = np.array(
        [
            [Scores.of(reference, reference - other).fit_percent for other in responses]
            for reference in responses
        ]
    )
    measured = None
    if record is not None:
        measured = np.array(
            [validate(model, record).output(name).scores.fit_percent for model in models.values()]
        )
    return StepComparison(tuple(models), name, times, responses, fits, measured)


def _outputs(model: Model) -> tuple[str, ...]:
    return model.output_names if isinstance(model, ModalModel) else (model.output_name,)


def _common_output(models: Mapping[str, Model], wanted: str | None) -> str:
    outputs = [_outputs(model) for model in models.values()]
    name = outputs[0][0] if wanted is None and len(outputs[0]) == 1 else wanted
    if name is None:
        raise EstimationError(
            f"output_name is not given and the models have {', '.join(outputs[0])}; expected one of them"
        )
    for key, names in zip(models, outputs, strict=True):
        if name not in names:
            raise EstimationError(f"model {key!r} has no output {name!r}; it has {', '.join(names)}")
    return name


def _refuse_jumps(models: Mapping[str, Model], drive: InputSignal | None) -> None:
    for key, model in models.items():
        is_position = isinstance(model, ModalModel) and model.structure == "base_motion"
        if is_position and (drive is None or drive.hold == "zoh"):
            raise EstimationError(
                f"model {key!r} takes a position, which cannot jump; give a smooth drive, such as "
                "Step().sample().input_signal('position')"
            )


def _default_times(models: Mapping[str, Model], drive: InputSignal | None) -> FloatArray:
    poles = np.concatenate([model.poles for model in models.values()])
    if drive is not None:
        start, end = drive.span_s
    else:
        slowest = float(np.min(-poles.real, initial=np.inf))
        if not (np.isfinite(slowest) and slowest > 0.0):
            raise EstimationError(
                f"the slowest pole decays at {slowest:.3g} 1/s, so that a step response never ends; give times_s"
            )
        start, end = 0.0, _DECAYS / slowest
    step = 2.0 * np.pi / (_SAMPLES_PER_PERIOD * max(float(np.max(np.abs(poles), initial=0.0)), 1e-300))
    n = int(np.clip(np.ceil((end - start) / step), 100, _MAX_SAMPLES))
    return np.asarray(np.linspace(start, end, n + 1), dtype=np.float64)


def _response(model: Model, drive: InputSignal, times: FloatArray, name: str) -> FloatArray:
    response = model.simulate(drive, times)
    if isinstance(model, ModalModel):
        return np.asarray(response[:, model.output_names.index(name)])
    return response
