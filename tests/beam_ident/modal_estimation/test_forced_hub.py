from __future__ import annotations

import numpy as np
import pytest

from beam_ident import InputSignal, LogChirp, TimeRecord, identify
from benchmarks.ident.forced_hub import FreeHubCase, SoftServoCase
from benchmarks.ident.physical import PhysicalCase

SHORT = LogChirp(sweep_s=10.0, still_s=4.0)


@pytest.fixture(scope="module")
def servo():
    return SoftServoCase(chirp=SHORT)


def test_the_measured_position_of_a_soft_servo_gives_the_clamped_beam(servo):
    outcome = servo.run(1)
    assert np.max(np.abs((outcome.estimate - servo.truth) / outcome.sd)) < 4.0
    # The hub does not follow its set point: the beam's pull and the loop's lag move it by micrometres.
    assert np.max(np.abs(servo.positions - servo.set_points)) > 1e-5


def test_the_set_point_of_a_soft_servo_gives_other_poles(servo):
    record = servo.record(1)
    set_point = InputSignal("hub", "m", (0.0, 1e-3), servo.set_points, "cubic")
    model = identify(TimeRecord((set_point,), record.outputs), n_modes=3).model
    z = (model.natural_frequencies - servo.truth[:3]) / model.natural_frequency_sd
    assert np.max(np.abs(z)) > 10.0


def test_a_force_on_the_hub_gives_the_modes_of_the_free_hub_and_its_mass():
    case = FreeHubCase(SHORT)
    outcome = case.run(1)
    assert np.max(np.abs((outcome.estimate - case.truth) / outcome.sd)) < 4.0
    clamped = case.hub.model.natural_frequencies[:2]
    assert np.all(case.truth[:2] > clamped + 10.0 * outcome.sd[:2])


def test_the_beam_itself_is_found_from_a_start_thirty_percent_off():
    case = PhysicalCase(SHORT)
    outcome = case.run(1)
    assert np.max(np.abs((outcome.estimate - case.truth) / outcome.sd)) < 4.0
