"""What a reader of a trace is told, whatever it missed."""

from __future__ import annotations

import random

from beam_ros.view.traces import Trace


def test_readers_of_any_pace_have_the_newest_rows_and_none_twice():
    random.seed(1)
    trace = Trace(seconds=1.0)
    readers = [{"have": [], "cursor": (-1, 0)} for _ in range(5)]
    for k in range(2000):
        trace.add(k * 0.01, k)
        if k % 700 == 699:
            trace.clear()
        for n, reader in enumerate(readers):
            if random.random() < 0.5**n or k == 1999:
                news = trace.since(*reader["cursor"])
                reader["have"] = news["rows"] if news["anew"] else reader["have"] + news["rows"]
                reader["cursor"] = (trace.epoch, trace.total)
    for reader in readers:
        values = [row[1] for row in reader["have"]]
        assert values == sorted(set(values))
        assert values[-101:] == list(range(1899, 2000))


def test_a_reader_that_has_all_is_told_nothing():
    trace = Trace(1.0)
    trace.add(0.0, 1.0)
    assert trace.since(0, 1) == {"anew": False, "rows": []}


def test_rows_that_come_too_soon_are_left_out():
    trace = Trace(1.0, min_step_s=0.0035)
    for k in range(100):
        trace.add(k * 0.001, k)
    assert [row[1] for row in trace.since(-1, 0)["rows"]] == list(range(0, 100, 4))
