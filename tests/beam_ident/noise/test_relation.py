from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import lfilter

from beam_ident import EstimationError, estimate_transfer_function, identify, select_transfer_function
from beam_ident.noise.relation import innovation_criterion, is_related
from benchmarks.ident.unrelated_input import unrelated_record

RNG = np.random.default_rng(4)
TIMES = 0.01 * np.arange(2000)


@pytest.mark.parametrize("colour", [[1.0], [1.0, -0.9], [1.0, -1.8513, 0.9948]])
def test_the_criterion_is_that_of_the_innovations_whatever_the_colour(colour):
    noise = lfilter([1.0], colour, 3.0 * RNG.standard_normal(4000))[2000:]
    expected = 2000 * math.log(9.0) + (len(colour) - 1) * math.log(2000)
    # log of a variance from n samples scatters by sqrt(2 / n): 63 over 2000 samples.
    assert abs(innovation_criterion([noise]) - expected) < 200.0


def test_a_response_that_noise_hides_to_the_eye_is_related():
    drive = RNG.standard_normal(2000)
    response = lfilter([0.02], [1.0, -1.8, 0.95], drive)
    noise = RNG.standard_normal(2000) * 2.0 * np.std(response)
    assert is_related([(TIMES, response + noise)], [noise], 4, False, False)
    assert not is_related([(TIMES, noise)], [noise], 4, False, False)


@pytest.mark.parametrize("first", [45, 60, 150])
def test_a_blow_at_the_beginning_is_seen_where_the_model_is_only_nearly_right(first):
    """The longest means of the past reach over a tenth of the record: what is in it counts all the same."""
    blow = np.where(np.arange(2000) == first, 1.0, 0.0)
    swing = [0.0, 0.0]
    for push in blow:  # the air brakes with the square of the speed
        speed = swing[-1] - swing[-2]
        swing.append(1.9 * swing[-1] - 0.997 * swing[-2] + push - 0.02 * abs(speed) * speed)
    measured = np.array(swing[2:]) + 0.003 * RNG.standard_normal(2000)
    linear = lfilter([1.0], [1.0, -1.9, 0.994], blow)
    left = measured - linear * (linear @ measured) / (linear @ linear)
    assert is_related([(TIMES, measured)], [left], 4, False, False)


def test_drift_that_a_model_has_beside_the_input_does_not_count_for_it():
    noise = RNG.standard_normal(2000)
    assert not is_related([(TIMES, 40.0 + 3.0 * TIMES + noise)], [noise], 5, True, True)


@pytest.mark.parametrize("seed", [11, 12, 101, 155])
def test_noise_that_rings_slowly_beside_the_sampling_on_a_drift_is_no_response(seed):
    # One period is 160 samples, four times as long as the longest autoregression.
    rng, times = np.random.default_rng(seed), 0.002 * np.arange(10_000)
    zeta = rng.choice([0.003, 0.006, 0.012])
    pole = np.exp(2.0 * np.pi * 3.1 / 500.0 * (-zeta + 1j * math.sqrt(1.0 - zeta**2)))
    ringing = [1.0, -2.0 * pole.real, abs(pole) ** 2]
    measured = lfilter([1.0], ringing, rng.standard_normal(30_000))[20_000:]
    measured = measured / np.std(measured) + 0.003 * rng.standard_normal(10_000)
    measured += np.cumsum(rng.standard_normal(10_000)) * 10.0 ** rng.uniform(-3.0, -1.5)
    forced = lfilter([1.0], ringing, np.sign(rng.standard_normal(1000)).repeat(10))
    free = pole ** np.arange(10_000)
    model = np.stack([forced, np.append(0.0, forced[:-1]), free.real, free.imag], axis=1)
    model /= np.linalg.norm(model, axis=0)
    left = measured - model @ np.linalg.lstsq(model, measured, rcond=None)[0]
    assert not is_related([(times, measured)], [left], 6, False, False)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 3, 6, 13])
def test_noise_that_rings_is_no_model_of_an_unrelated_input(seed):
    record = unrelated_record(seed)
    for refused in (
        lambda: select_transfer_function(record, range(1, 3)),
        lambda: identify(record, "receptance"),
    ):
        with pytest.raises(EstimationError):
            refused()
    found = estimate_transfer_function(record, 2, 1)
    assert any("no more than chance" in said for said in found.warnings)
    found = identify(record, "receptance", n_modes=1)
    assert any("no more than chance" in said for said in found.warnings)
