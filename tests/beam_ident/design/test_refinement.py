"""Lines refined on the whole record: against the exact bound, exact peaks and differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beam_ident import AxisLimits, ShapedMultisine
from beam_ident.design.criteria import Criterion
from beam_ident.design.experiment import drive_of
from beam_ident.design.limits import ExcitationLimits
from beam_ident.design.precision import Observation, predicted_model
from beam_ident.design.refinement import LimitedLines, SeenLines, amplitudes_and_phases, refined
from tests.beam_ident.design.test_spectrum import limits, two_modes

OBSERVATION = Observation(50.0, {"low": 5e-6, "tip": 5e-6}, 2e-3, clock_rate_sd=0.0)
LINES = (3.0, 4.9, 5.15, 20.8, 21.3, 30.0)
RECIPE = ShapedMultisine(
    LINES, (1.0, 2.0, 3.0, 1.0, 1.0, 1.0), (0.0, 1.0, 2.0, 3.0, 4.0, 5.0), 1.0, 6.0, 0.5, 1.5
)


def quadratures(recipe: ShapedMultisine) -> np.ndarray:
    effective = np.array(recipe.amplitudes) / np.sqrt(np.sum(np.square(recipe.amplitudes)))
    return np.concatenate([effective * np.cos(recipe.line_phases), effective * np.sin(recipe.line_phases)])


@pytest.mark.parametrize("structure", ["base_motion", "force", "receptance", "mobility", "accelerance"])
def test_the_information_of_the_lines_is_that_of_the_record(structure):
    """A record of 7.5 s that the first mode outlasts: nothing of it is steady."""
    model = replace(two_modes(), structure=structure, damping_ratios=np.array([0.004, 0.01]))
    if structure == "receptance":
        model = replace(model, gains=np.zeros(2))
    own = ExcitationLimits(AxisLimits(acceleration=1.0), scale=2.0, period_s=2e-3)
    if structure == "base_motion":
        own = replace(own, scale=1.0)
    information, _ = SeenLines(model, RECIPE, own, OBSERVATION).information(quadratures(RECIPE))
    exact = predicted_model(model, drive_of(RECIPE, model, own), OBSERVATION)
    # Residual terms of what differentiates the drive are left out of the lines, as are a receptance's gains.
    kept = [
        k for k, name in enumerate(model.parameter_names) if information[k, k] > 0.0 and name != "clock_rate"
    ]
    if structure in ("mobility", "accelerance"):
        kept = [k for k in kept if not model.parameter_names[k].startswith("R[")]
    sd = np.sqrt(np.diag(np.linalg.inv(information[np.ix_(kept, kept)])))
    scale = np.concatenate([model.natural_frequencies, model.damping_ratios, np.ones(10)])[kept]
    # Exposures weaken a transient as they weaken its mode, not as they weaken the line that made it.
    np.testing.assert_allclose(sd[:4] * scale[:4], exact.standard_deviations[kept][:4], rtol=0.1)


def test_peaks_of_the_lines_are_those_of_the_recipe():
    own = limits(two_modes())
    lines = LimitedLines(RECIPE, [own])
    # Some of the instants stand for all: a peak between them is a little higher.
    found = np.exp(lines.log_peak(quadratures(RECIPE), 1024)[0])
    assert found == pytest.approx(max(own.shares(RECIPE).values()), rel=0.03)


@pytest.mark.parametrize(
    ("criterion", "counts"), [("D", [0, 1, 2, 3]), ("A", [0, 1, 2, 3]), ("c:zeta_1", [2])]
)
def test_slopes_are_differences_and_the_level_does_not_matter(criterion, counts):
    model, wanted = two_modes(), Criterion.of(criterion)
    seen = SeenLines(model, RECIPE, limits(model), OBSERVATION)
    lines = LimitedLines(RECIPE, [limits(model)])
    interest = np.eye(14)[:, counts]

    def cost(x: np.ndarray) -> tuple[float, np.ndarray]:
        peak, slopes = lines.log_peak(x, 16)
        information, signals = seen.information(x)
        value, weight = wanted.log_variance(information[None], interest)
        return 2.0 * peak + float(value[0]), 2.0 * slopes - seen.slopes(signals, weight[0])

    x = quadratures(RECIPE)
    slopes = cost(x)[1]
    steps = 1e-4 * np.eye(12)
    np.testing.assert_allclose(
        slopes, [(cost(x + step)[0] - cost(x - step)[0]) / 2e-4 for step in steps], atol=2e-3
    )
    assert abs(slopes @ x) < 1e-6


def test_refined_lines_tell_more_within_the_same_limits():
    model = replace(two_modes(), damping_ratios=np.array([0.004, 0.01]))
    own = limits(model)
    start = quadratures(RECIPE)
    seen, lines = SeenLines(model, RECIPE, own, OBSERVATION), LimitedLines(RECIPE, [own])
    best = refined([(1.0, Criterion("D"), np.eye(14)[:, :4])], [seen], lines, start)
    effective, phases = amplitudes_and_phases(best, lines)

    def value(recipe: ShapedMultisine) -> float:
        loudest = replace(recipe, acceleration=recipe.acceleration / max(own.shares(recipe).values()))
        return Criterion("D").value(predicted_model(model, drive_of(loudest, model, own), OBSERVATION))

    assert np.all(effective > 0.0)
    level = float(np.linalg.norm(effective))
    found = replace(RECIPE, amplitudes=tuple(effective), line_phases=tuple(phases), acceleration=level)
    assert value(found) < 0.6 * value(RECIPE)
    # Hardly a peak hides between the instants that are looked at, five in a period of the fastest line.
    assert np.exp(lines.log_peak(best, 1024)[0]) == pytest.approx(max(own.shares(found).values()), rel=0.05)


def test_a_line_is_faint_where_it_moves_nothing():
    lines = LimitedLines(RECIPE, [limits(two_modes())])
    resonance, fast = LINES.index(4.9), LINES.index(30.0)
    assert lines.sizes[resonance] > 3.0 * lines.sizes[fast]
    x = np.zeros(2 * len(LINES))
    x[fast], x[resonance], x[0] = 1.0, 9e-4, 1e-9
    effective, _ = amplitudes_and_phases(x, lines)
    assert np.flatnonzero(effective).tolist() == [resonance, fast]
