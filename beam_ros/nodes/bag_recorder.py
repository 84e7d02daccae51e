"""The node ``recorder``: every topic of the rig into one bag, as the bytes that were on the wire.

Subscriptions are raw, so that nothing is decoded, and take the quality of service that the publishers offer.
They exist only while a recording runs.
"""

from __future__ import annotations

import contextlib
import sys
import time
from pathlib import Path
from typing import Any

from beam_ros import messages
from beam_ros.bags.errors import BagError
from beam_ros.bags.live.recording import LossCounter, Recording
from beam_ros.bags.writing import FileLimits
from beam_ros.interfaces import graph
from beam_ros.rig.provenance import provenance
from beam_ros.shell.matched_subscription import MatchedSubscription
from beam_ros.shell.node import FAULT_OF_THE_USER, RigNode, run_node

_DEPTH = 1000
_PATIENCE_S = 2.0
"""So long after its start a recording waits for what it needs before it says what is missing [s]."""


class TopicTap:
    """One topic's way from the graph into the recording.

    Parameters
    ----------
    node : RigNode -- owns the subscription
    topic : graph.Topic -- row of the table
    recording : Recording -- takes the messages

    Attributes
    ----------
    name : str -- the topic's full name
    received : int -- messages so far
    is_needed : bool -- no identification without it
    losses : LossCounter
    """

    def __init__(self, node: RigNode, topic: graph.Topic, recording: Recording) -> None:
        self.losses = LossCounter()
        self._topic = topic
        self._recording = recording
        self.received = 0
        self.is_needed = topic.is_needed
        self.name: str = node.resolve_topic_name(topic.name)
        self._subscription = MatchedSubscription(
            node, topic, self._take, depth=_DEPTH, raw=True, is_early=True
        )
        self.follow_publishers()

    def follow_publishers(self) -> None:
        """Ask for the most that all publishers offer; subscribe anew where that is not what was asked for."""
        self._subscription.follow()

    def _take(self, data: bytes, info: dict[str, int | None]) -> None:
        if not self.received:
            offered = self._subscription.offers() or (self._topic.qos,)
            self._recording.announce(self.name, self._topic.type_name, offered)
        self.received += 1
        if self._subscription.publishers == 1:
            self.losses.see(info["publication_sequence_number"])
        else:
            self.losses.forget()
        now_ns = time.time_ns()
        received_ns, sent_ns = info["received_timestamp"] or now_ns, info["source_timestamp"] or now_ns
        self._recording.put(self.name, received_ns, sent_ns, data)

    def close(self) -> None:
        """Give the subscription up."""
        self._subscription.close()


class BagRecorder(RigNode):
    """Records the rig on request, or from its start."""

    def __init__(self, **options: Any) -> None:
        super().__init__("bag_recorder", **options)
        self._recording: Recording | None = None
        self._taps: list[TopicTap] = []
        self._begun_at = 0.0
        self._has_complained = False
        self._last: dict[str, Any] = {
            "recording": False,
            "path": "",
            "messages": 0,
            "lost": 0,
            "failure": "",
            "topics": {},
        }
        self._state = self.offer("recorder/state")
        self.serve("recorder/start", self._on_start)
        self.serve("recorder/stop", self._on_stop)
        self.create_timer(0.5, self._watch)
        if self.rig.recorder.start_at_launch:
            self._start()
        self._publish_state()

    def _start(self) -> None:
        path = Path(self.rig.recorder.path or Path("runs") / time.strftime("%Y-%m-%d_%H-%M-%S"))
        settings = self.rig.recorder
        self._recording = Recording(
            path,
            provenance=provenance(self.rig, settings.operator),
            limits=FileLimits(settings.max_size * 1_000_000, round(settings.max_duration * 1e9)),
            min_free=settings.min_free * 1_000_000,
        )
        self._begun_at, self._has_complained = time.monotonic(), False
        with_images = self.rig.recorder.images
        topics = [t for t in graph.TOPICS.values() if (with_images or not t.is_image) and not t.is_derived]
        self._taps = [TopicTap(self, topic, self._recording) for topic in topics]
        self.get_logger().info(f"recording to {path}")

    def _stop(self) -> None:
        recording = self._recording
        assert recording is not None
        for tap in self._taps:
            tap.close()
        try:
            recording.stop()
        finally:
            self._last = {**self._describe(), "recording": False}
            self._recording, self._taps = None, []

    def _describe(self) -> dict[str, Any]:
        recording = self._recording
        if recording is None:
            return self._last
        return {
            "recording": True,
            "path": str(recording.path.resolve()),
            "messages": recording.message_count,
            "lost": recording.dropped + sum(tap.losses.lost for tap in self._taps),
            "failure": recording.failure,
            "topics": {tap.name: tap.received for tap in self._taps if tap.received},
        }

    def _publish_state(self) -> None:
        self._state.publish(messages.json_text(self.types, self._describe()))

    def _watch(self) -> None:
        if self._recording is not None:
            for tap in self._taps:
                tap.follow_publishers()
            missing = self._missing()
            if missing and not self._has_complained:
                self._has_complained = True
                self.get_logger().warning(missing)
            if self._recording.failure:
                self.get_logger().error(self._recording.failure)
                with contextlib.suppress(BagError):
                    self._stop()
            self._publish_state()

    def _missing(self) -> str:
        """Say which topics that are needed have not been heard, once there was time for them."""
        if self._recording is None or time.monotonic() < self._begun_at + _PATIENCE_S:
            return ""
        names = [tap.name for tap in self._taps if tap.is_needed and not tap.received]
        if not names:
            return ""
        return (
            f"nothing on {', '.join(names)} after {_PATIENCE_S:g} s: expected the nodes that publish there; start "
            "them, or nothing can be identified from this bag"
        )

    def _on_start(self, _request: Any, response: Any) -> Any:
        if self._recording is not None:
            response.success = False
            response.message = f"already recording to {self._recording.path}; call recorder/stop first"
            return response
        try:
            self._start()
        except BagError as err:
            response.success, response.message = False, str(err)
        else:
            response.success, response.message = True, f"recording to {self._describe()['path']}"
        self._publish_state()
        return response

    def _on_stop(self, _request: Any, response: Any) -> Any:
        if self._recording is None:
            response.success, response.message = False, "no recording is running; call recorder/start first"
            return response
        try:
            self._stop()
        except BagError as err:
            self.get_logger().error(str(err))
            response.success, response.message = False, str(err)
        else:
            self.get_logger().info(f"wrote {self._last['messages']} messages to {self._last['path']}")
            lost = f", {self._last['lost']} lost" if self._last["lost"] else ""
            response.success = True
            response.message = f"{self._last['messages']} messages{lost} in {self._last['path']}"
        self._publish_state()
        return response

    def health(self) -> tuple[str, str, dict[str, object]]:
        """Report what is recorded, and as an error what could not be."""
        state = self._describe()
        counters: dict[str, object] = {"messages": state["messages"], "lost": state["lost"]}
        if state["failure"]:
            return "ERROR", str(state["failure"]), counters
        missing = self._missing()
        if missing:
            return "WARN", missing, counters
        sentence = f"recording to {state['path']}" if state["recording"] else "not recording"
        return ("WARN" if state["lost"] else "OK"), sentence, counters

    def close(self) -> None:
        """Finish the bag that is being written; a failure stays in ``failure``."""
        if self._recording is not None:
            with contextlib.suppress(BagError):
                self._stop()
            self.say_last(self._state, messages.json_text(self.types, self._describe()))

    @property
    def failure(self) -> str:
        """Why the last recording could not be written to its end; empty where it was."""
        return str(self._last["failure"])


def main(argv: list[str] | None = None) -> int:
    """Run the node; the exit status is 2 also where the disk did not take the recording."""
    nodes: list[BagRecorder] = []

    def build() -> BagRecorder:
        nodes.append(BagRecorder())
        return nodes[0]

    status = run_node(build, argv)
    if nodes and nodes[0].failure:
        print(f"beam_ros node: {nodes[0].failure}", file=sys.stderr)  # noqa: T201
        return FAULT_OF_THE_USER
    return status
