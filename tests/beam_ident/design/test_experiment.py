"""Designed experiments: within their limits, better than the best usual ones, refused where nothing can be shown."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from beam_ident import (
    AxisLimits,
    ExcitationError,
    ExcitationLimitError,
    ExcitationLimits,
    ExperimentDesign,
    InputSignal,
    LimitedResponse,
    ModalModel,
    OutputSignal,
    TimeRecord,
    design_experiment,
    identify,
)
from beam_ident.design.experiment import drive_of
from beam_ident.design.precision import Observation, predicted_model
from tests.beam_ident.design.test_spectrum import limits, two_modes

OBSERVATION = Observation(100.0, {"low": 5e-6, "tip": 5e-6}, 2e-3)


def design(criterion: str = "D", **changes: Any) -> ExperimentDesign:
    model = changes.pop("model", two_modes())
    arguments: dict[str, Any] = {
        "limits": limits(model),
        "observation": OBSERVATION,
        "duration_s": 8.0,
        "band_hz": (1.0, 45.0),
        "criterion": criterion,
        **changes,
    }
    return design_experiment(model, **arguments)


@pytest.fixture(scope="module")
def uncertain() -> ExperimentDesign:
    return design(frequency_sd=0.01, damping_sd=0.2)


@pytest.fixture(scope="module")
def certain() -> ExperimentDesign:
    return design()


@pytest.mark.slow
def test_the_design_keeps_all_limits_whatever_the_poles_are(uncertain: ExperimentDesign):
    model, own = two_modes(), limits(two_modes())
    assert max(uncertain.optimal.shares.values()) <= 0.95
    for factor, ratio in ((0.99, 0.9), (1.01, 0.8), (1.0, 0.75)):
        moved = replace(
            model,
            natural_frequencies=factor * model.natural_frequencies,
            damping_ratios=ratio * model.damping_ratios,
        )
        # Draws stand for the distribution: between them a peak may be a little higher.
        assert max(own.with_poles(model, moved).shares(uncertain.recipe).values()) < 1.0
    for candidate in (uncertain.chirp, uncertain.multisine):
        assert max(candidate.shares.values()) <= 0.95 + 1e-9
        assert candidate.recipe.total_s == pytest.approx(8.0)


@pytest.mark.slow
def test_the_design_beats_the_best_usual_excitations(uncertain: ExperimentDesign, certain: ExperimentDesign):
    assert uncertain.gain < 0.9
    assert uncertain.optimal.value < uncertain.multisine.value
    assert certain.gain < uncertain.gain
    assert f"{certain.worst_gain:.2g} of the chirp's" in str(certain)
    # Where the poles lie elsewhere the design that knew of it loses less.
    moved = two_modes()
    moved = replace(moved, natural_frequencies=1.015 * moved.natural_frequencies)

    def there(one: ExperimentDesign) -> float:
        found = predicted_model(moved, drive_of(one.recipe, moved, limits(moved)), OBSERVATION)
        return one.criterion.value(found) / one.optimal.value

    assert there(uncertain) < there(certain)


@pytest.mark.slow
def test_each_criterion_is_best_at_its_own(certain: ExperimentDesign):
    damping = design("c:zeta_2")
    assert damping.worst_parameter == "zeta_2"
    assert damping.optimal.pole_sd["zeta_2"] < certain.optimal.pole_sd["zeta_2"]
    assert certain.optimal.pole_sd["zeta_1"] < damping.optimal.pole_sd["zeta_1"]


@pytest.mark.slow
def test_estimates_scatter_as_predicted(uncertain: ExperimentDesign):
    model = two_modes()
    recipe, predicted = uncertain.recipe, uncertain.optimal.predicted
    drive = drive_of(recipe, model, limits(model))
    times = OBSERVATION.stamps(recipe.total_s)
    clean = model.simulate(drive, times, OBSERVATION.exposure_s)
    found = []
    for seed in range(8):
        noise = 5e-6 * np.random.default_rng(seed).standard_normal(clean.shape)
        outputs = [
            OutputSignal(name, "m", times, clean[:, j] + noise[:, j], OBSERVATION.exposure_s)
            for j, name in enumerate(model.output_names)
        ]
        led = InputSignal("hub", "m", drive.times_s, drive.values, "cubic")
        found.append(identify(TimeRecord((led,), tuple(outputs)), n_modes=2).model.parameters[:4])
    scores = (np.array(found) - model.parameters[:4]) / predicted.standard_deviations[:4]
    # 32 scores of which those of one parameter are independent: a mean square of 1 +- 0.25 each.
    assert 0.5 < np.sqrt(np.mean(scores**2)) < 1.5


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"duration_s": 1.0}, "expected at least 2.67 s"),
        ({"band_hz": (1.0, 15.0)}, "modes at 21 Hz lie outside"),
        ({"band_hz": (1.0, 400.0)}, "half the rate of the hold"),
        ({"margin": 0.0}, "margin"),
        ({"model": replace(two_modes(), damping_ratios=np.array([0.0, 0.01]))}, "expected numbers above 0"),
        ({"observation": replace(OBSERVATION, noise_sd={"low": 1e-6})}, "names no tip"),
        ({"frequency_sd": -1.0}, "frequency_sd"),
        ({"criterion": "c:zeta_7"}, "no such parameter"),
        ({"observation": replace(OBSERVATION, rate_hz=20.0, exposure_s=1.0 / 21.0)}, "averages whole cycles"),
        (
            {"model": replace(two_modes(), residues=np.array([[0.2, 0.0], [1.5, 0.0]]))},
            "the mode at 21 Hz shows in no output",
        ),
        (
            {"limits": replace(limits(two_modes()), axis=AxisLimits(), responses=())},
            "no quantity has a limit",
        ),
    ],
)
def test_what_no_design_can_be_made_of_is_refused(changes: dict[str, Any], said: str):
    with pytest.raises(ExcitationError, match=said):
        design(**changes)


@pytest.mark.slow
def test_limits_that_leave_no_excitation_are_named_with_what_would_do():
    tiny = replace(limits(two_modes()), axis=AxisLimits(travel=1e-9, acceleration=4.0))
    with pytest.raises(ExcitationLimitError, match=r"the limit of travel binds\. Raise it by a factor of"):
        design(limits=tiny)


@pytest.mark.slow
def test_a_design_that_the_tip_alone_limits_beats_the_usual_ones() -> None:
    # At 45 Hz the tip hardly moves with the base: next to it, lines at the first resonance have little acceleration.
    model = ModalModel(
        structure="base_motion",
        input_name="hub",
        output_names=("tip",),
        natural_frequencies=2.0 * np.pi * np.array([4.4, 28.3]),
        damping_ratios=np.array([0.005, 0.005]),
        residues=np.array([[1.5, -0.75]]),
        residual_terms=np.zeros(1),
        gains=np.ones(1),
        latency=0.0,
        clock_rate=0.0,
        covariance=np.zeros((10, 10)),
        noise_sd=np.ones(1),
    )
    found = design(
        model=model,
        limits=ExcitationLimits(AxisLimits(), [LimitedResponse(model, {"tip": 0.03})]),
        observation=Observation(100.0, {"tip": 5e-6}, 5e-3, input_sd=3e-8),
    )
    assert found.gain < 0.8
    assert found.optimal.value < 0.8 * found.multisine.value


def test_an_exposure_longer_than_a_frame_is_refused() -> None:
    with pytest.raises(ExcitationError, match=r"exposure_s is 5\.0; expected at most 0\.01 s"):
        Observation(100.0, {"tip": 5e-6}, 5.0)
