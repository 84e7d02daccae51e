from __future__ import annotations

import numpy as np
import pytest

from beam_model import BeamModel, BeamParameters, Damping
from beam_ros.hub.parameters import AxisParameters
from beam_ros.hub.simulated.beam_points import BeamPoints
from beam_ros.hub.simulated.plant import BeamPlant, beam_on_axis
from tests.beam_ros.hub.hub_scenes import enabled_axis, rest_to_rest

T = 1e-3
TICK = 1_000_000
HEIGHTS = [0.010, 0.225, 0.285]


def beam(**damping) -> BeamModel:
    rig = BeamParameters.from_section(
        0.30,
        0.025,
        0.0005,
        7850.0,
        200e9,
        hub_mass=0.8,
        gravity="upright",
        damping=Damping(**damping) if damping else Damping(ratios=(0.005,)),
    )
    return BeamModel(rig, n_modes=5)


def play(axis, values, extra_ticks=400):
    """Play a sequence; return the axis's first tick of it."""
    start = axis.tick + 5
    assert axis.arm(start * TICK, len(values)).success
    assert axis.append(0, list(values)).success
    batches = []
    while axis.tick < start + len(values) + extra_ticks:
        axis.feed()
        batches.append(axis.advance(axis.device_ns + 10 * TICK))
    return start, batches


@pytest.mark.parametrize("damping", [{}, {"air": 0.05}, {"internal": 3e-4}])
def test_the_axis_shows_what_the_models_own_stepper_computes(damping):
    model = beam(**damping)
    axis = enabled_axis(AxisParameters(), BeamPlant(model, T))
    values = rest_to_rest(500, 2.0)
    start, _ = play(axis, values)
    reference = model.motion_stepper(T)
    tau = 0.37e-3
    for k in range(800):
        a = values[k] if k < 500 else 0.0
        if k % 50 == 7:
            shown = axis.snapshots([(start + k) * TICK + 370_000])
            assert shown.coordinates[0] == pytest.approx(reference.coordinates(tau, a), abs=1e-12)
            residual = reference.residual_acceleration(tau, a)
            assert shown.residual_accelerations[0] == pytest.approx(float(residual), abs=1e-9)
        reference.step(a)


def test_the_force_on_a_led_hub_drives_a_free_hub_along_the_same_path():
    model = beam()
    period = 2.5e-4
    parameters = AxisParameters(period_ns=250_000)
    axis = enabled_axis(parameters, BeamPlant(model, period))
    n = 2000
    values = rest_to_rest(n, 1.0)
    axis.arm(axis.device_ns, n)
    axis.append(0, values.tolist())
    efforts = []
    x = []
    for _ in range(n // 20):
        axis.feed()
        batch = axis.advance(axis.device_ns + 20 * 250_000)
        efforts.append(batch.efforts)
        x.append(batch.position_counts * 1e-7)
    force = np.concatenate(efforts).astype(float)
    x = np.concatenate(x)
    free = model.force_stepper(period)
    # The force is known at the ticks: its mean over a tick is nearly that of both ends.
    path = free.run((force[:-1] + force[1:]) / 2)[:, 0]
    assert np.max(np.abs(path[:n] - x)) < 0.01 * np.max(np.abs(x))


@pytest.mark.parametrize("mode", ["velocity", "position"])
def test_velocity_steps_and_lines_of_position_bend_the_beam_like_the_smooth_motion(mode):
    n = 1000
    t = np.arange(n + 1) * T
    smooth = 0.004 * np.sin(np.pi * t) ** 4
    model = beam()
    points = BeamPoints(model, HEIGHTS)
    values = smooth if mode == "position" else np.append(np.diff(smooth) / T, 0.0)
    axis = enabled_axis(AxisParameters(command_mode=mode), BeamPlant(model, T))
    start, _ = play(axis, values)
    accelerated = enabled_axis(AxisParameters(), BeamPlant(model, T))
    a = np.gradient(np.gradient(smooth, T), T)
    begin, _ = play(accelerated, a - a.mean())
    ticks = np.arange(100, 1300, 10)
    seen = points.displacements(axis.snapshots((start + ticks) * TICK))
    expected = points.displacements(accelerated.snapshots((begin + ticks) * TICK))
    # The tip bends by millimetres; half a tick of delay is 8 um at most.
    assert np.max(np.abs(expected)) > 3e-3
    assert np.max(np.abs(seen - expected)) < 3e-5


def test_a_free_hub_with_a_beam_moves_as_the_force_stepper_says_and_brakes_to_rest():
    model = beam()
    axis = enabled_axis(AxisParameters(command_mode="effort"), BeamPlant(model, T))
    values = np.concatenate([np.full(150, 0.3), np.full(140, -0.3)])
    start, _ = play(axis, values)
    reference = model.force_stepper(T)
    for k in range(290):
        if k % 29 == 3:
            shown = axis.snapshots([(start + k) * TICK + 400_000])
            motion = reference.motion(4e-4, values[k])
            assert shown.positions[0] == pytest.approx(float(motion.position), abs=1e-12)
            assert shown.coordinates[0] == pytest.approx(motion.coordinates, abs=1e-11)
        reference.step(values[k])
    held = axis.snapshots([axis.device_ns - 50 * TICK, axis.device_ns])
    assert held.positions[0] == held.positions[1]
    assert np.max(np.abs(held.coordinates)) > 1e-5


def test_the_deflection_under_a_lasting_acceleration_is_the_static_one():
    # A slow ramp: w(L) = a rho L^4 / (8 EI), raised by gravity's softening of the upright strip.
    model = beam(ratios=(0.7,))
    load = BeamPlant(model, T)
    for _ in range(3000):
        load.step_led(1.0, 1.0)
    q = load.coordinates(load.state(), 0.0, 1.0)
    w = model.shape([0.3]) @ q - model.residual_terms([0.3])
    EI = 200e9 * 0.025 * 0.0005**3 / 12
    rigid = -7850 * 0.025 * 0.0005 * 0.3**4 / (8 * EI)
    assert w[0] == pytest.approx(rigid, rel=0.1)


SECOND = 1.0 / 1.001  # true seconds per second of a device that runs 1000 ppm fast


def test_a_struck_beam_vibrates_in_true_time_whatever_the_devices_clock_says():
    """Closed form after a jump v of the hub: q = -Gamma v e^(-zeta w t) sin(w_d t) / w_d, in true time."""
    model = beam()
    plant = beam_on_axis(model, AxisParameters(), clock_drift_ppm=1000.0)
    plant.kick(0.1 * SECOND)  # as the device sees 0.1 m/s
    ticks = 3000
    for _ in range(ticks):
        plant.step_led(0.0, 0.0)
    t = ticks * T * SECOND
    omega, zeta = model.natural_frequencies, model.damping_ratios
    damped = omega * np.sqrt(1 - zeta**2)
    expected = -model.participation_factors * 0.1 * np.exp(-zeta * omega * t) * np.sin(damped * t) / damped
    np.testing.assert_allclose(plant.state()[: model.n_modes], expected, atol=1e-12)
    inside = plant.coordinates(plant.state(), 0.5 * T, 0.0)
    t += 0.5 * T * SECOND
    expected = -model.participation_factors * 0.1 * np.exp(-zeta * omega * t) * np.sin(damped * t) / damped
    np.testing.assert_allclose(inside, expected, atol=1e-12)


def test_a_held_acceleration_of_the_device_is_another_one_in_true_time():
    """The static shape under a lasting acceleration a is -Gamma a / w^2."""
    model = beam(viscous=5.0)
    plant = beam_on_axis(model, AxisParameters(), clock_drift_ppm=1000.0)
    for _ in range(4000):
        plant.step_led(1.0, 1.0)
    expected = -model.participation_factors / SECOND**2 / model.natural_frequencies**2
    np.testing.assert_allclose(plant.state()[: model.n_modes], expected, rtol=1e-6)
    assert plant.residual_acceleration(plant.state(), 0.0, 1.0) == pytest.approx(SECOND**-2)


def test_a_free_hub_moves_in_true_time_and_is_told_in_the_devices():
    model = beam()
    plant, truth = (
        beam_on_axis(model, AxisParameters(), clock_drift_ppm=1000.0),
        model.force_stepper(T * SECOND),
    )
    position = velocity = 0.0
    for _ in range(500):
        position, velocity = plant.step_free(position, velocity, 0.3)
        truth.step(0.3)
    assert position == pytest.approx(truth.state[0], rel=1e-9)
    assert velocity == pytest.approx(truth.state[model.n_modes + 1] * SECOND, rel=1e-9)
    seen = plant.free_motion(plant.state(), position, velocity, T / 2, 0.3)
    expected = truth.motion(T * SECOND / 2, 0.3)
    assert seen.position == pytest.approx(float(expected.position), rel=1e-9)
    assert seen.acceleration == pytest.approx(float(expected.acceleration), rel=1e-6)


def test_a_clock_without_drift_needs_no_translation():
    assert isinstance(beam_on_axis(beam(), AxisParameters()), BeamPlant)
