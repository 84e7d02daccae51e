"""A recorded bag on the page: played, paused, and entered at any place.

A thread reads the bag and hands every message to the scene when it is due. At another place the page
shows at once what the last seconds before it say: they are read without waiting.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from beam_ros.bags.errors import BagError
from beam_ros.bags.live.replay import Pace
from beam_ros.bags.reading import Bag
from beam_ros.errors import UsageError
from beam_ros.messages import SECOND_NS, LiveIdentification
from beam_ros.process.remote_paths import AnyPath
from beam_ros.view.scene import SHOWN_TOPICS, Scene
from beam_ros.view.server import OrderRefusedError


class RecordedScene:
    """Plays one bag into a scene.

    Parameters
    ----------
    path : Path, RemotePath or str -- as ``Bag`` takes it
    scene : Scene -- of source "bag"
    lead_s : float -- so much before a place is read when it is entered [s]
    estimate_at : callable -- returns what the growing estimate says at a time of the bag [s]; None: nothing yet
    clock_ns : callable -- steady time [ns]

    Raises
    ------
    UsageError
        The bag holds nothing that the page shows.
    """

    def __init__(
        self,
        path: AnyPath | str,
        scene: Scene,
        *,
        lead_s: float = 10.0,
        estimate_at: Callable[[float], LiveIdentification | None] = lambda position_s: None,
        clock_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._path, self._scene, self._clock_ns = path, scene, clock_ns
        self._lead_ns = round(lead_s * SECOND_NS)
        self._estimate_at = estimate_at
        self._estimate: LiveIdentification | None = None
        with Bag(path) as bag:
            self._start_ns, self.duration_ns = bag.start_ns, bag.duration_ns
            self._topics = {bag.full_name(topic): topic for topic in SHOWN_TOPICS if bag.count(topic)}
            self._namespace = bag.namespace
            if not self._topics:
                raise UsageError(
                    f"{path} holds nothing that the page shows: expected one of {', '.join(SHOWN_TOPICS)}; choose "
                    "another bag, or look with `beam info`"
                )
        self._pace = Pace(1.0, is_paused=True)
        self._pace.begin(clock_ns())
        self._turn = threading.Condition()
        self._entered_ns: int | None = 0
        self._is_ending = False
        self._thread = threading.Thread(target=self._run, name="bag", daemon=True)
        self.show()

    @property
    def orders(self) -> Mapping[str, Callable[[Any], str]]:
        """What a reader may ask of the player."""
        return {"play": self._play, "pause": self._pause, "seek": self._seek}

    def start(self, *, is_paused: bool = False) -> None:
        """Begin to play."""
        self._thread.start()
        if not is_paused:
            self._play(None)

    def close(self) -> None:
        """End the player."""
        with self._turn:
            self._is_ending = True
            self._turn.notify_all()
        if self._thread.ident is not None:
            self._thread.join()

    def show(self) -> None:
        """Tell the scene where the player is, and what is known there."""
        with self._turn:
            at_ns = min(self._pace.position_ns(self._clock_ns()), self.duration_ns)
            player = {
                "position": round(at_ns / SECOND_NS, 2),
                "duration": round(self.duration_ns / SECOND_NS, 2),
                "playing": not self._pace.is_paused,
            }
        self._scene.show("player", player)
        estimate, before = self._estimate_at(at_ns / SECOND_NS), self._estimate
        self._estimate = estimate
        if estimate is None:
            self._scene.show("identification", None)
        elif estimate is not before:
            self._scene.show_live(estimate, at_ns / SECOND_NS)

    def _play(self, _value: Any) -> str:
        with self._turn:
            if self._pace.position_ns(self._clock_ns()) >= self.duration_ns:
                self._enter(0)
            self._pace.resume(self._clock_ns())
            self._turn.notify_all()
        return "playing"

    def _pause(self, _value: Any) -> str:
        with self._turn:
            self._pace.pause(self._clock_ns())
            self._turn.notify_all()
        return "paused"

    def _seek(self, value: Any) -> str:
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0.0 <= value < float("inf"):
            raise OrderRefusedError(f"seek {value!r}: expected seconds from the bag's beginning")
        with self._turn:
            self._enter(min(round(value * SECOND_NS), self.duration_ns))
            self._turn.notify_all()
        return f"at {value:g} s"

    def _enter(self, position_ns: int) -> None:
        self._entered_ns = position_ns
        self._pace.begin(self._clock_ns(), position_ns)

    # --- the thread

    def _run(self) -> None:
        while (position_ns := self._next_place()) is not None:
            self._scene.begin_anew()
            try:
                self._play_from(position_ns)
            except BagError as err:
                self._scene.note("error", str(err), position_ns / SECOND_NS)

    def _next_place(self) -> int | None:
        """Wait until a place is entered and return it; None: it is over."""
        with self._turn:
            self._turn.wait_for(lambda: self._is_ending or self._entered_ns is not None)
            position_ns, self._entered_ns = self._entered_ns, None
            return None if self._is_ending else position_ns

    def _play_from(self, position_ns: int) -> None:
        for topic, due_ns, data in self._messages(max(0, position_ns - self._lead_ns)):
            if due_ns > position_ns and not self._is_due(due_ns):
                return
            self._scene.take(topic, data, due_ns / SECOND_NS, due_ns / SECOND_NS)
        if self._is_due(self.duration_ns):
            self._pause(None)

    def _messages(self, from_ns: int) -> Iterator[tuple[str, int, bytes]]:
        with Bag(self._path, namespace=self._namespace, start_s=from_ns / SECOND_NS) as bag:
            for message in bag.raw_messages(*self._topics.values()):
                yield self._topics[message.topic], message.receive_ns - self._start_ns, message.data

    def _is_due(self, due_ns: int) -> bool:
        """Wait until a time in the bag; False where another place was entered, or the player ends."""
        with self._turn:
            while not self._is_ending and self._entered_ns is None:
                wait_ns = self._pace.wait_ns(due_ns, self._clock_ns())
                if wait_ns is not None and wait_ns <= 0:
                    return True
                self._turn.wait(None if wait_ns is None else wait_ns / SECOND_NS)
            return False
