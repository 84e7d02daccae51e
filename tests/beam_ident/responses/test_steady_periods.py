from __future__ import annotations

import functools
import json
import re

import numpy as np
import pytest

from beam_ident import (
    FrequencyRecord,
    InputSignal,
    Multisine,
    OutputSignal,
    TimeRecord,
    TransferFunctionModel,
    fit_frequency_modes,
    fit_frequency_transfer_function,
    local_polynomial_response,
    periodic_response,
    welch_response,
)
from beam_ident.data.frequency_record import beside
from beam_ident.responses.steady_periods import changing_warnings, drift_of_periods, input_changes
from tests.beam_ident.periodic import LINE_PERIOD_S, LINES_HZ, modal_plant, siso_record

RECIPE = Multisine(start_frequency=2.0, end_frequency=20.0, line_period=5.0, n_periods=7)


@functools.cache
def played() -> TimeRecord:
    """Return the recipe, fades included, on the two-mode plant."""
    drive = RECIPE.sample(2e-3).input_signal("position", "hub")
    stamps = 0.01 * np.arange(1, 3500)
    values = modal_plant().simulate(drive, stamps)[:, 0]
    values = values + 1e-7 * np.random.default_rng(1).standard_normal(len(stamps))
    return TimeRecord((drive,), (OutputSignal("tip", "m", stamps, values),))


def steady(n_periods: int, end_s: float):
    start_s = end_s - 5.0 * n_periods
    return periodic_response(played(), 5.0, RECIPE.lines_hz, start_s, end_s - 0.005).response


def test_a_recipe_says_between_which_times_it_repeats():
    start_s, end_s = RECIPE.steady_window_s
    times = np.linspace(start_s, start_s + 5.0, 400)
    for last in (end_s - 5.0, end_s - 10.0):
        turns = np.floor((last - start_s) / 5.0) * 5.0
        np.testing.assert_allclose(RECIPE.displacement(times + turns), RECIPE.displacement(times), atol=1e-12)
    assert RECIPE.displacement(np.array([end_s + 0.3])) != pytest.approx(
        RECIPE.displacement(np.array([end_s + 0.3 - 5.0])), rel=1e-2
    )


@pytest.mark.parametrize("n_periods", [2, 3, 4])
def test_periods_that_reach_into_a_fade_are_said_by_every_fit(n_periods):
    end_s = RECIPE.steady_window_s[1]
    good, faded = steady(n_periods, end_s), steady(n_periods, end_s + 0.45)
    assert good.warnings == ()
    assert len(faded.warnings) == 1
    assert "the input is not the same in every period" in faded.warnings[0]
    assert "start_s and end_s" in faded.warnings[0]
    modes = fit_frequency_modes(faded, "base_motion", n_modes=1)
    assert faded.warnings[0] in modes.warnings
    assert faded.warnings[0] in fit_frequency_transfer_function(faded, 2, 2).warnings


def test_a_transient_of_the_structure_is_said_too():
    record = siso_record(noise=1e-3, n_periods=8)
    output = record.outputs[0]
    elapsed = output.times_s - output.times_s[0]
    ringing = output.values + 0.02 * np.exp(-0.05 * elapsed) * np.cos(30.0 * elapsed)
    unsteady = TimeRecord(record.inputs, (OutputSignal("y", "", output.times_s, ringing),))
    said = periodic_response(unsteady, LINE_PERIOD_S, LINES_HZ).response.warnings
    assert len(said) == 1
    assert "the periods still change (drift" in said[0]


@pytest.mark.parametrize("n_periods", [2, 4, 8])
@pytest.mark.parametrize("input_noise", [0.0, 0.05])
def test_noise_and_rounding_are_no_transient(n_periods, input_noise):
    for seed, noise in enumerate((0.0, 1e-3, 0.3, 0.3, 0.3)):
        record = siso_record(noise=noise, input_noise=input_noise, n_periods=n_periods, seed=seed)
        assert periodic_response(record, LINE_PERIOD_S, LINES_HZ).response.warnings == ()


def test_coloured_noise_is_called_a_drift_as_rarely_as_white():
    # Four complex lines of twenty carry the noise: of 400 draws for each number of periods one in 10^4 may stand out.
    rng = np.random.default_rng(3)
    colour = np.where(np.arange(20) < 4, 1.0, 0.01)
    for n_periods in (4, 6):
        shape = (400, n_periods, 20)
        noise = colour * (rng.standard_normal(shape) + 1j * rng.standard_normal(shape))
        drift, is_unsteady = drift_of_periods(5.0 + noise)
        assert np.count_nonzero(is_unsteady) <= 1
        assert np.median(drift) == pytest.approx(1.0, abs=0.25)


def test_quiet_input_noise_is_no_change_and_one_stumble_is():
    rng = np.random.default_rng(5)
    ticks = np.tile(np.sin(0.02 * np.pi * np.arange(1000)), (3, 1)) + 0.01 * rng.standard_normal((3, 1000))
    assert not input_changes(ticks)
    ticks[1, 400:420] += 0.2
    assert input_changes(ticks)


def test_warnings_are_stored_and_kept_by_whatever_is_made_of_the_record():
    values = np.ones(5)
    record = FrequencyRecord(np.arange(1.0, 6.0), values, warnings=["look out"])
    assert record.warnings == ("look out",)
    assert FrequencyRecord.from_dict(json.loads(json.dumps(record.to_dict()))).warnings == ("look out",)
    assert record.between(0.2, 0.5).warnings == ("look out",)
    other = FrequencyRecord(
        np.arange(1.0, 6.0), values, input_names=("u2",), warnings=("look out", "and here")
    )
    assert beside([record, other]).warnings == ("look out", "and here")


@pytest.mark.parametrize(("share", "has_changed"), [(0.5, False), (2.0, True)])
def test_a_change_of_the_input_counts_from_a_millionth_of_its_power(share, has_changed):
    ticks = np.tile(np.sin(2 * np.pi * np.arange(320) / 320), (5, 1))
    power = 0.5  # of the sine
    ticks[3, 40:60] += np.tile([1.0, -1.0], 10) * np.sqrt(share * 1e-6 * power)  # the third of 16 blocks
    assert input_changes(ticks) is has_changed


@pytest.mark.filterwarnings("error")
def test_periods_that_are_alike_to_the_last_bit_are_steady():
    spectra = np.tile(1.0 + 2.0j, (2, 5, 3))
    drift, is_unsteady = drift_of_periods(spectra)
    assert drift.tolist() == [0.0, 0.0]
    assert not np.any(is_unsteady)


def stretched(seed, gains, delays=0.0, noise=0.05):
    """Return the response of stretches to inputs of their own, each with its gain and its delay."""
    rng = np.random.default_rng(seed)
    omegas = 2.0 * np.pi * np.linspace(1.0, 10.0, 60)
    gains, delays = np.broadcast_arrays(np.asarray(gains, dtype=float), np.asarray(delays, dtype=float))
    shape = (len(gains), len(omegas))
    drives = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
    plant = 1.0 / (1.0 + 0.05j * omegas)
    answers = drives * plant * gains[:, None] * np.exp(-1j * omegas * delays[:, None])
    answers += noise * (rng.standard_normal(shape) + 1j * rng.standard_normal(shape))
    response = np.sum(answers * np.conj(drives), axis=0) / np.sum(np.abs(drives) ** 2, axis=0)
    return response * drives, answers, omegas


@pytest.mark.parametrize("n", [2, 3, 8])
@pytest.mark.parametrize("leaks", [False, True])
def test_noise_alone_changes_a_response_in_one_record_of_a_thousand(n, leaks):
    alarms = sum(
        bool(changing_warnings("y", *stretched(seed, np.ones(n)), leaks=leaks)) for seed in range(400)
    )
    assert alarms <= 3


@pytest.mark.parametrize(
    ("gains", "delays", "said"),
    [
        ([1.0, 1.0, 1.0, 1.0, 0.9, 0.9], 0.0, r"gain changes by a factor of 0\.\d+ after 4 of 6"),
        ([1.0, 1.0, 0.0, 0.0], 0.0, "gain changes"),
        ([1.0, 0.9], 0.0, "gain changes"),
        (np.ones(6), [0.0, 0.0, 2e-3, 2e-3, 2e-3, 2e-3], r"delay changes by [12]\.?\d* ms after 2 of 6"),
        (np.ones(6), 1e-3 * np.arange(6), r"delay drifts by [45]\.?\d* ms from the first of 6"),
    ],
)
def test_a_gain_or_a_delay_that_changes_is_named_with_its_size_and_place(gains, delays, said):
    (found,) = changing_warnings("y", *stretched(3, gains, delays), leaks=True)
    assert re.search(said, found), found


def test_a_gain_that_falls_in_mid_record_is_said_by_responses_of_every_kind():
    rng = np.random.default_rng(2)
    period = np.convolve(rng.standard_normal(500), np.ones(3), "same")
    drive = InputSignal("u", "N", (0.0, 0.01), np.tile(period, 6), "zoh")
    stamps = 0.01 * np.arange(1, 3000)
    clean = TransferFunctionModel(
        np.array([400.0]), np.array([1.0, 4.0, 400.0]), 0.0, np.zeros((4, 4)), 0.0
    ).simulate(drive, stamps)
    values = np.where(stamps > 20.0, 0.8, 1.0) * clean + 0.01 * np.std(clean) * rng.standard_normal(2999)
    record = TimeRecord((drive,), (OutputSignal("y", "m", stamps, values),))
    for found in (local_polynomial_response(record), periodic_response(record, 5.0, start_s=4.9).response):
        assert any("changes in mid-record" in said for said in found.warnings), found.method


@pytest.mark.parametrize("way", [local_polynomial_response, welch_response])
@pytest.mark.parametrize("rate", [-0.006, 0.01])
def test_a_clock_that_turns_lines_through_cycles_is_named_with_its_rate(way, rate):
    step, rng = 0.01, np.random.default_rng(4)
    drive = rng.standard_normal(8000)
    plant = TransferFunctionModel(np.array([900.0]), np.array([1.0, 3.0, 900.0]), 0.0, np.zeros((4, 4)), 0.0)
    signal = InputSignal("u", "N", (0.0, step), drive, "linear")
    stamps = step * np.arange(1, 7900)
    values = plant.simulate(signal, stamps)
    values = values + 0.01 * np.std(values) * rng.standard_normal(len(values))
    for wrong in (0.0, rate):
        record = TimeRecord((signal,), (OutputSignal("y", "m", stamps * (1.0 + wrong), values),))
        said = [own for own in way(record).warnings if "its clock runs" in own]
        assert len(said) == (wrong != 0.0)
    assert float(re.findall(r"clock runs ([-+.0-9]+)%", said[0])[0]) / 100.0 == pytest.approx(rate, rel=0.2)
