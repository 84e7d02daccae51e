"""Modes under a hammer, from samples: early and late blows, several of them, any kind of sensor."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from beam_ident import InputSignal, OutputSignal, TimeRecord, identify
from benchmarks.ident.hammer import OMEGAS, RESIDUES, ZETAS, Hammer


def z_scores(model) -> np.ndarray:
    """Return errors of frequencies, damping ratios and residues in standard deviations."""
    assert model.n_modes == len(OMEGAS)
    errors = np.concatenate([model.natural_frequencies - OMEGAS, model.damping_ratios - ZETAS])
    scores = errors / np.concatenate([model.natural_frequency_sd, model.damping_ratio_sd])
    return np.append(scores, (model.residues - RESIDUES) / model.residue_sd)


@pytest.mark.parametrize("start_s", [2e-4, 1.0])
@pytest.mark.parametrize("kind", ["receptance", "mobility", "accelerance"])
def test_a_blow_is_identified_wherever_it_falls_and_whatever_the_sensor_measures(kind, start_s):
    found = identify(Hammer(kind, start_s).records(1), kind)
    assert found.converged
    assert not found.warnings
    # Twelve numbers, and residues of the third mode that a blow at the start hardly tells from free motion.
    assert np.max(np.abs(z_scores(found.model))) < 4.2


@pytest.mark.parametrize(
    ("kind", "start_s"), [("receptance", 2e-4), ("accelerance", 2e-4), ("accelerance", 0.02)]
)
def test_standard_deviations_are_the_bound_computed_apart(kind, start_s):
    case = Hammer(kind, start_s, is_free=start_s > 0.01)
    model = identify(case.records(2), kind).model
    stated = np.concatenate([model.natural_frequency_sd, model.damping_ratio_sd])
    assert stated == pytest.approx(case.bound, rel=0.06)


@pytest.mark.slow
def test_several_blows_are_known_better_by_the_root_of_their_number():
    case = Hammer("accelerance", 0.01, 1.0, 3)
    records = case.records(3)
    one, three = identify(records[0], "accelerance").model, identify(records, "accelerance").model
    assert np.max(np.abs(z_scores(three))) < 4.2
    assert one.natural_frequency_sd / three.natural_frequency_sd == pytest.approx(3**0.5, rel=0.1)


@pytest.mark.slow
def test_a_record_that_begins_with_a_blow_in_motion_is_not_taken_from_rest():
    case = Hammer("receptance", 2e-4)
    (record,) = case.records(4)
    # Ringing that was there before, in a fourth of a cycle from what the blow makes of itself.
    pole = OMEGAS[1] * (-ZETAS[1] + 1j * np.sqrt(1.0 - ZETAS[1] ** 2))
    ringing = np.real(np.exp(pole * case.blow.times)) * 0.3 * np.ptp(case.blow.clean[:, 1])
    outputs = tuple(
        type(o)(o.name, o.unit, o.times_s, o.values + r * ringing)
        for o, r in zip(record.outputs, RESIDUES[:, 1], strict=True)
    )
    found = identify(type(record)(record.inputs, outputs), "receptance")
    assert found.structure.has_free_response
    model = found.model
    assert model.n_modes == 3
    assert np.max(np.abs(model.natural_frequencies - OMEGAS) / model.natural_frequency_sd) < 4.0
    assert np.max(np.abs(model.damping_ratios - ZETAS) / model.damping_ratio_sd) < 4.0


@pytest.mark.slow
def test_close_modes_that_settle_slowly_give_no_sensor_a_delay():
    # Two modes 1.5 Hz apart settle late: the outputs are asked one by one, while free motion hides their clocks.
    hertz, zetas = np.array([12.3, 47.1, 118.0, 119.5, 260.0]), 1e-3 * np.array([6, 4, 8, 6, 3])
    residues = np.array([[1, 0.8, 0.5, -0.4, 0.3], [0.7, -0.9, 0.2, 0.6, -0.5], [0.3, -0.4, -0.7, 0.5, 0.6]])
    tick, finer = 1.0 / 16384.0, 8
    since = tick * np.arange(8192 * finer) - 0.01
    blow = np.where((since > 0.0) & (since < 6e-3), 200.0 * np.sin(np.pi * since / 6e-3) ** 2, 0.0)
    clean = 0.0
    for hz, zeta, residue in zip(hertz, zetas, residues.T, strict=True):
        omega = 2.0 * np.pi * hz
        b, a, _ = cont2discrete(([1.0, 0.0, 0.0], [1.0, 2.0 * zeta * omega, omega**2]), tick, "foh")
        clean = clean + lfilter(np.squeeze(b), a, blow)[::finer, None] * residue
    noise = 0.01 * np.std(clean, axis=0) * np.random.default_rng(2).standard_normal(clean.shape)
    times = since[::finer]
    seen = [OutputSignal(f"p{j}", "m/s^2", times, own) for j, own in enumerate((clean + noise).T)]
    found = identify(
        TimeRecord((InputSignal("hammer", "N", times, blow[::finer], "linear"),), tuple(seen)), "accelerance"
    )
    np.testing.assert_array_equal(found.model.output_delays, 0.0)
    assert not found.warnings
    np.testing.assert_allclose(found.model.natural_frequencies, 2.0 * np.pi * hertz, rtol=1e-4)
    np.testing.assert_allclose(found.model.damping_ratios, zetas, rtol=0.02)


@pytest.mark.slow
def test_hum_that_a_blow_does_not_ring_is_no_mode():
    (record,) = Hammer("accelerance", 0.01).records(11)
    outputs = []
    for own in record.outputs:
        hum = 0.05 * np.std(own.values) * np.sin(2.0 * np.pi * 50.0 * own.times_s + 0.3)
        outputs.append(OutputSignal(own.name, own.unit, own.times_s, own.values + hum))
    found = identify(TimeRecord(record.inputs, tuple(outputs)), "accelerance")
    assert np.max(np.abs(z_scores(found.model))) < 4.5
    assert any("a line at 50 Hz" in said and "hum" in said for said in found.warnings)
