"""Identify a modal model from records, without hints: what is asked for, and what is known of it."""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.data.argument_checks import (
    chosen_inputs,
    require_input,
    require_records,
)
from beam_ident.data.batches import Progress
from beam_ident.data.own_clocks import OwnClock, on_common_clock
from beam_ident.data.prior import Prior
from beam_ident.data.records import TimeRecord
from beam_ident.errors import EstimationError, IdentificationError
from beam_ident.modal.identification_result import IdentificationResult
from beam_ident.modal.regression import farthest_latency
from beam_ident.modal.structure import ModalStructure, StructureKind, kinds_by_units
from beam_ident.modal_estimation.free_base import with_kind_of
from beam_ident.modal_estimation.mode_search import (
    MAX_MODES,
    checked_limit,
    silent,
)
from beam_ident.modal_identification.change_moves import ModeChanges
from beam_ident.modal_identification.clock_jump_moves import ClockJumps
from beam_ident.modal_identification.clock_moves import IdleClocks, OwnClockSteps, SensorLowPasses
from beam_ident.modal_identification.coarse_delays import coarse_delays
from beam_ident.modal_identification.conditions import Conditions
from beam_ident.modal_identification.estimation import End, IdentificationTask
from beam_ident.modal_identification.noise_moves import OutlierMask, UnseenInputNoise
from beam_ident.modal_identification.search_moves import explored
from beam_ident.numerics.blas_threads import on_one_thread
from beam_ident.sensing.blows import without_noise_between_blows
from beam_ident.sensing.damage import damage_warnings, without_repeated
from beam_ident.sensing.quantisation import without_clipped
from beam_ident.sensing.still_noise import with_found_noise


@dataclass(frozen=True, eq=False)
class Reached:
    """Where a search ended, and what it was asked for."""

    asked: IdentificationTask
    end: End


LATENCY_PRIOR = Prior(0.0, math.inf)
CLOCK_RATE_PRIOR = Prior(0.0, 50e-6)
_FAR_SD = 5.0  # standard deviations of a prior that are searched
_BEGINS_FAR = 0.75  # of the latencies that are searched: from here on the search begins elsewhere
_AT_THE_END = 0.98  # of the latencies that are searched
_TOO_LATE = (
    "The latency ends at {:.4g} s, where the search does, which looks {:g} s to either side: the stamps may be "
    "later, and the poles bent by that. Give what is known, as latency=Prior(0.5, 0.1)."
)


@on_one_thread
def identify(
    record: TimeRecord | Sequence[TimeRecord],
    structure: StructureKind | ModalStructure | None = None,
    n_modes: int | None = None,
    latency: Prior | Mapping[str, Prior | float] | None = None,
    clock_rate: Prior | Mapping[str, Prior | float] | None = None,
    input_name: str | Sequence[str] | None = None,
    max_modes: int = MAX_MODES,
    progress: Progress | None = None,
) -> IdentificationResult:
    """Identify a modal model with poles common to all outputs.

    Parameters
    ----------
    record : TimeRecord or sequence of TimeRecord
        One experiment, or several that share the model.  Every output weighs in each by the level, the colour
        and the outliers of its noise there; where noise on the input matters, by the level.  An input that is
        measured and states no ``sigma`` has that which its rest shows.
    structure : str, ModalStructure or None
        Which model goes with the input, or with every input; None goes by the units: "base_motion" for a hub position
        [m], and for a force [N] on what may be free or held whichever the data show, "force" or "receptance".
    n_modes : int or None
        Number of modes; None lets the Bayesian information criterion decide.
    latency, clock_rate : Prior, mapping or None
        Knowledge about the outputs' clock against the input's: latency [s] and relative
        rate.  ``Prior(mean, 0)`` fixes them, ``Prior(0, inf)`` leaves them to the data: a latency of one input is
        found up to half of the record.
        None is an unknown latency and a rate of 0 +- 50 ppm, as of a camera beside an axis;
        for a receptance, mobility or accelerance, whose signals commonly share a clock, it is no error at all.
        A mapping from the names of some outputs to a Prior, or to a number that is known, is of their own clocks
        (a laser beside a camera); of what all others share it says nothing.
    input_name : str, sequence of str or None
        Which input, or which inputs together; None takes all that the records have.  Inputs share the poles and
        the clock; each has gains, residual terms, residues and a hold of its own (``ModalModel.path``).
    max_modes : int
        Bound on the modes tried when ``n_modes`` is None.
    progress : callable or None
        Called with a phrase and the share done, between 0 and 1.  A TimeoutError that it raises ends the
        estimation, as Ctrl-C does and too little memory: once there is a mode, the model so far is returned,
        not converged, and ``reason`` says what is missing.

    Returns
    -------
    IdentificationResult

    Raises
    ------
    EstimationError
        A record from which nothing can be identified: too few samples for the order,
        a constant output, an input and outputs at rest, an impossible order, no such input, no such output.
    """
    asked = (structure, n_modes, latency, clock_rate, input_name, max_modes, progress)
    return identified(record, *asked, ends=[])


def identified(
    record: TimeRecord | Sequence[TimeRecord],
    structure: StructureKind | ModalStructure | None,
    n_modes: int | None,
    latency: Prior | Mapping[str, Prior | float] | None,
    clock_rate: Prior | Mapping[str, Prior | float] | None,
    input_name: str | Sequence[str] | None,
    max_modes: int,
    progress: Progress | None,
    ends: list[Reached],
) -> IdentificationResult:
    """Identify as ``identify`` does, and keep where the searches ended in ``ends``."""
    records = require_records(record, may_lack_outputs=True, takes_low_passes=True)
    drives = chosen_inputs(records[0], input_name)
    asked_latency = latency

    def again(
        kind: StructureKind | ModalStructure, by_s: float = 0.0, latency: Prior | None = None
    ) -> IdentificationResult:
        """Identify with another structure, or with stamps that are earlier by a time [s]."""
        moved = [_earlier(one, by_s) for one in records]
        prior = asked_latency if latency is None else latency
        found = identified(moved, kind, n_modes, prior, clock_rate, input_name, max_modes, progress, ends)
        return found.with_later_stamps(by_s)

    if structure is None:
        units = [output.unit for one in records for output in one.outputs]
        return with_kind_of(kinds_by_units([drive.unit for drive in drives], units), again)
    input_names = tuple(drive.name for drive in drives)
    terms = structure if isinstance(structure, ModalStructure) else ModalStructure(structure)
    checked_limit(n_modes, max_modes)
    names = list(dict.fromkeys(name for one in records for name in one.output_names))
    own_latencies, common = _own_priors("latency", latency, names)
    # A clock is looked for about 0, as far as the input is continued beyond its ends.
    farthest = farthest_latency([one.input(drive.name) for one in records for drive in drives])
    if common is not None and common.mean and abs(common.mean) + _FAR_SD * common.sd > farthest:
        return again(structure, common.mean, Prior(0.0, common.sd))
    own_rates, rate = _own_priors("clock_rate", clock_rate, names)
    conditions, said = _prepared(records, terms, names, input_names)
    asked = IdentificationTask(
        input_names,
        n_modes,
        max_modes,
        _in_common(common, Prior() if terms.is_test else LATENCY_PRIOR, own_latencies, names),
        _in_common(rate, Prior() if terms.is_test else CLOCK_RATE_PRIOR, own_rates, names),
        progress or silent,
        own_latencies,
        own_rates,
        may_rest=not isinstance(structure, ModalStructure) and not terms.is_motion,
    )
    late = _far_delays(asked, conditions, farthest)
    least = min(late.values(), key=abs, default=0.0)
    if abs(least) > _BEGINS_FAR * farthest:
        with contextlib.suppress(EstimationError):
            return again(structure, least, Prior(0.0, farthest))
    apart = {name: delay - least for name, delay in late.items()}
    apart = {name: delay for name, delay in apart.items() if abs(delay) > _BEGINS_FAR * farthest}
    result = _searched(asked, _far_apart(asked, conditions, apart), names, said, ends)
    if not asked.latency.is_free or abs(result.model.latency) <= _AT_THE_END * farthest:
        return result
    return replace(result, warnings=(*result.warnings, _TOO_LATE.format(result.model.latency, farthest)))


def _searched(
    asked: IdentificationTask,
    conditions: Conditions,
    names: Sequence[str],
    said: Sequence[str],
    ends: list[Reached],
) -> IdentificationResult:
    """Return what a search finds, without clipped samples, and with what is known of the records before it."""
    damage = [text for one in conditions.measured for text in damage_warnings(one.outputs, one.inputs)]

    def result_of(measured: Sequence[TimeRecord]) -> IdentificationResult:
        ends.append(Reached(asked, _explored(asked, replace(conditions, measured=measured))))
        return ends[-1].end.result

    try:
        result, clipped = without_clipped(
            list(conditions.measured),
            names,
            result_of,
            _prediction,
        )
    except EstimationError as err:
        if not damage:
            raise
        raise EstimationError(f"{err}. {' '.join(damage)}") from err
    doubts = [text for text in (*said, clipped, *damage) if text]
    return replace(result, warnings=(*result.warnings, *doubts)) if doubts else result


def refitted(reached: Reached, records: Sequence[TimeRecord], clock_rate: Prior | None) -> Reached:
    """Return where the modes of an end go on records that have grown since, under the same conditions.

    Parameters
    ----------
    reached : Reached -- on the same records, shorter
    records : sequence of TimeRecord -- as they are now
    clock_rate : Prior or None -- what is known of it by now; None: nothing else

    Raises
    ------
    EstimationError
        They cannot be fitted any more.
    """
    end, asked = reached.end, reached.asked
    known = end.conditions.measured
    names = list(dict.fromkeys(name for one in records for name in one.output_names))
    present = [
        own if before is None else own.from_instant(before.start_ns)
        for own, before in itertools.zip_longest(records, known)
    ]
    prepared, _ = _prepared(present, end.conditions.terms, names, asked.input_names)
    conditions = replace(
        end.conditions,
        measured=[
            _without_masked(own, before) for own, before in itertools.zip_longest(prepared.measured, known)
        ],
        found_noise=prepared.found_noise,
        start=end.weighed.fit,
    )
    asked = replace(asked, n_modes=len(end.weighed.fit.omegas), clock_rate=clock_rate or asked.clock_rate)
    return Reached(asked, asked.end(conditions, after=end))


def _without_masked(record: TimeRecord, known: TimeRecord | None) -> TimeRecord:
    """Return a record without the samples that did not count while it was shorter."""
    if known is None:
        return record
    # To the nanosecond: an origin that has moved leaves a rounding.
    masked = {own.name: np.rint(1e9 * own.times_s[~own.is_valid]) for own in known.outputs}
    outputs = tuple(
        replace(
            own,
            values=np.where(
                np.isin(np.rint(1e9 * own.times_s), masked.get(own.name, ())), np.nan, own.values
            ),
        )
        for own in record.outputs
    )
    return replace(record, outputs=outputs)


def _far_delays(asked: IdentificationTask, conditions: Conditions, farthest: float) -> dict[str, float]:
    """Return how late outputs are as phases alone say, where nothing is known of it [s]."""
    if asked.latency.sd < farthest or len(asked.input_names) > 1 or asked.own_latencies:
        return {}
    near_s, power = _BEGINS_FAR * farthest, conditions.terms.driving_power
    return coarse_delays(conditions.measured, asked.input_names[0], near_s, power)


def _prepared(
    records: list[TimeRecord], terms: ModalStructure, names: Sequence[str], input_names: tuple[str, ...]
) -> tuple[Conditions, list[str]]:
    """Return what is believed of records before any fit, and what must be known of it."""
    if terms.is_test and any(_jumps_into(terms, own, input_names) for own in records):
        terms = replace(terms, has_residual=False)
    for one in records:
        for drive in chosen_inputs(one, input_names):
            require_input(drive, is_needed=False)
    noisy_blows = ""
    if terms.is_test:
        records, noisy_blows = without_noise_between_blows(records, input_names)
    records, repeated = without_repeated(records, names)
    records, found_noise = with_found_noise(records, input_names)
    return Conditions(records, terms, found_noise=found_noise), [*repeated, noisy_blows]


def _in_common(
    prior: Prior | None, default: Prior, known: Mapping[str, Prior], names: Sequence[str]
) -> Prior:
    """Return what is known of the clock in common; nothing is left of it where all outputs' own is known."""
    return (prior or default) if set(names) - set(known) else Prior()


def _explored(asked: IdentificationTask, conditions: Conditions) -> End:
    """Return where the search ends, with jumps of clocks where some are likely and it can be made with them."""
    jumps = ClockJumps(asked)
    if likely := jumps.likely(conditions):
        with contextlib.suppress(EstimationError):
            return _explored_on(asked, replace(conditions, jumps=likely), jumps)
    return _explored_on(asked, conditions, jumps)


def _explored_on(asked: IdentificationTask, conditions: Conditions, jumps: ClockJumps) -> End:
    """Return where the search ends that begins on clocks with some jumps, or none."""
    clocks = {**conditions.clocks, **_known_clocks(asked, conditions)}
    steps = OwnClockSteps(len(conditions.measured[0].outputs))
    moves = (
        ModeChanges(),
        steps,
        SensorLowPasses(steps),
        IdleClocks(),
        OutlierMask(),
        jumps,
        UnseenInputNoise(),
    )
    return explored(asked.end, replace(conditions, clocks=clocks), moves)


def _known_clocks(asked: IdentificationTask, conditions: Conditions) -> dict[str, OwnClock]:
    """Return the clocks that outputs are known to have against that which the others share."""
    known = {*asked.own_latencies, *asked.own_rates}
    if not known:
        return {}
    latency, rate = asked.latency.mean, asked.clock_rate.mean
    rest = [
        one.select(left)
        for one in conditions.steady
        if (left := [name for name in one.output_names if name not in known])
    ]
    if len(rest) == len(conditions.steady):
        with contextlib.suppress(IdentificationError):
            shared = replace(asked, own_latencies={}, own_rates={})
            model = _explored(shared, replace(conditions, measured=rest, jumps=())).result.model
            latency, rate = model.latency, model.clock_rate
    return {
        name: OwnClock(
            asked.own_latencies[name].mean - latency if name in asked.own_latencies else 0.0,
            asked.own_rates[name].mean - rate if name in asked.own_rates else 0.0,
            name in asked.own_rates,
        )
        for name in known
    }


def _far_apart(asked: IdentificationTask, conditions: Conditions, apart: Mapping[str, float]) -> Conditions:
    """Return conditions of outputs that are later than others by more than a search looks [s].

    As if they had been stamped with the others, which says by how much more or less they are late.
    """
    if not apart:
        return conditions
    far = {name: OwnClock(delay) for name, delay in apart.items()}
    there = [on_common_clock(one, far) for one in conditions.measured]
    with contextlib.suppress(EstimationError):
        found = _explored(asked, replace(conditions, measured=there)).result.model.own_clocks
        clocks = {name: found.get(name, OwnClock()).moved(delay, 0.0) for name, delay in apart.items()}
        return replace(conditions, clocks={**found, **clocks})
    return conditions


def _jumps_into(structure: ModalStructure, record: TimeRecord, input_names: Sequence[str]) -> bool:
    """Return whether a held input jumps where the residual term would differentiate it: to nothing at a sample."""
    drives = chosen_inputs(record, input_names)
    return structure.differentiations > 0 and any(drive.hold == "zoh" for drive in drives)


def _earlier(record: TimeRecord, by_s: float) -> TimeRecord:
    """Return a record whose outputs' stamps are earlier by a time [s]."""
    return replace(record, outputs=tuple(replace(o, times_s=o.times_s - by_s) for o in record.outputs))


def _own_priors(
    what: str, given: Prior | Mapping[str, Prior | float] | None, names: Sequence[str]
) -> tuple[dict[str, Prior], Prior | None]:
    """Return what is known of single outputs, by name, and of the clock in common."""
    if given is None or isinstance(given, Prior):
        return {}, given
    if not isinstance(given, Mapping):
        raise EstimationError(
            f"{what} is {given!r}; expected a Prior, as Prior({given!r}) for a known one, or a mapping from names of "
            "outputs to such"
        )
    strangers = [name for name in given if name not in names]
    if strangers:
        raise EstimationError(
            f"{what} names {', '.join(map(repr, strangers))}, and the records have the outputs {', '.join(names)}; "
            "expected names of outputs"
        )
    found = {}
    for name, value in given.items():
        if isinstance(value, bool) or not isinstance(value, Prior | float | int):
            raise EstimationError(f"{what} of {name} is {value!r}; expected a number or a Prior")
        prior = value if isinstance(value, Prior) else Prior(float(value))
        if prior.sd < math.inf:  # else the data find it by themselves
            found[name] = prior
    return found, None


def _prediction(result: IdentificationResult, record: TimeRecord, name: str) -> FloatArray:
    """Return what a model says at the stamps of an output, from rest and with an offset; NaN outside the input."""
    model = result.model
    output = record.output(name)
    low_pass = model.low_passes.get(name, output.low_pass)
    drives = [drive.seen_through(low_pass) for drive in chosen_inputs(record, model.input_names)]
    first, last = max(drive.span_s[0] for drive in drives), min(drive.span_s[1] for drive in drives)
    late = model.latency + float(model.output_delays[model.output_names.index(name)])
    inside = output.is_within(first + max(late, 0.0), last + min(late, 0.0))
    said = np.full(len(inside), np.nan)
    if np.any(inside):
        simulated = model.simulate(drives, output.times_s[inside] - late, output.exposure_s)
        said[inside] = simulated[:, model.output_names.index(name)]
        said += float(np.nanmedian(output.values - said))
    return said
