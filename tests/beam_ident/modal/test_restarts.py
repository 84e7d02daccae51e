"""What is not known of an input in its gaps, and fits that begin anew after them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.signal import lsim

from beam_ident import (
    EstimationError,
    InputSignal,
    ModalModel,
    ModalStructure,
    OutputSignal,
    Prior,
    TimeRecord,
    identify,
)
from beam_ident.data.gaps import InputGap
from beam_ident.modal.regression import ClockState, ModalRegression
from beam_ident.modal.restarts import Restarts, bridge_effects
from beam_ident.modal_estimation.record_levels import restart_priors
from beam_ident.modal_estimation.variable_projection import fit_modes, held_cost
from tests.beam_ident.truth import OMEGAS, RESIDUES, ZETAS, beam_record


@pytest.mark.first_case
@pytest.mark.parametrize(("kind", "differentiations"), [("velocity", 1), ("acceleration", 0), ("force", 0)])
def test_errors_of_a_bridge_do_to_an_output_what_a_simulation_says(kind: str, differentiations: int) -> None:
    start, end, missing = 1.0, 1.021, 20
    step = (end - start) / (missing + 1)
    errors = np.random.default_rng(0).standard_normal((3, missing))
    gap = InputGap(start, end, missing, 1.0, errors)
    instants = np.linspace(1.5, 3.0, 40)
    shared = np.array([1.3, 0.0, 0.4])  # gain, residual term, residue
    omega, zeta = 20.0, 0.05
    found = bridge_effects(
        gap,
        ModalStructure(kind),
        np.array([omega]),
        np.array([zeta]),
        shared,
        instants,  # type: ignore[arg-type]
    )
    fine = np.arange(0.9, 3.0, 2e-4)
    sign = 1.0 if kind == "force" else -1.0
    for own, effect in zip(errors, found, strict=True):
        # Held for a step around the place of every missing sample.
        places = start + step * np.arange(1, missing + 1)
        index = np.rint((fine - places[0]) / step).astype(int)
        held = np.where((index >= 0) & (index < missing), own[np.clip(index, 0, missing - 1)], 0.0)
        numerator = [0.4 * sign] + [0.0] * differentiations
        _, modal, _ = lsim((numerator, [1.0, 2.0 * zeta * omega, omega**2]), held, fine)
        _, rigid, _ = lsim(([1.3], [1.0] + [0.0] * (2 - differentiations)), held, fine)
        expected = np.interp(instants, fine, modal + rigid)
        # The sum over samples stands for the integral: exact to the square of omega times the step, 4e-4.
        np.testing.assert_allclose(effect, expected, atol=0.02 * np.max(np.abs(expected)))


def damaged(record: TimeRecord, holes: tuple[tuple[float, float], ...]) -> TimeRecord:
    """Return a record whose input was not heard of for a while."""
    drive = record.inputs[0]
    values = np.array(drive.values)
    for first, last in holes:
        values[(drive.times_s > first) & (drive.times_s < last)] = np.nan
    return dataclasses.replace(record, inputs=(dataclasses.replace(drive, values=values),))


@pytest.mark.slow
@pytest.mark.parametrize("quantity", ["position", "velocity", "acceleration"])
def test_gaps_of_any_length_leave_the_poles_where_they_are(quantity: str) -> None:
    structure = "base_motion" if quantity == "position" else quantity
    record = beam_record(3, quantity=quantity)
    whole = identify(record, structure, n_modes=3)  # type: ignore[arg-type]
    holes = ((2.0, 2.022), (4.0, 4.5), (6.1, 6.13))
    found = identify(damaged(record, holes), structure, n_modes=3)  # type: ignore[arg-type]
    assert found.converged
    (said,) = [warning for warning in found.warnings if "gaps" in warning]
    assert "3 gaps (2.000-2.022 s" in said
    assert "begins anew" in said
    for name, truth in (("natural_frequencies", OMEGAS), ("damping_ratios", ZETAS)):
        sd = {"natural_frequencies": "natural_frequency_sd", "damping_ratios": "damping_ratio_sd"}[name]
        z = (getattr(found.model, name) - truth) / getattr(found.model, sd)
        assert np.max(np.abs(z)) < 4.0
        # What is lost is what the second half tells of the phase since the first: no factor of more than a few.
        assert np.max(getattr(found.model, sd) / getattr(whole.model, sd)) < 4.0
    assert np.max(np.abs(found.model.residues - RESIDUES) / found.model.residue_sd) < 4.5


@pytest.mark.slow
@pytest.mark.parametrize("quantity", ["velocity", "acceleration"])
def test_modes_are_found_between_many_gaps_of_an_integrated_input(quantity: str) -> None:
    rng = np.random.default_rng(0)
    starts = 0.01 * np.sort(rng.choice(np.arange(20, 1350), 50, replace=False))
    record = damaged(beam_record(3, quantity=quantity), tuple((a, a + 0.021) for a in starts))
    found = identify(record, quantity)  # type: ignore[arg-type]
    assert found.converged
    assert found.model.n_modes == 3
    assert any("the constants of the input's integration begin anew" in said for said in found.warnings)
    assert not any("cannot be told apart" in said for said in found.warnings)
    z = (found.model.natural_frequencies - OMEGAS) / found.model.natural_frequency_sd
    assert np.max(np.abs(z)) < 4.0


@pytest.mark.slow
def test_a_bridge_that_nobody_believes_excites_nothing_in_the_search() -> None:
    # What a poor bridge does at its ends would look like a blow, which reaches 500 Hz, and hides modes behind it.
    record = damaged(beam_record(3), ((3.0, 4.0),))
    found = identify(record)
    assert found.band.low_hz < 4.0
    assert found.band.high_hz < 100.0
    assert found.model.n_modes == 3
    z = (found.model.natural_frequencies - OMEGAS) / found.model.natural_frequency_sd
    assert np.max(np.abs(z)) < 4.0


@pytest.mark.parametrize(("hole", "is_known"), [((3.0, 4.0), False), ((3.0, 3.1), True)])
def test_what_begins_after_a_poor_bridge_is_unknown(hole: tuple[float, float], is_known: bool) -> None:
    # Errors at a few other places do not say what a bridge that went wrong does at its ends.
    record = damaged(beam_record(3), (hole,))
    gaps = record.inputs[0].gaps
    restarts = Restarts((gaps,), 0, (frozenset(),))
    regression = ModalRegression([record], ModalStructure("base_motion"), restarts=restarts)
    fit = fit_modes(regression, OMEGAS, ZETAS, ClockState(), Prior(), Prior())
    # Two columns for each of three modes at three outputs.
    assert len(restart_priors(regression, fit)) == (18 if is_known else 0)


def test_knowledge_of_a_bridge_yields_to_what_the_fit_finds() -> None:
    record = damaged(beam_record(3), ((3.0, 3.1),))
    (gap,) = record.inputs[0].gaps
    feigned = dataclasses.replace(gap, errors=1e-3 * gap.errors)
    restarts = Restarts(((feigned,),), 0, (frozenset(),))
    regression = ModalRegression([record], ModalStructure("base_motion"), restarts=restarts)
    fit = fit_modes(regression, OMEGAS, ZETAS, ClockState(), Prior(), Prior())
    amplitudes = np.concatenate([np.zeros(fit.n_theta), *fit.coefficients])
    for place, sd in restart_priors(regression, fit):
        # Of 18 numbers none lies beyond four of what is known and of what the fit knows, taken together.
        assert abs(amplitudes[place]) < 4.0 * np.hypot(sd, np.sqrt(fit.covariance[place, place]))


@pytest.mark.verify
def test_outputs_with_delays_of_their_own_may_have_gaps_of_the_input() -> None:
    record = damaged(beam_record(3), ((2.0, 2.022), (6.1, 6.13)))
    late = dataclasses.replace(record.outputs[2], times_s=record.outputs[2].times_s + 2e-3)
    found = identify(dataclasses.replace(record, outputs=(*record.outputs[:2], late)), n_modes=3)
    assert found.model.output_delays[2] == pytest.approx(2e-3, abs=2e-4)


@pytest.mark.slow
def test_a_fit_that_fails_names_the_gaps() -> None:
    times = 1e-3 * np.arange(4000)
    rng = np.random.default_rng(0)
    values = 1e-3 * np.sin(30.0 * times)
    values[1000:1020] = np.nan
    record = beam_record(1)
    stamps = 0.01 * np.arange(1, 390)
    output = dataclasses.replace(record.outputs[0], times_s=stamps, values=rng.standard_normal(389))
    drive = InputSignal("hub", "m", times, values, "cubic")
    with pytest.raises(EstimationError, match=r"Input hub has 1 gap \(0\.999-1\.020 s\)"):
        identify(TimeRecord((drive,), (output,)))


def test_no_sample_at_the_end_of_a_gap_changes_sides_with_the_latency() -> None:
    # Held, with stamps on the input's own grid: the first sample after the gap stands exactly at its end.
    times = 0.01 * np.arange(3000)
    rng = np.random.default_rng(0)
    held = rng.standard_normal(3000)
    plant = ModalModel(
        "receptance", "u", ("y",), np.array([20.0]), np.array([0.02]), np.array([[3.0]]), *np.zeros((2, 1)),
        0.0, 0.0, np.zeros((7, 7)), np.ones(1),
    )  # fmt: skip
    values = plant.simulate(InputSignal("u", "N", (0.0, 0.01), held, "zoh"), times[1:])[:, 0]
    held[1000:1100] = np.nan
    record = TimeRecord(
        (InputSignal("u", "N", (0.0, 0.01), held, "zoh"),), (OutputSignal("y", "m", times[1:], values),)
    )
    # Without the residual term, which follows the jumps of a held input.
    regression = ModalRegression([record], ModalStructure("receptance", has_residual=False))
    costs = [
        held_cost(regression, np.array([20.3]), np.array([0.02]), ClockState(latency, 0.0))
        for latency in (-2e-7, -1e-7, 0.0, 1e-7, 2e-7)
    ]
    # A smooth cost is straight so near; one sample on the other side would move it by several.
    assert np.max(np.abs(np.diff(costs, 2))) < 1e-3
