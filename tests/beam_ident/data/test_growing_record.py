"""A record that grows is, at any time, the record of what has arrived."""

from __future__ import annotations

import itertools
import tracemalloc

import numpy as np
import pytest

from beam_ident import GrowingRecord, InputSignal, OutputSignal, RecordError, TimeRecord

TICKS = 1e-3 * np.arange(2000)
FRAMES = 0.011 + 0.01 * np.arange(190) + 1e-4 * np.sin(np.arange(190))


def whole(lost: slice | None = None) -> TimeRecord:
    values = np.sin(7.0 * TICKS)
    if lost is not None:
        values[lost] = np.nan
    drive = InputSignal("hub", "m", TICKS, values, "cubic", 1e-8)
    return TimeRecord((drive,), (OutputSignal("tip", "m", FRAMES, np.cos(FRAMES), 5e-3),), 7, "run")


def grown(of: TimeRecord, values: np.ndarray, steps: int, memory_s: float = np.inf) -> GrowingRecord:
    ends = np.linspace(0.0, 2.0, steps + 1)
    begun = TimeRecord(
        (InputSignal("hub", "m", TICKS[: 2000 // steps], values[: 2000 // steps], "cubic", 1e-8),),
        (of.outputs[0].between(0.0, ends[1]),),
        7,
        "run",
    )
    record = GrowingRecord(begun, memory_s)
    for first, last in itertools.pairwise(ends[1:]):
        ticks = slice(*np.searchsorted(TICKS, [first - 1e-4, last - 1e-4]))
        record.add("hub", TICKS[ticks], values[ticks])
        frames = slice(*np.searchsorted(FRAMES, [first, last], side="right"))
        record.add("tip", FRAMES[frames], np.cos(FRAMES[frames]))
    return record


@pytest.mark.parametrize("lost", [None, slice(900, 1015)], ids=["whole", "a gap across batches"])
def test_pieces_make_the_record_that_the_whole_makes(lost):
    expected = whole(lost)
    values = np.sin(7.0 * TICKS)
    if lost is not None:
        values[lost] = np.nan
    found = grown(expected, values, 20)
    for _ in range(2):  # asking changes nothing
        record = found.record()
        np.testing.assert_array_equal(record.inputs[0].times_s, expected.inputs[0].times_s)
        np.testing.assert_array_equal(record.inputs[0].values, expected.inputs[0].values)
        assert record.inputs[0].gaps == expected.inputs[0].gaps
        assert (record.inputs[0].hold, record.inputs[0].sigma) == ("cubic", 1e-8)
        np.testing.assert_array_equal(record.outputs[0].values, expected.outputs[0].values)
        assert (record.outputs[0].exposure_s, record.start_ns, record.name) == (5e-3, 7, "run")
    assert found.heard_s == pytest.approx(1.999)


def test_memory_keeps_the_newest_samples_alone():
    found = grown(whole(), np.sin(7.0 * TICKS), 20, memory_s=0.5)
    record = found.record()
    assert record.inputs[0].times_s[0] == pytest.approx(1.499)
    assert record.outputs[0].times_s[0] >= 1.499
    assert found.heard_s == pytest.approx(1.999)


def test_what_is_not_kept_takes_no_memory_even_while_nobody_asks():
    found = GrowingRecord(whole(), memory_s=1.0)
    ticks, frames = TICKS + 2.0, 2.0 + 0.01 * np.arange(200)
    few, many = (_memory_of(found, ticks + 2.0 * k, frames + 2.0 * k) for k in (0, 20))
    assert many <= few


def _memory_of(record: GrowingRecord, ticks: np.ndarray, frames: np.ndarray) -> int:
    """Return how many bytes are in use after further samples."""
    tracemalloc.start()
    for own in range(0, 2000, 100):
        record.add("hub", ticks[own : own + 100] + 0.0, np.zeros(100))
    record.add("tip", frames, np.zeros(200))
    used, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return used


def test_the_last_sample_of_an_input_that_is_still_unknown_waits():
    found = grown(whole(), np.sin(7.0 * TICKS), 20)
    found.add("hub", [2.0, 2.001], [np.nan, np.nan])
    assert found.record().inputs[0].times_s[-1] == pytest.approx(1.999)
    found.add("hub", [2.002], [np.sin(14.014)])
    assert found.record().inputs[0].gaps[0].missing == 2


@pytest.mark.parametrize(
    ("name", "times", "complaint"),
    [
        ("root", [3.0], "no signal 'root'; expected one of hub, tip"),
        ("tip", [1.0], "its clock stepped back"),
        ("tip", [3.0, 3.0], "do not rise"),
        ("tip", [3.0, np.nan], "do not rise"),
        ("tip", [[3.0]], "expected as many"),
    ],
)
def test_what_cannot_follow_is_refused(name, times, complaint):
    found = grown(whole(), np.sin(7.0 * TICKS), 20)
    with pytest.raises(RecordError, match=complaint):
        found.add(name, times, np.zeros(np.shape(times)))


def test_a_memory_of_nothing_is_refused():
    with pytest.raises(RecordError, match="memory_s is 0"):
        GrowingRecord(whole(), 0.0)
