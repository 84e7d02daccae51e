"""Which degrees a transfer function needs: the table of orders, and a choice.

Every structure is estimated and listed with the figures that the literature tabulates
(R_T^2, YIC, AIC, BIC, FIT, condition, convergence).  The choice is made by BIC among
the structures that pass the gates: the fit converged, every pole is known well
enough to mean something, and no pole is cancelled by a zero within their
uncertainty.  YIC is shown because it is customary; for lightly damped modes it picks
orders that are too low, and decides nothing here.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from beam_ident.batches import Progress, map_records
from beam_ident.errors import EstimationError
from beam_ident.records import TimeRecord
from beam_ident.transfer_function import TransferFunctionModel
from beam_ident.transfer_function_fit import TransferFunctionResult, estimate_transfer_function

_MAX_POLE_SD = 0.5  # of the pole's modulus
_CANCELLATION = 3.0  # standard deviations between a pole and the nearest zero


@dataclass(frozen=True)
class StructureEntry:
    """One line of the table of orders.

    Attributes
    ----------
    n_poles, n_zeros : int
    r_squared, fit_percent, yic, aic, bic, condition : float -- NaN where the estimation failed
    converged : bool
    refused_because : str -- empty when the structure passed all gates
    is_chosen : bool
    """

    n_poles: int
    n_zeros: int
    r_squared: float
    fit_percent: float
    yic: float
    aic: float
    bic: float
    condition: float
    converged: bool
    refused_because: str
    is_chosen: bool = False


@dataclass(frozen=True, eq=False)
class OrderSelection:
    """The table of orders and the chosen estimate.

    Attributes
    ----------
    table : tuple of StructureEntry -- best BIC first
    chosen : TransferFunctionResult
    """

    table: tuple[StructureEntry, ...]
    chosen: TransferFunctionResult


def select_transfer_function(
    record: TimeRecord,
    n_poles: Iterable[int] = range(1, 7),
    n_zeros: Iterable[int] | None = None,
    n_workers: int = 1,
    progress: Progress | None = None,
    scheduler: str | None = None,
    **options: Any,
) -> OrderSelection:
    """Estimate all structures of a range and choose one.

    Parameters
    ----------
    record : TimeRecord
    n_poles : iterable of int -- degrees of the denominator
    n_zeros : iterable of int or None
        Degrees of the numerator; None takes all below the denominator's.
    n_workers : int -- processes to spread the estimates over; 1 stays in this one
    progress : callable or None -- called with a phrase and the share done
    scheduler : str or None -- address of a Dask cluster that does the work instead; see :func:`map_records`
    **options
        Handed to :func:`estimate_transfer_function`, such as ``has_offset``.

    Raises
    ------
    EstimationError
        An empty range, no structure that passes the gates, or no cluster where one was named.
    """
    zeros = None if n_zeros is None else list(n_zeros)
    structures = [(n, m) for n in n_poles for m in (range(n) if zeros is None else zeros) if 0 <= m <= n]
    if not structures:
        raise EstimationError(
            "no structure to try; give at least one number of poles with no more zeros than poles"
        )
    jobs = [(record, n, m, options) for n, m in structures]
    results = map_records(_attempt, jobs, n_workers, scheduler, progress)
    entries = [_entry(n, m, outcome) for (n, m), outcome in zip(structures, results, strict=True)]
    passed = [k for k, entry in enumerate(entries) if not entry.refused_because]
    if not passed:
        reasons = "; ".join(f"{e.n_poles}/{e.n_zeros}: {e.refused_because}" for e in entries[:4])
        raise EstimationError(
            f"none of {len(entries)} structures passes the gates ({reasons}). Excite more, or record longer"
        )
    best = min(passed, key=lambda k: entries[k].bic)
    entries[best] = replace(entries[best], is_chosen=True)
    chosen = results[best]
    assert isinstance(chosen, TransferFunctionResult)
    ordered = sorted(entries, key=lambda e: e.bic if math.isfinite(e.bic) else math.inf)
    return OrderSelection(tuple(ordered), chosen)


def _attempt(job: tuple[TimeRecord, int, int, dict[str, Any]]) -> TransferFunctionResult | str:
    record, n, m, options = job
    try:
        return estimate_transfer_function(record, n, m, **options)
    except EstimationError as err:
        return str(err)


def _entry(n: int, m: int, outcome: TransferFunctionResult | str) -> StructureEntry:
    if isinstance(outcome, str):
        nan = math.nan
        return StructureEntry(n, m, nan, nan, nan, nan, nan, nan, False, outcome)
    n_samples = len(outcome.measured)
    n_parameters = n + m + 1
    refusal = "" if outcome.converged else outcome.reason
    of_nothing = n_samples * math.log(max(float(outcome.measured @ outcome.measured), 1e-300))
    if not refusal and not outcome.bic < of_nothing:
        refusal = "no better by BIC than no model at all"
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
        refusal or structure_complaint(outcome.model),
    )


def structure_complaint(model: TransferFunctionModel) -> str:
    """Return why the degrees of a model are not to be trusted, or an empty string."""
    poles = model.poles
    poles = poles[poles.imag >= 0.0]
    n = model.n_poles
    by_a = model.pole_sensitivities(poles)
    size = np.einsum("ka,ab,kb->k", by_a, model.covariance[:n, :n], np.conj(by_a)).real
    for pole, variance in zip(poles, size, strict=True):
        if not math.sqrt(max(variance, 0.0)) < _MAX_POLE_SD * abs(pole):
            share = math.sqrt(max(variance, 0.0)) / abs(pole)
            return f"the pole at {abs(pole):.4g} rad/s is known to {share:.0%} only"
    zeros = model.zeros
    if not len(zeros):
        return ""
    m = len(model.numerator) - 1
    slope = np.polyval(np.polyder(model.numerator), zeros)
    by_b = -(zeros[:, None] ** np.arange(m, -1, -1)) / slope[:, None]
    for k, pole in enumerate(poles):
        nearest = int(np.argmin(np.abs(zeros - pole)))
        gradient = np.concatenate([by_a[k], -by_b[nearest], [0.0]])
        parts = np.stack([gradient.real, gradient.imag])
        covariance = parts @ model.covariance @ parts.T
        apart = np.array([(pole - zeros[nearest]).real, (pole - zeros[nearest]).imag])
        if pole.imag == 0.0:
            covariance, apart = covariance[:1, :1], apart[:1]
        distance = float(apart @ np.linalg.pinv(covariance, rcond=1e-12, hermitian=True) @ apart)
        if distance < _CANCELLATION**2:
            return f"a zero cancels the pole at {abs(pole):.4g} rad/s within {_CANCELLATION:.0f} standard deviations"
    return ""
