"""Decays through bent sensors, whose products are known in closed form."""

from __future__ import annotations

import json

import numpy as np
import pytest

from beam_ident import FreeDecay, OutputSignal, fit_free_decay

TIMES = np.arange(1200) / 100.0
HERTZ = np.array([4.4, 27.5])
ZETAS = np.array([0.006, 0.004])


def decay(square: float, cube: float, second: float = 0.0, hertz: np.ndarray = HERTZ) -> OutputSignal:
    """Return x + square x^2 + cube x^3 of two modes, the second of some size."""
    poles = 2.0 * np.pi * hertz * (-ZETAS + 1j * np.sqrt(1.0 - ZETAS**2))
    x = np.real(np.exp(np.outer(TIMES, poles)) @ np.array([np.exp(0.7j), second * np.exp(0.2j)]))
    noise = 1e-3 * np.random.default_rng(5).standard_normal(len(x))
    return OutputSignal("z", "mm", TIMES, x + square * x**2 + cube * x**3 + noise)


def test_products_of_a_mode_are_listed_apart_by_frequency_phase_and_decay():
    found = fit_free_decay(decay(0.08, 0.05, 0.02))
    assert found.frequencies_hz == pytest.approx(HERTZ, rel=1e-4)
    # x^2 of size a is a/2 at twice the frequency, x^3 is a quarter at thrice and three quarters, in phase, at once.
    listed = {(own.makers, own.times, own.factors): own.amplitudes[0] for own in found.harmonics}
    expected = {((0,), (2,), (2,)): 0.04, ((0,), (3,), (3,)): 0.0125, ((0,), (1,), (3,)): 0.0375}
    assert {key: listed[key] for key in expected} == pytest.approx(expected, rel=0.15)
    assert any("No modes but products of modes" in said and "2 f1" in said for said in found.warnings)
    assert FreeDecay.from_dict(json.loads(json.dumps(found.to_dict()))).harmonics == found.harmonics


def test_a_mode_that_lies_at_twice_the_frequency_of_another_stays_a_mode():
    # It decays with a rate of its own.
    found = fit_free_decay(decay(0.0, 0.0, 0.3, hertz=np.array([4.4, 8.8])))
    assert len(found.natural_frequencies) == 2
    assert found.harmonics == ()


def test_as_many_modes_as_were_asked_for_are_returned():
    found = fit_free_decay(decay(0.08, 0.0), n_modes=2)
    assert found.frequencies_hz == pytest.approx([4.4, 8.8], rel=1e-3)
    assert found.harmonics == ()
