"""The tracker's page names what there is: every parameter, topic and service, and none that is not."""

from __future__ import annotations

import re
from pathlib import Path

from beam_ros.interfaces.graph import NODES, TOPICS
from beam_ros.interfaces.rig_parameters import RIG_PARAMETERS

PAGE = (Path(__file__).parents[3] / "docs" / "tracker-node.md").read_text(encoding="utf-8")
WORDS = set(re.findall(r"`([a-z_]+[./][a-z_]+(?:/[a-z_]+)?)`", PAGE))


def test_every_parameter_of_the_tracker_is_told_and_every_one_told_exists() -> None:
    told = {word for word in WORDS if "." in word and not word.endswith(".py")}
    assert told <= set(RIG_PARAMETERS)
    assert {name for name in RIG_PARAMETERS if name.startswith("tracker.")} <= told


def test_every_topic_and_service_of_the_tracker_is_told() -> None:
    row = NODES["vision_tracker"]
    wanted = {name for name in (*row.publishes, *row.subscribes) if not name.startswith("/")}
    assert wanted | set(row.serves) <= WORDS
    assert {word for word in WORDS if "/" in word} <= set(TOPICS) | set(row.serves)
