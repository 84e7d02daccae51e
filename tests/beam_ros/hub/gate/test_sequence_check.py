from __future__ import annotations

import numpy as np
import pytest

from beam_ros.hub.gate.sequence_assembly import SequenceAssembler
from beam_ros.hub.gate.sequence_check import SequenceCheck, SequenceMotion
from beam_ros.hub.parameters import AxisParameters
from tests.beam_ros.hub.hub_scenes import chunks_of, rest_to_rest

ACCELERATION = AxisParameters()
VELOCITY = AxisParameters(command_mode="velocity")
POSITION = AxisParameters(command_mode="position")
EFFORT = AxisParameters(command_mode="effort")


def assembled(values, parameters):
    chunks = chunks_of(values, 10**18, period_ns=parameters.period_ns)
    assembler = SequenceAssembler(chunks[0], parameters)
    for chunk in chunks:
        assert assembler.add(chunk) is None
    return assembler


def check_sequence(values, parameters, position):
    check = SequenceCheck(assembled(values, parameters), parameters, position)
    check.begin(in_background=False)
    assert check.is_done
    return check.objection


def _velocity(values):
    return check_sequence(np.asarray(values), VELOCITY, 0.0)


def test_acceleration_sequences_are_checked_by_exact_integration():
    good = rest_to_rest(2000)
    assert check_sequence(good, ACCELERATION, 0.0) is None
    assert "ends with" in check_sequence(good[:1500], ACCELERATION, 0.0)
    assert "acceleration reaches" in check_sequence(good * 40, ACCELERATION, 0.0)
    # The move's own extremum is 0.0136 m or so: from 0.049 m it leaves the travel.
    assert "travel" in check_sequence(good, ACCELERATION, 0.049)
    there_and_back = np.concatenate([np.full(200, 3.0), np.full(400, -3.0), np.full(200, 3.0)])
    assert "speed reaches" in check_sequence(there_and_back, ACCELERATION, 0.0)


def test_travel_is_checked_between_ticks_too():
    # A tick that turns round in its middle: 20 mm from the start at both ends, 30 mm in between.
    slow = AxisParameters(period_ns=100_000_000)
    values = np.array([4.0, -8.0, 4.0])
    assert check_sequence(values, slow, 0.02) is None
    assert "travel" in check_sequence(values, slow, 0.0201)


def test_velocity_sequences_start_from_rest_and_end_at_rest():
    ramp = np.linspace(0, 0.2, 101)
    there = np.concatenate([ramp, ramp[::-1]])
    assert _velocity(np.concatenate([there, -there])) is None
    assert "start from rest" in _velocity([0.05, 0.05, 0.0])
    assert "acceleration" in _velocity([0.0, 0.05, 0.0])
    assert "ends with" in _velocity(ramp)


def test_position_sequences_begin_where_the_hub_is():
    x = 0.01 * (1 - np.cos(2 * np.pi * np.arange(1001) / 1000))
    assert check_sequence(x, POSITION, 0.0) is None
    assert "starts at" in check_sequence(x, POSITION, 1e-4)
    assert "acceleration" in check_sequence(np.array([0.0, 1e-3, 1e-3]), POSITION, 0.0)
    assert "travel" in check_sequence(x + 0.045, POSITION, 0.045)


def test_effort_sequences_stay_within_the_force():
    assert check_sequence(np.array([0.0, 5.0, 0.0]), EFFORT, 0.0) is None
    assert "effort reaches" in check_sequence(np.array([0.0, 25.0]), EFFORT, 0.0)


@pytest.mark.parametrize("mode", ["acceleration", "velocity", "position"])
def test_a_motion_in_pieces_is_the_motion_in_one_piece(mode):
    parameters = AxisParameters(command_mode=mode)
    a = rest_to_rest(3000, 1.0)
    values = {"acceleration": a, "velocity": np.cumsum(a) * 1e-3}.get(mode, np.cumsum(np.cumsum(a)) * 1e-6)
    whole, pieces = SequenceMotion(parameters, 0.0), SequenceMotion(parameters, 0.0)
    assert whole.add(values) is None
    for piece in np.split(values, [1, 2, 700, 1999]):
        assert pieces.add(piece) is None
    assert pieces._position == pytest.approx(whole._position, abs=1e-12)
    assert pieces._velocity == pytest.approx(whole._velocity, abs=1e-12)
    # A jump at the seam of two pieces is as much a jump as one within.
    jump = np.concatenate(
        [values[:1500], values[1500:] + {"acceleration": 10.0, "velocity": 0.02}.get(mode, 1e-4)]
    )
    pieces = SequenceMotion(parameters, 0.0)
    assert pieces.add(jump[:1500]) is None
    assert "acceleration reaches" in str(pieces.add(jump[1500:]))


def test_a_check_that_breaks_refuses_its_sequence():
    class Broken:
        def add(self, values):
            raise MemoryError("no room")

    check = SequenceCheck(assembled(np.zeros(9), ACCELERATION), ACCELERATION, 0.0, Broken)
    with pytest.raises(MemoryError):
        check.begin(in_background=False)
    assert check.is_done
    assert "MemoryError: no room" in str(check.objection)
