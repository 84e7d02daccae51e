"""Two masses with a spring between them against closed forms, and against ``solve_ivp`` from event to event."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from beam_ident.axis.compliant_motion import DriveSpring, TwoMotions, simulate_compliant
from beam_ident.axis.hub_motion import Guide, simulate_guide
from tests.beam_ident.axis.test_hub_motion import H, force_on_grid

FREE = Guide(mass=0.8, viscous_forward=0.0, viscous_backward=0.0, forward=0.0, backward=0.0)


def moved(guide: Guide, spring: DriveSpring, force, n: int, start=(0.0, 0.0, 0.0), load=None) -> TwoMotions:
    return simulate_compliant(guide, spring, force_on_grid(force), load, (0, n), start)


def test_a_released_spring_swings_about_the_centre_of_mass_at_its_resonance() -> None:
    spring = DriveSpring(mass=0.2, stiffness=4000.0, damping=0.0)
    run = moved(FREE, spring, np.zeros(1000), 999, (0.3, 1e-3, 0.0))
    t, omega = H * np.arange(1000), math.sqrt(4000.0 * (1.0 / 0.8 + 1.0 / 0.2))
    # The centre goes on at (0.8 * 0.3 + 0.2 * 0.3) / 1.0 from where it was, 0.2 * 1e-3 ahead of the hub.
    centre = 0.2e-3 + 0.3 * t
    deflection = 1e-3 * np.cos(omega * t)
    assert run.hub == pytest.approx(centre - 0.2 * deflection, abs=1e-12)
    assert run.drive == pytest.approx(centre + 0.8 * deflection, abs=1e-12)


def test_a_stiff_spring_makes_one_mass_of_two() -> None:
    whole = Guide(mass=1.0, viscous_forward=2.0, viscous_backward=3.0, forward=0.6, backward=0.4)
    hub = Guide(mass=0.8, viscous_forward=2.0, viscous_backward=3.0, forward=0.6, backward=0.4)
    t = H * np.arange(2000)
    force = 2.0 * np.sin(7.0 * t) + 0.3
    x, _ = simulate_guide(whole, force_on_grid(force), 0, 1999, 0.0, 0.0)
    run = moved(hub, DriveSpring(0.2, 2e6, 200.0), force, 1999)
    assert np.max(np.abs(run.hub - x)) < 2e-5 * np.ptp(x)
    # The spring is 5e-7 m/N: the drive is ahead by at most 2.6 N of it.
    assert np.max(np.abs(run.drive - run.hub)) < 1.5e-6


@pytest.mark.first_case
@pytest.mark.parametrize("stiffness", [300.0, 2e4, 4e5])
def test_turns_and_rests_are_those_of_an_integrator_that_is_stopped_at_each_of_them(stiffness: float) -> None:
    guide = Guide(mass=0.8, viscous_forward=1.5, viscous_backward=0.5, forward=0.9, backward=0.5)
    spring = DriveSpring(0.4, stiffness, 0.05 * math.sqrt(stiffness))
    n = 700
    t = H * np.arange(n + 1)
    force = 2.5 * np.sin(9.0 * t) * np.sin(2.2 * t) + 0.2
    load = 0.3 * np.sin(25.0 * t)
    run = moved(guide, spring, force, n, (0.05, 0.1 / stiffness, 0.0), load)
    hub, drive = integrated(guide, spring, force, load, (0.05, 0.1 / stiffness))
    assert np.any(run.hub_velocity == 0.0)
    assert np.max(np.abs(run.hub - hub)) < 1e-9
    assert np.max(np.abs(run.drive - drive)) < 1e-9


def integrated(guide: Guide, spring: DriveSpring, force, load, start) -> tuple[np.ndarray, np.ndarray]:
    """Return hub and drive by ``solve_ivp``, step by step under a held force, from event to event."""
    k, d = spring.stiffness, spring.damping
    state, way, found = np.array([0.0, start[0], start[1], start[0]]), 1, []

    def tension(y: np.ndarray) -> float:
        return k * (y[2] - y[0]) + d * (y[3] - y[1])

    for j in range(len(force) - 1):
        found.append(state)
        done = 0.0
        for _ in range(20):

            def push(s: float, j: int = j) -> float:
                return load[j] + (load[j + 1] - load[j]) * s / H

            def rates(s: float, y: np.ndarray, j: int = j, way: int = way, push=push) -> list[float]:
                T = tension(y)
                a = 0.0
                if way:
                    a = (T + push(s) - guide.viscous(way) * y[1] - guide.resistance(way)) / guide.mass
                return [y[1] if way else 0.0, a, y[3], (force[j] - T) / spring.mass]

            def event(s: float, y: np.ndarray, way: int = way, push=push, begin: float = done) -> float:
                if way:
                    return way * y[1] + (1e-13 if s == begin else 0.0)
                pull = tension(y) + push(s)
                return min(guide.forward - pull, pull + guide.backward)

            event.terminal, event.direction = True, -1.0
            one = solve_ivp(rates, (done, H), state, rtol=1e-10, atol=1e-14, events=event)
            state, done = one.y[:, -1].copy(), float(one.t[-1])
            if one.status != 1:
                break
            state[1] = 0.0
            pull = tension(state) + push(done)
            was_held = way == 0
            way = 1 if pull > guide.forward - 1e-9 * was_held else 0
            if not way and pull < -guide.backward + 1e-9 * was_held:
                way = -1
    found.append(state)
    return np.array(found)[:, 0], np.array(found)[:, 2]
