"""Direct estimation of transfer functions from sampled data, with no hints beyond their degrees.

Several records of one system are one fit: denominators, numerators and delays are common to them, while
every record has its own clocks, offset, drift and initial state, and its own noise, by which it weighs.

What is estimated is a ``OutputErrorProblem``; how a start is found and
refined to the optimum stands in ``transfer_function_estimation.srivc``, how a delay is found in
``transfer_function_estimation.delay_search``, and how inputs with denominators of their own are separated in
``transfer_function_estimation.additive_fit``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeVar, overload

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.data.argument_checks import (
    require_arrival,
    require_excitation,
    require_records,
    require_whole_number,
    split_at_gaps,
)
from beam_ident.data.prior import Prior
from beam_ident.data.records import InputSignal, TimeRecord
from beam_ident.errors import EstimationError
from beam_ident.noise.input_noise import input_noise_share, noise_grid
from beam_ident.noise.record_fit import OverOneOutput, OverOutputs, RecordFit, pooled_scores
from beam_ident.noise.relation import innovation_criterion, is_related
from beam_ident.noise.scores import Scores, ScoreTest, Tested, Whiteness, are_rounding
from beam_ident.numerics.blas_threads import on_one_thread
from beam_ident.numerics.rational_response import upper_roots
from beam_ident.sensing.clock_rate import clocks_of_record
from beam_ident.sensing.damage import damage_warnings, without_repeated
from beam_ident.sensing.misfit_causes import input_misfit_warnings
from beam_ident.sensing.quantisation import without_clipped
from beam_ident.sensing.still_noise import StillNoise, found_noise_warning
from beam_ident.summary import SummarisedModes, SummaryPart, result_parts
from beam_ident.transfer_function.model import TransferFunctionModel
from beam_ident.transfer_function.multi_input_model import MultiInputModel
from beam_ident.transfer_function.structure_gates import (
    structure_complaint,
    transfer_function_warnings,
)
from beam_ident.transfer_function_estimation.additive_fit import estimate_additive
from beam_ident.transfer_function_estimation.output_error import (
    JointCovariance,
    OutputErrorProblem,
    OutputErrorState,
)
from beam_ident.transfer_function_estimation.pole_exchange import Place
from beam_ident.transfer_function_estimation.record_share import Nuisances, RecordShare
from beam_ident.transfer_function_estimation.rivc import refine_with_noise_model, under_noise_as_it_is
from beam_ident.transfer_function_estimation.srivc import (
    FINALISTS,
    METHODS,
    Method,
    Optimum,
    estimate_denominator,
)

DelayLike = float | Prior | Literal["estimate"]

_MAX_POLES = 20
_MAX_INTEGRATORS = 2
_VISIBLE_SHARE = 0.01  # of the output's noise variance: from here on noise on the input is reported

_INITIAL_MOTION_LEVEL = 0.05  # false alarms: their price is low, and a motion that is missed is a bias
_LEFT_OUT_LEVEL = 1e-3  # the same, where only a warning comes of it
_BEGAN = "The record began in motion ({}): its initial state was estimated along."
_LEFT_OUT = (
    "The record began in motion (p = {:.1g}), and its initial state was not estimated: poles and damping ratios are "
    "biased."
)
_REMEDY = "Leave has_free_response at None, which decides from the data, or set it to True."


@dataclass(frozen=True)
class InitialMotion:
    """Whether records began in motion.

    Attributes
    ----------
    p_value : float -- how often a record at rest looks as much like one in motion; NaN where it was not tested
    is_estimated : bool -- whether the initial state was estimated along
    warnings : tuple of str -- what is to be said of it
    """

    p_value: float = math.nan
    is_estimated: bool = False
    warnings: tuple[str, ...] = ()

    @staticmethod
    def found(p_value: float) -> InitialMotion:
        """Return what an estimate without initial motion says, where the data decide; 0 where there is none."""
        if p_value > _INITIAL_MOTION_LEVEL:
            return InitialMotion(p_value)
        how = f"p = {p_value:.1g}" if p_value else "nothing fits without"
        return InitialMotion(p_value, True, (_BEGAN.format(how),))


@dataclass(frozen=True, eq=False, kw_only=True)
class RationalFit(OverOneOutput):
    """What is to be known about the estimation of transfer functions to one output.

    Attributes
    ----------
    method : str -- which estimator the numbers come from
    bic, yic : float
        Bayesian information criterion, and Young's information criterion
        ``ln(var e / var y) + ln(mean(var a_i / a_i^2))``, which the literature tabulates.
    offset, ramp : float
        Of the first record: at its middle, and over its whole length.
    initial_motion : InitialMotion -- whether the records began in motion
        Beside these, everything that ``OverOneOutput`` lists.
    """

    method: Method
    bic: float
    yic: float
    offset: float
    ramp: float
    initial_motion: InitialMotion = InitialMotion()


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class TransferFunctionResult(SummarisedModes, RationalFit):
    """A transfer function and what is to be known about its estimation.

    Attributes
    ----------
    model : TransferFunctionModel
        Beside it, everything that ``RationalFit`` and ``OverOneOutput`` list.
    """

    model: TransferFunctionModel

    def summary_parts(self) -> list[SummaryPart]:
        """Return the summary's tables and sentences."""
        return result_parts(self, (self.model,), (self.model.output_name,))


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class MultiInputResult(SummarisedModes, RationalFit):
    """Transfer functions from several inputs and what is to be known about their estimation.

    Attributes
    ----------
    model : MultiInputModel
        Beside it, everything that ``RationalFit`` and ``OverOneOutput`` list.
    """

    model: MultiInputModel

    def summary_parts(self) -> list[SummaryPart]:
        """Return the summary's tables and sentences."""
        return result_parts(self, (self.model,), (self.model.output_name,))


@dataclass(frozen=True, eq=False, repr=False)
class SeparateOutputsResult(SummarisedModes, OverOutputs):
    """A transfer function of every output, each estimated by itself and with poles of its own.

    Attributes
    ----------
    outputs : tuple of TransferFunctionResult
    tables : tuple of str
        The table of orders of every output as text, empty where the degrees were given.
        Beside these, everything that ``OverOutputs`` lists.
    """

    outputs: tuple[TransferFunctionResult, ...]
    tables: tuple[str, ...] = ()

    def summary_parts(self) -> list[SummaryPart]:
        """Return the summary's tables and sentences."""
        return result_parts(self, self.models, tuple(model.output_name for model in self.models))

    @property
    def models(self) -> tuple[TransferFunctionModel, ...]:
        """Transfer function of every output."""
        return tuple(output.model for output in self.outputs)

    @property
    def converged(self) -> bool:
        """Whether every estimation came to its end."""
        return all(output.converged for output in self.outputs)

    @property
    def reason(self) -> str:
        """Why each of them ended."""
        return "; ".join(f"{output.model.output_name}: {output.reason}" for output in self.outputs)

    @property
    def iterations(self) -> int:
        """Iterations of all of them."""
        return sum(output.iterations for output in self.outputs)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a reader must know before trusting the numbers."""
        return tuple(
            f"Output {output.model.output_name}: {said}"
            for output in self.outputs
            for said in output.warnings
        )


@overload
def estimate_transfer_function(
    record: TimeRecord | Sequence[TimeRecord],
    n_poles: int,
    n_zeros: int,
    method: Method = ...,
    has_offset: bool = ...,
    has_ramp: bool = ...,
    has_free_response: bool | None = ...,
    delay: DelayLike = ...,
    input_name: str | None = ...,
    output_name: str | None = ...,
    cutoff: float | None = ...,
    n_integrators: int = ...,
    n_starts: int = ...,
) -> TransferFunctionResult: ...


@overload
def estimate_transfer_function(
    record: TimeRecord | Sequence[TimeRecord],
    n_poles: int | Sequence[int],
    n_zeros: Sequence[int],
    method: Method = ...,
    has_offset: bool = ...,
    has_ramp: bool = ...,
    has_free_response: bool | None = ...,
    delay: DelayLike | Sequence[DelayLike] = ...,
    input_name: None = ...,
    output_name: str | None = ...,
    cutoff: float | None = ...,
    n_integrators: int = ...,
    n_starts: int = ...,
) -> MultiInputResult: ...


@on_one_thread
def estimate_transfer_function(
    record: TimeRecord | Sequence[TimeRecord],
    n_poles: int | Sequence[int],
    n_zeros: int | Sequence[int],
    method: Method = "auto",
    has_offset: bool = False,
    has_ramp: bool = False,
    has_free_response: bool | None = None,
    delay: DelayLike | Sequence[DelayLike] = 0.0,
    input_name: str | None = None,
    output_name: str | None = None,
    cutoff: float | None = None,
    n_integrators: int = 0,
    n_starts: int = FINALISTS + 1,
) -> TransferFunctionResult | MultiInputResult:
    """Estimate B(s)/A(s) from one input to one output, or one B_k(s)/A(s) from each of several.

    Parameters
    ----------
    record : TimeRecord or sequence of TimeRecord
        One experiment, or several that share transfer functions and delays.  Each has its own clocks,
        offset, ramp and initial state, and weighs by the noise that its residuals show.
    n_poles : int or sequence of int
        Degree of A.  With several inputs one number is a denominator common to all of them,
        and a sequence gives every input a denominator of its own.
    n_zeros : int or sequence of int
        Degree of B, or one for each input of the records; no more than poles and integrators.
    method : {"auto", "rivc", "white", "output_error", "srivc", "ivsvf", "lssvf"}
        "auto" goes by SRIVC to the output-error optimum, "output_error" by Levenberg-Marquardt alone.  Where BIC
        finds a colour or outliers in the residuals, both go on to the optimum under that noise, unless it is too far
        away to be noise.  "rivc" goes there in any case, "white" never; the others stop at the estimator they
        name (LSSVF is biased under noise, IVSVF is not efficient).
    has_offset, has_ramp : bool
        Unknown constant and drift, estimated along with the rest.
    has_free_response : bool or None
        Whether a record may begin in motion, so that its initial state is estimated as well. None decides
        from the data, by a score test that finds motion where there is none in one record of twenty; a warning
        says so where there is some, and where it was left out by request.
    delay : float, Prior, "estimate" or a sequence of these, one for each input
        Pure delay [s]: known, or estimated with what is known beforehand; "estimate" is
        ``Prior(0, inf)``, searched up to a quarter of the shortest record.
    input_name, output_name : str or None -- which signals, where there are several
    cutoff : float or None
        Cut-off of the state-variable filter [rad/s]; None tries a portfolio.
    n_integrators : {0, 1, 2}
        Known poles at zero, beside those that are estimated; with a free response an unknown
        constant (and for two a ramp) is estimated too.  Where a fit leaves doubts and an integrator, an offset
        or a drift more explains the data better, a warning says which.
    n_starts : int
        Starts at most, tried in turn until the residuals look like noise; 1 is the quickest, for
        comparing many structures.  With all of them, where the optimum did not converge, a pole is hardly known, or
        the residuals follow the input, poles are exchanged for others as long as that explains more.  Inputs with
        denominators of their own have starts of their own.

    Returns
    -------
    TransferFunctionResult, or MultiInputResult where ``n_zeros`` is a sequence

    Raises
    ------
    EstimationError
        Impossible degrees, too few samples, a constant output, an input at rest; records whose signals
        differ in name or unit.

    Notes
    -----
    The noise of every record has its own variance, colour and tails: samples of a quiet record count
    for more, and the stated standard deviations stay true for any levels.  The model's ``noise_sd``
    is the root of the mean square over all samples; each record's own stands in ``records``.  The weights
    of "lssvf" and "ivsvf" are those of a first estimate.
    """
    options: dict[str, Any] = {
        "method": method,
        "has_offset": has_offset,
        "has_ramp": has_ramp,
        "has_free_response": has_free_response,
        "delay": delay,
        "input_name": input_name,
        "output_name": output_name,
        "cutoff": cutoff,
        "n_integrators": n_integrators,
        "n_starts": n_starts,
    }
    result = estimated(record, n_poles, n_zeros, **options)
    if not (method in ("auto", "output_error", "rivc") and leaves_doubt(result)):
        return result
    best, gain = _more_terms(record, result, n_zeros, offers(n_poles, n_zeros, options), options)
    if best is None or gain <= STRONG:
        return result
    said = (
        f"With {best} the data are explained better than with the structure that was asked for (BIC lower by "
        f"{gain:.3g}): gains and poles of that one may be far off. Ask for {best.arguments}, or let "
        "select_transfer_function() choose."
    )
    return replace(result, warnings=(said, *result.warnings))


def criterion(
    result: TransferFunctionResult | MultiInputResult, has_offset: bool = False, has_ramp: bool = False
) -> float:
    """Return BIC with noise of any colour, whatever the fit took it for, up to a constant of the samples."""
    model = result.model
    denominators = model.denominators if isinstance(model, MultiInputModel) else (model.denominator,)
    poles = sum(len(np.trim_zeros(own, "b")) - 1 for own in denominators)
    shared = poles + sum(len(path.numerator) for path in paths_of(model))
    own = int(has_offset) + int(has_ramp) + poles * result.initial_motion.is_estimated
    n_parameters = shared + own * len(result.records)
    innovations = innovation_criterion([own.residuals for own in result.records])
    return innovations + n_parameters * math.log(len(result.measured))


def _more_terms(
    record: TimeRecord | Sequence[TimeRecord],
    result: TransferFunctionResult | MultiInputResult,
    n_zeros: int | Sequence[int],
    offered: Sequence[Offer],
    options: Mapping[str, Any],
) -> tuple[Offer | None, float]:
    """Return the structure to which terms lead one after the other, each lowering the criterion, and by how much."""
    present = criterion(result, options["has_offset"], options["has_ramp"])
    best, gain, terms = None, 0.0, _terms(options)
    while True:
        before = gain
        for offer in offered:
            more = np.subtract(_terms(offer.options), terms)
            if np.sum(np.abs(more)) != 1 or np.any(more < 0):
                continue
            try:
                other = estimated(record, offer.n_poles, n_zeros, **offer.options, is_compared=True)
            except EstimationError:
                continue
            lower = present - criterion(other, offer.options["has_offset"], offer.options["has_ramp"])
            if len(other.measured) == len(result.measured) and other.converged and lower > gain:
                best, gain = offer, lower
                if not leaves_doubt(other):
                    return best, gain
        if gain == before or best is None:
            return best, gain
        terms = _terms(best.options)


def _terms(options: Mapping[str, Any]) -> tuple[int, ...]:
    return int(options["n_integrators"]), int(options["has_offset"]), int(options["has_ramp"])


STRONG = 6.0  # difference of BIC, twice the logarithm of the odds: strong evidence (Kass and Raftery 1995)


@dataclass(frozen=True)
class Offer:
    """A structure with terms that another one lacks.

    Attributes
    ----------
    n_poles : int or sequence of int -- beside the integrators
    options : mapping -- of ``estimate_transfer_function``
    arguments : str -- what to ask for
    """

    n_poles: int | Sequence[int]
    options: dict[str, Any]
    arguments: str

    def __str__(self) -> str:
        """Return the terms in words."""
        words = ["no integrator", "an integrator", "two integrators"]
        terms = [words[self.options["n_integrators"]]] if self.options["n_integrators"] else []
        terms += ["an offset"] * bool(self.options["has_offset"])
        terms += ["a drift"] * bool(self.options["has_ramp"])
        count = f"{self.n_poles} pole{'s' if self.n_poles != 1 else ''}"
        *most, last = [count, *terms]
        return f"{', '.join(most)} and {last}" if most else last


def leaves_doubt(result: TransferFunctionResult | MultiInputResult) -> bool:
    """Return whether a fit has anything that a missing integrator, offset or drift may be the cause of."""
    if are_rounding(result.measured, result.residuals):
        return False
    paths = paths_of(result.model)
    return (
        not result.converged
        or not result.whiteness.is_white
        or any(structure_complaint(path) for path in paths)
    )


def offers(
    n_poles: int | Sequence[int], n_zeros: int | Sequence[int], options: Mapping[str, Any]
) -> list[Offer]:
    """Return structures with an integrator, an offset or a drift more; integrators instead of a pole, too.

    Parameters
    ----------
    n_poles, n_zeros : int or sequence of int
    options : mapping -- of ``estimate_transfer_function``
    """
    given = {"n_integrators": 0, "has_offset": False, "has_ramp": False, **options}
    moves = options.get("has_free_response")
    degrees = [n_zeros] if isinstance(n_zeros, int) else list(n_zeros)
    few = [n_poles]
    if isinstance(n_poles, int) and n_poles > 1:
        few.append(n_poles - 1)
    found = []
    for more in range(min(2, _MAX_INTEGRATORS - given["n_integrators"]) + 1):
        for n in few[::-1] if more else few[:1]:  # an integrator instead of a pole before one beside all
            for offset, ramp in ((False, False), (True, False), (True, True)):
                terms = {
                    "n_integrators": given["n_integrators"] + more,
                    "has_offset": given["has_offset"] or offset,
                    "has_ramp": given["has_ramp"] or ramp,
                }
                is_new = any(terms[name] != given[name] for name in terms) or n != n_poles
                most = min([n] if isinstance(n, int) else n) + terms["n_integrators"]
                asked = [f"n_poles={n}"] * (n != n_poles)
                asked += [f"{name}={value}" for name, value in terms.items() if value != given[name]]
                # One quick fit each; what such a record had of motion at first matters less than a term that lacks.
                quick = {"n_starts": 1, "method": "white", "has_free_response": bool(moves)}
                offer = Offer(n, {**options, **terms, **quick}, ", ".join(asked))
                if is_new and max(degrees) <= most and offer not in found:
                    found.append(offer)
    return found


def paths_of(model: TransferFunctionModel | MultiInputModel) -> list[TransferFunctionModel]:
    """Return the transfer function of every input."""
    if isinstance(model, TransferFunctionModel):
        return [model]
    return [model.path(k) for k in range(len(model.input_names))]


@on_one_thread
def estimated(
    record: TimeRecord | Sequence[TimeRecord],
    n_poles: int | Sequence[int],
    n_zeros: int | Sequence[int],
    method: Method = "auto",
    has_offset: bool = False,
    has_ramp: bool = False,
    has_free_response: bool | None = None,
    delay: DelayLike | Sequence[DelayLike] = 0.0,
    input_name: str | None = None,
    output_name: str | None = None,
    cutoff: float | None = None,
    n_integrators: int = 0,
    n_starts: int = FINALISTS + 1,
    inside: Sequence[TransferFunctionModel | MultiInputModel] = (),
    is_compared: bool = False,
) -> TransferFunctionResult | MultiInputResult:
    """Estimate as ``estimate_transfer_function`` does, without a look for terms that the structure lacks.

    ``inside`` are what structures inside this one ended at: the fit begins there, too. ``is_compared`` says that
    only the criterion counts: then nothing is said of the records.
    """
    records = require_records(record)
    _require_settings(method, n_starts, cutoff)
    asked = _Structure.of(
        records[0], n_poles, n_zeros, delay, input_name, output_name, n_integrators, (has_offset, has_ramp)
    )
    if any(prior.is_free for prior in asked.delays) and method in ("srivc", "ivsvf", "lssvf"):
        raise EstimationError(
            f"method {method!r} takes delays as given and one is to be estimated; use 'auto', 'output_error' "
            "or 'rivc'"
        )

    def fit(seen: list[TimeRecord]) -> TransferFunctionResult | MultiInputResult:
        asked.require_data(seen, is_moving=bool(has_free_response))
        still: list[Place] = []

        def attempt(is_moving: bool) -> tuple[OutputErrorProblem, Optimum]:
            problem = asked.problem(seen, is_moving)
            if len(asked.orders) > 1:
                return estimate_additive(problem, method, cutoff)
            known = [_ended(model, asked.delays) for model in inside]
            solved, found = estimate_denominator(
                problem,
                method,
                cutoff,
                n_starts - 1,
                [*still, *known],
                looks_elsewhere=n_starts > FINALISTS and not inside,
            )
            still.append(Place.of(found.state))
            return solved, found

        (problem, optimum), motion = with_initial_motion(
            attempt, lambda found: [found[0].initial_motion(found[1].state)], has_free_response
        )
        if method in ("auto", "output_error"):
            problem, optimum = under_noise_as_it_is(problem, optimum, method)
        elif method == "rivc" or (len(seen) > 1 and method in ("white", "srivc")):
            problem, optimum = refine_with_noise_model(problem, optimum, method, as_it_is=method == "rivc")
        result = _result(problem, optimum, method, n_integrators, asked.output_name, asked.is_several)
        return replace(result, initial_motion=motion, warnings=(*motion.warnings, *result.warnings))

    records, gaps = split_at_gaps(records, 3 * (sum(asked.poles) + 2))
    records, repeated = without_repeated(records, [asked.output_name])
    result, clipped = without_clipped(records, [asked.output_name], fit, _prediction)
    if is_compared:
        return result
    said = (*repeated, *((clipped,) if clipped else ()), *_said_of_records(records, asked, result))
    return replace(result, warnings=gaps + result.warnings + said) if gaps or said else result


def _require_settings(method: str, n_starts: int, cutoff: float | None) -> None:
    """Refuse settings that no record could make sense of."""
    if method not in METHODS:
        raise EstimationError(f"method is {method!r}; expected one of {', '.join(METHODS)}")
    require_whole_number("n_starts", n_starts, 1)
    if cutoff is not None and not (math.isfinite(cutoff) and cutoff > 0.0):
        raise EstimationError(
            f"cutoff is {cutoff}; expected a frequency > 0 in rad/s, or None for a portfolio"
        )


@dataclass(frozen=True, eq=False)
class _Structure:
    """What is to be estimated: from which inputs to which output, with what degrees, delays and other terms.

    Attributes
    ----------
    drives : tuple of str -- the inputs' names
    output_name : str
    poles, zeros : tuple of int -- of every input's path
    has_own_poles : bool -- whether every input has a denominator of its own
    delays : tuple of Prior -- of every input
    n_integrators : int
    drifts : tuple of bool -- whether there is an offset, and a ramp
    is_several : bool -- whether the result is one of several inputs
    """

    drives: tuple[str, ...]
    output_name: str
    poles: tuple[int, ...]
    zeros: tuple[int, ...]
    has_own_poles: bool
    delays: tuple[Prior, ...]
    n_integrators: int
    drifts: tuple[bool, bool]
    is_several: bool

    @staticmethod
    def of(
        record: TimeRecord,
        n_poles: int | Sequence[int],
        n_zeros: int | Sequence[int],
        delay: DelayLike | Sequence[DelayLike],
        input_name: str | None,
        output_name: str | None,
        n_integrators: int,
        drifts: tuple[bool, bool],
    ) -> _Structure:
        """Take the arguments of ``estimate_transfer_function`` for a record.

        Raises
        ------
        EstimationError
            Signals that are not told apart, or impossible degrees.
        """
        require_whole_number("n_integrators", n_integrators, 0, _MAX_INTEGRATORS)
        if output_name is None and len(record.outputs) > 1:
            raise EstimationError(
                f"record {record.name!r} has {len(record.outputs)} outputs; say which one by its name"
            )
        output = record.outputs[0] if output_name is None else record.output(output_name)
        is_several = isinstance(n_zeros, Sequence) and not isinstance(n_zeros, str)
        drives = _drives(record, input_name, is_several)
        zeros, poles = one_each("n_zeros", n_zeros, drives), one_each("n_poles", n_poles, drives)
        for n, m in zip(poles, zeros, strict=True):
            _require_degrees(n, m, n_integrators)
        return _Structure(
            tuple(drives),
            output.name,
            tuple(poles),
            tuple(zeros),
            isinstance(n_poles, Sequence) and not isinstance(n_poles, str),
            tuple(delay_prior(value) for value in one_each("delay", delay, drives)),
            n_integrators,
            drifts,
            is_several,
        )

    @property
    def orders(self) -> tuple[int, ...]:
        """Degrees of the denominators."""
        return self.poles if self.has_own_poles else self.poles[:1]

    def require_data(self, records: Sequence[TimeRecord], is_moving: bool) -> None:
        """Refuse records whose inputs do not reach the output, or rest where nothing else moves it."""
        for one in records:
            for name, prior in zip(self.drives, self.delays, strict=True):
                require_arrival(one.input(name), prior.mean, one.output(self.output_name))
        if not is_moving:
            for name in self.drives:
                require_excitation(records, name)

    def problem(self, records: Sequence[TimeRecord], is_moving: bool) -> OutputErrorProblem:
        """Return the likelihood of records that begin in motion or do not."""
        blocks = list(range(len(self.drives))) if self.has_own_poles else [0] * len(self.drives)
        experiments = [
            RecordShare.of(
                one,
                self.output_name,
                self.drives,
                self.zeros,
                blocks,
                self.delays,
                self.n_integrators,
                is_moving,
            )
            for one in records
        ]
        nuisances = Nuisances(*self.drifts, is_moving).with_integrators(self.n_integrators)
        return OutputErrorProblem(experiments, self.orders, nuisances)


def _drives(record: TimeRecord, input_name: str | None, is_several: bool) -> list[str]:
    """Return the names of the inputs that drive the output."""
    if is_several:
        if input_name is not None:
            raise EstimationError(
                "input_name goes with one number of zeros; a sequence of them takes all inputs"
            )
        return [drive.name for drive in record.inputs]
    if input_name is None and len(record.inputs) > 1:
        raise EstimationError(
            f"record {record.name!r} has {len(record.inputs)} inputs; say which one by its name, or give one "
            "number of zeros for each"
        )
    return [(record.inputs[0] if input_name is None else record.input(input_name)).name]


def _require_degrees(n: int, m: int, n_integrators: int) -> None:
    """Refuse degrees of denominator and numerator that are none, or too high."""
    require_whole_number("n_poles", n, 0)
    require_whole_number("n_zeros", m, 0)
    if n == 0 and n_integrators:
        raise EstimationError(
            f"0 poles beside {n_integrators} at zero; expected n_poles of at least 1, which are those to be "
            "estimated. Without integrators, n_poles=1 finds such a pole near zero, with its deviation; the gain "
            "of an integrator alone is the slope of the output over the input's integral (numpy.polyfit)"
        )
    if not 1 <= n <= _MAX_POLES or not 0 <= m <= n + n_integrators:
        raise EstimationError(
            f"{n} poles and {m} zeros; expected 1 to {_MAX_POLES} poles and no more zeros than poles "
            "(beyond that use the additive modal form: identify())"
        )


def _said_of_records(
    records: Sequence[TimeRecord], asked: _Structure, result: TransferFunctionResult | MultiInputResult
) -> Iterator[str]:
    """Yield what must be known of the records and of what an estimate leaves of them."""
    yield from _input_noise_warnings(records, asked.drives, result)
    pairs = [([one.output(asked.output_name)], [one.input(name) for name in asked.drives]) for one in records]
    for outputs, drives in pairs:
        yield from damage_warnings(outputs, drives)
    if len(asked.drives) > 1:
        return
    yield from _input_misfits(records, asked.drives[0], result)
    if not Whiteness.of(result.residuals).is_white:
        for outputs, (drive,) in pairs:
            yield from clocks_of_record(outputs, drive)


def _ended(model: TransferFunctionModel | MultiInputModel, delays: Sequence[Prior]) -> Place:
    """Return where a model says that its structure ended: poles, and the delays that are free."""
    paths = paths_of(model)
    own = paths[0].denominator
    poles = upper_roots(own[: len(own) - paths[0].n_integrators])
    free = [path.delay for path, prior in zip(paths, delays, strict=True) if prior.is_free]
    return Place(poles, np.array(free))


def _prediction(
    result: TransferFunctionResult | MultiInputResult, record: TimeRecord, name: str
) -> FloatArray:
    """Return what an estimate says at all stamps of an output."""
    del name
    return result.model.predict(record)


def _input_noise_warnings(
    records: Sequence[TimeRecord], drives: Sequence[str], result: TransferFunctionResult | MultiInputResult
) -> Iterator[str]:
    """Yield what noise on a measured input, stated or seen while it stood still, does to an estimate."""
    for place, name in enumerate(drives):
        for record in records:
            drive = record.input(name)
            found = StillNoise.of(drive) if drive.sigma == 0.0 else StillNoise(drive.sigma)
            if not found.sigma:
                continue
            model = result.model.path(place) if isinstance(result.model, MultiInputModel) else result.model
            omegas, zetas = model.modes()[:2]
            grid = noise_grid(omegas / (2.0 * math.pi), zetas, drive)
            response = model.frequency_response(grid)[0][:, None]
            noisy = replace(drive, sigma=found.sigma)
            share = float(input_noise_share(response, grid, noisy, np.array([model.noise_sd]))[0])
            if share > _VISIBLE_SHARE:
                what = (
                    f"It makes up {share:.0%} of the noise of {model.output_name}, and biases this estimator, which "
                    "does not weigh it; identify() does."
                )
                if drive.sigma > 0.0:
                    yield f"Input {name} is stated to have noise of {drive.sigma:.2g} {drive.unit}. {what}"
                else:
                    yield found_noise_warning(drive, found, what)
                break


def _input_misfits(
    records: Sequence[TimeRecord], name: str, result: TransferFunctionResult | MultiInputResult
) -> Iterator[str]:
    """Yield what the residuals say of the only input."""
    model = result.model.path(0) if isinstance(result.model, MultiInputModel) else result.model
    for one, own in zip(records, result.records, strict=True):
        output = one.output(model.output_name)

        def respond(
            drive: InputSignal, times: FloatArray = own.times_s, exposure_s: float = output.exposure_s
        ) -> FloatArray:
            return model.simulate(drive, times, exposure_s)

        part = (own.times_s, own.modelled, own.residuals)
        yield from input_misfit_warnings(model.output_name, one.input(name), part, respond)


Fit = TypeVar("Fit")


def with_initial_motion(
    attempt: Callable[[bool], Fit], tested: Callable[[Fit], list[Tested]], has_free_response: bool | None
) -> tuple[Fit, InitialMotion]:
    """Return an estimate with or without initial motion, as the data or a request will have it.

    Parameters
    ----------
    attempt : callable -- estimates with initial motion, or without
    tested : callable -- of an estimate without, what every output gives to a score test
    has_free_response : bool or None -- a request; None lets the data decide
    """
    if has_free_response:
        return attempt(True), InitialMotion(math.nan, True)
    try:
        still = attempt(False)
    except EstimationError:
        if has_free_response is not None:
            raise
        # Motion that is larger than what the input makes may leave nothing to begin with.
        return attempt(True), InitialMotion.found(0.0)
    p_value = ScoreTest.of(tested(still)).p_value
    left_out = _LEFT_OUT.format(p_value)
    if has_free_response is not None:
        said = (f"{left_out} {_REMEDY}",) if p_value < _LEFT_OUT_LEVEL else ()
        return still, InitialMotion(p_value, warnings=said)
    motion = InitialMotion.found(max(p_value, 1e-300))
    if not motion.is_estimated:
        return still, motion
    try:
        return attempt(True), motion
    except EstimationError as err:
        return still, InitialMotion(p_value, warnings=(f"{left_out} With it: {err}.",))


def one_each(name: str, value: Any, drives: list[str]) -> list[Any]:
    """Return one value for each input."""
    if isinstance(value, Sequence) and not isinstance(value, str):
        if len(value) != len(drives):
            raise EstimationError(
                f"{name} has {len(value)} entries for {len(drives)} inputs ({', '.join(drives)}); expected "
                "one for each"
            )
        return list(value)
    return [value] * len(drives)


def delay_prior(delay: DelayLike) -> Prior:
    """Return what is known of a delay [s] that is given as a time, as a prior or as "estimate"."""
    if isinstance(delay, str):
        if delay != "estimate":
            raise EstimationError(f"delay is {delay!r}; expected a time [s], a Prior, or 'estimate'")
        return Prior(0.0, math.inf)
    if isinstance(delay, bool) or not isinstance(delay, Prior | int | float | np.integer | np.floating):
        raise EstimationError(f"delay is {delay!r}; expected a time [s], a Prior, or 'estimate'")
    prior = delay if isinstance(delay, Prior) else Prior(float(delay))
    if prior.mean < 0.0:
        raise EstimationError(
            f"the delay is {prior.mean} s; expected 0 or more: an output does not precede its input"
        )
    return prior


def _result(
    problem: OutputErrorProblem,
    optimum: Optimum,
    method: Method,
    n_integrators: int,
    output_name: str,
    several: bool,
) -> TransferFunctionResult | MultiInputResult:
    """Collect what an optimum says, in physical units."""
    state = optimum.state
    converged, reason = optimum.converged, optimum.reason
    problem.scale = state.scale
    if not state.responses[0].has_squares:
        state = problem.state(state.theta)
    joint = problem.covariance(state)
    if not joint.condition < 1e14:
        converged, reason = False, "the data do not determine all poles: the information matrix is singular"
    deviance, n_noise = problem.deviance(state)
    n_all = len(state.theta) + len(state.coefficients) + n_noise
    residuals = problem.unweighed_residuals(state)
    records = record_fits(problem, state, joint)
    terms = problem.nuisances
    relative = np.diag(joint.values)[: problem.n_a] / np.maximum(state.theta[: problem.n_a] ** 2, 1e-300)
    sizes = [len(own.measured) for own in records]
    spread = float(np.average([np.var(own.measured) for own in records], weights=sizes))
    figures: dict[str, Any] = {
        "method": method,
        "times_s": problem.times,
        "measured": problem.values,
        "modelled": problem.values - residuals,
        "residuals": residuals,
        "noise_coefficients": records[0].noise_coefficients,
        "scores": pooled_scores([(own.measured, own.residuals) for own in records]),
        "whiteness": Whiteness.of(problem.standardised(state.residuals)),
        "bic": deviance + n_all * math.log(len(problem.values)),
        "yic": math.log(max(float(np.var(residuals)), 1e-300) / max(spread, 1e-300))
        + math.log(max(float(np.mean(relative)), 1e-300)),
        "condition": joint.condition,
        "converged": converged,
        "reason": reason,
        "iterations": optimum.iterations,
        "offset": records[0].offset,
        "ramp": records[0].ramp,
        "records": records,
    }
    noise_sd = pooled_level(records)
    model = physical_model(problem, state, joint.values, n_integrators, noise_sd, output_name)
    signals = [(own.times, own.values) for own in problem.experiments]
    figures["warnings"] = transfer_function_warnings(
        [model.path(k) for k in range(len(problem.paths))],
        records,
        figures["whiteness"],
        is_related(signals, [own.residuals for own in records], n_all, terms.has_offset, terms.has_ramp),
        converged,
        reason,
    )
    if several:
        return MultiInputResult(model=model, **figures)
    return TransferFunctionResult(model=model.path(0), **figures)


def record_fits(
    problem: OutputErrorProblem, state: OutputErrorState, joint: JointCovariance
) -> tuple[RecordFit, ...]:
    """Return the fit of every record at an optimum."""
    residuals, terms = problem.unweighed_residuals(state), problem.nuisances
    fits = []
    for record, (own, part) in enumerate(zip(problem.experiments, problem.rows, strict=True)):
        level, noise = 1.0, None
        if problem.noise is not None:
            level = float(problem.noise.levels[record])
            noise = None if problem.noise.noises is None else problem.noise.noises[record]
        is_plain = noise is None or noise.is_plain
        place = problem.n_numerators + record * problem.n_nuisances
        left = residuals[part]
        fits.append(
            RecordFit(
                name=own.name,
                times_s=own.times,
                measured=own.values,
                modelled=own.values - left,
                residuals=left,
                noise_sd=level * math.sqrt(joint.variance)
                if noise is None or is_plain
                else float(np.std(noise.counted(left))),
                noise_coefficients=np.ones(1) if noise is None else noise.colour.coefficients,
                noise="" if is_plain else str(noise),
                scores=Scores.of(own.values, left),
                whiteness=Whiteness.of(state.residuals[part]),
                offset=float(state.coefficients[place]) if terms.has_offset else 0.0,
                ramp=float(state.coefficients[place + terms.has_offset]) if terms.has_ramp else 0.0,
            )
        )
    return tuple(fits)


def pooled_level(records: Sequence[RecordFit]) -> float:
    """Return the standard deviation of the noise over all samples of all records."""
    if len(records) == 1:
        return records[0].noise_sd
    sizes = [len(own.residuals) for own in records]
    return math.sqrt(float(np.average([own.noise_sd**2 for own in records], weights=sizes)))


def physical_model(
    problem: OutputErrorProblem,
    state: OutputErrorState,
    covariance: FloatArray,
    n_integrators: int,
    noise_sd: float,
    output_name: str,
) -> MultiInputModel:
    """Return the model in physical units, with the covariance of all its parameters.

    Notes
    -----
    In units of the scale w, ``s^p / (s^n + ..)`` is ``w^(n-p) s^p / (s^n + ..)`` in physical ones.
    """
    scale, n_theta = state.scale, len(state.theta)
    source: list[int] = []  # of every physical parameter among theta and the coefficients; -1 is known
    units: list[float] = []
    denominators, numerators = [], []
    for block, n in enumerate(problem.orders):
        powers = scale ** np.arange(1.0, n + 1.0)
        denominators.append(
            np.concatenate([[1.0], state.theta[problem.parts[block]] * powers, np.zeros(n_integrators)])
        )
        source += [*problem.parts[block].tolist(), *[-1] * n_integrators]
        units += [*powers.tolist(), *[1.0] * n_integrators]
    place = n_theta
    for k, path in enumerate(problem.paths):
        descending = np.arange(path.n_zeros, -1, -1)
        factors = scale ** (problem.orders[path.block] - descending.astype(np.float64))
        numerators.append(problem.numerator(state, k)[::-1] * factors)
        source += (place + descending).tolist()
        units += factors.tolist()
        place += path.n_zeros + 1
    for k in range(len(problem.paths)):
        source.append(problem.n_a + problem.free_delays.index(k) if k in problem.free_delays else -1)
        units.append(1.0)
    index = np.array(source)
    taken = covariance[np.ix_(index, index)] * np.outer(units, units)
    taken[index < 0, :] = 0.0
    taken[:, index < 0] = 0.0
    return MultiInputModel(
        numerators=tuple(numerators),
        denominators=tuple(denominators),
        delays=tuple(float(delay) for delay in problem.delays(state.theta)),
        covariance=taken,
        noise_sd=noise_sd,
        input_names=tuple(path.name for path in problem.paths),
        output_name=output_name,
    )
