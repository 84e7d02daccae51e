"""An input that goes on between its samples, given as one that is held, and the reverse: half a sample of delay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, cont2discrete, lfilter, sosfilt

from beam_ident import InputSignal, OutputSignal, TimeRecord, identify

STEP_S = 2e-3
HERTZ, ZETAS = np.array([3.1, 11.7, 29.0]), np.array([0.008, 0.02, 0.005])
RESIDUES = np.array([[1.0, -30.0, 80.0], [0.6, 40.0, 20.0]])


def record(seed: int, unit: str, true_hold: str, stated: str) -> TimeRecord:
    """Return 20 s of a broad band and two outputs, by SciPy's discretised plant."""
    rng = np.random.default_rng(seed)
    band = butter(4, [2e-3, 0.24], "band", output="sos")
    drive = sosfilt(band, rng.standard_normal(10_000))
    seen = np.zeros((10_000, 2))
    for hz, zeta, residue in zip(HERTZ, ZETAS, RESIDUES.T, strict=True):
        omega = 2.0 * np.pi * hz
        plant = [1.0], [1.0, 2.0 * zeta * omega, omega**2]
        b, a, _ = cont2discrete(plant, STEP_S, {"linear": "foh", "zoh": "zoh"}[true_hold])
        seen += lfilter(np.squeeze(b), a, drive)[:, None] * residue
    seen += 0.003 * seen.std(axis=0) * rng.standard_normal(seen.shape)
    times = STEP_S * np.arange(10_000)
    outputs = tuple(OutputSignal(f"p{j}", "m", times, own) for j, own in enumerate(seen.T))
    return TimeRecord((InputSignal("shaker", unit, times, drive, stated),), outputs)


@pytest.mark.slow
@pytest.mark.parametrize("unit", ["N", "m/s^2"])
@pytest.mark.parametrize(
    ("true_hold", "stated", "remedy"), [("linear", "zoh", "linear or cubic"), ("zoh", "linear", "zoh")]
)
def test_a_wrong_hold_costs_half_a_sample_and_is_named(unit, true_hold, stated, remedy):
    for seed in (1, 2):
        found = identify(record(seed, unit, true_hold, stated))
        model = found.model
        assert model.n_modes == 3
        z = (model.natural_frequencies / (2.0 * np.pi) - HERTZ) / (model.natural_frequency_sd / (2.0 * np.pi))
        assert np.max(np.abs(z)) < 4.0
        half = {"zoh": -0.5, "linear": 0.5}[stated] * STEP_S
        np.testing.assert_allclose(model.latency + model.output_delays, half, atol=1e-5)
        if unit == "N" or stated == "zoh":  # otherwise stamps may well be as late
            assert any(said.endswith(f"Set its hold to {remedy}.") for said in found.warnings)


@pytest.mark.slow
def test_the_right_hold_is_not_doubted():
    right = record(3, "N", "linear", "linear")
    assert not identify(right).warnings
    cubic = replace(right, inputs=(replace(right.inputs[0], hold="cubic"),))
    assert not any("hold" in said for said in identify(cubic).warnings)
