"""Sensors that show the motion through a low-pass, on records integrated by SciPy's own filters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

from beam_ident import (
    EstimationError,
    InputSignal,
    LowPass,
    ModalStructure,
    OutputSignal,
    TimeRecord,
    estimate_transfer_function,
    identify,
    validate,
)
from beam_ident.modal.model import ModalModel
from benchmarks.ident.supersets import hard_record

FREQUENCIES_HZ, DAMPING = np.array([4.38, 19.4]), np.array([0.005, 0.008])
RESIDUES = ((1.56, 0.62), (-0.9, 0.7))
LATE_S, NOISE, FINE_HZ = 0.004, 2e-6, 5000


def behind(order: int, cutoff_hz: float):
    """An analogue Butterworth low-pass, numerator and denominator."""
    return signal.butter(order, 2.0 * np.pi * cutoff_hz, analog=True)


def filmed(filters, seed=1, duration=12.0, noise=None, swept=False):
    """Band-limited or swept motion of the base, and two markers that are seen through a filter each, or none."""
    rng = np.random.default_rng(seed)
    times = np.arange(int(duration * FINE_HZ)) / FINE_HZ
    if swept:
        base = 4e-3 * signal.chirp(times, 1.0, duration - 4.0, 30.0, phi=-90.0)
        base *= np.clip(5.0 * (duration - 3.8 - times), 0.0, 1.0)
    else:
        base = signal.lfilter(*signal.butter(4, 2.0 * 30.0 / FINE_HZ), rng.standard_normal(len(times)))
        base *= 2e-3 / base.std()
        base[:500] *= np.linspace(0.0, 1.0, 500)

    def passed(system, values):
        top, bottom, _ = signal.cont2discrete(system, 1.0 / FINE_HZ, method="foh")
        return signal.lfilter(top.ravel(), bottom, values)

    outputs = []
    stamps = np.arange(0.05, duration - 0.05, 0.01)
    for number, (filtered, residues) in enumerate(zip(filters, RESIDUES, strict=True)):
        seen = base.copy()
        for omega, zeta, residue in zip(2.0 * np.pi * FREQUENCIES_HZ, DAMPING, residues, strict=True):
            seen += passed(([-residue, 0.0, 0.0], [1.0, 2.0 * zeta * omega, omega**2]), base)
        if filtered is not None:
            seen = passed(filtered, seen)
        own = rng.standard_normal(len(stamps)) if noise is None else noise(rng, len(stamps))
        values = np.interp(stamps, times, seen) + NOISE * own
        outputs.append(OutputSignal(f"z{number}", "m", stamps + LATE_S, values))
    return TimeRecord((InputSignal("hub", "m", (0.0, 5.0 / FINE_HZ), base[::5], "cubic"),), tuple(outputs))


def stated(record, *low_passes):
    outputs = [replace(own, low_pass=low) for own, low in zip(record.outputs, low_passes, strict=True)]
    return replace(record, outputs=tuple(outputs))


def deviations(model):
    """How far the poles are from the truth, in their own standard deviations."""
    frequencies = (model.frequencies_hz - FREQUENCIES_HZ) / (model.natural_frequency_sd / (2.0 * np.pi))
    return np.abs(np.concatenate([frequencies, (model.damping_ratios - DAMPING) / model.damping_ratio_sd]))


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize(("hold", "corner"), [("zoh", 2e-3), ("linear", 3e-4), ("cubic", 3e-4)])
def test_what_a_low_pass_shows_of_an_input_is_what_scipy_says(order, hold, corner):
    times = np.arange(0.0, 1.0, 0.01)
    drive = InputSignal("u", "N", times, 4.0 - np.cos(7.0 * times), hold)
    fine = np.arange(0.0, 0.99, 1e-4)
    before = signal.lsim(signal.lti(*behind(order, 20.0)), drive.signal()(fine) - 3.0, fine)[1] + 3.0
    shown = LowPass.of_order(order, 20.0).of(drive)
    np.testing.assert_allclose(shown.signal()(fine[::50]), before[::50], atol=corner)


def test_the_cutoff_is_where_71_percent_is_shown():
    for order in (1, 2):
        low_pass = LowPass.of_order(order, 80.0)
        assert low_pass.cutoff_hz == pytest.approx(80.0)
        s = 2j * np.pi * 80.0
        assert abs(1.0 / (1.0 + low_pass.lag_s * s + low_pass.bend_s2 * s**2)) == pytest.approx(0.5**0.5)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("filters", "known"),
    [
        ((None, behind(1, 30.0)), (None, LowPass.of_order(1, 30.0))),
        ((behind(2, 80.0), behind(2, 80.0)), (LowPass.of_order(2, 80.0),) * 2),
    ],
)
def test_a_low_pass_that_is_stated_is_taken_out(filters, known):
    result = identify(stated(filmed(filters), *known))
    assert np.max(deviations(result.model)) < 3.0
    assert abs(result.model.latency - LATE_S) < 3.0 * result.model.latency_sd
    assert not result.warnings
    assert not result.model.low_passes


@pytest.mark.slow
def test_a_low_pass_that_nobody_stated_is_found_and_the_poles_do_not_bend():
    result = identify(filmed((behind(1, 300.0),) * 2))  # else -3.5 standard deviations, with white residuals
    assert np.max(deviations(result.model)) < 3.0
    assert [own.cutoff_hz for own in result.model.low_passes.values()] == pytest.approx([300.0] * 2, rel=0.05)
    assert abs(result.model.latency - LATE_S) < 4.0 * result.model.latency_sd
    assert "z0 shows the motion through a low-pass, 0.5" in " ".join(result.warnings)


@pytest.mark.slow
def test_no_mode_is_made_of_a_low_pass_and_the_model_keeps_it_for_validation():
    result = identify(filmed((None, behind(2, 60.0))))  # else a mode at 44 Hz, and a delay of 3.9 ms
    model = ModalModel.from_dict(result.model.to_dict())
    assert model.n_modes == 2
    assert np.max(deviations(model)) < 3.0
    (found,) = model.low_passes.items()
    assert found[0] == "z1"
    assert found[1].cutoff_hz == pytest.approx(60.0, rel=0.01)
    lag_sd = float(model.output_low_pass_sd[1, 0])
    assert abs(found[1].lag_s - LowPass.of_order(2, 60.0).lag_s) < 4.0 * lag_sd
    unseen = validate(model, filmed((None, behind(2, 60.0)), seed=2))
    assert [own.scores.fit_percent for own in unseen.outputs] > [99.9] * 2


@pytest.mark.slow
def test_modes_that_stand_for_low_passes_are_left_out_all_at_once():
    result = identify(filmed((behind(2, 80.0),) * 2, swept=True))  # else a third is made
    assert result.model.n_modes == 2
    assert np.max(deviations(result.model)) < 3.0
    assert [own.cutoff_hz for own in result.model.low_passes.values()] == pytest.approx([80.0] * 2, rel=0.03)
    assert not any("Misfit" in own for own in result.warnings)


@pytest.mark.slow
def test_coloured_noise_is_no_low_pass():
    def slow(rng, n):
        return signal.lfilter([1.0], [1.0, -0.9], rng.standard_normal(n))

    result = identify(filmed((None, None), noise=slow))
    assert not result.model.low_passes
    assert np.max(deviations(result.model)) < 4.0


def test_what_does_not_take_a_low_pass_out_refuses_it():
    record = stated(filmed((None, None), duration=4.0), None, LowPass(1e-3))
    with pytest.raises(
        EstimationError, match="'z1' states a low_pass of its sensor, which is not taken out here"
    ):
        estimate_transfer_function(record, 2, 1)


@pytest.mark.slow
def test_a_search_that_leads_to_no_low_pass_ends_there():
    # Records on which the likeliest low-pass is none at all: its lag shrinks without an end.
    structure = ModalStructure("receptance", has_offset=True, has_ramp=True, has_free_response=False)
    found = identify(hard_record(40), structure, n_modes=2)
    assert not found.model.low_passes
