from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from beam_ident import EstimationError, InputSignal, OutputSignal, TimeRecord
from beam_ident.responses.periodic_averaging import periodic_response
from beam_ident.responses.periods import moving_mean
from tests.beam_ident.periodic import LINE_PERIOD_S, LINES_HZ, PLANT, multisine, siso_record


def predicted(record, omegas):
    """Return what the plant shows at the lines, by the record's own folding."""

    def at(values):
        return np.polyval(PLANT.numerator, 1j * values) / np.polyval(PLANT.denominator, 1j * values)

    folding = record.folding
    # 900 / (s^2 + 3 s + 900) = 900 / s^2 - 2700 / s^3 ..
    return at(omegas) + np.sum(folding.weights * at(folding.omegas), axis=1) + 900.0 * folding.tails[:, 4]


@pytest.mark.parametrize("hold", ["zoh", "linear", "cubic", "band_limited"])
@pytest.mark.parametrize(("step", "offset", "exposure"), [(1, 0.0, 0.0), (2, 0.003, 0.006), (4, 0.0, 0.0)])
def test_hold_exposure_and_folding_are_accounted_for_exactly(hold, step, offset, exposure):
    # With four ticks a sample the outputs' half rate is 12.5 Hz, and lines up to 37.3 Hz fold onto bins of their own.
    found = periodic_response(
        siso_record(hold=hold, step=step, offset=offset, exposure=exposure), LINE_PERIOD_S, LINES_HZ
    ).response
    model = predicted(found, found.omegas)
    # Beyond the images kept, the third term of the plant's expansion is left: 1e-6 at the worst line.
    error = np.abs(found.response[:, 0, 0] - model) / np.max(np.abs(model))
    assert np.max(error) < 2e-6
    assert found.frequencies_hz[-1] > 37.0


@pytest.mark.parametrize("stamps", ["late", "lost", "another rate"])
def test_stamps_off_the_grid_of_the_period_leave_a_response_exact(stamps):
    record = siso_record(hold="band_limited")
    output, rng = record.outputs[0], np.random.default_rng(0)
    lines = LINES_HZ[LINES_HZ < 15.0]
    times = {
        "late": output.times_s + rng.uniform(0.0, 4e-3, len(output.times_s)),
        "lost": np.delete(output.times_s, rng.choice(len(output.times_s), 200, replace=False)),
        "another rate": np.arange(20.0, 59.9, 0.009973),
    }[stamps]
    period = multisine(7, lines)
    drive = InputSignal("u", "", (0.0, 0.01), period, "band_limited")
    values = PLANT.simulate(drive, times)
    values = values + 1e-3 * (times - 30.0)  # a drift, too
    found = periodic_response(
        TimeRecord((drive,), (OutputSignal("y", "", times, values),)), LINE_PERIOD_S, lines
    ).response
    s = 1j * found.omegas
    truth = np.polyval(PLANT.numerator, s) / np.polyval(PLANT.denominator, s)
    assert np.max(np.abs(found.response[:, 0, 0] - truth)) < 1e-5 * np.max(np.abs(truth))
    assert found.n_lines == len(lines)


def test_a_period_with_a_long_hole_is_left_out():
    record = siso_record(n_periods=4)
    output = record.outputs[0]
    is_lost = (output.times_s > 34.0) & (output.times_s < 34.2)
    # An offset is not a drift, whichever periods are kept.
    values = np.where(is_lost, np.nan, output.values + 5.0)
    lines = LINES_HZ[LINES_HZ < 30.0]
    holey = TimeRecord(record.inputs, (dataclasses.replace(output, values=values),))
    found = periodic_response(holey, LINE_PERIOD_S, lines)
    assert found.n_periods == 3
    whole = periodic_response(record, LINE_PERIOD_S, lines)
    np.testing.assert_allclose(found.response.response, whole.response.response, rtol=1e-3)


def test_lines_are_found_from_the_input_and_reported_where_they_were_excited():
    found = periodic_response(siso_record(step=4), LINE_PERIOD_S)
    assert set(np.round(found.response.frequencies_hz, 6)) <= set(np.round(LINES_HZ, 6))
    assert np.max(found.response.frequencies_hz) > 2.9 * 12.5


def test_a_noisy_measured_input_leaves_the_response_unbiased_and_its_variance_true():
    scores, naive = [], []
    for seed in range(12):
        record = siso_record(noise=0.01, input_noise=0.05, step=2, seed=seed)
        found = periodic_response(record, LINE_PERIOD_S, LINES_HZ).response
        model = predicted(found, found.omegas)
        error = found.response[:, 0, 0] - model
        scores.append(np.mean(np.abs(error) ** 2 / found.variance[:, 0, 0]))
        quiet = periodic_response(
            siso_record(noise=0.01, step=2, seed=seed), LINE_PERIOD_S, LINES_HZ
        ).response
        naive.append(np.mean(np.abs(error) ** 2 / quiet.variance[:, 0, 0]))
    # 12 runs of about 110 lines: the mean square of |complex z| is 1 +- 0.03, 1.03 for variances of 40 freedoms.
    assert 0.9 < np.mean(scores) < 1.18
    assert np.mean(naive) > 2.0  # the output's noise alone would not explain the errors


def test_errors_of_two_outputs_under_one_noisy_input_depend_on_each_other():
    record = siso_record(input_noise=0.05, noise=1e-3)
    twin = dataclasses.replace(record.outputs[0], name="twin", values=2.0 * record.outputs[0].values)
    both = TimeRecord(record.inputs, (record.outputs[0], twin))
    covariance = periodic_response(both, LINE_PERIOD_S, LINES_HZ).response.covariance
    correlation = covariance[:, 0, 1].real / np.sqrt(covariance[:, 0, 0].real * covariance[:, 1, 1].real)
    np.testing.assert_allclose(correlation, 1.0, atol=1e-9)


def test_a_straight_drift_does_not_leak_into_the_lines():
    record = siso_record()
    output = record.outputs[0]
    drifting = dataclasses.replace(output, values=output.values + 0.3 * output.times_s - 2.0)
    still = periodic_response(record, LINE_PERIOD_S, LINES_HZ).response
    moved = periodic_response(TimeRecord(record.inputs, (drifting,)), LINE_PERIOD_S, LINES_HZ).response
    np.testing.assert_allclose(moved.response, still.response, atol=1e-10)


def test_a_transient_shows_as_drift():
    steady = periodic_response(siso_record(noise=1e-3, n_periods=8), LINE_PERIOD_S, LINES_HZ)
    assert steady.drift[0] < 1.3
    record = siso_record(noise=1e-3, n_periods=8)
    output = record.outputs[0]
    ringing = 0.02 * np.exp(-0.05 * (output.times_s - output.times_s[0])) * np.cos(30.0 * output.times_s)
    unsteady = TimeRecord(record.inputs, (dataclasses.replace(output, values=output.values + ringing),))
    assert periodic_response(unsteady, LINE_PERIOD_S, LINES_HZ).drift[0] > 2.0


def test_what_is_not_periodic_is_refused_with_the_remedy():
    record = siso_record()
    output = record.outputs[0]
    uneven = dataclasses.replace(output, times_s=20.0 + 0.00999 * np.arange(len(output.times_s)))
    with pytest.raises(EstimationError, match=r"44\.9 Hz lies too near half"):
        periodic_response(TimeRecord(record.inputs, (uneven,)), LINE_PERIOD_S, LINES_HZ)
    with pytest.raises(EstimationError, match="1 whole periods"):
        periodic_response(record, LINE_PERIOD_S, LINES_HZ, start_s=20.0, end_s=35.0)
    with pytest.raises(EstimationError, match=r"multiples of 0\.1 Hz"):
        periodic_response(record, LINE_PERIOD_S, np.array([0.55]))
    holes = output.values.copy()
    holes[::10] = np.nan
    with pytest.raises(EstimationError, match=r"10\.0% of the samples are missing"):
        periodic_response(
            TimeRecord(record.inputs, (dataclasses.replace(output, values=holes),)), LINE_PERIOD_S
        )
    drive = record.inputs[0]
    uneven = InputSignal("u", "", np.append(drive.times_s[:-1], drive.times_s[-1] + 0.004), drive.values)
    with pytest.raises(EstimationError, match="needs a regular input"):
        periodic_response(TimeRecord((uneven,), record.outputs), LINE_PERIOD_S)
    other = OutputSignal("z", "", output.times_s, output.values, exposure_s=2e-3)
    with pytest.raises(EstimationError, match="different exposures"):
        periodic_response(TimeRecord(record.inputs, (output, other)), LINE_PERIOD_S)


@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e3])
def test_of_a_measured_input_only_what_stands_out_of_the_noise_beside_it_counts(unit):
    record = siso_record()
    drive = record.inputs[0]
    times = drive.times_s - record.outputs[0].times_s[0]
    rng = np.random.default_rng(2)
    # White noise, and a hundred times more of it from 30 Hz on; of each period anew, so that it does not leak.
    loud = np.fft.rfft(rng.standard_normal((len(times) // 1000, 1000)))
    loud[:, :300] = 0.0
    noise = 1e-3 * (rng.standard_normal(len(times)) + 100.0 * np.fft.irfft(loud).ravel())
    # Two sines that nobody names, of a hundred times the power of white noise in their lines (four periods of a
    # thousand ticks): one far from the loud noise, one 3 Hz below it.
    unnamed = np.array([102, 270])
    amplitude = 1e-3 * 10.0 * 2.0 / np.sqrt(4 * 1000)
    sines = amplitude * np.sin(2 * np.pi / LINE_PERIOD_S * np.multiply.outer(times, unnamed))
    values = unit * (drive.values + noise + np.sum(sines, axis=1))
    seen = dataclasses.replace(drive, values=values)
    found = periodic_response(TimeRecord((seen,), record.outputs), LINE_PERIOD_S, LINES_HZ)
    spectrum = dict(zip(found.bins.tolist(), found.input_spectrum / unit, strict=True))
    # The noise of an amplitude is a tenth of it: four standard deviations.
    assert np.max(np.abs([spectrum[k] + 1j * amplitude for k in unnamed])) < 0.4 * amplitude
    named = np.round(LINES_HZ * LINE_PERIOD_S).astype(int).tolist()
    assert np.min(np.abs([spectrum[k] for k in named])) > 0.08  # 1 / sqrt(112), and the loud noise
    others = [abs(spectrum[k]) for k in spectrum if k not in {*named, *unnamed.tolist()}]
    assert np.max(others) < 1e-12


def test_a_line_counts_beyond_fifteen_times_the_power_of_forty_freedoms_of_noise():
    record = siso_record(n_periods=2)
    drive = record.inputs[0]
    periods = drive.values.reshape(-1, 1000).copy()  # of which the output has the third and the fourth
    angles = 2.0 * np.pi * np.arange(1000) / 1000
    # Noise that is known: what one period has more and the next one less. An impulse of 1 is 1 in every line, so
    # that the mean of two periods has the variance 1; line 300 has that of forty lines, the freedom of two periods.
    noise = np.sqrt(40.0) / 500.0 * np.sin(300 * angles)
    noise[0] += 1.0
    periods[2] += noise
    periods[3] -= noise
    power = {150: 14.9, 160: 15.1, 286: 29.0, 288: 31.0, 322: 29.0}  # 322 is too far from line 300
    for line, times_noise in power.items():
        periods += np.sqrt(times_noise) / 500.0 * np.sin(line * angles)
    seen = dataclasses.replace(drive, values=periods.ravel())
    found = periodic_response(TimeRecord((seen,), record.outputs), LINE_PERIOD_S, LINES_HZ)
    spectrum = dict(zip(found.bins.tolist(), 500.0 * np.abs(found.input_spectrum), strict=True))
    kept = {line: spectrum[line] ** 2 for line in (*power, 300) if spectrum[line] > 1e-9}
    assert kept == pytest.approx({line: power[line] for line in (160, 288, 322)})


@pytest.mark.parametrize("width", [1, 3, 4, 9, 12])
def test_amoving_mean_is_centred_and_whole_at_the_ends(width):
    values = np.random.default_rng(0).standard_normal((12, 2))
    found = moving_mean(values, width)
    for line in range(12):
        first = min(max(line - width // 2, 0), 12 - width)
        np.testing.assert_allclose(found[line], np.mean(values[first : first + width], axis=0), atol=1e-12)
