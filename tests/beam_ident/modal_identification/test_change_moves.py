"""Modes whose frequencies change: the response against their equations of motion, and what a search says."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ident import Prior, identify
from beam_ident.modal.mode_change import ModeChange, over_time
from beam_ident.modal.regression import ClockState, ModalRegression
from beam_ident.modal.structure import ModalStructure
from beam_ident.modal_estimation.variable_projection import fit_modes
from beam_ident.modal_identification.mode_changes import change_columns
from benchmarks.ident.changing_modes import ChangingModes

BASE_MOTION = ModalStructure("base_motion")


def test_the_response_of_a_mode_that_changes_is_that_of_its_equation_of_motion() -> None:
    modes = ChangingModes("time", duration_s=8.0)
    modes.noise = 0.0
    record, share = modes.record(1), modes.share(1)
    course = over_time(*ModalRegression([record], BASE_MOTION).stamps_span_s)
    left = []
    for changes in ((), (ModeChange("time", float(modes.omegas[0]), share, course),)):
        regression = ModalRegression([record], BASE_MOTION).with_changes(changes)
        fit = fit_modes(regression, modes.omegas, modes.zetas, ClockState(), Prior(), Prior())
        left.append(float(np.std(fit.residuals[0])))
    # Of 20 mm; the pace is that of a segment's middle, and steps of 1 ms err as well.
    assert left[0] > 1e-5
    assert left[1] < 3e-7
    np.testing.assert_allclose(fit.omegas, modes.omegas, rtol=2e-6)
    np.testing.assert_allclose(fit.zetas, modes.zetas, rtol=2e-4)


def test_columns_of_a_change_are_the_derivatives_of_the_response() -> None:
    modes = ChangingModes(None, duration_s=4.0)
    regression = ModalRegression([modes.record(2)], BASE_MOTION)
    fit = fit_modes(regression, modes.omegas, modes.zetas, ClockState(), Prior(), Prior())
    change = ModeChange("time", float(fit.omegas[1]), 0.0, over_time(*regression.stamps_span_s))
    (slopes, _) = (own[:, 0] for own in change_columns(regression, fit, [change]))
    (block,) = regression.blocks(fit.omegas, fit.zetas, fit.clock, gradients=False)
    moved = ModeChange("time", change.omega, 1e-4, change.course)
    (there,) = regression.with_changes((moved,)).blocks(fit.omegas, fit.zetas, fit.clock, gradients=False)
    difference = (there.matrix - block.matrix) @ fit.coefficients[0]
    np.testing.assert_allclose(difference, 1e-4 * slopes, atol=0.02 * float(np.max(np.abs(difference))))


def test_modes_that_do_not_change_are_not_said_to() -> None:
    modes = ChangingModes(None)
    result = identify(modes.record(3))
    assert not result.frequency_changes
    assert not result.warnings
    np.testing.assert_allclose(result.model.natural_frequencies, modes.omegas, rtol=1e-5)


@pytest.mark.slow
def test_a_mode_that_changes_over_time_is_estimated_with_its_change() -> None:
    modes = ChangingModes("time")
    result = identify(modes.record(0))
    (change,) = result.frequency_changes
    assert (change.mode, change.over) == (0, "time")
    assert abs(change.share - modes.share(0)) < 4.0 * change.share_sd < 1e-4
    model = result.model
    scores = (model.natural_frequencies - modes.omegas) / model.natural_frequency_sd
    assert np.max(np.abs(scores)) < 4.0
    assert np.max(np.abs(model.damping_ratios - modes.zetas) / model.damping_ratio_sd) < 4.0
    (said,) = result.warnings
    assert said.startswith("The natural frequency of mode 1 changed by")
    assert "from the first stamp to the last" in said


@pytest.mark.slow
def test_a_mode_that_changes_over_its_swing_is_not_said_to_change_over_time() -> None:
    modes = ChangingModes("swing")
    # Its third harmonic, which no mode has, could be taken for a twin of the first mode.
    result = identify(modes.record(1), n_modes=2)
    (change,) = result.frequency_changes
    assert (change.mode, change.over) == (0, "swing")
    # Duffing's oscillator: the change with the square of the amplitude, from the frequency of small motion.
    assert abs(2.0 * np.pi * change.from_hz / modes.omegas[0] - 1.0) < 0.1 * abs(change.share)
    amplitude = change.swing / modes.shapes[0, 0]
    assert change.share == pytest.approx(modes.share(1) * (amplitude / 0.01) ** 2, rel=0.1)
