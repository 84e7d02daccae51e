"""The state of the page from the rig's own messages, as bytes."""

from __future__ import annotations

import json

import numpy as np
import pytest

from beam_ros import messages
from beam_ros.bags.batches import encode_batch
from beam_ros.hub.contract import SampleBatch
from beam_ros.interfaces import graph
from beam_ros.messages import BagTypes, Health
from beam_ros.rig.rig import Rig
from beam_ros.view.scene import SHOWN_TOPICS, Cursor, Scene

TYPES = BagTypes()
START = 1_700_000_000_000_000_000


@pytest.fixture
def scene() -> Scene:
    return Scene(Rig.from_file(), source="rig", title="a rig")


def text(scene: Scene, topic: str, content: dict, now_s: float = 0.0) -> None:
    scene.take(topic, TYPES.serialize(messages.json_text(TYPES, content), graph.STRING), now_s, now_s)


def hub(scene: Scene, now_s: float, first_ms: int = 0) -> None:
    batch = SampleBatch(START + first_ms * 1_000_000, 1_000_000, 1, positions=np.full(20, 1e-3))
    scene.take("hub/measured", encode_batch(batch), now_s, now_s)


def health(scene: Scene, now_s: float, **values: object) -> None:
    message = messages.diagnostics(TYPES, START, [Health("hub: simulator", "OK", "fine", "hub", values)])
    scene.take("/diagnostics", TYPES.serialize(message, graph.DIAGNOSTICS), now_s, now_s)


def logged(scene: Scene) -> list[str]:
    return [row["text"] for row in scene.log.since(-1, 0)["rows"]]


def test_a_reader_gets_all_at_first_then_only_what_is_new(scene):
    cursor = Cursor()
    first = json.loads(scene.news(cursor))
    assert {"beam", "axis", "shape", "hub", "tip", "log", "losses", "identification"} <= set(first)
    assert scene.news(cursor) == ""
    hub(scene, 0.0)
    second = json.loads(scene.news(cursor))
    assert set(second) == {"shape", "hub"}
    assert second["hub"]["rows"][0][1] == 1.0
    text(scene, "hub/mode", {"state": "homed", "activity": "idle", "fault": None, "since": 0.0, "reason": ""})
    assert set(json.loads(scene.news(cursor))) == {"axis", "log"}


def test_a_slow_reader_gets_the_newest_state_and_not_what_was_between(scene):
    cursor = Cursor()
    scene.news(cursor)
    for state in ("loading", "ready", "running", "done"):
        text(scene, "hub/sequence_state", {"id": "a", "state": state, "points": 1, "reason": ""})
    assert json.loads(scene.news(cursor))["sequence"]["state"] == "done"


def test_a_fault_comes_with_its_sentence_and_remedy(scene):
    fault = {
        "number": 65,
        "name": "port_lost",
        "sentence": "the port vanished",
        "remedy": "check cable and power",
    }
    text(
        scene, "hub/mode", {"state": "fault", "activity": "idle", "fault": fault, "since": 0.0, "reason": ""}
    )
    assert scene.part("axis")["mode"]["fault"] == fault
    assert logged(scene) == ["hub: fault: the port vanished; check cable and power"]


def test_a_hub_that_falls_silent_is_noticed_and_so_is_its_return(scene):
    hub(scene, 0.0)
    scene.look(1.0, 1.0)
    assert not scene.part("axis")["silent"]
    scene.look(3.0, 3.0)
    assert scene.part("axis")["silent"]
    hub(scene, 4.0, 4000)
    scene.look(4.1, 4.1)
    assert not scene.part("axis")["silent"]
    assert logged(scene) == ["nothing is heard of the hub any more", "the hub is heard again"]


def test_a_node_that_falls_silent_is_no_longer_shown_as_well(scene):
    health(scene, 0.0)
    scene.look(1.0, 1.0)
    assert scene.part("nodes") == [{"name": "hub", "level": "OK", "sentence": "fine"}]
    scene.look(10.0, 10.0)
    assert scene.part("nodes")[0]["level"] == "STALE"


def test_losses_are_counted_where_they_were(scene):
    health(scene, 0.0, lost_ticks=3)
    row = {"where": "hub", "what": "samples of the hub lost on the line", "count": 3}
    assert scene.part("losses") == [row]


def test_stamps_that_step_back_are_said_and_begin_the_curves_anew(scene):
    cursor = Cursor()
    hub(scene, 0.0, 9000)
    scene.news(cursor)
    hub(scene, 0.1, 2000)
    news = json.loads(scene.news(cursor))
    assert news["hub"]["anew"]
    assert "the stamps stepped back by 7.019 s" in news["log"]["rows"][0]["text"]


# The markers' pixels are read beside the frame that they are shown in: see the tests of pictures.
@pytest.mark.parametrize("topic", sorted({*SHOWN_TOPICS} - {"beam/markers"}))
def test_what_cannot_be_read_is_one_line_of_the_log_however_often_it_comes(scene, topic):
    for _ in range(3):
        scene.take(topic, b"\x00\x01\x00\x00nonsense that is no message", 0.0, 0.0)
    assert len(logged(scene)) == 1
    assert topic in logged(scene)[0]


def test_the_rig_is_the_one_that_the_excitation_describes_unless_its_file_was_given():
    other = Rig.from_file().with_values({"hub.travel": 0.3})
    info = {"recipe": {"kind": "chirp", "duration": 5.0}, "rig": other.to_nested()}
    for is_given, limit in ((False, 150.0), (True, 50.0)):
        scene = Scene(Rig.from_file(), source="bag", title="a bag", is_rig_given=is_given)
        hub(scene, 0.0)
        cursor = Cursor()
        scene.news(cursor)
        text(scene, "excitation/info", info)
        assert scene.part("beam")["hub_limit"] == limit
        assert logged(scene) == ["excitation: chirp"]
        # Curves of another beam do not go on.
        assert ("hub" in json.loads(scene.news(cursor))) == (not is_given)


def test_the_estimate_is_shown_and_said_when_its_state_changes(scene):
    live = {
        "version": 1,
        "state": "growing",
        "sentence": "one mode so far",
        "record_s": 3.0,
        "samples": {"input": 3000},
        "started": 0.0,
        "modes": [
            {"frequency_hz": 4.4, "frequency_sd_hz": 0.01, "damping_ratio": 0.005, "damping_ratio_sd": None}
        ],
        "response": None,
        "shape": None,
        "tests": [],
        "aims": [],
        "cost": {"share_of_core": 0.1, "seconds_of_last_fit": 0.1},
    }
    text(scene, "identification/live", live)
    text(scene, "identification/live", {**live, "sentence": "one mode still"})
    assert scene.part("identification")["modes"][0]["frequency_hz"] == 4.4
    assert scene.part("identification")["sentence"] == "one mode still"
    text(scene, "identification/live", {**live, "state": "known", "sentence": "all aims are met"})
    assert logged(scene) == ["identification: one mode so far", "identification: all aims are met"]


def test_an_entry_at_another_place_of_a_bag_forgets_what_was_under_way(scene):
    cursor = Cursor()
    hub(scene, 0.0)
    text(scene, "hub/sequence_state", {"id": "a", "state": "done", "points": 1, "reason": ""})
    scene.news(cursor)
    scene.begin_anew()
    news = json.loads(scene.news(cursor))
    assert news["sequence"] is None
    assert news["log"] == {"anew": True, "rows": []}
    assert news["hub"] == {"anew": True, "rows": []}
