from __future__ import annotations

import numpy as np
import pytest

from beam_ident import InputSignal, OutputSignal, Prior, TimeRecord, estimate_transfer_function
from beam_ident.numerics.rational_response import full_roots
from beam_ident.transfer_function_estimation.output_error import OutputErrorProblem
from beam_ident.transfer_function_estimation.pole_exchange import (
    Place,
    PoleExchange,
    completed,
    exchanged,
)
from beam_ident.transfer_function_estimation.record_share import Nuisances, RecordShare
from benchmarks.ident.supersets import hard_record
from tests.beam_ident.transfer_function_estimation.test_output_error import RESONANCES, problem

POLES = np.array([-0.7 + 0.0j, -0.4 + 5.0j])


@pytest.mark.parametrize("several", [False, True])
@pytest.mark.parametrize(("exposure_s", "n_integrators"), [(0.0, 0), (0.04, 0), (0.04, 1)])
def test_the_likelihood_of_poles_of_the_pool_is_that_of_the_problem_itself(
    exposure_s, n_integrators, several
):
    case = problem(False, exposure_s, n_integrators, several=several)
    place = Place(POLES, np.array([0.03, 0.1]))
    exchange = PoleExchange([case, case], place.delays, [POLES])
    case.scale = place.scale
    state = case.state(place.theta)
    assert exchange.cost(exchange.nearest(POLES)) == pytest.approx(2.0 * state.cost, abs=1e-6)
    assert Place.of(state).poles == pytest.approx(POLES)
    assert Place.of(state).cost == state.cost


def two_resonances(n_zeros: int = 2, noise: float = 0.01) -> OutputErrorProblem:
    rng = np.random.default_rng(5)
    drive = InputSignal("u", "", (0.0, 0.02), rng.standard_normal(600), "zoh")
    times = 0.02 * np.arange(600)
    values = RESONANCES.simulate(drive, times)
    values += noise * np.std(values) * rng.standard_normal(600)
    record = TimeRecord((drive,), (OutputSignal("y", "", times, values),))
    share = RecordShare.of(record, "y", ["u"], [n_zeros], [0], [Prior(0.0)], 0, False)
    return OutputErrorProblem([share], (4,), Nuisances())


def test_a_pair_that_explains_nothing_is_exchanged_for_the_mode_that_is_missing():
    case = two_resonances()
    truth = np.sort_complex(RESONANCES.poles[RESONANCES.poles.imag > 0.0])
    wrong = Place(np.array([truth[0], -3.0 + 60.0j]), np.empty(0), 1e9)

    def refined(place: Place, target: float) -> Place:
        case.scale = place.scale
        return Place.of(case.state(place.theta))

    found = exchanged([case], wrong, lambda place: place, refined, [truth[1:] * (1.0 + 1e-3)])
    assert np.sort_complex(found.poles) == pytest.approx(truth, rel=1e-2)


def test_a_structure_inside_another_is_completed_to_one_that_does_as_much():
    record = hard_record(0)
    share = RecordShare.of(record, "y0", ["u"], [2], [0], [Prior(0.0, np.inf)], 0, True)
    case = OutputErrorProblem([share], (3,), Nuisances(True, True, True))
    inside = Place(np.array([-0.5 + 6.0j]), np.empty(0))
    (place,) = completed(case, [inside])
    assert len(full_roots(place.poles)) == 3
    assert place.poles[0] == inside.poles[0]
    assert place.delays == pytest.approx([0.0])
    smaller = OutputErrorProblem([share], (2,), case.nuisances)
    smaller.scale, case.scale = inside.scale, place.scale
    assert case.state(place.theta).cost < smaller.state(np.append(inside.theta, 0.0)).cost + 1e-6


def test_poles_that_meet_are_no_candidates():
    case = two_resonances()
    exchange = PoleExchange([case], np.empty(0), [np.array([-1.0 + 6.0j, -1.0 + 6.000001j])])
    assert exchange.cost((0, 1)) == np.inf


@pytest.mark.slow
def test_a_pole_that_an_offset_drives_to_zero_does_not_hold_back_the_others():
    record = hard_record(13)
    costs = []
    for n_zeros in (1, 2):
        found = estimate_transfer_function(record, 3, n_zeros, method="white", has_free_response=True)
        assert found.converged
        assert np.min(np.abs(found.model.poles)) < 1e-6
        costs.append(float(found.residuals @ found.residuals))
    assert costs[1] <= costs[0]
