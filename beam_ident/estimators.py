"""The one table of estimators that are called by name, as ``beam identify --estimator NAME`` does.

An estimator is a function from a record and settings to a ``Result``. A new one is a file with that function and
a line in ``ESTIMATORS``; another package adds its own, without a change here, as an entry point of the group
``beam_ident.estimators``. Nothing is loaded before it is asked for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any, Literal, Protocol

from beam_ident.errors import EstimationError
from beam_ident.plug_ins import find_kind, plug_ins
from beam_ident.results import LineResult, Result, TimeResult

if TYPE_CHECKING:
    from beam_ident.data.batches import Progress
    from beam_ident.data.prior import Prior
    from beam_ident.data.records import TimeRecord
    from beam_ident.modal.structure import StructureKind

GROUP = "beam_ident.estimators"

Term = Literal["residual", "offset", "ramp", "free_response"]
NoiseChoice = Literal["auto", "white", "modelled"]


@dataclass(frozen=True)
class EstimatorSettings:
    """What is known of a record beforehand, and what is wanted; every estimator uses what concerns it.

    Attributes
    ----------
    structure : str -- which model goes with the input; one of those that ``identify`` takes, by its name
    n_modes : int or None -- how many modes, each a pair of poles; None: from the data
    clock_rate : Prior or None -- what is known of the outputs' clock against the input's
    progress : callable or None -- called with a phrase and the share done, between 0 and 1
    latency : Prior or None
        What is known of the time by which stamps of the outputs are late [s], or of the delay of a transfer function;
        None: nothing, as far as an estimator can find it.
    orders : tuple of (n_poles, n_zeros)
        Degrees to choose from, of estimators that have such; empty: by the number of modes.
    max_modes : int or None -- bound on the modes tried where ``n_modes`` is None
    noise : {"auto", "white", "modelled"} -- of transfer functions: as the residuals are, as if white, or coloured
    without : tuple of {"residual", "offset", "ramp", "free_response"} -- terms that are left out of the model
    """

    structure: StructureKind = "base_motion"
    n_modes: int | None = None
    clock_rate: Prior | None = None
    progress: Progress | None = None
    latency: Prior | None = None
    orders: tuple[tuple[int, int], ...] = ()
    max_modes: int | None = None
    noise: NoiseChoice = "auto"
    without: tuple[Term, ...] = ()


class Estimator(Protocol):
    """What a name in the table stands for."""

    def __call__(self, record: TimeRecord | Sequence[TimeRecord], settings: EstimatorSettings, /) -> Result:
        """Estimate from one record or several of one system; raise EstimationError where that cannot be done."""


@dataclass(frozen=True)
class EstimatorEntry:
    """One line of the table.

    Attributes
    ----------
    meaning : str -- for a person who chooses
    where : str -- module:function
    result : type -- the contract that its results keep
    """

    meaning: str
    where: str
    result: type[object]


ESTIMATORS: dict[str, EstimatorEntry] = {
    "modal": EstimatorEntry(
        "modes common to all outputs, maximum likelihood with every noise weighed (identify)",
        "beam_ident.record_estimators:modal",
        TimeResult,
    ),
    "transfer_function": EstimatorEntry(
        "B(s)/A(s) e^(-s T) of every output by itself, degrees chosen by BIC (select_transfer_function)",
        "beam_ident.record_estimators:transfer_function",
        TimeResult,
    ),
    "srivc": EstimatorEntry(
        "transfer_function, stopped at refined instrumental variables for continuous time",
        "beam_ident.record_estimators:srivc",
        TimeResult,
    ),
    "rivc": EstimatorEntry(
        "transfer_function, with a model of the noise in any case",
        "beam_ident.record_estimators:rivc",
        TimeResult,
    ),
    "output_error": EstimatorEntry(
        "transfer_function, by Levenberg-Marquardt alone",
        "beam_ident.record_estimators:output_error",
        TimeResult,
    ),
    "common_poles": EstimatorEntry(
        "the same with one A(s) for all outputs, at the delay found first (estimate_common_poles)",
        "beam_ident.record_estimators:common_poles",
        TimeResult,
    ),
    "po_moesp": EstimatorEntry(
        "subspace model without iteration, order by BIC, no standard deviations (subspace_model)",
        "beam_ident.record_estimators:po_moesp",
        TimeResult,
    ),
    "local_polynomial": EstimatorEntry(
        "modes fitted to a local polynomial frequency response, for long records (fit_frequency_modes)",
        "beam_ident.record_estimators:local_polynomial",
        LineResult,
    ),
}
"""The library's own estimators by name; no other package replaces one of them."""


def estimator_meanings() -> dict[str, str]:
    """Return every estimator's name and meaning; those of other packages are named, not loaded."""
    others = plug_ins(GROUP)
    return {name: entry.meaning for name, entry in ESTIMATORS.items()} | {
        name: f"added by {found.dist.name if found.dist else found.value}"
        for name, found in sorted(others.items())
        if name not in ESTIMATORS
    }


def find_estimator(name: str) -> Estimator:
    """Return an estimator by its name: one of the table, else one that an installed package adds.

    Raises
    ------
    EstimationError
        Nobody has that name, or the package that has it cannot be loaded.
    """
    found: Any = find_kind("estimator", name, ESTIMATORS, GROUP, EstimationError, EstimationError)
    if isinstance(found, EstimatorEntry):
        module, _, function = found.where.partition(":")
        found = getattr(import_module(module), function)
    estimator: Estimator = found
    return estimator


def run_estimator(
    name: str, record: TimeRecord | Sequence[TimeRecord], settings: EstimatorSettings
) -> Result:
    """Estimate from a record, or several of one system, with the estimator of a name.

    Parameters
    ----------
    name : str -- one of ``estimator_meanings()``
    record : TimeRecord or sequence of TimeRecord -- a single one in a sequence is handed on by itself
    settings : EstimatorSettings

    Raises
    ------
    EstimationError
        No such estimator, one that returns no ``Result``, or whatever the estimator itself refuses.
    """
    only = record[0] if isinstance(record, Sequence) and len(record) == 1 else record
    found = find_estimator(name)(only, settings)
    if not isinstance(found, Result):
        raise EstimationError(
            f"estimator {name!r} returned a {type(found).__name__}; expected a Result, with converged, reason, "
            "iterations and warnings"
        )
    return found
