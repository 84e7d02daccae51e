"""A mass on a guide against closed forms, and against steps a hundred times finer without any events."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from beam_ident.axis.hub_motion import GridForce, Guide, at_stamps, simulate_guide
from beam_ident.numerics.piecewise import Hold, PiecewisePolynomial

H = 1e-3


def force_on_grid(values: np.ndarray, hold: Hold = "zoh", period: float = H, delay: float = 0.0) -> GridForce:
    times = H * np.arange(len(values))
    signal = PiecewisePolynomial.from_samples(times, values, hold)
    once = signal.antiderivative()
    n = math.floor((signal.knots[-1] - signal.knots[0]) / period + 1e-9)
    return GridForce.of(signal, (once, once.antiderivative()), 0.0, period, n, delay)


def test_a_thrown_mass_comes_to_rest_where_its_energy_is_spent_and_stays() -> None:
    guide = Guide(mass=2.0, viscous_forward=0.0, viscous_backward=0.0, forward=3.0, backward=3.0)
    x, v = simulate_guide(guide, force_on_grid(np.zeros(1000)), 0, 1000, 0.1, 0.5)
    # m v^2 / 2 = F s, and m v = F t.
    assert x[-1] == pytest.approx(0.1 + 0.5 * 2.0 * 0.5**2 / 3.0, abs=1e-13)
    assert np.all(v[math.ceil(2.0 * 0.5 / 3.0 / H) :] == 0.0)


def test_viscous_friction_alone_is_an_exponential() -> None:
    guide = Guide(mass=0.05, viscous_forward=0.7, viscous_backward=0.7, forward=0.0, backward=0.0)
    x, v = simulate_guide(guide, force_on_grid(np.full(400, 0.3)), 0, 400, 0.0, 0.2)
    t, final, rate = H * np.arange(401), 0.3 / 0.7, 0.7 / 0.05
    assert v == pytest.approx(final + (0.2 - final) * np.exp(-rate * t), abs=1e-12)
    assert x == pytest.approx(final * t + (0.2 - final) * (1.0 - np.exp(-rate * t)) / rate, abs=1e-12)


def test_turns_and_rests_are_those_of_an_integrator_that_is_stopped_at_each_of_them() -> None:
    guide = Guide(mass=2.0, viscous_forward=3.0, viscous_backward=4.0, forward=2.5, backward=1.0)

    def pushes(t: float) -> float:
        return 8.0 * math.sin(8.2 * t) * math.sin(1.25 * t) + 1.0

    samples = np.array([pushes(H * k) for k in range(4001)])
    force = force_on_grid(samples, "cubic")
    x, v = simulate_guide(guide, force, 0, 4000, 0.0, 0.1)
    expected, held = integrated(guide, pushes, 4.0, 0.0, 0.1)
    # The force is a straight line over every step: of a sine that is h^2 f''/12 wide of the mark at most.
    assert np.max(np.abs(x - expected)) < 2e-9
    assert 0.02 < np.mean(v == 0.0) == pytest.approx(held, abs=0.005)


def integrated(guide: Guide, pushes, end: float, x: float, v: float) -> tuple[np.ndarray, float]:
    """Return positions by ``solve_ivp`` from event to event, and the share of the time at rest."""
    t, way, rested = 0.0, int(np.sign(v)), 0.0
    knots = np.arange(0.0, end + 0.5 * H, H)
    found = np.full(len(knots), x)
    while t < end:
        if way == 0:
            fine = np.arange(t, end, 1e-6)
            net = 8.0 * np.sin(8.2 * fine) * np.sin(1.25 * fine) + 1.0
            loose = np.flatnonzero((net > guide.forward) | (net < -guide.backward))
            until = float(fine[loose[0]]) if len(loose) else end
            found[(knots >= t) & (knots <= until)] = x
            rested += until - t
            if not len(loose):
                break
            t, way, v = until, 1 if net[loose[0]] > 0.0 else -1, 0.0
        drag = guide.viscous_forward if way > 0 else guide.viscous_backward
        dry = guide.forward if way > 0 else -guide.backward

        def slope(s, z, drag=drag, dry=dry):
            return [z[1], (pushes(s) - dry - drag * z[1]) / guide.mass]

        def stops(s, z, begin=t, way=way):
            return z[1] if s > begin + 1e-7 else 1e-9 * way

        stops.terminal, stops.direction = True, -way  # type: ignore[attr-defined]
        run = solve_ivp(
            slope, (t, end), [x, v], events=stops, rtol=1e-10, atol=1e-13, dense_output=True, max_step=0.02
        )
        inside = (knots >= t) & (knots <= run.t[-1])
        found[inside] = run.sol(knots[inside])[0]
        t, x, v = float(run.t[-1]), float(run.y[0, -1]), 0.0
        net = pushes(t)
        way = 1 if net > guide.forward else -1 if net < -guide.backward else 0
    return found, rested / end


def test_a_coarse_grid_keeps_the_forces_mean_and_moment_so_that_a_free_mass_is_exact_on_it() -> None:
    guide = Guide(mass=1.5, viscous_forward=0.0, viscous_backward=0.0, forward=0.0, backward=0.0)
    values = np.random.default_rng(1).standard_normal(400) + 2.0
    fine, _ = simulate_guide(guide, force_on_grid(values), 0, 400, 0.0, 0.0)
    coarse, _ = simulate_guide(guide, force_on_grid(values, period=5.0 * H), 0, 80, 0.0, 0.0)
    assert coarse == pytest.approx(fine[::5], abs=1e-14)


def test_a_delay_moves_the_force_and_nothing_else() -> None:
    guide = Guide(mass=1.5, viscous_forward=1.0, viscous_backward=1.0, forward=0.5, backward=0.5)
    values = np.concatenate([np.zeros(50), 3.0 * np.sin(0.03 * np.arange(600))])
    plain, _ = simulate_guide(guide, force_on_grid(values), 0, 650, 0.0, 0.0)
    late, _ = simulate_guide(guide, force_on_grid(values, delay=7.0 * H), 0, 650, 0.0, 0.0)
    assert late[7:] == pytest.approx(plain[:-7], abs=1e-12)


def test_positions_between_knots_are_exact_under_a_constant_force() -> None:
    guide = Guide(mass=1.0, viscous_forward=0.0, viscous_backward=0.0, forward=0.0, backward=0.0)
    x, v = simulate_guide(guide, force_on_grid(np.full(20, 2.0)), 0, 20, 0.0, 0.0)
    times = np.array([0.0, 0.00133, 0.0109, 0.02])
    assert at_stamps(x, v, 0.0, H, times) == pytest.approx(times**2, abs=1e-16)
