from __future__ import annotations

import json

import numpy as np
import pytest

from beam_ident import (
    AxisLimits,
    ExcitationError,
    ExcitationLimitError,
    LogChirp,
    ModelFormatError,
    Multisine,
    Recipe,
    Step,
)

RECIPES = [
    LogChirp(),
    Multisine(still_s=2.0),
    Multisine(odd_only=True, seed=3),
    Step(hold_s=1.0, still_s=1.0),
]


@pytest.mark.parametrize("recipe", RECIPES, ids=lambda r: r.kind)
@pytest.mark.parametrize("period", [1e-3, 0.7e-3])
def test_exact_integration_of_the_held_accelerations_ends_at_rest_at_home(recipe, period):
    excitation = recipe.sample(period)
    velocity = position = 0.0
    for a in excitation.accelerations:
        position += period * velocity + 0.5 * period**2 * a
        velocity += period * a
    # Rounding only: thousands of sums of numbers below 1 m/s^2.
    assert abs(velocity) < 1e-12
    assert abs(position) < 1e-12


@pytest.mark.parametrize("recipe", RECIPES, ids=lambda r: r.kind)
def test_a_recipe_survives_json_exactly(recipe):
    again = Recipe.from_dict(json.loads(json.dumps(recipe.to_dict())))
    assert again == recipe
    np.testing.assert_array_equal(again.sample().accelerations, recipe.sample().accelerations)


def test_the_chirp_keeps_its_acceleration_and_its_ceiling():
    excitation = LogChirp(acceleration=0.7, displacement_ceiling=0.005).sample()
    assert np.max(np.abs(excitation.positions)) <= 0.005
    # The half-tick differences and the rounded corner take a little, the fades overshoot nothing.
    assert 0.68 < np.max(np.abs(excitation.accelerations)) < 0.71
    still = excitation.accelerations[-9900:]
    assert np.max(np.abs(still)) == 0.0


def test_the_multisine_has_its_lines_its_level_and_its_seed():
    recipe = Multisine(low_hz=2.0, high_hz=20.0, line_period_s=5.0, odd_only=True, displacement_ceiling=1.0)
    assert np.all(np.round(recipe.lines_hz * 5.0).astype(int) % 2 == 1)
    excitation = recipe.sample()
    steady = excitation.accelerations[2500:7500]
    assert np.std(steady) == pytest.approx(0.5, rel=0.02)  # sinc attenuation at 20 Hz is 0.1 %
    other = Multisine(
        low_hz=2.0, high_hz=20.0, line_period_s=5.0, odd_only=True, displacement_ceiling=1.0, seed=1
    )
    assert not np.allclose(other.sample().accelerations, excitation.accelerations)


def test_limits_are_checked_between_the_ticks_too():
    excitation = Step(distance=0.01).sample()
    excitation.check(AxisLimits(travel=0.0101, speed=1.0, acceleration=10.0))
    for limits, word in (
        (AxisLimits(travel=0.005), "travel"),
        (AxisLimits(speed=0.01), "speed"),
        (AxisLimits(acceleration=0.1), "acceleration"),
    ):
        with pytest.raises(ExcitationLimitError, match=f"peak {word}"):
            excitation.check(limits)
        with pytest.raises(ExcitationLimitError):
            Step(distance=0.01).sample(limits=limits)


def test_samples_serve_every_command_mode():
    excitation = Step(hold_s=1.0, still_s=1.0).sample()
    for quantity, hold in (("acceleration", "zoh"), ("velocity", "linear"), ("position", "cubic")):
        signal = excitation.input_signal(quantity)
        assert signal.hold == hold
    with pytest.raises(ExcitationError, match="quantity is 'force'"):
        excitation.samples("force")


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: LogChirp(start_hz=0.0), "start_hz is 0.0"),
        (lambda: LogChirp(end_hz=0.5), "above start_hz"),
        (lambda: LogChirp(sweep_s=float("nan")), "sweep_s is nan"),
        (lambda: LogChirp(fade_in_s=15.0), "half of sweep_s"),
        (lambda: Multisine(n_periods=0), "n_periods is 0"),
        (lambda: Multisine(low_hz=0.11, high_hz=0.15, line_period_s=10.0), "at least one line"),
        (lambda: Step(distance=0.0), "distance is 0.0"),
        (lambda: Step().sample(period_s=0.0), "period_s is 0.0"),
    ],
)
def test_impossible_recipes_are_refused(make, says):
    with pytest.raises(ExcitationError, match=says):
        make()


def test_unknown_recipes_are_refused():
    with pytest.raises(ModelFormatError, match="kind is 'noise'"):
        Recipe.from_dict({"schema": 1, "kind": "noise"})
    with pytest.raises(ModelFormatError, match="unknown field 'amplitude'"):
        Recipe.from_dict({"schema": 1, "kind": "step", "amplitude": 1.0})
    with pytest.raises(ModelFormatError, match="schema is 7"):
        Recipe.from_dict({"schema": 7, "kind": "step"})
