"""The node ``player``: a bag back onto its topics, as the bytes that were recorded and in their old rhythm.

Header stamps stay what they were. The replay can be paused and stepped, begin later and over again, and make the time
of the graph. What moves an axis is left out unless it is asked for, and nothing is
played while a live hub is on the graph, so that a replay never meets a real axis.
"""

from __future__ import annotations

import os
import threading
import time
from typing import Any

from builtin_interfaces.msg import Time
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.executors import ExternalShutdownException
from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock as ClockMessage

from beam_ros.bags.live.replay import Pace, ReplayTopic, due_messages, replay_topics
from beam_ros.bags.reading import Bag
from beam_ros.errors import RigUnavailableError, RosMissingError, UsageError
from beam_ros.messages import SECOND_NS
from beam_ros.shell.large_messages import widen_shared_memory
from beam_ros.shell.node import RigNode, qos_profile, run_node

_DISCOVERY_S = 3.5
"""Time for the graph and the player to find each other before the first message [s].

It takes 0.2 s, but a participant whose first announcements were lost repeats them only after 3 s.
"""

_CLOCK_S = 0.01
_HUB_NODE = "hub"
_HUB_TOPIC = "hub/measured"


class BagPlayer(RigNode):
    """Plays one bag and ends."""

    def __init__(self, **options: Any) -> None:
        super().__init__("bag_player", **options)
        path = self.rig.player.bag
        if not path:
            raise UsageError("player.bag is empty: expected a bag's folder; give it with -p player.bag:=PATH")
        settings = self.rig.player
        self._bag = Bag(path, start_s=settings.start or None)
        self._rate, self._loops = settings.rate, settings.loop
        self._pace = Pace(settings.rate, is_paused=settings.paused)
        self._time_of_bag = self.offer("/clock") if settings.clock else None
        self._told = threading.Event()
        self._lock = threading.Lock()
        self._topics = replay_topics(self._bag, with_commands=self.rig.player.commands)
        self._stopping = threading.Event()
        self._published = 0
        self._fault: Exception | None = None
        self._outputs: dict[str, Publisher] | None = None
        self._thread = threading.Thread(target=self._play, name="replay", daemon=True)
        self._discovered_at = time.monotonic() + _DISCOVERY_S
        self.serve("player/pause", self._on_pause)
        self.serve("player/step", self._on_step)
        # On the steady clock: a player that makes the time must not wait for it.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(0.1, self._watch, clock=steady)
        if self._time_of_bag is not None:
            self.create_timer(_CLOCK_S, self._publish_clock, clock=steady)

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
            self.get_logger().info(
                f"played {self._published} messages, {self._pace.late_ns * 1e-6:.2f} ms late in the mean (rms), "
                f"{self._pace.max_late_ns * 1e-6:.1f} ms at most"
            )
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
        try:
            while True:
                with self._lock:
                    self._pace.begin(time.monotonic_ns())
                for message in due_messages(self._bag, topics):
                    if not self._wait(message.due_ns):
                        return
                    outputs[message.name_in_bag].publish(message.data)
                    self._published += 1
                if not self._loops or not self._published:
                    break
            for output in outputs.values():
                output.wait_for_all_acked(Duration(seconds=1))
        except Exception as err:  # noqa: BLE001 - handed to the executor's thread, which ends the node with it
            self._fault = err

    def _wait(self, due_ns: int) -> bool:
        """Wait until what is due is to go; return False where the node ends instead."""
        while not self._stopping.is_set():
            self._told.clear()
            with self._lock:
                wait_ns = self._pace.wait_ns(due_ns, time.monotonic_ns())
                if wait_ns is not None and wait_ns <= 0:
                    self._pace.sent(wait_ns)
                    return True
            self._told.wait(None if wait_ns is None else wait_ns * 1e-9)
        return False

    def _on_pause(self, request: Any, response: Any) -> Any:
        with self._lock:
            now_ns = time.monotonic_ns()
            if request.data:
                self._pace.pause(now_ns)
            else:
                self._pace.resume(now_ns)
            position_s = self._pace.position_ns(now_ns) * 1e-9
        self._told.set()
        response.success = True
        response.message = f"{'paused at' if request.data else 'goes on from'} {position_s:.3f} s"
        return response

    def _on_step(self, _request: Any, response: Any) -> Any:
        with self._lock:
            response.success = self._pace.step()
        self._told.set()
        response.message = (
            "the next message goes" if response.success else "nothing stands still; call player/pause first"
        )
        return response

    def _publish_clock(self) -> None:
        if self._time_of_bag is None or self._thread.ident is None:
            return
        with self._lock:
            played_ns = max(0, self._pace.position_ns(time.monotonic_ns()))
        now_ns = self._bag.begins_ns + min(
            played_ns, self._bag.start_ns + self._bag.duration_ns - self._bag.begins_ns
        )
        seconds, nanoseconds = divmod(now_ns, SECOND_NS)
        self._time_of_bag.publish(ClockMessage(clock=Time(sec=seconds, nanosec=nanoseconds)))

    def health(self) -> tuple[str, str, dict[str, object]]:
        """Report how far the replay has come, and how late it is."""
        counters: dict[str, object] = {
            "messages": self._published,
            "latest by [ms]": round(self._pace.max_late_ns * 1e-6, 1),
            "late in the root mean square [ms]": round(self._pace.late_ns * 1e-6, 3),
        }
        return (
            "OK",
            f"{'standing still in' if self._pace.is_paused else 'playing'} {self._bag.path}",
            counters,
        )

    def close(self) -> None:
        """End the replay and close the bag."""
        self._stopping.set()
        self._told.set()
        if self._thread.ident is not None:
            self._thread.join()
        self._bag.close()


def main(argv: list[str] | None = None) -> int:
    """Run the node."""
    widen_shared_memory(os.environ)
    return run_node(BagPlayer, argv)
