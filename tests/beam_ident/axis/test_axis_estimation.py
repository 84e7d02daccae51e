"""Mass and friction of axes that other code has stepped: found, with intervals that hold, or refused in words."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

from beam_ident import EstimationError, InputSignal, OutputSignal, TimeRecord, check_axis, identify_axis
from beam_ident.axis.axis_record import AxisRecord
from beam_ident.axis.inverse_dynamics import NAMES, fit_inverse_dynamics
from beam_model import AxisStepper, BeamModel, Damping, HubFriction, PositionServo
from benchmarks.ident.driven_axis import CompliantAxis, DrivenAxis, filtered_least_squares
from tests.beam_model.rigs import strip

SHORT = DrivenAxis(duration_s=8.0)


def scores(axis: DrivenAxis, seed: int = 0, **options) -> np.ndarray:
    """Errors of the first four estimates over their standard deviations."""
    found = identify_axis(axis.record(seed), force="force", **options)
    return (found.estimates[:4] - axis.truth) / found.standard_deviations[:4]


def test_a_closed_loop_gives_mass_and_friction_without_the_bias_of_filtered_derivatives() -> None:
    record = SHORT.record(3)
    found = identify_axis(record, force="force")
    errors = found.estimates / SHORT.truth - 1.0
    assert found.method == "output_error"
    assert np.max(np.abs(errors)) < 1e-4
    assert np.max(np.abs(errors * SHORT.truth / found.standard_deviations)) < 4.0
    assert abs(filtered_least_squares(record)[1] / SHORT.truth[1] - 1.0) > 0.05
    assert found.check.is_white


@pytest.mark.slow
def test_intervals_hold_over_many_closed_loops() -> None:
    short = DrivenAxis(duration_s=4.0, period_s=2e-3, noise=2e-5, speed=0.3)
    all_scores = np.array([scores(short, seed, delay_s=0.0) for seed in range(20)])
    # Of 80 scores, correlated by fours: rms 1 +- 0.13, and a mean of 0 +- 0.25 each.
    assert np.sqrt(np.mean(np.square(all_scores))) == pytest.approx(1.0, abs=0.35)
    assert np.max(np.abs(np.mean(all_scores, axis=0))) < 0.8


@pytest.mark.first_case
@pytest.mark.parametrize(
    "axis",
    [
        DrivenAxis(
            mass=0.05, viscous=(0.4, 0.4), coulomb=(0.02, 0.02), offset=0.01, stroke=0.05, duration_s=6.0
        ),
        DrivenAxis(mass=20.0, viscous=(5.0, 5.0), coulomb=(9.0, 9.0), offset=0.0, stroke=2.0, speed=2.0),
        DrivenAxis(duration_s=10.0, period_s=0.02, is_closed_loop=False),
        DrivenAxis(duration_s=8.0, offset=120.0, noise=2e-5),
        DrivenAxis(duration_s=8.0, noise=1e-6, quantum=1e-5),
        DrivenAxis(duration_s=8.0, max_force=60.0),
        DrivenAxis(duration_s=8.0, static=15.0),
        DrivenAxis(duration_s=8.0, viscous=(0.0, 0.0), coulomb=(0.0, 0.0), offset=0.0, is_closed_loop=True),
    ],
    ids=[
        "tiny",
        "fast and far",
        "50 Hz",
        "heavy offset",
        "coarse encoder",
        "saturated",
        "stiction",
        "frictionless",
    ],
)
def test_axes_unlike_each_other_are_found(axis: DrivenAxis) -> None:
    assert np.max(np.abs(scores(dataclasses.replace(axis, duration_s=min(axis.duration_s, 10.0))))) < 4.5


@pytest.mark.slow
def test_friction_that_differs_by_direction_and_a_delay_are_seen_in_the_data() -> None:
    axis = DrivenAxis(
        viscous=(150.0, 250.0), coulomb=(30.0, 15.0), offset=0.0, delay_steps=3, duration_s=8.0, noise=2e-6
    )
    found = identify_axis(axis.record(1), force="force", offset=0.0)
    truth = {"viscous_difference": -100.0, "coulomb_difference": 15.0, "delay": 3e-3}
    for name, value in truth.items():
        assert abs(found.value(name) - value) < 4.5 * found.sd(name)
    assert found.resistance_forward == pytest.approx(30.0, rel=1e-3)
    assert found.resistance_backward == pytest.approx(15.0, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_a_late_servo_that_feeds_noise_back_leaves_no_false_delay(seed: int) -> None:
    # Every whole period was a minimum of its own, and masses were a hundred standard deviations off in one of them.
    axis = DrivenAxis(duration_s=8.0, delay_steps=3, noise=2e-5)
    found = identify_axis(axis.record(seed), force="force")
    assert abs(found.value("delay") - 3e-3) < 4.0 * found.sd("delay")
    assert np.max(np.abs((found.estimates[:4] - axis.truth) / found.standard_deviations[:4])) < 4.0
    # The two methods agree: instruments are made of the simulated motion, not of the noisy one.
    assert np.max(np.abs(found.other_estimates - axis.truth) / found.other_sd) < 4.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", [124, 143])
def test_noise_that_makes_a_delay_likely_leaves_no_false_delay(seed: int) -> None:
    """The fit with it ends in an optimum that leaves more than the fit without it."""
    axis = DrivenAxis(noise=5e-5)
    found = identify_axis(axis.record(seed), force="force")
    assert "delay" not in found.names
    assert np.max(np.abs(found.estimates[:4] - axis.truth) / found.standard_deviations[:4]) < 4.0


@pytest.mark.slow
def test_a_known_mass_turns_a_current_into_newtons() -> None:
    record = SHORT.record(5)
    current = InputSignal("current", "A", (0.0, SHORT.period_s), record.inputs[0].values / 7.5)
    found = identify_axis(TimeRecord((current,), record.outputs), mass=SHORT.mass, mass_sd=0.1)
    assert found.units[:3] == ("N/A", "N s/m", "N")
    assert abs(found.value("force_constant") - 7.5) < 4.0 * found.sd("force_constant")
    # The mass is known to 0.1 %, and so is everything else in newtons.
    assert found.sd("coulomb") == pytest.approx(0.1 / SHORT.mass * SHORT.truth[2], rel=0.05)
    alone = identify_axis(TimeRecord((current,), record.outputs))
    assert alone.units[0] == "A s^2/m"
    assert alone.value("mass") == pytest.approx(SHORT.mass / 7.5, rel=1e-3)


@pytest.mark.slow
def test_forces_that_nobody_measured_are_left_to_inverse_dynamics() -> None:
    axis = DrivenAxis(disturbance=2.0, duration_s=12.0)
    found = identify_axis(axis.record(2), force="force", reference="reference")
    assert found.method == "instrumental_variables"
    assert np.max(np.abs((found.estimates[:4] - axis.truth) / found.standard_deviations[:4])) < 4.0
    assert any("nobody measured" in warning for warning in found.warnings)
    # Without the reference the motion that these forces make is in the instruments too.
    unled = identify_axis(axis.record(2), force="force")
    assert any("reference=" in warning for warning in unled.warnings)
    assert not any("reference=" in warning for warning in found.warnings)


def test_inverse_dynamics_see_a_delay_and_a_difference_by_direction_too() -> None:
    axis = DrivenAxis(viscous=(150.0, 250.0), delay_steps=4, duration_s=8.0, noise=1e-6)
    record = axis.record(4)
    loaded = AxisRecord(record.inputs[0], record.outputs[0])
    found = fit_inverse_dynamics([loaded], 0.0, (*NAMES, "viscous_difference", "delay"))
    # One linear step from no delay: its second order is left out.
    assert found.parameters.delay == pytest.approx(4e-3, rel=0.1)
    assert found.parameters.viscous_difference == pytest.approx(-100.0, rel=0.05)
    again = fit_inverse_dynamics([loaded], found.parameters.delay, (*NAMES, "viscous_difference", "delay"))
    assert again.parameters.delay == pytest.approx(4e-3, rel=0.01)


@pytest.mark.slow
def test_gaps_in_force_and_position_and_several_records_are_one_fit() -> None:
    records = []
    for seed in range(2):
        whole = SHORT.record(seed)
        force = whole.inputs[0].values.copy()
        force[2000:2040] = np.nan
        position = whole.outputs[0].values.copy()
        position[4000:4300] = np.nan
        records.append(
            TimeRecord(
                (InputSignal("force", "N", (0.0, 1e-3), force),),
                (OutputSignal("position", "m", (0.0, 1e-3), position),),
            )
        )
    found = identify_axis(records)
    assert np.max(np.abs((found.estimates[:4] - SHORT.truth) / found.standard_deviations[:4])) < 4.0
    assert found.method == "output_error"


@pytest.mark.slow
def test_another_record_confirms_the_axis_and_names_what_has_changed() -> None:
    found = identify_axis(SHORT.record(0), force="force")
    same = check_axis(found, SHORT.record(1))
    assert same.is_white
    assert same.fit_percent > 99.9
    assert not same.terms
    stickier = dataclasses.replace(SHORT, coulomb=(24.0, 24.0))
    changed = check_axis(found, stickier.record(1))
    assert not changed.is_white
    assert "the direction" in [term.name for term in changed.terms]
    assert "the direction" in changed.verdict


@pytest.mark.slow
def test_a_beam_on_the_axis_takes_its_part_of_the_mass_where_its_modes_are_known() -> None:
    beam = BeamModel(strip(damping=Damping(ratios=(0.01,))), 3)
    servo = PositionServo(proportional=7000.0, derivative=110.0)
    axis = AxisStepper(beam, 1e-3, HubFriction(coulomb=0.5, viscous=2.0), servo=servo)
    t = 1e-3 * np.arange(8000)
    wanted = 0.02 * np.sin(2.5 * t) * np.sin(0.4 * t) + 0.01 * np.sin(7.0 * t)
    noise = 1e-6 * np.random.default_rng(1).standard_normal(len(t))
    force, position = np.empty(len(t)), np.empty(len(t))
    for k, slope in enumerate(np.gradient(wanted, 1e-3)):
        position[k] = axis.position + noise[k]
        force[k] = axis.servo_force(wanted[k] - noise[k], slope)
        axis.step(force[k])
    record = TimeRecord(
        (InputSignal("force", "N", (0.0, 1e-3), force),), (OutputSignal("hub", "m", (0.0, 1e-3), position),)
    )
    modes = list(zip(beam.natural_frequencies[:2], beam.damping_ratios[:2], strict=True))
    found = identify_axis(record, modes=modes)
    mass = beam.parameters.total_mass
    assert found.moving_mass == pytest.approx(mass, rel=1e-3)
    assert abs(found.value("coulomb") - 0.5) < 5.0 * found.sd("coulomb") + 1e-4
    # A clamped strip's first mode carries 61.3 % of its mass (Blevins, 1979).
    assert found.value("modal_mass_1") == pytest.approx(0.613 * (mass - beam.parameters.hub_mass), rel=0.02)
    assert abs(identify_axis(record).moving_mass / mass - 1.0) < 0.05


SPRUNG = CompliantAxis(duration_s=4.0, period_s=2e-3, speed=0.3, is_of_drive=True)


@pytest.mark.slow
def test_a_spring_between_drive_and_hub_is_found_from_the_drives_encoder_without_any_masses() -> None:
    found = identify_axis(SPRUNG.record(1), force="force", encoder="drive")
    truth = dict(zip(NAMES, SPRUNG.truth, strict=True)) | {"stiffness": 1e6, "drive_mass": 20.0}
    for name, value in truth.items():
        assert abs(found.value(name) - value) < 4.0 * found.sd(name)
    assert found.sd("stiffness") < 0.1 * 1e6
    assert found.units[found.names.index("stiffness")] == "N/m"
    # Two masses on a spring: omega^2 = k (1/m_d + 1/m_h).
    omega = np.sqrt(1e6 * (1.0 / 20.0 + 1.0 / (SPRUNG.mass - 20.0)))
    assert found.drive_resonance == pytest.approx(omega, rel=0.02)
    table = found.summary().splitlines()[1 : 1 + len(found.names)]
    assert [len(re.split(r"\s{2,}", row)) for row in table] == [5] * len(found.names)
    assert "compliant" in found.summary()
    assert found.check.is_white
    # What is left of a new record is the encoder's noise, a tenth wider by the errors of the parameters.
    assert check_axis(found, SPRUNG.record(2)).residual_sd < 1.1 * SPRUNG.noise
    assert not any("disagree" in warning for warning in found.warnings)
    # A stiff axis would be wrong about the mass by many of its deviations.
    stiff = identify_axis(SPRUNG.record(1), force="force")
    assert abs(stiff.value("mass") - SPRUNG.mass) > 4.0 * stiff.sd("mass")


@pytest.mark.slow
def test_the_hubs_encoder_tells_the_stiffness_where_the_mass_of_the_drive_is_known() -> None:
    axis = dataclasses.replace(SPRUNG, is_of_drive=False, speed_gain=8.0, place_gain=6.0, duration_s=8.0)
    found = identify_axis(axis.record(2), force="force", drive_mass=20.0)
    for name, value in (*zip(NAMES, axis.truth, strict=True), ("stiffness", 1e6)):
        assert abs(found.value(name) - value) < 4.0 * found.sd(name)
    assert found.sd("stiffness") < 0.1 * 1e6


@pytest.mark.slow
@pytest.mark.parametrize(
    "axis",
    [
        DrivenAxis(duration_s=4.0, speed=0.3),
        DrivenAxis(duration_s=4.0, speed=0.3, delay_steps=3, noise=1e-6, quantum=1e-5),
        DrivenAxis(duration_s=4.0, speed=0.3, coulomb=(30.0, 15.0), static=15.0),
    ],
    ids=["plain", "late and coarse", "sticking"],
)
def test_a_drive_without_a_spring_is_called_stiffer_than_a_limit(axis: DrivenAxis) -> None:
    found = identify_axis(axis.record(0), force="force", encoder="drive", drive_mass=20.0)
    assert not found.is_compliant
    # A spring of 40 Hz is found in such records; one that is ten times softer is far from what they allow.
    assert found.stiffer_than > 1e5
    assert "stiffer than" in found.summary()


@pytest.mark.slow
def test_forces_that_nobody_measured_leave_open_whether_a_drive_is_compliant() -> None:
    axis = DrivenAxis(disturbance=2.0, duration_s=6.0)
    found = identify_axis(axis.record(2), force="force", reference="reference", drive_mass=20.0)
    assert not found.is_compliant
    assert np.isnan(found.stiffer_than)
    assert any("cannot be told" in warning for warning in found.warnings)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"duration_s": 2.0, "stroke": 1e-9}, "never moved"),
        ({"duration_s": 1.0, "speed": 0.05}, "never moved backward"),
        ({"duration_s": 0.02}, "record longer"),
    ],
)
def test_an_axis_that_shows_too_little_is_refused_with_what_to_record(change, words) -> None:
    with pytest.raises(EstimationError, match=words):
        identify_axis(dataclasses.replace(SHORT, **change).record(1), force="force")


@pytest.mark.slow
def test_arguments_out_of_place_are_refused() -> None:
    record = SHORT.record(0)
    for options, words in (
        ({}, "has the inputs force, reference"),
        ({"force": "force", "mass": -1.0}, "mass is -1.0 kg"),
        ({"force": "force", "mass": 1.0, "mass_sd": -1.0}, "mass_sd"),
        ({"force": "force", "delay_s": np.inf}, "delay_s is inf"),
        ({"force": "force", "position": "angle"}, "angle"),
        ({"force": "force", "encoder": "motor"}, "expected 'hub' or 'drive'"),
        ({"force": "force", "drive_mass": -1.0}, "drive_mass is -1.0 kg"),
        ({"force": "force", "drive_mass": 96.0}, "a part of it"),
        ({"force": "force", "encoder": "drive", "mass": 95.0}, "without mass="),
        ({"force": "force", "encoder": "drive", "modes": [(30.0, 0.01)]}, "leave out one of"),
    ):
        with pytest.raises(ValueError, match=words):
            identify_axis(record, **options)
    angle = TimeRecord(
        record.inputs[:1], (OutputSignal("angle", "rad", (0.0, 1e-3), record.outputs[0].values),)
    )
    with pytest.raises(EstimationError, match="expected m"):
        identify_axis(angle)


@pytest.mark.parametrize("period_s", [2e-3, 5e-3, 10e-3])
def test_inverse_dynamics_lose_nothing_by_sampling(period_s: float) -> None:
    # x'' = (u - c x') / m of a held force in closed form; windows of nine samples gave a mass 1.6 % too large.
    mass, viscous, n = 0.4, 3.0, int(8.0 / period_s)
    t = period_s * np.arange(n)
    force = 2.0 * np.sin(7.0 * t) + 3.0 * np.sin(31.0 * t + 1.0) + 4.0 * np.sin(83.0 * t)
    decay, position, speed = np.exp(-viscous / mass * period_s), np.zeros(n), 0.0
    for k in range(n - 1):
        final = force[k] / viscous
        position[k + 1] = position[k] + final * period_s + (speed - final) * (1.0 - decay) * mass / viscous
        speed = final + (speed - final) * decay
    record = TimeRecord(
        (InputSignal("force", "N", (0.0, period_s), force),),
        (OutputSignal("position", "m", (0.0, period_s), position),),
    )
    found = fit_inverse_dynamics([AxisRecord(record.inputs[0], record.outputs[0])]).parameters
    assert found.mass == pytest.approx(mass, rel=1e-4)
    assert found.viscous == pytest.approx(viscous, rel=1e-4)
    assert abs(found.coulomb) < 1e-3


def with_signals(record: TimeRecord, push=None, seen=None, start_s: float = 0.0) -> TimeRecord:
    """Return a record with other forces or positions, and stamps that begin elsewhere."""
    drive, output = record.input("force"), record.outputs[0]
    values = drive.values if push is None else push(drive.values)
    positions = output.values if seen is None else seen(output.values)
    return dataclasses.replace(
        record,
        inputs=(dataclasses.replace(drive, times_s=drive.times_s + start_s, values=values),),
        outputs=(dataclasses.replace(output, times_s=output.times_s + start_s, values=positions),),
    )


def test_stamps_since_1970_change_nothing() -> None:
    record = DrivenAxis(duration_s=4.0, period_s=2e-3, noise=2e-5, speed=0.3).record(0)
    one, other = (identify_axis(with_signals(record, start_s=start), force="force") for start in (0.0, 1.7e9))
    # Their rounding is 0.24 us: at 0.3 m/s far below the encoder's noise.
    assert np.max(np.abs(one.estimates - other.estimates)[:4] / one.standard_deviations[:4]) < 0.5


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"seen": lambda y: -y}, "against the force"),
        ({"push": lambda u: np.full(len(u), 2.0)}, "is constant"),
        ({"push": lambda u: np.random.default_rng(0).standard_normal(len(u))}, "is not seen that"),
        (
            {"seen": lambda y: np.where(np.random.default_rng(1).random(len(y)) < 0.3, np.nan, y)},
            "32 positions",
        ),
    ],
    ids=["other sign", "constant force", "unrelated force", "a third missing"],
)
def test_signals_that_are_not_those_of_one_axis_are_refused(change, words) -> None:
    record = DrivenAxis(duration_s=4.0, period_s=2e-3, noise=2e-5, speed=0.3).record(0)
    with pytest.raises(EstimationError, match=words):
        identify_axis(with_signals(record, **change), force="force")
