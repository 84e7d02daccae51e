"""What has been heard on the rig's topics so far, as a bag that grows: whatever reads bags reads it at any time.

Arrays grow with what arrives, each message being decoded once. The messages themselves, which are looked at again
only where their stamps contradict each other, lie in files without a name. What streams may be forgotten after some
time; what is latched holds until it is said anew.
"""

from __future__ import annotations

import math
import struct
import tempfile
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

import numpy as np

from beam_ros.bags.blocks import Block, TypedTopic
from beam_ros.bags.reading import AnyIntake, Bag, RawMessage, TopicCount
from beam_ros.bags.signals import Intake
from beam_ros.interfaces import graph
from beam_ros.messages import SECOND_NS, BagTypes

_HEAD = struct.Struct("<HqI")  # number of the topic, receive time, bytes


@dataclass
class _Spool:
    """Messages as they came, from a time on [ns, UNIX], in a file without a name."""

    begun_ns: int
    file: IO[bytes]


@dataclass
class _Stream:
    """What was heard on a topic: receive times of what is remembered, what waits to be decoded, and how many came."""

    count: int = 0
    received_ns: deque[int] = field(default_factory=deque)
    waiting: deque[tuple[int, bytes]] = field(default_factory=deque)
    intake: Intake[Any] | None = None

    def forget(self, before_ns: int) -> None:
        """Let go of what was received before a time [ns, UNIX]."""
        while self.received_ns and self.received_ns[0] < before_ns:
            self.received_ns.popleft()
        while self.waiting and self.waiting[0][0] < before_ns:
            self.waiting.popleft()


class HeardBag(Bag):
    """Messages of the rig's topics as they come, under the names of the table.

    Parameters
    ----------
    name : str -- stands for a path in whatever is said of it
    memory_s : float -- of what streams, only what was received so long before the newest message is kept [s]
    n_files : int -- in which these messages lie; one that holds only forgotten ones is given up
    """

    def __init__(self, name: str = "what was heard", memory_s: float = math.inf, *, n_files: int = 5) -> None:
        self.path, self.namespace, self.storage = Path(name), "", ""
        self.is_whole, self.message_count = False, 0
        self.start_ns = self.duration_ns = self.begins_ns = 0
        self.memory_s, self._n_files = memory_s, n_files
        self._types = BagTypes()
        self._streams: dict[str, _Stream] = {}
        self._spools: deque[_Spool] = deque()

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
        stream = self._streams.setdefault(topic, _Stream())
        stream.count += 1
        stream.received_ns.append(receive_ns)
        stream.waiting.append((receive_ns, data))
        self._forget(topic)
        self._spool(receive_ns).write(
            _HEAD.pack(list(graph.TOPICS).index(topic), receive_ns, len(data)) + data
        )

    def _forget(self, topic: str) -> None:
        """Let go of what streams on a topic of the table and is older than the memory."""
        row = graph.TOPICS.get(topic)
        if row is not None and not row.qos.is_latched and math.isfinite(self.memory_s):
            newest_ns = self.start_ns + self.duration_ns
            self._streams[topic].forget(newest_ns - round(self.memory_s * SECOND_NS))

    def _spool(self, now_ns: int) -> IO[bytes]:
        """Return the file of the newest messages."""
        part_s = self.memory_s / (self._n_files - 1)
        if not self._spools or now_ns - self._spools[-1].begun_ns > part_s * SECOND_NS:
            file = tempfile.TemporaryFile(prefix="beam-heard-")  # noqa: SIM115  closed in close()
            self._spools.append(_Spool(now_ns, file))
            if len(self._spools) > self._n_files:
                self._spools.popleft().file.close()
        return self._spools[-1].file

    @property
    def topics(self) -> tuple[TopicCount, ...]:  # type: ignore[override]
        """The topics that were heard."""
        return tuple(
            TopicCount(name, graph.TOPICS[name].type_name, stream.count)
            for name, stream in sorted(self._streams.items())
            if stream.count
        )

    def full_name(self, topic: str) -> str:
        """Return the name of a topic, which is that of the table."""
        return topic

    def read(self, *topics: str) -> None:
        """Read nothing ahead: what was heard is decoded when it is asked for."""

    def raw_messages(self, *topics: str) -> Iterator[RawMessage]:
        """Yield the messages in the order in which they came, of some topics or of all."""
        names = list(graph.TOPICS)
        for spool in self._spools:
            spool.file.seek(0)
            try:
                while head := spool.file.read(_HEAD.size):
                    number, receive_ns, size = _HEAD.unpack(head)
                    data = spool.file.read(size)
                    if not topics or names[number] in topics:
                        yield RawMessage(
                            names[number], graph.TOPICS[names[number]].type_name, receive_ns, data
                        )
            finally:
                spool.file.seek(0, 2)

    def _filled(self, topic: str, kind: type[AnyIntake], intake: AnyIntake) -> AnyIntake:
        """Return the intake of a topic with all that is remembered of it."""
        stream = self._streams.setdefault(topic, _Stream())
        self._forget(topic)
        if stream.intake is None:
            stream.intake = intake
        own = stream.intake
        assert isinstance(own, kind)
        if waiting := list(stream.waiting):
            stream.waiting.clear()
            sizes = np.array([len(data) for _, data in waiting])
            receive_ns = np.array([at_ns for at_ns, _ in waiting], dtype=np.int64)
            data = np.frombuffer(b"".join(data for _, data in waiting), dtype=np.uint8)
            name = TypedTopic(topic, graph.TOPICS[topic].type_name)
            own.take(Block(name, data, np.cumsum(sizes) - sizes, sizes, receive_ns))
        own.forget(own.n_seen - len(stream.received_ns))
        return own

    def provenance(self) -> dict[str, str]:
        """Return nothing: it is no recording."""
        return {}

    def close(self) -> None:
        """Let go of the messages."""
        for spool in self._spools:
            spool.file.close()
