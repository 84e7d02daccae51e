from __future__ import annotations

import json

import numpy as np
import pytest

from beam_ident import (
    EstimationError,
    ModelFormatError,
    TimeRecord,
    estimate_transfer_function,
    select_transfer_function,
    validate,
)
from beam_ident.transfer_function.multi_input_model import MultiInputModel
from benchmarks.ident.multi_input import MultiInput


@pytest.fixture(scope="module")
def common() -> MultiInput:
    return MultiInput(True)


@pytest.fixture(scope="module")
def model(common: MultiInput) -> MultiInputModel:
    return common.estimate(common.record(1))


@pytest.fixture(scope="module")
def own() -> MultiInput:
    return MultiInput(False)


def z(case: MultiInput, model: MultiInputModel) -> np.ndarray:
    k = case.estimated
    return (model.parameters[:k] - case.truth) / model.standard_deviations[:k]


def test_two_inputs_share_their_poles_at_irregular_stamps(common, model):
    assert np.max(np.abs(z(common, model))) < 4.0
    np.testing.assert_allclose(model.standard_deviations[: common.estimated], common.bound, rtol=0.25)
    assert model.parameter_names[:5] == ("a1", "a2", "a3", "a4", "b0[force]")


@pytest.mark.slow
def test_inputs_with_poles_of_their_own_are_told_apart(own):
    found = estimate_transfer_function(own.record(2), own.n_poles, own.n_zeros)
    assert found.converged
    assert np.max(np.abs(z(own, found.model))) < 4.0
    assert found.whiteness.is_white
    assert found.model.parameter_names[4] == "a1[base]"
    paths = [found.model.path(name) for name in ("force", "base")]
    assert [path.n_poles for path in paths] == [4, 2]


@pytest.mark.slow
def test_delays_of_several_inputs_are_found_together(own):
    record = own.record(4)
    late = record.inputs[1]
    later = type(late)(late.name, late.unit, late.times_s - 0.31, late.values, late.hold)
    record = TimeRecord((record.inputs[0], later), record.outputs)
    found = estimate_transfer_function(record, own.n_poles, own.n_zeros, delay=[0.0, "estimate"]).model
    assert abs(found.delays[1] - 0.31) < 4.0 * found.standard_deviations[-1]
    assert found.delays[0] == found.standard_deviations[-2] == 0.0


def test_a_path_carries_its_share_of_the_covariance(model):
    path = model.path("base")
    np.testing.assert_array_equal(path.numerator, model.numerators[1])
    sd = dict(zip(model.parameter_names, model.standard_deviations, strict=True))
    assert path.standard_deviations[4] == sd["b0[base]"]
    omegas = np.array([5.0, 20.0])
    response, band = model.frequency_response(omegas)
    np.testing.assert_allclose(response[:, 1], path.frequency_response(omegas)[0])
    assert np.all(band > 0.0)
    with pytest.raises(EstimationError, match="no input 'wind'"):
        model.path("wind")


def test_simulation_takes_all_inputs_by_name(common, model):
    parts = [model.path(drive.name).simulate(drive, common.stamps) for drive in common.drives]
    np.testing.assert_allclose(model.simulate(common.drives[::-1], common.stamps), np.sum(parts, axis=0))
    with pytest.raises(EstimationError, match="no input base"):
        model.simulate(common.drives[:1], common.stamps)


def test_an_unseen_record_is_predicted_and_validated(common, model):
    record = common.record(9).between(5.0, 18.0)
    checked = validate(model, record).output("y")
    assert checked.noise_ratio == pytest.approx(1.0, abs=0.1)
    assert checked.input_correlation.is_independent
    predicted = model.predict(record)
    inside = np.isfinite(predicted)
    left = record.outputs[0].values[inside] - predicted[inside]
    np.testing.assert_allclose(left, checked.residuals)
    with pytest.raises(EstimationError, match="the model goes from force, base"):
        validate(model, TimeRecord(record.inputs[:1], record.outputs))


@pytest.mark.first_case
@pytest.mark.parametrize("which", ["common", "own"])
def test_the_states_of_all_inputs_are_the_frequency_response(which, request):
    case = request.getfixturevalue(which)
    found = request.getfixturevalue("model") if which == "common" else case.estimate(case.record(2))
    transition, entry, row, through = found.state_space()
    assert len(transition) == (4 if which == "common" else 6)
    for omega in (3.0, 12.0, 40.0):
        response = row @ np.linalg.solve(1j * omega * np.eye(len(transition)) - transition, entry) + through
        np.testing.assert_allclose(response, found.frequency_response(np.array([omega]))[0], rtol=1e-8)
    assert found.to_scipy().B.shape == (len(transition), 2)


def test_python_control_gets_one_column_for_each_input(model):
    pytest.importorskip("control")
    found = model.to_control()(30j)
    np.testing.assert_allclose(np.ravel(found), model.frequency_response(np.array([30.0]))[0][0], rtol=1e-9)


def test_the_model_survives_json(model):
    again = MultiInputModel.from_dict(json.loads(json.dumps(model.to_dict())))
    np.testing.assert_array_equal(again.parameters, model.parameters)
    np.testing.assert_array_equal(again.covariance, model.covariance)
    with pytest.raises(ModelFormatError, match="multi_input_model"):
        MultiInputModel.from_dict({"type": "transfer_function", "schema": 1})
    with pytest.raises(ModelFormatError, match="one denominator for all"):
        MultiInputModel((np.ones(1),), (np.ones(2), np.ones(2)), (0.0,), np.zeros((1, 1)), 0.0, ("u",))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"n_zeros": (1, 1, 1)}, "3 entries for 2 inputs"),
        ({"n_poles": (4, 4, 2)}, "3 entries for 2 inputs"),
        ({"n_zeros": 1}, "one number of zeros for each"),
        ({"input_name": "force"}, "a sequence of them takes all inputs"),
        ({"n_poles": (4, 2), "method": "srivc"}, "denominators of their own"),
        ({"n_zeros": (5, 1)}, "no more zeros than poles"),
    ],
)
def test_impossible_requests_are_refused(common, change, says):
    arguments = {"n_poles": 4, "n_zeros": (2, 1)} | change
    with pytest.raises(EstimationError, match=says):
        estimate_transfer_function(common.record(0), **arguments)


@pytest.mark.parametrize("has_common_poles", [True, False])
def test_the_path_of_an_input_has_the_uncertainty_of_its_own_parameters(has_common_poles):
    denominators = [np.array([1.0, 2.0, 30.0]), np.array([1.0, 3.0, 50.0])]
    # Places in the covariance: every denominator, then every numerator, then every delay.
    own = {
        True: ([0, 1, 2, 5], [0, 1, 3, 4, 6]),
        False: ([0, 1, 4, 7], [2, 3, 5, 6, 8]),
    }[has_common_poles]
    size = 7 if has_common_poles else 9
    root = np.random.default_rng(0).standard_normal((size, size))
    model = MultiInputModel(
        numerators=(np.array([5.0]), np.array([6.0, 7.0])),
        denominators=tuple(denominators[: 1 if has_common_poles else 2]),
        delays=(0.01, 0.02),
        covariance=root @ root.T,
        noise_sd=1.0,
        input_names=("hub", "force"),
    )
    for name, places in zip(("hub", "force"), own, strict=True):
        assert np.array_equal(model.path(name).covariance, model.covariance[np.ix_(places, places)])


@pytest.mark.slow
def test_the_search_gives_every_input_its_own_degree():
    common = MultiInput(has_common_poles=True)
    selection = select_transfer_function(common.record(0), [4], [2, 3])
    chosen = next(entry for entry in selection.table if entry.is_chosen)
    assert (chosen.n_poles, chosen.n_zeros) == (4, (2, 3))
    assert {entry.n_zeros for entry in selection.table} == {(2, 2), (2, 3), (3, 2), (3, 3)}
    assert selection.chosen.model.input_names == ("force", "base")
    assert "2,3" in str(selection)
