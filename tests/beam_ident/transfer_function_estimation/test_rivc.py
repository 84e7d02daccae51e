from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import cholesky, solve_triangular, toeplitz
from scipy.signal import lfilter

from beam_ident import EstimationError, OutputSignal, TimeRecord, estimate_transfer_function
from beam_ident.noise.noise_model import Whitening
from benchmarks.ident.forced_beam import ForcedBeam
from benchmarks.ident.noise_models import coloured
from tests.beam_ident.rao_garnier import PARAMETERS, PERIOD_S, benchmark_record, noise_level, prbs, response

NOISE = np.array([1.0, -1.6, 0.8])


def noisy_record(seed: int, snr_db: float = 10.0) -> TimeRecord:
    clean = response(prbs(2000))
    values = clean + noise_level(clean, snr_db) * coloured(seed, 2000, [1.0], NOISE.tolist())
    return TimeRecord(benchmark_record(0, 10.0).inputs, (OutputSignal("y", "", (0.0, PERIOD_S), values),))


def test_whitening_is_the_inverse_root_of_the_noise_covariance():
    impulse = np.zeros(4000)
    impulse[0] = 1.0
    shape = lfilter([1.0], NOISE, impulse)
    covariance = toeplitz([float(shape[k:] @ shape[: 4000 - k]) for k in range(30)])
    columns = np.random.default_rng(0).standard_normal((30, 2))
    expected = solve_triangular(cholesky(covariance, lower=True), columns, lower=True)
    found = Whitening(NOISE, 0.1 * np.arange(30)).apply(columns)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)


def test_a_gap_begins_a_new_run():
    times = 0.1 * np.delete(np.arange(40), [17, 18])
    columns = np.random.default_rng(1).standard_normal((38, 1))
    found = Whitening(NOISE, times).apply(columns)
    np.testing.assert_allclose(found[:17], Whitening(NOISE, times[:17]).apply(columns[:17]))
    np.testing.assert_allclose(found[17:], Whitening(NOISE, times[17:]).apply(columns[17:]))


def test_the_noise_is_identified_beside_the_system():
    found = estimate_transfer_function(noisy_record(2), 4, 1, method="rivc")
    assert found.converged
    assert found.method == "rivc"
    np.testing.assert_allclose(found.noise_coefficients[1:3], NOISE[1:], atol=0.08)
    assert found.whiteness.is_white
    assert found.model.noise_sd == pytest.approx(np.std(found.residuals))
    np.testing.assert_allclose(found.modelled + found.residuals, found.measured)
    plain = estimate_transfer_function(noisy_record(2), 4, 1)
    assert not plain.whiteness.is_white
    assert found.bic < plain.bic - 1000.0
    scores = (found.model.parameters[:6] - PARAMETERS) / found.model.standard_deviations[:6]
    assert np.max(np.abs(scores)) < 4.0


def test_the_fast_mode_of_a_beam_gains_what_its_noise_lacks():
    beam = ForcedBeam()
    clean = beam.model.simulate(beam.drive, beam.period * np.arange(beam.n))[:, 0]
    errors = []
    for seed in range(2):
        values = clean + 0.1 * np.std(clean) * coloured(seed, beam.n, [1.0], [1.0, -0.95])
        record = TimeRecord((beam.drive,), (OutputSignal("tip", "m", (0.0, beam.period), values),))
        models = [
            estimate_transfer_function(record, 6, 4, method).model for method in ("output_error", "rivc")
        ]
        errors.append([abs(model.modes()[0][2] / beam.omegas[2] - 1.0) for model in models])
    plain, refined = np.sqrt(np.mean(np.square(errors), axis=0))
    # AR(1) of 0.95 leaves 7 % of white noise's power at 40 Hz: deviations fall to a quarter.
    assert refined < 0.6 * plain


def test_white_noise_gets_no_model_and_the_same_estimate():
    found = estimate_transfer_function(benchmark_record(1, 10.0), 4, 1, method="rivc")
    plain = estimate_transfer_function(benchmark_record(1, 10.0), 4, 1)
    assert len(found.noise_coefficients) == 1
    np.testing.assert_allclose(
        found.model.parameters, plain.model.parameters, atol=2e-3 * np.max(plain.model.standard_deviations)
    )


def test_irregular_stamps_are_refused_with_the_remedy():
    output = benchmark_record(0, 10.0).outputs[0]
    times = output.times_s + 1e-3 * np.random.default_rng(0).uniform(size=2000)
    record = TimeRecord(benchmark_record(0, 10.0).inputs, (OutputSignal("y", "", times, output.values),))
    with pytest.raises(EstimationError, match="takes stamps as they are"):
        estimate_transfer_function(record, 4, 1, method="rivc")
