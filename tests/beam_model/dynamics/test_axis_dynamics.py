from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from beam_model import BeamModel, BeamModelError, BeamParameterError, Damping
from beam_model.dynamics.axis_dynamics import AxisStepper, EndStops, HubFriction, PositionServo
from beam_model.dynamics.nonlinear import AirDrag, NonlinearMotionStepper, NonlinearTerms
from tests.beam_model.rigs import strip

PERIOD = 1e-3
MODEL = BeamModel(strip(gravity="upright", damping=Damping(ratios=(0.005,))), 5)


def energy(stepper: AxisStepper) -> float:
    n = MODEL.n_modes + 1
    x, v = stepper.state[:n], stepper.state[n:]
    return float(0.5 * v @ MODEL.matrices.M @ v + 0.5 * x @ MODEL.matrices.K @ x)


def test_a_free_axis_is_the_force_stepper() -> None:
    axis, force = AxisStepper(MODEL, PERIOD), MODEL.force_stepper(PERIOD)
    for value in np.random.default_rng(1).standard_normal(300):
        axis.step(value)
        force.step(value)
    assert axis.state == pytest.approx(force.state, rel=1e-10, abs=1e-14)
    assert not axis.is_held


def test_friction_holds_what_is_pushed_too_weakly() -> None:
    axis = AxisStepper(MODEL, PERIOD, HubFriction(coulomb=0.5))
    for _ in range(100):
        axis.step(0.49)
    assert axis.is_held
    assert axis.position == 0.0
    axis.step(0.51)
    assert not axis.is_held
    assert axis.velocity > 0.0


def test_a_vibrating_beam_breaks_a_held_hub_loose() -> None:
    axis = AxisStepper(MODEL, PERIOD, HubFriction(coulomb=0.1))
    axis.state[1] = 0.02
    moved = False
    for _ in range(300):
        axis.step(0.0)
        moved = moved or not axis.is_held
    # 40 mm of tip at mode 1 pulls with 0.36 N.
    assert moved
    assert axis.position != 0.0


def test_a_rigid_slide_comes_to_rest_where_friction_says() -> None:
    # 0.83 kg at 0.1 m/s against 1 N: v^2 M / 2 F, but for the beam's vibration, which a heavy hub hardly feels.
    heavy = BeamModel(strip(hub_mass=50.0, damping=Damping(ratios=(0.005,))), 3)
    axis = AxisStepper(heavy, PERIOD, HubFriction(coulomb=10.0))
    axis.state[4] = 0.1
    for _ in range(800):
        axis.step(0.0)
    assert axis.is_held
    assert axis.velocity == 0.0
    assert axis.position == pytest.approx(0.1**2 * heavy.parameters.total_mass / 20.0, rel=2e-3)


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_friction_may_differ_between_the_directions(direction: float) -> None:
    friction = HubFriction(10.0, 30.0, coulomb_difference=8.0, viscous_difference=-20.0)
    heavy = BeamModel(strip(hub_mass=50.0, damping=Damping(ratios=(0.005,))), 3)
    dry, drag = (14.0, 20.0) if direction > 0.0 else (6.0, 40.0)
    axis = AxisStepper(heavy, PERIOD, friction)
    axis.step(direction * (dry - 0.01))
    assert axis.is_held
    axis.state[4] = 0.1 * direction
    for _ in range(1200):
        axis.step(0.0)
    assert axis.velocity == 0.0
    # M v' = -F - c v: the way to rest is M/c (v - F/c ln(1 + c v / F)).
    way = heavy.parameters.total_mass / drag * (0.1 - dry / drag * np.log1p(drag * 0.1 / dry))
    assert axis.position == pytest.approx(direction * way, rel=2e-3)


def test_viscous_friction_that_differs_changes_where_the_velocity_does() -> None:
    heavy = BeamModel(strip(hub_mass=50.0, damping=Damping(ratios=(0.005,))), 3)
    ends = []
    for divisor in (1, 7):
        axis = AxisStepper(heavy, PERIOD / divisor, HubFriction(viscous=100.0, viscous_difference=160.0))
        for force in (40.0, -60.0, 30.0, -5.0):
            for _ in range(37 * divisor):
                axis.step(force)
        ends.append(axis.state.copy())
    assert ends[1] == pytest.approx(ends[0], abs=1e-12)


def test_friction_that_would_push_is_refused() -> None:
    with pytest.raises(BeamParameterError, match="coulomb_difference"):
        HubFriction(coulomb=1.0, coulomb_difference=-2.1)


@pytest.mark.parametrize("scenario", ["friction", "stops", "both"])
def test_halving_the_tick_changes_nothing(scenario: str) -> None:
    friction = HubFriction(coulomb=2.0, viscous=1.0) if scenario != "stops" else None
    stops = EndStops(-0.0005, 0.0005, 0.5) if scenario != "friction" else None
    rng = np.random.default_rng(2)
    forces = np.repeat(3.0 * rng.standard_normal(40), 10)
    ends = []
    n_held = n_turned = 0
    for divisor in (1, 2, 4):
        axis = AxisStepper(MODEL, PERIOD / divisor, friction, stops)
        path = []
        for force in forces:
            for _ in range(divisor):
                before = axis.velocity
                axis.step(force)
                n_held += axis.is_held
                n_turned += axis.velocity * before < 0.0
            path.append(axis.state.copy())
        ends.append(np.array(path))
    assert n_turned > 10
    assert scenario == "stops" or n_held > 20
    if stops is not None:
        assert np.abs(ends[0][:, 0]).max() > 0.00049
    for finer in ends[1:]:
        assert np.abs(finer[:, 0] - ends[0][:, 0]).max() < 1e-9
        assert np.abs(finer[:, 1] - ends[0][:, 1]).max() < 1e-8


@pytest.mark.parametrize("n_modes", [5, 20])
@pytest.mark.parametrize("scenario", ["friction", "stick and slip", "stops", "both"])
def test_reversals_and_blows_within_one_tick_are_found(n_modes: int, scenario: str) -> None:
    # Mode 5 turns the hub round four times a tick, mode 20 ten times: an end of a tick shows none of it.
    model = BeamModel(strip(gravity="upright", damping=Damping(ratios=(0.005,))), n_modes)
    friction = HubFriction(coulomb=0.3, static=0.4 if scenario == "stick and slip" else 0.0)
    stops = EndStops(-2e-5, 2e-5, 0.6) if scenario in ("stops", "both") else None
    for seed in range(4):
        rng = np.random.default_rng(seed)
        start = np.zeros(2 * n_modes + 2)
        start[n_modes + 1 :] = 0.3 * rng.standard_normal(n_modes + 1) / np.sqrt(n_modes)
        start[n_modes + 1] *= 0.01
        paths = []
        for divisor in (1, 2, 16):
            axis = AxisStepper(model, PERIOD / divisor, None if scenario == "stops" else friction, stops)
            axis.state[:] = start
            path = []
            for k in range(24):
                for _ in range(divisor):
                    axis.step(0.2 * np.sin(k))
                path.append(axis.state.copy())
            paths.append(np.array(path))
        for finer in paths[1:]:
            # Metres and m/s; a reversal that is missed moves the path by up to 1e-5 m.
            assert np.abs(finer[:, 0] - paths[0][:, 0]).max() < 1e-13
            assert np.abs(finer - paths[0]).max() < 1e-9


def test_a_spring_driven_hub_sticks_and_slips_as_in_the_textbook() -> None:
    # A heavy slide pulled by a spring of stiffness k at a constant speed V: it breaks loose at F_s = k V t, and
    # slips as a half period and more of omega = sqrt(k/M) about the Coulomb force.
    heavy = BeamModel(strip(hub_mass=500.0), 1)
    mass, k, speed = heavy.parameters.total_mass, 2.0e6, 1e-3
    servo = PositionServo(proportional=k, derivative=0.0)
    period = 2e-5
    axis = AxisStepper(heavy, period, HubFriction(coulomb=10.0, static=14.0), servo=servo)
    positions = []
    for tick in range(1500):
        axis.step_servo(speed * (tick + 0.5) * period)
        positions.append(axis.position)
    assert np.flatnonzero(positions)[0] * period == pytest.approx(14.0 / (k * speed), abs=2 * period)
    t = np.arange(1, 1501) * period - 14.0 / (k * speed)
    omega = np.sqrt(k / mass)
    # M x'' = k (V t + 14/k - x) - 10, from rest: the drop of friction, and the spring that goes on.
    slip = speed * t + 4.0 / k - 4.0 / k * np.cos(omega * t) - speed / omega * np.sin(omega * t)
    slipping = t > 0.0
    assert np.array(positions)[slipping] == pytest.approx(slip[slipping], abs=2e-8 + 2e-3 * slip.max())


def test_a_hub_with_play_lags_by_it_at_every_reversal() -> None:
    servo = PositionServo(1e5, 400.0, backlash=2e-5)
    axis = AxisStepper(MODEL, PERIOD, HubFriction(coulomb=1.5, static=2.0, viscous=4.0), servo=servo)
    t = np.arange(8000) * PERIOD
    reference = 0.002 * np.sin(2.0 * np.pi * 0.25 * t)
    hub = []
    for x in reference.tolist():
        hub.append(axis.position)
        axis.step_servo(x)
    lag = reference - np.array(hub)
    # In the direction of motion half the play, the friction on the servo's stiffness, and what rises with speed.
    velocity = 0.002 * np.pi * 0.5 * np.cos(2.0 * np.pi * 0.25 * t)
    expected = (0.5 * 2e-5 + 1.5 / 1e5) * np.sign(velocity) + 404.0 / 1e5 * velocity
    for k in (3700, 4300, 5800, 6200, 7800):
        assert lag[k] == pytest.approx(expected[k], abs=2e-6)
    # At the turning point the hub waits until the drive has crossed the play and the friction.
    turning = np.array(hub)[1000:1060]
    assert np.ptp(turning) < 1e-7


def test_a_flank_only_pushes_and_nothing_acts_within_the_play() -> None:
    servo = PositionServo(1e5, 100.0, backlash=2e-5)
    assert servo.force(0.9e-5, 1.0) == 0.0
    assert servo.force(2e-5, 0.0) == pytest.approx(1.0)
    assert servo.force(-2e-5, 0.0) == pytest.approx(-1.0)
    assert servo.force(2e-5, -0.5, 1.0) == 0.0
    assert servo.force(-2e-5, -0.5, 3.0) == pytest.approx(-48.0)


@pytest.mark.slow
def test_drag_and_large_deflections_act_on_a_free_hub() -> None:
    terms = NonlinearTerms(MODEL, AirDrag(0.025, 6.0))
    n, forces = MODEL.n_modes, np.repeat([0.4, -0.4, 0.2], 100)
    A, B = MODEL.matrices.state_space()

    def rates(_t: float, state: np.ndarray, force: float) -> np.ndarray:
        change = A @ state + B * force
        change[n + 1 :] += terms.accelerations_free(
            state[1 : n + 1], state[n + 2 :], float(state[n + 1]), change[n + 1 :].copy()
        )
        return change

    start = np.zeros(2 * n + 2)
    start[1] = 0.012
    truth = start.copy()
    for force in (0.4, -0.4, 0.2):
        truth = solve_ivp(rates, (0.0, 0.1), truth, args=(force,), rtol=1e-10, atol=1e-13, method="DOP853").y[
            :, -1
        ]
    errors = []
    for divisor in (1, 2):
        axis = AxisStepper(MODEL, PERIOD / divisor, terms=terms)
        axis.state[:] = start
        for force in np.repeat(forces, divisor):
            axis.step(float(force))
        errors.append(np.abs(axis.state[: n + 1] - truth[: n + 1]).max())
    linear = AxisStepper(MODEL, PERIOD)
    linear.state[:] = start
    for force in forces:
        linear.step(float(force))
    # The splitting errs by the square of the step, and by far less than the terms themselves do.
    assert np.abs(linear.state[: n + 1] - truth[: n + 1]).max() > 300 * errors[0]
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.3)


def test_drag_slows_a_beam_on_a_hub_that_friction_holds_as_on_one_that_is_led() -> None:
    terms = NonlinearTerms(MODEL, AirDrag(0.025, 6.0))
    axis = AxisStepper(MODEL, PERIOD, HubFriction(coulomb=5.0), terms=terms)
    led = NonlinearMotionStepper(MODEL, PERIOD, terms)
    axis.state[1] = led.state[0] = 0.01
    for _ in range(500):
        axis.step(0.0)
        led.step(0.0)
    assert axis.position == 0.0
    assert axis.state[1 : MODEL.n_modes + 1] == pytest.approx(led.state[: MODEL.n_modes], rel=1e-6, abs=1e-9)


def test_the_hub_never_leaves_its_travel_and_a_blow_never_gains_energy() -> None:
    stops = EndStops(-0.005, 0.005, restitution=0.3)
    axis = AxisStepper(MODEL, PERIOD, stops=stops)
    for k in range(2000):
        before, force = energy(axis), 5.0 * np.sign(np.sin(2.0 * np.pi * 3.0 * k * PERIOD))
        start = axis.position
        axis.step(force)
        assert stops.lower - 1e-12 <= axis.position <= stops.upper + 1e-12
        assert energy(axis) <= before + force * (axis.position - start) + 1e-12


def test_a_hub_pressed_against_a_stop_stays_there() -> None:
    axis = AxisStepper(MODEL, PERIOD, stops=EndStops(-0.001, 0.001))
    for _ in range(500):
        axis.step(2.0)
    assert axis.is_held
    assert axis.position == pytest.approx(0.001)
    assert axis.motion(0.5e-3, 2.0).acceleration == 0.0
    for _ in range(5):
        axis.step(-2.0)
    assert not axis.is_held
    assert axis.position < 0.001


def test_a_servo_follows_its_reference_and_feels_the_beam() -> None:
    servo = PositionServo(proportional=8000.0, derivative=100.0, integral=2e4, max_force=20.0)
    axis = AxisStepper(MODEL, PERIOD, HubFriction(viscous=2.0), EndStops(-0.05, 0.05), servo)
    t = np.arange(3000) * PERIOD
    reference = 0.002 * np.sin(2.0 * np.pi * 2.0 * t)
    speed = 0.002 * 2.0 * np.pi * 2.0 * np.cos(2.0 * np.pi * 2.0 * t)
    position, forces = [], []
    for x, v in zip(reference, speed, strict=True):
        position.append(axis.position)
        forces.append(axis.step_servo(float(x), float(v)))
    error = np.array(position)[1500:] - reference[1500:]
    assert np.abs(error).max() < 1e-4
    assert np.abs(forces).max() <= 20.0
    # The beam's reaction shows in the force: more than the rigid hub alone would ask for.
    assert np.std(axis.state[1 : MODEL.n_modes + 1]) > 0.0


def test_a_saturated_servo_stays_within_its_force() -> None:
    servo = PositionServo(1e5, 100.0, 1e6, max_force=1.0)
    axis = AxisStepper(MODEL, PERIOD, servo=servo)
    for _ in range(50):
        assert abs(axis.step_servo(0.01)) <= 1.0
    assert axis.force == 1.0


def test_motion_inside_a_tick_meets_the_next_one() -> None:
    axis = AxisStepper(MODEL, PERIOD, HubFriction(coulomb=0.2))
    for _ in range(20):
        axis.step(1.0)
    inside = axis.motion(PERIOD, -3.0)
    axis.step(-3.0)
    assert float(inside.position) == pytest.approx(axis.position, rel=1e-12)
    assert inside.coordinates == pytest.approx(axis.state[1 : MODEL.n_modes + 1], rel=1e-12)
    assert float(inside.velocity) == pytest.approx(axis.velocity, rel=1e-12)


@pytest.mark.parametrize(
    "make",
    [
        lambda: HubFriction(coulomb=-1.0),
        lambda: HubFriction(coulomb=1.0, static=0.5),
        lambda: PositionServo(1.0, 1.0, backlash=-1e-6),
        lambda: EndStops(0.1, 0.0),
        lambda: EndStops(-0.1, 0.1, 1.5),
        lambda: PositionServo(0.0, 1.0),
        lambda: PositionServo(1.0, 1.0, max_force=0.0),
        lambda: AxisStepper(MODEL, 0.0),
        lambda: AxisStepper(MODEL, PERIOD, stops=EndStops(0.01, 0.02)),
    ],
)
def test_bad_axes_are_refused(make: object) -> None:
    with pytest.raises(BeamParameterError):
        make()  # type: ignore[operator]


def test_an_axis_without_a_servo_says_so() -> None:
    with pytest.raises(BeamModelError, match="servo"):
        AxisStepper(MODEL, PERIOD).step_servo(0.0)
