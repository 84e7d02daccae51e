"""The library's methods as estimators of one contract: from a record and settings to a result, without hints.

What a method leaves to its caller (degrees, an order, a delay, a response to fit to) is chosen here from the data.
``beam_ident.estimators`` has the names.
"""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, Any

import numpy as np

from beam_ident.data.batches import Progress
from beam_ident.data.prior import Prior
from beam_ident.data.records import TimeRecord
from beam_ident.errors import EstimationError
from beam_ident.modal.identification_result import FrequencyDomainResult
from beam_ident.modal.structure import ModalStructure
from beam_ident.modal_estimation.frequency_domain import fit_frequency_modes
from beam_ident.modal_estimation.time_domain import identify
from beam_ident.responses.local_polynomial import local_polynomial_response
from beam_ident.subspace.model import SubspaceModel, subspace_model
from beam_ident.transfer_function.structure_gates import information_criterion
from beam_ident.transfer_function_estimation.common_poles import CommonPoleResult, estimate_common_poles
from beam_ident.transfer_function_estimation.estimation import (
    SeparateOutputsResult,
    TransferFunctionResult,
    estimate_transfer_function,
)
from beam_ident.transfer_function_estimation.order_selection import select_transfer_function

if TYPE_CHECKING:
    from beam_ident.estimators import EstimatorSettings
    from beam_ident.modal.identification_result import IdentificationResult

_MOST_MODES = 3  # of the degrees that are tried
_MOST_ORDERS = 10  # of a subspace
_INTEGRATORS = {"velocity": 1, "acceleration": 2, "force": 2}
_RESOLVED = 6.0  # lines in a half-power band, as many as the local polynomials reach to either side


def modal(record: TimeRecord, settings: EstimatorSettings) -> IdentificationResult:
    """Identify modes common to all outputs."""
    return identify(
        record,
        settings.structure,
        settings.n_modes,
        clock_rate=settings.clock_rate,
        progress=settings.progress,
    )


def transfer_function(record: TimeRecord, settings: EstimatorSettings) -> SeparateOutputsResult:
    """Estimate a transfer function to every output by itself, with its delay, and choose its degrees by BIC.

    Notes
    -----
    As many zeros as poles, since a camera at rest sees the base's motion directly and a free base follows its force;
    two fewer on a fixed structure seen by a sensor of displacement, one fewer by one of velocity. A number of modes
    that is given is taken; what speaks against it stands in the warnings.
    """
    options: dict[str, Any] = {
        "has_offset": True,
        "has_ramp": True,
        "delay": "estimate",
        "n_integrators": _INTEGRATORS.get(settings.structure, 0),
    }
    if len(record.inputs) > 1:
        raise EstimationError(
            f"record {record.name!r} has the inputs {', '.join(own.name for own in record.inputs)}; expected one for "
            "this estimator. Take the estimator modal, or estimate_common_poles"
        )
    degrees = _degrees(settings, _MOST_MODES)
    zeros = [n - _fewer_zeros(settings) for n in degrees]
    chosen = []
    for number, name in enumerate(record.output_names):
        part, progress = record.select((name,)), _part(settings.progress, number, len(record.outputs), name)
        try:
            if settings.n_modes:
                chosen.append(estimate_transfer_function(part, degrees[0], zeros[0], **options))
            else:
                selection = select_transfer_function(part, degrees, zeros, progress=progress, **options)
                assert isinstance(selection.chosen, TransferFunctionResult)  # of one input
                chosen.append(selection.chosen)
        except EstimationError as err:
            raise EstimationError(f"output {name!r}: {err}") from err
    return SeparateOutputsResult(tuple(chosen))


def common_poles(record: TimeRecord, settings: EstimatorSettings) -> CommonPoleResult:
    """Estimate transfer functions with one denominator, of the highest degree that an output alone needs.

    Notes
    -----
    The delay is the mean of those found at the outputs that need this degree, each weighed by its variance: a
    model with too few poles charges what it lacks to its delay.
    """
    alone = transfer_function(record, settings).models
    n_poles = max(model.n_poles - model.n_integrators for model in alone)
    whole = [model for model in alone if model.n_poles - model.n_integrators == n_poles]
    weights = [1.0 / max(float(model.covariance[-1, -1]), 1e-300) for model in whole]
    delay = max(float(np.average([model.delay for model in whole], weights=weights)), 0.0)
    found = estimate_common_poles(
        record,
        n_poles,
        n_poles - _fewer_zeros(settings),
        has_offset=True,
        has_ramp=True,
        delay=delay,
        n_integrators=_INTEGRATORS.get(settings.structure, 0),
    )
    said = f"the delay of {delay * 1e3:.3g} ms was found output by output and is taken as known here"
    return dataclasses.replace(found, warnings=(*found.warnings, said))


def po_moesp(record: TimeRecord, settings: EstimatorSettings) -> SubspaceModel:
    """Estimate a subspace model and choose its order by BIC of the simulated outputs."""
    _refuse_drift(settings, "PO-MOESP takes poles to be stable")
    best: SubspaceModel | None = None
    least = math.inf
    for order in _degrees(settings, _MOST_ORDERS):
        try:
            found = subspace_model(record, order)
        except EstimationError:
            if best is None:
                raise
            break  # the record is too short for more
        n_parameters = order + len(found.residuals) * (order + 3)  # numerators, offsets and ramps
        criterion = information_criterion(found.residuals, n_parameters)
        if criterion < least:
            best, least = found, criterion
    assert best is not None
    return best


def local_polynomial(record: TimeRecord, settings: EstimatorSettings) -> FrequencyDomainResult:
    """Fit modes to a local polynomial frequency response, and warn of those that its lines do not resolve."""
    _refuse_drift(settings, "the lines of an output that drifts leak into each other")
    response = local_polynomial_response(record)
    structure = ModalStructure(settings.structure)
    found = fit_frequency_modes(response, structure, settings.n_modes, latency=Prior(0.0, math.inf))
    spacing_hz = float(response.frequencies_hz[0])
    widths = 2.0 * found.model.damping_ratios * found.model.frequencies_hz / spacing_hz
    said = tuple(
        f"the half-power band at {hertz:.4g} Hz is {width:.1f} lines wide, and local polynomials need {_RESOLVED:g}: "
        "do not trust this damping ratio; record longer, or take the estimator modal"
        for hertz, width in zip(found.model.frequencies_hz, widths, strict=True)
        if width < _RESOLVED
    )
    # The noise of the lines is none of samples, by which ``validate`` would judge: the model states none.
    model = dataclasses.replace(found.model, noise_sd=np.full(len(record.outputs), np.nan))
    return dataclasses.replace(found, model=model, warnings=(*said, *found.warnings))


def _refuse_drift(settings: EstimatorSettings, why: str) -> None:
    """Raise EstimationError for a structure with poles at zero."""
    if settings.structure in _INTEGRATORS:
        raise EstimationError(
            f"structure {settings.structure!r} has poles at zero, and {why}; expected 'base_motion' or 'receptance'. "
            "Take the estimator modal or transfer_function"
        )


def _fewer_zeros(settings: EstimatorSettings) -> int:
    """Return how many zeros fewer than poles, those at zero left aside, the structure has."""
    return {"receptance": 2, "mobility": 1}.get(settings.structure, 0)


def _degrees(settings: EstimatorSettings, most: int) -> tuple[int, ...]:
    """Return the numbers of poles to try, two for each mode."""
    return tuple(2 * n for n in ([settings.n_modes] if settings.n_modes else range(1, most + 1)))


def _part(progress: Progress | None, number: int, count: int, name: str) -> Progress | None:
    """Return a progress that reports the share of one output."""
    if progress is None:
        return None
    return lambda phrase, share: progress(f"{name}: {phrase}", (number + share) / count)
