from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from beam_ident import InputSignal, LogChirp, ModalStructure, OutputSignal, TimeRecord, identify
from benchmarks.ident.forced_hub import FreeHubCase, SoftServoCase
from benchmarks.ident.physical import PhysicalCase

# Two masses and a spring under a force: a free hub whose response has a closed form.
HUB, TIP, SPRING, DASHPOT = 0.8, 0.05, 40.0, 0.02  # [kg], [kg], [N/m], [N s/m]
PERIOD_S, EXPOSURE_S = 0.01, 0.004

SHORT = LogChirp(duration=10.0, still=4.0)


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


def two_masses() -> TimeRecord:
    """Push the hub with a held random force; the positions come from the matrix exponential of Newton's laws."""
    rng = np.random.default_rng(0)
    force = rng.standard_normal(1200)
    force -= np.mean(force)
    # x = (hub, tip, hub', tip', integrals of hub and tip, force)
    newton = np.zeros((7, 7))
    newton[0, 2] = newton[1, 3] = 1.0
    pull = np.array([-SPRING, SPRING, -DASHPOT, DASHPOT])
    newton[2, :4], newton[3, :4] = pull / HUB, -pull / TIP
    newton[2, 6] = 1.0 / HUB
    newton[4, 0] = newton[5, 1] = 1.0
    step = expm(newton * 1e-3)
    fine = np.zeros((10 * len(force) + 1, 7))
    for k in range(len(fine) - 1):
        fine[k, 6] = force[k // 10]
        fine[k + 1] = step @ fine[k]
    centres = np.arange(13, len(fine) - 10, 10)  # off the steps of the force
    seen = (fine[centres + 2, 4:6] - fine[centres - 2, 4:6]) / EXPOSURE_S
    seen += 1e-9 * rng.standard_normal(seen.shape)
    outputs = tuple(
        OutputSignal(name, "m", 1e-3 * centres, seen[:, j], EXPOSURE_S)
        for j, name in enumerate(("hub", "tip"))
    )
    return TimeRecord((InputSignal("force", "N", (0.0, PERIOD_S), force, "zoh"),), outputs)


def test_gains_and_residues_under_force_are_those_of_two_masses_and_a_spring():
    # u_hub/f = 1/(M s^2) + (m/m_h)/M / (s^2 + c/mu s + k/mu),  u_tip/f = 1/(M s^2) - 1/M / (...),
    # with M = m_h + m and the reduced mass mu = m_h m / M.
    total, reduced = HUB + TIP, HUB * TIP / (HUB + TIP)
    model = identify(two_masses(), ModalStructure("force", has_residual=False), n_modes=1).model
    omega = np.sqrt(SPRING / reduced)
    assert model.natural_frequencies == pytest.approx([omega], rel=1e-6)
    assert model.damping_ratios == pytest.approx([DASHPOT / (2.0 * reduced * omega)], rel=1e-4)
    assert model.gains == pytest.approx([1.0 / total, 1.0 / total], rel=1e-4)
    assert model.residues[:, 0] == pytest.approx([TIP / HUB / total, -1.0 / total], rel=1e-4)
    assert np.all(model.residue_sd < 1e-4)
