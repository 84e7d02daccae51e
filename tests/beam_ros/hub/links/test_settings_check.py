"""When a controller is asked for its settings, and what becomes of the answers, in virtual time."""

from __future__ import annotations

import pytest

from beam_ros.hub.links.settings_check import PATIENCE_S, SettingsCheck
from beam_ros.hub.links.trajectory import CONTROLLER_SETTINGS

WRONG = {"joints": ["slider", "arm"], "allow_partial_joints_goal": False}
RIGHT = {"joints": ["slider"]}


class Scene:
    """A hub as the check sees it, a controller that answers when it is told to, and a clock."""

    def __init__(self) -> None:
        self.is_connected, self.awaits_check = True, False
        self.verdicts: list[str] = []
        self.denials: list[str] = []
        self.asked: list[str] = []
        self.warnings = 0
        self.is_there = False
        self.now_s = 0.0
        self.check = SettingsCheck(self, self.asked.append, self._warn, "slider", "acceleration")

    def judge(self, objection: str) -> None:
        self.awaits_check = False
        self.verdicts.append(objection)
        self.is_connected = not objection

    def leave_off(self, reason: str) -> None:
        self.denials.append(reason)

    def _warn(self) -> None:
        self.warnings += 1

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / 0.1)):
            self.now_s += 0.1
            self.check.look(self.now_s, is_there=self.is_there)

    def answer(self, settings: dict[str, object], n: int | None = None) -> None:
        for name in self.asked[:n]:
            self.check.answer(name, settings.get(name))
        del self.asked[:n]


@pytest.fixture
def scene() -> Scene:
    return Scene()


def test_a_controller_that_comes_long_after_its_joint_states_is_still_asked_and_refused(scene: Scene) -> None:
    scene.run(PATIENCE_S + 1.0)
    assert (scene.verdicts, scene.warnings, scene.awaits_check) == ([""], 1, False)
    scene.is_there = True
    scene.run(0.2)
    scene.answer(WRONG)
    assert "allow_partial_joints_goal: true" in scene.verdicts[-1]
    assert scene.warnings == 1


def test_answers_that_take_longer_than_the_patience_count(scene: Scene) -> None:
    scene.is_there = True
    scene.run(1.6 * PATIENCE_S)
    # The answers to the first questions alone.
    scene.answer(WRONG, len(CONTROLLER_SETTINGS))
    assert scene.verdicts[-1]


def test_a_lost_answer_is_asked_for_again_and_nothing_else(scene: Scene) -> None:
    scene.is_there = True
    scene.run(0.2)
    lost = scene.asked.pop()
    scene.answer(RIGHT)
    scene.run(PATIENCE_S + 0.2)
    assert scene.asked == [lost]
    scene.answer(RIGHT)
    assert scene.verdicts == [""]


def test_a_controller_that_is_there_and_answers_nothing_leaves_the_motor_off_with_a_reason(
    scene: Scene,
) -> None:
    scene.is_there = True
    scene.run(PATIENCE_S - 0.2)
    assert scene.denials == []
    scene.run(0.5)
    assert "has not said its settings" in scene.denials[-1]
    assert scene.awaits_check
    assert scene.verdicts == []


def test_a_refused_controller_is_asked_until_it_is_mended(scene: Scene) -> None:
    scene.is_there = True
    scene.run(0.2)
    scene.answer(WRONG)
    scene.run(0.5 * PATIENCE_S)
    assert scene.asked == []
    scene.run(PATIENCE_S)
    scene.answer(RIGHT)
    assert scene.verdicts[-1] == ""


@pytest.mark.parametrize("goes", ["service", "joint states"])
def test_a_controller_that_goes_and_comes_back_is_asked_anew(scene: Scene, goes: str) -> None:
    scene.is_there = True
    scene.run(0.2)
    scene.answer(RIGHT)
    scene.run(3.0 * PATIENCE_S)
    assert scene.asked == []
    name = "is_there" if goes == "service" else "is_connected"
    setattr(scene, name, False)
    scene.run(0.3)
    # One that is held is not let go because its service is gone.
    assert scene.awaits_check == (goes == "joint states")
    setattr(scene, name, True)
    scene.run(0.2)
    scene.answer(WRONG)
    assert scene.verdicts[-1]
