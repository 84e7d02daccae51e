"""The simulated axis with what real ones have: against the model's own stepper, closed forms and what is known."""

from __future__ import annotations

import numpy as np
import pytest

from beam_model import (
    AirDrag,
    AxisStepper,
    BeamModel,
    BeamParameters,
    Damping,
    EndStops,
    HubFriction,
    NonlinearTerms,
)
from beam_ros.hub.parameters import AxisParameters, SimulatedDevice
from beam_ros.hub.simulated.axis import VirtualAxis
from beam_ros.hub.simulated.mechanism import Mechanism, servo_on
from beam_ros.hub.simulated.plant import BeamPlant, beam_on_axis
from tests.beam_ros.hub.hub_scenes import SimulatedRig, chunks_of, enabled_axis, rest_to_rest

T = 1e-3
TICK = 1_000_000
MODEL = BeamModel(
    BeamParameters.from_section(
        0.30,
        0.025,
        0.0005,
        7850.0,
        200e9,
        hub_mass=0.8,
        gravity="upright",
        damping=Damping(ratios=(0.005,)),
    ),
    n_modes=5,
)
MASS = MODEL.parameters.total_mass
FRICTION = HubFriction(coulomb=1.5, static=2.0, viscous=4.0)


def servo(max_force: float = 20.0, backlash: float = 0.0, frequency_hz: float = 60.0, zeta: float = 0.7):
    return servo_on(
        MASS, frequency_hz=frequency_hz, damping_ratio=zeta, max_force=max_force, backlash=backlash
    )


def play(axis: VirtualAxis, values, extra_ticks: int = 200):
    """Play a sequence; return its first tick and what the device measured from there on."""
    start = axis.tick + 5
    axis.feed()
    assert axis.arm(start * TICK, len(values)).success
    assert axis.append(0, list(values)).success
    axis.advance(start * TICK)
    batches = []
    while axis.tick < start + len(values) + extra_ticks:
        axis.feed()
        batches.append(axis.advance(axis.device_ns + 10 * TICK))
    return start, batches


@pytest.mark.parametrize("mode", ["acceleration", "velocity", "position"])
def test_a_servo_moves_hub_and_beam_as_the_models_own_axis_does(mode: str) -> None:
    parameters = AxisParameters(command_mode=mode)
    mechanism = Mechanism(FRICTION, EndStops(-0.05, 0.05), servo(backlash=5e-6))
    axis = enabled_axis(parameters, BeamPlant(MODEL, T, mechanism=mechanism))
    accelerations = rest_to_rest(500, 2.0)
    velocities = np.concatenate([[0.0], np.cumsum(accelerations) * T])
    if mode == "acceleration":
        values = accelerations
        positions = np.concatenate([[0.0], np.cumsum((velocities[:-1] + velocities[1:]) * T / 2)])
        reference = list(zip(positions, velocities, values, strict=False))
    elif mode == "velocity":
        values = velocities
        positions = np.concatenate([[0.0], np.cumsum(values) * T])
        reference = list(zip(positions, values, np.diff(values, prepend=0.0) / T, strict=False))
    else:
        values = np.concatenate([[0.0], np.cumsum(velocities) * T])
        speeds = np.diff(values) / T
        reference = list(zip(values, speeds, np.diff(speeds, prepend=0.0) / T, strict=False))
    start, batches = play(axis, values)
    truth = AxisStepper(MODEL, T, FRICTION, EndStops(-0.05, 0.05), servo(backlash=5e-6))
    n, measured = MODEL.n_modes, np.concatenate([b.position_counts for b in batches]) * 1e-7
    lags = []
    for k, (x, v, a) in enumerate(reference):
        assert measured[k] == pytest.approx(truth.position, abs=0.51e-7)
        force = truth.servo_force(float(x), float(v), MASS * float(a))
        if k % 29 == 7:
            shown = axis.snapshots([(start + k) * TICK + 370_000])
            motion = truth.motion(0.37e-3, force)
            assert shown.positions[0] == pytest.approx(float(motion.position), abs=1e-12)
            assert shown.coordinates[0] == pytest.approx(motion.coordinates, abs=1e-11)
            assert shown.accelerations[0] == pytest.approx(float(motion.acceleration), abs=1e-8)
        truth.step(force)
        lags.append(x - truth.position)
    assert np.max(np.abs(truth.state[1 : n + 1])) > 1e-5
    assert np.max(np.abs(lags)) > 5e-6


def test_the_servo_gives_the_moving_mass_its_frequency_and_damping() -> None:
    heavy = BeamModel(BeamParameters.from_section(0.3, 0.025, 0.0005, 7850.0, 200e9, hub_mass=500.0), 1)
    mass = heavy.parameters.total_mass
    loop = servo_on(mass, frequency_hz=10.0, damping_ratio=0.1, max_force=1e9, backlash=0.0)
    axis = AxisStepper(heavy, 1e-4, servo=loop)
    axis.state[0] = 1e-3
    x = []
    for _ in range(3000):
        x.append(axis.position)
        axis.step_servo(0.0)
    omega, t = 2 * np.pi * 10.0, np.arange(3000) * 1e-4
    damped = omega * np.sqrt(1 - 0.01)
    expected = (
        1e-3 * np.exp(-0.1 * omega * t) * (np.cos(damped * t) + 0.1 * omega / damped * np.sin(damped * t))
    )
    # Holding the force over a tick delays it by half of one: 0.3 % of a radian.
    assert np.max(np.abs(np.array(x) - expected)) < 1e-5


def test_the_beam_pushes_a_soft_servo_back() -> None:
    # A bent beam at rest on a resting hub: the servo's stiffness times what it gives way is the beam's pull.
    plant = BeamPlant(MODEL, T, mechanism=Mechanism(servo=servo(frequency_hz=20.0)))
    axis = enabled_axis(AxisParameters(), plant)
    _, batches = play(axis, rest_to_rest(300, 3.0), extra_ticks=400)
    x = np.concatenate([b.position_counts for b in batches])[-300:] * 1e-7
    forces = np.concatenate([b.efforts for b in batches])[-300:].astype(float)
    # The reference rests; at mode 1 the hub gives way by force over stiffness, and pushes harder the more it does.
    stiffness = MASS * (2 * np.pi * 20.0) ** 2
    assert np.ptp(x) > 5e-7
    assert np.ptp(forces) == pytest.approx(stiffness * np.ptp(x), rel=0.25)


def test_a_push_below_the_static_friction_moves_nothing() -> None:
    for force, moves in ((1.9, False), (2.1, True)):
        plant = BeamPlant(MODEL, T, mechanism=Mechanism(FRICTION))
        axis = enabled_axis(AxisParameters(command_mode="effort"), plant)
        _, batches = play(axis, np.full(20, force), extra_ticks=0)
        counts = np.concatenate([b.position_counts for b in batches])
        assert bool(np.any(counts != 0)) == moves


def test_a_servo_too_weak_to_brake_runs_into_the_stop_and_no_further() -> None:
    plant = BeamPlant(
        MODEL, T, mechanism=Mechanism(stops=EndStops(-0.05, 0.05, 0.3), servo=servo(max_force=1.0))
    )
    axis = enabled_axis(AxisParameters(), plant)
    start, _ = play(axis, np.concatenate([np.full(250, 1.0), np.full(125, -2.0)]), extra_ticks=600)
    seen = axis.snapshots(np.arange(start, axis.tick) * TICK + 500_000).positions
    assert seen.max() == pytest.approx(0.05, abs=2e-4)
    assert seen.max() <= 0.05 + 1e-12


def test_the_encoders_noise_is_in_the_counts_and_nowhere_else() -> None:
    def run(seed: int) -> tuple[np.ndarray, np.ndarray, float]:
        device = SimulatedDevice(encoder_noise=3e-7, seed=seed)
        axis = VirtualAxis(AxisParameters(), BeamPlant(MODEL, T), device)
        ticks = axis.advance(4000 * TICK)
        return ticks.position_counts * 1e-7, ticks.velocity_counts, axis.true_position

    positions, speeds, truth = run(1)
    # Noise and the rounding to a tenth of a micrometre.
    assert np.std(positions) == pytest.approx(np.hypot(3e-7, 1e-7 / np.sqrt(12)), rel=0.05)
    assert np.corrcoef(positions[1:], positions[:-1])[0, 1] == pytest.approx(0.0, abs=0.05)
    assert truth == 0.0
    assert not np.any(speeds)
    assert np.array_equal(run(1)[0], positions)
    assert not np.array_equal(run(2)[0], positions)


def test_an_encoder_at_the_drive_sees_neither_play_nor_compliance() -> None:
    lags = {}
    for place in ("hub", "drive"):
        plant = BeamPlant(MODEL, T, mechanism=Mechanism(FRICTION, servo=servo(backlash=1e-4)))
        axis = enabled_axis(AxisParameters(), plant, device=SimulatedDevice(encoder_at=place))
        a = rest_to_rest(500, 2.0)
        _, batches = play(axis, a, extra_ticks=0)
        v = np.concatenate([[0.0], np.cumsum(a) * T])
        reference = np.concatenate([[0.0], np.cumsum((v[:-1] + v[1:]) * T / 2)])[:500]
        lags[place] = np.abs(np.concatenate([b.position_counts for b in batches])[:500] * 1e-7 - reference)
    assert np.max(lags["drive"]) < 0.6e-7
    assert np.max(lags["hub"]) > 5e-5


def test_home_is_where_the_servo_had_the_hub_when_it_was_found() -> None:
    plant = BeamPlant(MODEL, T, mechanism=Mechanism(FRICTION, servo=servo(backlash=4e-5)))
    axis = enabled_axis(AxisParameters(), plant, device=SimulatedDevice(initial_position=0.004))
    # Play and friction keep the hub off the true home, and the device cannot know.
    assert 1e-5 < axis.true_position < 6e-5
    assert axis.position == 0.0
    axis.feed()
    axis.advance(axis.device_ns + 200 * TICK)
    assert axis.position == pytest.approx(0.0, abs=1e-6)
    # From there on the device counts from its own home: the hub lags behind the reference as ever.
    pulse = np.concatenate([np.full(100, 0.5), np.full(100, -0.5)])
    play(axis, pulse)
    assert axis.reference_position == pytest.approx(0.005)
    # Half the play and Coulomb's friction on the stiffness.
    lag = 2e-5 + 1.5 / (MASS * (2 * np.pi * 60.0) ** 2)
    assert axis.reference_position - axis.position == pytest.approx(lag, abs=6e-6)


def test_the_ripple_pushes_as_its_sine_says() -> None:
    plant = BeamPlant(MODEL, T, mechanism=Mechanism(ripple=0.3, ripple_period=0.005))
    axis = enabled_axis(AxisParameters(command_mode="effort"), plant)
    truth = MODEL.force_stepper(T)
    for _ in range(300):
        truth.step(0.2 + 0.3 * np.sin(2 * np.pi * truth.state[0] / 0.005))
    start, batches = play(axis, np.full(300, 0.2), extra_ticks=1)
    counts = np.concatenate([b.position_counts for b in batches])
    assert counts[300] * 1e-7 == pytest.approx(truth.state[0], abs=0.6e-7)
    shown = axis.snapshots([(start + 100) * TICK, (start + 100) * TICK + 999_999])
    # Inside a tick the same force acts as from tick to tick.
    assert shown.positions[1] == pytest.approx(axis.snapshots([(start + 101) * TICK]).positions[0], abs=1e-9)
    accelerations = axis.snapshots([(start + 101) * TICK - 1, (start + 100) * TICK]).accelerations
    assert accelerations[0] == pytest.approx(accelerations[1], abs=0.05)
    # What the device says that it applied is without the ripple, which it does not know.
    assert np.concatenate([b.efforts for b in batches])[:300] == pytest.approx(0.2)


def test_a_servo_under_a_drifting_clock_works_in_true_time() -> None:
    mechanism = Mechanism(FRICTION, servo=servo())
    second = 1.0 / 1.001
    axis = enabled_axis(
        AxisParameters(), beam_on_axis(MODEL, AxisParameters(), mechanism=mechanism, clock_drift_ppm=1000.0)
    )
    a = rest_to_rest(300, 2.0)
    _, batches = play(axis, a, extra_ticks=1)
    measured = np.concatenate([b.position_counts for b in batches]) * 1e-7
    truth = AxisStepper(MODEL, T * second, FRICTION, servo=servo())
    x = v = 0.0
    for k, value in enumerate(a):
        assert measured[k] == pytest.approx(truth.position, abs=0.6e-7)
        truth.step_servo(x, v / second, MASS * value / second**2)
        x, v = x + v * T + value * T * T / 2, v + value * T


@pytest.mark.slow
def test_drag_slows_the_beam_under_a_force_too() -> None:
    def amplitude(terms: NonlinearTerms | None) -> float:
        axis = enabled_axis(AxisParameters(command_mode="effort"), BeamPlant(MODEL, T, terms))
        t = np.arange(2000) * T
        # At the free hub's first frequency: resonance, which drag limits.
        drive = 0.15 * np.sin(MODEL.free_hub_natural_frequencies[0] * t)
        start, _ = play(axis, drive, extra_ticks=0)
        return float(np.max(np.abs(axis.snapshots(np.arange(start, axis.tick) * TICK).coordinates[:, 0])))

    bare, in_air = amplitude(None), amplitude(NonlinearTerms(MODEL, AirDrag(0.025, 20.0)))
    assert in_air < 0.9 * bare


def test_a_sequence_goes_on_from_the_reference_though_friction_keeps_the_hub_beside_it() -> None:
    parameters = AxisParameters(command_mode="position")
    rig = SimulatedRig(
        parameters, BeamPlant(MODEL, T, mechanism=Mechanism(FRICTION, servo=servo(backlash=4e-5)))
    )
    rig.enable()
    values = 0.004 * np.sin(np.pi * np.arange(801) / 800 / 2) ** 2
    for name, path in (("there", values), ("back", values[::-1])):
        start_ns = rig.now.unix_ns + 600_000_000
        for chunk in chunks_of(path, start_ns, name):
            rig.hub.load(chunk, rig.now)
        rig.until(lambda report: any(s.state == "done" for s in report.sequences))
        rig.run(0.3)
        # Further off than a sequence may start from where the axis is.
        assert abs(rig.hub.axis.position - path[-1]) > 5e-6
