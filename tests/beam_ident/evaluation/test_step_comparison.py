"""Step responses of several models against each other and against a measured step."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ident import EstimationError, InputSignal, OutputSignal, Step, TimeRecord, TransferFunctionModel
from beam_ident.evaluation.step_comparison import compare_step_responses
from tests.beam_ident.design.test_prediction import model as modal_model


def second_order(omega: float, zeta: float, output_name: str = "y") -> TransferFunctionModel:
    return TransferFunctionModel(
        numerator=np.array([omega**2]),
        denominator=np.array([1.0, 2 * zeta * omega, omega**2]),
        delay=0.0,
        covariance=np.zeros((4, 4)),
        noise_sd=0.0,
        output_name=output_name,
    )


def test_the_fit_percentage_is_that_of_the_closed_form():
    times = np.linspace(0.0, 10.0, 4001)
    omegas, zeta = (2.0, 2.2), 0.1
    comparison = compare_step_responses(
        {"slow": second_order(2.0, zeta), "fast": second_order(2.2, zeta)}, times_s=times
    )
    y = []
    for omega in omegas:
        damped = omega * np.sqrt(1 - zeta**2)
        y.append(
            1
            - np.exp(-zeta * omega * times)
            * (np.cos(damped * times) + zeta * omega / damped * np.sin(damped * times))
        )
    np.testing.assert_allclose(comparison.responses, y, atol=1e-9)
    for i in range(2):
        for j in range(2):
            error = np.linalg.norm(y[i] - y[j]) / np.linalg.norm(y[i] - np.mean(y[i]))
            assert comparison.fit_percent[i, j] == pytest.approx(100 * (1 - error), abs=1e-6)
    assert comparison.measured_fit_percent is None


@pytest.mark.parametrize("slow", [2.0, 0.02])
def test_default_times_last_until_the_slowest_model_has_settled(slow):
    comparison = compare_step_responses({"a": second_order(slow, 0.05), "b": second_order(10 * slow, 0.5)})
    assert comparison.times_s[-1] == pytest.approx(5 / (0.05 * slow))
    # Twenty samples to a period of the fastest pole.
    assert np.diff(comparison.times_s)[0] == pytest.approx(2 * np.pi / (10 * slow) / 20, rel=1e-3)
    np.testing.assert_allclose(np.diag(comparison.fit_percent), 100.0)
    # A heavily damped response of little scale stands badly for a lightly damped one and worse the other way.
    assert comparison.fit_percent[1, 0] < comparison.fit_percent[0, 1] < 50.0


def test_a_measured_step_scores_every_model():
    drive = InputSignal("u", "", (0.0, 0.01), np.r_[np.zeros(100), np.ones(1900)], "zoh")
    times = 0.01 * np.arange(1, 1990)
    truth = second_order(3.0, 0.1)
    noise = 0.01 * np.random.default_rng(4).standard_normal(len(times))
    record = TimeRecord((drive,), (OutputSignal("y", "", times, truth.simulate(drive, times) + noise),))
    comparison = compare_step_responses(
        {"right": truth, "wrong": second_order(3.3, 0.1)}, drive=drive, record=record
    )
    right, wrong = comparison.measured_fit_percent
    y = truth.simulate(drive, times) + noise
    assert right == pytest.approx(100 * (1 - np.linalg.norm(noise) / np.linalg.norm(y - y.mean())), abs=0.2)
    assert wrong < 80.0
    text = str(comparison).splitlines()
    assert text[0] == "fit percentage of y on a step"
    assert text[-1].startswith("measured")
    assert len(text) == 5


def test_modal_models_answer_a_smooth_step_of_their_base():
    step = Step(step_size=0.01, rise_time=0.1, duration=5.2, still=2.0).sample(2e-3)
    models = {"a": modal_model(), "b": modal_model(frequency=4.1)}
    comparison = compare_step_responses(models, step.input_signal("position", "hub"), output_name="tip")
    assert comparison.responses.shape[0] == 2
    # The same step in the quantity that another structure takes.
    accelerated = compare_step_responses(
        {"a": modal_model("acceleration"), "b": modal_model("acceleration", frequency=4.1)},
        step.input_signal("acceleration", "hub"),
        times_s=comparison.times_s,
        output_name="tip",
    )
    np.testing.assert_allclose(accelerated.fit_percent, comparison.fit_percent, atol=0.5)


@pytest.mark.parametrize(
    ("models", "arguments", "says"),
    [
        ({"a": second_order(1.0, 0.1)}, {}, "1 given; expected at least two"),
        ({"a": modal_model(), "b": modal_model()}, {}, "expected one of them"),
        ({"a": modal_model(), "b": modal_model()}, {"output_name": "tip"}, "cannot jump"),
        ({"a": second_order(1.0, 0.1), "b": second_order(1.0, 0.1, "z")}, {}, "'b' has no output 'y'"),
        ({"a": second_order(1.0, 0.0), "b": second_order(1.0, 0.1)}, {}, "give times_s"),
        ({"a": second_order(1.0, 0.1), "b": second_order(2.0, 0.1)}, {"times_s": [np.nan, 1.0]}, "finite"),
    ],
)
def test_what_cannot_be_compared_is_refused(models, arguments, says):
    with pytest.raises(EstimationError, match=says):
        compare_step_responses(models, **arguments)
