"""Every estimator with what it says of the quantities that an experiment knows: value, standard deviation."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from beam_ident import (
    FrequencyRecord,
    SampledController,
    TimeRecord,
    analyse_modes,
    circle_fit,
    estimate_common_poles,
    estimate_in_closed_loop,
    estimate_transfer_function,
    fit_free_decay,
    fit_frequency_modes,
    fit_frequency_transfer_function,
    fit_sine,
    half_power_damping,
    hammer_response,
    identify,
    local_polynomial_response,
    models_of,
    nonlinear_distortion,
    periodic_response,
    select_transfer_function,
    stabilisation_chart,
    stepped_sine_response,
    subspace_model,
    validate,
    welch_response,
)
from tests.beam_ident.bad_input.experiments import (
    GAINS,
    LINE_PERIOD_S,
    OMEGA,
    PERIOD_S,
    PLANT,
    STEPS,
    ZETA,
)

Values = dict[str, tuple[float, float]]
TRUTH = {"frequency": OMEGA, "damping": ZETA, **{f"gain of {name}": gain for name, gain in GAINS.items()}}
BAND = (2.0, 5.0)  # Hz: where a response is compared with the truth


@dataclass(frozen=True)
class Said:
    """What a result says: numbers with deviations, what is to be known of them, and whether it believes in itself."""

    values: Values
    warnings: tuple[str, ...] = ()
    converged: bool = True
    reason: str = ""


@dataclass(frozen=True)
class Estimator:
    """One row: the experiment that suits it, how it is called, and whether its numbers are held against the truth.

    What a response without a model says is held against what it says of the sound record.
    """

    experiment: str
    run: Callable[[TimeRecord], Said]
    is_model: bool = True


def _said(result: Any, values: Values) -> Said:
    return Said(values, tuple(result.warnings), result.converged, result.reason)


def _modal(result: Any) -> Said:
    """Return the mode nearest to the true one, of a modal model or of a table of modes."""
    model = models_of(result)[0]
    omegas = np.asarray(model.natural_frequencies)
    if not len(omegas):  # a rigid body alone
        return _said(result, {"frequency": (np.nan, 0.0)})
    n, k = len(omegas), int(np.argmin(np.abs(np.log(omegas / OMEGA))))
    covariance = np.asarray(model.covariance)
    found = {
        "frequency": (float(omegas[k]), float(np.sqrt(max(covariance[k, k], 0.0)))),
        "damping": (float(model.damping_ratios[k]), float(np.sqrt(max(covariance[n + k, n + k], 0.0)))),
    }
    return _said(result, found)


def _rational(result: Any) -> Said:
    model = models_of(result)[0]
    omegas, zetas, omega_sd, zeta_sd = model.modes()
    if not len(omegas):
        return Said({"frequency": (np.nan, 0.0)}, tuple(result.warnings), result.converged, result.reason)
    k = int(np.argmin(np.abs(np.log(omegas / OMEGA))))
    values = {
        "frequency": (float(omegas[k]), float(omega_sd[k])),
        "damping": (float(zetas[k]), float(zeta_sd[k])),
    }
    if hasattr(model, "frequency_response"):
        response, sd = model.frequency_response(np.array([1e-6]))
        values[f"gain of {model.output_name}"] = (float(np.real(response[0])), float(np.ravel(sd)[0]))
    return _said(result, values)


def _lines(record: FrequencyRecord) -> Said:
    """Return the response in a band over the true one: a complex factor for each output."""
    values: Values = {}
    keep = (record.frequencies_hz > BAND[0]) & (record.frequencies_hz < BAND[1])
    if not np.any(keep):
        return Said({"size of y": (np.nan, 0.0)}, record.fit_warnings)
    s = record.s[keep]  # beside the imaginary axis where a window was exponential
    plant = np.polyval(PLANT.numerator, s) / np.polyval(PLANT.denominator, s)
    for j, name in enumerate(record.output_names):
        true, own = GAINS[name] * plant, record.response[keep, j, 0]
        variance = np.ones(len(own)) if record.variance is None else record.variance[keep, j, 0]
        known = np.isfinite(own) & np.isfinite(variance)
        if not np.any(known):
            values[f"size of {name}"] = (np.nan, 0.0)
            continue
        # No weights: a fault that changes the variances of lines would also change which line's bias counts.
        shares = np.conj(true[known]) / np.sum(np.abs(true[known]) ** 2)
        factor = np.sum(shares * own[known])
        sd = float(np.sqrt(0.5 * record.shared_lines * np.sum(np.abs(shares) ** 2 * variance[known])))
        values |= {f"size of {name}": (factor.real, sd), f"turn of {name}": (factor.imag, sd)}
    return Said(values, record.fit_warnings)


def _sine(record: TimeRecord) -> Said:
    hertz, starts, ends = (float(values[1]) for values in STEPS)
    steady = record.output("y").between(starts, ends)
    found = fit_sine(steady.times_s, steady.values, 2.0 * np.pi * hertz, is_frequency_free=True)
    return Said({"frequency": (float(found.omega), float(found.omega_sd))}, (), found.converged)


def _periods(record: TimeRecord) -> Any:
    return periodic_response(record, LINE_PERIOD_S, start_s=2.0 * LINE_PERIOD_S)


def _distortion(record: TimeRecord) -> Said:
    found = nonlinear_distortion(_periods(record))
    said = (found.verdict,) if found.is_nonlinear else ()
    return Said({}, (*said, *_periods(record).response.fit_warnings))


def _half_power(record: TimeRecord) -> Said:
    lines = local_polynomial_response(record)
    found = half_power_damping(lines)
    sd = max(0.01, found.largest_bias * found.damping_ratio)
    return Said({"damping": (float(found.damping_ratio), sd)}, lines.fit_warnings)


def _circle(record: TimeRecord) -> Said:
    lines = local_polynomial_response(record)
    found = circle_fit(lines, 3.2, 1.0)
    return Said({"frequency": (found.natural_frequency, found.natural_frequency_sd)}, lines.fit_warnings)


def _validated(record: TimeRecord) -> Said:
    found = validate(PLANT_OF_Y, record)
    verdicts = [str(own.verdict) for own in found.outputs]
    fit = float(found.outputs[0].scores.fit_percent)
    return Said(
        {"FIT": (fit, 1.0)}, (), all(said.startswith("good") for said in verdicts), "; ".join(verdicts)
    )


def _y(record: TimeRecord) -> TimeRecord:
    return record.select(("y",))


def _rationals(method: str) -> Estimator:
    return Estimator(
        "shaken",
        lambda r: _rational(estimate_transfer_function(_y(r), 2, 0, method=method, n_starts=1)),  # type: ignore[arg-type]
    )


PLANT_OF_Y = type(PLANT)(
    PLANT.numerator, PLANT.denominator, 0.0, np.zeros((4, 4)), 0.01, input_name="u", output_name="y"
)

ESTIMATORS: Mapping[str, Estimator] = {
    "identify, receptance": Estimator("shaken", lambda r: _modal(identify(r, "receptance", max_modes=3))),
    "identify, mobility": Estimator("shaken, velocities", lambda r: _modal(identify(r, "mobility", max_modes=3))),
    "identify, accelerance": Estimator(
        "shaken, accelerations", lambda r: _modal(identify(r, "accelerance", max_modes=3))
    ),
    "identify, base_motion": Estimator("moved", lambda r: _modal(identify(r, max_modes=2))),
    **{
        f"estimate_transfer_function, {method}": _rationals(method)
        for method in ("auto", "output_error", "srivc", "rivc", "white")
    },
    "estimate_in_closed_loop": Estimator(
        "looped",
        lambda r: _rational(
            estimate_in_closed_loop(r, SampledController([0.1], [1.0], PERIOD_S), 2, 0, "r", "u")
        ),
    ),
    "estimate_common_poles": Estimator("shaken", lambda r: _rational(estimate_common_poles(r, 2, 0))),
    "select_transfer_function": Estimator(
        "shaken", lambda r: _rational(select_transfer_function(_y(r), [2], n_zeros=[0, 1]).chosen)
    ),
    "subspace_model": Estimator("shaken", lambda r: _rational(subspace_model(r, 2))),
    "fit_free_decay": Estimator("plucked", lambda r: _modal(fit_free_decay(r.outputs, max_modes=3))),
    "fit_sine": Estimator("stepped", _sine, is_model=False),
    "fit_frequency_modes": Estimator(
        "shaken", lambda r: _modal(fit_frequency_modes(_periods(r).response, "receptance", max_modes=3))
    ),
    "fit_frequency_transfer_function": Estimator(
        "shaken", lambda r: _rational(fit_frequency_transfer_function(_periods(r).response.select(["y"]), 2, 0))
    ),
    "analyse_modes": Estimator(
        "shaken",
        lambda r: _modal(analyse_modes(stabilisation_chart(_periods(r).response, max_order=6), [3.2])),
    ),
    "hammer_response, fit_frequency_modes": Estimator(
        "hammered",
        lambda r: _modal(fit_frequency_modes(hammer_response(r).between(0.5, 15.0), "receptance", max_modes=2)),
    ),
    "hammer_response": Estimator("hammered", lambda r: _lines(hammer_response(r)), is_model=False),
    "periodic_response": Estimator("shaken", lambda r: _lines(_periods(r).response), is_model=False),
    "welch_response": Estimator(
        "shaken for long", lambda r: _lines(welch_response(r, segment_s=15.0)), is_model=False
    ),
    "local_polynomial_response": Estimator(
        "shaken for long", lambda r: _lines(local_polynomial_response(r)), is_model=False
    ),
    "stepped_sine_response": Estimator(
        "stepped", lambda r: _lines(stepped_sine_response(r, *STEPS)), is_model=False
    ),
    "nonlinear_distortion": Estimator("sparse lines", _distortion, is_model=False),
    "half_power_damping": Estimator("shaken for long", _half_power, is_model=False),
    "circle_fit": Estimator("shaken for long", _circle, is_model=False),
    "validate": Estimator("shaken", _validated, is_model=False),
}  # fmt: skip
