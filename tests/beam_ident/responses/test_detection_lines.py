from __future__ import annotations

import numpy as np
import pytest

from beam_ident import EstimationError, InputSignal, OutputSignal, TimeRecord
from beam_ident.responses.detection_lines import _between, nonlinear_distortion
from beam_ident.responses.periodic_averaging import periodic_response
from tests.beam_ident.periodic import LINE_PERIOD_S, PLANT, TICK_S, multisine

ODD = np.arange(5, 150, 2)
RANDOM_ODD = np.delete(ODD, np.arange(1, len(ODD), 4)) / LINE_PERIOD_S  # every fourth odd line left out


def clean_output(n_periods=6):
    n = round(LINE_PERIOD_S / TICK_S)
    drive = InputSignal("u", "", (0.0, TICK_S), 3.0 * multisine(n_periods + 3, RANDOM_ODD))
    stamps = TICK_S * np.arange(2 * n, (n_periods + 2) * n)
    return drive, stamps, PLANT.simulate(drive, stamps)


DRIVE, STAMPS, CLEAN = clean_output()


def analysed(square=0.0, cube=0.0, noise=0.05, seed=0, drive=DRIVE, **keywords):
    values = CLEAN + square * CLEAN**2 + cube * CLEAN**3
    values = values + noise * np.random.default_rng(seed).standard_normal(len(values))
    record = TimeRecord((drive,), (OutputSignal("y", "", STAMPS, values),))
    return nonlinear_distortion(periodic_response(record, LINE_PERIOD_S, RANDOM_ODD), **keywords)


def test_a_linear_plant_is_called_nonlinear_as_often_as_stated():
    flagged = sum(analysed(seed=seed, significance=0.2).is_nonlinear for seed in range(80))
    assert 5 <= flagged <= 28  # 16 +- 3.6


@pytest.mark.parametrize(
    ("square", "cube", "parities"),
    [(1e-3, 0.0, {"even"}), (0.0, 1e-3, {"odd"}), (1e-3, 1e-3, {"even", "odd"})],
)
def test_even_and_odd_nonlinearities_show_on_their_own_lines(square, cube, parities):
    found = analysed(square, cube)
    assert {level.parity for level in found.levels if level.is_detected} == parities
    assert found.verdict.startswith("nonlinear, with " + " and ".join(sorted(parities)))


def test_the_level_is_that_of_the_distortion():
    found = analysed(cube=1e-3, noise=0.01)
    spectrum = np.fft.rfft((1e-3 * CLEAN**3)[: len(CLEAN) // 6])
    whole = np.fft.rfft((CLEAN + 1e-3 * CLEAN**3)[: len(CLEAN) // 6])
    excited = np.round(RANDOM_ODD * LINE_PERIOD_S).astype(int)
    left_out = np.setdiff1d(ODD, excited)
    left_out = left_out[(left_out > excited[0]) & (left_out < excited[-1])]
    expected = 10 * np.log10(np.mean(np.abs(spectrum[left_out]) ** 2) / np.mean(np.abs(whole[excited]) ** 2))
    odd = next(level for level in found.levels if level.parity == "odd")
    assert odd.n_lines == len(left_out)
    assert odd.level_db == pytest.approx(expected, abs=0.3)
    assert odd.level_db <= odd.largest_db < odd.level_db + 3.0


def test_an_input_that_is_itself_distorted_does_not_accuse_the_plant():
    n = round(LINE_PERIOD_S / TICK_S)
    bent = DRIVE.values + 0.01 * DRIVE.values**2
    drive = InputSignal("u", "", (0.0, TICK_S), bent)
    values = PLANT.simulate(drive, STAMPS) + 0.05 * np.random.default_rng(0).standard_normal(6 * n)
    record = TimeRecord((drive,), (OutputSignal("y", "", STAMPS, values),))
    found = nonlinear_distortion(periodic_response(record, LINE_PERIOD_S, RANDOM_ODD))
    assert not found.is_nonlinear
    assert "no nonlinear distortion" in found.verdict


def test_an_excitation_without_detection_lines_is_refused():
    every = np.arange(5, 40) / LINE_PERIOD_S
    record = TimeRecord((DRIVE,), (OutputSignal("y", "", STAMPS, CLEAN),))
    with pytest.raises(EstimationError, match="random-odd"):
        nonlinear_distortion(periodic_response(record, LINE_PERIOD_S, every))
    with pytest.raises(EstimationError, match="significance is 2"):
        analysed(significance=2.0)


def test_a_response_between_few_lines_lies_on_the_straight_line_through_them():
    found = _between(5, np.array([3, 9]), np.array([1.0 + 1.0j, 4.0 - 2.0j]))
    assert found == pytest.approx(2.0 + 0.0j, abs=1e-12)


def test_a_response_between_many_lines_follows_a_resonance():
    def at(line):
        return (2.0 + 0.3 * line) / (1.0 + (0.1 - 0.2j) * (line - 20.0) + 0.05 * (line - 20.0) ** 2)

    excited = np.array([13, 15, 17, 19, 23, 25, 27, 29])
    assert _between(21, excited, at(excited)) == pytest.approx(at(21), rel=1e-9)
