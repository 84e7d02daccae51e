"""Sensors of several kinds under one model, against modes that are known in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ident import InputSignal, LowPass, OutputSignal, identify
from beam_ident.data.stamp_order import StampOrder
from beam_ros.bags.signals import Unreadable
from beam_ros.signals.descriptions import SignalSource
from beam_ros.signals.fields import FieldSamples
from beam_ros.signals.records import SensorOutput, output_signal, records_of_one_model
from tests.beam_ros.signals.foreign_bags import DAMPING_RATIOS, FREQUENCIES_HZ, Beam, shaken

LASER, IMU = 0, 2


@pytest.fixture(scope="module")
def beam() -> Beam:
    return shaken(6.0)


def outputs(beam: Beam) -> dict[int, SensorOutput]:
    rng = np.random.default_rng(3)
    times, n = beam.times_s[::5], len(beam.times_s[::5])
    laser = beam.displacement[::5] + 1e-6 * rng.standard_normal(n)
    # The acceleration jumps with that of the base at each tick: between ticks it is one value.
    imu = beam.acceleration[::5] + 0.01 * rng.standard_normal(n)
    return {
        LASER: SensorOutput(OutputSignal("laser", "m", times, laser), 0),
        IMU: SensorOutput(OutputSignal("imu", "m/s^2", times + 1e-9, imu), 2),
    }


@pytest.mark.first_case
@pytest.mark.parametrize(
    ("drive_kind", "sensors", "structure"),
    [
        ("position", (LASER,), "base_motion"),
        ("position", (LASER, IMU), "base_motion"),
        ("acceleration", (LASER,), "acceleration"),
        ("acceleration", (IMU,), "accelerance"),
        ("acceleration", (LASER, IMU), "accelerance"),
    ],
)
def test_every_pair_of_input_and_sensors_finds_the_same_modes(
    beam: Beam, drive_kind: str, sensors: tuple[int, ...], structure: str
) -> None:
    values = beam.base if drive_kind == "position" else beam.base_acceleration
    hold = "cubic" if drive_kind == "position" else "zoh"
    drive = InputSignal("axis", "m", beam.times_s, values, hold)
    found = outputs(beam)
    kind, records = records_of_one_model(drive, drive_kind, [found[k] for k in sensors], 0, "beam")
    assert kind == structure
    assert len(records) == len(sensors)
    model = identify(records, kind, n_modes=2).model
    # A cubic through ticks of 1 ms misses a held acceleration by less than 1e-4 at 31 Hz.
    np.testing.assert_allclose(model.frequencies_hz, FREQUENCIES_HZ, rtol=2e-5)
    np.testing.assert_allclose(model.damping_ratios, DAMPING_RATIOS, rtol=3e-3)


def test_a_force_is_integrated_for_the_lower_kinds() -> None:
    times = 1e-3 * np.arange(2000)
    drive = InputSignal("hammer", "N", times, np.sin(20.0 * times), "cubic")
    outs = [
        SensorOutput(OutputSignal("laser", "m", times, np.cos(times)), 0),
        SensorOutput(OutputSignal("imu", "m/s^2", times, np.cos(times)), 2),
    ]
    structure, (accelerometer, laser) = records_of_one_model(drive, "force", outs, 0, "x")
    assert structure == "accelerance"
    np.testing.assert_array_equal(accelerometer.inputs[0].values, drive.values)
    twice = (20.0 * times - np.sin(20.0 * times)) / 400.0
    np.testing.assert_allclose(laser.inputs[0].values, twice, atol=1e-9)
    assert records_of_one_model(drive, "force", outs[:1], 0, "x")[0] == "receptance"
    assert records_of_one_model(drive, "force", outs[:1], 0, "x", has_rigid_body=True)[0] == "force"


def test_a_low_pass_of_a_sensor_goes_from_the_text_to_the_output() -> None:
    source = SignalSource.of("/laser/range:range,low_pass=80,order=2", is_input=False)
    stamps = np.arange(30, dtype=np.int64) * 10_000_000
    samples = FieldSamples(
        source.topic,
        source.field,
        stamps,
        np.zeros(30),
        True,
        0,
        Unreadable(),
        StampOrder(np.arange(30), 0, 0, ()),
    )
    assert output_signal(source, samples, 0).signal.low_pass == LowPass.of_order(2, 80.0)
