"""A shaped move on the firmware for the STM32F405 in QEMU: what its processor applies, and the swing that is left."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import cont2discrete, dlsim

from beam_ident.shaping.known_beam import PoleDrift
from beam_ident.shaping.residual import predict_residual
from beam_ros.excitation.optimal import theory_of_drive
from beam_ros.excitation.plan import plan_excitation
from beam_ros.excitation.shaping import MoveOrder, shape_for_rig
from beam_ros.hub.simulated.beam_points import BeamPoints
from beam_ros.rig.rig import Rig
from benchmarks.paced_firmware import PacedFirmware
from tests.firmware.builds import built
from tests.firmware.test_core import Host, play

pytestmark = pytest.mark.slow

RIG = Rig.from_file().with_values({"excitation.dwell": 0.5, "excitation.still": 0.1})
SEEN = 480
"""Ticks that are filmed before the move and after it: two periods of the first mode."""
WARMER = 1.0 - 4e-4
"""What the beam's frequencies are of those that the move was shaped for."""


def phasors(poles: np.ndarray, times_s: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Amplitudes of the modes at time 0, with their phases, in what a point does at some times."""
    waves = np.exp(np.outer(times_s, poles))
    columns = np.concatenate([waves.real, -waves.imag, np.ones((len(times_s), 1))], axis=1)
    found = np.linalg.lstsq(columns, places, rcond=None)[0]
    return found[: len(poles)] + 1j * found[len(poles) : -1]


def swings_of_linear_model(accelerations: np.ndarray, rig: Rig) -> np.ndarray:
    """What held accelerations leave in a rig's modes, by SciPy's steps of every mode, at every marker."""
    theory = theory_of_drive(rig)
    total = np.zeros(len(theory.output_names))
    for omega, zeta, shares in zip(
        theory.natural_frequencies, theory.damping_ratios, theory.residues.T, strict=True
    ):
        states = np.array([[0.0, 1.0], [-(omega**2), -2.0 * zeta * omega]])
        system = cont2discrete(
            (states, np.array([[0.0], [-1.0]]), np.eye(2), np.zeros((2, 1))), rig.hub.period
        )
        place, speed = dlsim(system, np.append(accelerations, 0.0))[1][-1]
        damped = omega * np.sqrt(1.0 - zeta**2)
        total += np.abs(shares) * np.hypot(place, (speed + zeta * omega * place) / damped)
    return total


def test_the_processor_applies_a_shaped_move_tick_by_tick_and_it_leaves_what_was_predicted():
    theory = theory_of_drive(RIG)
    found = shape_for_rig(RIG, MoveOrder(0.0, 0.02, 1e-4, drift=PoleDrift(5e-4, 0.05)), theory)
    assert found.choice.keeps_aim
    plan = plan_excitation(found.rig)
    rig = found.rig.with_values({"beam.youngs_modulus": RIG.beam.youngs_modulus * WARMER**2})
    model = rig.beam_model()
    plant = rig.simulated_plant(model, 0.0)
    firmware = PacedFirmware(built("stm32f405-plant.elf"), rig.axis_parameters(), plant, 0.01)
    try:
        host = Host(firmware)
        host.enable()
        host.rest(SEEN)
        ticks = play(host, plan.values)
        np.testing.assert_array_equal(ticks.applied, plan.values)

        end = round(plan.recipe.move_end_s / rig.hub.period)
        since = np.concatenate([np.arange(-SEEN, 1), end + np.arange(1, SEEN)])
        instants = (ticks.first_tick + since) * rig.axis_parameters().period_ns
        filmed = BeamPoints(model, rig.markers.heights).displacements(firmware.axis.snapshots(instants))
    finally:
        firmware.close()
    residual = predict_residual(found.choice.chosen.move, found.choice.beam)
    low, high = residual.interval
    poles = theory_of_drive(rig).poles
    by_command = swings_of_linear_model(ticks.applied[:end], rig)
    assert np.all((low <= by_command) & (by_command <= high))
    # The beam still swings from homing when the move begins: that goes on beside what the move adds.
    times_s, is_before = (since - end) * rig.hub.period, since <= 0
    for place, own_low, own_high in zip(filmed.T, low, high, strict=True):
        left, homing = (phasors(poles, times_s[own], place[own]) for own in (~is_before, is_before))
        assert own_low <= np.sum(np.abs(left - homing)) <= own_high
