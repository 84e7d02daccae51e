"""Draws of an input's noise against the moments of quadratic forms in it."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ident import InputSignal, ModalStructure, OutputSignal, TimeRecord
from beam_ident.modal.regression import ClockState, ModalRegression, forced_columns
from beam_ident.modal_estimation.noise_draws import FitPoint, NoiseDraws, Stride
from beam_ident.noise.input_noise import Smoothing

STRUCTURE = ModalStructure(
    "receptance", has_residual=False, has_offset=False, has_ramp=False, has_free_response=False
)
OMEGAS, ZETAS = np.array([20.0]), np.array([0.05])
PERIOD_S, N_INPUT, SIGMA, OWN = 0.01, 400, 0.3, 2e-5
STAMPS = 0.05 + 0.02 * np.arange(190)
RESIDUE = 0.5


def regression_on(values: np.ndarray) -> ModalRegression:
    drive = InputSignal("u", "N", (0.0, PERIOD_S), values, "cubic", SIGMA)
    return ModalRegression(
        [TimeRecord((drive,), (OutputSignal("y", "m", STAMPS, np.sin(STAMPS)),))], STRUCTURE, ("u",)
    )


def passed() -> np.ndarray:
    """Return what every sample of the input does to the rows, for a residue of one, by simulation."""
    columns = []
    for sample in np.eye(N_INPUT):
        drive = InputSignal("u", "N", (0.0, PERIOD_S), sample, "cubic")
        columns.append(forced_columns([drive], STRUCTURE, STAMPS, 0.0, OMEGAS, ZETAS)[:, 0])
    return np.array(columns).T


def test_draws_know_the_moments_of_noise_that_derivatives_and_residuals_share():
    draws = NoiseDraws(
        regression_on(np.zeros(N_INPUT)),
        Smoothing(1e6),
        lambda values: regression_on(values[0]),
        1,
        (False, False),
    )
    point = FitPoint(OMEGAS, ZETAS, ClockState(0.0, 0.0), (np.array([RESIDUE]),))
    score = draws.score(point, [np.full(len(STAMPS), OWN)], [], [])
    # The derivative by the residue is P nu, the residual e - b P nu.
    response = passed()
    power = SIGMA**2 * np.sum(np.square(response))
    scatter = OWN**2 * power + 2.0 * RESIDUE**2 * SIGMA**4 * np.sum(np.square(response @ response.T))
    place = -1  # behind log omega and zeta
    assert score.information[place, place] == pytest.approx(power, rel=0.3)
    missed = score.mean[place] + RESIDUE * power
    assert abs(missed) < 3.0 * np.sqrt(score.mean_error[place, place])
    # 16 draws know a variance to 35 %; a mean, over the same, to a quarter of its deviation.
    assert score.scatter[place, place] == pytest.approx(scatter, rel=0.8)
    np.testing.assert_allclose(score.mean_error, score.scatter / 16.0)
    longer = score.of_longer(3.0)
    np.testing.assert_allclose(longer.scatter + longer.mean_error, (3.0 + 9.0 / 16.0) * score.scatter)


@pytest.mark.parametrize("overshoot", [1.0, 3.0, 6.0, 40.0])
def test_strides_settle_where_every_step_goes_too_far(overshoot):
    root, point = np.array([20.3, 0.04]), np.array([20.0, 0.05])
    stride = Stride(np.zeros(2))
    for _ in range(25):
        here = FitPoint(point[:1], point[1:], ClockState(0.0, 0.0), ())
        error = (root - point) / [point[0], 1.0]
        stride = stride.following(overshoot * error, here)
        assert np.abs(stride.change).max() <= 0.5 * point[1] + 1e-12
        point = point + stride.change * [point[0], 1.0]
    assert point == pytest.approx(root, rel=1e-4)
