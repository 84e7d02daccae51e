"""The verdict on driven oscillators that are integrated without the library."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from beam_ident import EstimationError, IdentificationResult, driven_amplitude_curves, identify
from beam_ident.amplitude.linearity import Linearity, driven, linearity
from tests.beam_ident.amplitude.oscillators import UNIT, Oscillator, driven_record, moved_hub
from tests.beam_ident.truth import beam_record


@cache
def judged(oscillator: Oscillator, seed: int = 1) -> Linearity:
    record = driven_record(oscillator, seed)
    found = identify(record, n_modes=1)
    assert isinstance(found, IdentificationResult)
    return linearity([record], found.model)


def test_what_a_pole_makes_of_a_cause_is_its_integral() -> None:
    pole, t = complex(-0.3, 27.0), np.sort(np.random.default_rng(0).uniform(0.0, 5.0, 3000))
    cause = np.exp(pole * t)[:, None] * np.array([1.0, 2.0j])
    # A cause that turns as the pole does grows along with time.
    expected = (t - t[0])[:, None] * cause
    assert np.abs(driven(pole, t, cause) - expected).max() < 1e-9


@pytest.mark.slow
def test_a_cubic_spring_shows_its_frequency() -> None:
    soft = judged(Oscillator(zeta=0.01, hardening=-0.001))
    assert not soft.is_linear
    (mode,) = soft.modes
    share = (mode.largest / UNIT) ** 2 * (1.0 - 1.0 / 9.0)
    assert mode.frequency_change == pytest.approx(
        -0.001 * share, rel=0.15, abs=3.0 * mode.frequency_change_sd
    )
    assert abs(mode.damping_change) < 3.0 * mode.damping_change_sd + 1e-4
    assert "one pole does not describe mode 1 (p" in soft.verdict
    assert "m of z285 its frequency changes by -0." in soft.verdict


@pytest.mark.slow
@pytest.mark.parametrize(
    ("oscillator", "grows"),
    [(Oscillator(zeta=0.01, quadratic=0.001), True), (Oscillator(zeta=0.01, dry=0.0005), False)],
)
def test_damping_that_grows_and_damping_that_falls_are_told_apart(
    oscillator: Oscillator, grows: bool
) -> None:
    found = judged(oscillator)
    assert not found.is_linear
    (mode,) = found.modes
    assert (mode.damping_change > 2.0 * mode.damping_change_sd) == grows
    assert (mode.damping_change < -2.0 * mode.damping_change_sd) != grows


def verdicts(seeds: range) -> list[bool]:
    result = []
    for seed in seeds:
        record = beam_record(seed)
        result.append(linearity([record], identify(record, n_modes=3).model).is_linear)
    return result


@pytest.mark.slow
def test_a_linear_record_is_called_linear() -> None:
    found = judged(Oscillator(zeta=0.01))
    assert found.is_linear
    assert "one pole describes each mode" in found.verdict


@pytest.mark.verify
def test_a_linear_record_is_called_linear_in_95_percent() -> None:
    # 200 draws at 5 %: their share is known to 1.5 %; the blocks' own scores make the test a little conservative.
    assert 0.92 <= np.mean(verdicts(range(200))) <= 0.995


@pytest.mark.slow
def test_noise_that_swells_with_the_motion_is_no_change_of_the_pole() -> None:
    chances = []
    for seed in range(3):
        clean = driven_record(Oscillator(zeta=0.01), seed, noise=0.0, duration_s=8.0)
        (output,) = clean.outputs
        rng = np.random.default_rng(seed)
        late = 2e-4 * rng.standard_normal(len(output.values))
        scattered = replace(output, values=output.values + late * np.gradient(output.values, output.times_s))
        noisy = replace(clean, outputs=(scattered,))
        chances.append(linearity([noisy], identify(noisy, n_modes=1).model).p_value)
    # Half of all draws lie above 0.5 where the test is right.
    assert np.median(chances) > 0.1


@pytest.mark.slow
@pytest.mark.parametrize("encoder", [2e-6, 2e-5])
def test_noise_of_a_measured_input_is_no_change_of_the_pole(encoder: float) -> None:
    records = [moved_hub(seed, encoder) for seed in range(5)]
    chances = [linearity([record], identify(record, n_modes=1).model).p_value for record in records]
    # It rings in the mode for seconds: as white noise of the outputs it would give p < 0.01 nearly always.
    assert np.median(chances) > 0.1, chances
    assert sum(chance < 0.05 for chance in chances) <= 1, chances


@pytest.mark.slow
def test_a_cubic_spring_shows_behind_a_noisy_input() -> None:
    record = moved_hub(1, 2e-6, hardening=0.02)
    found = linearity([record], identify(record, n_modes=1).model)
    assert not found.is_linear
    assert found.modes[0].frequency_change > 3.0 * found.modes[0].frequency_change_sd


@pytest.mark.slow
def test_stored_words_and_numbers_agree() -> None:
    found = judged(Oscillator(zeta=0.01, hardening=-0.001))
    content = found.to_dict()
    assert content["verdict"] == found.verdict
    assert content["modes"][0]["p_value"] == found.modes[0].p_value
    assert content["is_linear"] is False


def test_signals_that_never_change_are_refused() -> None:
    record = driven_record(Oscillator(zeta=0.01), 0, duration_s=8.0)
    model = identify(record, n_modes=1).model
    (output,) = record.outputs
    dead = replace(record, outputs=(replace(output, values=np.zeros(len(output.values))),))
    with pytest.raises(EstimationError, match="is constant"):
        linearity([dead], model)
    with pytest.raises(EstimationError, match="is constant"):
        driven_amplitude_curves([dead], model)
    still = replace(
        record, inputs=(replace(record.inputs[0], values=np.zeros(len(record.inputs[0].values))),)
    )
    with pytest.raises(EstimationError, match="in no record"):
        driven_amplitude_curves([still], model)
