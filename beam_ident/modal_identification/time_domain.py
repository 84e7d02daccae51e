"""Identify a modal model from records, without hints: what is asked for, and what is known of it."""

from __future__ import annotations

import contextlib
import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

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
from beam_ident.errors import EstimationError
from beam_ident.modal.identification_result import IdentificationResult
from beam_ident.modal.regression import farthest_latency
from beam_ident.modal.structure import ModalStructure, StructureKind, kinds_by_units
from beam_ident.modal_estimation.free_base import with_kind_of
from beam_ident.modal_estimation.mode_search import (
    MAX_MODES,
    checked_limit,
    silent,
)
from beam_ident.modal_identification.coarse_delays import coarse_delays
from beam_ident.modal_identification.identification_task import IdentificationTask
from beam_ident.modal_identification.unseen_noise import Leftover, unseen_noise
from beam_ident.numerics.blas_threads import on_one_thread
from beam_ident.sensing.blows import without_noise_between_blows
from beam_ident.sensing.damage import damage_warnings, without_repeated
from beam_ident.sensing.quantisation import without_clipped
from beam_ident.sensing.still_noise import StillNoise, with_found_noise

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
    records = require_records(record, may_lack_outputs=True, takes_low_passes=True)
    drives = chosen_inputs(records[0], input_name)
    if structure is None:
        outputs = [output.unit for one in records for output in one.outputs]
        return with_kind_of(
            kinds_by_units([drive.unit for drive in drives], outputs),
            lambda kind: identify(
                records, kind, n_modes, latency, clock_rate, input_name, max_modes, progress
            ),
        )
    input_names = tuple(drive.name for drive in drives)
    terms = structure if isinstance(structure, ModalStructure) else ModalStructure(structure)
    checked_limit(n_modes, max_modes)
    names = list(dict.fromkeys(name for one in records for name in one.output_names))
    own_latencies, latency = _own_priors("latency", latency, names)
    farthest = farthest_latency([one.input(drive.name) for one in records for drive in drives])

    def about(late_s: float, sd: float) -> IdentificationResult:
        """A clock is looked for about 0, as far as the input is continued beyond its ends."""
        near = [_earlier(one, late_s) for one in records]
        found = identify(
            near, structure, n_modes, Prior(0.0, sd), clock_rate, input_name, max_modes, progress
        )
        return found.with_later_stamps(late_s)

    if latency is not None and latency.mean and abs(latency.mean) + _FAR_SD * latency.sd > farthest:
        return about(latency.mean, latency.sd)
    own_rates_known, clock_rate = _own_priors("clock_rate", clock_rate, names)
    if terms.is_test and any(_jumps_into(terms, own, input_names) for own in records):
        terms = replace(terms, has_residual=False)
    for one in records:
        for drive in chosen_inputs(one, input_names):
            require_input(drive, is_needed=False)
    records, noisy_blows = (
        without_noise_between_blows(records, input_names) if terms.is_test else (records, "")
    )
    records, repeated = without_repeated(records, names)
    records, found = with_found_noise(records, input_names)
    latency = latency or (Prior() if terms.is_test else LATENCY_PRIOR)
    clock_rate = clock_rate or (Prior() if terms.is_test else CLOCK_RATE_PRIOR)
    if not set(names) - set(own_latencies):  # nothing is left that could be in common
        latency = Prior()
    if not set(names) - set(own_rates_known):
        clock_rate = Prior()
    late = {}
    if latency.sd >= farthest and len(drives) == 1 and not own_latencies:
        late = coarse_delays(records, input_names[0], _BEGINS_FAR * farthest)
    common = min(late.values(), key=abs, default=0.0)
    if abs(common) > _BEGINS_FAR * farthest:
        with contextlib.suppress(EstimationError):
            return about(common, farthest)
    task = IdentificationTask(
        terms,
        may_rest=not isinstance(structure, ModalStructure) and not terms.is_motion,
        n_modes=n_modes,
        max_modes=max_modes,
        latency=latency,
        clock_rate=clock_rate,
        input_names=input_names,
        progress=progress or silent,
        found_noise=found,
        own_latencies=own_latencies,
        own_rates=own_rates_known,
    )
    apart = {name: OwnClock(delay - common) for name, delay in late.items()}
    apart = {name: own for name, own in apart.items() if abs(own.delay) > _BEGINS_FAR * farthest}
    if apart:
        # As if they had been stamped with the others, which says by how much more or less they are late.
        with contextlib.suppress(EstimationError):
            found_there = task.result([on_common_clock(one, apart) for one in records]).model.own_clocks
            clocks = {
                name: found_there.get(name, OwnClock()).moved(own.delay, 0.0) for name, own in apart.items()
            }
            task = replace(task, first_clocks={**found_there, **clocks})
    damage = [text for one in records for text in damage_warnings(one.outputs, one.inputs)]
    try:
        result, said = without_clipped(
            records, names, functools.partial(_with_unseen_noise, task), _prediction
        )
    except EstimationError as err:
        if not damage:
            raise
        raise EstimationError(f"{err}. {' '.join(damage)}") from err
    doubts = [text for text in (*repeated, said, noisy_blows) if text]
    if latency.is_free and abs(result.model.latency) > _AT_THE_END * farthest:
        doubts.append(_TOO_LATE.format(result.model.latency, farthest))
    doubts += damage
    return replace(result, warnings=(*result.warnings, *doubts)) if doubts else result


def _with_unseen_noise(task: IdentificationTask, records: list[TimeRecord]) -> IdentificationResult:
    """Return what a task finds, weighed by noise of the input that only the outputs show, where they do."""
    result = task.result(records)
    if len(task.input_names) > 1 or not (result.converged and result.band.is_excited):
        return result
    drives = [one.input(task.input_names[0]) for one in records]
    if any(drive.sigma > 0.0 for drive in drives) or all(own.whiteness.is_white for own in result.outputs):
        return result
    leftovers = []
    for place, own in enumerate(result.outputs):
        seen = [k for k, one in enumerate(records) if own.name in one.output_names]
        if len(seen) != len(own.records):
            return result
        late = result.model.latency + float(result.model.output_delays[place])
        for k, part in zip(seen, own.records, strict=True):
            output = records[k].output(own.name)
            low_pass = result.model.low_passes.get(own.name, output.low_pass)
            drive = drives[k].seen_through(low_pass)
            leftovers.append(Leftover(place, part.times_s - late, part.residuals, output.exposure_s, drive))
    noise = StillNoise(unseen_noise(result.model, leftovers), is_behind=True)
    if not noise.sigma > 0.0:
        return result
    noisy = [
        replace(
            one, inputs=tuple(replace(own, sigma=noise.sigma) if own is drive else own for own in one.inputs)
        )
        for one, drive in zip(records, drives, strict=True)
    ]
    found_noise = dict.fromkeys(range(len(records)), noise)
    with contextlib.suppress(EstimationError):
        weighed = replace(task, found_noise=found_noise).result(noisy)
        if weighed.converged:
            return weighed
    return result


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
