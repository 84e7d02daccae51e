"""The page's ears on the rig's graph, and the one thing that it may ask of the rig: stop.

Everything is heard with a shallow queue. What streams is asked for without repetition, so that no publisher waits for
the page or keeps anything for it; a recorder beside it hears nothing less. The camera's frames are large: they are
asked for only while somebody looks.

A thread takes what has come a few times a second. An executor would put together anew, for every single message, all
that it waits for, which costs ten times what the messages do. Only a stop has one, for its answer alone.
"""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Collection
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription

from beam_ros.interfaces import graph
from beam_ros.messages import RosTypes
from beam_ros.process.interruption import signals_taken
from beam_ros.shell.matched_subscription import next_waiting
from beam_ros.shell.node import qos_profile
from beam_ros.shell.other_hubs import reach
from beam_ros.view.scene import SHOWN_TOPICS, Scene
from beam_ros.view.server import OrderRefusedError

LIGHT_TOPICS = tuple(name for name in SHOWN_TOPICS if not graph.TOPICS[name].is_image)
"""All but the camera's frames."""

TEXT_TOPICS = tuple(
    name for name in LIGHT_TOPICS if graph.TOPICS[name].type_name in (graph.STRING, graph.DIAGNOSTICS)
)
"""What says in words what goes on: enough for the log."""

_IMAGES = tuple(name for name in SHOWN_TOPICS if graph.TOPICS[name].is_image)
"""The camera's frames, the likeliest first: the simulated ones are compressed only while somebody listens."""


class LiveView:
    """Feeds a scene with what the rig says.

    Parameters
    ----------
    scene : Scene -- of source "rig"
    namespace : str -- of the rig
    topics : collection of str -- what is listened to at all times
    period_s : float -- how often what has come is taken [s]

    Attributes
    ----------
    wants_images : callable -- returns whether the camera's frames are listened to
    """

    def __init__(
        self,
        scene: Scene,
        *,
        namespace: str = "",
        topics: Collection[str] = LIGHT_TOPICS,
        period_s: float = 0.05,
    ) -> None:
        self._scene, self._types, self._period_s = scene, RosTypes(), period_s
        self._context = Context()
        rclpy.init(args=[], context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self._ears, self._voice = (
            Node(name, namespace=namespace, context=self._context, start_parameter_services=False)
            for name in ("page", "page_stop")
        )
        service = self._types.service_class(graph.SERVICES["hub/stop"].type_name)
        self._stop = self._voice.create_client(service, "hub/stop")
        self._is_asking = threading.Lock()
        self._subscriptions = {topic: self._listen(topic) for topic in topics}
        self.wants_images: Callable[[], bool] = lambda: False
        self._is_ending = threading.Event()
        self._thread = threading.Thread(target=self._hear, name="ears", daemon=True)
        self._thread.start()

    def _listen(self, topic: str) -> Subscription:
        row = graph.TOPICS[topic]
        # What streams may wait for a second of a busy computer, on this side alone; of all else the newest counts.
        depth = 1 if row.is_image or row.qos.is_latched else min(row.qos.depth, 100)
        qos = graph.QualityOfService(depth, is_reliable=row.qos.is_latched, is_latched=row.qos.is_latched)
        message_class = self._types.message_class(row.type_name)
        return self._ears.create_subscription(
            message_class, topic, lambda _: None, qos_profile(qos), raw=True
        )

    def _hear(self) -> None:
        while not self._is_ending.wait(self._period_s):
            self._follow_images()
            for topic, subscription in self._subscriptions.items():
                while (taken := next_waiting(subscription)) is not None:
                    self._scene.take(topic, bytes(taken[0]), time.monotonic(), time.time())

    def _follow_images(self) -> None:
        """Listen to the camera while somebody looks at the page."""
        is_wanted = self.wants_images()
        heard = next((topic for topic in _IMAGES if topic in self._subscriptions), None)
        if heard is not None and not is_wanted:
            self._ears.destroy_subscription(self._subscriptions.pop(heard))
        elif heard is None and is_wanted:
            offered = next((topic for topic in _IMAGES if self._ears.count_publishers(topic)), None)
            if offered is not None:
                self._subscriptions[offered] = self._listen(offered)

    def look(self) -> None:
        """Let the scene notice what has fallen silent."""
        self._scene.look(time.monotonic(), time.time())

    def stop(self, _value: Any = None, *, patience_s: float = 3.0) -> str:
        """Stop the axis and return what the hub answers.

        Raises
        ------
        OrderRefusedError
            The hub is not there, does not answer, or refuses.
        """
        self._scene.note("warning", "stop was asked for", time.time())
        try:
            answer = self._call_stop(patience_s)
        except OrderRefusedError as err:
            self._scene.note("error", str(err), time.time())
            raise
        self._scene.note("info", f"stop: {answer}", time.time())
        return answer

    def _call_stop(self, patience_s: float) -> str:
        remedy = "stop the axis at its own switch, and look whether the hub's node runs"
        if not self._stop.service_is_ready():
            raise OrderRefusedError(f"no hub offers hub/stop on {reach()}; {remedy}")
        future = self._stop.call_async(self._stop.srv_type.Request())
        with self._is_asking:
            executor = SingleThreadedExecutor(context=self._context)
            try:
                executor.add_node(self._voice)
                executor.spin_until_future_complete(future, timeout_sec=patience_s)
            finally:
                executor.shutdown(timeout_sec=0.0)
        if not future.done():
            raise OrderRefusedError(f"hub/stop did not answer within {patience_s:g} s; {remedy}")
        response = future.result()
        if not response.success:
            raise OrderRefusedError(f"hub/stop was refused: {response.message}; {remedy}")
        return str(response.message)

    def close(self) -> None:
        """Leave the graph."""
        with signals_taken(signal.SIG_IGN):
            self._is_ending.set()
            self._thread.join()
            self._ears.destroy_node()
            self._voice.destroy_node()
            rclpy.try_shutdown(context=self._context)

    def __enter__(self) -> LiveView:
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()
