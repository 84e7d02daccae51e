"""A bag played back: which of its messages, under which names, and when."""

from __future__ import annotations

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
    """When to publish what: time after the start [ns], the topic's name in the bag, CDR bytes."""

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
    tuple of ReplayTopic -- those with messages; commands, in whatever namespace, only when asked for
    """
    chosen = []
    for row in bag.topics:
        relative = row.name.removeprefix(f"/{bag.namespace}/" if bag.namespace else "/")
        known = graph.TOPICS.get(row.name) or graph.TOPICS.get(relative)
        if not row.message_count or (_is_command(row.name) and not with_commands):
            continue
        if known is None or known.type_name != row.type_name:
            chosen.append(ReplayTopic(row.name, row.name, row.type_name, QualityOfService(1000)))
        else:
            chosen.append(ReplayTopic(row.name, known.name, row.type_name, known.qos))
    return tuple(chosen)


def _is_command(name: str) -> bool:
    return any(topic.is_command and name.endswith(f"/{topic.name}") for topic in graph.TOPICS.values())


def due_messages(bag: Bag, topics: tuple[ReplayTopic, ...], rate: float) -> Iterator[DueMessage]:
    """Yield the messages of some topics with their times, the first one at 0.

    Parameters
    ----------
    bag : Bag
    topics : tuple of ReplayTopic
    rate : float -- 2 plays twice as fast

    Raises
    ------
    BagTruncatedError
        The file is damaged further on.
    """
    if not topics:
        return
    first_ns: int | None = None
    for message in bag.raw_messages(*(topic.name_in_bag for topic in topics)):
        first_ns = message.receive_ns if first_ns is None else first_ns
        yield DueMessage(round((message.receive_ns - first_ns) / rate), message.topic, message.data)
