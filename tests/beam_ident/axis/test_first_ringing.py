"""What positions show of a ringing, against columns of a ringing made elsewhere; and what leaving it out did."""

from __future__ import annotations

import math

import numpy as np
import pytest

from beam_ident.axis.axis_output_error import AxisOutputError, MassAndFriction
from beam_ident.axis.axis_record import AxisRecord
from beam_ident.axis.first_ringing import FirstRinging
from beam_ident.axis.inverse_dynamics import NAMES
from benchmarks.ident.driven_axis import CompliantAxis

OMEGA, WEIGHTS = 250.0, np.array([16.0, 400.0])


def information(zeta: float, duration_s: float) -> np.ndarray:
    """Return that on a drift and on both parts of a ringing at 250 rad/s under noise of 0.1."""
    t = np.arange(0.0, duration_s, 1e-3)
    ringing = np.exp((-zeta + 1j * math.sqrt(1.0 - zeta**2)) * OMEGA * t)
    columns = np.stack([t, ringing.real, ringing.imag], axis=1) / 0.1
    return np.asarray(columns.T @ columns)


@pytest.mark.parametrize("to", [1e-9, 0.01, 0.06])
def test_its_cost_at_another_damping_is_that_of_the_information_there(to: float) -> None:
    spans = [0.1, 2.0]
    first = FirstRinging.of(WEIGHTS, [information(0.03, span) for span in spans], spans, 0.03 * OMEGA)
    wanted = 0.0
    for span in spans:
        for sign, zeta in ((1.0, to), (-1.0, 0.03)):
            covariance = np.linalg.inv(information(zeta, span))[1:, 1:]
            wanted += 0.5 * sign * np.linalg.slogdet(np.diag(WEIGHTS) + np.linalg.inv(covariance))[1]
    # The drift takes a little of slow ringing, and samples are not an integral.
    assert first.cost(to * OMEGA) - first.cost(0.03 * OMEGA) == pytest.approx(wanted, rel=0.03)


def test_a_ringing_that_positions_cannot_show_costs_nothing_however_large_it_may_be() -> None:
    # Springs with ringings of other sizes are compared: beside no information, what is expected must not count.
    for weights in (WEIGHTS, 100.0 * WEIGHTS):
        first = FirstRinging.of(weights, [1e-9 * information(0.03, 2.0)], [2.0], 0.03 * OMEGA)
        assert first.cost(0.01 * OMEGA) == pytest.approx(0.0, abs=1e-5)


def test_its_slope_is_that_of_its_cost_where_the_ringing_has_faded() -> None:
    first = FirstRinging.of(np.full(2, 1e-9), [information(0.05, 2.0)] * 3, [2.0] * 3, 0.05 * OMEGA)
    # Two parts in each of three pieces, half a logarithm of 1 / fading each.
    assert first.slope(10.0) == pytest.approx(-3.0 / 10.0, rel=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [21, 26])
def test_damping_of_a_spring_that_a_servo_shakes_is_not_taken_for_none(seed: int) -> None:
    axis = CompliantAxis(duration_s=8.0, speed=0.2, is_of_drive=True)
    reduced = axis.drive_mass * (axis.mass - axis.drive_mass) / axis.mass
    omega = math.sqrt(axis.stiffness / reduced)
    zeta = axis.damping / (2.0 * omega * reduced)
    truth = MassAndFriction(*axis.truth, resonance=omega, resonance_damping=zeta, drive_mass=axis.drive_mass)
    whole = axis.record(seed)
    record = AxisRecord(whole.inputs[0], whole.outputs[0], is_of_drive=True)
    names = (*NAMES, "resonance", "resonance_damping", "drive_mass")
    problem = AxisOutputError([(record, piece) for piece in record.pieces], truth, names)
    state = problem.minimum(is_patient=True).state
    sd = np.sqrt(np.diag(problem.covariance(state)[0]))
    # Fitted only, the ringing of these records left damping ratios below 0.0001, thirteen deviations from 0.03.
    place = names.index("resonance_damping")
    assert abs(state.theta[place] - zeta) < 3.3 * sd[place]
