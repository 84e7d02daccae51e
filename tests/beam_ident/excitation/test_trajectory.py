"""Trajectories of one's own: what is played between the rows, and what is no motion."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ident import AxisLimits, ExcitationError, ExcitationLimitError, Trajectory

T = 1e-3
RNG = np.random.default_rng(2)


def at_ticks(n: int) -> tuple[float, ...]:
    return tuple((0.5 + T * np.arange(n)).tolist())


def test_accelerations_on_ticks_are_played_as_they_are() -> None:
    rows = RNG.standard_normal(200)
    rows -= np.mean(rows)
    excitation = Trajectory("acceleration", at_ticks(200), tuple(rows), still=0.1).sample(T)
    np.testing.assert_allclose(excitation.accelerations[:200], rows, atol=1e-10)
    np.testing.assert_allclose(excitation.accelerations[201:], 0.0, atol=1e-10)
    np.testing.assert_allclose(excitation.velocities[:201], np.append(0.0, np.cumsum(rows) * T), atol=1e-14)


def test_velocities_are_exact_at_the_ticks_and_straight_between_rows() -> None:
    rows = np.concatenate([[0.0], 0.01 * RNG.standard_normal(20), [0.0]])
    times = np.sort(RNG.uniform(0.0, 2.0, 22))
    excitation = Trajectory("velocity", tuple(times), tuple(rows), still=0.3).sample(T)
    ticks = T * np.arange(len(excitation.velocities))
    np.testing.assert_allclose(
        excitation.velocities, np.interp(ticks, times - times[0], rows, left=0.0, right=0.0), atol=1e-13
    )


def test_positions_are_met_within_a_quarter_of_the_acceleration_and_the_end_stays() -> None:
    times = np.linspace(1.0, 3.0, 41)
    path = (
        0.02 + 0.004 * np.sin(np.pi * (times - 1.0) / 4.0) ** 2
    )  # at rest at both ends, elsewhere at the second
    recipe = Trajectory("position", tuple(times), tuple(path), still=0.5)
    excitation = recipe.sample(T)
    ticks = T * np.arange(len(excitation.positions))
    wanted = 0.004 * np.sin(np.pi * np.minimum(ticks, 2.0) / 4.0) ** 2
    bound = T**2 / 4.0 * np.max(np.abs(excitation.accelerations))
    # The cubic spline itself is off by less than 5 / 384 h^4 of the fourth derivative.
    spline = 5.0 / 384.0 * 0.05**4 * 0.002 * (np.pi / 2.0) ** 4
    assert np.max(np.abs(excitation.positions - wanted)) < bound + spline
    assert excitation.positions[-1] == pytest.approx(0.004, abs=1e-12)
    assert abs(excitation.velocities[-1]) < 1e-12
    np.testing.assert_allclose(recipe.displacement(np.array([-1.0, 0.0, 9.0])), [0.0, 0.0, 0.004], atol=1e-15)


@pytest.mark.parametrize(
    ("quantity", "times", "values", "words"),
    [
        ("speed", (0.0, 1.0), (0.0, 1.0), "quantity is 'speed'"),
        ("position", (0.0, 1.0), (0.0, 1.0, 2.0), "expected one for each of 2 times"),
        ("position", (0.0,), (0.0,), "at least two"),
        ("position", (0.0, 2.0, 1.0), (0.0, 1.0, 0.0), "1 s after a later one"),
        ("position", (0.0, 1.0), (2.0, 2.0), "all the same'; expected a motion"),
        ("position", (0.0, 1.0), (0.0, np.nan), "a finite number"),
        ("velocity", (0.0, 1.0), (0.0, 0.0), "zero throughout"),
        (
            "velocity",
            (0.0, 1.0, 2.0),
            (0.1, 1.0, 0.0),
            "0.1 m/s where it begins, at 0 s.*expected to begin and end at rest",
        ),
        ("acceleration", (0.0, 1.0, 2.0), (1.0, -0.5, -0.2), "0.3 m/s where it ends, at 3 s"),
    ],
)
def test_what_is_no_motion_from_rest_to_rest_is_refused(
    quantity: str, times: tuple[float, ...], values: tuple[float, ...], words: str
) -> None:
    with pytest.raises(ExcitationError, match=words):
        Trajectory(quantity, times, values)


@pytest.mark.parametrize(
    ("limits", "words"),
    [
        (AxisLimits(speed=0.05), "peak speed 0.1 m/s is above the limit of 0.05 m/s, first at 0.501 s"),
        (AxisLimits(travel=0.2), "peak travel 0.4 m is above the limit of 0.2 m, first at 2.5"),
        (
            AxisLimits(acceleration=1e-4),
            r"peak acceleration 0.1.*first at 0 s; .*is it in units a thousand times smaller",
        ),
    ],
)
def test_a_limit_is_named_with_the_time_at_which_it_is_left(limits: AxisLimits, words: str) -> None:
    recipe = Trajectory("velocity", (0.0, 1.0, 4.0, 5.0), (0.0, 0.1, 0.1, 0.0), still=0.0)
    with pytest.raises(ExcitationLimitError, match=words):
        recipe.sample(T, limits)
