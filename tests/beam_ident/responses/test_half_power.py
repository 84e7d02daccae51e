from __future__ import annotations

import numpy as np
import pytest

from beam_ident import EstimationError
from beam_ident.data.frequency_record import FrequencyRecord
from beam_ident.responses.half_power import half_power_damping

OMEGA, ZETA = 2 * np.pi * 10.0, 0.01


def receptance(omegas):
    return FrequencyRecord(omegas, 1.0 / (OMEGA**2 - omegas**2 + 2j * ZETA * OMEGA * omegas))


def test_a_fine_response_gives_the_damping():
    found = half_power_damping(receptance(np.linspace(50.0, 75.0, 4001)))
    # The formula itself is off by 1.5 zeta^2 relative.
    assert found.damping_ratio == pytest.approx(ZETA, rel=3e-4)
    assert found.natural_frequency == pytest.approx(OMEGA, rel=3e-4)
    assert found.is_resolved


@pytest.mark.parametrize("shift", [0.0, 0.25, 0.5, 0.75])
@pytest.mark.parametrize("lines", [3.0, 6.0])
def test_the_bias_of_coarse_lines_is_within_what_is_stated(lines, shift):
    spacing = 2 * ZETA * OMEGA / lines
    omegas = OMEGA + spacing * (np.arange(-60, 61) + shift)
    found = half_power_damping(receptance(omegas))
    # Straight lines between coarse points cut the flanks: a few per cent more at three lines a band.
    assert found.damping_ratio / ZETA - 1.0 < found.largest_bias + 0.06
    assert found.damping_ratio / ZETA - 1.0 > -0.03
    assert found.is_resolved == (lines > 5.0)


def test_the_peak_that_is_meant_can_be_named():
    omegas = np.linspace(20.0, 100.0, 8001)
    second = 0.2 / (40.0**2 - omegas**2 + 2j * 0.02 * 40.0 * omegas)
    record = FrequencyRecord(omegas, receptance(omegas).response[:, 0, 0] + second)
    assert half_power_damping(record).natural_frequency == pytest.approx(OMEGA, rel=1e-3)
    assert half_power_damping(record, near_hz=6.4).natural_frequency == pytest.approx(40.0, rel=1e-2)


def test_a_peak_without_flanks_is_refused():
    with pytest.raises(EstimationError, match="does not fall to half power"):
        half_power_damping(receptance(OMEGA + np.linspace(-0.2, 0.2, 21)))
    with pytest.raises(EstimationError, match="no peak"):
        half_power_damping(receptance(np.linspace(1.0, 20.0, 50)))


def test_a_line_that_noise_may_have_lifted_is_no_peak():
    omegas = np.linspace(50.0, 75.0, 401)
    response = receptance(omegas).response[:, 0, 0].copy()
    variance = np.full(len(omegas), (0.01 * np.max(np.abs(response))) ** 2)
    response[20] = 3.0 * np.max(np.abs(response))  # hum, over an input that hardly has that line
    variance[20] = abs(response[20]) ** 2
    found = half_power_damping(FrequencyRecord(omegas, response, variance[:, None, None]))
    assert found.natural_frequency == pytest.approx(OMEGA, rel=1e-3)
    with pytest.raises(EstimationError, match="3 standard deviations"):
        half_power_damping(FrequencyRecord(omegas, response, 1e4 * variance[:, None, None]))


def test_of_several_outputs_the_first_is_read_where_none_is_named():
    omegas = np.linspace(50.0, 75.0, 4001)
    other = 1.0 / (OMEGA**2 - omegas**2 + 2j * 0.03 * OMEGA * omegas)
    both = np.stack([receptance(omegas).response[:, 0, 0], other], axis=1)[:, :, None]
    record = FrequencyRecord(omegas, both, output_names=("light", "heavy"))
    assert half_power_damping(record).damping_ratio == pytest.approx(ZETA, rel=1e-3)
    assert half_power_damping(record, output_name="heavy").damping_ratio == pytest.approx(0.03, rel=3e-3)
