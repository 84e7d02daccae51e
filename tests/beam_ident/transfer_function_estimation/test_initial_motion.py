"""Records that begin in motion: found from the data, by every estimator of transfer functions."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lsim, max_len_seq

from beam_ident import (
    InputSignal,
    OutputSignal,
    TimeRecord,
    estimate_common_poles,
    estimate_transfer_function,
    select_transfer_function,
    subspace_model,
    validate,
)

NUMERATOR, DENOMINATOR = [40.0], [1.0, 0.6, 100.0]
PERIOD = 0.02
N = 1000


def record(seed: int, energy: float, noise: float = 0.03) -> TimeRecord:
    """Return two points of a system that begins with so many times the energy that the input gives it."""
    rng = np.random.default_rng(seed)
    drive = np.repeat(2.0 * max_len_seq(9)[0] - 1.0, 2)[:N]
    fine = PERIOD / 10 * np.arange(10 * N)
    held = np.repeat(drive, 10)
    _, forced, _ = lsim((NUMERATOR, DENOMINATOR), held, fine, interp=False)
    forced = forced[::10]
    times = fine[::10]
    phase = rng.uniform(0.0, 2.0 * np.pi)
    free = (
        np.sqrt(2.0 * energy) * np.std(forced) * np.exp(-0.3 * times) * np.cos(np.sqrt(99.91) * times + phase)
    )
    outputs = [
        OutputSignal(name, "m", times, gain * (forced + free) + noise * rng.standard_normal(N))
        for name, gain in (("a", 1.0), ("b", -0.5))
    ]
    return TimeRecord((InputSignal("u", "N", (0.0, PERIOD), drive, "zoh"),), tuple(outputs))


def worst(model: object) -> float:
    """Return the largest deviation of the denominator, in stated standard deviations."""
    found = np.array(model.denominator)[1:]  # type: ignore[attr-defined]
    return float(np.max(np.abs(found - DENOMINATOR[1:]) / model.standard_deviations[:2]))  # type: ignore[attr-defined]


@pytest.mark.parametrize("energy", [0.03, 1.0, 10.0])
@pytest.mark.parametrize("method", ["auto", "output_error", "rivc", "srivc"])
def test_motion_at_the_beginning_is_found_and_estimated_along(energy: float, method: str) -> None:
    found = estimate_transfer_function(record(1, energy), 2, 0, method, output_name="a")  # type: ignore[call-overload]
    assert found.initial_motion.is_estimated
    assert found.initial_motion.p_value < 1e-6
    assert any("began in motion" in said for said in found.warnings)
    assert worst(found.model) < 4.0


@pytest.mark.slow
def test_rest_is_taken_for_motion_as_rarely_as_is_stated() -> None:
    # 5 % of 60 are 3; more than 9 have a chance of 1e-3.
    estimates = [estimate_transfer_function(record(seed, 0.0), 2, 0, output_name="a") for seed in range(60)]
    assert sum(found.initial_motion.is_estimated for found in estimates) <= 9


def test_motion_that_is_left_out_by_request_is_named_and_biases() -> None:
    # Under the noise as it is, motion passes for a colour; without one it is a bias.
    found = estimate_transfer_function(
        record(2, 1.0), 2, 0, "white", output_name="a", has_free_response=False
    )
    assert not found.initial_motion.is_estimated
    assert "poles and damping ratios are biased" in found.warnings[0]
    along = estimate_transfer_function(record(2, 1.0), 2, 0, "white", output_name="a")
    wrong, right = (np.abs(one.model.denominator - DENOMINATOR)[2] for one in (found, along))
    assert wrong > 10.0 * right
    still = estimate_transfer_function(record(2, 0.0), 2, 0, output_name="a", has_free_response=False)
    assert not any("motion" in said for said in still.warnings)


@pytest.mark.slow
def test_common_poles_orders_and_subspaces_find_it_too() -> None:
    moving, still = record(3, 3.0), record(3, 0.0)
    found = estimate_common_poles(moving, 2, 0)
    assert "began in motion" in found.warnings[0]
    assert worst(found.models[0]) < 4.0
    assert not any("motion" in said for said in estimate_common_poles(still, 2, 0).warnings)
    chosen = select_transfer_function(moving.select(["a"]), (1, 2, 3), (0,)).chosen
    assert chosen.model.n_poles == 2
    assert chosen.initial_motion.is_estimated
    assert any("began in motion" in said for said in chosen.warnings)
    subspace = subspace_model(moving, 2)
    assert "began in motion" in subspace.warnings[0]
    assert subspace.scores[0].fit_percent > 90.0
    assert not any("motion" in said for said in subspace_model(still, 2).warnings)


def test_validation_gives_the_plain_simulation_beside_the_one_with_motion() -> None:
    model = estimate_transfer_function(record(4, 0.0), 2, 0, output_name="a").model
    rest, moving = (validate(model, record(5, energy)).outputs[0] for energy in (0.0, 10.0))
    assert rest.simulation_scores.fit_percent == pytest.approx(rest.scores.fit_percent, abs=0.5)
    assert moving.scores.fit_percent > 95.0
    # The free motion decays with 0.3 /s over 20 s: its mean power is 10/12 of the input's, unexplained from rest.
    assert moving.simulation_scores.fit_percent < 50.0
    assert f"{moving.simulation_scores.fit_percent:.2f} % simulated from rest" in moving.verdict


@pytest.mark.slow
def test_a_gap_splits_a_record_into_pieces_that_begin_in_motion() -> None:
    whole = record(6, 0.0)
    drive = whole.inputs[0]
    values = np.array(drive.values)
    values[300:330] = np.nan  # of a random sequence: nothing foretells it
    values[700] = np.nan
    lost = InputSignal("u", "N", drive.times_s, values, "zoh")
    damaged = TimeRecord((lost,), whole.outputs)
    found = estimate_transfer_function(damaged, 2, 0, output_name="a")
    assert "2 gaps (5.980-6.600 s, 13.980-14.020 s)" in found.warnings[0]
    assert len(found.records) == 3
    assert found.initial_motion.is_estimated
    assert worst(found.model) < 4.0
    assert worst(estimate_common_poles(damaged, 2, 0).models[0]) < 4.0
    assert subspace_model(damaged, 2).natural_frequencies == pytest.approx([10.0], rel=0.01)
