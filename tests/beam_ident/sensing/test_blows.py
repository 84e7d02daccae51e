"""A hammer's force between its blows: noise of its sensor, and of no other force."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from beam_ident import InputSignal, OutputSignal, TimeRecord, identify
from beam_ident.sensing.blows import without_noise_between_blows

H = 1e-3
TIMES = H * np.arange(8000)
OMEGAS, ZETAS, RESIDUES = 2.0 * np.pi * np.array([19.0, 61.0]), np.array([0.008, 0.005]), np.array([1.0, 0.7])


def blows(at_s: tuple[float, ...], times: np.ndarray = TIMES, width: float = 4e-3) -> np.ndarray:
    force = np.zeros(len(times))
    for k, begin in enumerate(at_s):
        s = (times - begin) / width
        force += np.where((s > 0.0) & (s < 1.0), (50.0 + 20.0 * k) * np.sin(np.pi * s) ** 2, 0.0)
    return force


def struck(noise: float, seed: int = 0) -> TimeRecord:
    """Return the accelerations after three blows, integrated at a sixteenth of the samples' step."""
    rng = np.random.default_rng(seed)
    fine = H / 16.0 * np.arange(16 * len(TIMES))
    force, answer = blows((0.3, 2.9, 5.6), fine), np.zeros(16 * len(TIMES))
    for omega, zeta, residue in zip(OMEGAS, ZETAS, RESIDUES, strict=True):
        b, a, _ = cont2discrete(([residue, 0.0, 0.0], [1.0, 2.0 * zeta * omega, omega**2]), H / 16.0, "foh")
        answer += lfilter(b.ravel(), a, force)
    seen = force[::16] + noise * rng.standard_normal(len(TIMES))
    values = answer[::16] + 0.05 * rng.standard_normal(len(TIMES))
    return TimeRecord(
        (InputSignal("hammer", "N", (0.0, H), seen, "cubic"),),
        (OutputSignal("p", "m/s^2", (0.0, H), values),),
    )


@pytest.mark.slow
def test_a_noisy_hammer_bends_no_mode():
    # Taken for a force, the noise between the blows moved frequencies by 8 standard deviations, each a hundred times
    # what it is without.
    found = identify(struck(0.2), "accelerance")
    model = found.model
    assert model.n_modes == 2
    assert np.max(np.abs(model.natural_frequencies - OMEGAS) / model.natural_frequency_sd) < 4.0
    assert np.max(np.abs(model.damping_ratios - ZETAS) / model.damping_ratio_sd) < 4.0
    assert np.max(model.natural_frequency_sd / OMEGAS) < 1e-5
    assert any("touches nothing" in warning for warning in found.warnings)


def silenced(values: np.ndarray, hold: str = "cubic") -> bool:
    record = TimeRecord(
        (InputSignal("force", "N", (0.0, H), values, hold),), (OutputSignal("p", "m", (0.0, H), TIMES),)
    )
    return bool(without_noise_between_blows([record], ["force"])[1])


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_what_is_no_contact_is_no_force(sign):
    noise = 0.2 * np.random.default_rng(1).standard_normal(len(TIMES))
    truth = blows((0.3, 2.9, 5.6))
    record = TimeRecord(
        (InputSignal("force", "N", (0.0, H), sign * truth + noise + 3.0, "cubic"),),
        (OutputSignal("p", "m", (0.0, H), TIMES),),
    )
    (cut,), said = without_noise_between_blows([record], ["force"])
    force = sign * cut.inputs[0].values
    assert "0.2 N" in said
    assert np.count_nonzero(force) < 40
    assert np.sum(force) == pytest.approx(np.sum(truth), rel=0.01)


def test_other_forces_stay_what_they_are():
    rng = np.random.default_rng(2)
    noise = 0.2 * rng.standard_normal(len(TIMES))
    burst = np.where((TIMES > 1.0) & (TIMES < 1.5), 30.0 * np.sin(200.0 * TIMES), 0.0)
    assert not silenced(burst + noise)
    assert not silenced(5.0 * rng.standard_normal(len(TIMES)))
    assert not silenced(blows((0.3, 2.9), width=1.2) + noise)
    assert not silenced(blows((0.3, 2.9, 5.6)) + noise, "zoh")
    assert not silenced(blows((0.3, 2.9, 5.6)))
    # A shaker that the structure moves between its pushes.
    assert not silenced(blows((0.3, 2.9, 5.6)) + 5.0 * np.sin(100.0 * TIMES))
