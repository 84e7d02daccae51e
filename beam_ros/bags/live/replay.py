"""A bag played back: which of its messages, under which names, and when.

What has one name for a whole graph (``/diagnostics``, ``/clock``) is left out: it would speak for nodes that are not
there. The pace says when a message is due in spite of pauses and steps, and how late messages were.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from beam_ros.bags.reading import Bag
from beam_ros.interfaces import graph
from beam_ros.interfaces.graph import QualityOfService


@dataclass(frozen=True)
class ReplayTopic:
    """A topic that is played.

    Attributes
    ----------
    name_in_bag : str -- full
    name : str -- on the graph: relative for the rig's topics, so that the player's namespace moves them
    type_name : str
    qos : QualityOfService -- to offer
    """

    name_in_bag: str
    name: str
    type_name: str
    qos: QualityOfService


@dataclass(frozen=True)
class DueMessage:
    """When to publish what: time in the bag after the start [ns], the topic's name in the bag, CDR bytes."""

    due_ns: int
    name_in_bag: str
    data: bytes


def replay_topics(bag: Bag, *, with_commands: bool) -> tuple[ReplayTopic, ...]:
    """Choose the topics to play.

    Parameters
    ----------
    bag : Bag
    with_commands : bool -- also what moves an axis

    Returns
    -------
    tuple of ReplayTopic -- those with messages; commands, in whatever namespace, only when asked for; what has
        one name for the whole graph never
    """
    chosen = []
    for row in bag.topics:
        relative = row.name.removeprefix(f"/{bag.namespace}/" if bag.namespace else "/")
        known = graph.TOPICS.get(row.name) or graph.TOPICS.get(relative)
        if not row.message_count or (_is_command(row.name) and not with_commands):
            continue
        if known is not None and known.name.startswith("/"):
            continue
        if known is None or known.type_name != row.type_name:
            chosen.append(ReplayTopic(row.name, row.name, row.type_name, QualityOfService(1000)))
        else:
            chosen.append(ReplayTopic(row.name, known.name, row.type_name, known.qos))
    return tuple(chosen)


def _is_command(name: str) -> bool:
    return any(topic.is_command and name.endswith(f"/{topic.name}") for topic in graph.TOPICS.values())


def due_messages(bag: Bag, topics: tuple[ReplayTopic, ...]) -> Iterator[DueMessage]:
    """Yield the messages of some topics with their times in the bag, the first one that is played at 0.

    Parameters
    ----------
    bag : Bag -- where it is opened from a later time on, what is latched before comes first, at 0
    topics : tuple of ReplayTopic

    Raises
    ------
    BagTruncatedError
        The file is damaged further on.
    """
    if not topics:
        return
    first_ns = None if bag.begins_ns == bag.start_ns else bag.begins_ns
    for message in bag.raw_messages(*(topic.name_in_bag for topic in topics)):
        first_ns = message.receive_ns if first_ns is None else first_ns
        yield DueMessage(max(0, message.receive_ns - first_ns), message.topic, message.data)


class Pace:
    """When what is due, in spite of pauses and steps.

    Parameters
    ----------
    rate : float -- 2 plays twice as fast
    is_paused : bool -- begin so

    Attributes
    ----------
    is_paused : bool
    max_late_ns : int -- how late the latest message was [ns]
    """

    def __init__(self, rate: float, *, is_paused: bool = False) -> None:
        self.is_paused = is_paused
        self.max_late_ns = 0
        self._rate = rate
        self._steps = 0
        self._begun_ns = 0
        self._reached_ns = 0
        self._squares, self._count = 0.0, 0

    def begin(self, now_ns: int, position_ns: int = 0) -> None:
        """Begin the bag, or begin it anew, at a steady time and at a position in it."""
        self._begun_ns, self._reached_ns = now_ns - round(position_ns / self._rate), position_ns

    def pause(self, now_ns: int) -> None:
        """Stand still."""
        self._reached_ns = self.position_ns(now_ns)
        self.is_paused = True

    def resume(self, now_ns: int) -> None:
        """Go on from where it stands."""
        if self.is_paused:
            self._begun_ns = now_ns - round(self._reached_ns / self._rate)
            self.is_paused, self._steps = False, 0

    def step(self) -> bool:
        """Let one more message through; return False where nothing stands still."""
        if self.is_paused:
            self._steps += 1
        return self.is_paused

    def position_ns(self, now_ns: int) -> int:
        """Return how much of the bag has been played [ns of its time]."""
        return self._reached_ns if self.is_paused else round((now_ns - self._begun_ns) * self._rate)

    def wait_ns(self, due_ns: int, now_ns: int) -> int | None:
        """Return how long to wait for what is due [ns], not above 0 where it is to go now; None: till told."""
        if not self.is_paused:
            return self._begun_ns + round(due_ns / self._rate) - now_ns
        if self._steps == 0:
            return None
        self._steps -= 1
        self._reached_ns = due_ns
        return 0

    def sent(self, wait_ns: int) -> None:
        """Take note of a message that went out ``-wait_ns`` late."""
        late_ns = max(0, -wait_ns)
        self.max_late_ns = max(self.max_late_ns, late_ns)
        self._squares += float(late_ns) ** 2
        self._count += 1

    @property
    def late_ns(self) -> float:
        """Root mean square of how late the messages were [ns]."""
        return math.sqrt(self._squares / self._count) if self._count else 0.0
