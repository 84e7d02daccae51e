"""What an excitation does to a model, and whether it resolves its modes."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ident import (
    ExcitationError,
    ExcitationLimitError,
    LinearChirp,
    LogChirp,
    ModalModel,
    Multisine,
    Prbs,
    Sine,
    Step,
    SteppedSine,
    excitation_report,
    predict_amplitudes,
)
from beam_ident.design.prediction import half_power_bands, resolution_warning
from beam_ident.excitation.sampled import SampledExcitation


def model(structure="base_motion", frequency=4.0, zeta=0.01, gain=1.0):
    has_direct = structure != "receptance"
    n_parameters = 2 + 2 + 2 * 3
    return ModalModel(
        structure=structure,
        input_name="hub",
        output_names=("root", "tip"),
        natural_frequencies=np.array([2 * np.pi * frequency]),
        damping_ratios=np.array([zeta]),
        residues=np.array([[0.0], [gain]]),
        residual_terms=np.zeros(2),
        gains=np.ones(2) if has_direct else np.zeros(2),
        latency=0.0,
        clock_rate=0.0,
        covariance=np.zeros((n_parameters, n_parameters)),
        noise_sd=np.ones(2),
    )


@pytest.mark.parametrize("structure", ["base_motion", "velocity", "acceleration"])
def test_a_resonant_sine_is_predicted_at_its_closed_form(structure):
    sine = Sine(start_frequency=4.0, acceleration=0.1, duration=100.0, fade_cycles=10.0, still=1.0).sample()
    root, tip = predict_amplitudes(sine, model(structure))
    # Steady state at resonance: w = a / (2 zeta omega^2), a quarter of a period behind the hub's a / omega^2.
    still = 0.1 / (2 * np.pi * 4.0) ** 2
    assert root.peak == pytest.approx(still, rel=2e-3)
    assert tip.peak == pytest.approx(still * np.hypot(50.0, 1.0), rel=2e-3)
    assert tip.output_name == "tip"
    assert 10.0 < tip.peak_time_s < 100.0


def test_a_force_is_predicted_on_a_receptance():
    held = Sine(start_frequency=4.0, acceleration=0.1, duration=100.0, still=1.0).sample_input(scale=2.0)
    assert np.max(np.abs(held.values)) == pytest.approx(0.2, rel=3e-3)  # the ramps overshoot a little
    tip = predict_amplitudes(held, model("receptance"))[1]
    assert tip.peak == pytest.approx(0.2 / (2 * 0.01 * (2 * np.pi * 4.0) ** 2), rel=2e-3)


def test_limits_are_named_with_what_would_do():
    chirp = LogChirp(start_frequency=1.0, end_frequency=10.0, duration=5.0, still=1.0).sample()
    peak = predict_amplitudes(chirp, model())[1].peak
    predict_amplitudes(chirp, model(), limits={"tip": peak * 1.001})
    with pytest.raises(ExcitationLimitError, match=r"tip is predicted to reach .* by a factor of 0\.500"):
        predict_amplitudes(chirp, model(), limits={"tip": peak / 2})
    with pytest.raises(ExcitationLimitError, match="root is predicted"):
        predict_amplitudes(chirp, model(), limits=1e-6)
    with pytest.raises(ExcitationError, match="'top' is not an output of the model"):
        predict_amplitudes(chirp, model(), limits={"top": 1.0})
    with pytest.raises(ExcitationError, match="expected a number > 0"):
        predict_amplitudes(chirp, model(), limits=float("nan"))


def test_a_motion_is_no_force():
    step = Step(duration=1.4, still=1.0)
    with pytest.raises(ExcitationError, match=r"use recipe\.sample_input"):
        predict_amplitudes(step.sample(), model("receptance"))
    with pytest.raises(ExcitationError, match=r"use recipe\.sample\(period_s\)"):
        predict_amplitudes(step.sample_input(), model())


def test_a_scaled_force_leaves_a_free_mass_at_rest_at_home():
    held = LogChirp(duration=5.0, still=1.0).sample_input(scale=0.8)
    impulse = np.cumsum(held.values) * held.period_s
    assert abs(impulse[-1]) < 1e-12
    assert abs(np.sum(impulse)) < 1e-9
    with pytest.raises(ExcitationLimitError, match=r"peak value .* N is above"):
        held.check(peak=0.1)
    with pytest.raises(ExcitationLimitError, match=r"peak rate .* N/s is above"):
        held.check(rate=1.0)
    assert held.input_signal().hold == "zoh"
    assert held.input_signal().unit == "N"


@pytest.mark.parametrize(
    ("recipe", "spacing"),
    [
        (LogChirp(duration=20.0, still=10.0), 1 / 30),
        (LinearChirp(duration=20.0, still=0.0), 1 / 20),
        (Multisine(line_period=10.0, n_periods=8), 0.1),
        (Multisine(line_period=10.0, lines="odd"), 0.2),
        (Prbs(order=10, clock_period=0.01, n_periods=4), 1 / 10.23),
        (SteppedSine(frequencies=(3.8, 4.3, 3.9)), 0.4),
    ],
)
def test_lines_are_counted_in_the_half_power_band(recipe, spacing):
    band = half_power_bands(recipe, [2 * np.pi * 4.0], [0.01])[0]
    assert band.width_hz == pytest.approx(0.08)
    assert band.line_spacing_hz == pytest.approx(spacing)
    assert band.lines == pytest.approx(0.08 / spacing)
    assert not band.is_resolved
    text = str(resolution_warning([band]))
    assert "mode at 4 Hz" in text
    assert "0.08 Hz" in text
    assert "50 s of record" in text


def test_a_long_record_resolves_the_mode_and_nobody_is_warned():
    band = half_power_bands(LogChirp(duration=45.0), [2 * np.pi * 4.0], [0.01])[0]
    assert band.is_resolved
    assert resolution_warning([band]) is None
    with pytest.raises(ExcitationError, match="modes: 1 natural frequencies and 2 damping ratios"):
        half_power_bands(LogChirp(), [1.0], [0.1, 0.1])
    with pytest.raises(ExcitationError, match="all finite and > 0"):
        half_power_bands(LogChirp(), [1.0], [0.0])


def test_several_modes_that_are_not_resolved_share_one_warning():
    bands = half_power_bands(
        Multisine(line_period=10.0), 2 * np.pi * np.array([4.0, 25.0, 30.0, 90.0]), [0.01] * 4
    )
    text = str(resolution_warning(bands))
    # Half-power bands of 0.08, 0.5, 0.6 and 1.8 Hz: only the first holds fewer than four lines 0.1 Hz apart.
    assert text.startswith("mode at 4 Hz: 0.8 lines in its half-power band of 0.08 Hz")
    tighter = half_power_bands(
        Multisine(line_period=2.0), 2 * np.pi * np.array([4.0, 25.0, 30.0]), [0.01] * 3
    )
    text = str(resolution_warning(tighter))
    assert text.startswith(
        "modes at 4, 25 and 30 Hz: 0.16, 1 and 1.2 lines in their half-power bands of 0.08, 0.5 and 0.6 Hz"
    )
    assert "lines every 0.02 Hz, from 50 s of record" in text  # what the narrowest one takes


def test_the_report_has_the_energy_the_band_and_the_levels_of_the_signal():
    excitation = LogChirp(start_frequency=2.0, end_frequency=50.0, duration=10.0, still=3.0).sample()
    report = excitation_report(excitation)
    energy = np.sum(excitation.accelerations**2) * 1e-3
    step = report.frequencies_hz[1]
    assert np.sum(report.energy_density) * step == pytest.approx(energy, rel=1e-9)
    low, high = report.band_hz
    assert low == pytest.approx(2.3, abs=0.7)  # the fade takes the first cycles
    assert high == pytest.approx(50.0, abs=2.0)
    assert report.active_s == pytest.approx(10.0, abs=0.2)
    acceleration, velocity, position = report.levels
    assert acceleration.peak == np.max(np.abs(excitation.accelerations))
    assert acceleration.crest_factor == pytest.approx(acceleration.peak / acceleration.rms)
    assert (velocity.unit, position.unit) == ("m/s", "m")
    assert report.modes == report.amplitudes == report.warnings == ()
    assert "crest factor" in str(report)


def test_the_report_warns_of_modes_it_does_not_resolve_or_reach():
    excitation = LogChirp(start_frequency=2.0, end_frequency=50.0, duration=10.0, still=3.0).sample()
    report = excitation_report(excitation, model(frequency=4.0, zeta=0.005))
    assert len(report.warnings) == 1
    assert "half-power band" in report.warnings[0]
    assert [a.output_name for a in report.amplitudes] == ["root", "tip"]
    beyond = excitation_report(excitation, model(frequency=80.0, zeta=0.05))
    assert len(beyond.warnings) == 1
    assert "outside the excited band" in beyond.warnings[0]
    assert "warning: mode at 80 Hz" in str(beyond)
    held = excitation_report(
        Prbs(drive="force", amplitude=1.0, still=0.0).sample_input(), model("receptance")
    )
    assert held.levels[0].crest_factor == pytest.approx(1.0)
    assert held.levels[0].unit == "N"
    # The mean of a binary sequence is one level over its length: the density at 0 Hz counts once.
    energy = 2047 * 0.005  # levels of 1 N over one period
    assert np.sum(held.energy_density) * held.frequencies_hz[1] == pytest.approx(energy, rel=1e-9)


def test_the_levels_of_a_move_there_are_those_of_its_formulas():
    # Accelerate for 100 ticks, brake for 100: a triangle of velocity and two parabolas, and a still stretch after.
    held = np.concatenate([np.ones(100), -np.ones(100), np.zeros(50)])
    report = excitation_report(SampledExcitation(Prbs(), 1e-3, held))
    k = np.arange(201)
    velocity = 1e-3 * np.minimum(k, 200 - k)
    position = 1e-6 * np.where(k <= 100, k**2 / 2, 10000 - (200 - k) ** 2 / 2)
    assert report.active_s == pytest.approx(0.2)
    for level, truth in zip(report.levels, (np.ones(200), velocity, position), strict=True):
        assert level.rms == pytest.approx(np.sqrt(np.mean(truth**2)), rel=1e-9)
        assert level.peak == pytest.approx(np.max(truth), rel=1e-9)
