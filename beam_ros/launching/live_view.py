"""The page's ears on the rig's graph, and the one thing that it may ask of the rig: stop.

Everything is heard with a shallow queue. What streams is asked for without repetition, so that no publisher waits for
the page or keeps anything for it; a recorder beside it hears nothing less. The camera's frames are large: they are
asked for only while somebody looks. The node has a thread, a context and an executor of its own.
"""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Collection
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription

from beam_ros.interfaces import graph
from beam_ros.messages import RosTypes
from beam_ros.process.interruption import signals_taken
from beam_ros.shell.node import qos_profile
from beam_ros.shell.other_hubs import reach
from beam_ros.view.scene import SHOWN_TOPICS, Scene
from beam_ros.view.server import OrderRefusedError

LIGHT_TOPICS = tuple(name for name in SHOWN_TOPICS if not graph.TOPICS[name].is_image)
"""All but the camera's frames."""

_IMAGES = tuple(name for name in SHOWN_TOPICS if graph.TOPICS[name].is_image)
"""The camera's frames, the likeliest first: the simulated ones are compressed only while somebody listens."""


class LiveView:
    """Feeds a scene with what the rig says.

    Parameters
    ----------
    scene : Scene -- of source "rig"
    namespace : str -- of the rig
    topics : collection of str -- what is listened to at all times
    """

    def __init__(self, scene: Scene, *, namespace: str = "", topics: Collection[str] = LIGHT_TOPICS) -> None:
        self._scene, self._types = scene, RosTypes()
        self._context = Context()
        rclpy.init(args=[], context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self._node = Node("page", namespace=namespace, context=self._context)
        self._stop = self._node.create_client(
            self._types.service_class(graph.SERVICES["hub/stop"].type_name), "hub/stop"
        )
        for topic in topics:
            self._listen(topic)
        self._images: Subscription | None = None
        self.wants_images: Callable[[], bool] = lambda: False
        self._node.create_timer(0.5, self._follow_images)
        self._thread = threading.Thread(target=self._spin, name="ears", daemon=True)
        self._thread.start()

    def _listen(self, topic: str) -> Subscription:
        row = graph.TOPICS[topic]
        # What streams may wait for a second of a busy computer, on this side alone; of all else the newest counts.
        depth = 1 if row.is_image or row.qos.is_latched else min(row.qos.depth, 100)
        qos = graph.QualityOfService(depth, is_reliable=row.qos.is_latched, is_latched=row.qos.is_latched)
        return self._node.create_subscription(
            self._types.message_class(row.type_name),
            topic,
            lambda data: self._scene.take(topic, data, time.monotonic(), time.time()),
            qos_profile(qos),
            raw=True,
        )

    def _follow_images(self) -> None:
        """Listen to the camera while somebody looks at the page."""
        is_wanted = self.wants_images()
        if self._images is not None and not is_wanted:
            self._node.destroy_subscription(self._images)
            self._images = None
        elif self._images is None and is_wanted:
            offered = (topic for topic in _IMAGES if self._node.count_publishers(topic))
            topic = next(offered, None)
            self._images = self._listen(topic) if topic else None

    def _spin(self) -> None:
        executor = SingleThreadedExecutor(context=self._context)
        executor.add_node(self._node)
        try:
            while self._context.ok():
                executor.spin_once(timeout_sec=0.5)
        except ExternalShutdownException:
            pass
        finally:
            executor.shutdown(timeout_sec=0.0)

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
        answered = threading.Event()
        future = self._stop.call_async(self._stop.srv_type.Request())
        future.add_done_callback(lambda _: answered.set())
        if not answered.wait(patience_s):
            raise OrderRefusedError(f"hub/stop did not answer within {patience_s:g} s; {remedy}")
        response = future.result()
        if not response.success:
            raise OrderRefusedError(f"hub/stop was refused: {response.message}; {remedy}")
        return str(response.message)

    def close(self) -> None:
        """Leave the graph."""
        with signals_taken(signal.SIG_IGN):
            rclpy.try_shutdown(context=self._context)
            self._thread.join()
            self._node.destroy_node()

    def __enter__(self) -> LiveView:
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()
