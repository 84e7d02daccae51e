"""What was lost, and where: the counters of ``/diagnostics`` in words that say what it means for a recording."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from beam_ros.bags.summary import BagInfo
from beam_ros.messages import Health

LOSSES = (
    # node, counter, what it counts
    ("hub", r"lost_ticks", "samples of the hub lost on the line"),
    ("hub", r"bad_frames", "damaged frames on the line"),
    ("hub", r"lost_answers", "questions to the controller without an answer"),
    ("hub", r"late_writes", "commands written late"),
    ("hub", r"real_time_jumps", "jumps of the computer's clock"),
    ("hub", r"refused set-points", "set-points refused"),
    ("tracker", r"dropped frames", "camera frames that never came"),
    ("tracker", r"unusable frames", "frames that could not be read"),
    ("tracker", r"repeated frames", "frames that came twice"),
    ("tracker", r"frames from the past", "frames that came late"),
    ("tracker", r"clock steps", "jumps of the camera's clock"),
    ("tracker", r"(\S+) lost", r"frames without marker \1"),
    ("recorder", r"lost", "messages that the recorder lost"),
)
"""Which counters of a node say that something was lost, and in which words."""


@dataclass(frozen=True)
class Loss:
    """So many of something were lost at a node; 0 says that it was counted, and none was."""

    where: str
    what: str
    count: int


def losses_of_nodes(statuses: Iterable[Health]) -> tuple[Loss, ...]:
    """Return the losses that the newest statuses of the nodes count, in the order of the table."""
    by_node: Mapping[str, Health] = {status.hardware_id: status for status in statuses}
    found = []
    for node, pattern, words in LOSSES:
        values = by_node[node].values if node in by_node else {}
        for name, value in values.items():
            match = re.fullmatch(pattern, str(name))
            if match and re.fullmatch(r"\d+", str(value)):
                found.append(Loss(node, match.expand(words), int(str(value))))
    return tuple(found)


def losses_of_bag(info: BagInfo) -> tuple[Loss, ...]:
    """Return what is missing from a bag."""
    found = []
    for signal in info.signals:
        topic = signal.topic.lstrip("/")
        found.append(Loss(topic, f"samples missing, in {signal.gaps} gaps", signal.lost))
        if signal.unreadable:
            found.append(Loss(topic, "messages that cannot be read", signal.unreadable))
        found += [
            Loss(topic, f"frames without marker {name}", count)
            for name, count in zip(signal.names, signal.unseen, strict=True)
        ]
    return tuple(found)
