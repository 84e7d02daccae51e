from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from beam_ident import EstimationError, InputSignal, OutputSignal, TimeRecord
from beam_ident.subspace.model import subspace_model
from beam_ident.subspace.po_moesp import Stretch, subspace_poles
from benchmarks.ident.forced_beam import ForcedBeam
from tests.beam_ident.rao_garnier import PARAMETERS, PERIOD_S, benchmark_record, prbs, response

TRUE_POLES = np.sort_complex(np.roots(np.concatenate([[1.0], PARAMETERS[:4]])))


def test_without_noise_the_model_is_exact():
    found = subspace_model(benchmark_record(0, 300.0), 4)
    np.testing.assert_allclose(np.sort_complex(found.poles), TRUE_POLES, rtol=1e-7)
    np.testing.assert_allclose(found.denominator[1:], PARAMETERS[:4], rtol=1e-7)
    np.testing.assert_allclose(found.numerators[0, 0, -2:], PARAMETERS[4:], rtol=1e-5)
    assert np.max(np.abs(found.numerators[0, 0, :3])) < 1e-3 * 1600.0
    assert found.scores[0].fit_percent > 99.999
    # A system of four states fills four directions of the window, and no fifth.
    assert found.singular_values[4] < 1e-6 * found.singular_values[3]


@pytest.mark.parametrize("snr_db", [20.0, 0.0])
def test_three_light_modes_are_found_in_as_much_noise_as_signal(snr_db):
    beam = ForcedBeam()
    found = subspace_model(beam.record(1, snr_db), 6)
    np.testing.assert_allclose(found.natural_frequencies, beam.omegas, rtol=2e-2)
    np.testing.assert_allclose(found.damping_ratios, beam.zetas, rtol=0.4)
    assert found.output_names == ("tip", "root")


def test_offset_and_drift_do_no_harm():
    record = benchmark_record(0, 60.0)
    output = record.outputs[0]
    drifted = OutputSignal("y", "", output.times_s, output.values + 50.0 - 3.0 * output.times_s)
    found = subspace_model(TimeRecord(record.inputs, (drifted,)), 4)
    np.testing.assert_allclose(np.sort_complex(found.poles), TRUE_POLES, rtol=1e-2)


def test_two_inputs_have_a_numerator_each():
    first, second = prbs(2000), np.roll(prbs(2000, n_stages=9), 300)
    clean = response(first) + 0.5 * response(second)
    record = TimeRecord(
        (
            InputSignal("u", "", (0.0, PERIOD_S), first),
            InputSignal("v", "", (0.0, PERIOD_S), second),
        ),
        (OutputSignal("y", "", (0.0, PERIOD_S), clean),),
    )
    found = subspace_model(record, 4)
    np.testing.assert_allclose(found.numerators[0, 0, -2:], PARAMETERS[4:], rtol=1e-4)
    np.testing.assert_allclose(found.numerators[0, 1, -2:], 0.5 * PARAMETERS[4:], rtol=1e-4)


def test_irregular_stamps_are_good_enough_to_start_from():
    drive = prbs(2000)
    times = PERIOD_S * (np.arange(2, 1990) + np.random.default_rng(0).uniform(-0.3, 0.3, 1988))
    values = np.interp(times, PERIOD_S * np.arange(2000), response(drive))
    stretch = Stretch([InputSignal("u", "", (0.0, PERIOD_S), drive).signal()], [(times, values)])
    poles = subspace_poles([stretch], 4)[0]
    np.testing.assert_allclose(np.sort_complex(poles), TRUE_POLES, rtol=0.1)


def test_a_long_window_averages_and_decimates():
    found = subspace_model(benchmark_record(0, 40.0), 4, window_s=1.5)
    assert found.period_s == pytest.approx(0.03)
    assert found.window_s == pytest.approx(1.5, rel=0.1)
    np.testing.assert_allclose(found.natural_frequencies, [2.0, 20.0], rtol=2e-2)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"order": 0}, "expected a whole number, 1 to 40"),
        ({"order": 4, "window_s": 0.0}, "expected a time > 0"),
        ({"order": 4, "n_block_rows": 1}, "at least 2"),
        ({"order": 40, "n_block_rows": 20}, "too few for a subspace of order 40"),
    ],
)
def test_impossible_requests_are_refused(change, says):
    with pytest.raises(EstimationError, match=says):
        subspace_model(benchmark_record(0, 10.0), **change)


def test_windows_together_see_what_each_alone_does_not():
    beam = ForcedBeam()
    record = beam.record(3, 0.0).select(["root"])
    output = record.outputs[0]
    alone = [subspace_model(record, 6, window_s=window).natural_frequencies for window in (0.25, 1.0)]
    # The short window loses the weak slow mode in the noise, the long one averages the fast one away.
    assert len(alone[0]) < 3 or not np.allclose(alone[0], beam.omegas, rtol=3e-2)
    assert not np.allclose(alone[1], beam.omegas, rtol=3e-2)
    stretch = Stretch([record.inputs[0].signal()], [(output.times_s, output.values)])
    together = subspace_poles([stretch], 6)[-1]
    found = np.sort(np.abs(together[together.imag > 0.0]))
    np.testing.assert_allclose(found, beam.omegas, rtol=3e-2)


def test_windows_together_keep_a_real_pole_beside_a_light_mode():
    plant = signal.TransferFunction([400.0], np.polymul([1.0, 0.4], [1.0, 0.8, 400.0]))
    drive, times = prbs(4000), PERIOD_S * np.arange(4000)
    values = signal.lsim(plant, drive, times, interp=False)[1]
    values = values + 0.02 * np.std(values) * np.random.default_rng(0).standard_normal(4000)
    stretch = Stretch([InputSignal("u", "", times, drive).signal()], [(times, values)])
    windows = subspace_poles([stretch], 3)
    assert len(windows) > 1
    together = windows[-1]
    np.testing.assert_allclose(together[together.imag == 0.0], [-0.4], rtol=0.1)
    np.testing.assert_allclose(together[together.imag > 0.0], [-0.4 + 20.0j], rtol=0.02)


def test_a_single_pole_is_one_even_where_every_window_sees_a_pair():
    drive, times = prbs(4000), PERIOD_S * np.arange(4000)
    values = signal.lsim(([400.0], [1.0, 0.8, 400.0]), drive, times, interp=False)[1]
    stretch = Stretch([InputSignal("u", "", times, drive).signal()], [(times, values)])
    counts = [len(poles) for poles in subspace_poles([stretch], 1)]
    assert len(counts) > 1
    assert set(counts) == {1}


@pytest.mark.parametrize("place", [0, -1])
def test_every_output_counts_up_to_the_ends_of_the_record(place):
    times, drive = PERIOD_S * np.arange(600), prbs(600)
    values = response(drive) + 0.1 * np.random.default_rng(2).standard_normal(600)
    poles = []
    for change in (0.0, 0.1):
        values[place] += change
        stretch = Stretch([InputSignal("u", "", times, drive).signal()], [(times, values.copy())])
        poles.append(np.sort_complex(subspace_poles([stretch], 4)[0]))
    assert np.max(np.abs(poles[1] / poles[0] - 1.0)) > 1e-7  # far beyond rounding
