"""Which degrees a transfer function needs: the table of orders, and a choice.

Every structure is estimated, from one start and, where that may have led to a local optimum, from
several.  All are listed with the figures that the literature tabulates (R_T^2, YIC, AIC, BIC,
FIT, condition, convergence).  The choice is made by BIC among the structures that pass the
gates: the fit converged, every pole is known well enough to mean something, and no pole is
cancelled by a zero within their uncertainty.  Where what the best one leaves has a colour or outliers, all are
estimated and compared under the noise as it is.  YIC is shown because it is customary; for lightly
damped modes it picks orders that are too low, and decides nothing here.

Of several inputs all have numerators of one degree at first; around the best structure each is then given its own.
Where the best one leaves doubts, structures with integrators, an offset or a drift more are tried beside it.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from beam_ident.data.argument_checks import require_excitation, require_records, require_whole_number
from beam_ident.data.batches import Progress, map_records
from beam_ident.data.records import TimeRecord
from beam_ident.errors import EstimationError
from beam_ident.noise.noise_model import RecordNoise
from beam_ident.noise.scores import are_rounding
from beam_ident.transfer_function.model import TransferFunctionModel
from beam_ident.transfer_function.multi_input_model import MultiInputModel
from beam_ident.transfer_function.structure_gates import UNRELATED, structure_complaint
from beam_ident.transfer_function_estimation.estimation import (
    InitialMotion,
    MultiInputResult,
    TransferFunctionResult,
    estimated,
    leaves_doubt,
    offers,
    paths_of,
)
from beam_ident.transfer_function_estimation.record_share import Nuisances
from beam_ident.transfer_function_estimation.srivc import WHITE

_FIRST_PART = 0.7  # of the progress: one start for every structure
_VISIBLE = 1.0  # of -2 log-likelihood
_NEAR = 2  # parameters
_TERMS = ("n_integrators", "has_offset", "has_ramp")
_FAR = 10.0  # difference of BIC: very strong evidence (Kass and Raftery 1995)
_VISIBLE_FIT = 1.0  # percent: a model that simulates worse by more than that lacks something
_STARTS = 2  # of a structure that may have ended in a local optimum: a subspace, and the best filter

_NEEDED = (
    "{0.n_poles}/{0.n_zeros} was chosen although {0.refused_because}: do not rely on that pole. Without it the data "
    "are explained far worse: the best structure with poles that are all known is {1.n_poles}/{1.n_zeros}, FIT "
    "{1.fit_percent:.1f} % against {0.fit_percent:.1f} %. Excite more, record longer, or name what is known, such as "
    "n_integrators."
)
_LEFT_BEHIND = (
    "{0.n_poles}/{0.n_zeros} explains the data far better than the chosen structure (R_T^2 {0.r_squared:.5f} against "
    "{1.r_squared:.5f}), but was refused: {0.refused_because}. What is chosen lacks something: try other degrees, "
    "n_integrators=1 or has_offset=True, or record longer."
)

Degrees = tuple[int, int | tuple[int, ...]]  # of the denominator, and of the numerators
Outcome = TransferFunctionResult | MultiInputResult | str  # why there is no result


@dataclass(frozen=True)
class StructureEntry:
    """One line of the table of orders.

    Attributes
    ----------
    n_poles : int -- beside integrators
    n_zeros : int, or tuple of int with one for each of several inputs
    r_squared, fit_percent, yic, aic, bic, condition : float -- NaN where the estimation failed
    converged : bool
    refused_because : str -- empty when the structure passed all gates
    is_chosen : bool
    n_integrators : int
    has_offset, has_ramp : bool
    """

    n_poles: int
    n_zeros: int | tuple[int, ...]
    r_squared: float
    fit_percent: float
    yic: float
    aic: float
    bic: float
    condition: float
    converged: bool
    refused_because: str
    is_chosen: bool = False
    n_integrators: int = 0
    has_offset: bool = False
    has_ramp: bool = False


@dataclass(frozen=True, eq=False)
class OrderSelection:
    """The table of orders and the chosen estimate.

    Attributes
    ----------
    table : tuple of StructureEntry -- best BIC first
    chosen : TransferFunctionResult, or MultiInputResult of several inputs
    """

    table: tuple[StructureEntry, ...]
    chosen: TransferFunctionResult | MultiInputResult

    def __str__(self) -> str:
        """Return the table as text, a line for every structure, the chosen one marked by an arrow."""
        heads = ("poles", "zeros", "R_T^2", "YIC", "FIT %", "AIC", "BIC", "condition", "converged", "also")
        lines = ["   " + " ".join(f"{head:>10}" for head in heads) + "  refused because"]
        for e in self.table:
            figures = (
                f"{e.n_poles:d}",
                f"{e.n_zeros:d}" if isinstance(e.n_zeros, int) else ",".join(map(str, e.n_zeros)),
                f"{e.r_squared:.5f}",
                f"{e.yic:.2f}",
                f"{e.fit_percent:.2f}",
                f"{e.aic:.1f}",
                f"{e.bic:.1f}",
                f"{e.condition:.1e}",
                "yes" if e.converged else "no",
                # Integrators, offset and drift, as 1/s, c and t.
                "".join(["1/s "] * e.n_integrators + ["c "] * e.has_offset + ["t"] * e.has_ramp).strip()
                or "-",
            )
            mark = "-> " if e.is_chosen else "   "
            lines.append(mark + " ".join(f"{f:>10}" for f in figures) + f"  {e.refused_because}".rstrip())
        return "\n".join(lines)


def select_transfer_function(
    record: TimeRecord | Sequence[TimeRecord],
    n_poles: Iterable[int] = range(1, 7),
    n_zeros: Iterable[int] | None = None,
    n_workers: int = 1,
    progress: Progress | None = None,
    scheduler: str | None = None,
    degrees: Iterable[tuple[int, int]] | None = None,
    **options: Any,
) -> OrderSelection:
    """Estimate all structures of a range and choose one.

    Parameters
    ----------
    record : TimeRecord or sequence of TimeRecord
        One experiment, or several that share the structure and the model.
    n_poles : iterable of int -- degrees of the denominator
    n_zeros : iterable of int or None
        Degrees of the numerator, or of that of every input; None takes all below the denominator's,
        and as many where none of these passes.
    n_workers : int -- processes to spread the estimates over; 1 stays in this one
    progress : callable or None -- called with a phrase and the share done
    scheduler : str or None -- address of a Dask cluster that does the work instead; see ``map_records``
    degrees : iterable of (n_poles, n_zeros) or None -- these pairs instead of all of the two ranges
    **options
        Handed to ``estimate_transfer_function``, such as ``has_offset``.  Where ``has_free_response`` is left
        out, the best structure without initial motion tells whether all are estimated with it.  Where
        ``n_integrators`` is left out, integrators, an offset and a drift are tried where the best structure without
        leaves doubts; what is chosen for them stands in the table and in a warning.

    Raises
    ------
    EstimationError
        An empty range, no structure that passes the gates, or no cluster where one was named.
    """
    records, given = require_records(record), dict(options)
    n_inputs = 1 if options.get("input_name") is not None else len(records[0].inputs)
    structures, zeros = _asked_for(n_poles, n_zeros, degrees, n_inputs)
    asks = options.get("has_free_response") is None
    if asks:
        for drive in records[0].inputs:
            if options.get("input_name") in (None, drive.name):
                require_excitation(records, drive.name)
    results, options, motion = _all_under_their_noise(
        records, structures, options, n_workers, scheduler, progress
    )
    if n_inputs > 1:
        structures, results = _with_own_degrees(records, structures, results, options, zeros)
    entries = [_entry(n, m, outcome, options) for (n, m), outcome in zip(structures, results, strict=True)]
    offered = False
    if "n_integrators" not in options:
        entries, results, offered = _with_offers(records, structures, results, entries, options, asks)
    if all(entry.refused_because for entry in entries):
        if zeros is None:
            # What answers at once, as an acceleration under a force, has as many zeros as poles.
            at_once = sorted({(n, n) for n, _ in structures})
            with contextlib.suppress(EstimationError):
                other = select_transfer_function(records, n_workers=n_workers, degrees=at_once, **given)
                return replace(other, table=_ordered([*other.table, *entries]))
        reasons = "; ".join(f"{e.n_poles}/{e.n_zeros}: {e.refused_because}" for e in entries[:4])
        raise EstimationError(
            f"none of {len(entries)} structures passes the gates ({reasons}). Excite more, or record longer"
        )
    best, said = _best(entries, results)
    entries[best] = replace(entries[best], refused_because="", is_chosen=True)
    chosen = results[best]
    assert not isinstance(chosen, str)
    if offered and (terms := _terms(entries[best], options)):
        said = [f"Chosen with {terms}, which BIC prefers.", *said]
    own = chosen.initial_motion
    if motion.is_estimated and own.is_estimated and math.isnan(own.p_value):
        chosen = replace(chosen, initial_motion=motion)
        said = [*motion.warnings, *said]
    if said:
        chosen = replace(chosen, warnings=(*said, *chosen.warnings))
    return OrderSelection(_ordered(entries), chosen)


def _asked_for(
    n_poles: Iterable[int],
    n_zeros: Iterable[int] | None,
    degrees: Iterable[tuple[int, int]] | None,
    n_inputs: int,
) -> tuple[list[Degrees], list[int] | None]:
    """Return the structures to be tried, and the degrees of numerators among which to choose, None for all.

    Raises
    ------
    EstimationError
        What is no range of whole numbers, or an empty one.
    """
    if not isinstance(n_poles, Iterable) or not (n_zeros is None or isinstance(n_zeros, Iterable)):
        raise EstimationError(
            f"n_poles is {n_poles!r} and n_zeros {n_zeros!r}; expected ranges or lists to choose from, as "
            "range(1, 7) (estimate_transfer_function() takes one number of each)"
        )
    if degrees is not None:
        pairs = [(n, m) for n, m in degrees]
        n_poles, n_zeros = ([pair[k] for pair in pairs] for k in range(2))
    poles, zeros = list(n_poles), None if n_zeros is None else list(n_zeros)
    for name, own in (("n_poles", poles), ("n_zeros", zeros or [])):
        for degree in own:
            require_whole_number(f"a degree in {name}", degree, 0)
    if degrees is None:
        pairs = [(n, m) for n in poles for m in (range(n) if zeros is None else zeros)]
    structures: list[Degrees] = [
        (n, m if n_inputs == 1 else (m,) * n_inputs) for n, m in pairs if 0 <= m <= n
    ]
    if not structures:
        raise EstimationError(
            "no structure to try; give at least one number of poles with no more zeros than poles"
        )
    return structures, zeros


def _all_under_their_noise(
    records: Sequence[TimeRecord],
    structures: list[Degrees],
    options: dict[str, Any],
    n_workers: int,
    scheduler: str | None,
    progress: Progress | None,
) -> tuple[list[Outcome], dict[str, Any], InitialMotion]:
    """Return the estimates of all structures, with which options, and whether the record begins in motion."""
    is_automatic, asks = options.get("method", "auto") == "auto", options.get("has_free_response") is None
    plain = {"method": "white"} if is_automatic else {}

    def under(options: dict[str, Any], may_follow: bool) -> list[Outcome]:
        return _all(records, structures, options, n_workers, scheduler, progress, may_follow)

    options = {**options, **({"has_free_response": False} if asks else {})}
    results = under(options | plain, is_automatic)
    motion = _initial_motion(results) if asks else InitialMotion()
    if motion.is_estimated:
        options["has_free_response"] = True
        results = under(options | plain, is_automatic)
    if is_automatic:
        results = [r if isinstance(r, str) else replace(r, method="auto") for r in results]
        if _has_noise_of_its_own(results):
            # Under white noise BIC would pay for poles that only follow the noise: every structure has it as it is.
            results = under(options, False)
    return results, options, motion


def _best(entries: Sequence[StructureEntry], results: Sequence[Outcome]) -> tuple[int, list[str]]:
    """Return which structure is chosen, and what must be known of that."""
    passed = [k for k, entry in enumerate(entries) if not entry.refused_because]
    best = min(passed, key=lambda k: entries[k].bic)
    needed = _needed(entries, results, best)
    if needed is not None:
        return needed, [_NEEDED.format(entries[needed], entries[best])]
    refused = min(entries, key=_bic_of_converged)
    if _is_far_better(refused, entries[best]):
        return best, [_LEFT_BEHIND.format(refused, entries[best])]
    return best, []


def _ordered(entries: Sequence[StructureEntry]) -> tuple[StructureEntry, ...]:
    """Return them with the best Bayesian information criterion first."""
    return tuple(sorted(entries, key=lambda e: e.bic if math.isfinite(e.bic) else math.inf))


def _with_own_degrees(
    records: Sequence[TimeRecord],
    structures: list[Degrees],
    results: list[Outcome],
    options: dict[str, Any],
    zeros: list[int] | None,
) -> tuple[list[Degrees], list[Outcome]]:
    """Return structures and estimates with those in which single inputs have other degrees than the best one's."""
    structures, results = list(structures), list(results)
    while True:
        found = [k for k, outcome in enumerate(results) if not isinstance(outcome, str)]
        if not found:
            return structures, results
        best = min(found, key=lambda k: _figure_of_merit(structures[k], results[k], options))
        n, degrees = structures[best]
        assert isinstance(degrees, tuple)
        further: list[Degrees] = [
            (n, (*degrees[:k], m, *degrees[k + 1 :]))
            for k in range(len(degrees))
            for m in (range(n) if zeros is None else zeros)
            if 0 <= m <= n
        ]
        further = [own for own in further if own not in structures]
        if not further:
            return structures, results
        structures += further
        results += [_attempt((records, *own, {"n_starts": _STARTS} | options)) for own in further]


def _figure_of_merit(structure: Degrees, outcome: Outcome, options: dict[str, Any]) -> float:
    """Return BIC of a structure that passes the gates, else infinity."""
    entry = _entry(*structure, outcome, options)
    return math.inf if entry.refused_because else entry.bic


def _bic_of_converged(entry: StructureEntry) -> float:
    return entry.bic if entry.converged else math.inf


def _is_far_better(refused: StructureEntry, chosen: StructureEntry) -> bool:
    """Return whether a structure that was refused leaves the chosen one far behind."""
    return bool(refused.refused_because) and refused.bic < chosen.bic - _FAR


def _needed(entries: Sequence[StructureEntry], results: Sequence[Outcome], passed: int) -> int | None:
    """Return which structure is to be chosen although its poles are doubtful, if there is one.

    A pole that is hardly known, or meets a zero, is to be left out where the data can be explained without. Where the
    best structure that passes all gates simulates them visibly worse, they cannot.
    """
    found = [
        k
        for k, outcome in enumerate(results)
        if not (isinstance(outcome, str) or _failure(outcome))
        and _is_far_better(entries[k], entries[passed])
        and entries[k].fit_percent > entries[passed].fit_percent + _VISIBLE_FIT
    ]
    return min(found, key=lambda k: entries[k].bic, default=None)


def _failure(outcome: TransferFunctionResult | MultiInputResult) -> str:
    """Return why an estimate is none, whatever its poles are, or an empty string."""
    if not outcome.converged:
        return outcome.reason
    if UNRELATED in outcome.warnings:
        return "it explains no more than noise of any colour would"
    if outcome.scores.fit_percent < 0.0:
        return "its simulation is further from the output than the output's mean is"
    return ""


def _with_offers(
    records: Sequence[TimeRecord],
    structures: list[Degrees],
    results: list[Outcome],
    entries: list[StructureEntry],
    options: dict[str, Any],
    asks: bool,
) -> tuple[list[StructureEntry], list[Outcome], bool]:
    """Return entries and estimates with those of integrators, offset and drift, and whether they were looked at.

    They are offered to the best structure, refused or not: a pole near zero that is hardly known may be what stands
    for an integrator.
    """
    found = [(k, outcome) for k, outcome in enumerate(results) if not isinstance(outcome, str)]
    if not found:
        return entries, results, False
    place = min(found, key=lambda own: own[1].bic)[0]
    passed = [(k, outcome) for k, outcome in found if not entries[k].refused_because]
    if passed and not leaves_doubt(min(passed, key=lambda own: own[1].bic)[1]):
        return entries, results, False
    entries, results = list(entries), list(results)
    n_plain, tried = len(entries), set()
    for offer in offers(*structures[place], options):
        own = {**options, **{name: offer.options[name] for name in _TERMS}, "n_starts": 1}
        if not isinstance(offer.n_poles, int):
            continue
        if options["has_free_response"] is True and entries[place].refused_because:
            own["has_free_response"] = False  # what seemed to be initial motion may be a term that is offered
        # The free motion of an integrator is an offset, that of two a drift as well.
        columns = Nuisances(own["has_offset"], own["has_ramp"], own["has_free_response"] is True)
        structure = offer.n_poles, own["n_integrators"], columns.with_integrators(own["n_integrators"])
        if structure in tried:
            continue
        tried.add(structure)
        outcome = _attempt((records, offer.n_poles, structures[place][1], own))
        entries.append(_entry(offer.n_poles, structures[place][1], outcome, own))
        results.append(outcome)
        if not (isinstance(outcome, str) or entries[-1].refused_because or leaves_doubt(outcome)):
            break
    taken = [entry for entry in entries[n_plain:] if not entry.refused_because]
    if taken:
        # What lacked has bent the degrees, too, and may have looked like initial motion: both are chosen anew, with
        # these terms and with fewer.
        winner = min(taken, key=lambda entry: entry.bic)
        anew = {**options, "has_free_response": None} if asks else options
        for terms in _fewer_terms(winner, anew):
            _with_terms(records, structures, results, entries, {**anew, **terms})
    return entries, results, True


def _fewer_terms(entry: StructureEntry, options: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the terms of a structure, and those with one less, where that is more than was asked for."""
    own = {name: getattr(entry, name) for name in _TERMS}
    given = {name: options.get(name, type(value)(0)) for name, value in own.items()}
    sets = [own]
    if own["n_integrators"] > given["n_integrators"]:
        sets.append({**own, "n_integrators": own["n_integrators"] - 1})
    if own["has_ramp"] > given["has_ramp"]:
        sets.append({**own, "has_ramp": False})
    elif own["has_offset"] > given["has_offset"]:
        sets.append({**own, "has_offset": False})
    return [terms for terms in sets if terms != given]


def _with_terms(
    records: Sequence[TimeRecord],
    structures: Sequence[Degrees],
    results: list[Outcome],
    entries: list[StructureEntry],
    options: dict[str, Any],
) -> None:
    """Add the estimates of all structures with terms of ``options``, an integrator standing for a pole."""
    known = {(e.n_poles, e.n_zeros, *(getattr(e, name) for name in _TERMS)) for e in entries}
    terms = tuple(options[name] for name in _TERMS)
    for n, m in structures:
        own = n - options["n_integrators"]
        if own >= 1 and (own, m, *terms) not in known:
            outcome = _attempt((records, own, m, {**options, "n_starts": 1}))
            entries.append(_entry(own, m, outcome, options))
            results.append(outcome)


def _terms(entry: StructureEntry, options: dict[str, Any]) -> str:
    """Return which terms a structure has that nobody asked for."""
    said = ["an integrator", "two integrators"][entry.n_integrators - 1 : entry.n_integrators]
    said += ["an offset"] * (entry.has_offset and not options.get("has_offset"))
    said += ["a drift"] * (entry.has_ramp and not options.get("has_ramp"))
    return " and ".join(said)


def _initial_motion(results: Sequence[Outcome]) -> InitialMotion:
    """Return whether the best structure without initial motion, if there is one, says that there is some."""
    found = [r for r in results if not isinstance(r, str)]
    return InitialMotion.found(min(found, key=lambda r: r.bic).initial_motion.p_value if found else 0.0)


def _all(
    records: Sequence[TimeRecord],
    structures: list[Degrees],
    options: dict[str, Any],
    n_workers: int,
    scheduler: str | None,
    progress: Progress | None,
    may_follow: bool = False,
) -> list[Outcome]:
    """Return the estimates of all structures, or why there is none.

    ``may_follow`` says that noise which is not white will have all of them estimated again, under it.
    """
    jobs = [(records, n, m, {"n_starts": 1} | options) for n, m in structures]
    results = map_records(_attempt, jobs, n_workers, scheduler, _part(progress, 0.0, _FIRST_PART))
    suspects = {} if "n_starts" in options else _suspects(structures, results)
    if may_follow and suspects and _has_noise_of_its_own(results):
        suspects = {}  # all are estimated again, under that noise
    # One that a structure inside it surpasses begins where that one ended, too.
    jobs = [
        (records, *structures[k], {"n_starts": _STARTS, "inside": _models(results, j)} | options)
        for k, j in suspects.items()
    ]
    again = (
        map_records(_attempt, jobs, n_workers, scheduler, _part(progress, _FIRST_PART, 1.0)) if jobs else []
    )
    for k, outcome in zip(suspects, again, strict=True):
        results[k] = _better(results[k], outcome)
    if progress is not None and not suspects:
        progress(f"{len(structures)} structures", 1.0)
    return results


def _has_noise_of_its_own(results: Sequence[Outcome]) -> bool:
    """Return whether what the best structure leaves under white noise has a colour, by BIC, or outliers."""
    found = [r for r in results if not isinstance(r, str)]
    if not found:
        return False
    best = min(found, key=lambda r: r.bic)
    return any(
        not are_rounding(own.measured, own.residuals)
        and not RecordNoise.of(own.measured, own.residuals, own.times_s).is_plain
        for own in best.records
    )


def _part(progress: Progress | None, start: float, end: float) -> Progress | None:
    """Return a progress that reports a part of the whole."""
    if progress is None:
        return None
    return lambda phrase, share: progress(phrase, start + (end - start) * share)


def _models(
    results: Sequence[Outcome], place: int | None
) -> tuple[TransferFunctionModel | MultiInputModel, ...]:
    """Return the model that was estimated at a place, if there is one."""
    found = None if place is None else results[place]
    return () if found is None or isinstance(found, str) else (found.model,)


def _suspects(structures: list[Degrees], results: list[Outcome]) -> dict[int, int | None]:
    """Return which structures may have ended in a local optimum, and matter, and what surpasses them.

    Those without any estimate; those that a structure inside them surpasses; and, where residuals
    do not look like noise, those not larger than the best by BIC and not much smaller.
    """
    found = [(k, r) for k, r in enumerate(results) if not isinstance(r, str)]
    suspects: dict[int, int | None] = {k: None for k, r in enumerate(results) if isinstance(r, str)}
    if not found:
        return suspects
    sizes = [n + sum(_each(m)) for n, m in structures]
    best = min(found, key=lambda item: item[1].bic)[0]
    misfits = {k: r.bic - sizes[k] * math.log(len(r.measured)) for k, r in found}
    for k, r in found:
        inside = [j for j, _ in found if j != k and _is_within(structures[j], structures[k])]
        best_inside = min(inside, key=lambda j: misfits[j], default=k)
        is_surpassed = misfits[best_inside] < misfits[k] - _VISIBLE
        is_noise = r.converged and r.whiteness.p_value > WHITE
        is_near = sizes[best] - _NEAR <= sizes[k] <= sizes[best] and k != best
        if is_surpassed or (is_near and not is_noise):
            suspects[k] = best_inside if is_surpassed else None
    return suspects


def _each(n_zeros: int | tuple[int, ...]) -> tuple[int, ...]:
    return (n_zeros,) if isinstance(n_zeros, int) else n_zeros


def _is_within(one: Degrees, other: Degrees) -> bool:
    """Return whether a structure is a special case of another one."""
    pairs = zip(_each(one[1]), _each(other[1]), strict=True)
    return one[0] <= other[0] and all(m <= most for m, most in pairs)


def _better(first: Outcome, second: Outcome) -> Outcome:
    """Return the estimate of lower cost."""
    if isinstance(second, str):
        return first
    return second if isinstance(first, str) or second.bic <= first.bic else first


def _attempt(job: tuple[Sequence[TimeRecord], int, int | tuple[int, ...], dict[str, Any]]) -> Outcome:
    records, n, m, options = job
    try:
        return estimated(records, n, m, **options)
    except EstimationError as err:
        return str(err)


def _entry(n: int, m: int | tuple[int, ...], outcome: Outcome, options: dict[str, Any]) -> StructureEntry:
    terms = {name: options[name] for name in _TERMS if name in options}
    if isinstance(outcome, str):
        nan = math.nan
        return StructureEntry(n, m, nan, nan, nan, nan, nan, nan, False, outcome, **terms)
    n_samples = len(outcome.measured)
    n_parameters = n + sum(own + 1 for own in _each(m))
    return StructureEntry(
        n,
        m,
        outcome.scores.r_squared,
        outcome.scores.fit_percent,
        outcome.yic,
        outcome.bic - n_parameters * (math.log(n_samples) - 2.0),
        outcome.bic,
        outcome.condition,
        outcome.converged,
        _failure(outcome)
        or next((said for path in paths_of(outcome.model) if (said := structure_complaint(path))), ""),
        **terms,
    )
