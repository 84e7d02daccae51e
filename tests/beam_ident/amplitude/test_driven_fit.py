"""Curves of driven oscillators against what the reversals of their free decays say."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from beam_ident import AmplitudeCurves, EstimationError, ModalModel, driven_amplitude_curves, identify
from beam_ident.amplitude.driven_fit import moved
from tests.beam_ident.amplitude.oscillators import OMEGA, Oscillator, driven_record

SOFT = Oscillator(zeta=0.005, hardening=-0.004, quadratic=0.002)
DRY = Oscillator(zeta=0.005, hardening=0.003, quadratic=0.002, dry=0.0004)
LEVELS = (1.0, 0.5, 0.25)


def curves_of(oscillator: Oscillator, seed: int, noise: float, duration_s: float = 12.0) -> AmplitudeCurves:
    records = [
        driven_record(oscillator, 10 * seed + k, level, noise, duration_s) for k, level in enumerate(LEVELS)
    ]
    return driven_amplitude_curves(records, identify(records, n_modes=1).model)


@cache
def truth(oscillator: Oscillator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    A, f, zeta = (values[::-1] for values in oscillator.curves(15.0))
    return A, f, zeta


def inside(curves: AmplitudeCurves, oscillator: Oscillator) -> tuple[bool, bool]:
    """Whether the whole of each true curve, as far as the decay shows it, lies in its band."""
    A, f, zeta = truth(oscillator)
    seen = (curves.amplitudes > A[0]) & (curves.amplitudes < A[-1])
    assert np.count_nonzero(seen) > 20
    result = []
    for values, band in ((f, curves.frequency_band_hz), (zeta, curves.damping_band)):
        expected = np.interp(curves.amplitudes[seen], A, values)
        result.append(bool(np.all((expected >= band[0][seen]) & (expected <= band[1][seen]))))
    return result[0], result[1]


@pytest.mark.slow
@pytest.mark.parametrize("oscillator", [SOFT, DRY], ids=["soft", "dry"])
def test_three_levels_give_the_curves_of_the_decay(oscillator: Oscillator) -> None:
    curves = curves_of(oscillator, 1, 3e-5)
    A, f, zeta = truth(oscillator)
    for place in (0.008, 0.012, 0.018):
        assert curves.frequency_hz_at(place) == pytest.approx(np.interp(place, A, f), rel=3e-5)
        assert curves.damping_ratio_at(place) == pytest.approx(np.interp(place, A, zeta), rel=6e-3)
        # A clock rate that the linear model errs by would be ten deviations and more.
        sd = np.interp(place, curves.amplitudes, curves.frequency_sd_hz)
        assert abs(curves.frequency_hz_at(place) - np.interp(place, A, f)) < 4.0 * sd
    assert not curves.is_one_pole
    assert curves.verdict.startswith("one pole does not describe the data")


@pytest.mark.slow
def test_a_linear_oscillator_has_level_curves() -> None:
    curves = curves_of(Oscillator(zeta=0.01), 3, 1e-4)
    assert curves.is_one_pole
    assert inside(curves, Oscillator(zeta=0.01)) == (True, True)


def test_no_change_of_the_pole_leaves_the_motion() -> None:
    pole, t = OMEGA * complex(-0.01, 1.0), np.arange(0.0, 4.0, 0.01)
    motion = np.exp(1j * 25.0 * t) * (1.0 - np.exp(-t))
    same = moved(pole, t, motion, np.array([pole.imag, 0.0]), np.array([0.0, -pole.real, 0.0]))
    assert np.abs(same - motion).max() < 1e-12


def model() -> ModalModel:
    record = driven_record(Oscillator(zeta=0.05), 1, duration_s=8.0)
    return identify(record, n_modes=1).model


@pytest.mark.slow
def test_one_level_alone_is_refused_with_what_would_do() -> None:
    steady = driven_record(Oscillator(zeta=0.05), 2, level=0.2, duration_s=10.0, band_hz=(4.0, 4.0)).between(
        3.0, 9.0
    )
    with pytest.raises(EstimationError, match="add records at half and at a quarter of this level"):
        driven_amplitude_curves([steady], model())
    with pytest.raises(EstimationError, match="mode is 3; expected an index from 0 to 0"):
        driven_amplitude_curves([steady], model(), mode=3)
    with pytest.raises(EstimationError, match="expected one of z285"):
        driven_amplitude_curves([steady], model(), output="z1")
