"""Decays that no law of powers describes, from an integrator of their own: named, or right beside what is named."""

from __future__ import annotations

import math

import numpy as np
import pytest

from beam_ident import AmplitudeCurves, EstimationError, OutputSignal, amplitude_curves
from beam_ident.amplitude.decay_fit import DecayProblem
from beam_ident.amplitude.lack_of_fit import LEVEL, lack_of_fit, without_own_swings
from tests.beam_ident.amplitude.oscillators import OMEGA, UNIT, Oscillator, noisy, released

FINE = np.arange(0.0, 15.0, 1.0 / 4000.0)
ZETA = 0.004


def seen(x: np.ndarray, noise: float = 1e-4, limit: float = math.inf) -> OutputSignal:
    """Return every fortieth sample with noise, within the range of a sensor."""
    own = x[::40] + noise * np.random.default_rng(1).standard_normal(len(x[::40]))
    return OutputSignal("z285", "m", FINE[::40], np.clip(own, -limit, limit))


def linear(x: float, v: float) -> float:
    return 2.0 * ZETA * OMEGA * v + OMEGA**2 * x


def stop(x: float, v: float) -> float:
    """A stop that adds 2 % of stiffness beyond half of the swing."""
    return linear(x, v) + 0.02 * OMEGA**2 * math.copysign(max(abs(x) - 0.5 * UNIT, 0.0), x)


def beating(f_hz: float, share: float) -> np.ndarray:
    """Return two linear modes, the second of ``share`` of the first."""
    result = np.zeros(len(FINE))
    for omega, size, phase in ((OMEGA, 1.0, 0.0), (2.0 * np.pi * f_hz, share, 0.5)):
        ringing = np.cos(omega * math.sqrt(1.0 - ZETA**2) * FINE + phase)
        result += size * UNIT * np.exp(-ZETA * omega * FINE) * ringing
    return result


def said(curves: AmplitudeCurves) -> str:
    return " ".join(curves.warnings)


@pytest.mark.slow
def test_noise_alone_is_seldom_accused() -> None:
    chances = []
    for seed in range(5):
        problem = DecayProblem([[noisy(Oscillator(hardening=0.005, quadratic=0.002), 1e-4, seed)]], 0)
        chances.append(lack_of_fit(problem, problem.fit(problem.start(None))))
    assert min(chances) > LEVEL
    assert np.median(chances) > 0.05


def test_own_swings_are_taken_out_and_no_others() -> None:
    x = released(linear) + 2e-3 * np.cos(2.0 * np.pi * 12.0 * FINE)
    problem = DecayProblem([[seen(x)]], 0)
    fit = problem.fit(problem.start(None))
    (left,) = without_own_swings(problem, fit)
    assert np.std(left.values) == pytest.approx(2e-3 / math.sqrt(2.0), rel=0.1)
    swings = np.exp(-1j * OMEGA * left.times_s) @ left.values
    assert abs(swings) < 1e-3 * len(left.values) * 2e-3


@pytest.mark.slow
@pytest.mark.parametrize(("f_hz", "share"), [(4.6, 0.3), (4.45, 0.5)])
def test_two_modes_that_beat_are_told_apart(f_hz: float, share: float) -> None:
    """The curve followed the beat: 0.5 % off in frequency, twenty standard deviations."""
    curves = amplitude_curves(seen(beating(f_hz, share)))
    assert "two modes beat" in said(curves)
    assert curves.is_one_pole
    f = OMEGA * math.sqrt(1.0 - ZETA**2) / (2.0 * np.pi)
    for truth, band in ((f, curves.frequency_band_hz), (ZETA, curves.damping_band)):
        assert np.all((band[0] < truth) & (truth < band[1]))


def test_two_modes_of_one_size_are_refused_by_name() -> None:
    with pytest.raises(EstimationError, match=r"vanish and return.*where two modes beat"):
        amplitude_curves(seen(beating(4.6, 1.0)))


@pytest.mark.slow
def test_what_no_law_of_powers_follows_is_named() -> None:
    """The bands missed the frequency at a stop by 14 standard deviations, and nothing said so."""
    assert "bends more sharply over the amplitude" in said(amplitude_curves(seen(released(stop))))
    assert "the law does not follow the decay" in said(amplitude_curves(seen(released(stop), 1e-5)))
    blow = released(linear, (6.03, 0.02 * UNIT * OMEGA))
    assert "the law does not follow the decay" in said(amplitude_curves(seen(blow)))


@pytest.mark.slow
def test_a_pendulum_is_no_pair_of_modes() -> None:
    def pendulum(x: float, v: float) -> float:
        return 2.0 * ZETA * OMEGA * v + OMEGA**2 * UNIT * math.sin(x / UNIT)

    assert amplitude_curves(seen(released(pendulum))).warnings == ()


@pytest.mark.slow
def test_samples_that_are_no_measurements_are_named() -> None:
    x = released(linear)
    assert "Clipped:" in said(amplitude_curves(seen(x, limit=0.7 * UNIT)))
    stuck = np.where((FINE > 5.0) & (FINE < 5.6), x[20000], x)
    signal = seen(stuck, 0.0)
    assert "is stuck at" in said(amplitude_curves(signal))
    loose = np.where(FINE > 6.0, 0.8 * x, x)
    assert "Misfit of z285" in said(amplitude_curves(seen(loose)))
