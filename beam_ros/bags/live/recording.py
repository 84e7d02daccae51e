"""A recording in progress: the receiver of messages hands them over, a thread of its own writes them.

The receiver never waits for the disk. What is handed over reaches the file in less than a second, also when
nothing follows; should the disk fall far behind, messages are dropped and counted rather than the
memory filled. A recording ends by itself, as a whole bag, before the disk is full.
"""

from __future__ import annotations

import queue
import shutil
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from beam_ros.bags.errors import BagError
from beam_ros.bags.writing import BagWriter, FileLimits
from beam_ros.interfaces.graph import QualityOfService

IDLE_FLUSH_S = 0.25
"""After this silence [s] the chunk in the making is closed too, beside what the writer does by itself."""

DISK_LOOK_S = 0.5
"""So often the free space of the disk is looked at [s]."""

MAX_WAITING_BYTES = 512 * 2**20
"""What may wait for the disk; about 15 s of VGA frames at 100 Hz."""


@dataclass(frozen=True)
class _Announcement:
    topic: str
    type_name: str
    qos: tuple[QualityOfService, ...]


@dataclass(frozen=True)
class _Arrival:
    topic: str
    receive_ns: int
    publish_ns: int
    data: bytes


class Recording:
    """Writes one bag from a thread of its own.

    Parameters
    ----------
    path : Path -- the bag's folder; must not exist
    provenance : mapping of str to str, optional -- how the bag comes about
    limits : FileLimits, optional -- after how much another file begins
    min_free : int -- the recording ends where the disk has less left [bytes]

    Attributes
    ----------
    path : Path
    dropped : int -- messages given up because the disk fell too far behind
    failure : str -- why the recording took no more; empty while all is well

    Raises
    ------
    BagError
        The bag cannot be created.
    """

    def __init__(
        self,
        path: Path,
        *,
        provenance: Mapping[str, str] | None = None,
        limits: FileLimits = FileLimits(),  # noqa: B008 - frozen
        min_free: int = 0,
    ) -> None:
        self.path = path
        self.dropped = 0
        self.failure = ""
        self._writer = BagWriter(path, provenance=provenance, limits=limits)
        self._min_free = min_free
        self._next_look = 0.0
        self._queue: queue.SimpleQueue[_Announcement | _Arrival | None] = queue.SimpleQueue()
        self._waiting_bytes = 0
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._work, name="bag writer", daemon=True)
        self._thread.start()

    @property
    def message_count(self) -> int:
        """Messages written so far."""
        return self._writer.message_count

    def announce(self, topic: str, type_name: str, qos: tuple[QualityOfService, ...]) -> None:
        """Name a topic by its full name, with what its publishers offer, before its first message."""
        self._queue.put(_Announcement(topic, type_name, qos))

    def put(self, topic: str, receive_ns: int, publish_ns: int, data: bytes) -> None:
        """Hand over one message of an announced topic; returns at once."""
        with self._lock:
            if self.failure or self._waiting_bytes + len(data) > MAX_WAITING_BYTES:
                self.dropped += 1
                return
            self._waiting_bytes += len(data)
        self._queue.put(_Arrival(topic, receive_ns, publish_ns, data))

    def stop(self) -> None:
        """Write what still waits and finish the bag.

        Raises
        ------
        BagError
            The disk refused; what was written before can be recovered.
        """
        self._queue.put(None)
        self._thread.join()
        if self.failure:
            raise BagError(self.failure)

    def _work(self) -> None:
        try:
            while self._has_space():
                try:
                    item = self._queue.get(timeout=IDLE_FLUSH_S)
                except queue.Empty:
                    self._writer.flush()
                    continue
                if item is None:
                    break
                self._take(item)
            self._writer.close()
        except BagError as err:
            with self._lock:
                self.failure = str(err)
            self._writer.abandon()

    def _has_space(self) -> bool:
        """Look at the disk from time to time; where little is left, say why the bag ends here."""
        if not self._min_free or time.monotonic() < self._next_look:
            return True
        self._next_look = time.monotonic() + DISK_LOOK_S
        free = shutil.disk_usage(self.path).free
        if free >= self._min_free:
            return True
        with self._lock:
            self.failure = (
                f"{self.path} was ended before the disk is full: {free / 1e6:.0f} MB are left, expected at least "
                f"{self._min_free / 1e6:.0f} MB (recorder.min_free); the bag is whole; make space and record anew"
            )
        return False

    def _take(self, item: _Announcement | _Arrival) -> None:
        if isinstance(item, _Announcement):
            self._writer.add_topic(item.topic, item.type_name, item.qos)
            return
        with self._lock:
            self._waiting_bytes -= len(item.data)
        self._writer.write(item.topic, item.receive_ns, item.data, publish_ns=item.publish_ns)


class LossCounter:
    """Counts what a topic's only publisher sent and nobody here received, by its sequence numbers.

    A middleware that keeps the last n messages drops older ones without a word; their numbers are then
    missing. Numbers that begin anew are a restarted publisher.
    """

    def __init__(self) -> None:
        self.lost = 0
        self._last: int | None = None

    def see(self, number: int | None) -> None:
        """Take note of a received message's number; None where the middleware gives none."""
        if number is None:
            return
        if self._last is not None and number > self._last + 1:
            self.lost += number - self._last - 1
        self._last = number

    def forget(self) -> None:
        """Start anew: there is more than one publisher, whose numbers run side by side."""
        self._last = None
