"""What holds for every recipe: exact return, exact storage, limits, refusals."""

from __future__ import annotations

import dataclasses
import json
import math

import numpy as np
import pytest

import beam_ident
from beam_ident import (
    AxisLimits,
    BandLimitedNoise,
    Doublet,
    ExcitationError,
    ExcitationLimitError,
    LinearChirp,
    LogChirp,
    ModelFormatError,
    Multisine,
    PointToPoint,
    Prbs,
    Pulse,
    Recipe,
    ShapedMove,
    ShapedMultisine,
    Sine,
    Step,
    SteppedSine,
    Trajectory,
)
from beam_ident.excitation import RECIPES as KINDS
from beam_ident.excitation import describe_recipe

RECIPES = [
    LogChirp(duration=5.0, still=1.0),
    LinearChirp(start_frequency=40.0, end_frequency=2.0, duration=5.0, still=1.0, max_velocity=0.01),
    Multisine(end_frequency=20.0, line_period=2.0, still=1.0),
    Multisine(
        end_frequency=20.0, line_period=4.0, n_periods=1, lines="random_odd", detection_group=4, seed=3
    ),
    Multisine(end_frequency=8.0, line_period=1.0, still=0.0, phases="crest"),
    Multisine(end_frequency=20.0, line_period=2.0, phases="schroeder", max_velocity=0.001),
    ShapedMultisine(duration=5.0, still=1.0),
    ShapedMultisine(frequencies=(7.3,), amplitudes=(3.0,), line_phases=(1.0,), duration=2.5, still=0.0),
    Prbs(order=9, clock_period=0.007, still=1.0),
    Prbs(drive="velocity", amplitude=0.01, order=8, clock_period=0.014, edge_time=0.005, high_pass=0.5),
    Prbs(drive="position", amplitude=-1e-4, order=7, clock_period=0.014, edge_time=0.01, inverse_repeat=True),
    Step(duration=1.4, still=1.0),
    Pulse(still=1.0),
    Pulse(drive="velocity", amplitude=0.01, edge_time=0.0, width=0.1003),
    Pulse(drive="acceleration", amplitude=0.3, edge_time=0.01),
    Doublet(still=1.0),
    Doublet(drive="velocity", amplitude=0.01),
    Doublet(drive="acceleration", amplitude=0.3, edge_time=0.0),
    Sine(duration=2.5, still=1.0),
    Sine(duration=2.5, fade_cycles=5.0, still=1.0),
    SteppedSine(frequencies=(3.0, 9.0, 5.0), measure_cycles=3),
    BandLimitedNoise(end_frequency=20.0, duration=4.0, still=0.0),
    PointToPoint(still=1.0),
    PointToPoint(waypoints=(0.1, 0.3, 0.0), profile="quintic", still=0.0),
    PointToPoint(waypoints=(-1e-5, 0.0), profile="cycloidal", dwell=0.0),
    Trajectory(still=1.0),
    Trajectory("velocity", (3.0, 3.7, 4.4, 5.1, 5.8), (0.0, 0.01, 0.0, -0.01, 0.0), "a.csv", still=0.0),
    Trajectory("acceleration", (0.0, 0.7, 1.4, 2.1), (0.1, -0.1, -0.1, 0.1), still=0.0),
    ShapedMove(move_to=0.0004, command=(0.4, *([0.0] * 999), -0.4), dwell=1.0, still=0.5),
]


def name_of(value: object) -> str:
    return value.kind if isinstance(value, Recipe) else str(value)


def test_every_kind_is_among_the_recipes_tested_here():
    assert {recipe.kind for recipe in RECIPES} == set(KINDS)


@pytest.mark.parametrize("recipe", RECIPES, ids=name_of)
@pytest.mark.parametrize("period", [1e-3, 0.7e-3], ids=name_of)
def test_exact_integration_of_the_held_accelerations_ends_at_rest_at_home(recipe, period):
    period = getattr(recipe, "command_period", period)  # a command is for one tick, and for no other
    excitation = recipe.sample(period)
    velocity = position = 0.0
    for a in excitation.accelerations.tolist():
        position += period * velocity + 0.5 * period**2 * a
        velocity += period * a
    # Rounding only: thousands of sums of numbers around 1 m/s^2.
    assert abs(velocity) < 1e-12
    assert abs(position) < 1e-12
    assert excitation.positions[-1] == pytest.approx(position, abs=1e-12)
    assert np.max(np.abs(excitation.accelerations)) > 0.0


@pytest.mark.parametrize("recipe", RECIPES, ids=name_of)
def test_a_recipe_survives_json_exactly(recipe):
    again = Recipe.from_dict(json.loads(json.dumps(recipe.to_dict())))
    assert again == recipe
    assert again.to_dict() == recipe.to_dict()
    period = getattr(recipe, "command_period", 7e-4)
    np.testing.assert_array_equal(again.sample(period).accelerations, recipe.sample(period).accelerations)


@pytest.mark.parametrize("recipe", RECIPES, ids=name_of)
def test_numbers_of_numpy_are_stored_as_plain_ones(recipe):
    numbers = {
        name: np.float64(value) for name, value in recipe.to_dict().items() if isinstance(value, float)
    }
    assert dataclasses.replace(recipe, **numbers).to_dict() == recipe.to_dict()
    json.dumps(dataclasses.replace(recipe, **numbers).to_dict())


def test_a_stored_recipe_without_the_fields_that_have_a_default_is_read():
    stored = {
        "schema": 2,
        "kind": "multisine",
        "start_frequency": 1.0,
        "end_frequency": 95.0,
        "line_period": 10.0,
        "n_periods": 2,
        "acceleration": 0.5,
        "max_displacement": 0.001,
        "lines": "odd",
        "seed": 3,
        "still": 10.0,
        "fade": 0.5,
    }
    assert Recipe.from_dict(stored) == Multisine(lines="odd", seed=3)


def test_the_samples_are_those_of_every_other_numpy():
    """Values of NumPy 2.4 and 1.26: the draws to the bit, the sines to their rounding over T^2."""
    random = Multisine(start_frequency=2.0, end_frequency=9.0, line_period=1.0, n_periods=4, seed=7).sample(
        0.01
    )
    noise = BandLimitedNoise(start_frequency=2.0, end_frequency=9.0, duration=4.0, seed=7).sample(0.01)
    np.testing.assert_allclose(random.accelerations[200:203], SEEDED["multisine"], rtol=1e-11)
    np.testing.assert_allclose(noise.accelerations[200:203], SEEDED["noise"], rtol=1e-11)
    left_out = Multisine(lines="random_odd", detection_group=4, seed=7).odd_detection_lines_hz[:6]
    np.testing.assert_allclose(left_out, SEEDED["left out"], rtol=1e-14)


SEEDED = {
    "multisine": [0.41262886244550645, 0.1156005480926009, -0.17635269652926944],
    "noise": [0.5387387256481995, 0.6137072829176244, 0.6296391363037693],
    "left out": [1.7, 1.9, 2.7, 3.5, 4.5, 5.5],
}


def test_a_long_list_of_phases_is_counted_where_people_read():
    text = describe_recipe(Multisine(phases="crest").to_dict())
    assert "phases_rad (941 numbers)" in text
    assert "schema" not in text
    assert describe_recipe({"kind": "step", "step_size": 0.5}) == "kind step, step_size 0.5"


def test_the_chirp_keeps_its_acceleration_and_its_ceiling():
    excitation = LogChirp(acceleration=0.7, max_displacement=0.005).sample()
    assert np.max(np.abs(excitation.positions)) <= 0.005
    # The half-tick differences and the rounded corner take a little, the fades overshoot nothing.
    assert 0.68 < np.max(np.abs(excitation.accelerations)) < 0.71
    still = excitation.accelerations[-9900:]
    assert np.max(np.abs(still)) == 0.0


def test_the_multisine_has_its_lines_its_level_and_its_seed():
    recipe = Multisine(
        start_frequency=2.0, end_frequency=20.0, line_period=5.0, lines="odd", max_displacement=1.0
    )
    assert np.all(np.round(recipe.lines_hz * 5.0).astype(int) % 2 == 1)
    excitation = recipe.sample()
    steady = excitation.accelerations[2500:7500]
    assert np.std(steady) == pytest.approx(0.5, rel=0.02)  # sinc attenuation at 20 Hz is 0.1 %
    other = Multisine(
        start_frequency=2.0, end_frequency=20.0, line_period=5.0, lines="odd", max_displacement=1.0, seed=1
    )
    assert not np.allclose(other.sample().accelerations, excitation.accelerations)


def test_limits_are_checked_between_the_ticks_too():
    excitation = Step(step_size=0.01).sample()
    excitation.check(AxisLimits(travel=0.0101, speed=1.0, acceleration=10.0))
    for limits, word in (
        (AxisLimits(travel=0.005), "travel"),
        (AxisLimits(speed=0.01), "speed"),
        (AxisLimits(acceleration=0.1), "acceleration"),
        (AxisLimits(jerk=1.0), "jerk"),
    ):
        with pytest.raises(ExcitationLimitError, match=f"peak {word}"):
            excitation.check(limits)
        with pytest.raises(ExcitationLimitError):
            Step(step_size=0.01).sample(limits=limits)


def test_samples_serve_every_command_mode():
    excitation = Step(duration=1.4, still=1.0).sample()
    for quantity, hold in (("acceleration", "zoh"), ("velocity", "linear"), ("position", "cubic")):
        signal = excitation.input_signal(quantity)
        assert signal.hold == hold
    with pytest.raises(ExcitationError, match="quantity is 'force'"):
        excitation.samples("force")


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: LogChirp(duration="long"), "duration is 'long'; expected a finite number"),
        (lambda: LogChirp(duration=None), "duration is None"),
        (lambda: LogChirp(duration=True), "duration is True"),
        (lambda: LogChirp(acceleration=math.inf), "acceleration is inf"),
        (lambda: LinearChirp(end_frequency=1.0), "other than start_frequency"),
        (lambda: LinearChirp(max_velocity=-1.0), "max_velocity is -1.0"),
        (lambda: Multisine(n_periods=1.5), "n_periods is 1.5; expected a whole number"),
        (lambda: Multisine(lines="even"), "lines is 'even'; expected one of full, odd, random_odd"),
        (lambda: Prbs(inverse_repeat="yes"), "inverse_repeat is 'yes'; expected True or False"),
        (lambda: Multisine(seed=-1), "seed is -1"),
        (lambda: Multisine(phases="flat"), "one of random, schroeder, crest"),
        (lambda: Multisine(lines="random_odd", detection_group=1), "detection_group is 1"),
        (lambda: Multisine(phases="crest", phases_rad=(0.0, 1.0)), "2 numbers.*expected 941"),
        (lambda: Prbs(order=40), "order is 40; expected from 3 to 18"),
        (lambda: Prbs(edge_time=0.01), "at most clock_period"),
        (lambda: Prbs(high_pass=50.0), "a tenth of the clock's rate"),
        (lambda: Prbs(clock_period=0.0015).sample(1e-3), "a whole number of periods of 0.001 s"),
        (lambda: Prbs(drive="current"), "one of position, velocity, acceleration, force"),
        (lambda: Pulse(amplitude=0.0), "amplitude is 0.0"),
        (lambda: Pulse(edge_time=0.5), "at most width"),
        (lambda: Doublet(width=-1.0), "width is -1.0"),
        (lambda: Sine(fade_cycles=30.0), "at most half of duration"),
        (lambda: SteppedSine(frequencies=()), "at least one frequency"),
        (lambda: SteppedSine(frequencies=(1.0, math.nan)), "frequencies is nan"),
        (lambda: SteppedSine(frequencies=5.0), "frequencies is 5.0; expected a list of numbers"),
        (lambda: SteppedSine(measure_cycles=0), "measure_cycles is 0"),
        (lambda: BandLimitedNoise(start_frequency=3.01, end_frequency=3.02), "a band of at least"),
        (lambda: PointToPoint(waypoints=(0.1, 0.2)), "the axis ends at home"),
        (lambda: PointToPoint(waypoints=(0.1, 0.1, 0.0)), "different from the one before"),
        (lambda: PointToPoint(profile="square"), "one of bounded_jerk, quintic, cycloidal"),
        (lambda: PointToPoint(jerk=0.0), "jerk is 0.0"),
        (lambda: AxisLimits(travel=-1.0), "travel is -1.0"),
        (lambda: AxisLimits(speed=math.nan), "speed is nan"),
        (lambda: Step().sample(period_s=1e-9), "samples; expected at most"),
        (lambda: Step().sample_input(scale=0.0), "scale is 0.0"),
        (lambda: LogChirp(start_frequency=0.0), "start_frequency is 0.0"),
        (lambda: LogChirp(end_frequency=0.5), "above start_frequency"),
        (lambda: LogChirp(duration=float("nan")), "duration is nan"),
        (lambda: LogChirp(fade_in=15.0), "half of duration"),
        (lambda: Multisine(n_periods=0), "n_periods is 0"),
        (lambda: Multisine(n_periods=2.5), "n_periods is 2.5; expected a whole number"),
        (lambda: Multisine(start_frequency=0.11, end_frequency=0.15, line_period=10.0), "at least one line"),
        (lambda: Step(duration=0.3), "at least two rise times"),
        (lambda: Step(step_size=0.0), "step_size is 0.0"),
        (lambda: Step().sample(period_s=0.0), "period_s is 0.0"),
    ],
)
def test_impossible_recipes_are_refused(make, says):
    with pytest.raises(ExcitationError, match=says):
        make()


def test_unknown_recipes_are_refused():
    with pytest.raises(ModelFormatError, match="kind is 'sound'"):
        Recipe.from_dict({"schema": 2, "kind": "sound"})
    with pytest.raises(ModelFormatError, match="unknown field 'amplitude'"):
        Recipe.from_dict({"schema": 2, "kind": "step", "amplitude": 1.0})
    with pytest.raises(ModelFormatError, match="schema is 7"):
        Recipe.from_dict({"schema": 7, "kind": "step"})


@pytest.mark.parametrize(
    "written",
    [
        "BandLimitedNoise(start_frequency=1.0, end_frequency=95.0, duration=20.0, acceleration=0.3, "
        "max_displacement=0.001, seed=0, still=10.0, fade=0.5)",
        "Doublet(drive='position', amplitude=0.0005, edge_time=0.05, still=10.0, width=0.1, gap=1.0)",
        "LinearChirp(start_frequency=1.0, end_frequency=95.0, duration=20.0, acceleration=0.7, "
        "max_displacement=0.005, still=10.0, fade_in=1.0, fade_out=0.25, max_velocity=0.0)",
        "LogChirp(start_frequency=1.0, end_frequency=95.0, duration=20.0, acceleration=0.7, "
        "max_displacement=0.005, still=10.0, fade_in=1.0, fade_out=0.25, max_velocity=0.0)",
        "Multisine(start_frequency=1.0, end_frequency=95.0, line_period=10.0, n_periods=2, "
        "acceleration=0.5, max_displacement=0.001, lines='full', seed=0, still=10.0, fade=0.5, "
        "detection_group=4, phases='random', max_velocity=0.0, phases_rad=())",
        "PointToPoint(waypoints=(0.002, -0.002, 0.0), profile='bounded_jerk', speed=0.05, "
        "acceleration=0.5, jerk=20.0, dwell=2.0, still=10.0)",
        "Prbs(drive='acceleration', amplitude=0.3, edge_time=0.0, still=10.0, order=11, "
        "clock_period=0.005, n_periods=1, inverse_repeat=False, high_pass=1.0)",
        "Pulse(drive='position', amplitude=0.0005, edge_time=0.05, still=10.0, width=0.1, gap=0.1)",
        "Sine(start_frequency=4.0, acceleration=0.2, duration=10.0, fade_cycles=4.0, still=10.0, "
        "max_displacement=0.005)",
        "Step(step_size=0.005, rise_time=0.2, duration=10.4, still=10.0)",
        "SteppedSine(frequencies=(2.0, 4.0, 8.0, 16.0), acceleration=0.2, max_displacement=0.005, "
        "settle_cycles=10.0, measure_cycles=10, glide_cycles=2.0, still=5.0)",
    ],
    ids=lambda written: written.partition("(")[0],
)
def test_what_a_recipe_takes_where_nothing_is_said_is_a_promise(written):
    # A script that names its seed alone must give the same motion next year.
    assert repr(getattr(beam_ident, written.partition("(")[0])()) == written
