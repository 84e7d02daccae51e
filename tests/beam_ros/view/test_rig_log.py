"""The log says each change once, in words."""

from __future__ import annotations

import pytest

from beam_ros.hub.contract import ACTIVITIES, AXIS_STATES, SequenceState
from beam_ros.view import rig_log
from beam_ros.view.rig_log import RigLog, words_of_mode, words_of_sequence


def texts(log: RigLog) -> list[str]:
    return [row["text"] for row in log.since(-1, 0)["rows"]]


def test_every_word_of_the_hub_has_words_for_people():
    assert set(rig_log.STATES) == set(AXIS_STATES)
    assert set(rig_log.ACTIVITIES) == set(ACTIVITIES)
    assert set(rig_log.SEQUENCES) == set(SequenceState.__args__)


@pytest.mark.parametrize(
    ("mode", "words"),
    [
        ({"state": "homed", "activity": "idle"}, "homed, switched off"),
        ({"state": "enabled", "activity": "hold"}, "switched on, holds its place"),
        ({"state": "enabled", "activity": "stopping"}, "switched on, decelerates to rest"),
        (
            {
                "state": "fault",
                "activity": "idle",
                "fault": {"sentence": "the port vanished", "remedy": "plug it in"},
            },
            "fault: the port vanished; plug it in",
        ),
        ({"state": "brand new", "activity": "dancing"}, "brand new, dancing"),
    ],
)
def test_a_mode_is_said_in_words(mode, words):
    assert words_of_mode(mode) == words


def test_a_sequence_that_was_refused_says_why():
    said = words_of_sequence({"id": "a", "state": "refused", "reason": "too fast"})
    assert said == "sequence a was refused: too fast"


def test_the_same_is_said_once_and_a_change_again():
    log = RigLog()
    for _ in range(3):
        log.mode(0.0, {"state": "homed", "activity": "idle"})
    log.mode(0.0, {"state": "enabled", "activity": "hold"})
    log.mode(0.0, {"state": "homed", "activity": "idle"})
    assert len(texts(log)) == 3


def test_a_node_is_in_the_log_when_it_falls_ill_and_when_it_is_well_again():
    log = RigLog()
    for level in ("OK", "OK", "WARN", "WARN", "OK"):
        log.health(0.0, "tracker", level, f"says {level}")
    assert texts(log) == ["tracker: says WARN", "tracker is well again: says OK"]


def test_a_recorder_that_loses_says_so_once_in_a_recording():
    log = RigLog()
    for lost in (0, 1, 7):
        log.recorder(0.0, {"recording": True, "path": "a", "messages": 10, "lost": lost})
    log.recorder(0.0, {"recording": False, "path": "a", "messages": 20, "lost": 7})
    assert texts(log) == ["recording to a", "the recorder loses messages of a", "recorded 20 messages to a"]


def test_only_the_newest_are_kept_and_a_reader_gets_what_it_lacks():
    log = RigLog(length=10)
    for k in range(25):
        log.add(0.0, "info", str(k))
    assert [row["text"] for row in log.since(0, 23)["rows"]] == ["23", "24"]
    assert log.since(0, 3)["anew"]
    assert texts(log) == [str(k) for k in range(15, 25)]
