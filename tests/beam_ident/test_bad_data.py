"""Data that cannot be identified from are refused or flagged, by every estimator, and in bounded time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from beam_ident import (
    IdentificationError,
    InputSignal,
    OutputSignal,
    RecordError,
    TimeRecord,
    analyse_modes,
    circle_fit,
    estimate_common_poles,
    estimate_transfer_function,
    fit_free_decay,
    fit_frequency_modes,
    fit_frequency_transfer_function,
    half_power_damping,
    identify,
    local_polynomial_response,
    nonlinear_distortion,
    periodic_response,
    select_transfer_function,
    stabilisation_chart,
    stepped_sine_response,
    subspace_model,
    validate,
    welch_response,
)
from tests.beam_ident import result_cases
from tests.beam_ident.result_cases import PERIOD_S, PLANT

BASE = result_cases.record(3)
FORCE = np.asarray(BASE.inputs[0].values)
SEEN = [np.asarray(output.values) for output in BASE.outputs]
STAMPS = np.asarray(BASE.outputs[0].times_s)


def record_of(
    force: np.ndarray = FORCE, seen: list[np.ndarray] = SEEN, stamps: np.ndarray = STAMPS
) -> TimeRecord:
    drive = InputSignal("u", "N", (0.0, PERIOD_S), force, "zoh")
    outputs = (OutputSignal(n, "m", stamps[: len(y)], y) for n, y in zip("yz", seen, strict=True))
    return TimeRecord((drive,), tuple(outputs))


def first(n: int) -> TimeRecord:
    return record_of(FORCE[: max(n + 1, 2)], [y[:n] for y in SEEN], STAMPS[:n])


def periods(record: TimeRecord) -> Any:
    return periodic_response(record, 2.56, start_s=2.56)


ESTIMATORS: dict[str, Callable[[TimeRecord], Any]] = {
    "identify": lambda r: identify(r, "receptance", max_modes=3),
    "estimate_transfer_function": lambda r: estimate_transfer_function(r.select(("y",)), 2, 0, n_starts=1),
    "with a free delay": lambda r: estimate_transfer_function(
        r.select(("y",)), 2, 0, delay="estimate", n_starts=1
    ),
    "rivc": lambda r: estimate_transfer_function(r.select(("y",)), 2, 0, method="rivc", n_starts=1),
    "estimate_common_poles": lambda r: estimate_common_poles(r, 2, 0, has_offset=True),
    "select_transfer_function": lambda r: select_transfer_function(r.select(("y",)), [2]).chosen,
    "subspace_model": lambda r: subspace_model(r, 2),
    "welch_response": welch_response,
    "local_polynomial_response": local_polynomial_response,
    "periodic_response": lambda r: periods(r).response,
    "stepped_sine_response": lambda r: stepped_sine_response(r, [3.0], [0.5], [2.5]),
    "nonlinear_distortion": lambda r: nonlinear_distortion(periods(r)),
    "fit_free_decay": lambda r: fit_free_decay(r.outputs, max_modes=3),
    "fit_frequency_modes": lambda r: fit_frequency_modes(periods(r).response, "receptance", max_modes=3),
    "fit_frequency_transfer_function": lambda r: fit_frequency_transfer_function(
        periods(r).response.select(["y"]), 2, 0
    ),
    "analyse_modes": lambda r: analyse_modes(stabilisation_chart(local_polynomial_response(r), max_order=6)),
    "half_power_damping": lambda r: half_power_damping(local_polynomial_response(r)),
    "circle_fit": lambda r: circle_fit(local_polynomial_response(r), 3.2, 1.0),
    "validate": lambda r: validate(result_cases.result("estimate_transfer_function").model, r),
}

HOPELESS: dict[str, Callable[[], TimeRecord]] = {
    "one sample": lambda: first(1),
    "three samples": lambda: first(3),
    "nine samples": lambda: first(9),
    "all but five missing": lambda: record_of(seen=[np.where(np.arange(len(y)) < 5, y, np.nan) for y in SEEN]),
    "a hundredth of a second in common": lambda: record_of(stamps=STAMPS + 7.675),
    "a constant output": lambda: record_of(seen=[np.full(len(y), 3.0) for y in SEEN]),
    "an output that moves by rounding": lambda: record_of(seen=[3.0 + 4e-16 * np.sign(y) for y in SEEN]),
    "an input at rest": lambda: record_of(np.zeros(len(FORCE))),
    "an input that moves when all is over": lambda: record_of(np.concatenate([np.zeros(len(FORCE) - 1), [1.0]])),
}  # fmt: skip

WRONG: dict[str, Callable[[], TimeRecord]] = {
    "noise for an output": lambda: record_of(
        seen=[np.random.default_rng(k).standard_normal(len(y)) for k, y in enumerate(SEEN)]
    ),
    "a growing output": lambda: record_of(seen=[np.exp(3.0 * STAMPS), -np.exp(3.0 * STAMPS)]),
    "a wild value": lambda: record_of(seen=[np.where(np.arange(len(y)) == 400, 1e6, y) for y in SEEN]),
    "the plant, stamps in disorder": lambda: record_of(
        stamps=np.sort(np.random.default_rng(0).uniform(0.0, 7.6, len(STAMPS)))
    ),
}
MODELS = (
    "identify", "estimate_transfer_function", "with a free delay", "rivc", "estimate_common_poles",
    "select_transfer_function", "subspace_model", "fit_frequency_modes", "fit_frequency_transfer_function",
)  # fmt: skip
OF_THE_OUTPUT_ALONE = ("fit_free_decay", "identify")  # an input at rest leaves them a decay
RESPONSES = (
    "periodic_response",
    "stepped_sine_response",
    "nonlinear_distortion",
    "validate",
    "welch_response",
)


def values_of(found: Any) -> np.ndarray:
    """Return the numbers that a result states."""
    model = getattr(found, "models", [getattr(found, "model", found)])[0]
    for name in ("parameters", "poles", "natural_frequencies", "response"):
        if hasattr(model, name):
            return np.asarray(getattr(model, name))
    return np.zeros(0)


def is_doubted(found: Any) -> bool:
    """Whether a result says of itself that it is not to be believed."""
    return bool(getattr(found, "warnings", ())) or not getattr(found, "converged", True)


@pytest.mark.parametrize("name", ESTIMATORS)
@pytest.mark.parametrize("case", HOPELESS)
@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_data_that_hold_nothing_are_refused_or_flagged(name, case):
    try:
        found = ESTIMATORS[name](HOPELESS[case]())
    except IdentificationError:
        return  # what it says is tested where it is raised
    assert np.all(np.isfinite(values_of(found)))
    if name in MODELS and "input" not in case:
        assert is_doubted(found)


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("case", WRONG)
@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_a_model_of_data_that_have_none_is_refused_or_flagged(name, case):
    try:
        found = ESTIMATORS[name](WRONG[case]())
    except IdentificationError:
        return  # what it says is tested where it is raised
    assert np.all(np.isfinite(values_of(found)))
    assert is_doubted(found)


@pytest.mark.parametrize("stamps", [[0.0, 0.1, 0.1], [0.0, 0.2, 0.1], [0.0, np.nan, 0.2], [0.0, np.inf, 0.2]])
def test_stamps_that_repeat_or_run_backwards_never_reach_an_estimator(stamps):
    for made in (InputSignal, OutputSignal):
        with pytest.raises(RecordError, match=r"stamp (1|2)"):
            made("x", "m", np.array(stamps), np.ones(3))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_samples_that_are_no_numbers_never_reach_an_estimator(value):
    if np.isnan(value):  # a sample that is missing; at an end nothing tells what it was
        with pytest.raises(RecordError, match="known at both ends"):
            InputSignal("u", "N", (0.0, 0.1), np.array([value, 1.0, 2.0]))
    else:
        with pytest.raises(RecordError, match="value 1 is"):
            InputSignal("u", "N", (0.0, 0.1), np.array([1.0, value, 2.0]))
        with pytest.raises(RecordError, match="never inf"):
            OutputSignal("y", "m", (0.0, 0.1), np.array([1.0, value, 2.0]))


def test_records_that_do_not_overlap_are_refused():
    with pytest.raises(RecordError, match="not overlap"):
        record_of(stamps=STAMPS + 100.0)


@pytest.mark.parametrize("order", [0, 40])
@pytest.mark.parametrize(
    "asked",
    [
        lambda n: estimate_transfer_function(first(60).select(("y",)), n, 0),
        lambda n: estimate_common_poles(first(60), n, 0),
        lambda n: select_transfer_function(first(60).select(("y",)), [n]),
        lambda n: subspace_model(first(60), n),
        lambda n: identify(first(60), "receptance", n_modes=n),
        lambda n: fit_free_decay(first(60).outputs, n),
        lambda n: fit_frequency_modes(result_cases.lines().between(0.0, 10.0), "receptance", n_modes=n),
        lambda n: fit_frequency_transfer_function(result_cases.lines(), n, 0),
        lambda n: stabilisation_chart(result_cases.lines().between(0.0, 10.0), max_order=n),
    ],
)
def test_orders_of_nothing_and_of_forty_are_refused(asked, order):
    with pytest.raises(IdentificationError):
        asked(order)


def test_the_plant_itself_is_neither_refused_nor_flagged():
    record = result_cases.record()
    assert PLANT.n_poles == 2
    for name in MODELS:
        if name != "fit_frequency_modes":
            assert not is_doubted(ESTIMATORS[name](record)), name
