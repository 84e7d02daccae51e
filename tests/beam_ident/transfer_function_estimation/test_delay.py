from __future__ import annotations

import numpy as np
import pytest

from beam_ident import (
    EstimationError,
    InputSignal,
    OutputSignal,
    Prior,
    TimeRecord,
    estimate_transfer_function,
)
from beam_ident.transfer_function.model import TransferFunctionModel
from beam_ident.transfer_function_estimation.delay_search import delay_profile
from beam_ident.transfer_function_estimation.output_error import OutputErrorProblem
from beam_ident.transfer_function_estimation.record_share import Nuisances, Path, RecordShare
from beam_ident.transfer_function_estimation.srivc import _Chain, portfolio
from benchmarks.ident.delay import DelayedBeam, DoublePole, LateBeam
from tests.beam_ident.rao_garnier import PERIOD_S, noise_level, prbs

SECOND_ORDER = (np.array([3.0, 90.0]), np.array([1.0, 2.0, 81.0]))


def late_record(
    delay: float, hold: str = "zoh", start_s: float = 0.0, jitter: float = 0.0, snr_db: float = 20.0
) -> TimeRecord:
    rng = np.random.default_rng(8)
    drive = InputSignal("u", "", (0.0, PERIOD_S), prbs(1500, width=5), hold)
    model = TransferFunctionModel(*SECOND_ORDER, delay, np.zeros((5, 5)), 0.0)
    stamps = PERIOD_S * (np.arange(1, 1490) + jitter * rng.uniform(-0.5, 0.5, 1489))
    clean = model.simulate(drive, stamps)
    noisy = clean + noise_level(clean, snr_db) * rng.standard_normal(len(clean))
    record = TimeRecord((drive,), (OutputSignal("y", "", stamps, noisy),))
    return record if start_s == 0.0 else record.between(start_s, 100.0)


def scores(model: TransferFunctionModel, delay: float) -> np.ndarray:
    truth = np.concatenate([SECOND_ORDER[1][1:], SECOND_ORDER[0], [delay]])
    return (model.parameters - truth) / model.standard_deviations


@pytest.mark.slow
def test_a_double_pole_behind_eight_seconds_is_found_without_a_hint():
    case = DoublePole()
    for seed in range(3):
        model = case.estimate(case.record(seed))
        z = (model.parameters - case.truth) / model.standard_deviations
        assert np.all(np.isfinite(model.covariance))
        assert np.max(np.abs(z)) < 3.3


@pytest.mark.slow
def test_a_fraction_of_a_sample_is_resolved_on_the_beam():
    case = DelayedBeam()
    model = case.estimate(case.record(0))
    assert abs(model.delay - 7.3e-3) < 3.3 * model.standard_deviations[-1]
    assert model.standard_deviations[-1] < 3e-5


@pytest.mark.slow
def test_a_numerator_that_makes_up_for_a_wrong_delay_is_seen_through():
    # In this record the first start ends 9 ms late, in a local optimum with white residuals.
    case = DelayedBeam()
    model = case.estimate(case.record(105))
    assert abs(model.delay - 7.3e-3) < 4.0 * model.standard_deviations[-1]


def test_two_points_with_common_modes_know_the_delay_five_times_better():
    found = LateBeam().identify(0)
    assert abs(found.latency - 7.3e-3) < min(3.3 * found.latency_sd, 5e-5)
    assert found.latency_sd < 6e-6


@pytest.mark.first_case
@pytest.mark.parametrize("hold", ["zoh", "linear", "cubic"])
@pytest.mark.parametrize("jitter", [0.0, 0.8])
def test_delays_are_estimated_under_every_hold_at_irregular_stamps(hold, jitter):
    model = estimate_transfer_function(late_record(0.2537, hold, jitter=jitter), 2, 1, delay="estimate").model
    assert np.max(np.abs(scores(model, 0.2537))) < 4.0
    assert model.standard_deviations[-1] < 0.15 * PERIOD_S


def test_no_delay_is_not_taken_for_one():
    model = estimate_transfer_function(late_record(0.0), 2, 1, delay=Prior(0.0, np.inf)).model
    assert np.max(np.abs(scores(model, 0.0))) < 4.0


@pytest.mark.slow
def test_knowledge_of_the_delay_narrows_its_interval():
    free = estimate_transfer_function(late_record(0.25, snr_db=0.0), 2, 1, delay="estimate").model
    known = Prior(0.25, 0.2 * free.standard_deviations[-1])
    narrow = estimate_transfer_function(late_record(0.25, snr_db=0.0), 2, 1, delay=known).model
    assert narrow.standard_deviations[-1] == pytest.approx(known.sd, rel=0.03)
    assert abs(narrow.delay - 0.25) < abs(free.delay - 0.25)


@pytest.mark.slow
def test_a_record_that_begins_in_motion_loses_the_samples_of_an_unknown_past():
    record = late_record(0.25, start_s=3.0)
    found = estimate_transfer_function(record, 2, 1, delay="estimate", has_free_response=True)
    assert np.max(np.abs(scores(found.model, 0.25))) < 4.0
    assert found.times_s[0] > record.outputs[0].times_s[0] + 0.25
    without = estimate_transfer_function(record, 2, 1, delay="estimate", has_free_response=False)
    assert without.scores.fit_percent < found.scores.fit_percent


def late_problem() -> OutputErrorProblem:
    record = late_record(0.2537, snr_db=30.0)
    path = Path.of(record.inputs[0], 1, 0, Prior(0.0, np.inf), 0, 0.02)
    output = record.outputs[0]
    experiment = RecordShare("record", (path,), output.times_s, output.values, 0.0)
    return OutputErrorProblem([experiment], (2,), Nuisances())


def test_a_subspace_starts_at_the_most_promising_delay():
    problem = late_problem()
    chain = _Chain(problem, "auto", portfolio(problem), [np.array([0.25]), np.array([2.0])], 1)
    start = min(chain._subspace_starts(), key=lambda state: state.cost)
    assert start.theta[-1] == 0.25
    # Which is right to 0.004 s, a hundredth of a radian of the mode.
    poles = np.sort_complex(np.roots(np.concatenate([[1.0], start.theta[:2]]))) * start.scale
    np.testing.assert_allclose(poles, np.sort_complex(np.roots(SECOND_ORDER[1])), rtol=0.05)


def test_the_profile_is_lowest_at_the_delay():
    problem = late_problem()
    delays, cost = delay_profile(problem, 9.0, np.zeros(1), 0, 0.0, 3.0)
    assert np.max(np.abs(np.diff(delays) - 0.5 * PERIOD_S)) < 1e-12
    assert abs(delays[np.argmin(cost)] - 0.2537) < PERIOD_S


@pytest.mark.parametrize("delay", ["guess", -0.1, Prior(-1.0, 0.0), float("nan"), [0.1, 0.2]])
def test_delays_that_mean_nothing_are_refused(delay):
    with pytest.raises(EstimationError, match=r"delay|prior"):
        estimate_transfer_function(late_record(0.0), 2, 1, delay=delay)


@pytest.mark.parametrize("method", ["srivc", "ivsvf", "lssvf"])
def test_estimators_that_take_a_delay_as_given_do_not_pretend_to_find_it(method):
    with pytest.raises(EstimationError, match="takes delays as given"):
        estimate_transfer_function(late_record(0.1), 2, 1, method, delay="estimate")
    found = estimate_transfer_function(late_record(0.1, snr_db=40.0), 2, 1, method, delay=0.1)
    assert found.scores.fit_percent > 80.0


@pytest.mark.parametrize("delay", [Prior(0, np.inf), Prior(0, 1)])
def test_a_delay_that_is_known_to_whole_seconds_is_estimated_to_fractions(delay):
    model = estimate_transfer_function(late_record(0.1234), 2, 1, delay=delay).model
    assert np.max(np.abs(scores(model, 0.1234))) < 4.0


def test_a_prior_of_something_that_is_no_number_is_refused():
    with pytest.raises(EstimationError, match="expected a finite mean"):
        Prior("soon", 1.0)  # type: ignore[arg-type]
