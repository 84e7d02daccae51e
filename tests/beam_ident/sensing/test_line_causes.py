"""What residuals of lines look like: a sensor's delay and filters are named, missing modes are not taken for one."""

from __future__ import annotations

import re

import numpy as np
import pytest

from beam_ident import FrequencyRecord, Prior, fit_frequency_modes, fit_frequency_transfer_function

OMEGAS = 2.0 * np.pi * np.arange(0.2, 15.0, 0.1)
S = 1j * OMEGAS
ONE = 400.0 / (S**2 + 2.0 * 0.03 * 20.0 * S + 400.0)
TWO = ONE + 0.3 * 2500.0 / (S**2 + 2.0 * 0.02 * 50.0 * S + 2500.0)
SENSORS = {
    "late": (np.exp(-0.004 * S), r"seen (3\.[5-9]|4\.?[0-5]?)\d* ms late"),
    "early": (np.exp(0.004 * S), r"seen -(3\.[5-9]|4\.?[0-5]?)\d* ms late"),
    "low-pass": (1.0 / (1.0 + 0.003 * S), r"seen (2\.[3-9]|3\.?[0-3]?)\d* ms late"),
    "high-pass": (S / (S + 2.0 * np.pi * 0.05), r"high-pass .* at about 0\.0(4[5-9]|5[0-5]?) Hz"),
}


def lines(response: np.ndarray, seed: int = 0, noise: float = 0.01, is_known: bool = True) -> FrequencyRecord:
    """Return a response with relative noise of its own at every line."""
    rng = np.random.default_rng(seed)
    size = noise * np.abs(response)
    errors = size / np.sqrt(2.0) * (rng.standard_normal(len(S)) + 1j * rng.standard_normal(len(S)))
    return FrequencyRecord(OMEGAS, response + errors, size**2 if is_known else None)


@pytest.mark.parametrize("is_known", [True, False])
@pytest.mark.parametrize("sensor", SENSORS)
def test_what_a_sensor_does_is_named_with_its_size(sensor: str, is_known: bool) -> None:
    through, says = SENSORS[sensor]
    record = lines(TWO * through, is_known=is_known)
    for found in (
        fit_frequency_modes(record, "receptance", n_modes=2),
        fit_frequency_transfer_function(record, 4, 2),
    ):
        said = " ".join(found.warnings)
        assert re.search(says, said), said


@pytest.mark.slow
def test_a_sound_response_has_no_cause() -> None:
    said = []
    for seed in range(60):
        record = lines(TWO, seed, is_known=seed % 2 == 0)
        said += fit_frequency_modes(record, "receptance", n_modes=2).warnings
        said += fit_frequency_transfer_function(record, 4, 2).warnings
    assert not [text for text in said if "Misfit" in text]


def test_a_latency_that_is_estimated_is_none() -> None:
    record = lines(TWO * np.exp(-0.004 * S))
    found = fit_frequency_modes(record, "receptance", n_modes=2, latency=Prior(0.0, 0.01))
    assert not [text for text in found.warnings if "late" in text]


def test_a_mode_that_is_missing_is_no_sensor() -> None:
    for seed in range(6):
        said = fit_frequency_modes(lines(TWO, seed), "receptance", n_modes=1).warnings
        assert any("modes or distortion are not in the model" in text for text in said)
        assert not [text for text in said if "Misfit" in text]


def test_standard_deviations_count_what_is_left_as_noise() -> None:
    sound, spoilt = (
        fit_frequency_transfer_function(lines(own), 2, 0) for own in (ONE, ONE * np.exp(-0.004 * S))
    )
    assert spoilt.misfit.inflation > 3.0
    grown = spoilt.model.standard_deviations[0] / sound.model.standard_deviations[0]
    assert grown == pytest.approx(np.sqrt(spoilt.misfit.inflation), rel=0.2)
