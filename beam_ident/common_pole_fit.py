"""Transfer functions from one input to several outputs that share their poles.

    y_j = B_j(s) / (s^q A(s)) e^(-s T) u + nuisances_j + noise_j

Every output has its own numerator, nuisances, stamps and noise, and all of them inform the one
denominator: the log-likelihoods add up, each with its own unknown noise variance.  The best of the
denominators that the outputs give alone is where the joint iteration starts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beam_ident.argument_checks import require_input, require_output, require_record, require_whole_number
from beam_ident.blas_threads import on_one_thread
from beam_ident.errors import EstimationError
from beam_ident.levenberg_marquardt import minimise
from beam_ident.modal_fit import Prior
from beam_ident.output_error import Nuisances, OutputErrorProblem, OutputErrorState, Path, usable_samples
from beam_ident.piecewise import FloatArray
from beam_ident.records import TimeRecord
from beam_ident.refined_instruments import estimate_denominator
from beam_ident.structure_gates import (
    criterion_of_nothing,
    information_criterion,
    transfer_function_warnings,
)
from beam_ident.transfer_function import TransferFunctionModel
from beam_ident.transfer_function_fit import physical_model
from beam_ident.validation import Scores, Whiteness

_ITERATIONS = 50
_MAX_POLES = 20


@dataclass(frozen=True, eq=False)
class CommonPoleResult:
    """Transfer functions with one denominator and what is to be known about their estimation.

    Attributes
    ----------
    models : tuple of TransferFunctionModel
        One for each output; the denominator and its covariance are the same in all.
    times_s, measured, modelled, residuals : tuple of ndarray -- of every output, the samples used
    scores : tuple of Scores
    whiteness : tuple of Whiteness
    converged : bool
    reason : str
    iterations : int -- of the joint fit
    warnings : tuple of str -- what a reader must know before trusting the numbers
    """

    models: tuple[TransferFunctionModel, ...]
    times_s: tuple[FloatArray, ...]
    measured: tuple[FloatArray, ...]
    modelled: tuple[FloatArray, ...]
    residuals: tuple[FloatArray, ...]
    scores: tuple[Scores, ...]
    whiteness: tuple[Whiteness, ...]
    converged: bool
    reason: str
    iterations: int
    warnings: tuple[str, ...]

    def model(self, output_name: str) -> TransferFunctionModel:
        """Return the transfer function of one output by its name."""
        for model in self.models:
            if model.output_name == output_name:
                return model
        names = ", ".join(model.output_name for model in self.models)
        raise EstimationError(f"no output {output_name!r} in this result; available: {names}")


@dataclass(frozen=True, eq=False)
class _JointState:
    theta: FloatArray
    cost: float
    states: tuple[OutputErrorState, ...]


class _JointProblem:
    """The likelihoods of several outputs as a function of one denominator."""

    def __init__(self, problems: list[OutputErrorProblem], scale: float) -> None:
        self.problems = problems
        for problem in problems:
            problem.scale = scale

    def state(self, theta: FloatArray) -> _JointState:
        states = tuple(problem.state(theta) for problem in self.problems)
        return _JointState(theta, sum(state.cost for state in states), states)

    def slope(self, state: _JointState) -> tuple[FloatArray, FloatArray]:
        parts = [problem.slope(own) for problem, own in zip(self.problems, state.states, strict=True)]
        return np.sum([part[0] for part in parts], axis=0), np.sum([part[1] for part in parts], axis=0)

    def limited(self, theta: FloatArray, step: FloatArray) -> FloatArray:
        return np.asarray(theta + step)


@on_one_thread
def estimate_common_poles(
    record: TimeRecord,
    n_poles: int,
    n_zeros: int | Sequence[int],
    has_offset: bool = False,
    has_ramp: bool = False,
    has_free_response: bool = False,
    delay: float = 0.0,
    input_name: str | None = None,
    n_integrators: int = 0,
) -> CommonPoleResult:
    """Estimate transfer functions from one input to every output of a record, with common poles.

    Parameters
    ----------
    record : TimeRecord
    n_poles : int -- degree of the common denominator
    n_zeros : int or sequence of int -- degree of the numerators, or of each
    has_offset, has_ramp, has_free_response : bool -- estimated for every output
    delay : float -- known pure delay of all outputs [s]
    input_name : str or None -- which input, where there are several
    n_integrators : {0, 1, 2} -- known poles at zero

    Raises
    ------
    EstimationError
        Impossible degrees, too few samples, a constant output, or no output that gives a start.
    """
    require_record(record)
    if input_name is None and len(record.inputs) > 1:
        raise EstimationError(
            f"record {record.name!r} has {len(record.inputs)} inputs; say which one by its name"
        )
    drive = record.inputs[0] if input_name is None else record.input(input_name)
    require_input(drive, is_needed=not has_free_response)
    zeros = list(n_zeros) if isinstance(n_zeros, Sequence) else [n_zeros] * len(record.outputs)
    if len(zeros) != len(record.outputs):
        raise EstimationError(
            f"n_zeros has {len(zeros)} entries for {len(record.outputs)} outputs; expected one for each"
        )
    for name, value in (
        ("n_poles", n_poles),
        ("n_integrators", n_integrators),
        *(("n_zeros", m) for m in zeros),
    ):
        require_whole_number(name, value, 0)
    if (
        n_integrators not in range(3)
        or not 1 <= n_poles <= _MAX_POLES
        or not all(0 <= m <= n_poles + n_integrators for m in zeros)
    ):
        raise EstimationError(
            f"{n_poles} poles, {n_integrators} integrators and {zeros} zeros; expected 1 to {_MAX_POLES} poles, at "
            "most 2 integrators, and no more zeros than both together"
        )
    if not (math.isfinite(delay) and delay >= 0.0):
        raise EstimationError(f"delay is {delay} s; expected a time of 0 or more")
    nuisances = Nuisances(has_offset, has_ramp, has_free_response).with_integrators(n_integrators)
    problems, starts = [], []
    for output, m in zip(record.outputs, zeros, strict=True):
        keep = usable_samples(output, [drive])
        if has_free_response:
            keep = keep & (output.times_s >= drive.span_s[0] + delay + 0.5 * output.exposure_s)
        path = Path.of(drive, m, 0, Prior(delay), n_integrators, output.exposure_s)
        times, values = np.asarray(output.times_s[keep]), np.asarray(output.values[keep])
        require_output(output.name, values)
        problem = OutputErrorProblem((path,), (n_poles,), times, values, output.exposure_s, nuisances)
        problems.append(problem)
        starts.append(estimate_denominator(problem, "auto")[1].state)
    joints = [_JointProblem(problems, own.scale).state(own.theta) for own in starts]
    chosen = int(np.argmin([joint.cost for joint in joints]))
    if not math.isfinite(joints[chosen].cost):
        raise EstimationError("no output gives a denominator that the others allow; give other degrees")
    minimum = minimise(_JointProblem(problems, starts[chosen].scale), joints[chosen], _ITERATIONS)
    states = minimum.state.states
    information = [problem.slope(own)[0] for problem, own in zip(problems, states, strict=True)]
    models = []
    for j, (problem, own, output) in enumerate(zip(problems, states, record.outputs, strict=True)):
        others = [part for k, part in enumerate(information) if k != j]
        covariance = problem.covariance(own, np.sum(others, axis=0) if others else None)
        noise_sd = math.sqrt(covariance.variance)
        model = physical_model(problem, own, covariance.values, n_integrators, noise_sd, output.name)
        models.append(model.path(0))
    whiteness = tuple(Whiteness.of(own.residuals) for own in states)
    warnings: list[str] = []
    for problem, own, found, of_residuals in zip(problems, states, models, whiteness, strict=True):
        n_own = n_poles + len(own.coefficients)
        of_nothing = criterion_of_nothing(
            problem.times, problem.values, nuisances.has_offset, nuisances.has_ramp
        )
        is_worth_it = information_criterion(own.residuals, n_own) < of_nothing
        warnings += [
            f"Output {found.output_name}: {said}"
            for said in transfer_function_warnings([found], of_residuals, is_worth_it, True, "")
        ]
    if not minimum.converged:
        warnings.insert(0, f"The fit did not converge: {minimum.reason}.")
    return CommonPoleResult(
        models=tuple(models),
        times_s=tuple(problem.times for problem in problems),
        measured=tuple(problem.values for problem in problems),
        modelled=tuple(p.values - s.residuals for p, s in zip(problems, states, strict=True)),
        residuals=tuple(own.residuals for own in states),
        scores=tuple(Scores.of(p.values, s.residuals) for p, s in zip(problems, states, strict=True)),
        whiteness=whiteness,
        converged=minimum.converged,
        reason=minimum.reason,
        iterations=minimum.iterations,
        warnings=tuple(warnings),
    )
