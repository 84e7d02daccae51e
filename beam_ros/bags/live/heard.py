"""What has been heard on the rig's topics so far, as a bag that grows: whatever reads bags reads it at any time.

Arrays grow with what arrives, each message being decoded once. The messages themselves, which are looked at again
only where their stamps contradict each other, lie in a file without a name.
"""

from __future__ import annotations

import struct
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from beam_ros.bags.blocks import Block, TypedTopic
from beam_ros.bags.reading import AnyIntake, Bag, RawMessage, TopicCount
from beam_ros.bags.signals import Intake
from beam_ros.interfaces import graph
from beam_ros.messages import BagTypes

_HEAD = struct.Struct("<HqI")  # number of the topic, receive time, bytes


class HeardBag(Bag):
    """Messages of the rig's topics as they come, under the names of the table.

    Parameters
    ----------
    name : str -- stands for a path in whatever is said of it
    """

    def __init__(self, name: str = "what was heard") -> None:
        self.path, self.namespace, self.storage = Path(name), "", ""
        self.is_whole, self.message_count = False, 0
        self.start_ns = self.duration_ns = self.begins_ns = 0
        self._types = BagTypes()
        self._counts: dict[str, int] = {}
        self._waiting: dict[str, list[tuple[int, bytes]]] = {}
        self._taken: dict[str, Intake[Any]] = {}
        self._spool = tempfile.TemporaryFile(prefix="beam-heard-")  # noqa: SIM115  closed in close()

    def hear(self, topic: str, data: bytes, receive_ns: int) -> None:
        """Take a message.

        Parameters
        ----------
        topic : str -- name in the table
        data : bytes -- CDR
        receive_ns : int -- when it came [ns, UNIX]
        """
        self.start_ns = self.start_ns or receive_ns
        self.duration_ns = receive_ns - self.start_ns
        self.message_count += 1
        self._counts[topic] = self._counts.get(topic, 0) + 1
        self._waiting.setdefault(topic, []).append((receive_ns, data))
        self._spool.write(_HEAD.pack(list(graph.TOPICS).index(topic), receive_ns, len(data)) + data)

    @property
    def topics(self) -> tuple[TopicCount, ...]:  # type: ignore[override]
        """The topics that were heard."""
        return tuple(
            TopicCount(name, graph.TOPICS[name].type_name, count)
            for name, count in sorted(self._counts.items())
        )

    def full_name(self, topic: str) -> str:
        """Return the name of a topic, which is that of the table."""
        return topic

    def read(self, *topics: str) -> None:
        """Read nothing ahead: what was heard is decoded when it is asked for."""

    def raw_messages(self, *topics: str) -> Iterator[RawMessage]:
        """Yield the messages in the order in which they came, of some topics or of all."""
        names = list(graph.TOPICS)
        self._spool.seek(0)
        try:
            while head := self._spool.read(_HEAD.size):
                number, receive_ns, size = _HEAD.unpack(head)
                data = self._spool.read(size)
                if not topics or names[number] in topics:
                    yield RawMessage(names[number], graph.TOPICS[names[number]].type_name, receive_ns, data)
        finally:
            self._spool.seek(0, 2)

    def _filled(self, topic: str, kind: type[AnyIntake], intake: AnyIntake) -> AnyIntake:
        """Return the intake of a topic with all that was heard of it."""
        own = self._taken.setdefault(topic, intake)
        assert isinstance(own, kind)
        if waiting := self._waiting.pop(topic, []):
            sizes = np.array([len(data) for _, data in waiting])
            receive_ns = np.array([at_ns for at_ns, _ in waiting], dtype=np.int64)
            data = np.frombuffer(b"".join(data for _, data in waiting), dtype=np.uint8)
            name = TypedTopic(topic, graph.TOPICS[topic].type_name)
            own.take(Block(name, data, np.cumsum(sizes) - sizes, sizes, receive_ns))
        return own

    def provenance(self) -> dict[str, str]:
        """Return nothing: it is no recording."""
        return {}

    def close(self) -> None:
        """Let go of the messages."""
        self._spool.close()
