"""Precision that is predicted before a fit, against the standard deviations that the fit states."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beam_ident import InputSignal, LogChirp, OutputSignal, TimeRecord, identify
from beam_ident.design.precision import Observation, predicted_model, predicted_precision
from tests.beam_ident.design.test_spectrum import two_modes
from tests.beam_ros.signals.foreign_bags import DAMPING_RATIOS, FREQUENCIES_HZ, shaken

NOISE = 5e-6


def record(duration_s: float) -> TimeRecord:
    beam = shaken(duration_s, 4)
    noise = NOISE * np.random.default_rng(5).standard_normal(len(beam.times_s[::10]))
    drive = InputSignal("hub", "m", beam.times_s, beam.base, "cubic")
    seen = OutputSignal("tip", "m", beam.times_s[::10], beam.displacement[::10] + noise)
    return TimeRecord((drive,), (seen,))


def test_the_prediction_is_what_the_fit_states() -> None:
    own = record(5.0)
    # Poles a part in a thousand off, as theory may be.
    omegas, zetas = 2.0 * np.pi * FREQUENCIES_HZ * 1.0003, DAMPING_RATIOS * 1.05
    predicted = predicted_precision([own], "base_motion", omegas, zetas, {"tip": NOISE}, 50e-6)
    model = identify(own, n_modes=2).model
    # The fit's noise is that of one record, and its poles are not those that were assumed.
    np.testing.assert_allclose(predicted.omega_sd, model.natural_frequency_sd, rtol=0.25)
    np.testing.assert_allclose(predicted.zeta_sd, model.damping_ratio_sd, rtol=0.25)


def test_twice_the_noise_is_half_the_precision_and_a_mode_beyond_the_excitation_is_unknown() -> None:
    own = record(3.0)
    omegas = 2.0 * np.pi * FREQUENCIES_HZ
    one, two = (
        predicted_precision([own], "base_motion", omegas, DAMPING_RATIOS, {"tip": k * NOISE}) for k in (1, 2)
    )
    np.testing.assert_allclose(two.omega_sd, 2.0 * one.omega_sd)
    # Above the excitation nothing is seen of a mode that is not there: its damping is known to no digit.
    three = [np.append(omegas, 2.0 * np.pi * 140.0), np.append(DAMPING_RATIOS, 0.005)]
    beyond = predicted_precision([own], "base_motion", *three, {"tip": NOISE})
    assert not beyond.zeta_sd[2] < 0.5 * 0.005
    assert beyond.zeta_sd[0] < 0.01 * DAMPING_RATIOS[0]


@pytest.mark.slow
def test_noise_on_the_input_counts_as_the_covariance_that_it_gives_the_outputs():
    """Against slopes from differences and a covariance from the response to every sample of the input."""
    model = two_modes()
    observation = Observation(50.0, {"low": 5e-6, "tip": 5e-6}, 0.0, 0.0, 0.0, input_sd=5e-7)
    recipe = LogChirp(start_frequency=3.0, end_frequency=30.0, duration=2.0, still=1.0)
    drive = recipe.sample(5e-3).input_signal("position")
    times, step = observation.stamps(drive.span_s[1]), 1e-4

    def moved(name: str, factors: np.ndarray) -> np.ndarray:
        own = replace(model, **{name: getattr(model, name) * factors})
        return (own.simulate(drive, times) - model.simulate(drive, times)).T.ravel() / step

    columns = [moved("natural_frequencies", 1.0 + step * row) for row in np.eye(2)]
    columns += [moved("damping_ratios", 1.0 + step * row) for row in np.eye(2)]
    columns += [moved("gains", 1.0 + step * row) for row in np.eye(2)]
    columns += [moved("residues", 1.0 + step * row.reshape(2, 2)) for row in np.eye(4)]
    free = np.exp(np.outer(times, model.poles))
    acceleration = np.gradient(np.gradient(drive.values, 5e-3), 5e-3)[np.rint(times / 5e-3).astype(int)]
    own = np.column_stack([np.ones(len(times)), times, free.real, free.imag, acceleration])
    slopes = np.concatenate([np.array(columns).T, np.kron(np.eye(2), own)], axis=1)
    samples = np.eye(len(drive.values))
    passed = [
        model.simulate(InputSignal("hub", "m", (0.0, 5e-3), one, "cubic"), times).T.ravel() for one in samples
    ]
    covariance = 5e-6**2 * np.eye(2 * len(times)) + 5e-7**2 * np.array(passed).T @ np.array(passed)
    size = np.linalg.norm(slopes, axis=0)
    slopes /= size
    expected = np.sqrt(np.diag(np.linalg.inv(slopes.T @ np.linalg.solve(covariance, slopes)))) / size
    found = predicted_model(model, drive, observation)
    sds = found.standard_deviations[:4] / model.parameters[:4]
    np.testing.assert_allclose(sds, expected[:4], rtol=0.05)
    blind = predicted_model(model, drive, replace(observation, input_sd=0.0))
    assert np.all(found.standard_deviations[:2] > 1.3 * blind.standard_deviations[:2])
