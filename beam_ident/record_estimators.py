"""The library's methods as estimators of one contract: from a record and settings to a result, without hints.

What a method leaves to its caller (degrees, an order, a delay, a response to fit to) is chosen here from the data.
``beam_ident.estimators`` has the names.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from beam_ident.data.argument_checks import require_records
from beam_ident.data.batches import Progress
from beam_ident.data.prior import Prior
from beam_ident.data.records import TimeRecord
from beam_ident.errors import EstimationError
from beam_ident.modal.identification_result import FrequencyDomainResult
from beam_ident.modal.structure import ModalStructure
from beam_ident.modal_estimation.frequency_domain import fit_frequency_modes
from beam_ident.modal_identification.time_domain import identify
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
from beam_ident.transfer_function_estimation.srivc import Method

if TYPE_CHECKING:
    from beam_ident.estimators import EstimatorSettings
    from beam_ident.modal.identification_result import IdentificationResult

_MOST_MODES = 3  # of the degrees that are tried
_MOST_ORDERS = 10  # of a subspace
_INTEGRATORS = {"velocity": 1, "acceleration": 2, "force": 2}
_RESOLVED = 6.0  # lines in a half-power band, as many as the local polynomials reach to either side


Records = TimeRecord | Sequence[TimeRecord]


def modal(record: Records, settings: EstimatorSettings) -> IdentificationResult:
    """Identify modes common to all outputs."""
    _refuse(settings, "modal", orders=settings.orders, noise=settings.noise != "auto")
    more: dict[str, Any] = {} if settings.max_modes is None else {"max_modes": settings.max_modes}
    return identify(
        record,
        _structure(settings),
        settings.n_modes,
        latency=settings.latency,
        clock_rate=settings.clock_rate,
        progress=settings.progress,
        **more,
    )


def _structure(settings: EstimatorSettings) -> Any:
    """Return the structure's name, or the structure without the terms that are left out."""
    if not settings.without:
        return settings.structure
    structure = ModalStructure(settings.structure)
    left_out: dict[str, Any] = {f"has_{term}": False for term in settings.without}
    return dataclasses.replace(structure, **left_out)


def transfer_function(record: Records, settings: EstimatorSettings) -> SeparateOutputsResult:
    """Estimate a transfer function to every output by itself, with its delay, and choose its degrees by BIC.

    Notes
    -----
    As many zeros as poles, since a camera at rest sees the base's motion directly and a free base follows its force;
    two fewer on a fixed structure seen by a sensor of displacement, one fewer by one of velocity. A number of modes
    that is given is taken; what speaks against it stands in the warnings. Degrees that are given are taken as they
    are.
    """
    methods: dict[str, Method] = {"auto": "auto", "white": "white", "modelled": "rivc"}
    return _separate_outputs(record, settings, methods[settings.noise])


def srivc(record: Records, settings: EstimatorSettings) -> SeparateOutputsResult:
    """Estimate transfer functions by refined instrumental variables, and stop there.

    Notes
    -----
    The method takes delays as known: where one is not, it comes from the estimator transfer_function.
    """
    _refuse(settings, "srivc", noise=settings.noise != "auto")
    known = settings.latency
    if known is not None and not known.is_free:
        return _separate_outputs(record, settings, "srivc")
    first = _separate_outputs(record, dataclasses.replace(settings, noise="auto"), "auto")
    records = require_records(record, may_lack_outputs=True)
    outputs: list[TransferFunctionResult] = []
    tables: list[str] = []
    for output in first.outputs:
        name, delay = output.model.output_name, max(output.model.delay, 0.0)
        own = [one.select((name,)) for one in records if name in one.output_names]
        held = dataclasses.replace(settings, latency=Prior(delay))
        found = _separate_outputs(own, held, "srivc")
        said = (
            f"the delay of {delay * 1e3:.3g} ms was estimated by transfer_function and is taken as known here"
        )
        outputs.append(dataclasses.replace(found.outputs[0], warnings=(*found.outputs[0].warnings, said)))
        tables += found.tables
    return SeparateOutputsResult(tuple(outputs), tuple(tables))


def rivc(record: Records, settings: EstimatorSettings) -> SeparateOutputsResult:
    """Estimate transfer functions with a model of the noise."""
    return _separate_outputs(record, settings, "rivc")


def output_error(record: Records, settings: EstimatorSettings) -> SeparateOutputsResult:
    """Estimate transfer functions by Levenberg-Marquardt alone."""
    return _separate_outputs(record, settings, "output_error")


def _separate_outputs(record: Records, settings: EstimatorSettings, method: Method) -> SeparateOutputsResult:
    """Estimate a transfer function to every output by one method."""
    records = require_records(record, may_lack_outputs=True)
    _refuse(
        settings,
        "a transfer function",
        noise=settings.noise != "auto" and method not in ("white", "rivc"),
        residual="residual" in settings.without,
    )
    options: dict[str, Any] = {
        "method": method,
        "has_offset": "offset" not in settings.without,
        "has_ramp": "ramp" not in settings.without,
        "delay": "estimate" if settings.latency is None else settings.latency,
        "n_integrators": _INTEGRATORS.get(settings.structure, 0),
    }
    if "free_response" in settings.without:
        options["has_free_response"] = False
    if len(records[0].inputs) > 1:
        raise EstimationError(
            f"record {records[0].name!r} has the inputs {', '.join(own.name for own in records[0].inputs)}; expected "
            "one for this estimator. Take the estimator modal, or estimate_common_poles"
        )
    degrees = _degrees(settings, _MOST_MODES)
    pairs = settings.orders or tuple((n, n - _fewer_zeros(settings)) for n in degrees)
    names = list(dict.fromkeys(name for one in records for name in one.output_names))
    chosen, tables = [], []
    for number, name in enumerate(names):
        own = [one.select((name,)) for one in records if name in one.output_names]
        progress = _part(settings.progress, number, len(names), name)
        try:
            if len(pairs) == 1:
                chosen.append(estimate_transfer_function(own, *pairs[0], **options))
            else:
                selection = select_transfer_function(
                    own,
                    degrees,
                    [m for _, m in pairs],
                    progress=progress,
                    degrees=settings.orders or None,
                    **options,
                )
                assert isinstance(selection.chosen, TransferFunctionResult)  # of one input
                chosen.append(selection.chosen)
                tables.append(f"orders of {name}\n{selection}")
        except EstimationError as err:
            raise EstimationError(f"output {name!r}: {err}") from err
    return SeparateOutputsResult(tuple(chosen), tuple(tables))


def common_poles(record: Records, settings: EstimatorSettings) -> CommonPoleResult:
    """Estimate transfer functions with one denominator, of the highest degree that an output alone needs.

    Notes
    -----
    The delay is the mean of those found at the outputs that need this degree, each weighed by its variance: a
    model with too few poles charges what it lacks to its delay.
    """
    records = require_records(record)
    _refuse(settings, "common_poles", orders=len(settings.orders) > 1)
    known = settings.latency if settings.latency is not None and not settings.latency.is_free else None
    if settings.orders and known is not None:
        (n_poles, n_zeros), delay = settings.orders[0], known.mean
    else:
        alone = transfer_function(records, settings).models
        n_poles = max(model.n_poles - model.n_integrators for model in alone)
        n_zeros = settings.orders[0][1] if settings.orders else n_poles - _fewer_zeros(settings)
        whole = [model for model in alone if model.n_poles - model.n_integrators == n_poles]
        weights = [1.0 / max(float(model.covariance[-1, -1]), 1e-300) for model in whole]
        delay = max(float(np.average([model.delay for model in whole], weights=weights)), 0.0)
    found = estimate_common_poles(
        records,
        n_poles,
        n_zeros,
        has_offset="offset" not in settings.without,
        has_ramp="ramp" not in settings.without,
        has_free_response=False if "free_response" in settings.without else None,
        delay=delay,
        n_integrators=_INTEGRATORS.get(settings.structure, 0),
    )
    assert isinstance(found, CommonPoleResult)  # of one input
    if known is not None:
        return found
    said = f"the delay of {delay * 1e3:.3g} ms was found output by output and is taken as known here"
    return dataclasses.replace(found, warnings=(*found.warnings, said))


def po_moesp(record: Records, settings: EstimatorSettings) -> SubspaceModel:
    """Estimate a subspace model and choose its order by BIC of the simulated outputs."""
    _refuse_drift(settings, "PO-MOESP takes poles to be stable")
    _refuse(
        settings, "po_moesp", noise=settings.noise != "auto", without=settings.without, delay=settings.latency
    )
    best: SubspaceModel | None = None
    least = math.inf
    for order in tuple(n for n, _ in settings.orders) or _degrees(settings, _MOST_ORDERS):
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


def local_polynomial(record: Records, settings: EstimatorSettings) -> FrequencyDomainResult:
    """Fit modes to a local polynomial frequency response, and warn of those that its lines do not resolve."""
    _refuse_drift(settings, "the lines of an output that drifts leak into each other")
    _refuse(
        settings,
        "local_polynomial",
        noise=settings.noise != "auto",
        orders=settings.orders,
        without=[term for term in settings.without if term != "residual"],
    )
    responses = [local_polynomial_response(one) for one in require_records(record)]
    found = fit_frequency_modes(
        responses if len(responses) > 1 else responses[0],
        _structure(settings),
        settings.n_modes,
        latency=settings.latency or Prior(0.0, math.inf),
    )
    spacing_hz = max(float(own.frequencies_hz[0]) for own in responses)
    widths = 2.0 * found.model.damping_ratios * found.model.frequencies_hz / spacing_hz
    said = tuple(
        f"the half-power band at {hertz:.4g} Hz is {width:.1f} lines wide, and local polynomials need {_RESOLVED:g}: "
        "do not trust this damping ratio; record longer, or take the estimator modal"
        for hertz, width in zip(found.model.frequencies_hz, widths, strict=True)
        if width < _RESOLVED
    )
    # The noise of the lines is none of samples, by which ``validate`` would judge: the model states none.
    noise_sd = np.full(len(found.model.output_names), np.nan)
    model = dataclasses.replace(found.model, noise_sd=noise_sd)
    return dataclasses.replace(found, model=model, warnings=(*said, *found.warnings))


def _refuse(settings: EstimatorSettings, who: str, **asked: object) -> None:
    """Raise EstimationError for what was asked for and an estimator does not have."""
    for what, is_asked in asked.items():
        if is_asked:
            value = getattr(settings, {"delay": "latency", "residual": "without"}.get(what, what))
            raise EstimationError(
                f"{what} is {value!r}, and {who} has no choice there; leave it out, or take another estimator"
            )


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
