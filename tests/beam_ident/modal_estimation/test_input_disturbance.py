from __future__ import annotations

import numpy as np
import pytest

from beam_ident import InputSignal, ModalModel, ModalStructure
from beam_ident.modal.regression import forced_columns
from beam_ident.modal_estimation.input_disturbance import InputDisturbance, Observations
from beam_ident.noise.input_noise import Smoothing
from benchmarks.ident.rig import Rig

PERIOD_S = 2e-3
N_INPUT = 300
OMEGAS, ZETAS = 2.0 * np.pi * np.array([3.0, 14.0]), np.array([0.02, 0.01])
SHARED = np.array([[1.0, 1e-7, 0.8, -0.5], [1.0, -2e-7, 1.2, 0.6]])
SIGMA, VARIANCES = 1e-2, np.array([2e-5, 5e-5])
SCALES = {"base_motion": 1.0, "velocity": 1.0 / 30.0, "acceleration": 1.0 / 900.0, "receptance": 1.0 / 900.0}


def stamps() -> tuple[np.ndarray, np.ndarray]:
    """Return irregular stamps of two outputs, some of them shared."""
    common = 0.02 + 0.01 * np.arange(55) + np.random.default_rng(1).uniform(-1e-3, 1e-3, 55)
    return common, np.delete(common, [7, 8, 30])


def unit_responses(structure: ModalStructure, shared: np.ndarray, exposure_s: float) -> np.ndarray:
    """Return the outputs' rows for a unit sample at every place of the input, by simulation."""
    columns = []
    for k in range(N_INPUT):
        values = np.zeros(N_INPUT)
        values[k] = 1.0
        drive = InputSignal("hub", "", (0.0, PERIOD_S), values, "cubic")
        columns.append(
            np.concatenate(
                [
                    forced_columns([drive], structure, times, exposure_s, OMEGAS, ZETAS) @ own
                    for times, own in zip(stamps(), shared, strict=True)
                ]
            )
        )
    return np.array(columns).T


def distance(found: np.ndarray, expected: np.ndarray) -> float:
    return float(np.linalg.norm(found - expected) / np.linalg.norm(expected))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "exposure_s", "tolerance"),
    [
        # What passes at once is taken as white from frame to frame and apart from what the modes hold.
        ("base_motion", 5e-3, 0.35),
        ("velocity", 0.0, 0.02),
        ("acceleration", 5e-3, 0.02),
        ("receptance", 0.0, 0.02),
    ],
)
def test_the_filter_inverts_the_covariance_of_the_disturbance_and_finds_the_input(
    kind, exposure_s, tolerance
):
    structure = ModalStructure(kind)
    shared = SHARED[:, 0 if structure.has_direct else 1 :]
    sigma = SIGMA / SCALES[kind]
    response = unit_responses(structure, shared, exposure_s)
    sizes = [len(times) for times in stamps()]
    noise = np.repeat(VARIANCES, sizes)
    covariance = np.diag(noise) + sigma**2 * response @ response.T
    rng = np.random.default_rng(0)
    disturbance = response @ (sigma * rng.standard_normal(N_INPUT))
    residuals = np.sqrt(noise) * rng.standard_normal(len(noise)) + disturbance
    expected = np.linalg.solve(covariance, residuals)

    drive = InputSignal("hub", "", (0.0, PERIOD_S), np.zeros(N_INPUT), "cubic", sigma)
    noisy = InputDisturbance(drive, structure, OMEGAS, ZETAS, shared, np.full(2, exposure_s), Smoothing(1e6))
    observations = Observations.of(stamps(), [np.arange(n) for n in sizes])
    taken_out = noisy.filter(observations, VARIANCES)
    split = [residuals[: sizes[0], None].copy(), residuals[sizes[0] :, None].copy()]
    taken_out.whiten(split)
    innovations = np.concatenate(split)[:, 0]
    assert innovations @ innovations == pytest.approx(residuals @ expected, rel=0.02)
    assert residuals @ (residuals / noise) > 1.3 * residuals @ expected  # what it is without the filter
    taken_out.weigh(split)
    weighed = np.concatenate(split)[:, 0]
    assert distance(np.sqrt(noise) * weighed, np.sqrt(noise) * expected) < tolerance
    added = noisy.most_likely(observations, [split[0][:, 0], split[1][:, 0]])
    assert distance(response @ added, response @ (sigma**2 * response.T @ expected)) < tolerance


def test_what_passes_at_once_is_the_noise_that_drives_the_modes():
    rig = Rig()
    rng, sd, n = np.random.default_rng(1), 20e-6, 3
    full = rig.full
    omegas, zetas, residues = full.natural_frequencies[:n], full.damping_ratios[:n], full.residues[:, :n]
    left_out = np.sum(full.residues[:, n:] / full.natural_frequencies[n:] ** 2, axis=1)
    terms, size = full.residual_terms + left_out, 2 * n + 2 + 3 * (n + 2)
    found = (omegas, zetas, residues, terms, np.ones(3), 0.0, 0.0, np.zeros((size, size)), np.ones(3))
    model = ModalModel("base_motion", "hub", rig.names, *found)
    noise = sd * rng.standard_normal(len(rig.excitation.positions))
    drive = InputSignal("hub", "m", (0.0, 1e-3), noise, "cubic", sd)
    smoothing = Smoothing(96.0)
    own = 5e-6 * rng.standard_normal((len(rig.stamps), 3))
    left = own - model.simulate(smoothing.of(drive), rig.stamps, rig.exposure)
    shared = np.column_stack([np.ones(3), terms, residues])
    disturbance = InputDisturbance(
        drive, ModalStructure(), omegas, zetas, shared, np.full(3, rig.exposure), smoothing
    )
    observations = Observations.of([rig.stamps] * 3, [np.arange(len(rig.stamps))] * 3)
    white = [column[:, None].copy() for column in left.T]
    disturbance.filter(observations, np.full(3, 25e-12)).whiten(white)
    seen = np.concatenate(white, axis=1)[50:-50]
    correlations = [seen[lag:].T @ seen[: len(seen) - lag] / len(seen) for lag in (0, 1, 2)]
    correlations[0] -= np.eye(3)
    # Taken for independent, the two made innovations correlate by 0.5; what is left is the window's form, and 0.02
    # of chance.
    assert np.max(np.abs(correlations)) < 0.15


@pytest.mark.parametrize("kind", ["velocity", "acceleration", "force", "receptance"])
def test_outputs_without_noise_of_their_own_leave_a_filter_of_finite_gains(kind):
    # Six outputs of four states: of what they show, two directions at least are noise of their own alone.
    rng, n = np.random.default_rng(3), 6
    structure = ModalStructure(kind)
    shared = np.column_stack([np.ones(n), 1e-7 * rng.standard_normal(n), rng.uniform(-1.0, 1.0, (n, 2))])
    shared = shared[:, 0 if structure.has_direct else 1 :]
    drive = InputSignal("hub", "", (0.0, PERIOD_S), np.zeros(4000), "cubic", 1.0)
    noisy = InputDisturbance(drive, structure, OMEGAS, ZETAS, shared, np.full(n, 5e-3), Smoothing(1e6))
    times = 0.02 + 0.01 * np.delete(np.arange(600), slice(200, 400))
    observations = Observations.of([times] * n, [np.arange(len(times))] * n)
    for own in (1e-10, 1e-14, 1e-18):
        taken_out = noisy.filter(observations, np.full(n, own**2))
        columns = list(rng.standard_normal((n, len(times), 1)))
        taken_out.whiten(columns)
        taken_out.weigh(columns)
        assert np.all(np.isfinite(columns))
        assert np.isfinite(taken_out.log_determinant)
