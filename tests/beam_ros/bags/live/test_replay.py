"""Replays: what is played, when it is due, and how pauses and steps change that."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ros import messages
from beam_ros.bags.live.replay import Pace, due_messages, replay_topics
from beam_ros.bags.reading import Bag
from beam_ros.bags.writing import BagWriter
from tests.beam_ros.bags.small_bags import BATCH, PERIOD, START, TYPES, write_experiment

MS = 1_000_000


def test_what_speaks_for_the_whole_graph_is_never_played(tmp_path):
    with BagWriter(tmp_path / "run") as bag:
        well = messages.diagnostics(TYPES, START, [messages.Health("hub", "OK", "connected", "hub")])
        bag.write_message("/diagnostics", START, well)
        bag.write_message("excitation/info", START, messages.json_text(TYPES, {}))
    with Bag(tmp_path / "run") as bag:
        assert [topic.name for topic in replay_topics(bag, with_commands=True)] == ["excitation/info"]


def test_a_later_start_plays_what_is_latched_first_and_then_from_there(tmp_path):
    path = write_experiment(tmp_path / "run", batches=100)
    with Bag(path, start_s=1.0) as bag:
        due = list(due_messages(bag, replay_topics(bag, with_commands=False)))
    latched = [item for item in due if item.name_in_bag in ("/excitation/info", "/hub/sequence_state")]
    assert [item.due_ns for item in latched] == [0, 0, 0, 0]
    assert due[:4] == latched
    batches = [item for item in due if item.name_in_bag == "/hub/measured"]
    assert len(batches) == pytest.approx(50, abs=1)
    assert batches[0].due_ns < BATCH * PERIOD
    assert np.all(np.diff([item.due_ns for item in due]) >= 0)


@pytest.mark.parametrize("rate", [0.5, 1.0, 4.0])
def test_a_pause_delays_what_comes_after_it_by_its_length(rate):
    pace = Pace(rate)
    pace.begin(1000 * MS)
    assert pace.wait_ns(100 * MS, 1000 * MS) == round(100 * MS / rate)
    pace.pause(1000 * MS + round(40 * MS / rate))
    assert pace.wait_ns(100 * MS, 9999 * MS) is None
    assert pace.position_ns(9999 * MS) == 40 * MS
    pace.resume(10_000 * MS)
    assert pace.wait_ns(100 * MS, 10_000 * MS) == pytest.approx(60 * MS / rate, abs=2)
    assert pace.position_ns(10_000 * MS) == pytest.approx(40 * MS, abs=2)


def test_a_step_lets_one_message_through_and_stands_where_it_is_due():
    pace = Pace(1.0, is_paused=True)
    pace.begin(0)
    assert pace.wait_ns(70 * MS, 5 * MS) is None
    assert pace.step()
    assert pace.wait_ns(70 * MS, 5 * MS) == 0
    assert pace.wait_ns(90 * MS, 5 * MS) is None
    assert pace.position_ns(99 * MS) == 70 * MS
    pace.resume(100 * MS)
    assert pace.wait_ns(90 * MS, 100 * MS) == 20 * MS
    assert not pace.step()


def test_lateness_is_the_root_mean_square_and_the_most_of_all_messages():
    pace = Pace(1.0)
    for wait_ns in (0, -3 * MS, -4 * MS, 0):
        pace.sent(wait_ns)
    assert pace.max_late_ns == 4 * MS
    assert pace.late_ns == pytest.approx(2.5 * MS)
