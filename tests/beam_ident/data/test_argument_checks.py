"""Bad arguments and dead signals are refused by name, by every estimator alike."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from beam_ident import (
    EstimationError,
    InputSignal,
    ModalModel,
    OutputSignal,
    RecordError,
    SampledController,
    TimeRecord,
    TransferFunctionModel,
    compare_models,
    estimate_common_poles,
    estimate_in_closed_loop,
    estimate_transfer_function,
    fit_free_decay,
    identify,
    select_transfer_function,
    stabilisation_chart,
    subspace_model,
    validate,
)
from beam_ident.data.argument_checks import require_records
from beam_ident.data.frequency_record import FrequencyRecord
from beam_ident.responses.local_polynomial import local_polynomial_response
from beam_ident.responses.periodic_averaging import periodic_response
from beam_ident.responses.spectral import welch_response

PERIOD = 0.01
STAMPS = PERIOD * np.arange(1, 400)
PLANT = TransferFunctionModel(
    np.array([400.0]), np.array([1.0, 2.0, 400.0]), 0.0, np.zeros((4, 4)), 1.0, "u", "y"
)
MODES = ModalModel(
    "receptance", "u", ("y",), np.array([20.0]), np.array([0.05]), np.array([[400.0]]), np.zeros(1), np.ones(1),
    0.0, 0.0, np.zeros((7, 7)), np.ones(1),
)  # fmt: skip


def record_of(
    output_scale: float = 1.0, input_scale: float = 1.0, constant: float | None = None
) -> TimeRecord:
    rng = np.random.default_rng(1)
    period = rng.standard_normal(100)
    drive = InputSignal("u", "N", (0.0, PERIOD), input_scale * np.tile(period, 5), "zoh")
    other = InputSignal("r", "N", (0.0, PERIOD), np.tile(period, 5), "zoh")
    seen = output_scale * (PLANT.simulate(other, STAMPS) + 0.01 * rng.standard_normal(len(STAMPS)))
    if constant is not None:
        seen = np.full_like(seen, constant)
    return TimeRecord((drive,), (OutputSignal("y", "m", STAMPS, seen),))


def looped(record: TimeRecord) -> Any:
    reference = InputSignal("r", "N", (0.0, PERIOD), np.tile([1.0, -1.0], 250), "zoh")
    pair = TimeRecord((reference, *record.inputs), record.outputs)
    return estimate_in_closed_loop(pair, SampledController([0.1], [1.0], PERIOD), 2, 0, "r", "u")


ESTIMATORS = {
    "identify": lambda record: identify(record, "receptance"),
    "estimate_transfer_function": lambda record: estimate_transfer_function(record, 2, 0),
    "estimate_common_poles": lambda record: estimate_common_poles(record, 2, 0),
    "select_transfer_function": lambda record: select_transfer_function(record, range(1, 3)),
    "estimate_in_closed_loop": looped,
    "subspace_model": lambda record: subspace_model(record, 2),
    "welch_response": welch_response,
    "local_polynomial_response": local_polynomial_response,
    "periodic_response": lambda record: periodic_response(record, 1.0),
    "fit_free_decay": lambda record: fit_free_decay(record.outputs),
    "validate transfer function": lambda record: validate(PLANT, record),
    "validate modal model": lambda record: validate(MODES, record),
}
DRIVEN = [
    name for name in ESTIMATORS if name not in ("identify", "fit_free_decay") and "validate" not in name
]


@pytest.mark.parametrize("name", ESTIMATORS)
@pytest.mark.parametrize("constant", [0.0, 2.5])
def test_an_output_that_never_moves_is_refused_by_name(name, constant):
    with pytest.raises(EstimationError, match=f"output 'y' is constant .{constant:g}"):
        ESTIMATORS[name](record_of(constant=constant))


@pytest.mark.parametrize("name", ESTIMATORS)
@pytest.mark.parametrize("scale", [1e200, 1e-200])
def test_an_output_whose_squares_overflow_or_vanish_is_refused(name, scale):
    with pytest.raises(EstimationError, match=r"output 'y' reaches .* Check its unit"):
        ESTIMATORS[name](record_of(output_scale=scale))


@pytest.mark.parametrize("name", DRIVEN)
def test_an_input_at_rest_is_refused_where_nothing_else_moves(name):
    with pytest.raises(
        EstimationError, match=r"'u' (is zero throughout|is constant \(0\)|has no line)|no line"
    ):
        ESTIMATORS[name](record_of(input_scale=0.0))


@pytest.mark.parametrize("name", [name for name in DRIVEN if name != "periodic_response"] + ["identify"])
def test_an_input_of_absurd_size_is_refused(name):
    with pytest.raises(EstimationError, match="input 'u' reaches"):
        ESTIMATORS[name](record_of(input_scale=1e200))


LINES = FrequencyRecord(
    np.linspace(1.0, 100.0, 200), np.ones(200) + 0j, output_names=("y",), input_names=("u",)
)


@pytest.mark.parametrize("value", [2.5, "2", True, None, float("nan")])
@pytest.mark.parametrize(
    "asked",
    [
        lambda record, n: estimate_transfer_function(record, n, 0),
        lambda record, n: estimate_transfer_function(record, 2, n),
        lambda record, n: estimate_transfer_function(record, 2, 0, n_starts=n),
        lambda record, n: estimate_common_poles(record, n, 0),
        lambda record, n: select_transfer_function(record, [n]),
        lambda record, n: subspace_model(record, n),
        lambda record, n: identify(record, "receptance", n_modes=3 if n is None else n, max_modes=n),
        lambda record, n: fit_free_decay(record.outputs, max_modes=n),
        lambda record, n: stabilisation_chart(LINES, max_order=n),
    ],
)
def test_an_order_that_is_no_whole_number_is_refused(asked, value):
    with pytest.raises(EstimationError, match=r"expected a whole number"):
        asked(record_of(), value)


@pytest.mark.parametrize(
    ("asked", "says"),
    [
        (lambda r: estimate_transfer_function([r, 3], 2, 0), "expected one TimeRecord"),
        (lambda r: subspace_model(None, 2), "record is a NoneType"),
        (lambda r: identify([r, 3], "receptance"), "record is a int"),
        (lambda r: identify(r, "receptance", latency=0.01), "latency is 0.01; expected a Prior"),
        (lambda r: estimate_transfer_function(r, 2, 0, cutoff=-1.0), "cutoff is -1.0"),
        (lambda r: estimate_transfer_function(r, 2, 0, cutoff=float("nan")), "cutoff is nan"),
        (lambda r: select_transfer_function(r, 3), "expected ranges or lists"),
        (lambda r: validate(3, r), "model is a int"),
        (lambda r: compare_models(MODES, PLANT), "a TransferFunctionModel is to be compared"),
        (lambda r: welch_response(r, segment_s=float("nan")), "segment_s is nan"),
        (lambda r: periodic_response(r, float("nan")), "expected at least 4"),
        (lambda r: local_polynomial_response(r, degree=40), "0 to 10"),
    ],
)
def test_other_arguments_are_refused_with_what_was_expected(asked, says):
    with pytest.raises(EstimationError, match=says):
        asked(record_of())


def test_validation_needs_more_than_a_handful_of_samples():
    with pytest.raises(EstimationError, match="3 samples"):
        validate(PLANT, record_of().between(0.005, 0.035))


@pytest.mark.parametrize("values", [["a"] * 3, [1.0, 2j, 3.0], [[1.0], [2.0, 3.0]]])
def test_values_that_are_no_real_numbers_are_refused(values):
    with pytest.raises(RecordError, match="expected real numbers"):
        OutputSignal("y", "m", (0.0, 0.1), values)
    with pytest.raises(RecordError, match="expected real numbers"):
        InputSignal("u", "N", values, np.ones(3))


def test_records_of_one_fit_have_the_same_outputs_unless_one_may_lack_them():
    drive = InputSignal("u", "", (0.0, PERIOD), np.ones(400))
    first, second = (OutputSignal(name, "m", STAMPS, STAMPS) for name in ("first", "second"))
    records = [TimeRecord((drive,), (first, second)), TimeRecord((drive,), (first,))]
    with pytest.raises(EstimationError, match="expected the same outputs in all records"):
        require_records(records)
    assert require_records(records, may_lack_outputs=True) == records
