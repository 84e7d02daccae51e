"""Modes under two inputs: common poles, and residues, gains and a hold of each input's own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beam_ident import InputSignal, TimeRecord, identify, restore, validate
from beam_ident.design.prediction import predict_amplitudes
from beam_ident.errors import EstimationError, ExcitationError, RecordError
from beam_ident.excitation import Multisine
from beam_ident.report.identification import write_report
from benchmarks.ident.two_inputs_modes import TwoForces, flat


@pytest.fixture(scope="module")
def case():
    return TwoForces()


@pytest.fixture(scope="module")
def result(case):
    return identify(case.record(1), "receptance")


def test_two_forces_give_modes_and_the_residues_of_each(case, result):
    assert result.converged
    assert result.model.input_names == ("shaker", "hammer")
    assert result.model.residues.shape == (3, 2, 3)
    estimate, sd = (own[: len(case.truth)] for own in flat(result.model))
    scores = (estimate - case.truth) / sd
    # 24 parameters: one beyond 4 in 600 such records, and their mean square within 1 +- 4 sqrt(2 / 24).
    assert np.max(np.abs(scores)) < 4.0
    assert np.mean(scores**2) < 2.2
    assert result.warnings == ()


@pytest.mark.slow
def test_a_second_input_is_no_disturbance(case):
    # With one force taken for all there is, the other's share is noise, ten times as large as the true one.
    alone = identify(case.record(1), "receptance", n_modes=3, input_name="shaker").model
    both = identify(case.record(1), "receptance", n_modes=3).model
    assert np.all(both.natural_frequency_sd[:2] < 0.3 * alone.natural_frequency_sd[:2])


def test_every_input_alone_is_a_modal_model(result):
    model = result.model
    for place, path in enumerate(model.paths):
        np.testing.assert_array_equal(path.residues, model.residues[:, place])
        np.testing.assert_array_equal(path.residue_sd, model.residue_sd[:, place])
        np.testing.assert_array_equal(path.natural_frequency_sd, model.natural_frequency_sd)
        assert path.input_names == (("shaker", "hammer")[place],)
    assert model.parameter_names[8:13] == (
        "c[p1, shaker]",
        "R[p1, shaker]",
        "r_1[p1, shaker]",
        "r_2[p1, shaker]",
        "r_3[p1, shaker]",
    )


def test_the_sum_of_what_the_inputs_cause_is_what_the_model_says(case, result):
    parts = [
        path.simulate(drive, case.stamps) for path, drive in zip(result.model.paths, case.drives, strict=True)
    ]
    together = result.model.simulate(case.drives[::-1], case.stamps)
    np.testing.assert_allclose(together, parts[0] + parts[1], atol=1e-12)
    a, b, c, d = result.model.state_space()
    s = 2j * np.pi * 5.0
    response = c @ np.linalg.solve(s * np.eye(len(a)) - a, b) + d
    for place, path in enumerate(result.model.paths):
        np.testing.assert_allclose(path.frequency_response([s.imag]).response[0], response[:, place])


def test_the_stored_model_is_the_same(result):
    restored = restore(result.model.to_dict())
    np.testing.assert_array_equal(restored.residues, result.model.residues)
    np.testing.assert_array_equal(restored.covariance, result.model.covariance)
    assert restored.input_names == result.model.input_names


def test_it_predicts_another_record_of_the_same_forces(case, result):
    for output in validate(result.model, case.record(7)).outputs:
        assert 0.95 < output.noise_ratio < 1.05
    with pytest.raises(EstimationError, match="hammer"):
        validate(result.model, TimeRecord(case.drives[:1], case.record(7).outputs))


@pytest.mark.slow
def test_report_and_figures_show_every_input(case, result, tmp_path):
    text = write_report(tmp_path / "report.html", "two forces", case.record(1), result).read_text()
    assert "shaker, hammer" in text
    assert "r2[p3, hammer]" in text


def test_what_goes_with_one_input_alone_says_so(result):
    model = result.model
    for ask in (
        lambda: model.frequency_response([1.0]),
        model.mode_shapes,
        model.polynomials,
        lambda: model.zpk("p1"),
        lambda: model.step_response([0.1]),
        lambda: model.step_response_sd([0.1]),
    ):
        with pytest.raises(EstimationError, match="path"):
            ask()
    with pytest.raises(ExcitationError, match="path"):
        predict_amplitudes(Multisine(start_frequency=1.0, end_frequency=20.0).sample_input(0.01, 1.0), model)
    with pytest.raises(EstimationError, match="no input 'wind'"):
        model.path("wind")


def test_an_input_that_does_nothing_is_named(case):
    wind = InputSignal("wind", "N", (0.0, 0.01), np.random.default_rng(8).standard_normal(1520))
    record = case.record(1)
    found = identify(TimeRecord((*record.inputs, wind), record.outputs), "receptance", n_modes=3)
    assert [w for w in found.warnings if "wind" in w and "Nothing" in w]
    assert not [w for w in found.warnings if "input shaker" in w or "input hammer" in w]


def test_noise_that_is_not_weighed_is_named(case):
    record = case.record(1)
    noisy = replace(record.inputs[1], sigma=0.2)
    found = identify(TimeRecord((record.inputs[0], noisy), record.outputs), "receptance", n_modes=3)
    assert any("Noise on input hammer" in said for said in found.warnings)


def test_a_gap_of_one_input_is_stepped_over(case):
    record = case.record(1)
    values = np.array(record.inputs[1].values)
    values[600:640] = np.nan
    lost = replace(record.inputs[1], values=values)
    found = identify(TimeRecord((record.inputs[0], lost), record.outputs), "receptance", n_modes=3)
    estimate, sd = (own[: len(case.truth)] for own in flat(found.model))
    assert np.max(np.abs(estimate - case.truth) / sd) < 4.0
    assert any("hammer has 1 gap" in said for said in found.warnings)


@pytest.mark.parametrize("names", [[], ["shaker", "shaker"]])
def test_names_of_inputs_are_checked(case, names):
    with pytest.raises(EstimationError, match="expected different names among shaker, hammer"):
        identify(case.record(1), "receptance", input_name=names)


def test_an_unknown_input_is_named(case):
    with pytest.raises(RecordError, match="wind"):
        identify(case.record(1), "receptance", input_name=["shaker", "wind"])
