from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from beam_model import BeamModel, BeamParameterError, Damping
from beam_model.galerkin.compiled import compiled_pairs, step_pairs
from beam_model.galerkin.stepping import _pairs
from tests.beam_model.rigs import strip

PERIOD = 1e-3
DAMPED = Damping(ratios=(0.005,))


def held(values: np.ndarray, t: float) -> float:
    return float(values[min(int(t / PERIOD * (1.0 + 1e-12)), values.size - 1)])


@pytest.mark.parametrize(
    "damping", [DAMPED, Damping(ratios=(0.005,), viscous=0.05, air=0.1, internal=1e-5)], ids=["ratios", "all"]
)
def test_motion_steps_equal_a_fine_integration(damping: Damping) -> None:
    model = BeamModel(strip(gravity="upright", damping=damping, tip_mass=2e-3), 5)
    a = np.random.default_rng(1).standard_normal(60)
    stepper = model.motion_stepper(PERIOD)
    C, K = model.matrices.C / model.basis.modal_mass, model.matrices.K / model.basis.modal_mass
    gamma = model.participation_factors

    state = np.zeros(11)
    for value in a:

        def slope(_: float, x: np.ndarray, value: float = value) -> np.ndarray:
            q, rate, velocity = x[:5], x[5:10], x[10]
            force = -C[1:, 1:] @ rate - K[1:, 1:] @ q - C[1:, 0] * velocity - gamma * value
            return np.concatenate([rate, force, [value]])

        state = solve_ivp(slope, (0.0, PERIOD), state, method="DOP853", rtol=1e-12, atol=1e-15).y[:, -1]
        stepper.step(value)
    assert stepper.state[:5] == pytest.approx(state[:5], rel=1e-8, abs=1e-8 * np.abs(state[:5]).max())
    assert stepper.state[5:] == pytest.approx(state[5:10], rel=1e-8, abs=1e-8 * np.abs(state[5:10]).max())


def test_force_steps_equal_a_fine_integration() -> None:
    model = BeamModel(strip(gravity="upright", damping=DAMPED), 5)
    f = np.random.default_rng(2).standard_normal(60)
    stepper = model.force_stepper(PERIOD)
    A, B = model.matrices.state_space()
    state = np.zeros(12)
    for value in f:
        state = solve_ivp(
            lambda _, x, value=value: A @ x + B * value,
            (0.0, PERIOD),
            state,
            method="DOP853",
            rtol=1e-12,
            atol=1e-16,
        ).y[:, -1]
        stepper.step(value)
    assert stepper.state == pytest.approx(state, rel=1e-8, abs=1e-9 * np.abs(state).max())


@pytest.mark.parametrize("drive", ["motion", "force"])
def test_halving_the_period_changes_nothing(drive: str) -> None:
    model = BeamModel(strip(gravity="upright", damping=DAMPED), 5)
    values = np.random.default_rng(3).standard_normal(500)
    make = model.motion_stepper if drive == "motion" else model.force_stepper
    whole, half = make(PERIOD), make(PERIOD / 2)
    for value in values:
        whole.step(value)
        half.step(value)
        half.step(value)
    assert np.abs(whole.state - half.state).max() < 1e-11 * np.abs(whole.state).max()


@pytest.mark.parametrize("drive", ["motion", "force"])
def test_a_whole_record_equals_single_steps(drive: str) -> None:
    model = BeamModel(strip(gravity="upright", damping=Damping(ratios=(0.005,), air=0.1, internal=1e-5)), 5)
    values = np.random.default_rng(4).standard_normal(1000)
    make = model.motion_stepper if drive == "motion" else model.force_stepper
    single, whole = make(PERIOD), make(PERIOD)
    single.step(1.0)
    whole.step(1.0)
    steps = [single.state.copy()]
    for value in values:
        single.step(value)
        steps.append(single.state.copy())
    scale = np.abs(np.array(steps)).max(axis=0)
    assert np.abs((whole.run(values) - np.array(steps)) / scale).max() < 1e-11
    assert np.abs((whole.state - single.state) / scale).max() < 1e-11


@pytest.mark.parametrize("drive", ["motion", "force"])
def test_coordinates_inside_a_tick_meet_the_next_tick_and_change_nothing(drive: str) -> None:
    model = BeamModel(strip(gravity="upright", damping=DAMPED), 5)
    # A tick of 20 ms is five periods of the fifth mode: the series must cut it into pieces.
    for period in (PERIOD, 0.02):
        stepper = model.motion_stepper(period) if drive == "motion" else model.force_stepper(period)
        for value in (1.0, -2.0, 0.5):
            stepper.step(value)
        before = stepper.state.copy()
        taus = np.array([0.0, 0.3, 0.7, 1.0]) * period
        found = stepper.coordinates(taus, 0.8)
        single = [stepper.coordinates(float(tau), 0.8) for tau in taus]
        q = found if drive == "motion" else found[1]
        singles = np.array(single if drive == "motion" else [pair[1] for pair in single])
        assert q == pytest.approx(singles, rel=1e-12, abs=1e-15)
        assert np.array_equal(stepper.state, before)
        offset = 0 if drive == "motion" else 1
        assert q[0] == pytest.approx(before[offset : offset + 5], rel=1e-13)
        stepper.step(0.8)
        assert q[-1] == pytest.approx(stepper.state[offset : offset + 5], rel=1e-11, abs=1e-15)


def test_prescribed_acceleration_and_the_force_that_makes_it_agree() -> None:
    model = BeamModel(strip(gravity="upright", damping=DAMPED), 5)
    stepper = model.force_stepper(1e-5)
    motion = model.motion_stepper(1e-5)
    for _ in range(2000):
        now = stepper.motion(5e-6, 0.3)
        motion.step(float(now.acceleration))
        stepper.step(0.3)
    # The acceleration is held at its midpoint: right to (omega dt)^2 / 24.
    assert motion.state[:5] == pytest.approx(stepper.state[1:6], rel=1e-5, abs=1e-6 * np.abs(motion.state[0]))


def test_a_kick_is_a_short_push() -> None:
    model = BeamModel(strip(gravity="upright", damping=Damping(ratios=(0.005,), air=0.1)), 5)
    kicked, pushed = model.motion_stepper(PERIOD), model.motion_stepper(1e-9)
    kicked.kick(0.2)
    pushed.step(0.2 / 1e-9)
    after = model.motion_stepper(PERIOD)
    after.kick(0.2)
    assert kicked.state[5:] == pytest.approx(pushed.state[5:], rel=1e-6)
    kicked.step(0.0)
    q = after.coordinates(PERIOD, 0.0)
    assert kicked.state[:5] == pytest.approx(q, rel=1e-11)


def test_the_left_out_modes_follow_internal_damping_with_a_lag() -> None:
    eta = 2e-3
    model = BeamModel(strip(damping=Damping(internal=eta)), 3)
    stepper = model.motion_stepper(PERIOD)
    assert stepper.residual_acceleration(PERIOD, 1.0) == pytest.approx(1.0 - np.exp(-PERIOD / eta), rel=1e-12)
    plain = BeamModel(strip(), 3).motion_stepper(PERIOD)
    assert plain.residual_acceleration(0.0, 1.0) == 1.0
    assert plain.residual_acceleration(np.zeros(3), 1.0).shape == (3,)


def test_undamped_energy_is_kept() -> None:
    model = BeamModel(strip(gravity="upright"), 5)
    stepper = model.motion_stepper(PERIOD)
    stepper.kick(0.1)

    def energy(state: np.ndarray) -> np.ndarray:
        q, rate = state[..., :5], state[..., 5:]
        return np.sum(rate**2 + (model.basis.natural_frequencies * q) ** 2, axis=-1)

    start = energy(stepper.state)
    for _ in range(20_000):
        stepper.step(0.0)
    # 1e-9 over a million steps (tests marked verify) is 2e-11 over these.
    assert abs(energy(stepper.state) / start - 1.0) < 2e-11


@pytest.mark.parametrize("drive", ["motion", "force"])
def test_a_first_order_hold_is_a_fine_staircase(drive: str) -> None:
    model = BeamModel(strip(gravity="upright", damping=DAMPED), 5)
    values = np.random.default_rng(5).standard_normal(70)
    make = model.motion_stepper if drive == "motion" else model.force_stepper
    n_fine = 1000
    fine = make(PERIOD / n_fine)
    middles = (np.arange(n_fine) + 0.5) / n_fine
    stairs = values[:-1, None] + middles * np.diff(values)[:, None]
    expected = fine.run(stairs.ravel())[::n_fine]
    scale = np.abs(expected).max(axis=0)
    found = make(PERIOD)
    # The staircase errs by 1 / (24 n_fine^2) of a second difference.
    assert np.abs((found.run(values, "foh") - expected) / scale).max() < 1e-6
    single = make(PERIOD)
    for start, end in pairwise(values):
        single.step_linear(start, end)
    assert np.abs((single.state - found.state) / scale).max() < 1e-11


@pytest.mark.parametrize("drive", ["motion", "force"])
@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_irregular_times_meet_the_regular_ones(drive: str, hold: str) -> None:
    model = BeamModel(strip(gravity="upright", damping=Damping(ratios=(0.005,), air=0.1)), 5)
    rng = np.random.default_rng(6)
    values = rng.standard_normal(40)
    make = model.motion_stepper if drive == "motion" else model.force_stepper
    times = np.arange(40) * PERIOD
    regular = make(PERIOD).run(values if hold == "foh" else values[:-1], hold)
    scale = np.abs(regular).max(axis=0)
    assert np.abs((make(PERIOD).run_at(times, values, hold) - regular) / scale).max() < 1e-11
    # Extra samples on the same input, at irregular times, change nothing.
    extra = np.sort(rng.uniform(0.0, times[-1], 25))
    both = np.concatenate([times, extra])
    order = np.argsort(both)
    index = np.searchsorted(times, extra, side="right") - 1
    between = np.interp(extra, times, values) if hold == "foh" else values[index]
    found = make(PERIOD).run_at(both[order], np.concatenate([values, between])[order], hold)
    assert np.abs((found[np.argsort(order)[:40]] - regular) / scale).max() < 1e-11


@pytest.mark.verify
def test_undamped_energy_is_kept_over_a_million_steps() -> None:
    model = BeamModel(strip(gravity="upright"), 5)
    stepper = model.motion_stepper(PERIOD)
    stepper.kick(0.1)
    omega = model.basis.natural_frequencies

    def energy(state: np.ndarray) -> np.ndarray:
        return np.sum(state[..., 5:] ** 2 + (omega * state[..., :5]) ** 2, axis=-1)

    start = energy(stepper.state)
    for _ in range(1_000_000):
        stepper.step(0.0)
    assert abs(energy(stepper.state) / start - 1.0) < 1e-9


@pytest.mark.verify
@pytest.mark.parametrize("hub_mass", [0.8, 0.03])
def test_energy_of_hub_and_beam_is_kept_over_a_million_steps(hub_mass: float) -> None:
    model = BeamModel(strip(gravity="upright", hub_mass=hub_mass), 5)
    stepper = model.force_stepper(PERIOD)
    stepper.state[:6] = [0.0, 1e-3, 1e-4, 1e-5, 1e-5, 1e-6]
    M, K = model.matrices.M, model.matrices.K

    def energy(state: np.ndarray) -> float:
        return float(state[6:] @ M @ state[6:] + state[:6] @ K @ state[:6])

    start = energy(stepper.state)
    for _ in range(1_000_000):
        stepper.step(0.0)
    assert abs(energy(stepper.state) / start - 1.0) < 1e-9


def test_bad_records_are_refused() -> None:
    stepper = BeamModel(strip(), 2).motion_stepper(PERIOD)
    with pytest.raises(BeamParameterError, match="hold"):
        stepper.run(np.ones(3), "cubic")
    with pytest.raises(BeamParameterError, match="increasing"):
        stepper.run_at(np.array([0.0, 1.0, 1.0]), np.ones(3))
    with pytest.raises(BeamParameterError, match="one time for each"):
        stepper.run_at(np.array([0.0, 1.0]), np.ones(3))
    with pytest.raises(BeamParameterError, match="at least"):
        stepper.run(np.empty(0), "foh")


@pytest.mark.parametrize("period", [0.0, -1e-3, np.nan])
def test_a_bad_period_is_refused(period: float) -> None:
    with pytest.raises(BeamParameterError, match="period"):
        BeamModel(strip(), 2).motion_stepper(period)


@pytest.mark.parametrize("drive", ["motion", "force"])
@pytest.mark.parametrize("n_ticks", [1, 15, 16, 257, 1024, 1500])
def test_a_whole_record_is_what_its_ticks_make_one_by_one(drive: str, n_ticks: int) -> None:
    model = BeamModel(strip(gravity="upright", damping=DAMPED), 3)
    values = np.random.default_rng(n_ticks).standard_normal(n_ticks)
    whole, single = (getattr(model, f"{drive}_stepper")(PERIOD) for _ in range(2))
    for stepper in (whole, single):
        stepper.step(1.0)
    found = whole.run(values)
    for value in values:
        single.step(value)
    scale = np.abs(found).max(axis=0)
    np.testing.assert_allclose(found[-1] / scale, single.state / scale, atol=1e-11)
    np.testing.assert_array_equal(whole.state, found[-1])


def test_a_loop_over_pairs_gives_what_blocks_give() -> None:
    stepper = BeamModel(strip(gravity="upright", damping=DAMPED), 4).motion_stepper(PERIOD)
    values = np.random.default_rng(3).standard_normal(700)
    expected = stepper.run(values)
    transition, effect = stepper.tick_matrices
    blocks = _pairs(transition)
    assert blocks is not None
    states = np.zeros_like(expected)
    step_pairs(blocks, effect.reshape(2, -1).copy(), values, states)
    np.testing.assert_allclose(states, expected, atol=1e-12 * np.abs(expected).max())
    compiled = compiled_pairs()
    if compiled is not None:
        again = np.zeros_like(expected)
        compiled(blocks, effect.reshape(2, -1).copy(), values, again)
        np.testing.assert_allclose(again, states, atol=1e-14 * np.abs(expected).max())


def test_modes_that_air_couples_are_no_pairs() -> None:
    coupled = BeamModel(strip(damping=Damping(ratios=(0.005,), air=0.1)), 3).motion_stepper(PERIOD)
    assert _pairs(coupled.tick_matrices[0]) is None
    force = BeamModel(strip(damping=DAMPED), 3).force_stepper(PERIOD)
    assert _pairs(force.tick_matrices[0]) is None


def test_a_long_record_is_stepped_like_its_two_halves() -> None:
    model = BeamModel(strip(gravity="upright", damping=DAMPED), 2)
    values = np.random.default_rng(1).standard_normal(30_000)
    whole, halves = model.motion_stepper(PERIOD), model.motion_stepper(PERIOD)
    found = whole.run(values)  # long enough for compiled code where there is such; a half is not
    expected = np.concatenate([halves.run(values[:15_000]), halves.run(values[15_000:])[1:]])
    np.testing.assert_allclose(found, expected, atol=1e-11 * np.abs(expected).max())
