"""The test's own node on the graph: publishes, listens, calls services, with time limits throughout."""

from __future__ import annotations

import time
from collections.abc import Callable
from types import TracebackType
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from beam_ros.hub.contract import ASK_AGAIN
from beam_ros.interfaces import graph
from beam_ros.interfaces.graph import QualityOfService
from beam_ros.messages import RosTypes
from beam_ros.shell.freeze_watch import WAKING_NS
from beam_ros.shell.node import qos_profile

HANG_S = 60.0
"""Nothing that works takes so long on the busiest computer [s]: a limit that ends what hangs, and no assertion."""


class Graph:
    """A node of the test's, spun only inside its methods."""

    def __init__(self, name: str = "test") -> None:
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self.node = Node(name)
        self.types = RosTypes()
        self._clients: dict[str, Any] = {}

    def publisher(self, topic: str, qos: QualityOfService | None = None, namespace: str = "") -> Any:
        """Make the publisher of a topic of the table."""
        row = graph.TOPICS[topic]
        message_class = self.types.message_class(row.type_name)
        name = topic if topic.startswith("/") else f"{namespace}/{topic}"
        return self.node.create_publisher(message_class, name, qos_profile(qos or row.qos))

    def listen(
        self, topic: str, callback: Callable[..., None], *, namespace: str = "", raw: bool = False
    ) -> None:
        """Subscribe to a topic of the table."""
        row = graph.TOPICS[topic]
        message_class = self.types.message_class(row.type_name)
        name = topic if topic.startswith("/") else f"{namespace}/{topic}"
        self.node.create_subscription(message_class, name, callback, qos_profile(row.qos), raw=raw)

    def spin(self, seconds: float) -> None:
        """Let callbacks run for a while."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            rclpy.spin_once(self.node, timeout_sec=0.02)

    def wait(self, condition: Callable[[], bool], what: str, timeout_s: float = HANG_S) -> None:
        """Spin until a condition holds; fail after the time limit."""
        end = time.monotonic() + timeout_s
        while not condition():
            assert time.monotonic() < end, f"{what} did not happen within {timeout_s:g} s"
            rclpy.spin_once(self.node, timeout_sec=0.02)

    def request(self, service: str, namespace: str = "", *, data: bool | None = None) -> Any:
        """Ask a Trigger of the table, or a SetBool with its data; returns the future of its answer.

        Clients are kept: a process that is stopped could not get to know another one.
        """
        name = f"{namespace}/{service}" if namespace else service
        service_class = self.types.service_class(graph.SERVICES[service].type_name)
        if name not in self._clients:
            self._clients[name] = self.node.create_client(service_class, name)
        client = self._clients[name]
        self.wait(client.service_is_ready, f"service {service}")
        return client.call_async(service_class.Request(**({} if data is None else {"data": data})))

    def call(self, service: str, namespace: str = "", *, data: bool | None = None) -> Any:
        """Ask and return the answer; where a hub that was frozen says so, ask again, as any client does."""
        end = time.monotonic() + HANG_S
        while True:
            future = self.request(service, namespace, data=data)
            self.wait(future.done, f"an answer of {service}")
            answer = future.result()
            if not answer.message.endswith(ASK_AGAIN) or time.monotonic() > end:
                return answer
            self.spin(WAKING_NS * 1e-9)

    def ask(self, service: str, namespace: str = "", *, data: bool | None = None) -> None:
        """Ask for what must succeed."""
        answer = self.call(service, namespace, data=data)
        assert answer.success, answer.message

    def switch_on(self, namespace: str = "") -> None:
        """Home the axis and enable it."""
        self.ask("hub/home", namespace)
        self.ask("hub/enable", namespace, data=True)

    def __enter__(self) -> Graph:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.node.destroy_node()
        rclpy.try_shutdown()
