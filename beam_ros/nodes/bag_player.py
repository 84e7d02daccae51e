"""The node ``player``: a bag back onto its topics, as the bytes that were recorded and in their old rhythm.

Header stamps stay what they were. What moves an axis is left out unless it is asked for, and nothing is
played while a live hub is on the graph, so that a replay never meets a real axis.
"""

from __future__ import annotations

import os
import threading
import time
from typing import Any

from rclpy.duration import Duration
from rclpy.executors import ExternalShutdownException
from rclpy.publisher import Publisher

from beam_ros.bags.live.replay import ReplayTopic, due_messages, replay_topics
from beam_ros.bags.reading import Bag
from beam_ros.errors import RigUnavailableError, RosMissingError, UsageError
from beam_ros.shell.large_messages import widen_shared_memory
from beam_ros.shell.node import RigNode, qos_profile, run_node

_DISCOVERY_S = 3.5
"""Time for the graph and the player to find each other before the first message [s].

It takes 0.2 s, but a participant whose first announcements were lost repeats them only after 3 s.
"""

_HUB_NODE = "hub"
_HUB_TOPIC = "hub/measured"


class BagPlayer(RigNode):
    """Plays one bag and ends."""

    def __init__(self) -> None:
        super().__init__("bag_player")
        path = self.rig.player.bag
        if not path:
            raise UsageError("player.bag is empty: expected a bag's folder; give it with -p player.bag:=PATH")
        self._bag = Bag(path)
        self._rate = self.rig.player.rate
        self._topics = replay_topics(self._bag, with_commands=self.rig.player.commands)
        self._stopping = threading.Event()
        self._published = 0
        self._late_ns = 0
        self._fault: Exception | None = None
        self._outputs: dict[str, Publisher] | None = None
        self._thread = threading.Thread(target=self._play, name="replay", daemon=True)
        self._discovered_at = time.monotonic() + _DISCOVERY_S
        self.create_timer(0.1, self._watch)

    def _watch(self) -> None:
        """Start when the graph is known; end with the replay, its fault, or a hub that comes to life."""
        hub = self._live_hub()
        if hub:
            raise RigUnavailableError(
                f"{hub} is on this graph: expected no live hub while a bag is played; end it, or play on "
                "another ROS_DOMAIN_ID"
            )
        if self._fault is not None:
            raise self._fault
        now = time.monotonic()
        if self._outputs is None:
            # A second for whoever was there to be found, the rest for those who listen to find the player.
            if now >= self._discovered_at - _DISCOVERY_S + 1.0:
                self._outputs = self._offer_topics()
        elif self._thread.ident is None:
            if now >= self._discovered_at:
                topics = f"{len(self._outputs)} topics of {self._bag.path}"
                self.get_logger().info(f"playing {topics} at rate {self._rate:g}")
                self._thread.start()
        elif not self._thread.is_alive():
            self.get_logger().info(f"played {self._published} messages")
            raise ExternalShutdownException

    def _live_hub(self) -> str:
        """Say who the live hub is; empty where there is none."""
        if (_HUB_NODE, self.get_namespace()) in self.get_node_names_and_namespaces():
            return f"node `{_HUB_NODE}`"
        for info in self.get_publishers_info_by_topic(self.resolve_topic_name(_HUB_TOPIC)):
            if (info.node_name, info.node_namespace) != (self.get_name(), self.get_namespace()):
                return f"a publisher of {_HUB_TOPIC} (node `{info.node_name}`)"
        return ""

    def _offer_topics(self) -> dict[str, Publisher]:
        publishers = {}
        for topic in self._topics:
            try:
                publishers[topic.name_in_bag] = self._offer_topic(topic)
            except RosMissingError as err:
                self.get_logger().warning(f"{topic.name_in_bag} is left out: {err}")
        return publishers

    def _offer_topic(self, topic: ReplayTopic) -> Publisher:
        message_class: Any = self.types.message_class(topic.type_name)
        return self.create_publisher(message_class, topic.name, qos_profile(topic.qos))

    def _play(self) -> None:
        outputs = self._outputs or {}
        topics = tuple(topic for topic in self._topics if topic.name_in_bag in outputs)
        start_ns = time.monotonic_ns()
        try:
            for message in due_messages(self._bag, topics, self._rate):
                wait_ns = start_ns + message.due_ns - time.monotonic_ns()
                if wait_ns > 0 and self._stopping.wait(wait_ns * 1e-9):
                    return
                outputs[message.name_in_bag].publish(message.data)
                self._published += 1
                self._late_ns = max(self._late_ns, -wait_ns)
            for output in outputs.values():
                output.wait_for_all_acked(Duration(seconds=1))
        except Exception as err:  # noqa: BLE001 - handed to the executor's thread, which ends the node with it
            self._fault = err

    def health(self) -> tuple[str, str, dict[str, object]]:
        """Report how far the replay has come."""
        counters: dict[str, object] = {
            "messages": self._published,
            "latest by [ms]": round(self._late_ns * 1e-6, 1),
        }
        return "OK", f"playing {self._bag.path}", counters

    def close(self) -> None:
        """End the replay and close the bag."""
        self._stopping.set()
        if self._thread.ident is not None:
            self._thread.join()
        self._bag.close()


def main(argv: list[str] | None = None) -> int:
    """Run the node."""
    widen_shared_memory(os.environ)
    return run_node(BagPlayer, argv)
