"""Modes under the noise that records really have: at any stamps, record by record, with outliers."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from beam_ident import OutputSignal, TimeRecord, identify
from benchmarks.ident.several_records import TwoFilms
from tests.beam_ident.noise.test_outliers import spoiled
from tests.beam_ident.truth import OMEGAS, beam_record


@pytest.fixture(scope="module")
def films() -> TwoFilms:
    return TwoFilms()


def scores(films: TwoFilms, record: TimeRecord | list[TimeRecord]) -> np.ndarray:
    model = identify(record, n_modes=2).model
    found = np.concatenate([model.natural_frequencies, model.damping_ratios])
    return (found - films.truth) / np.concatenate([model.natural_frequency_sd, model.damping_ratio_sd])


def slow_film(films: TwoFilms, seed: int) -> TimeRecord:
    """Return a film at stamps anywhere under Ornstein-Uhlenbeck noise of 0.1 s."""
    rng = np.random.default_rng(seed)
    times = np.sort(rng.uniform(0.01, 8.89, 889))
    noise = rng.standard_normal((889, 2))
    for k, share in enumerate(np.exp(-np.diff(times) / 0.1), start=1):
        noise[k] = share * noise[k - 1] + np.sqrt(1.0 - share**2) * noise[k]
    seen = films.model.simulate(films.hub, times, films.exposure_s) + 4e-6 * noise
    outputs = [
        OutputSignal(n, "m", times, seen[:, j], films.exposure_s) for j, n in enumerate(("root", "tip"))
    ]
    return TimeRecord((films.hub,), tuple(outputs))


@pytest.mark.slow
def test_slow_noise_at_stamps_anywhere_is_weighed_by_its_time_constant(films):
    found = identify(slow_film(films, 1), n_modes=2)
    for output in found.outputs:
        assert "Ornstein-Uhlenbeck" in output.records[0].noise
    every = np.array([scores(films, slow_film(films, seed)) for seed in range(3)])
    assert np.max(np.abs(every)) < 3.6
    assert np.mean(every**2) < 2.2  # twelve scores


@pytest.mark.slow
def test_every_record_has_noise_of_its_own_colour(films):
    quiet, loud = films.records(3, colour=0.0)[0], films.records(4, colour=0.9)[1]
    found = identify([quiet, loud], n_modes=2)
    for output in found.outputs:
        assert output.records[0].noise == ""
        assert "autoregression" in output.records[1].noise
    assert np.max(np.abs(scores(films, [quiet, loud]))) < 3.6


@pytest.mark.slow
def test_outliers_cost_modes_no_more_than_their_samples(films):
    clean = films.records(5)[0]
    known, found = identify(clean, n_modes=2).model, identify(spoiled(clean, 0.05, 2e-4), n_modes=2)
    assert all("outliers" in output.records[0].noise for output in found.outputs)
    moved = np.abs(found.model.natural_frequencies - known.natural_frequencies)
    assert np.all(moved < 0.7 * known.natural_frequency_sd)
    np.testing.assert_allclose(found.model.natural_frequency_sd, known.natural_frequency_sd, rtol=0.15)
    np.testing.assert_allclose(found.model.noise_sd, known.noise_sd, rtol=0.1)


def test_a_gap_in_the_stamps_is_no_neighbourhood(films):
    coloured = films.records(6, colour=0.95)[0]
    kept = np.random.default_rng(0).uniform(size=889) > 0.25
    outputs = [dataclasses.replace(o, values=np.where(kept, o.values, np.nan)) for o in coloured.outputs]
    assert np.max(np.abs(scores(films, TimeRecord(coloured.inputs, tuple(outputs))))) < 3.6


def with_outliers(record: TimeRecord, share: float, size: float, seed: int) -> TimeRecord:
    rng = np.random.default_rng([seed, 6])
    outputs = []
    for own in record.outputs:
        far = rng.random(len(own.values)) < share
        outputs.append(
            dataclasses.replace(own, values=own.values + far * size * rng.standard_normal(len(far)))
        )
    return dataclasses.replace(record, outputs=tuple(outputs))


@pytest.mark.slow
@pytest.mark.parametrize("n_modes", [None, 3])
def test_modes_below_the_outliers_are_found_and_no_output_is_called_late(n_modes):
    # Outliers of 2 mm beside noise of 5 um: least squares sees two modes of three.
    result = identify(with_outliers(beam_record(1), 0.02, 2e-3, 1), n_modes=n_modes)
    model = result.model
    assert model.n_modes == 3
    assert not any(result.doubts)
    assert not np.any(model.output_delays)
    assert np.max(np.abs((model.natural_frequencies - OMEGAS) / model.natural_frequency_sd)) < 4.0
    assert any(said.startswith("Outliers: ") for said in result.warnings)


@pytest.mark.slow
def test_outliers_of_outputs_on_one_clock_feign_no_delays():
    model = identify(with_outliers(beam_record(0), 0.05, 1e-4, 0)).model
    assert model.n_modes == 3
    assert not np.any(model.output_delays)
