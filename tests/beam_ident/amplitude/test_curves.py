"""Curves against what reversals and zero crossings of the same oscillators say, without noise."""

from __future__ import annotations

import json
from functools import cache

import numpy as np
import pytest

from beam_ident import AmplitudeCurves, EstimationError, OutputSignal, amplitude_curves
from tests.beam_ident.amplitude.oscillators import UNIT, Oscillator, noisy

CUBIC = Oscillator(hardening=0.002, quadratic=0.002)
SOFT = Oscillator(hardening=-0.01, quadratic=0.004)
DRY = Oscillator(hardening=0.005, quadratic=0.002, dry=0.0003)


@cache
def truth(oscillator: Oscillator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return oscillator.curves(15.0)


def inside(curves: AmplitudeCurves, oscillator: Oscillator) -> tuple[bool, bool]:
    """Whether the whole of each true curve lies in its band."""
    A, f, zeta = (values[::-1] for values in truth(oscillator))
    seen = (curves.amplitudes > A[0]) & (curves.amplitudes < A[-1])
    result = []
    for values, band in ((f, curves.frequency_band_hz), (zeta, curves.damping_band)):
        expected = np.interp(curves.amplitudes[seen], A, values)
        result.append(bool(np.all((expected >= band[0][seen]) & (expected <= band[1][seen]))))
    return result[0], result[1]


@pytest.mark.parametrize("oscillator", [CUBIC, SOFT, DRY], ids=["cubic", "soft", "dry"])
def test_the_true_curves_lie_in_their_bands(oscillator: Oscillator) -> None:
    found = [inside(amplitude_curves(noisy(oscillator, 1e-4, seed)), oscillator) for seed in range(6)]
    # Six bands of 95 %: two misses of one kind happen once in thirty times.
    assert np.all(np.sum(found, axis=0) >= 4)


@pytest.mark.verify
@pytest.mark.parametrize("oscillator", [CUBIC, SOFT, DRY], ids=["cubic", "soft", "dry"])
@pytest.mark.parametrize("noise", [2e-5, 2e-4])
def test_the_bands_hold_as_often_as_they_say(oscillator: Oscillator, noise: float) -> None:
    found = [inside(amplitude_curves(noisy(oscillator, noise, seed)), oscillator) for seed in range(200)]
    assert np.all(np.mean(found, axis=0) >= 0.91)


@pytest.mark.verify
def test_a_linear_decay_is_called_linear_in_95_percent() -> None:
    verdicts = [amplitude_curves(noisy(Oscillator(), 1e-4, seed)).is_one_pole for seed in range(200)]
    assert 0.91 <= np.mean(verdicts) <= 0.99


def test_verdicts_name_what_changes() -> None:
    linear = amplitude_curves(noisy(Oscillator(), 1e-4, 2))
    assert linear.is_one_pole
    assert linear.verdict.startswith("one pole describes the decay")
    soft = amplitude_curves(noisy(SOFT, 1e-4, 2))
    assert not soft.is_one_pole
    assert "one pole does not describe the decay" in soft.verdict
    assert "m of z285" in soft.verdict
    assert "(-0.99 %)" in soft.verdict


def test_two_decays_share_one_law_and_reach_further() -> None:
    large = noisy(DRY, 1e-4, 1, 5.0)
    t, x = DRY.swing(15.0, 100.0)
    late = slice(800, 1500)  # as if it had been let go at a smaller amplitude
    small = OutputSignal(
        "z285", "m", t[late] - t[800], x[late] + 1e-4 * np.random.default_rng(5).standard_normal(700)
    )
    both = amplitude_curves([[large], [small]])
    alone = amplitude_curves(large)
    assert both.amplitudes[0] < 0.6 * alone.amplitudes[0]
    assert all(inside(both, DRY))


def test_other_outputs_and_modes_stand_beside() -> None:
    first = noisy(CUBIC, 5e-5, 1)
    rng = np.random.default_rng(7)
    other = 2e-3 * np.exp(-1.5 * first.times_s) * np.cos(2 * np.pi * 28.3 * first.times_s + 1.0)
    _, x = CUBIC.swing(15.0, 100.0)
    half = OutputSignal("z225", "m", first.times_s, 0.5 * x - other + 5e-5 * rng.standard_normal(len(x)))
    curves = amplitude_curves([OutputSignal("z285", "m", first.times_s, first.values + other), half])
    assert curves.output_name == "z285"
    assert curves.amplitudes[-1] == pytest.approx(UNIT, rel=0.01)
    assert all(inside(curves, CUBIC))
    assert curves.noise_sd == pytest.approx([5e-5, 5e-5], rel=0.1)
    assert amplitude_curves([first, half], output="z225").amplitudes[-1] == pytest.approx(
        0.5 * UNIT, rel=0.01
    )


def test_an_exposure_does_not_make_the_amplitude_smaller() -> None:
    t, x = CUBIC.swing(15.0, 4000.0)
    mean = np.convolve(x, np.ones(160) / 160.0, mode="same")[200::40]  # 40 ms of 228
    signal = OutputSignal("z285", "m", t[200::40], mean[: len(t[200::40])], exposure_s=0.04)
    curves = amplitude_curves(signal)
    A, f, _ = truth(CUBIC)
    middle = 0.5 * A.max()
    assert curves.frequency_hz_at(middle) == pytest.approx(np.interp(middle, A[::-1], f[::-1]), rel=2e-5)


def test_curves_are_stored_whole() -> None:
    curves = amplitude_curves(noisy(CUBIC, 1e-4, 3))
    again = AmplitudeCurves.from_dict(json.loads(json.dumps(curves.to_dict())))
    assert np.array_equal(again.frequency_band_hz, curves.frequency_band_hz)
    assert again.verdict == curves.verdict


def test_what_cannot_have_a_curve_is_refused() -> None:
    t, x = CUBIC.swing(2.0, 100.0)
    with pytest.raises(EstimationError, match="record a longer decay"):
        amplitude_curves(OutputSignal("z285", "m", t[:70], x[:70]))
    with pytest.raises(EstimationError, match="needs at least 60"):
        amplitude_curves(OutputSignal("z285", "m", t[:40], x[:40]))
    with pytest.raises(EstimationError, match="expected one of z285"):
        amplitude_curves(OutputSignal("z285", "m", t, x), output="z999")
    with pytest.raises(EstimationError, match="frequency_hz is -1"):
        amplitude_curves(OutputSignal("z285", "m", t, x), frequency_hz=-1.0)
    noise = np.random.default_rng(0).standard_normal(500)
    with pytest.raises(EstimationError, match="stand out of the noise"):
        amplitude_curves(OutputSignal("z285", "m", (0.0, 0.01), noise))
    with pytest.raises(EstimationError, match="the same in the same order"):
        amplitude_curves([[noisy(CUBIC, 1e-4, 3)], [OutputSignal("z", "m", t, x)]])
