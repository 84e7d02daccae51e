"""The node ``live_identifier``: what the rig's samples tell so far, twice a second.

It hands the bytes that it hears to a process of its own, which estimates, and publishes what that says.
"""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial
from typing import Any

from beam_ros.interfaces import graph
from beam_ros.offline.estimate_process import EstimateProcess, Heard
from beam_ros.shell.matched_subscription import MatchedSubscription
from beam_ros.shell.node import RigNode, run_node

_LEVELS = {"failed": "ERROR"}


class LiveIdentifier(RigNode):
    """Publishes the estimate that grows."""

    def __init__(self, **options: Any) -> None:
        super().__init__("live_identifier", **options)
        self._heard: list[Heard] = []
        self._estimate = EstimateProcess(self.rig.live)
        self._live = self.offer("identification/live")
        self._newest = self._published = self._estimate.newest()
        self._listening = [
            MatchedSubscription(
                self,
                graph.TOPICS[topic],
                partial(self._hear, topic),
                depth=1000,
                raw=True,
                is_early=True,
                wakes=False,
            )
            for topic in self.row.subscribes
        ]
        self.create_timer(0.1, self._hand_over)
        self.create_timer(0.5, self._publish)
        self._say()

    def _hear(self, topic: str, data: bytes, info: dict[str, int | None]) -> None:
        self._heard.append((topic, bytes(data), info["received_timestamp"] or time.time_ns()))

    def _hand_over(self) -> None:
        for subscription in self._listening:
            subscription.take()
        if self._heard:
            heard, self._heard = self._heard, []
            self._estimate.hear(heard)

    def _publish(self) -> None:
        for subscription in self._listening:
            subscription.follow()
        self._newest = self._estimate.newest()
        if self._newest != self._published:
            if self._newest.state != self._published.state:
                self.get_logger().info(f"{self._newest.state}: {self._newest.sentence}")
            self._say()

    def _say(self) -> None:
        self._published = self._newest
        self._live.publish(self.types.make(graph.STRING, data=self._newest.to_json()))

    def health(self) -> tuple[str, str, dict[str, object]]:
        """Report what is known, and what that costs."""
        newest = self._newest
        counters: dict[str, object] = {
            "record [s]": f"{newest.record_s:.1f}",
            "modes": len(newest.modes),
            "share of a core": f"{newest.cost.share_of_core:.2f}",
        }
        return _LEVELS.get(newest.state, "OK"), newest.sentence, counters

    def close(self) -> None:
        """End the process of the estimate, and say that nothing more comes."""
        self._estimate.close()
        newest = self._newest
        last = replace(
            newest,
            state=newest.state if newest.state in ("waiting", "failed") else "ended",
            sentence=f"The node has ended. Before: {newest.sentence}",
        )
        self.say_last(self._live, self.types.make(graph.STRING, data=last.to_json()))


def main(argv: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(LiveIdentifier, argv)
