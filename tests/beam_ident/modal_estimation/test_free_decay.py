from __future__ import annotations

import numpy as np
import pytest

from beam_ident import EstimationError, OutputSignal
from beam_ident.modal_estimation.free_decay import _DecayBasis, end_of_rest, fit_free_decay
from benchmarks.ident.free_decays import LOCAL_HZ, ManyPoints
from tests.beam_ident.truth import averaged_cosine

OMEGAS, ZETAS = 2 * np.pi * np.array([4.4, 28.3]), np.array([0.005, 0.008])
AMPLITUDES = np.array([[1.0, 0.3 - 0.2j], [0.4j, -0.5]])
TIMES = np.sort(np.random.default_rng(0).uniform(2.0, 8.0, 500))


def decays(noise, seed=0, exposure=0.0, times=TIMES):
    elapsed = times - TIMES[0]
    ringing = np.tile([3.0, -1.0], (len(times), 1))
    for pole, amplitudes in zip(OMEGAS * (-ZETAS + 1j * np.sqrt(1 - ZETAS**2)), AMPLITUDES.T, strict=True):
        if exposure > 0.0:
            ringing += np.stack([averaged_cosine(elapsed, pole, a, exposure) for a in amplitudes], axis=1)
        else:
            ringing += np.real(np.exp(elapsed * pole)[:, None] * amplitudes)
    noisy = ringing + noise * np.random.default_rng(seed).standard_normal(ringing.shape)
    return [OutputSignal(n, "m", times, noisy[:, j], exposure) for j, n in enumerate(("tip", "root"))]


# 20 ms are 0.57 of the second mode's period: the box takes half of it away.
@pytest.mark.parametrize("exposure", [0.0, 1e-6, 0.01, 0.02])
def test_two_modes_ring_at_irregular_stamps_and_are_found_exactly(exposure):
    found = fit_free_decay(decays(0.0, exposure=exposure))
    np.testing.assert_allclose(found.natural_frequencies, OMEGAS, rtol=1e-10)
    np.testing.assert_allclose(found.damping_ratios, ZETAS, rtol=1e-8)
    np.testing.assert_allclose(found.amplitudes, AMPLITUDES, atol=1e-9)
    np.testing.assert_allclose(found.offsets, [3.0, -1.0], atol=1e-9)
    np.testing.assert_allclose(found.logarithmic_decrements, 2 * np.pi * ZETAS, rtol=1e-4)


def test_intervals_cover():
    scores = []
    for seed in range(8):
        found = fit_free_decay(decays(0.1, seed), n_modes=2)
        estimate = np.concatenate([found.natural_frequencies - OMEGAS, found.damping_ratios - ZETAS])
        scores.append(estimate / np.concatenate([found.natural_frequency_sd, found.damping_ratio_sd]))
    assert 0.75 < np.sqrt(np.mean(np.square(scores))) < 1.3  # 32 scores: 1 +- 0.13


def test_outputs_with_clocks_of_their_own_share_the_poles():
    tip, root = decays(0.02)
    later = decays(0.02, seed=1, times=TIMES[50:] + 1e-3)[1]
    both = fit_free_decay([tip, later], n_modes=2)
    np.testing.assert_allclose(both.natural_frequencies, OMEGAS, rtol=3e-4)
    assert both.damping_ratio_sd[0] < fit_free_decay(root, n_modes=2).damping_ratio_sd[0]
    assert all(w.is_white for w in both.whiteness)


def test_nothing_that_rings_is_refused():
    with pytest.raises(
        EstimationError, match=r"stands out of the noise .* Give the stretch of the free decay"
    ):
        fit_free_decay(OutputSignal("y", "", TIMES, np.random.default_rng(1).standard_normal(len(TIMES))))
    with pytest.raises(EstimationError, match="a decay needs at least 12"):
        fit_free_decay(decays(0.1), end_s=2.05)
    with pytest.raises(EstimationError, match="n_modes is 0"):
        fit_free_decay(decays(0.1), n_modes=0)


@pytest.mark.parametrize("load", [0.0, 1.0, -0.4])  # what the structure is held by until it is let go
@pytest.mark.parametrize("noise", [0.0, 0.003, 0.05])
def test_a_rest_before_the_decay_is_left_out(load, noise):
    times = 0.01 * np.arange(3000)
    elapsed = np.maximum(times - 8.0, 0.0)
    pole = 2 * np.pi * 3.0 * (-0.01 + 1j * np.sqrt(1 - 1e-4))
    rings = np.real(np.exp(pole * elapsed) * (1.0 if load else -1j))
    values = np.where(times > 8.0, rings, load) + noise * np.random.default_rng(1).standard_normal(3000)
    found = fit_free_decay(OutputSignal("tip", "m", times, values))
    assert 8.0 <= found.start_s < 8.0 + 1.1 / 3.0
    assert found.warnings[0].startswith("The outputs rested first: the decay is taken from 8.")
    assert len(found.natural_frequencies) == 1
    assert abs(found.frequencies_hz[0] - 3.0) < 4.0 * found.natural_frequency_sd[0] / (2 * np.pi) + 1e-9
    assert abs(found.damping_ratios[0] - 0.01) < 4.0 * found.damping_ratio_sd[0] + 1e-9


@pytest.mark.parametrize("frequencies", [(3.0,), (3.0, 3.1), (0.2,), (0.05,)])
@pytest.mark.parametrize("phase", [0.0, 1.57, 3.14])
def test_what_rings_from_the_beginning_is_taken_whole(frequencies, phase):
    """Beats that begin at their null, too, and half a cycle of a slow mode at its crest."""
    times = 0.01 * np.arange(3000)
    poles = [2 * np.pi * f * (-0.005 + 1j) for f in frequencies]
    signs = 1.0 - 2.0 * np.arange(len(poles))
    values = sum(a * np.real(np.exp(p * times + 1j * phase)) for a, p in zip(signs, poles, strict=True))
    noisy = values + 0.01 * np.random.default_rng(2).standard_normal(3000)
    assert end_of_rest([OutputSignal("tip", "m", times, noisy)]) is None


def test_what_swells_is_not_taken_for_a_decay_after_a_rest():
    times = 0.01 * np.arange(400)
    for seed in range(3):
        noise = 0.1 * np.random.default_rng(seed).standard_normal(400)
        swelling = np.exp(0.5 * times) * np.cos(20.0 * times + seed) + noise
        assert end_of_rest([OutputSignal("tip", "m", times, swelling)]) is None


@pytest.mark.slow
def test_many_points_find_what_the_best_of_them_finds_alone():
    case = ManyPoints()
    points = case.signals(3)
    alone = fit_free_decay(points[case.local_point])
    together = fit_free_decay(points)
    # Of nine modes' worth of parameters the local one explains those of one point: it was not worth the others'.
    assert np.min(np.abs(alone.frequencies_hz / LOCAL_HZ - 1.0)) < 0.01
    for hertz in alone.frequencies_hz:
        assert np.min(np.abs(together.frequencies_hz / hertz - 1.0)) < 0.01
    errors = np.concatenate([together.natural_frequencies, together.damping_ratios]) - case.truth
    assert np.max(np.abs(errors / case.bound)) < 4.0


@pytest.mark.first_case
@pytest.mark.parametrize("shape", ["straight", "bent"])
def test_drift_is_no_mode_and_hides_none(shape):
    elapsed = (TIMES - TIMES[0]) / 6.0
    drift = 5.0 * elapsed if shape == "straight" else 5.0 * elapsed + 8.0 * elapsed**2 * (1.0 - elapsed)
    signals = [
        OutputSignal(s.name, s.unit, s.times_s, s.values + k * drift) for k, s in enumerate(decays(0.02), 1)
    ]
    found, still = fit_free_decay(signals), fit_free_decay(decays(0.02))
    assert len(found.natural_frequencies) == 2
    moved = (found.natural_frequencies - still.natural_frequencies) / still.natural_frequency_sd
    assert np.max(np.abs(moved)) < 0.5
    assert found.natural_frequency_sd == pytest.approx(still.natural_frequency_sd, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(("step", "n_modes"), [(2.0, None), (1.0, None), (1.0, 2)])
def test_a_walk_that_is_louder_than_a_mode_does_not_hide_it(step, n_modes):
    # With equal weights its own slow swings are the next modes, or the search ends at the first one.
    signals = []
    for seed, signal in enumerate(decays(0.0)):
        steps = np.random.default_rng(seed).standard_normal(len(TIMES)) * np.sqrt(
            np.diff(TIMES, prepend=TIMES[0])
        )
        signals.append(OutputSignal(signal.name, "m", TIMES, signal.values + step * np.cumsum(steps)))
    found = fit_free_decay(signals, n_modes)
    assert len(found.natural_frequencies) == 2
    scores = [
        (found.natural_frequencies - OMEGAS) / found.natural_frequency_sd,
        (found.damping_ratios - ZETAS) / found.damping_ratio_sd,
    ]
    assert np.max(np.abs(scores)) < 3.6


def test_points_that_share_their_stamps_share_their_columns():
    found = fit_free_decay(decays(0.02), n_modes=2)
    apart = decays(0.02)
    apart[1] = OutputSignal("root", "m", apart[1].times_s + 1e-12, apart[1].values)
    other = fit_free_decay(apart, n_modes=2)
    np.testing.assert_allclose(found.natural_frequencies, other.natural_frequencies, rtol=1e-7)
    np.testing.assert_allclose(found.natural_frequency_sd, other.natural_frequency_sd, rtol=1e-4)


def test_the_slopes_of_a_decay_seen_through_an_exposure_are_its_differences():
    times, exposure, omega, zeta = np.linspace(0.0, 2.0, 50), 0.02, 2 * np.pi * 28.3, 0.008

    def cosine(w, z):
        return averaged_cosine(times, w * complex(-z, np.sqrt(1 - z**2)), 1.0, exposure)

    found = _DecayBasis(times, exposure).modal(omega, zeta, 0.0)
    h = 1e-5
    np.testing.assert_allclose(found.value[:, 0], cosine(omega, zeta), atol=1e-12)
    by_log_omega = (cosine(omega * (1 + h), zeta) - cosine(omega * (1 - h), zeta)) / (2 * h)
    by_zeta = (cosine(omega, zeta + h) - cosine(omega, zeta - h)) / (2 * h)
    # The error of a central difference is h^2/6 of the third derivative, (omega t)^3 = 4e7.
    size = np.max(np.abs(by_log_omega))
    np.testing.assert_allclose(found.by_log_omega[:, 0], by_log_omega, atol=1e-4 * size)
    np.testing.assert_allclose(found.by_zeta[:, 0], by_zeta, atol=1e-4 * size)


@pytest.mark.slow
def test_a_sensor_with_a_dead_band_is_named_and_a_sound_one_is_not():
    named = {0.0: 0, 0.1: 0}
    for seed in range(10):
        rng = np.random.default_rng(seed)
        stamps, omega, zeta = 0.01 * np.arange(500), 20.0 * rng.uniform(0.7, 1.4), rng.uniform(0.02, 0.06)
        moves = np.exp(-zeta * omega * stamps) * np.cos(omega * stamps + rng.uniform(0.0, 6.0))
        noise = 0.01 * rng.standard_normal((2, len(stamps)))
        for width in named:
            seen = []
            for name, values in zip("yz", (moves + noise[0], -0.5 * moves + noise[1]), strict=True):
                lost = width * np.std(values)
                beyond = np.sign(values) * np.maximum(np.abs(values) - lost, 0.0)
                seen.append(OutputSignal(name, "", stamps, beyond))
            said = " ".join(fit_free_decay(seen, max_modes=3).warnings)
            named[width] += "dead band" in said
    assert named[0.0] == 0
    assert named[0.1] >= 8  # 19 of 20 in a study: fewer than 8 of 10 once in a hundred
