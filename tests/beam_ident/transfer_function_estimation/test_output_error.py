from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from beam_ident import (
    EstimationError,
    InputSignal,
    OutputSignal,
    Prior,
    TimeRecord,
    TransferFunctionModel,
    estimate_transfer_function,
)
from beam_ident.noise.scores import ScoreTest
from beam_ident.transfer_function_estimation.output_error import OutputErrorProblem
from beam_ident.transfer_function_estimation.record_share import Nuisances, Path, RecordShare, usable_samples
from beam_ident.transfer_function_estimation.srivc import are_known
from beam_ident.transfer_function_estimation.state_variable_filter import stable_coefficients
from benchmarks.ident.supersets import hard_record

RNG = np.random.default_rng(3)
DRIVES = (
    InputSignal("held", "", (0.0, 0.05), RNG.standard_normal(200), "zoh"),
    InputSignal("joined", "", np.sort(RNG.uniform(-1.0, 11.0, 90)), RNG.standard_normal(90), "cubic"),
)
FIRST, SECOND = [1.0, 0.6, 36.0], [1.0, 1.2, 400.0]
RESONANCES = TransferFunctionModel(
    np.polyadd(36.0 * np.array(SECOND), 400.0 * np.array(FIRST)),
    np.polymul(FIRST, SECOND),
    0.0,
    np.zeros((8, 8)),
    1.0,
    "u",
    "y",
)
STAMPS = np.sort(RNG.uniform(0.4, 9.6, 150))


def problem(
    own_poles: bool = True,
    exposure_s: float = 0.0,
    n_integrators: int = 0,
    delay: Prior | None = None,
    several: bool = False,
) -> OutputErrorProblem:
    nuisances = Nuisances(True, True, True)
    delay = delay or Prior(0.0, np.inf)
    paths = tuple(
        Path.of(drive, m, block if own_poles else 0, delay, n_integrators, 0.2)
        for block, (drive, m) in enumerate(zip(DRIVES, (1, 2), strict=True))
    )
    values = np.sin(3.0 * STAMPS) + 0.3 * STAMPS + RNG.standard_normal(len(STAMPS))
    experiments = [RecordShare("record", paths, STAMPS, values, exposure_s)]
    if several:  # the same inputs, another clock
        later = np.sort(np.random.default_rng(7).uniform(0.4, 9.6, 80))
        experiments.append(RecordShare("second", paths, later, np.cos(2.0 * later) + 1.0, exposure_s))
    return OutputErrorProblem(experiments, (2, 3) if own_poles else (3,), nuisances)


def a_point(case: OutputErrorProblem) -> np.ndarray:
    case.scale = 4.0
    polynomials = [np.poly([-0.3 + 1j, -0.3 - 1j])[1:], np.poly([-0.2 + 2j, -0.2 - 2j, -0.8])[1:]]
    chosen = polynomials if len(case.orders) == 2 else polynomials[1:]
    return np.concatenate([*(np.real(a) for a in chosen), [0.123, 0.31]])


@pytest.mark.parametrize("own_poles", [True, False])
@pytest.mark.parametrize("exposure_s", [0.0, 0.03])
@pytest.mark.parametrize("n_integrators", [0, 1, 2])
def test_the_gradient_is_that_of_the_model_in_every_denominator_and_delay(
    own_poles, exposure_s, n_integrators
):
    case = problem(own_poles, exposure_s, n_integrators)
    theta = a_point(case)
    state = case.state(theta)
    found = case.jacobian(state)
    for i in range(len(theta)):
        step = np.zeros_like(theta)
        step[i] = 1e-6
        ahead, behind = case.point(theta + step).matrix, case.point(theta - step).matrix
        expected = (ahead - behind) @ state.coefficients / 2e-6
        if (
            i == case.n_a and exposure_s == 0.0
        ):  # a held input jumps where a stamp crosses its knot: leave those out
            odd = np.abs((STAMPS - theta[i]) / 0.05 - np.round((STAMPS - theta[i]) / 0.05)) < 1e-3
            expected, column = expected[~odd], found[~odd, i]
        else:
            column = found[:, i]
        np.testing.assert_allclose(column, expected, atol=2e-6 * max(np.max(np.abs(expected)), 1.0))


def test_the_slope_is_the_gradient_of_the_cost_priors_included():
    case = problem(own_poles=False, delay=Prior(0.1, 0.05))
    theta = a_point(case)
    _, direction = case.slope(case.state(theta))
    for i in range(len(theta)):
        step = np.zeros_like(theta)
        step[i] = 1e-6
        numeric = (case.state(theta + step).cost - case.state(theta - step).cost) / 2e-6
        assert -direction[i] == pytest.approx(numeric, rel=2e-3, abs=1e-2)


def test_points_that_are_not_allowed_have_infinite_cost():
    case = problem(own_poles=False)
    theta = a_point(case)
    for bad in (-theta, np.full_like(theta, np.nan), theta * np.array([1, 1, 1, -10.0, 1])):
        assert case.state(bad).cost == np.inf


def test_a_step_moves_a_delay_by_one_sample_at_most():
    case = problem()
    theta = a_point(case)
    moved = case.limited(theta, np.full_like(theta, 10.0))
    np.testing.assert_allclose(moved[case.n_a :] - theta[case.n_a :], case.period)


def test_samples_count_where_every_input_is_known():
    output = OutputSignal(
        "y", "", np.array([-0.5, 0.0, 5.0, 9.99, 10.5]), np.array([1.0, 2, np.nan, 4, 5]), 0.01
    )
    np.testing.assert_array_equal(usable_samples(output, list(DRIVES)), [False, False, False, True, False])


@pytest.mark.parametrize(("delay", "earliest_s"), [(Prior(0.2), 0.22), (Prior(0.2, 0.05), 0.02)])
def test_samples_whose_exposure_reaches_into_an_unknown_past_do_not_count(delay, earliest_s):
    # The input is known from 0 s on and comes 0.2 s late; every stamp is exposed 20 ms before and after.
    # A delay that is still to be found costs nothing yet: the estimator leaves samples out once it has found it.
    output = OutputSignal("y", "", earliest_s + np.array([-0.019, -0.001, 0.001, 0.5]), np.arange(4.0), 0.04)
    record = TimeRecord((DRIVES[0],), (output,))

    def stamps(is_past_unknown):
        return RecordShare.of(record, "y", ["held"], [1], [0], [delay], 0, is_past_unknown).times

    np.testing.assert_array_equal(stamps(True), output.times_s[2:])
    np.testing.assert_array_equal(stamps(False), output.times_s[output.times_s > 0.02])


def test_too_few_samples_are_refused_with_their_number():
    case = problem()
    with pytest.raises(EstimationError, match="15 usable samples"):
        OutputErrorProblem(
            [RecordShare("short", case.paths, STAMPS[:15], case.values[:15], 0.0)], (2, 3), Nuisances()
        )
    long, short = case.experiments[0], RecordShare("short", case.paths, STAMPS[:15], case.values[:15], 0.0)
    with pytest.raises(EstimationError, match="15 usable samples in record 'short'"):
        OutputErrorProblem([long, short], (2, 3), Nuisances())


def test_unstable_roots_are_mirrored_and_stable_ones_left_as_they_are():
    np.testing.assert_array_equal(stable_coefficients(np.array([3.0, 2.0])), [3.0, 2.0])
    # (s - 1)(s + 2) becomes (s + 1)(s + 2).
    np.testing.assert_allclose(stable_coefficients(np.array([1.0, -2.0])), [3.0, 2.0], rtol=1e-12)


WORSE_WITHOUT = {  # of seed, degrees and terms: what the larger structure had more of -2 log-likelihood once
    "pole hardly known": (8, (1, 0), (2, 0), {}),
    "zero": (0, (2, 0), (3, 1), {}),
    "wrong resonance": (26, (1, 0), (2, 0), {"has_offset": True}),  # 98
    "wrong delay": (49, (2, 0), (2, 0), {"has_offset": True}, {"delay": "estimate"}),  # 365
    "delay of a finite prior": (49, (2, 0), (2, 0), {"has_offset": True}, {"delay": Prior(0.0, 1.0)}),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", WORSE_WITHOUT)
def test_a_structure_never_ends_in_a_worse_optimum_than_one_inside_it(case):
    seed, small, large, terms, *more = WORSE_WITHOUT[case]
    record = hard_record(seed)
    asked = {"method": "white", "has_free_response": False, **terms}
    squares = [
        np.sum(np.square(estimate_transfer_function(record, *degrees, **{**asked, **terms}).residuals))
        for degrees, terms in ((small, {}), (large, more[0] if more else {}))
    ]
    assert squares[1] <= squares[0] * (1.0 + 1e-6)


@pytest.mark.parametrize(("n_poles", "is_whole"), [(4, True), (2, False)])
def test_what_follows_the_input_in_residuals_is_told_from_noise_of_a_colour(n_poles, is_whole):
    p_values = []
    for seed in range(40):
        rng = np.random.default_rng([seed, 3])
        times = 0.02 * np.arange(500)
        drive = InputSignal("u", "N", times, np.sign(rng.standard_normal(50)).repeat(10), "zoh")
        colour = lfilter([1.0], [1.0, -0.9], rng.standard_normal(1000))[500:]
        true = RESONANCES.simulate(drive, times)
        record = TimeRecord((drive,), (OutputSignal("y", "m", times, true + 0.1 * np.std(true) * colour),))
        share = RecordShare.of(record, "y", ["u"], [2], [0], [Prior(0.0)], 0, False)
        problem = OutputErrorProblem([share], (n_poles,), Nuisances())
        problem.scale = 10.0
        poles = np.sort_complex(RESONANCES.poles)[-n_poles:]
        theta = np.real(np.poly(poles / problem.scale))[1:]
        p_values.append(ScoreTest.of([problem.followed_inputs(problem.state(theta))]).p_value)
    if is_whole:
        assert np.sum(np.array(p_values) < 0.01) <= 2, p_values
        assert np.mean(p_values) == pytest.approx(0.5, abs=0.15)
    else:
        assert max(p_values) < 1e-3


@pytest.mark.parametrize(("zeta", "is_enough"), [(1e-4, False), (1e-2, True)])
def test_a_pole_that_may_not_decay_is_hardly_known(zeta, is_enough):
    case = problem(own_poles=False)
    theta = np.polymul([1.0, 2.0 * zeta, 1.0], [1.0, 1.0])[1:]
    assert are_known(case, theta, np.eye(3) / 1e-3**2) == is_enough
