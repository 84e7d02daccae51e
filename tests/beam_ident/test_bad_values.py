"""Values that are not numbers, too large or out of order are refused by name, wherever a person hands them in."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from beam_ident import (
    EstimationError,
    FrequencyRecord,
    IdentificationError,
    InputSignal,
    ModalModel,
    ModelFormatError,
    MultiInputModel,
    OutputSignal,
    Prior,
    RecordError,
    TimeRecord,
    TransferFunctionModel,
    analyse_modes,
    assess_repeatability,
    circle_fit,
    complex_mode_indicator,
    estimate_common_poles,
    estimate_transfer_function,
    fit_free_decay,
    fit_frequency_modes,
    fit_frequency_transfer_function,
    fit_sine,
    half_power_damping,
    identify,
    local_polynomial_response,
    multivariate_mode_indicator,
    nonlinear_distortion,
    periodic_response,
    select_transfer_function,
    stabilisation_chart,
    stepped_sine_response,
    subspace_model,
    welch_response,
)
from tests.beam_ident import result_cases

NAN, INF = math.nan, math.inf
TIMES = 0.01 * np.arange(1, 200)
DRIVE = result_cases.record().inputs[0]


def rational() -> TransferFunctionModel:
    return result_cases.result("estimate_transfer_function").model


def modal(structure: str = "receptance") -> ModalModel:
    own = result_cases.result("identify").model
    return own if structure == "receptance" else own.driven_by(structure)


def several() -> MultiInputModel:
    return result_cases.result("several inputs").model


SIMULATIONS: dict[str, Any] = {
    "transfer function": lambda drive, times, *more: rational().simulate(drive, times, *more),
    "its deviation": lambda drive, times, *more: rational().simulation_sd(drive, times, *more),
    "modal model": lambda drive, times, *more: modal().simulate(drive, times, *more),
    "several inputs": lambda drive, times, *more: several().simulate([drive], times, *more),
}


@pytest.mark.parametrize("name", SIMULATIONS)
@pytest.mark.parametrize(
    ("times", "says"),
    [
        ([0.1, NAN], r"instants \[s\]: number 1 is nan"),
        ([INF, 0.1], r"instants \[s\]: number 0 is inf"),
        (0.1, r"of shape \(\)"),
        (np.ones((2, 2)), r"of shape \(2, 2\)"),
        (["a"], "are not numbers"),
        ([1j], "are complex"),
        ([1e3], "is known from"),
    ],
)
def test_instants_of_a_simulation_are_finite_and_known(name, times, says):
    with pytest.raises(EstimationError, match=says):
        SIMULATIONS[name](DRIVE, times)


@pytest.mark.parametrize("name", SIMULATIONS)
def test_a_simulation_needs_an_input_and_an_exposure(name):
    with pytest.raises(EstimationError, match="expected an InputSignal"):
        SIMULATIONS[name](None, TIMES)
    for exposure in (NAN, -0.1, "1", None):
        with pytest.raises(EstimationError, match="exposure_s is"):
            SIMULATIONS[name](DRIVE, TIMES, exposure)


@pytest.mark.parametrize("model", [rational, modal, several])
@pytest.mark.parametrize("omegas", [[1.0, NAN], [INF], 5.0, ["a"], [1j]])
def test_frequencies_of_a_response_are_finite(model, omegas):
    with pytest.raises(EstimationError, match=r"frequencies \[rad/s\]"):
        model().frequency_response(omegas)


@pytest.mark.parametrize("model", [rational, modal])
@pytest.mark.parametrize("times", [[NAN], [0.1, INF], [-0.1]])
@pytest.mark.parametrize("method", ["step_response", "step_response_sd"])
def test_instants_of_a_step_response_are_finite_and_after_the_step(model, times, method):
    with pytest.raises(EstimationError, match="instant"):
        getattr(model(), method)(times)


def test_a_response_that_is_infinite_is_refused():
    integrator = TransferFunctionModel([1.0], [1.0, 2.0, 0.0], 0.0, np.zeros((4, 4)), 0.0)
    with pytest.raises(EstimationError, match="pole at 0 rad/s on the imaginary axis"):
        integrator.frequency_response([0.0, 1.0])
    one = np.ones(1)
    free = ModalModel(
        "force", "u", ("y",), one, 0.1 * one, one[:, None], one, one, 0.0, 0.0, np.zeros((7, 7)), one
    )
    with pytest.raises(EstimationError, match="to force at 0 rad/s is infinite"):
        free.frequency_response([0.0, 1.0])


@pytest.mark.parametrize(
    "made",
    [
        lambda: TransferFunctionModel([NAN], [1.0, 2.0], 0.0, np.zeros((3, 3)), 1.0),
        lambda: TransferFunctionModel([1.0], [1.0, INF], 0.0, np.zeros((3, 3)), 1.0),
        lambda: TransferFunctionModel([1.0], [1.0, 2.0], NAN, np.zeros((3, 3)), 1.0),
        lambda: TransferFunctionModel([], [1.0, 2.0], 0.0, np.zeros((2, 2)), 1.0),
        lambda: TransferFunctionModel([1.0], [], 0.0, np.zeros((2, 2)), 1.0),
        lambda: TransferFunctionModel([[1.0]], [1.0, 2.0], 0.0, np.zeros((3, 3)), 1.0),
        lambda: MultiInputModel(([NAN],), ([1.0, 2.0],), (0.0,), np.zeros((3, 3)), 1.0, ("u",)),
        lambda: _one_mode(natural_frequency=NAN),
        lambda: _one_mode(natural_frequency=-1.0),
        lambda: _one_mode(damping_ratio=1.5),
        lambda: _one_mode(residue=INF),
        lambda: _one_mode(structure="admittance"),
    ],
)
def test_a_model_of_numbers_that_are_none_is_refused(made):
    with pytest.raises(ModelFormatError, match="expected"):
        made()


def _one_mode(
    structure: str = "receptance",
    natural_frequency: float = 1.0,
    damping_ratio: float = 0.1,
    residue: float = 1.0,
) -> ModalModel:
    return ModalModel(
        structure, "u", ("y",), [natural_frequency], [damping_ratio], [[residue]], [0.0], [0.0], 0.0, 0.0,
        np.zeros((7, 7)), [1.0],
    )  # fmt: skip


@pytest.mark.parametrize(
    ("delay", "says"),
    [
        (-0.1, "does not precede"),
        (100.0, "cannot separate delays that differ by 2.56"),
        (Prior(100.0, 0.1), "cannot separate delays that differ by 2.56"),
        (NAN, "finite mean"),
        (None, "delay is None"),
        ("soon", "delay is 'soon'"),
        (True, "delay is True"),
    ],
)
def test_a_delay_that_no_line_can_tell_is_refused(delay, says):
    with pytest.raises(EstimationError, match=says):
        fit_frequency_transfer_function(result_cases.lines(), 2, 0, delay=delay)


@pytest.mark.parametrize("delay", [10.24, 100.0, Prior(100.0, 0.1)])
def test_a_delay_longer_than_the_record_is_refused(delay):
    record = result_cases.record()
    with pytest.raises(EstimationError, match="nothing of it has arrived"):
        estimate_transfer_function(record.select(("y",)), 2, 0, delay=delay)
    if not isinstance(delay, Prior):
        with pytest.raises(EstimationError, match="nothing of it has arrived"):
            estimate_common_poles(record, 2, 0, delay=delay)


@pytest.mark.parametrize("delay", [-1.0, NAN, INF, None, "a"])
def test_a_delay_that_is_no_time_is_refused(delay):
    record = result_cases.record()
    with pytest.raises(EstimationError, match=r"delay is|prior is"):
        estimate_transfer_function(record.select(("y",)), 2, 0, delay=delay)
    with pytest.raises(EstimationError, match="delay is"):
        estimate_common_poles(record, 2, 0, delay=delay)


@pytest.mark.parametrize(
    "made",
    [
        lambda: InputSignal("u", "N", ("a", 0.01), np.ones(5)),
        lambda: InputSignal("u", "N", (0.0, NAN), np.ones(5)),
        lambda: InputSignal("u", "N", (0.0, 0.01), np.ones(5), "zoh", "x"),
        lambda: OutputSignal("y", "m", (0.0, 0.01), np.ones(5), exposure_s=None),
        lambda: OutputSignal("y", "m", (0.0, 0.01), np.ones(5), sigma=NAN),
        lambda: TimeRecord(result_cases.record().outputs[0], result_cases.record().outputs[1]),
        lambda: TimeRecord(None, None),
        lambda: FrequencyRecord([1.0, 2.0], [1.0, INF]),
        lambda: FrequencyRecord([1.0, 2.0], [1.0, 2.0], variance=[NAN, 1.0]),
        lambda: FrequencyRecord([1.0, 2.0], [1.0, 2.0], variance=[INF, 1.0]),
        lambda: FrequencyRecord([1.0, 2.0], [1.0, 2.0], covariance=np.full((2, 1, 1), NAN)),
        lambda: FrequencyRecord([1.0, 2.0], [1.0, 2.0], degrees_of_freedom=NAN),
        lambda: FrequencyRecord([1.0, 2.0], [1.0, 2.0], degrees_of_freedom=0),
        lambda: FrequencyRecord(["a"], ["b"]),
    ],
)
def test_records_of_values_that_are_none_are_refused(made):
    with pytest.raises(RecordError):
        made()


PEAK = [1.0, 1.0, 2.0, 5.0, 2.0, 1.0, NAN, 1.0]


def test_lines_that_were_not_measured_are_left_out():
    record = FrequencyRecord(np.arange(1.0, 9.0), PEAK)
    whole = FrequencyRecord(np.arange(1.0, 9.0), np.nan_to_num(PEAK, nan=1.0))
    assert half_power_damping(record) == half_power_damping(whole)
    for indicator in (complex_mode_indicator, multivariate_mode_indicator):
        values = indicator(record)
        assert np.array_equal(np.isnan(values[:, 0]), np.isnan(PEAK))
        np.testing.assert_allclose(np.delete(values, 6, axis=0), np.delete(indicator(whole), 6, axis=0))


def test_a_circle_passes_by_lines_that_were_not_measured():
    lines = result_cases.lines()
    gap = np.array(lines.response)
    near = int(np.argmin(np.abs(lines.frequencies_hz - 3.9)))
    gap[near] = NAN
    found = circle_fit(FrequencyRecord(lines.omegas, gap), 3.2, 3.0)
    assert lines.omegas[near] not in found.omegas
    assert found.natural_frequency == pytest.approx(20.0, rel=0.05)


def chart() -> Any:
    return stabilisation_chart(result_cases.lines(), max_order=6)


@pytest.mark.parametrize(
    "asked",
    [
        lambda: fit_sine(TIMES, np.sin(20 * TIMES)[:5], 20.0),
        lambda: fit_sine(np.full(199, NAN), np.sin(20 * TIMES), 20.0),
        lambda: fit_sine(TIMES, np.full(199, INF), 20.0),
        lambda: fit_sine(TIMES, np.sin(20 * TIMES), NAN),
        lambda: stepped_sine_response(result_cases.record(), [NAN], [0.0], [2.0]),
        lambda: stepped_sine_response(result_cases.record(), ["a"], [0.0], [2.0]),
        lambda: stepped_sine_response(None, [3.0], [0.0], [2.0]),
        lambda: welch_response(None),
        lambda: local_polynomial_response(None),
        lambda: periodic_response(None, 2.56),
        lambda: periodic_response(result_cases.record(), 2.56, excited_hz=[NAN]),
        lambda: nonlinear_distortion(None),
        lambda: half_power_damping(None),
        lambda: half_power_damping(result_cases.lines(), NAN),
        lambda: half_power_damping(result_cases.lines(), -5.0),
        lambda: circle_fit(None, 3.2, 1.0),
        lambda: circle_fit(result_cases.lines(), 3.2, NAN),
        lambda: circle_fit(result_cases.lines(), 3.2, -1.0),
        lambda: complex_mode_indicator(None),
        lambda: multivariate_mode_indicator(None),
        lambda: stabilisation_chart(None),
        lambda: analyse_modes(None),
        lambda: analyse_modes(chart(), [NAN]),
        lambda: analyse_modes(chart(), ["a"]),
        lambda: analyse_modes(chart(), 3.2),
        lambda: fit_frequency_modes(None, "receptance"),
        lambda: fit_frequency_modes(result_cases.record(), "receptance"),
        lambda: fit_frequency_modes(result_cases.lines(), "receptance", latency=0.1),
        lambda: fit_frequency_transfer_function(result_cases.record(), 2, 0),
        lambda: fit_free_decay(None),
        lambda: fit_free_decay(result_cases.record()),
        lambda: assess_repeatability(None),
        lambda: several().path(7),
        lambda: several().simulate(None, TIMES),
        lambda: rational().predict(None),
    ],
)
def test_arguments_that_are_no_such_thing_are_refused(asked):
    with pytest.raises(IdentificationError):
        asked()


@pytest.mark.parametrize("stamps", [[0.0, 0.1, 0.1], [0.0, 0.2, 0.1], [0.0, NAN, 0.2], [0.0, INF, 0.2]])
def test_stamps_that_repeat_or_run_backwards_never_reach_an_estimator(stamps):
    for made in (InputSignal, OutputSignal):
        with pytest.raises(RecordError, match=r"stamp (1|2)"):
            made("x", "m", np.array(stamps), np.ones(3))


@pytest.mark.parametrize("value", [NAN, INF, -INF])
def test_samples_that_are_no_numbers_never_reach_an_estimator(value):
    if np.isnan(value):  # a sample that is missing; at an end nothing tells what it was
        with pytest.raises(RecordError, match="known at both ends"):
            InputSignal("u", "N", (0.0, 0.1), np.array([value, 1.0, 2.0]))
    else:
        with pytest.raises(RecordError, match="value 1 is"):
            InputSignal("u", "N", (0.0, 0.1), np.array([1.0, value, 2.0]))
        with pytest.raises(RecordError, match="never inf"):
            OutputSignal("y", "m", (0.0, 0.1), np.array([1.0, value, 2.0]))


def first(n: int) -> TimeRecord:
    """Return the first samples of a sound record."""
    whole = result_cases.record(3)
    drive = InputSignal("u", "N", (0.0, result_cases.PERIOD_S), whole.inputs[0].values[: n + 1], "zoh")
    return TimeRecord(
        (drive,), tuple(OutputSignal(own.name, "m", own.times_s[:n], own.values[:n]) for own in whole.outputs)
    )


def test_records_that_do_not_overlap_are_refused():
    (drive,), (output, _) = first(60).inputs, first(60).outputs
    with pytest.raises(RecordError, match="not overlap"):
        TimeRecord((drive,), (OutputSignal("y", "m", output.times_s + 100.0, output.values),))


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
