from __future__ import annotations

import numpy as np
import pytest

from beam_ident import (
    EstimationError,
    InputSignal,
    OutputSignal,
    TimeRecord,
    fit_frequency_modes,
    fit_frequency_transfer_function,
)
from beam_ident.responses.local_polynomial import local_polynomial_response
from beam_ident.responses.spectral import welch_response
from beam_ident.transfer_function.model import TransferFunctionModel

PERIOD_S = 0.01
MODEL = TransferFunctionModel(
    np.array([900.0]), np.array([1.0, 3.0, 900.0]), 0.0, np.zeros((4, 4)), 0.0
)  # 5 % damping


def make_record(drive: np.ndarray, noise: float, input_noise: float = 0.0, cubic: bool = False) -> TimeRecord:
    rng = np.random.default_rng(1)
    times = PERIOD_S * np.arange(len(drive))
    true = InputSignal("u", "", (0.0, PERIOD_S), drive, "zoh")
    output = MODEL.simulate(true, times)
    if cubic:
        output = output + 0.02 * output**3
    output = output + noise * rng.standard_normal(len(times))
    seen = InputSignal("u", "", (0.0, PERIOD_S), drive + input_noise * rng.standard_normal(len(times)), "zoh")
    return TimeRecord((seen,), (OutputSignal("y", "", times, output),))


def exact(omegas: np.ndarray) -> np.ndarray:
    """Return the response from samples to samples through the zero-order hold."""
    from scipy.signal import cont2discrete

    numerator, denominator, _ = cont2discrete((MODEL.numerator, MODEL.denominator), PERIOD_S, "zoh")
    z = np.exp(1j * omegas * PERIOD_S)
    return np.polyval(numerator[0], z) / np.polyval(denominator, z)


@pytest.fixture(scope="module")
def noise_record():
    return make_record(np.random.default_rng(0).standard_normal(20000), 0.05)


def test_averaged_spectra_find_the_response_and_say_how_well(noise_record):
    found = welch_response(noise_record, "h1", segment_s=10.0)
    band = (found.frequencies_hz > 1.0) & (found.frequencies_hz < 12.0)
    error = np.abs(found.response[:, 0, 0] - exact(found.omegas))[band]
    # Leakage of the Hann window at a resonance of 0.5 Hz width and 0.1 Hz lines: a few per cent.
    assert np.median(error / np.abs(exact(found.omegas))[band]) < 0.03
    assert np.median(found.coherence[band]) > 0.98
    assert 0.3 < np.sqrt(np.mean((error / found.sd[band, 0, 0]) ** 2)) < 2.0


@pytest.mark.slow
def test_h1_and_h2_bracket_the_truth_when_the_input_is_noisy():
    record = make_record(np.random.default_rng(0).standard_normal(40000), 0.3, input_noise=0.3)
    sizes = {}
    for method in ("h1", "h2", "hv"):
        found = welch_response(record, method, segment_s=5.0)
        band = (found.frequencies_hz > 0.5) & (found.frequencies_hz < 3.0)
        sizes[method] = np.mean(np.abs(found.response[band, 0, 0]) / np.abs(exact(found.omegas[band])))
    assert sizes["h1"] < 0.96
    assert sizes["h1"] < sizes["hv"] < sizes["h2"]
    assert sizes["h2"] > 1.02


def test_local_polynomials_remove_the_transient_of_a_short_record():
    record = make_record(np.random.default_rng(3).standard_normal(6000), 0.01).between(20.0, 60.0)
    found = local_polynomial_response(record)
    welch_found = welch_response(record, segment_s=5.0)
    band = (found.frequencies_hz > 1.0) & (found.frequencies_hz < 12.0)
    error = np.abs(found.response[:, 0, 0] - exact(found.omegas))[band]
    other = (welch_found.frequencies_hz > 1.0) & (welch_found.frequencies_hz < 12.0)
    welch_error = np.abs(welch_found.response[:, 0, 0] - exact(welch_found.omegas))[other]
    assert np.sqrt(np.mean(error**2)) < 0.3 * np.sqrt(np.mean(welch_error**2))
    z = error / found.sd[band, 0, 0]
    assert 0.6 < np.sqrt(np.mean(z**2)) < 1.8  # the mean square of |complex z| is 1


@pytest.mark.slow
def test_a_reference_signal_removes_the_bias_of_a_noisy_input():
    rng = np.random.default_rng(5)
    command = rng.standard_normal(40000)
    record = make_record(command, 0.3, input_noise=0.5)
    record = TimeRecord(
        (*record.inputs, InputSignal("r", "", (0.0, PERIOD_S), command, "zoh")), record.outputs
    )
    keywords = {"segment_s": 5.0, "input_name": "u"}
    found = welch_response(record, "reference", reference_name="r", **keywords)
    h1 = welch_response(record, "h1", **keywords)
    band = (found.frequencies_hz > 0.5) & (found.frequencies_hz < 3.0)
    error = (found.response[:, 0, 0] - exact(found.omegas))[band]
    assert np.mean(np.abs(h1.response[band, 0, 0]) / np.abs(exact(h1.omegas[band]))) < 0.85
    assert abs(np.mean(error / exact(found.omegas[band]))) < 0.02
    # The mean square of |complex z| is 1; 12 lines, and a bias of leakage beside the noise.
    assert 0.5 < np.sqrt(np.mean(np.abs(error / found.sd[band, 0, 0]) ** 2)) < 1.5


def test_several_outputs_stand_in_one_record(noise_record):
    output = noise_record.outputs[0]
    double = OutputSignal("twice", "", output.times_s, 2.0 * output.values)
    both = welch_response(TimeRecord(noise_record.inputs, (output, double)), segment_s=10.0)
    assert both.output_names == ("y", "twice")
    np.testing.assert_allclose(both.response[:, 1], 2.0 * both.response[:, 0])


def test_what_cannot_be_transformed_is_refused(noise_record):
    output = noise_record.outputs[0]
    stamps = output.times_s + np.random.default_rng(0).uniform(0, 4e-3, len(output.times_s))
    irregular = TimeRecord(noise_record.inputs, (OutputSignal("y", "", stamps, output.values),))
    with pytest.raises(EstimationError, match="irregular"):
        welch_response(irregular)
    holes = output.values.copy()
    holes[::10] = np.nan
    with pytest.raises(EstimationError, match=r"10\.0% of the samples are missing"):
        welch_response(TimeRecord(noise_record.inputs, (OutputSignal("y", "", output.times_s, holes),)))
    with pytest.raises(EstimationError, match="method is 'h3'"):
        welch_response(noise_record, "h3")
    with pytest.raises(EstimationError, match="one needs the other"):
        welch_response(noise_record, "reference")
    with pytest.raises(EstimationError, match="half_width is 1"):
        local_polynomial_response(noise_record, half_width=1)


def test_lines_that_share_data_are_said_to_and_a_fit_of_them_warns():
    rng = np.random.default_rng(1)
    drive = InputSignal("u", "N", (0.0, 0.01), rng.standard_normal(1000), "zoh")
    noise = OutputSignal("y", "m", 0.01 * np.arange(1, 1000), rng.standard_normal(999))
    found = local_polynomial_response(TimeRecord((drive,), (noise,)))
    # Neighbours' errors correlate as the smoother's weights overlap: five lines and more for a parabola over 13.
    assert 5.0 < found.shared_lines < 6.5
    assert "neighbouring lines share data" in fit_frequency_modes(found, "receptance", n_modes=1).warnings[0]
    assert any("share data" in said for said in fit_frequency_transfer_function(found, 2, 0).warnings)
    assert welch_response(TimeRecord((drive,), (noise,))).shared_lines == 1.0


@pytest.mark.slow
@pytest.mark.parametrize("method", ["h1", "reference"])
def test_the_variance_of_few_averages_is_not_below_the_scatter(method):
    errors, variances = [], []
    for seed in range(120):
        rng = np.random.default_rng(seed)
        drive = rng.standard_normal(600)
        output = 2.0 * drive + 0.5 * rng.standard_normal(600)  # no memory: nothing leaks
        signals = [InputSignal(name, "", (0.0, PERIOD_S), drive, "zoh") for name in ("u", "r")]
        record = TimeRecord(tuple(signals), (OutputSignal("y", "", (0.0, PERIOD_S), output),))
        reference = "r" if method == "reference" else None
        found = welch_response(record, method, 2.0, input_name="u", reference_name=reference)
        errors.append(np.abs(found.response[2:-2, 0, 0] - 2.0) ** 2)
        variances.append(found.variance[2:-2, 0, 0])
    # Segments of a third of the record, 3.7 averages. What is stated is no less than the scatter, and the overlap of
    # the windows is counted as costing more than it does: 0.7 and 0.95 were measured.
    assert 0.6 < np.mean(errors) / np.mean(variances) < 1.05


def test_outputs_of_different_length_have_different_lines_and_are_refused(noise_record):
    output = noise_record.outputs[0]
    shorter = OutputSignal("shorter", "", output.times_s[:9000], output.values[:9000])
    with pytest.raises(EstimationError, match="'y' and 'shorter' have different stamps"):
        welch_response(TimeRecord(noise_record.inputs, (output, shorter)))


def leaks(drive: np.ndarray, **options: float) -> bool:
    return any("what leaks" in said for said in welch_response(make_record(drive, 0.1), **options).warnings)


@pytest.mark.slow
def test_leakage_of_what_is_no_stationary_noise_is_named(noise_record):
    t = PERIOD_S * np.arange(20000)
    assert leaks(np.sin(2 * np.pi * (0.5 * t + 14.5 * t**2 / (2 * t[-1]))))
    assert leaks(np.where(np.abs(t - 5.0) < 0.02, 100.0, 0.0))
    assert leaks(np.random.default_rng(2).standard_normal(20000), segment_s=0.4)  # a mode rings for 0.7 s
    assert not any("what leaks" in said for said in welch_response(noise_record).warnings)
    # By chance in one of two hundred such records.
    assert sum(leaks(np.random.default_rng(seed).standard_normal(8000)) for seed in range(10)) <= 1


@pytest.mark.parametrize(
    "estimate",
    [
        local_polynomial_response,
        lambda record: welch_response(record, segment_s=record.inputs[0].span_s[1] / 8.0),
    ],
    ids=["local polynomial", "welch"],
)
def test_a_resonance_narrower_than_what_lines_are_smoothed_over_is_named(estimate):
    # Half-power band 0.48 Hz: 13 lines of a record are as wide after 27 s, 4 of an eighth of it after 67 s.
    rng = np.random.default_rng(8)
    for n, is_named in ((1000, True), (20000, False)):
        found = estimate(make_record(rng.standard_normal(n), 1e-3))
        assert any("too short for it" in said for said in found.warnings) == is_named


def test_segments_in_which_the_input_stands_still_are_refused():
    drive = np.zeros(1010)  # of which segments of 200, every 100, leave the last ten out
    drive[-1] = 1.0
    with pytest.raises(EstimationError, match="stands still in every segment"):
        welch_response(make_record(drive, 1e-3), segment_s=2.0)


def test_single_samples_far_off_are_named_and_none_of_sound_records():
    rng = np.random.default_rng(3)
    sound = make_record(rng.standard_normal(6000), noise=0.05)
    values = sound.output("y").values.copy()
    values[[1500, 2900, 4100]] += 6.0
    spiky = TimeRecord(sound.inputs, (OutputSignal("y", "", sound.output("y").times_s, values),))
    said = welch_response(spiky, segment_s=10.0).warnings
    assert any("Outliers: 3 of" in text for text in said)
    assert not any("Outliers" in text for text in welch_response(sound, segment_s=10.0).warnings)
