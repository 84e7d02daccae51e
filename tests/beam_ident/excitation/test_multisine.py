"""Lines, detection lines and crest factors of multisines and noise."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ident import BandLimitedNoise, ExcitationError, Multisine, ShapedMultisine
from beam_ident.excitation.crest_optimisation import crest_factor, optimised_phases, schroeder_phases


def numbers(lines_hz: np.ndarray, period_s: float) -> set[int]:
    return set(np.round(lines_hz * period_s).astype(int).tolist())


def test_a_random_odd_multisine_leaves_one_odd_line_out_of_each_group():
    recipe = Multisine(
        start_frequency=1.0,
        end_frequency=20.0,
        line_period=10.0,
        lines="random_odd",
        detection_group=4,
        seed=5,
    )
    excited = numbers(recipe.lines_hz, 10.0)
    left_out = numbers(recipe.odd_detection_lines_hz, 10.0)
    odd = list(range(11, 200, 2))
    assert excited | left_out == set(odd)
    assert not excited & left_out
    for first in range(0, len(odd) - 3, 4):
        assert len(left_out & set(odd[first : first + 4])) == 1
    assert numbers(recipe.even_detection_lines_hz, 10.0) == set(range(min(excited), max(excited) + 1)) - set(
        range(1, 200, 2)
    )
    # A seed draws its own lines: places of all four kinds occur.
    places = {odd.index(line) % 4 for line in left_out}
    assert places == {0, 1, 2, 3}


def test_a_full_multisine_has_no_detection_lines():
    recipe = Multisine(end_frequency=10.0)
    assert len(recipe.even_detection_lines_hz) == len(recipe.odd_detection_lines_hz) == 0
    assert len(Multisine(end_frequency=10.0, lines="odd").odd_detection_lines_hz) == 0


def test_the_sampled_signal_has_power_on_its_lines_alone():
    recipe = Multisine(
        start_frequency=1.0,
        end_frequency=20.0,
        line_period=5.0,
        n_periods=3,
        lines="random_odd",
        detection_group=3,
        seed=2,
    )
    steady = recipe.sample().accelerations[5000:10000]
    spectrum = np.abs(np.fft.rfft(steady)) / len(steady)
    excited = np.round(recipe.lines_hz * 5.0).astype(int)
    others = np.delete(spectrum, excited)
    assert np.max(others) < 1e-9 * np.min(spectrum[excited])


@pytest.mark.parametrize(
    ("band", "odd", "most"),
    [((1.0, 95.0), False, 1.50), ((1.0, 95.0), True, 1.55), ((2.0, 6.0), False, 1.62)],
)
def test_optimised_phases_beat_schroeders_which_beat_random_ones(band, odd, most):
    common = {
        "start_frequency": band[0],
        "end_frequency": band[1],
        "max_displacement": 1.0,
        "lines": "random_odd" if odd else "full",
    }
    crest, schroeder, random = (
        Multisine(phases=kind, **common).crest_factor() for kind in ("crest", "schroeder", "random")
    )
    # Guillaume et al. (1991) report 1.4 to 1.6 for flat spectra; random phases give about sqrt(2 ln N).
    assert 1.2 < crest < most
    assert crest < schroeder - 0.2
    assert schroeder < random


def test_the_reported_crest_factor_is_that_of_the_samples():
    recipe = Multisine(end_frequency=20.0, line_period=5.0, n_periods=3, phases="crest", max_displacement=1.0)
    steady = recipe.sample().accelerations[5000:10000]
    # The held differences take 0.1 % at 20 Hz.
    assert crest_factor(steady) == pytest.approx(recipe.crest_factor(), rel=5e-3)


def test_schroeders_phases_of_a_flat_spectrum_are_his():
    n = np.arange(1, 31)
    expected = np.mod(-np.pi * n * (n - 1) / 30.0, 2 * np.pi)
    difference = np.mod(schroeder_phases(np.ones(30)) - expected + np.pi, 2 * np.pi) - np.pi
    np.testing.assert_allclose(difference, 0.0, atol=1e-10)


def test_one_line_alone_is_a_sine_whatever_its_phase():
    assert np.all(np.isfinite(optimised_phases(np.array([3]), np.array([2.0]))))
    assert Multisine(start_frequency=2.0, end_frequency=2.05, phases="crest").crest_factor() == pytest.approx(
        np.sqrt(2.0), rel=1e-2
    )


def test_the_noise_is_flat_in_its_band_and_gaussian():
    recipe = BandLimitedNoise(
        start_frequency=2.0, end_frequency=50.0, duration=30.0, max_displacement=1.0, seed=11
    )
    values = recipe.sample(2e-3).accelerations[500:14500]
    # 1440 lines with random powers: the level scatters by 1/sqrt(1440) = 3 %.
    assert np.std(values) == pytest.approx(0.3, rel=0.09)
    kurtosis = np.mean(values**4) / np.mean(values**2) ** 2
    assert kurtosis == pytest.approx(3.0, abs=0.2)
    power = np.abs(np.fft.rfft(values)) ** 2
    hz = np.fft.rfftfreq(len(values), 2e-3)
    low, high = power[(hz > 3) & (hz < 25)].mean(), power[(hz > 25) & (hz < 48)].mean()
    assert low == pytest.approx(high, rel=0.2)
    assert power[hz > 55].mean() < 1e-3 * low


def test_the_noises_displacement_ceiling_holds_low_frequencies_down():
    free = BandLimitedNoise(start_frequency=0.2, end_frequency=20.0, max_displacement=1.0).sample(2e-3)
    held = BandLimitedNoise(start_frequency=0.2, end_frequency=20.0, max_displacement=1e-4).sample(2e-3)
    assert np.std(held.positions) < 3e-4  # four octaves of 1e-4 each at most, as a sum of squares 2e-4
    assert np.std(free.positions) > 10 * np.std(held.positions)


def test_band_limited_noise_has_the_lines_of_its_band_and_no_other():
    recipe = BandLimitedNoise(start_frequency=1.0, end_frequency=20.0, duration=4.0)
    np.testing.assert_array_equal(recipe._line_numbers(), np.arange(4, 81))


def test_a_shaped_multisine_has_the_stated_level_and_its_amplitudes_on_its_lines():
    recipe = ShapedMultisine(
        frequencies=(3.0, 5.5, 20.0),
        amplitudes=(1.0, 4.0, 2.0),
        line_phases=(0.1, 2.0, -1.0),
        acceleration=0.7,
        duration=12.0,
        fade=1.0,
        still=0.0,
    )
    steady = recipe.sample().accelerations[1001:11001]  # 10 s, whole cycles of all lines
    spectrum = 2.0 * np.fft.rfft(steady) / len(steady)
    lines = spectrum[np.round(np.array(recipe.frequencies) * 10.0).astype(int)]
    # Differences over half a tick weaken 20 Hz by 0.13 %.
    assert np.sqrt(np.mean(steady**2)) == pytest.approx(0.7, rel=2e-3)
    np.testing.assert_allclose(np.abs(lines) / np.abs(lines[0]), [1.0, 4.0, 2.0], rtol=2e-3)
    # The acceleration of sin(w t + phi) is -sin: its cosine's phase is phi + pi/2, after 1.001 s of delay.
    late = 2.0 * np.pi * np.array(recipe.frequencies) * 1.001
    expected = np.exp(1j * (np.array(recipe.line_phases) + 0.5 * np.pi + late))
    np.testing.assert_allclose(lines / np.abs(lines), expected, atol=0.02)
    assert recipe.line_spacing_hz(4.0) == 2.5
    assert recipe.line_spacing_hz(21.5) == 1.5


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"frequencies": (3.0, 3.0)}, "increasing"),
        ({"frequencies": ()}, "at least one"),
        ({"amplitudes": (1.0,)}, "2, one for each frequency"),
        ({"line_phases": (0.0, 1.0, 2.0)}, "2, one for each frequency"),
        ({"amplitudes": (1.0, 0.0)}, "numbers > 0"),
        ({"fade": 11.0}, "at most half"),
    ],
)
def test_lines_that_do_not_go_together_are_refused(wrong, said):
    right = {"frequencies": (2.0, 3.0), "amplitudes": (1.0, 1.0), "line_phases": (0.0, 0.0)}
    with pytest.raises(ExcitationError, match=said):
        ShapedMultisine(**{**right, **wrong})
