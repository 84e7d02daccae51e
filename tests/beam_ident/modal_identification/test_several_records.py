"""Several experiments in one fit, by every parametric estimator."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from beam_ident import (
    EstimationError,
    InputSignal,
    OutputSignal,
    TimeRecord,
    TransferFunctionModel,
    estimate_common_poles,
    estimate_in_closed_loop,
    estimate_transfer_function,
    identify,
    select_transfer_function,
    subspace_model,
    validate,
)
from benchmarks.ident.closed_loop import CONTROLLER, loop_record
from benchmarks.ident.closed_loop import PARAMETERS as LOOP_PARAMETERS
from benchmarks.ident.noise_models import coloured
from benchmarks.ident.several_records import TwoFilms, TwoRecords
from tests.beam_ident import rao_garnier
from tests.beam_ident.rao_garnier import benchmark_record

OWN = {"has_offset": True, "has_free_response": True}


@pytest.fixture(scope="module")
def case() -> TwoRecords:
    return TwoRecords()


def scores(model, truth) -> np.ndarray:
    k = len(truth)
    return (model.parameters[:k] - truth) / model.standard_deviations[:k]


@pytest.mark.slow
def test_the_quiet_and_the_loud_record_count_by_their_noise(case):
    outcomes = [case.run(seed) for seed in range(12)]
    errors = np.array([o.estimate - case.truth for o in outcomes])
    stated = np.array([o.sd for o in outcomes])
    # Twelve runs of six parameters: the mean efficiency scatters by about 20 %. Equal weights would give 0.36.
    assert 0.65 < np.mean(case.bound**2 / np.mean(errors**2, axis=0)) < 1.7
    np.testing.assert_allclose(np.median(stated, axis=0), case.bound, rtol=0.05)
    assert np.max(np.abs(errors / stated)) < 4.0


@pytest.mark.verify
def test_several_records_are_efficient_in_every_parameter(case):
    outcomes = [case.run(seed) for seed in range(300)]
    figures = case.summarise(outcomes)
    assert figures["failures"] == 0
    assert all(0.75 < e < 1.35 for e in figures["efficiency"])
    assert figures["worst coverage"] > 0.92


def test_every_record_keeps_what_is_its_own(case):
    records = case.records(1)
    found = estimate_transfer_function(records, 4, 1, **OWN)
    assert found.converged
    assert [own.name for own in found.records] == ["quiet", "loud"]
    np.testing.assert_allclose([own.noise_sd for own in found.records], case.sigmas, rtol=0.07)
    np.testing.assert_allclose([own.offset for own in found.records], (40.0, -250.0), atol=1.0)
    assert found.offset == found.records[0].offset
    for own, record in zip(found.records, records, strict=True):
        np.testing.assert_array_equal(own.times_s, record.outputs[0].times_s)
        np.testing.assert_allclose(own.modelled + own.residuals, own.measured)
        assert own.whiteness.is_white
    np.testing.assert_array_equal(found.residuals, np.concatenate([r.residuals for r in found.records]))
    assert found.whiteness.is_white
    assert not found.warnings
    sizes = [len(r.outputs[0].values) for r in records]
    assert found.model.noise_sd == pytest.approx(
        np.sqrt(np.average(np.square([own.noise_sd for own in found.records]), weights=sizes))
    )


@pytest.mark.slow
@pytest.mark.parametrize("method", ["srivc", "output_error", "rivc", "ivsvf", "lssvf"])
def test_every_method_takes_several_records(case, method):
    records = [benchmark_record(0, 20.0), benchmark_record(1, 10.0)]
    found = estimate_transfer_function(records, 4, 1, method)
    if method in ("ivsvf", "lssvf"):
        assert found.scores.fit_percent > 50.0
        return
    assert found.converged
    assert np.max(np.abs(scores(found.model, case.truth))) < 4.0
    expected = estimate_transfer_function(records, 4, 1).model
    distance = (found.model.parameters - expected.parameters)[:6] / expected.standard_deviations[:6]
    assert np.max(np.abs(distance)) < 0.1


def test_a_record_with_much_more_noise_than_signal_does_no_harm():
    record = benchmark_record(0, 20.0)
    alone = estimate_transfer_function(record, 4, 1).model
    noisy = benchmark_record(1, -25.0)
    both = estimate_transfer_function([noisy, record], 4, 1).model
    distance = (both.parameters - alone.parameters)[:6] / alone.standard_deviations[:6]
    assert np.max(np.abs(distance)) < 0.2
    assert np.all(both.standard_deviations[:6] <= 1.02 * alone.standard_deviations[:6])


def test_one_record_in_a_list_is_that_record():
    record = benchmark_record(2, 10.0)
    alone, listed = (estimate_transfer_function(given, 4, 1) for given in (record, [record]))
    np.testing.assert_array_equal(alone.model.covariance, listed.model.covariance)
    np.testing.assert_array_equal(alone.residuals, listed.residuals)
    assert len(alone.records) == 1
    assert alone.records[0].noise_sd == alone.model.noise_sd
    together = estimate_common_poles([record], 4, 1)
    np.testing.assert_array_equal(
        together.models[0].parameters, estimate_common_poles(record, 4, 1).models[0].parameters
    )


@pytest.mark.slow
def test_colours_differ_from_record_to_record():
    clean = rao_garnier.response(rao_garnier.prbs(2000))
    level = rao_garnier.noise_level(clean, 10.0)
    inputs = benchmark_record(0, 10.0).inputs
    records = []
    for seed, pole in ((1, 0.9), (2, -0.5)):
        values = clean + level * coloured(seed, 2000, [1.0], [1.0, -pole])
        records.append(TimeRecord(inputs, (OutputSignal("y", "", (0.0, rao_garnier.PERIOD_S), values),)))
    found = estimate_transfer_function(records, 4, 1, "rivc")
    assert found.converged
    assert found.whiteness.is_white
    assert [round(own.noise_coefficients[1], 1) for own in found.records] == [-0.9, 0.5]
    assert np.max(np.abs(scores(found.model, rao_garnier.PARAMETERS))) < 4.0


def late(record: TimeRecord, delay_s: float, start_s: float) -> TimeRecord:
    """The same record on a clock that begins elsewhere, its output late."""
    drive, output = record.inputs[0], record.outputs[0]
    shifted = InputSignal("u", "", drive.times_s + start_s, drive.values)
    keep = output.times_s < output.times_s[-1] - delay_s
    stamps = output.times_s[keep] + start_s + delay_s
    return TimeRecord((shifted,), (OutputSignal("y", "", stamps, output.values[keep]),))


@pytest.mark.slow
def test_an_unknown_delay_is_common():
    records = [late(benchmark_record(0, 15.0, 1000), 0.1234, 0.0)]
    records.append(late(benchmark_record(1, 5.0, 1500), 0.1234, 50.0))
    found = estimate_transfer_function(records, 4, 1, delay="estimate")
    truth = np.append(rao_garnier.PARAMETERS, 0.1234)
    assert found.converged
    assert np.max(np.abs(scores(found.model, truth))) < 4.0


def test_inputs_may_take_turns_in_exciting_and_have_poles_of_their_own():
    rng = np.random.default_rng(5)
    times = 0.01 * np.arange(1500)
    slow, fast = (np.sign(rng.standard_normal(1500)) for _ in range(2))
    denominators = ([1.0, 1.0, 60.0], [1.0, 3.0, 400.0])
    records = []
    for held in ((slow, 0.0 * slow), (0.0 * fast, fast)):
        drives = tuple(InputSignal(n, "", (0.0, 0.01), v) for n, v in zip("ab", held, strict=True))
        clean = np.zeros(1500)
        for drive, a, gain in zip(drives, denominators, (60.0, 400.0), strict=True):
            model = TransferFunctionModel(np.array([gain]), np.array(a), 0.0, np.zeros((4, 4)), 0.0)
            clean += model.simulate(drive, times)
        noisy = clean + 0.05 * rng.standard_normal(1500)
        records.append(TimeRecord(drives, (OutputSignal("y", "", times, noisy),)))
    found = estimate_transfer_function(records, (2, 2), (0, 0))
    assert found.converged
    truth = np.array([1.0, 60.0, 3.0, 400.0, 60.0, 400.0])
    assert np.max(np.abs(scores(found.model, truth))) < 4.0
    with pytest.raises(EstimationError, match="input 'b' is zero throughout"):
        estimate_transfer_function(records[:1], (2, 2), (0, 0))


def test_common_poles_weigh_every_output_in_every_record(case):
    records = []
    for number, record in enumerate(case.records(2)):
        output = record.outputs[0]
        noise = (5.0, 0.5)[number] * np.random.default_rng(number).standard_normal(len(output.values))
        second = OutputSignal("z", "V", output.times_s, case.clean[number] + noise)
        records.append(dataclasses.replace(record, outputs=(output, second)))
    joint = estimate_common_poles(records, 4, 1, **OWN)
    assert joint.converged
    assert not joint.warnings
    noise_sds = [[own.noise_sd for own in of_output] for of_output in joint.records]
    np.testing.assert_allclose(noise_sds, [case.sigmas, (5.0, 0.5)], rtol=0.07)
    for model in joint.models:
        assert np.max(np.abs(scores(model, case.truth))) < 4.0


@pytest.mark.slow
def test_a_loop_may_be_recorded_several_times():
    records = [loop_record(0, 0.9, 20.0, 1500), loop_record(1, 0.0, 5.0, 1500)]
    found = estimate_in_closed_loop(records, CONTROLLER, 3, 1, "reference", "drive", has_offset=True)
    assert found.converged
    assert found.whiteness.is_white
    assert np.max(np.abs(scores(found.model, LOOP_PARAMETERS))) < 4.0
    assert [len(own.noise_coefficients) > 1 for own in found.records] == [True, False]
    alone = estimate_in_closed_loop(records[0], CONTROLLER, 3, 1, "reference", "drive", has_offset=True)
    assert np.all(found.model.standard_deviations[:5] < alone.model.standard_deviations[:5])
    np.testing.assert_array_equal(found.residuals, np.concatenate([own.residuals for own in found.records]))


@pytest.mark.slow
def test_a_subspace_and_a_choice_of_order_take_several_records(case):
    model = subspace_model([benchmark_record(0, 20.0), benchmark_record(1, 20.0)], 4)
    truth = np.roots(np.concatenate([[1.0], case.truth[:4]]))
    np.testing.assert_allclose(model.natural_frequencies, np.sort(np.abs(truth[truth.imag > 0])), rtol=0.1)
    assert model.scores[0].fit_percent > 80.0
    records = case.records(3)
    selection = select_transfer_function(records, [3, 4], [1], **OWN)
    assert selection.chosen.model.n_poles == 4
    assert len(selection.chosen.records) == 2


def test_a_model_is_validated_on_several_records_together_and_each(case):
    found = estimate_transfer_function(case.records(4), 4, 1, **OWN)
    unseen = case.records(5)
    result = validate(found.model, unseen)
    alone = [validate(found.model, record).outputs[0] for record in unseen]
    for own, expected in zip(result.records, alone, strict=True):
        assert own.outputs[0].verdict == expected.verdict
    together = result.output("y")
    np.testing.assert_array_equal(together.residuals, np.concatenate([one.residuals for one in alone]))
    assert together.whiteness.is_white
    assert together.noise_ratio == pytest.approx(1.0, abs=0.1)
    # The records differ by an offset of 290 times the response: about a common mean that would be a fit of 99 %.
    fits = [one.scores.fit_percent for one in alone]
    assert min(fits) < together.scores.fit_percent < max(fits)
    assert found.scores.fit_percent < max(own.scores.fit_percent for own in found.records)


def renamed(record: TimeRecord, kind: str, **changes) -> TimeRecord:
    signals = getattr(record, kind)
    return dataclasses.replace(record, **{kind: (dataclasses.replace(signals[0], **changes),)})


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (
            lambda r: renamed(r, "inputs", unit="N"),
            "input 'u' is in 'V' in record 'quiet' and in 'N' in record 2",
        ),
        (lambda r: renamed(r, "outputs", unit="mm"), "output 'y' is in 'm' .* expected one unit"),
        (lambda r: renamed(r, "inputs", name="v"), "record 1 .* has the inputs u and record 2 .* v"),
        (lambda r: renamed(r, "outputs", name="z"), "expected the same outputs in all records"),
        (lambda r: "record", "record is a str"),
    ],
)
@pytest.mark.parametrize(
    "estimate",
    [
        lambda records: estimate_transfer_function(records, 4, 1),
        lambda records: estimate_common_poles(records, 4, 1),
        lambda records: estimate_in_closed_loop(records, CONTROLLER, 3, 1, "u", "u"),
        lambda records: subspace_model(records, 4),
        lambda records: select_transfer_function(records, [4], [1]),
    ],
)
def test_records_that_do_not_belong_together_are_refused(case, estimate, spoil, says):
    first, second = case.records(0)
    with pytest.raises(EstimationError, match=says):
        estimate([first, spoil(second)])
    with pytest.raises(EstimationError, match="no record"):
        estimate([])


@pytest.fixture(scope="module")
def films() -> TwoFilms:
    return TwoFilms()


@pytest.mark.slow
def test_modes_weigh_every_output_in_every_record(films):
    outcomes = [films.run(seed) for seed in range(3)]
    z = np.array([(o.estimate - films.truth) / o.sd for o in outcomes])
    assert np.max(np.abs(z)) < 4.0
    # With one level for both the stated deviations would be three times the bound.
    np.testing.assert_allclose(np.median([o.sd for o in outcomes], axis=0), films.bound, rtol=0.1)


@pytest.mark.slow
def test_films_keep_what_is_their_own(films):
    found = identify(films.records(0), n_modes=2)
    assert found.converged
    assert not found.warnings
    for output in found.outputs:
        assert [own.name for own in output.records] == ["quiet", "loud"]
        np.testing.assert_allclose([own.noise_sd for own in output.records], films.sigmas, rtol=0.1)
        np.testing.assert_allclose([own.offset for own in output.records], films.offsets, atol=1e-5)
        assert output.noise_sd == pytest.approx(np.sqrt(np.mean(np.square(films.sigmas))), rel=0.1)
        np.testing.assert_array_equal(
            output.residuals, np.concatenate([own.residuals for own in output.records])
        )
        np.testing.assert_allclose(output.modelled + output.residuals, output.measured)
        assert output.offset == output.records[0].offset
        assert output.whiteness.is_white


@pytest.mark.slow
def test_a_loud_film_does_not_hide_a_mode_that_a_quiet_one_shows():
    class WeakFilms(TwoFilms):
        model = dataclasses.replace(TwoFilms.model, residues=np.array([[0.01, -0.002], [1.5, -0.02]]))

    records = WeakFilms().records(0)
    assert identify(records[0]).model.n_modes == 2
    assert identify(records[1]).model.n_modes == 1
    found = identify(records)
    assert found.model.n_modes == 2
    assert found.orders[-1].refused_because


@pytest.mark.slow
def test_modes_weigh_records_of_coloured_noise_too(films):
    found = identify(films.records(0, 0.8), n_modes=2)
    model = found.model
    z = (model.natural_frequencies - films.truth[:2]) / model.natural_frequency_sd
    assert np.max(np.abs(z)) < 4.0
    # An AR(1) of 0.8 and power one has innovations of 0.6: these are what the levels compare.
    ratio = found.outputs[0].records[1].noise_sd / found.outputs[0].records[0].noise_sd
    assert ratio == pytest.approx(6.0, rel=0.25)


@pytest.mark.slow
def test_modes_take_records_of_one_unit_and_input_that_may_lack_an_output(case):
    first, second = case.records(0)
    with pytest.raises(EstimationError, match="expected one unit in all records"):
        identify([first, renamed(second, "outputs", unit="mm")], "receptance")
    with pytest.raises(EstimationError, match="expected the same inputs"):
        identify([first, renamed(second, "inputs", name="v")], "receptance")
    found = identify([first, renamed(first, "outputs", name="z")], "receptance", n_modes=1)
    assert found.model.output_names == ("y", "z")


def test_a_record_too_short_to_weigh_is_named(case):
    first, second = case.records(0)
    short = second.between(second.outputs[0].times_s[0], second.outputs[0].times_s[9])
    with pytest.raises(EstimationError, match=r"10 usable samples in record 'loud'"):
        estimate_transfer_function([first, short], 4, 1)
