"""Optimal spectra: against the exact bound of long records, and against the theorem of equivalence."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beam_ident import AxisLimits, ExcitationError, ModalModel, ShapedMultisine
from beam_ident.design.criteria import Criterion
from beam_ident.design.experiment import drive_of
from beam_ident.design.limits import ExcitationLimits, LimitedResponse
from beam_ident.design.precision import Observation, predicted_model
from beam_ident.design.spectrum import candidate_lines, line_information, optimal_powers

OBSERVATION = Observation(100.0, {"low": 5e-6, "tip": 5e-6}, 2e-3, clock_rate_sd=0.0)


def two_modes() -> ModalModel:
    return ModalModel(
        "base_motion",
        "hub",
        ("low", "tip"),
        2.0 * np.pi * np.array([5.0, 21.0]),
        np.array([0.02, 0.01]),
        np.array([[0.2, -0.3], [1.5, 0.8]]),
        np.zeros(2),
        np.ones(2),
        0.0,
        0.0,
        np.zeros((14, 14)),
        np.full(2, 5e-6),
    )


def limits(model: ModalModel) -> ExcitationLimits:
    axis = AxisLimits(travel=0.05, speed=0.5, acceleration=4.0)
    return ExcitationLimits(axis, (LimitedResponse(model, {"tip": 0.03}),), period_s=2e-3)


@pytest.mark.parametrize("input_sd", [0.0, 5e-7])
def test_the_lines_information_is_the_exact_one_of_a_long_record(input_sd):
    model, own, seen = two_modes(), limits(two_modes()), replace(OBSERVATION, input_sd=input_sd)
    lines, powers = np.array([3.0, 4.9, 5.15, 20.8, 21.3, 30.0]), np.array([0.1, 0.05, 0.05, 0.2, 0.3, 0.4])
    told = np.tensordot(powers, line_information(model, lines, own, 120.0, seen), 1)
    recipe = ShapedMultisine(
        tuple(lines), tuple(np.sqrt(powers)), tuple(range(6)), np.sqrt(powers.sum()), 120.0, 0.5, 0.0
    )
    exact = predicted_model(model, drive_of(recipe, model, own), seen)
    sd = np.sqrt(np.diag(np.linalg.inv(told)))
    places = [k for k, name in enumerate(model.parameter_names) if name != "clock_rate"]
    scale = np.concatenate([model.natural_frequencies, model.damping_ratios, np.ones(9)])
    # Neighbours, the beginning and the drift's columns are what the spectrum leaves out.
    np.testing.assert_allclose(sd * scale, exact.standard_deviations[places], rtol=0.12)


@pytest.mark.parametrize("criterion", ["D", "A"])
def test_no_line_is_worth_more_than_its_price(criterion):
    """Kiefer and Wolfowitz: a design is optimal if and only if the way to no line alone gains anything."""
    model = two_modes()
    own, crests = limits(model), np.full(4, 2.0)
    lines = candidate_lines([model], (1.0, 45.0), 60.0, 100.0)
    powers = optimal_powers(Criterion(criterion), [model], lines, [own], crests, 60.0, OBSERVATION)
    told = line_information(model, lines, own, 60.0, OBSERVATION)
    size = np.sqrt(np.einsum("kii->i", told))
    told /= np.outer(size, size)

    def value(p: np.ndarray) -> float:
        covariance = np.linalg.inv(np.tensordot(p, told, 1))[:4, :4] / np.outer(size[:4], size[:4])
        return float(
            -np.linalg.slogdet(covariance)[1] / 4.0 if criterion == "D" else -np.log(np.trace(covariance))
        )

    costs = 4.0 * own.gains(2.0 * np.pi * lines)
    used, step = np.max(powers @ costs), 1e-3
    gained = []
    for alone in np.diag(used / np.max(costs, axis=1)):
        gained.append((value((1.0 - step) * powers + step * alone) - value(powers)) / step)
    # The slope towards the best line is 0 at the optimum, and 1 where a line that is left out tells twice its price.
    assert max(gained) < 0.1
    flat = np.full(len(lines), used / np.max(np.sum(costs, axis=0)))
    assert value(powers) > value(flat) + 0.2


def test_the_best_for_one_parameter_is_better_for_it_than_what_is_best_for_all():
    model = two_modes()
    own, crests = limits(model), np.full(4, 2.0)
    lines = candidate_lines([model], (1.0, 45.0), 60.0, 100.0)
    told = line_information(model, lines, own, 60.0, OBSERVATION)
    sd = {}
    for wanted in ("D", "c:zeta_2", "c:r_2[tip]"):
        powers = optimal_powers(Criterion.of(wanted), [model], lines, [own], crests, 60.0, OBSERVATION)
        # With a little of everything: what is best for one alone may tell nothing of the rest.
        mixed = 0.95 * powers + 0.05 * np.mean(powers) / len(powers)
        sd[wanted] = np.sqrt(np.diag(np.linalg.inv(np.tensordot(mixed, told, 1))))
    assert sd["c:zeta_2"][3] < 0.95 * sd["D"][3]
    assert sd["c:r_2[tip]"][12] < 0.9 * sd["D"][12]


def test_candidates_surround_every_mode_and_avoid_what_is_seen_as_a_drift():
    model = two_modes()
    lines = candidate_lines([model], (1.0, 45.0), 20.0, 21.0)  # the camera folds 21 Hz to 0
    assert np.all(np.abs(lines - 21.0) > 2.0 / 20.0 - 1e-9)
    assert np.sum(np.abs(lines - 5.0) < 0.2) >= 4
    assert np.all(np.diff(lines) > 0.0)
    assert lines[0] >= 1.0
    assert lines[-1] <= 45.0


@pytest.mark.parametrize("wrong", ["E", "c", "c:", "D:zeta_1", ""])
def test_an_unknown_criterion_is_refused(wrong):
    with pytest.raises(ExcitationError, match="expected D, A or c:NAME"):
        Criterion.of(wrong)
    with pytest.raises(ExcitationError, match="omega_1, omega_2, zeta_1"):
        Criterion.of("c:zeta_9").place(two_modes())
