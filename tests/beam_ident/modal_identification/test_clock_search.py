from __future__ import annotations

import itertools

import numpy as np
import pytest

from beam_ident import Prior, identify
from beam_ident.modal.regression import ClockState, ModalRegression
from beam_ident.modal_estimation.variable_projection import ModalFit, fit_modes
from beam_ident.modal_identification.clock_search import clock_places
from benchmarks.ident.forced_beam import FREE, PLAIN, ForcedBeam, foreign_clock
from benchmarks.ident.unlike_rig import unlike_rig

TRUTH = ClockState(2e-3, 1e-3)


@pytest.fixture(scope="module")
def beam() -> ForcedBeam:
    return ForcedBeam()


@pytest.fixture(scope="module")
def regression(beam) -> ModalRegression:
    return ModalRegression([foreign_clock(beam, 1, 1.0)], PLAIN)


def at(regression: ModalRegression, beam: ForcedBeam, clock: ClockState) -> ModalFit:
    """Return a fit that stays where it begins: the right poles on a given clock."""
    fixed = Prior(clock.latency), Prior(clock.rate)
    return fit_modes(regression, beam.omegas, beam.zetas, clock, *fixed, max_iterations=0)


@pytest.mark.parametrize(
    ("latency", "rate"), [(0.0, 0.0), (2e-3 + 0.0125, 1e-3), (2e-3, 1e-3 - 0.025 / 25.0), (-8e-3, 2e-3)]
)
def test_the_right_crest_promises_most_from_wherever_the_clock_stands(beam, regression, latency, rate):
    fit = at(regression, beam, ClockState(latency, rate))
    best = clock_places(regression, fit, FREE, FREE, 3)[0]
    assert best.gain > 100.0
    # Within an eighth of a period of the fastest mode, over the whole record.
    assert abs(best.clock.latency - TRUTH.latency) + 25.0 * abs(best.clock.rate - TRUTH.rate) < 1 / 40 / 8


def test_nothing_better_is_promised_where_the_clock_is_right(beam, regression):
    places = clock_places(regression, at(regression, beam, TRUTH), FREE, FREE, 3)
    assert places[0].gain < 1.0
    clocks = [place.clock for place in places]
    for first, second in itertools.combinations(clocks, 2):  # crests, not one crest three times
        assert abs(first.latency - second.latency) + 25.0 * abs(first.rate - second.rate) > 0.1 / 40


def test_what_is_known_of_the_clock_is_respected(beam, regression):
    fit = at(regression, beam, ClockState())
    assert clock_places(regression, fit, Prior(0.0), FREE, 3) == []
    for place in clock_places(regression, fit, FREE, Prior(0.0), 3):
        assert place.clock.rate == 0.0
    for place in clock_places(regression, fit, FREE, Prior(0.0, 5e-5), 3):
        assert abs(place.clock.rate) <= 5.0 * 5e-5 + 1e-4  # one step of the grid beyond the prior's reach


@pytest.mark.slow
def test_a_search_that_began_cycles_away_from_the_latency_is_left_for_the_right_one():
    # The poles bend until a latency 175 ms away explains eight modes without a better crest near by.
    system = unlike_rig(10)
    model = identify(system.first.select(["y0"]), system.structure, 8, latency=FREE).model
    assert abs(model.latency - system.truth.latency) < 4.0 * model.latency_sd
    apart = np.abs(np.log(model.natural_frequencies[:, None] / system.truth.natural_frequencies))
    # One of the eight hardly shows at this output alone, behind the losses of the input.
    assert np.sort(np.min(apart, axis=1))[-2] < 0.02
