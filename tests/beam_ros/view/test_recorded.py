"""A bag on the page: played, paused, entered at any place."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest

from beam_ros.bags.writing import BagWriter
from beam_ros.errors import UsageError
from beam_ros.rig.rig import Rig
from beam_ros.view.recorded import RecordedScene
from beam_ros.view.scene import Scene
from beam_ros.view.server import OrderRefusedError
from tests.beam_ros.bags.small_bags import START, TYPES, write_experiment
from tests.graph import HANG_S


class Watched(Scene):
    """A scene that can be waited for, and keeps when it was told what."""

    def __init__(self) -> None:
        super().__init__(Rig.from_file(), source="bag", title="a bag")
        self.taken: list[tuple[str, float]] = []
        self.is_news = threading.Condition()

    def take(self, topic: str, data: bytes, now_s: float, day_s: float) -> None:
        super().take(topic, data, now_s, day_s)
        with self.is_news:
            self.taken.append((topic, now_s))
            self.is_news.notify_all()

    def wait_for(self, condition) -> None:
        with self.is_news:
            assert self.is_news.wait_for(lambda: condition(self), HANG_S)


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    return write_experiment(tmp_path / "bag", batches=100)


@pytest.fixture
def player(bag: Path):
    """A player that stands still at the beginning of two seconds."""
    scene = Watched()
    player = RecordedScene(bag, scene, clock_ns=lambda: 0)
    player.start(is_paused=True)
    yield player, scene
    player.close()


def reached(seconds: float):
    return lambda scene: any(at_s >= seconds for _, at_s in scene.taken)


def test_a_place_shows_what_was_before_it_at_once_and_nothing_of_after(player):
    player, scene = player
    assert player.orders["seek"](1.5) == "at 1.5 s"
    scene.wait_for(reached(1.48))
    player.show()
    assert scene.part("player") == {"position": 1.5, "duration": 2.0, "playing": False}
    assert scene.part("sequence")["state"] == "done"  # said at the beginning, and true until it is said anew
    assert max(at_s for _, at_s in scene.taken) <= 1.5
    player.orders["seek"](0.5)
    scene.wait_for(lambda scene: scene.taken[-1][1] == pytest.approx(0.5))


@pytest.mark.parametrize("value", [None, -1.0, "2", True, float("nan"), float("inf"), [1]])
def test_what_is_no_place_is_refused(player, value):
    with pytest.raises(OrderRefusedError, match="expected seconds"):
        player[0].orders["seek"](value)


def test_a_place_behind_the_end_is_the_end(player):
    player, scene = player
    player.orders["seek"](99.0)
    scene.wait_for(reached(1.99))
    player.show()
    assert scene.part("player")["position"] == 2.0


@pytest.mark.slow
def test_a_bag_plays_to_its_end_pauses_there_and_begins_anew(bag: Path):
    scene = Watched()
    player = RecordedScene(bag, scene)
    try:
        player.start()
        scene.wait_for(reached(1.99))
        player.show()
        while scene.part("player")["playing"]:
            player.show()
        assert scene.part("player")["position"] == pytest.approx(2.0, abs=0.05)
        scene.taken.clear()
        player.orders["play"](None)
        scene.wait_for(reached(1.0))
        assert scene.taken[0][1] < 0.1
    finally:
        player.close()


def test_a_bag_without_anything_to_show_is_refused_in_one_line(tmp_path: Path):
    path = tmp_path / "other"
    with BagWriter(path) as writer:
        writer.write_message("hub/state", START, _hub_state())
    with pytest.raises(UsageError, match="holds nothing that the page shows"):
        RecordedScene(path, Watched())


def _hub_state():
    from beam_ros import messages

    return messages.hub_state(TYPES, messages.HubSample(START, 0.0))
