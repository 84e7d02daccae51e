"""Moves as rows of held accelerations: where they end, within which limits, and what they leave."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from beam_ident.errors import ExcitationError
from beam_ident.shaping.command import convolved, s_curve
from tests.beam_ident.shaping.beams import LIMITS, OMEGAS, ZETAS, amplitude_after


@pytest.mark.parametrize("distance", [0.0003, -0.02, 0.09])
def test_an_s_curve_ends_at_rest_where_it_should_and_keeps_every_limit(distance: float) -> None:
    move = s_curve(distance, LIMITS.axis, 1e-3)
    assert move.distance == pytest.approx(distance, rel=1e-12)
    assert abs(move.velocities[-1]) < 1e-15
    jerks = np.diff(move.accelerations, prepend=0.0, append=0.0) / move.period_s
    peaks = (np.max(np.abs(move.velocities)), np.max(np.abs(move.accelerations)), np.max(np.abs(jerks)))
    for peak, limit in zip(peaks, (0.5, 8.0, 600.0), strict=True):
        assert peak <= limit * (1.0 + 1e-6)
    assert max(peaks[1] / 8.0, peaks[2] / 600.0) > 0.9, "one of the limits is used"


def test_a_slower_s_curve_takes_as_long_as_asked() -> None:
    assert s_curve(0.02, LIMITS.axis, 1e-3, duration_s=0.4).duration_s == pytest.approx(0.4, abs=2e-3)


@pytest.mark.parametrize("hold", ["acceleration", "position"])
def test_what_is_left_is_what_the_equation_of_motion_leaves(hold: str) -> None:
    move = dataclasses.replace(s_curve(0.004, LIMITS.axis, 2e-3), quantity=hold)
    omega, zeta = float(OMEGAS[1]), float(ZETAS[1])
    pole = omega * complex(-zeta, np.sqrt(1.0 - zeta**2))
    (phasor,) = move.end_phasors(np.array([pole]))
    assert abs(phasor) / pole.imag == pytest.approx(amplitude_after(move, omega, zeta, hold), rel=1e-6)


def test_velocities_that_are_held_delay_what_positions_do_by_half_a_tick() -> None:
    move = s_curve(0.004, LIMITS.axis, 2e-3)
    pole = np.array([complex(-0.1, 170.0)])
    of_velocity = dataclasses.replace(move, quantity="velocity").end_phasors(pole)
    of_position = dataclasses.replace(move, quantity="position").end_phasors(pole)
    expected = 0.5 * (1.0 + np.exp(pole * move.period_s))
    assert of_position / of_velocity == pytest.approx(expected)


def test_a_shaper_between_two_ticks_keeps_its_mean_delay_and_the_distance() -> None:
    base = s_curve(0.01, LIMITS.axis, 1e-3)
    shaped = convolved(base, np.array([0.0, 0.1133]), np.array([0.4, 0.6]), "two")
    assert shaped.distance == pytest.approx(0.01, rel=1e-12)

    def middle(move: object) -> float:
        return float(np.sum(0.01 - move.positions) * 1e-3 / 0.01)  # type: ignore[attr-defined]

    assert middle(shaped) - middle(base) == pytest.approx(0.6 * 0.1133, rel=1e-3)


@pytest.mark.parametrize("distance", [0.0, np.nan])
def test_a_move_to_nowhere_is_refused(distance: float) -> None:
    with pytest.raises(ExcitationError, match="other than 0"):
        s_curve(distance, LIMITS.axis, 1e-3)
