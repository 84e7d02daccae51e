"""The hub behind a firmware: it goes where the drive says, and its sensors tell of it."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ros.hub.firmware.driven_hub import DrivenHub
from beam_ros.hub.firmware.plant_port import Drive
from beam_ros.hub.parameters import AxisParameters, SimulatedDevice
from beam_ros.hub.simulated.plant import RigidPlant

AXIS = AxisParameters()
T = AXIS.period


def drive(tick, velocity=0.0, acceleration=0.0, effort=None):
    return Drive(tick, True, effort is not None, 0.0, velocity, acceleration, effort or 0.0, 0)


def at_rest(position=0.0, first=100, delay_ns=0):
    hub = DrivenHub(AXIS, RigidPlant(0.8, T), SimulatedDevice(position))
    hub.move(drive(first), first * AXIS.period_ns + delay_ns)
    return hub


def test_a_held_acceleration_and_a_jump_of_the_velocity_make_the_way_of_a_tick():
    hub = at_rest()
    hub.move(drive(101, velocity=0.1, acceleration=-2.0), 0)
    assert hub.true_position == pytest.approx(0.1 * T - T**2, abs=1e-15)
    assert hub.velocity == pytest.approx(0.1 - 2.0 * T)
    # The jump spread over the tick, and the acceleration held in it.
    assert hub.reading.effort == pytest.approx(0.8 * (0.1 / T - 2.0))
    assert (hub.reading.tick, hub.reading.counter) == (102, round((0.1 * T - T**2) / 1e-7))


def test_a_free_hub_follows_its_force():
    hub = at_rest()
    hub.move(drive(101, effort=4.0), 0)
    hub.move(drive(102, effort=0.0), 0)
    assert hub.velocity == pytest.approx(4.0 / 0.8 * T)


def test_a_tick_that_is_said_again_is_not_done_again():
    hub = at_rest()
    for _ in range(3):
        hub.move(drive(101, velocity=0.1), 0)
    assert hub.true_position == pytest.approx(0.1 * T)
    assert hub.reading.tick == 102


def test_the_home_counter_is_where_home_is_once_it_was_passed():
    hub = at_rest(position=-0.0012)
    assert hub.reading.is_below_home
    assert not hub.reading.has_home_counter
    for tick in range(101, 116):
        hub.move(drive(tick, velocity=0.1), 0)
    assert not hub.reading.is_below_home
    assert (hub.reading.has_home_counter, hub.reading.home_counter) == (True, 12_000)
    assert hub.reading.counter == 15_000


def test_the_end_switches_stand_beyond_the_widest_travel():
    hub = at_rest(position=0.0499)
    hub.move(drive(101, velocity=0.5), 0)
    assert not hub.reading.is_at_high_end
    hub.move(drive(102, velocity=0.5), 0)
    assert hub.reading.is_at_high_end
    assert not hub.reading.is_at_low_end


def test_after_a_reset_the_hub_stands_and_the_encoder_counts_from_there():
    hub = at_rest()
    hub.move(drive(101, velocity=0.1), 0)
    hub.reset()
    assert (hub.velocity, hub.reading.tick, hub.reading.counter) == (0.0, 0, 0)
    assert hub.true_position == pytest.approx(0.1 * T)
    hub.move(drive(5), 5 * AXIS.period_ns)
    assert hub.reading.tick == 6


def test_snapshots_name_the_callers_time_by_the_quickest_message():
    hub = at_rest(first=100, delay_ns=900_000)
    for tick, delay_ns in ((101, 150_000), (102, 400_000)):
        hub.move(drive(tick, velocity=0.1), tick * AXIS.period_ns + delay_ns)
    assert hub.device_ns == 103 * AXIS.period_ns + 150_000
    shown = hub.snapshots([101_000_000 + 150_000, 102_500_000 + 150_000])
    assert shown.positions == pytest.approx(np.array([0.0, 1.5e-4]), abs=1e-15)
