"""Transfer functions from one input or several to several outputs that share their poles.

    y_j = sum_k B_jk(s) / (s^q A(s)) e^(-s T_k) u_k + nuisances_j + noise_j

Every output has its own numerators, nuisances, stamps and noise, and all of them inform the one
denominator: the log-likelihoods add up, each with its own unknown noise variance.  The best of the
denominators that the outputs give alone is where the joint iteration starts.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar, overload

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.data.argument_checks import (
    chosen_inputs,
    require_arrival,
    require_excitation,
    require_records,
    require_time,
    require_whole_number,
    split_at_gaps,
)
from beam_ident.data.prior import Prior
from beam_ident.data.records import InputSignal, TimeRecord
from beam_ident.errors import EstimationError
from beam_ident.noise.record_fit import RecordFit, pooled_scores
from beam_ident.noise.relation import is_related
from beam_ident.noise.scores import Scores, Tested, Whiteness
from beam_ident.noise.shared_noise import SharedNoise, together
from beam_ident.numerics.blas_threads import on_one_thread
from beam_ident.numerics.levenberg_marquardt import Minimum, minimise
from beam_ident.sensing.clock_rate import clocks_of_record
from beam_ident.sensing.damage import damage_warnings, without_repeated
from beam_ident.sensing.misfit_causes import input_misfit_warnings
from beam_ident.sensing.quantisation import without_clipped
from beam_ident.summary import SummarisedModes, SummaryPart, result_parts
from beam_ident.transfer_function.model import TransferFunctionModel
from beam_ident.transfer_function.multi_input_model import MultiInputModel
from beam_ident.transfer_function.structure_gates import (
    transfer_function_warnings,
)
from beam_ident.transfer_function_estimation.estimation import (
    one_each,
    physical_model,
    pooled_level,
    record_fits,
    with_initial_motion,
)
from beam_ident.transfer_function_estimation.output_error import OutputErrorProblem, OutputErrorState
from beam_ident.transfer_function_estimation.pole_exchange import Place, exchanged
from beam_ident.transfer_function_estimation.record_share import Nuisances, RecordShare
from beam_ident.transfer_function_estimation.rivc import LOOKS, MAX_TRAVEL
from beam_ident.transfer_function_estimation.srivc import (
    are_known,
    estimate_denominator,
    follow_inputs,
)

_ITERATIONS = 50
_TURNS = 25  # of poles and noise
_SETTLED = 0.02  # standard deviations that a turn may still move the poles
_MAX_POLES = 20


Model = TypeVar("Model", TransferFunctionModel, MultiInputModel)


@dataclass(frozen=True, eq=False, repr=False)
class CommonPoleFit(SummarisedModes, Generic[Model]):
    """Models with one denominator and what is to be known about their estimation.

    Attributes
    ----------
    models : tuple of TransferFunctionModel, or of MultiInputModel where there are several inputs
        One for each output; the denominator and its covariance are the same in all.
    times_s, measured, modelled, residuals : tuple of ndarray
        Of every output the samples used, in the order of the records.
    records : tuple of tuple of RecordFit -- of every output, record by record
    scores : tuple of Scores
    whiteness : tuple of Whiteness
    converged : bool
    reason : str
    iterations : int -- of the joint fit
    warnings : tuple of str -- what a reader must know before trusting the numbers
    """

    models: tuple[Model, ...]
    times_s: tuple[FloatArray, ...]
    measured: tuple[FloatArray, ...]
    modelled: tuple[FloatArray, ...]
    residuals: tuple[FloatArray, ...]
    records: tuple[tuple[RecordFit, ...], ...]
    scores: tuple[Scores, ...]
    whiteness: tuple[Whiteness, ...]
    converged: bool
    reason: str
    iterations: int
    warnings: tuple[str, ...]

    def summary_parts(self) -> list[SummaryPart]:
        """Return the summary's tables and sentences."""
        return result_parts(self, self.models, tuple(model.output_name for model in self.models))

    def model(self, output_name: str) -> Model:
        """Return the model of one output by its name."""
        for model in self.models:
            if model.output_name == output_name:
                return model
        names = ", ".join(model.output_name for model in self.models)
        raise EstimationError(f"no output {output_name!r} in this result; available: {names}")


class CommonPoleResult(CommonPoleFit[TransferFunctionModel]):
    """Transfer functions from one input with one denominator; all else stands in ``CommonPoleFit``."""


class MultiInputCommonPoleResult(CommonPoleFit[MultiInputModel]):
    """Transfer functions from several inputs with one denominator; all else stands in ``CommonPoleFit``."""


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
        return self.problems[0].limited(theta, step)

    def scale_to(self, state: _JointState) -> None:
        """Take the unit of frequency of a state."""
        for problem in self.problems:
            problem.scale = state.states[0].scale

    def reweighed(self, state: _JointState, as_it_is: bool, stays: bool = False) -> _JointProblem:
        """Return the problem under the noise that every output has in every record, or its level alone.

        Where the noise ``stays`` what it was taken for, only levels and the weights of tails follow.
        """
        is_new = as_it_is and not stays
        problems = [
            problem.reweighed(
                own,
                as_it_is,
                problem.noise if stays else None,
                problem.doubt(own, others) if is_new else None,
            )
            for problem, own, others in zip(self.problems, state.states, self._others(state), strict=True)
        ]
        return _JointProblem(problems, state.states[0].scale)

    def _others(self, state: _JointState) -> list[FloatArray]:
        """Return the information on theta that every output has from all others."""
        parts = [problem.slope(own)[0] for problem, own in zip(self.problems, state.states, strict=True)]
        return [
            np.sum([part for k, part in enumerate(parts) if k != j] or [0.0 * parts[j]], axis=0)
            for j in range(len(parts))
        ]

    @property
    def is_plain(self) -> bool:
        """Whether no output has noise with a colour or outliers."""
        return all(problem.noise is None or problem.noise.is_plain for problem in self.problems)

    @property
    def is_cautious(self) -> bool:
        """Whether weights of some output are those of the way to the optimum."""
        return any(problem.noise is not None and problem.noise.is_cautious for problem in self.problems)

    def reach(self, state: _JointState) -> FloatArray:
        """Return the standard deviations of the coefficients, the colour of the noise included."""
        owned = zip(self.problems, state.states, self._others(state), strict=True)
        shares = [
            np.diag(problem.covariance(own, others).values)[: len(state.theta)]
            for problem, own, others in owned
        ]
        return np.asarray(np.sqrt(np.maximum(np.max(shares, axis=0), 1e-300)))


_Found = tuple[_JointProblem, Minimum[_JointState], int]


@overload
def estimate_common_poles(
    record: TimeRecord | Sequence[TimeRecord],
    n_poles: int,
    n_zeros: int | Sequence[int],
    has_offset: bool = ...,
    has_ramp: bool = ...,
    has_free_response: bool | None = ...,
    delay: float = ...,
    input_name: str | None = ...,
    n_integrators: int = ...,
) -> CommonPoleResult: ...


@overload
def estimate_common_poles(
    record: TimeRecord | Sequence[TimeRecord],
    n_poles: int,
    n_zeros: Sequence[Sequence[int]],
    has_offset: bool = ...,
    has_ramp: bool = ...,
    has_free_response: bool | None = ...,
    delay: float | Sequence[float] = ...,
    input_name: None = ...,
    n_integrators: int = ...,
) -> MultiInputCommonPoleResult: ...


@on_one_thread
def estimate_common_poles(
    record: TimeRecord | Sequence[TimeRecord],
    n_poles: int,
    n_zeros: int | Sequence[int] | Sequence[Sequence[int]],
    has_offset: bool = False,
    has_ramp: bool = False,
    has_free_response: bool | None = None,
    delay: float | Sequence[float] = 0.0,
    input_name: str | None = None,
    n_integrators: int = 0,
) -> CommonPoleResult | MultiInputCommonPoleResult:
    """Estimate transfer functions from one input, or from several, to every output, with common poles.

    Parameters
    ----------
    record : TimeRecord or sequence of TimeRecord
        One experiment, or several that share the transfer functions; each has its own clocks, offsets,
        ramps and initial states, and every output weighs in each by its noise there.
    n_poles : int -- degree of the common denominator
    n_zeros : int, sequence of int, or sequence of sequences of int
        Degree of the numerators, or of that of each output; or for each output a degree for each input, which
        takes all inputs of the record.
    has_offset, has_ramp : bool -- estimated for every output
    has_free_response : bool or None
        Whether records may begin in motion; None decides from the data, as ``estimate_transfer_function`` does.
    delay : float or sequence of float -- known pure delay of all outputs, or one from each input [s]
    input_name : str or None -- which input, where there are several and not all are taken
    n_integrators : {0, 1, 2} -- known poles at zero

    Returns
    -------
    CommonPoleResult, or MultiInputCommonPoleResult where ``n_zeros`` has a sequence for each output

    Raises
    ------
    EstimationError
        Impossible degrees, too few samples, a constant output, no output that gives a start, or records
        whose signals differ in name or unit.
    """
    records = require_records(record)
    first = records[0]
    drives, zeros = _degrees(first, n_zeros, input_name)
    delays = tuple(one_each("delay", delay, list(drives)))
    terms = Nuisances(has_offset, has_ramp)
    asked = _Request(n_poles, zeros, drives, delays, n_integrators, terms, has_free_response)
    asked.check(records, n_zeros)
    is_one_input = not isinstance(n_zeros, Sequence) or not any(isinstance(own, Sequence) for own in n_zeros)
    records, gaps = split_at_gaps(records, 3 * (n_poles + 2))
    records, repeated = without_repeated(records, first.output_names)
    result, clipped = without_clipped(
        records,
        first.output_names,
        lambda seen: asked.fit(seen, is_one_input),
        lambda found, one, name: found.model(name).predict(one),
    )
    said = [clipped] if clipped else []
    for one in records:
        said += damage_warnings(one.outputs, [one.input(own) for own in drives])
    if isinstance(result, CommonPoleResult):
        said += _input_misfits(records, drives[0], result)
        if not all(Whiteness.of(left).is_white for left in result.residuals):
            for one in records:
                said += clocks_of_record(one.outputs, one.input(drives[0]))
    return replace(result, warnings=(*gaps, *result.warnings, *repeated, *said))


def _degrees(
    record: TimeRecord, n_zeros: int | Sequence[int] | Sequence[Sequence[int]], input_name: str | None
) -> tuple[tuple[str, ...], tuple[tuple[int, ...], ...]]:
    """Return the inputs that are taken, and of every output the degrees of its numerators, one for each input."""
    degrees: list[Any] = list(n_zeros) if isinstance(n_zeros, Sequence) else [n_zeros] * len(record.outputs)
    several = any(isinstance(own, Sequence) for own in degrees)
    if several and input_name is not None:
        raise EstimationError(
            "input_name goes with one number of zeros for each output; a sequence of them takes all inputs"
        )
    if not several and input_name is None and len(record.inputs) > 1:
        raise EstimationError(
            f"record {record.name!r} has {len(record.inputs)} inputs; say which one by its name, or give for every "
            "output a number of zeros for each input"
        )
    drives = [own.name for own in (record.inputs if several else chosen_inputs(record, input_name))]
    if len(degrees) != len(record.outputs):
        raise EstimationError(
            f"n_zeros has {len(degrees)} entries for {len(record.outputs)} outputs; expected one for each"
        )
    return tuple(drives), tuple(tuple(one_each("n_zeros", own, drives)) for own in degrees)


@dataclass(frozen=True)
class _Request:
    """What is estimated.

    Attributes
    ----------
    n_poles, n_integrators : int
    zeros : tuple of tuple of int -- of every output, degrees of its numerators
    drives, delays : tuple -- inputs that are taken, and how late each arrives [s]
    terms : Nuisances -- of every output
    has_free_response : bool or None
    """

    n_poles: int
    zeros: tuple[tuple[int, ...], ...]
    drives: tuple[str, ...]
    delays: tuple[float, ...]
    n_integrators: int
    terms: Nuisances
    has_free_response: bool | None

    def check(self, records: Sequence[TimeRecord], n_zeros: object) -> None:
        """Raise EstimationError where it is impossible; ``n_zeros`` is as it was given."""
        require_whole_number("n_poles", self.n_poles, 0)
        require_whole_number("n_integrators", self.n_integrators, 0)
        for m in itertools.chain(*self.zeros):
            require_whole_number("n_zeros", m, 0)
        most = self.n_poles + self.n_integrators
        is_possible = self.n_integrators in range(3) and 1 <= self.n_poles <= _MAX_POLES
        if not is_possible or not all(0 <= m <= most for m in itertools.chain(*self.zeros)):
            raise EstimationError(
                f"{self.n_poles} poles, {self.n_integrators} integrators and {n_zeros} zeros; expected 1 to "
                f"{_MAX_POLES} poles, at most 2 integrators, and no more zeros than both together"
            )
        for name, late in zip(self.drives, self.delays, strict=True):
            require_time("delay", late)
            for one in records:
                for output in one.outputs:
                    require_arrival(one.input(name), late, output)
            if not self.has_free_response:
                require_excitation(records, name)

    def fit(
        self, seen: list[TimeRecord], is_one_input: bool
    ) -> CommonPoleResult | MultiInputCommonPoleResult:
        """Return the estimate from some records."""
        still: list[OutputErrorState] = []

        def attempt(is_moving: bool) -> _Found:
            problems = [self._problem(seen, place, is_moving) for place in range(len(self.zeros))]
            found = _joint_minimum(problems, still)
            still.append(found[1].state.states[0])
            return found

        (joint, minimum, iterations), motion = with_initial_motion(attempt, _tested, self.has_free_response)
        joint, minimum, more = _under_noise_as_it_is(joint, minimum)
        result = _result(seen, joint, minimum, self.n_integrators, iterations + more, not is_one_input)
        return replace(result, warnings=(*motion.warnings, *result.warnings))

    def _problem(self, seen: Sequence[TimeRecord], place: int, is_moving: bool) -> OutputErrorProblem:
        """Return the problem of one output alone."""
        name, priors = seen[0].output_names[place], [Prior(late) for late in self.delays]
        shares = [
            RecordShare.of(
                one,
                name,
                list(self.drives),
                list(self.zeros[place]),
                [0] * len(self.drives),
                priors,
                self.n_integrators,
                is_moving,
            )
            for one in seen
        ]
        nuisances = replace(self.terms, has_free_response=is_moving).with_integrators(self.n_integrators)
        return OutputErrorProblem(shares, (self.n_poles,), nuisances)


def _input_misfits(records: Sequence[TimeRecord], name: str, result: CommonPoleResult) -> list[str]:
    """Return what the residuals say of the only input."""
    said: list[str] = []
    for model, fits in zip(result.models, result.records, strict=True):
        for one, own in zip(records, fits, strict=True):

            def respond(
                drive: InputSignal,
                found: TransferFunctionModel = model,
                times: FloatArray = own.times_s,
                exposure_s: float = one.output(model.output_name).exposure_s,
            ) -> FloatArray:
                return found.simulate(drive, times, exposure_s)

            part = (own.times_s, own.modelled, own.residuals)
            said += input_misfit_warnings(model.output_name, one.input(name), part, respond)
    return said


def _tested(found: _Found) -> list[Tested]:
    """Return what every output gives to the test for initial motion."""
    joint, minimum, _ = found
    pairs = zip(joint.problems, minimum.state.states, strict=True)
    return [problem.initial_motion(own) for problem, own in pairs]


def _elsewhere(found: _Found, pool: Sequence[Place]) -> _Found:
    """Return an optimum, or a better one that has some of its poles in other places (as ``srivc`` does)."""
    joint, minimum, iterations = found
    joint.scale_to(minimum.state)
    theta = minimum.state.theta
    is_known = minimum.converged and are_known(joint.problems[0], theta, joint.slope(minimum.state)[0])
    if is_known and not follow_inputs(joint.problems, minimum.state.states):
        return found

    def place_of(own: _Found) -> Place:
        return replace(Place.of(own[1].state.states[0]), cost=own[1].state.cost)

    def refined(place: Place, target: float) -> _Found:
        again = _JointProblem(joint.problems, place.scale)
        end = minimise(again, again.state(place.theta), _ITERATIONS, target)
        return again, end, iterations + end.iterations

    joint, minimum, iterations = exchanged(
        joint.problems, found, place_of, refined, [own.poles for own in pool]
    )
    joint.scale_to(minimum.state)
    return joint, minimum, iterations


def _joint_minimum(problems: list[OutputErrorProblem], inside: Sequence[OutputErrorState] = ()) -> _Found:
    """Return problem, optimum and iterations of one denominator, from the best of what the outputs give alone.

    ``inside`` are optima of the same outputs with fewer nuisances.
    """
    alone = [estimate_denominator(problem, "auto", looks_elsewhere=False) for problem in problems]
    problems = [problem for problem, _ in alone]
    starts = [optimum.state for _, optimum in alone] + list(inside)
    joints = [_JointProblem(problems, own.scale).state(own.theta) for own in starts]
    chosen = int(np.argmin([joint.cost for joint in joints]))
    if not math.isfinite(joints[chosen].cost):
        raise EstimationError("no output gives a denominator that the others allow; give other degrees")
    joint = _JointProblem(problems, starts[chosen].scale)
    minimum = minimise(joint, joints[chosen], _ITERATIONS)
    iterations = minimum.iterations
    if len(problems[0].experiments) > 1:
        joint, minimum = _in_turns(joint, minimum, as_it_is=False)
        iterations += minimum.iterations
    return _elsewhere((joint, minimum, iterations), [Place.of(own) for own in starts])


def _under_noise_as_it_is(joint: _JointProblem, minimum: Minimum[_JointState]) -> _Found:
    """Return problem and optimum under the noise that the residuals show, and how many iterations that took."""
    if joint.reweighed(minimum.state, as_it_is=True).is_plain:
        return joint, minimum, 0
    reach = joint.reach(minimum.state)
    weighed, found = _in_turns(joint, minimum, as_it_is=True)
    moved = np.abs(found.state.theta - minimum.state.theta)
    # As for one output (``rivc``): what moves further than noise can is no noise, and the weights stay equal.
    if found.converged and np.max(moved / reach) < MAX_TRAVEL:
        return weighed, found, found.iterations
    return joint, minimum, found.iterations


def _in_turns(
    joint: _JointProblem, minimum: Minimum[_JointState], as_it_is: bool
) -> tuple[_JointProblem, Minimum[_JointState]]:
    """Estimate poles and noise in turns, until neither moves."""
    stays = False
    for turn in range(_TURNS):
        stays = stays or turn >= LOOKS
        joint = joint.reweighed(minimum.state, as_it_is, stays)
        start = minimum.state.theta
        minimum = minimise(joint, joint.state(start), _ITERATIONS)
        moved = minimum.state.theta - start
        if math.sqrt(float(moved @ joint.slope(minimum.state)[0] @ moved) / len(moved)) < _SETTLED:
            if not joint.is_cautious and (turn or joint.is_plain):
                return joint, minimum
            stays = joint.is_cautious
    reason = f"system and noise still moved after {_TURNS} turns"
    return joint, replace(minimum, converged=False, reason=reason)


def _result(
    records: Sequence[TimeRecord],
    joint: _JointProblem,
    minimum: Minimum[_JointState],
    n_integrators: int,
    iterations: int,
    several: bool,
) -> CommonPoleResult | MultiInputCommonPoleResult:
    """Collect what an optimum says, in physical units."""
    states = minimum.state.states
    residuals = [
        problem.unweighed_residuals(own) for problem, own in zip(joint.problems, states, strict=True)
    ]
    information = [problem.slope(own)[0] for problem, own in zip(joint.problems, states, strict=True)]
    beside = _shared_covariances(joint.problems, states, np.sum(information, axis=0))
    models, fits = [], []
    for j, (problem, own, name) in enumerate(
        zip(joint.problems, states, records[0].output_names, strict=True)
    ):
        others = [part for k, part in enumerate(information) if k != j]
        covariance = problem.covariance(own, np.sum(others, axis=0) if others else None)
        covariance = replace(covariance, values=covariance.values + beside[j])
        fits.append(record_fits(problem, own, covariance))
        model = physical_model(problem, own, covariance.values, n_integrators, pooled_level(fits[-1]), name)
        models.append(model)
    whiteness = tuple(
        Whiteness.of(problem.standardised(own.residuals))
        for problem, own in zip(joint.problems, states, strict=True)
    )
    warnings: list[str] = []
    for problem, own, found, of_records, of_residuals in zip(
        joint.problems, states, models, fits, whiteness, strict=True
    ):
        terms = problem.nuisances
        n_own = len(own.theta) + len(own.coefficients)
        signals = [(e.times, e.values) for e in problem.experiments]
        is_worth_it = is_related(
            signals, [e.residuals for e in of_records], n_own, terms.has_offset, terms.has_ramp
        )
        warnings += [
            f"Output {found.output_name}: {said}"
            for said in transfer_function_warnings(
                [found.path(k) for k in range(len(found.input_names))],
                of_records,
                of_residuals,
                is_worth_it,
                True,
                "",
            )
        ]
    if not minimum.converged:
        warnings.insert(0, f"The fit did not converge: {minimum.reason}.")
    figures: dict[str, Any] = {
        "times_s": tuple(problem.times for problem in joint.problems),
        "measured": tuple(problem.values for problem in joint.problems),
        "modelled": tuple(
            problem.values - left for problem, left in zip(joint.problems, residuals, strict=True)
        ),
        "residuals": tuple(residuals),
        "records": tuple(fits),
        "scores": tuple(pooled_scores([(own.measured, own.residuals) for own in parts]) for parts in fits),
        "whiteness": whiteness,
        "converged": minimum.converged,
        "reason": minimum.reason,
        "iterations": iterations,
        "warnings": tuple(warnings),
    }
    if several:
        return MultiInputCommonPoleResult(models=tuple(models), **figures)
    return CommonPoleResult(models=tuple(model.path(0) for model in models), **figures)


def _shared_covariances(
    problems: Sequence[OutputErrorProblem], states: Sequence[OutputErrorState], information: FloatArray
) -> list[FloatArray]:
    """Return what noise that outputs share adds to the covariance of every output, as if each was by itself.

    Notes
    -----
    With H the information on theta, S the covariance of its score and the projected derivatives D_k, w_k of unit
    variance, the errors are ``H^-1 sum_k D_k^T w_k`` of theta and ``B_j w_j + G_j`` times that of the linear
    coefficients, B_j the pseudoinverse of their columns and G_j as in (T.10): ``S - H`` and the covariance of B_j w_j
    and the score hold the terms between outputs.
    """
    sizes = [len(own.theta) + len(own.coefficients) for own in states]
    nothing = [np.zeros((size, size)) for size in sizes]
    owned = list(zip(problems, states, strict=True))
    tables = [
        together(times, rows)[1]
        for times, rows in zip(
            zip(*([own.times for own in problem.experiments] for problem in problems), strict=True),
            zip(*([np.arange(r.start, r.stop) for r in problem.rows] for problem in problems), strict=True),
            strict=True,
        )
    ]
    shared = SharedNoise.of([own.residuals for own in states], np.concatenate(tables))
    if shared is None:
        return nothing
    spreads = [problem.spread(own) for problem, own in owned]
    jacobians = [problem.jacobian(own) for problem, own in owned]
    solutions = [own.solution for own in states if own.solution is not None]
    projected = [
        solution.left_of(jacobian) / spread
        for solution, jacobian, spread in zip(solutions, jacobians, spreads, strict=True)
    ]
    inverse = np.linalg.pinv(information, hermitian=True)
    of_theta = inverse @ shared.excess(projected, [slice(0, len(own)) for own in projected]) @ inverse
    result = []
    for j, (solution, jacobian, spread) in enumerate(zip(solutions, jacobians, spreads, strict=True)):
        sensitivity = -solution.coefficients(jacobian)
        told = spread * solution.coefficients(shared.told_by_others(projected, j)) @ inverse
        cross = sensitivity @ of_theta + told
        of_linear = cross @ sensitivity.T + sensitivity @ told.T
        result.append(np.block([[of_theta, cross.T], [cross, of_linear]]))
    return result
