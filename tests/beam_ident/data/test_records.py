from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from beam_ident import InputSignal, OutputSignal, RecordError, TimeRecord


def make_record(**changes):
    drive = InputSignal("hub", "m", (0.0, 0.001), np.zeros(1000), "linear")
    output = OutputSignal("tip", "m", (0.0, 0.01), np.zeros(100))
    return TimeRecord((drive,), (output,), **changes)


def test_a_pair_of_start_and_period_becomes_a_regular_grid():
    drive = InputSignal("hub", "m", (2.0, 0.001), np.zeros(5))
    np.testing.assert_allclose(drive.times_s, 2.0 + 0.001 * np.arange(5), atol=1e-15)
    assert drive.period_s == pytest.approx(0.001)
    assert drive.span_s == pytest.approx((2.0, 2.005))  # the last held value lasts one more period


def test_irregular_stamps_are_kept_as_they_are():
    stamps = np.array([0.0, 0.1, 0.25])
    drive = InputSignal("hub", "m", stamps, np.zeros(3), "linear")
    assert drive.period_s is None
    assert drive.span_s == (0.0, 0.25)


@pytest.mark.parametrize(
    ("stamps", "values", "says"),
    [
        (np.array([0.0, 1.0, 1.0]), np.zeros(3), "does not come after"),
        (np.array([0.0, 2.0, 1.0]), np.zeros(3), "does not come after"),
        (np.array([0.0, np.nan, 1.0]), np.zeros(3), "stamp 1"),
        (np.array([0.0, 1.0]), np.zeros(3), "one stamp for each value"),
        ((0.0, 0.0), np.zeros(3), "period > 0"),
        ((0.0, 1.0), np.array([0.0, 1.0, np.nan]), "known at both ends"),
        ((0.0, 1.0), np.array([0.0, np.inf, 1.0]), "value 1 is inf"),
        ((0.0, 1.0), np.zeros(1), "at least two"),
    ],
)
def test_a_bad_input_is_refused_with_what_is_wrong(stamps, values, says):
    with pytest.raises(RecordError, match=says):
        InputSignal("hub", "m", stamps, values)


def test_an_output_may_miss_samples_but_not_all_and_not_with_infinity():
    output = OutputSignal("tip", "m", (0.0, 1.0), np.array([0.0, np.nan, 1.0]))
    assert output.is_valid.tolist() == [True, False, True]
    with pytest.raises(RecordError, match="all 3 values are NaN"):
        OutputSignal("tip", "m", (0.0, 1.0), np.full(3, np.nan))
    with pytest.raises(RecordError, match="mark a missing sample with NaN"):
        OutputSignal("tip", "m", (0.0, 1.0), np.array([0.0, np.inf, 1.0]))


def test_an_unknown_hold_and_a_negative_exposure_are_refused():
    with pytest.raises(RecordError, match="hold is 'spline'"):
        InputSignal("hub", "m", (0.0, 1.0), np.zeros(3), "spline")
    with pytest.raises(RecordError, match="exposure_s is -1"):
        OutputSignal("tip", "m", (0.0, 1.0), np.zeros(3), exposure_s=-1.0)


def test_signals_that_do_not_overlap_or_share_a_name_are_refused():
    drive = InputSignal("hub", "m", (0.0, 0.001), np.zeros(1000))
    with pytest.raises(RecordError, match="do not overlap"):
        TimeRecord((drive,), (OutputSignal("tip", "m", (5.0, 0.01), np.zeros(100)),))
    with pytest.raises(RecordError, match="used twice"):
        TimeRecord((drive,), (OutputSignal("hub", "m", (0.0, 0.01), np.zeros(100)),))


def test_signals_are_found_by_name_and_cannot_be_changed():
    record = make_record()
    assert record.output("tip").unit == "m"
    with pytest.raises(RecordError, match="available: tip"):
        record.output("root")
    with pytest.raises(ValueError, match="read-only"):
        record.output("tip").values[0] = 1.0


def test_a_segment_keeps_the_input_that_its_outputs_need():
    part = make_record().between(0.205, 0.5)
    assert part.outputs[0].times_s[0] >= 0.205
    assert part.inputs[0].times_s[0] <= 0.205
    assert part.inputs[0].times_s[-1] >= 0.5


def test_a_sample_lies_within_an_interval_with_all_of_its_exposure():
    # Powers of two, so that the borders are met exactly.
    output = OutputSignal("tip", "m", (0.0, 1 / 64), np.zeros(65), exposure_s=1 / 32)
    np.testing.assert_array_equal(np.flatnonzero(output.is_within(0.0, 1.0)), np.arange(1, 64))
    np.testing.assert_array_equal(np.flatnonzero(output.is_within(1 / 128, 63 / 64)), np.arange(2, 63))
    at_once = OutputSignal("tip", "m", (0.0, 1 / 64), np.zeros(65))
    assert np.all(at_once.is_within(0.0, 1.0))


def test_stamps_of_another_signal_are_not_stored_twice_but_those_that_can_change_are_copied():
    stamps, values = np.arange(100) * 1e-3, np.ones(100)
    first = InputSignal("hub", "m", stamps, values)
    assert first.times_s is not stamps
    assert dataclasses.replace(first, values=2.0 * values).times_s is first.times_s
    view = values[:50]
    view.setflags(write=False)
    second = InputSignal("hub", "m", stamps[:50], view)
    values[0] = 9.0  # what the view shows can still change
    assert second.values[0] == 1.0


def test_dates_are_refused_as_their_unit_would_be_lost():
    dates = np.datetime64("2026-01-01", "ns") + np.arange(5) * np.timedelta64(10, "ms")
    with pytest.raises(RecordError, match="are dates"):
        OutputSignal("y", "m", dates, np.arange(5.0))


def test_arrays_become_a_record_with_the_names_and_units_that_are_given():
    t = 0.01 * np.arange(5)
    record = TimeRecord.from_arrays(
        t,
        u={"force": t},
        y={"tip": 2 * t, "low": 3 * t},
        units={"force": "N", "tip": "m"},
        hold="linear",
        name="a",
    )
    assert [(s.name, s.unit) for s in record.inputs] == [("force", "N")]
    assert [(s.name, s.unit) for s in record.outputs] == [("tip", "m"), ("low", "")]
    assert record.inputs[0].hold == "linear"
    np.testing.assert_array_equal(record.output("low").values, 3 * t)
    np.testing.assert_array_equal(record.output("low").times_s, t)


def test_unnamed_columns_are_numbered_and_one_alone_is_not():
    record = TimeRecord.from_arrays((0.5, 0.1), u=np.zeros(4), y=np.arange(8.0).reshape(4, 2))
    assert [s.name for s in record.inputs] == ["u"]
    assert record.output_names == ("y1", "y2")
    np.testing.assert_array_equal(record.output("y2").values, [1.0, 3.0, 5.0, 7.0])
    assert record.output("y2").times_s[0] == 0.5


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"u": np.zeros(3)}, r"different lengths \(u 3, y 4\)"),
        ({"y": np.zeros((2, 2, 2))}, r"shape \(2, 2, 2\); expected"),
        ({"units": {"x": "m"}}, "units name 'x'.*among u, y"),
        ({"y": {"u": np.zeros(4)}}, "used twice"),
    ],
)
def test_arrays_that_are_no_signals_are_refused(change, says):
    given = {"u": np.zeros(4), "y": np.zeros(4)} | change
    with pytest.raises(RecordError, match=says):
        TimeRecord.from_arrays((0.0, 0.1), **given)


def table_of(kind):
    """Return a small table with a force, a tip and the time, and what its dates are worth."""
    columns = {"t": 0.1 * np.arange(4), "force": np.arange(4.0), "tip": np.arange(4.0) ** 2}
    if kind == "mapping":
        return columns
    if kind == "pyarrow":
        return pytest.importorskip("pyarrow", exc_type=ImportError).table(columns)
    return pytest.importorskip("pandas", exc_type=ImportError).DataFrame(columns)


@pytest.mark.parametrize("kind", ["mapping", "pyarrow", "pandas"])
def test_a_table_of_any_library_becomes_a_record(kind):
    record = TimeRecord.from_dataframe(table_of(kind), u="force", y=["tip"], time="t", units={"force": "N"})
    np.testing.assert_array_equal(record.input("force").values, np.arange(4.0))
    np.testing.assert_array_equal(record.output("tip").times_s, 0.1 * np.arange(4))
    with pytest.raises(RecordError, match="no column 'base'; expected one of t, force, tip"):
        TimeRecord.from_dataframe(table_of(kind), u="base", y="tip", time="t")


def test_dates_become_seconds_and_the_first_of_them_is_kept():
    columns = table_of("mapping") | {"t": np.array("2026-01-01T00:00:00.5", "M8[ms]") + 100 * np.arange(4)}
    record = TimeRecord.from_dataframe(columns, u="force", y="tip", time="t")
    np.testing.assert_allclose(record.input("force").times_s, 0.1 * np.arange(4), atol=1e-15)
    assert record.start_ns == 1_767_225_600_500_000_000
    with pytest.raises(RecordError, match="a dict has no index; expected the column"):
        TimeRecord.from_dataframe(columns, u="force", y="tip")
