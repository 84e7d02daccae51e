from __future__ import annotations

import pytest

from beam_ros.hub.parameters import AxisParameters, LinkParameters, SimulatedDevice
from beam_ros.hub.simulated.axis import VirtualAxis
from beam_ros.hub.simulated.plant import RigidPlant


@pytest.mark.parametrize(
    ("group", "name", "value"),
    [
        (AxisParameters, "travel", 0.0),
        (AxisParameters, "max_speed", float("nan")),
        (AxisParameters, "max_acceleration", -1.0),
        (AxisParameters, "command_mode", "jerk"),
        (AxisParameters, "period_ns", 1e6),
        (AxisParameters, "watchdog_s", 0.03),
        (AxisParameters, "homing_speed", 1.0),
        (LinkParameters, "serial_baud", 0),
        (LinkParameters, "max_clock_sd_ns", 50e3),
        (SimulatedDevice, "clock_drift_ppm", 2000.0),
        (SimulatedDevice, "clock_start_ns", -1),
        (SimulatedDevice, "buffer_samples", 10),
    ],
)
def test_a_parameter_no_hub_can_have_is_refused_by_name(group, name, value):
    with pytest.raises(ValueError, match=name):
        group(**{name: value})


@pytest.mark.parametrize("position", [0.06, float("nan")])
def test_a_hub_does_not_start_beyond_its_travel(position):
    with pytest.raises(ValueError, match="initial_position"):
        VirtualAxis(AxisParameters(), RigidPlant(0.8, 1e-3), SimulatedDevice(initial_position=position))


@pytest.mark.parametrize(
    ("period_ns", "ticks"), [(100_000, 100), (250_000, 80), (1_000_000, 20), (100_000_000, 1)]
)
def test_a_batch_is_about_twenty_milliseconds_and_fits_a_frame(period_ns, ticks):
    parameters = AxisParameters(period_ns=period_ns)
    assert (parameters.batch_ticks, parameters.batch_ns) == (ticks, ticks * period_ns)
