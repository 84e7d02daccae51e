from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from beam_ident import (
    EstimationError,
    InputSignal,
    OutputSignal,
    TimeRecord,
    fit_frequency_transfer_function,
    restore,
)
from beam_ident.best_linear.approximation import _p_value, best_linear_approximation
from beam_ident.best_linear.result import LineVariances
from beam_ident.figures import best_linear_figure
from beam_ident.report.measurement import add_best_linear
from beam_ident.report.page import Page
from benchmarks.ident.best_linear import LinearLoopless, NoisyInput, Polynomial, Signals

M, P = 7, 4
CASE = Polynomial()
LINES_HZ = CASE.excited / CASE.period_s


def records(case=CASE, seed=0, realisations=M):
    return case.records(case.simulate(np.random.default_rng(seed), realisations))


def approximation(of=None, **more):
    options = {"excited_hz": LINES_HZ, "skip_periods": 0, **more}
    return best_linear_approximation(records() if of is None else of, 1.0, **options)


@pytest.mark.slow
def test_bands_hold_noise_and_distortion_and_the_response_errs_as_stated():
    # The truth is a sum over all combinations of lines. 10 studies of 45 lines: 900 bands, 0.7 % of scatter.
    case = NoisyInput()
    found = [case.run(seed).figures for seed in range(10)]

    def mean(name):
        return np.mean([one[name] for one in found])

    for where in ("excited", "odd", "even"):
        assert 0.91 < mean(f"distortion held, {where}") < 0.985
        assert 0.92 < mean(f"noise held, {where}") < 0.98
        assert mean(f"noise over truth, {where}") == pytest.approx(1.0, abs=0.05)
        assert mean(f"distortion over truth, {where}") == pytest.approx(1.0, abs=0.15)
    # Of 6 complex degrees of freedom: |z|^2 is (M - 1) / (M - 2) on average.
    assert mean("squared z of the response") == pytest.approx(1.2, abs=0.2)
    assert mean("called nonlinear") == 1.0


def test_a_linear_system_is_left_in_peace():
    case = LinearLoopless()
    found = case.approximation(case.simulate(np.random.default_rng(3), M))
    assert found.p_value > 0.01
    assert found.verdict.startswith("linear as far as the noise of a realisation")
    assert not found.distortion.is_nonlinear
    # Nothing is left beside the noise: half of the differences are below zero, and most bands begin there.
    assert np.mean(found.excited.distortion_band()[0] == 0.0) > 0.9


def test_many_lines_of_noise_are_called_nonlinear_no_more_often_than_few():
    # 600 draws of 2000 lines: 5 % +- 0.9 %.
    rng = np.random.default_rng(0)
    n, of_total, of_noise = 2000, 2.0 * (M - 1), 2.0 * M * (P - 1)
    flagged = 0
    for _ in range(600):
        total = rng.chisquare(of_total, (n, 1)) / of_total
        noise = rng.chisquare(of_noise, (n, 1)) / of_noise
        lines = LineVariances(np.ones(n), total, noise, np.full(n, of_total), np.full(n, of_noise))
        flagged += _p_value(lines, np.ones((n, 1), dtype=complex)) < 0.05
    assert 0.025 < flagged / 600 < 0.075


def test_even_and_odd_lines_show_their_own_part():
    class Odd(Polynomial):
        square = 0.0

    found = Odd().approximation(Odd().simulate(np.random.default_rng(0), M))
    assert {level.parity for level in found.distortion.levels if level.is_detected} == {"odd"}
    assert np.mean(found.even.distortion_band()[0] > 0.0) < 0.1
    # On the odd lines that are left out stands what stands on the excited ones.
    ratio = np.mean(found.odd.distortion) / np.mean(found.excited.distortion)
    assert 0.4 < ratio < 2.5
    assert found.verdict.startswith("nonlinear: distortion of -")


@pytest.mark.slow
@pytest.mark.parametrize("has_reference", [True, False])
def test_in_a_loop_the_reference_removes_the_bias_that_comes_around(has_reference):
    # y = 2 u + d, u = r - 0.4 y: a gain of 2 in a loop; d is noise, and what repeats with every realisation.
    gain, back, n = 2.0, 0.4, 256
    rng = np.random.default_rng(0)
    lines = np.arange(1, 60)
    found, steps = [], 1.0 / n
    for _ in range(40):
        spectrum = np.zeros(n // 2 + 1, dtype=complex)
        spectrum[lines] = n / 2 * np.exp(2j * np.pi * rng.uniform(size=len(lines))) / np.sqrt(len(lines))
        r = np.tile(np.fft.irfft(spectrum, n), 3)
        d = 0.8 * np.tile(rng.standard_normal(n), 3) + 0.1 * rng.standard_normal(3 * n)
        y = (gain * r + d) / (1.0 + gain * back)
        u = r - back * y
        inputs = [InputSignal("u", "", (0.0, steps), u, "band_limited")]
        inputs += [InputSignal("r", "", (0.0, steps), r, "band_limited")]
        found.append(TimeRecord(tuple(inputs), (OutputSignal("y", "", (0.0, steps), y),)))
    best = best_linear_approximation(
        found, 1.0, lines, skip_periods=0, input_name="u", reference_name="r" if has_reference else None
    )
    z = np.mean((best.response[:, 0] - gain) / np.sqrt(best.total_covariance[:, 0, 0].real)) * np.sqrt(
        len(lines)
    )
    if has_reference:
        assert abs(z) < 3.0
        # Var d over |u|^2 of the reference: 0.64 / n beside (1 / 1.8)^2 / (4 * 59).
        expected = 0.64 / n / (1.0 / 1.8**2 / 4.0 / len(lines))
        assert np.mean(best.excited.distortion) == pytest.approx(expected, rel=0.1)
        assert not [said for said in best.warnings if "reference_name" in said]
    else:
        assert abs(z) > 5.0
        assert [said for said in best.warnings if "reference_name" in said]


def test_variances_of_detection_lines_are_of_the_same_kind_as_those_of_excited_ones():
    # What comes around a loop into the input, here as strong as the reference, is no part of what excites.
    n, rng, given = 256, np.random.default_rng(3), []
    odd = np.arange(1, 100, 2)
    lines = np.delete(odd, np.arange(2, 48, 4))
    for _ in range(16):
        r, back = (
            np.fft.irfft(
                np.bincount(own, minlength=n // 2 + 1) * np.exp(2j * np.pi * rng.uniform(size=n // 2 + 1)), n
            )
            for own in (lines, odd)
        )
        u = np.tile(r + back, 3)
        y = 2.0 * u + 1e-3 * rng.standard_normal(3 * n)
        step = 1.0 / n
        inputs = (
            InputSignal("u", "", (0.0, step), u, "band_limited"),
            InputSignal("r", "", (0.0, step), np.tile(r, 3), "band_limited"),
        )
        given.append(TimeRecord(inputs, (OutputSignal("y", "", (0.0, step), y),)))
    best = best_linear_approximation(given, 1.0, lines, skip_periods=0, input_name="u", reference_name="r")
    # What comes back leaves 35 % of scatter to the power at a line, of which there are 12.
    assert np.mean(best.odd.noise) == pytest.approx(np.mean(best.excited.noise), rel=0.4)


@pytest.mark.slow
def test_noise_of_the_input_does_not_bias_the_response():
    # A thousandth of a period's amplitude is left of the bias of H1, 5 % here.
    case = NoisyInput()
    case.square = case.cube = 0.0
    case.input_noise = 1.0
    found = [case.approximation(case.simulate(np.random.default_rng(seed), 12)) for seed in range(3)]
    ratio = np.mean([one.response[:, 0] / case.plant[case.excited] for one in found])
    power = 0.5 / len(case.excited)
    assert case.input_noise**2 / case.n_samples / P / power > 0.04
    assert abs(ratio - 1.0) < 0.01


def test_noise_that_passes_through_the_system_does_not_bias_the_response():
    # What shakes the input is seen by the sensor of the input and moves the output: y = 2 u, whatever u is.
    given = []
    for one in records():
        shaking = np.random.default_rng(len(given)).standard_normal((P, CASE.n_samples))
        shaking -= np.mean(shaking, axis=1)[
            :, None
        ]  # a drift of the outputs would be taken away, the inputs' not
        u = one.inputs[0].values + shaking.ravel()
        drive = dataclasses.replace(one.inputs[0], values=u)
        given.append(TimeRecord((drive,), (dataclasses.replace(one.outputs[0], values=2.0 * u),)))
    # The spline that stands for a band-limited input errs by 1e-5 at half of the band.
    np.testing.assert_allclose(approximation(given).response, 2.0, rtol=2e-5)


def test_one_record_may_hold_all_realisations():
    apart = records(realisations=3)
    step, n = CASE.period_s / CASE.n_samples, P * CASE.n_samples
    u, y = (np.concatenate([getattr(one, kind)[0].values for one in apart]) for kind in ("inputs", "outputs"))
    joined = TimeRecord(
        (InputSignal("u", "N", (0.0, step), u, "band_limited"),), (OutputSignal("y", "m", (0.0, step), y),)
    )
    windows = [(k * P, (k + 1) * P - 0.5 * step) for k in range(3)]
    found = approximation(joined, windows_s=windows)
    np.testing.assert_allclose(found.response, approximation(apart).response, rtol=1e-9)
    assert found.n_periods == (P,) * 3
    assert n == len(apart[0].outputs[0].values)


def test_realisations_may_excite_lines_of_their_own():
    of_each = [np.delete(LINES_HZ, slice(k, None, M)) for k in range(M)]
    found = approximation(excited_hz=of_each)
    assert found.n_realisations.tolist() == [M - 1] * len(LINES_HZ)
    assert np.all(found.excited.total_freedom == 2 * (M - 2))
    with pytest.raises(EstimationError, match="lines of 2 realisations; expected those of 7"):
        approximation(excited_hz=of_each[:2])


@pytest.mark.slow
def test_periods_that_still_settle_are_left_out():
    given = records()
    t = given[0].outputs[0].times_s
    ringing = 3.0 * np.exp(-5.0 * t) * np.cos(250.0 * t)
    shaken = [
        TimeRecord(one.inputs, (dataclasses.replace(one.outputs[0], values=one.outputs[0].values + ringing),))
        for one in given
    ]
    found = approximation(shaken, skip_periods=None)
    assert found.skipped_periods == 1
    assert found.n_periods == (P - 1,) * M
    calm = approximation(given, skip_periods=1)
    # The ringing, at 40 Hz, falls by e^5 from one period to the next.
    assert np.max(approximation(shaken).excited.noise / calm.excited.noise) > 20.0
    assert np.max(found.excited.noise / calm.excited.noise) < 4.0


def test_stamps_off_the_grid_and_lost_samples_change_nothing():
    rng = np.random.default_rng(5)
    lost = []
    for one in records():
        values = one.outputs[0].values.copy()
        values[rng.choice(len(values), 20, replace=False)] = np.nan
        lost.append(TimeRecord(one.inputs, (dataclasses.replace(one.outputs[0], values=values),)))
    found, whole = approximation(lost), approximation()
    z = np.abs(found.response - whole.response)[:, 0] / np.sqrt(whole.noise_covariance[:, 0, 0].real)
    assert np.median(z) < 0.5
    assert np.median(found.excited.noise / whole.excited.noise) == pytest.approx(1.0, abs=0.1)


@pytest.mark.slow
def test_a_model_is_fitted_with_the_total_or_with_the_noise_covariance():
    found = approximation()
    total, noise = (
        fit_frequency_transfer_function(found.record(which), 2, 1, delay="estimate")
        for which in ("total", "noise")
    )
    sd = [own.model.modes()[2][0] for own in (total, noise)]
    assert sd[0] > 2.0 * sd[1]
    assert total.misfit.is_noise
    assert not noise.misfit.is_noise
    with pytest.raises(EstimationError, match="expected 'total' or 'noise'"):
        found.record("both")


def test_the_covariance_of_several_outputs_is_theirs():
    twins = [
        TimeRecord(
            one.inputs,
            (
                one.outputs[0],
                dataclasses.replace(one.outputs[0], name="z", values=-2.0 * one.outputs[0].values),
            ),
        )
        for one in records()
    ]
    found = approximation(twins)
    for covariance in (found.total_covariance, found.noise_covariance, found.record().covariance):
        np.testing.assert_allclose(covariance[:, 0, 1], -2.0 * covariance[:, 0, 0], rtol=1e-6)
        np.testing.assert_allclose(covariance[:, 1, 1], 4.0 * covariance[:, 0, 0], rtol=1e-6)


def test_it_goes_through_json():
    found = approximation()
    again = restore(json.loads(json.dumps(found.to_dict(), allow_nan=False)))
    np.testing.assert_array_equal(again.total_covariance, found.total_covariance)
    np.testing.assert_array_equal(again.odd.noise_band(), found.odd.noise_band())
    assert again.distortion == found.distortion


def test_the_report_draws_response_noise_and_distortion_with_the_test_of_the_detection_lines():
    found = approximation()
    page = Page("title", "lead")
    page.section("Noise and distortion")
    add_best_linear(page, found)
    assert set(page.figures) == {"best-linear"}
    assert "nonlinear: distortion of -" in page.text().lower()
    assert page.text().count(">distortion<") == 2  # at even and at odd lines
    axis = best_linear_figure(found).axes[0]
    drawn = {line.get_label(): line.get_ydata() for line in axis.lines}
    np.testing.assert_allclose(drawn["response"], np.abs(found.response[:, 0]))
    np.testing.assert_allclose(drawn["noise, with 95 %"] ** 2, found.excited.noise[:, 0])
    assert len(drawn["distortion on even detection lines"]) == len(CASE.even)


def aperiodic():
    signals = CASE.simulate(np.random.default_rng(0), 3)
    noise = np.random.default_rng(1).standard_normal(signals.drive.shape)
    return CASE.records(Signals(signals.reference, noise, signals.output))


STILL = TimeRecord(
    (InputSignal("u", "N", (0.0, 1 / 512), np.ones(2048)),),
    (OutputSignal("y", "m", (0.0, 1 / 512), np.random.default_rng(0).standard_normal(2048)),),
)


@pytest.mark.parametrize(
    ("of", "more", "says"),
    [
        (lambda: records(realisations=1), {}, "there is one realisation.*other seeds"),
        (lambda: records(realisations=2) * 2, {}, "realisations 1 and 3 .* are the same signal"),
        (
            lambda: [one.between(0.0, 1.5) for one in records()],
            {},
            "1 whole periods of 1.0 s; expected at least two",
        ),
        (aperiodic, {}, r"of the power of 'u' repeats after 1 s; expected a periodic excitation"),
        (records, {"windows_s": [(0.0, 1.0)]}, "1 windows for 7 records"),
        (records, {"input_name": "v"}, "input_name is 'v'"),
        (records, {"reference_name": "u"}, "an input of record"),
        (records, {"skip_periods": -1}, "skip_periods"),
        (records, {"skip_periods": 3}, "1 whole periods"),
        (records, {"output_names": []}, "no output is named; expected some of y"),
        (lambda: [*records(realisations=3)[:2], STILL], {}, "input 'u' excites no line"),
    ],
)
def test_bad_input_is_refused_with_the_remedy(of, more, says):
    with pytest.raises(EstimationError, match=says):
        approximation(of(), **more)


@pytest.mark.first_case
@pytest.mark.parametrize("period_s", [1.001, 0.9997])
def test_a_period_that_is_slightly_wrong_is_refused_with_the_likely_one(period_s):
    with pytest.raises(EstimationError, match=r"later from period to period .* may be (1\.0000|0\.9999)"):
        best_linear_approximation(records(), period_s)


def test_without_noise_rounding_is_no_distortion():
    class Silent(LinearLoopless):
        output_noise = 0.0

    quiet = approximation(records(Silent()))
    assert quiet.verdict.startswith("linear as far as")
    assert not quiet.distortion.is_nonlinear

    class Bent(Polynomial):
        output_noise = 0.0

    assert approximation(records(Bent())).verdict.startswith("nonlinear: distortion of -")


def test_the_same_phases_begun_later_are_found_out():
    one, other = records(realisations=2)
    turned = TimeRecord(
        (dataclasses.replace(one.inputs[0], values=np.roll(one.inputs[0].values, 137)),),
        (dataclasses.replace(one.outputs[0], values=np.roll(one.outputs[0].values, 137)),),
    )
    with pytest.raises(EstimationError, match="realisations 1 and 3"):
        approximation([one, other, turned])


def test_a_spectrum_of_one_strong_line_is_not_taken_for_one_signal():
    def falling(values):
        spectrum = np.fft.rfft(values)
        return np.fft.irfft(spectrum / (1.0 + np.arange(len(spectrum))) ** 3, len(values))

    given = [
        TimeRecord(
            (dataclasses.replace(one.inputs[0], values=falling(one.inputs[0].values)),),
            (dataclasses.replace(one.outputs[0], values=falling(one.outputs[0].values)),),
        )
        for one in records()
    ]
    assert len(approximation(given).omegas) == len(LINES_HZ)


def test_clipped_samples_and_unlike_levels_are_said():
    given = records()
    top = 0.7 * np.max(given[0].outputs[0].values)
    clipped = [
        TimeRecord(
            one.inputs, (dataclasses.replace(one.outputs[0], values=np.minimum(one.outputs[0].values, top)),)
        )
        for one in given
    ]
    said = approximation(clipped).warnings
    assert len([one for one in said if "Clipped" in one and "more realisations" in one]) == 1
    louder = [
        TimeRecord(
            (dataclasses.replace(one.inputs[0], values=(1.0 + k) * one.inputs[0].values),),
            (dataclasses.replace(one.outputs[0], values=(1.0 + k) * one.outputs[0].values),),
        )
        for k, one in enumerate(given)
    ]
    assert [said for said in approximation(louder).warnings if "depends on the level" in said]
