from __future__ import annotations

import numpy as np
import pytest

from beam_ident import RecordError
from beam_ident.data.frequency_record import FrequencyRecord, beside

OMEGAS = np.array([1.0, 2.0, 3.0])


def test_a_single_response_is_kept_with_axes_for_outputs_and_inputs():
    record = FrequencyRecord(OMEGAS, np.array([1, 2j, 3]), variance=np.array([1.0, 4.0, 9.0]))
    assert record.response.shape == record.variance.shape == (3, 1, 1)
    assert record.output_names == ("y1",)
    assert record.input_names == ("u1",)
    np.testing.assert_array_equal(record.sd[:, 0, 0], [1.0, 2.0, 3.0])
    with pytest.raises(ValueError, match="read-only"):
        record.response[0] = 0.0


def test_bands_and_names_pick_everything_that_belongs_to_them():
    covariance = np.arange(3 * 16).reshape(3, 4, 4) + 0j
    record = FrequencyRecord(
        OMEGAS,
        np.arange(12).reshape(3, 2, 2),
        output_names=("a", "b"),
        input_names=("u", "v"),
        covariance=covariance,
    )
    part = record.between(2.0 / (2 * np.pi) - 1e-9, 1.0).select(["b"], ["v"])
    np.testing.assert_array_equal(part.response[:, 0, 0], [7, 11])
    np.testing.assert_array_equal(part.covariance[:, 0, 0], covariance[1:, 3, 3])
    np.testing.assert_array_equal(part.variance[:, 0, 0], covariance[1:, 3, 3].real)
    series = record.series()
    assert [(s.output_name, s.input_name) for s in series] == [("a", "u"), ("a", "v"), ("b", "u"), ("b", "v")]
    np.testing.assert_array_equal(series[2].response, [2, 6, 10])


def test_experiments_with_an_input_each_stand_beside_each_other():
    one = FrequencyRecord(OMEGAS, np.ones((3, 2)), np.ones((3, 2)), input_names=("u",))
    two = FrequencyRecord(OMEGAS, 2 * np.ones((3, 2)), np.ones((3, 2)), input_names=("v",))
    both = beside([one, two])
    assert both.input_names == ("u", "v")
    np.testing.assert_array_equal(both.response[:, :, 1], 2.0)
    with pytest.raises(RecordError, match="different lines"):
        beside([one, FrequencyRecord(2 * OMEGAS, np.ones((3, 2)), np.ones((3, 2)), input_names=("v",))])


@pytest.mark.parametrize(
    ("omegas", "response", "keywords", "message"),
    [
        (OMEGAS[::-1], np.ones(3), {}, "strictly increasing"),
        ([0.0, 1.0], np.ones(2), {}, "leave out 0"),
        ([1.0, np.nan], np.ones(2), {}, "finite"),
        (OMEGAS, np.ones(2), {}, r"shape \(2,\) for 3 lines"),
        (OMEGAS, np.ones(3), {"variance": -np.ones(3)}, "negative at 3 lines"),
        (OMEGAS, np.ones(3), {"variance": np.ones(2)}, r"variance has shape \(2,\)"),
        (OMEGAS, np.ones((3, 2)), {"output_names": ("y", "y")}, "2 different names"),
        (OMEGAS, np.ones(3), {"covariance": np.ones((3, 2, 2))}, "covariance has shape"),
    ],
)
def test_a_malformed_record_is_refused_with_its_fault(omegas, response, keywords, message):
    with pytest.raises(RecordError, match=message):
        FrequencyRecord(np.asarray(omegas), response, **keywords)


def test_a_name_that_is_not_there_is_refused_with_those_that_are():
    with pytest.raises(RecordError, match="no output 'z'; available: y1"):
        FrequencyRecord(OMEGAS, np.ones(3)).select(["z"])
    with pytest.raises(RecordError, match="no line between 5"):
        FrequencyRecord(OMEGAS, np.ones(3)).between(5.0, 6.0)
