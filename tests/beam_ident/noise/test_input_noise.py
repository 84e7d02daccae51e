"""The low-pass of a noisy input, beside gaps that are bridged badly."""

from __future__ import annotations

import numpy as np

from beam_ident import InputSignal
from beam_ident.data.gaps import InputGap
from beam_ident.noise.input_noise import Smoothing


def test_a_poor_bridge_stays_within_its_gap() -> None:
    times = 1e-3 * np.arange(6000)
    values = 1e-3 * np.sin(2.0 * np.pi * 8.0 * times)
    first, last = 2500, 3200
    wrong = values.copy()
    wrong[first + 1 : last] += 1e-3
    gap = InputGap(times[first], times[last], last - first - 1, 1e-3, np.full((1, last - first - 1), 1e-3))
    drive = InputSignal("hub", "m", times, wrong, "cubic", 1e-7, (gap,))
    left = (
        Smoothing(90.0).of(drive).values
        - Smoothing(90.0).of(InputSignal("hub", "m", times, values, "cubic")).values
    )
    known = np.r_[0 : first + 1, last:6000]
    # Mirrored about its end, the motion keeps value and speed; its bend, 2.5 m/s^2, turns: that leaves some 1e-6 m.
    assert np.max(np.abs(left[known])) < 2e-6
    assert np.max(np.abs(left[np.r_[0 : first - 100, last + 100 : 6000]])) < 1e-8
