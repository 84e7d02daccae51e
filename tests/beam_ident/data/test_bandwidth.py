"""The excited band is where the energy is, wherever in the record that is."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ident import InputSignal, LogChirp
from beam_ident.data.bandwidth import excited_band

PERIOD_S = 1e-4
DURATION_S = 2.0


def blow(start_s: float, width_s: float) -> np.ndarray:
    since = (PERIOD_S * np.arange(round(DURATION_S / PERIOD_S)) - start_s) / width_s
    return np.where((since > 0.0) & (since < 1.0), np.sin(np.pi * since) ** 2, 0.0)


def band_of(values: np.ndarray, differentiations: int = 0, sigma: float = 0.0):
    drive = InputSignal("f", "", (0.0, PERIOD_S), values, "linear", sigma)
    return excited_band(drive, differentiations, DURATION_S, 1000.0)


@pytest.mark.parametrize("start_s", [2e-4, 3e-3, 0.1, 1.0, 1.99])
@pytest.mark.parametrize("width_s", [1e-3, 5e-3])
def test_a_blow_excites_the_same_band_wherever_it_falls(start_s, width_s):
    band = band_of(blow(start_s, width_s))
    # The squared sine of width T has its first zero at 2/T, and lies 30 dB below its peak at 1.6/T.
    assert band.is_excited
    assert band.low_hz < 3.0
    assert 1.3 / width_s < band.high_hz < 3.5 / width_s


def test_a_decaying_burst_at_the_start_is_found():
    times = PERIOD_S * np.arange(round(DURATION_S / PERIOD_S))
    band = band_of(np.exp(-times / 0.02) * np.sin(2.0 * np.pi * 300.0 * times))
    assert band.low_hz < 300.0 < band.high_hz < 1500.0


def test_a_quick_move_of_the_base_at_the_start_is_found():
    position = np.cumsum(blow(5e-4, 0.02)) * PERIOD_S
    late = np.cumsum(blow(0.9, 0.02)) * PERIOD_S
    assert band_of(position, 2).high_hz > 40.0
    assert band_of(position, 2).high_hz == pytest.approx(band_of(late, 2).high_hz, rel=0.5)


def test_a_short_blow_is_no_standstill_and_noise_is():
    rng = np.random.default_rng(0)
    noise = rng.standard_normal(round(DURATION_S / PERIOD_S))
    # A blow of 50 standard deviations hardly moves the root mean square over two seconds.
    assert band_of(noise + 50.0 * blow(1.0, 1e-3), sigma=1.0).is_excited
    assert not band_of(noise, sigma=1.0).is_excited


@pytest.mark.first_case
@pytest.mark.parametrize(("start_s", "length_s"), [(0.119, 0.44), (5.619, 0.06), (9.219, 0.8)])
def test_a_rough_bridge_over_a_gap_is_no_excitation(start_s, length_s):
    # An encoder of 0.1 um: what fills the gap moves as little as it should, and shakes.
    positions = LogChirp(duration=10.0, still=4.0).sample(1e-3).positions
    positions = 1e-7 * np.round(positions / 1e-7)
    first = round(start_s / 1e-3) + 1
    positions[first : first + round(length_s / 1e-3)] = np.nan
    drive = InputSignal("hub", "m", (0.0, 1e-3), positions, "cubic", 1e-7 / np.sqrt(12.0))
    band = excited_band(drive, 2, 14.0, 100.0)
    assert band.low_hz < 1.0
    assert 50.0 < band.high_hz < 100.0


@pytest.mark.parametrize("seed", [5, 6, 7])
def test_many_short_gaps_hide_nothing_that_a_sweep_excites_between_them(seed):
    # With 50 lost messages of 20 ms no piece between two is as long as the sweep takes to pass.
    positions = LogChirp(duration=8.0, still=3.0).sample(1e-3).positions
    positions = 1e-7 * np.round(positions / 1e-7)
    n_messages = len(positions) // 20
    lost = 20 * np.random.default_rng(seed).choice(np.arange(3, n_messages - 3), 50, replace=False)
    positions[(lost[:, None] + np.arange(20)).ravel()] = np.nan
    drive = InputSignal("hub", "m", (0.0, 1e-3), positions, "cubic", 1e-7 / np.sqrt(12.0))
    band = excited_band(drive, 2, 11.0, 100.0)
    # The sweep goes from 1 to 95 Hz; its last turns may be lost.
    assert band.low_hz < 0.5
    assert 85.0 < band.high_hz < 120.0


def test_an_input_that_moved_while_nobody_heard_of_it_has_a_band_all_the_same():
    positions = np.concatenate([np.zeros(400), np.full(40, np.nan), np.full(600, 0.01)])
    band = excited_band(InputSignal("hub", "m", (0.0, 1e-3), positions, "cubic"), 2, 1.0, 100.0)
    assert 0.0 < band.low_hz < band.high_hz < 500.0
