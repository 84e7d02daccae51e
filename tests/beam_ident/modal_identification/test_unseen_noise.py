"""Noise of an input that never rests and fills the band: seen in what it leaves at the outputs, and nowhere else."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from beam_ident import InputSignal, OutputSignal, TimeRecord, identify
from beam_ident.modal.model import ModalModel
from beam_ident.modal_identification.unseen_noise import Leftover, unseen_noise

PERIOD_S = 0.004
N = 4000
TIMES = PERIOD_S * np.arange(N)
HERTZ, ZETAS = np.array([3.1, 19.4]), np.array([0.012, 0.006])
RESIDUES = np.array([[1.0, 0.6], [0.5, -0.8]])
SIGMA = 0.05  # of a force of 1


def answers(force: np.ndarray, finer: int = 8) -> np.ndarray:
    """Return what two sensors see of a force that runs straight between its samples, shape (n, 2)."""
    fine = np.interp((np.arange(N * finer) + 0.5) / finer, np.arange(N), force)
    step, total = PERIOD_S / finer, np.zeros((N, 2))
    for hertz, zeta, own in zip(HERTZ, ZETAS, RESIDUES.T, strict=True):
        omega = 2.0 * np.pi * hertz
        pole = omega * (-zeta + 1j * np.sqrt(1.0 - zeta**2))
        turn = np.exp(pole * step)
        # One pole of the pair, exact for a held input: x' = pole x + u, and the deflection is Im x / Im pole.
        x = lfilter([0.0, (turn - 1.0) / pole], [1.0, -turn], fine.astype(complex))
        total += np.outer(x.imag[::finer] / pole.imag, own)
    return total


def noise(seed: int) -> tuple[np.random.Generator, np.ndarray]:
    rng = np.random.default_rng([seed, 12])
    return rng, rng.standard_normal(N)


@pytest.fixture(scope="module")
def model() -> ModalModel:
    rng, force = noise(0)
    seen = answers(force)
    outputs = tuple(
        OutputSignal(name, "m", TIMES, own + 0.003 * np.std(own) * rng.standard_normal(N))
        for name, own in zip("ab", seen.T, strict=True)
    )
    return identify(TimeRecord((InputSignal("u", "N", TIMES, force, "linear"),), outputs), "receptance").model


def found_in(model: ModalModel, residuals: np.ndarray) -> float:
    drive = InputSignal("u", "N", TIMES, noise(1)[1], "linear")
    return unseen_noise(model, [Leftover(j, TIMES, residuals[:, j], 0.0, drive) for j in range(2)])


@pytest.mark.slow
@pytest.mark.parametrize("own", [0.1, 0.5])
def test_noise_that_passes_through_the_modes_is_found_with_its_size(model, own):
    found = []
    for seed in range(6):
        rng, force = noise(seed + 10)
        left = answers(SIGMA * force)
        found.append(found_in(model, left + own * np.std(left, axis=0) * rng.standard_normal((N, 2))))
    assert np.mean(found) == pytest.approx(SIGMA, rel=0.08)
    assert np.std(found) < 0.2 * SIGMA


@pytest.mark.slow
@pytest.mark.parametrize(
    "denominator", [[1.0], [1.0, -0.95], [1.0, -1.8, 0.95]], ids=["white", "slow", "another resonance"]
)
def test_noise_of_another_colour_is_none_of_an_input(model, denominator):
    for seed in range(20):  # none of 200 of each
        rng, _ = noise(seed + 30)
        assert found_in(model, lfilter([1.0], denominator, rng.standard_normal((N, 2)), axis=0)) == 0.0


def test_what_one_output_alone_leaves_is_none_of_an_input(model):
    """A gain that changes leaves the colour of the modes, too, but at its own output."""
    rng, force = noise(60)
    seen = answers(force)
    left = 0.003 * np.std(seen, axis=0) * rng.standard_normal((N, 2))
    left[N // 2 :, 0] += 0.1 * seen[N // 2 :, 0]
    assert found_in(model, left) == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", [71])
def test_a_force_whose_noise_nobody_declared_is_weighed_by_it(seed):
    rng, force = noise(seed)
    measured = InputSignal("u", "N", TIMES, force + SIGMA * rng.standard_normal(N), "linear")
    outputs = tuple(
        OutputSignal(name, "m", TIMES, own + 0.003 * np.std(own) * rng.standard_normal(N))
        for name, own in zip("ab", answers(force).T, strict=True)
    )
    result = identify(TimeRecord((measured,), outputs), "receptance")
    (said,) = [own for own in result.warnings if "nobody declared" in own]
    assert "in what it leaves at the outputs" in said
    assert float(said.split("declared: ")[1].split(" N")[0]) == pytest.approx(SIGMA, rel=0.15)
    apart = (result.model.frequencies_hz[:2] - HERTZ) / (
        result.model.natural_frequency_sd[:2] / (2.0 * np.pi)
    )
    assert np.all(np.abs(apart) < 3.5), apart  # 7 and more where it was taken for noise of the outputs
