"""A client of a running rig that calls its services and watches its state, to conduct an experiment."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from beam_ros import messages
from beam_ros.errors import RigUnavailableError
from beam_ros.hub.contract import ASK_AGAIN
from beam_ros.hub.parameters import LinkParameters
from beam_ros.interfaces import graph
from beam_ros.messages import RosTypes
from beam_ros.shell.freeze_watch import WAKING_NS
from beam_ros.shell.node import qos_profile
from beam_ros.shell.other_hubs import count_hubs, reach, two_hubs

_SPIN_S = 0.05
_LOOK_ROUND_S = 3.5
"""Under load two nodes take seconds to find each other [s]."""
MAX_CLOCK_SD_NS = LinkParameters.max_clock_sd_ns
"""Standard deviation of the clock map below which an experiment may start [ns]."""


class RigClient:
    """The experimenter's own node on the rig's graph.

    Ctrl-C stays an exception of Python here, so that the conductor of the experiment can end it in order.

    Attributes
    ----------
    check : callable -- called while waiting; raises when a node has fallen
    displacement : dict -- newest u by marker's name [m]; NaN where it was not seen
    hub_position : float -- newest hub position [m]
    sequence : dict -- newest ``hub/sequence_state``
    has_moved : bool -- a sequence has run, or begun to
    recorded : dict -- messages that the recorder has, by topic
    hub_counters : dict or None -- the hub's newest values on ``/diagnostics``
    hub_trouble : str -- the hub's newest sentence there, where it reports an error
    """

    def __init__(self, check: Callable[[], None] = lambda: None, *, namespace: str = "") -> None:
        """Join the graph; see the attributes for ``check``."""
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self._node = Node("experimenter", namespace=namespace)
        # One for all: rclpy.spin_once puts together anew, for every message, what can be waited for.
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._types = RosTypes()
        self.check = check
        self.displacement: dict[str, float] = {}
        self.hub_position = math.nan
        self.sequence: dict[str, Any] = {}
        self.has_moved = False
        self._on_result: Callable[[dict[str, Any]], None] = lambda result: None
        self.hub_counters: dict[str, object] | None = None
        self.hub_trouble = ""
        self.recorded: dict[str, int] = {}
        self._listen("beam/displacement", self._on_displacement)
        self._listen("hub/state", self._on_hub_state)
        self._listen("hub/sequence_state", self._on_sequence_state)
        self._listen("identification/result", self._on_identification)
        self._listen("/diagnostics", self._on_diagnostics)
        self._listen("recorder/state", self._on_recorder_state)

    def _listen(self, topic: str, callback: Callable[[Any], None]) -> None:
        row = graph.TOPICS[topic]
        self._node.create_subscription(
            self._types.message_class(row.type_name), topic, callback, qos_profile(row.qos)
        )

    def _on_displacement(self, message: Any) -> None:
        self.displacement.update(zip(message.name, message.position, strict=True))

    def _on_hub_state(self, message: Any) -> None:
        self.hub_position = message.position[0]

    def _on_sequence_state(self, message: Any) -> None:
        self.sequence = json.loads(message.data)
        self.has_moved |= self.sequence.get("state") in ("running", "done", "underrun")

    def _on_identification(self, message: Any) -> None:
        self._on_result(json.loads(message.data))

    def _on_recorder_state(self, message: Any) -> None:
        counts = json.loads(message.data).get("topics", {})
        self.recorded = {str(name).lstrip("/"): int(count) for name, count in counts.items()}

    def _on_diagnostics(self, message: Any) -> None:
        for status in messages.read_diagnostics(message):
            if status.hardware_id == "hub":
                self.hub_counters = dict(status.values)
                self.hub_trouble = status.message if status.level == "ERROR" else ""

    def is_hub_heard(self) -> bool:
        """Tell whether the hub has said where it is."""
        return not math.isnan(self.hub_position)

    def is_recording(self) -> bool:
        """Tell whether the recorder has samples of the hub."""
        name = self._node.resolve_topic_name("hub/measured").lstrip("/")
        return self.recorded.get(name, 0) > 0

    def refuse_live_hub(self) -> None:
        """Look round and raise where a hub, or what speaks like one, is on the graph already.

        Raises
        ------
        RigUnavailableError
            Two hubs would both act on every command, or a replay would be taken for the rig.
        """
        self._spin(_LOOK_ROUND_S)
        if count_hubs(self._node):
            raise RigUnavailableError(two_hubs())
        for topic in ("hub/state", "hub/measured"):
            name = self._node.resolve_topic_name(topic)
            for info in self._node.get_publishers_info_by_topic(name):
                raise RigUnavailableError(
                    f"node `{info.node_name}` publishes {name} on this graph ({reach()}), as a replay does: "
                    "what it says would look live; end it, or give this rig another --namespace or ROS_DOMAIN_ID"
                )

    def _spin(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self._executor.spin_once(timeout_sec=_SPIN_S)

    def is_clock_settled(self) -> bool:
        """Whether the device's clock is mapped well enough to start a sequence."""
        if self.hub_counters is None:
            return False
        return int(str(self.hub_counters.get("clock_sd_ns", 0))) < MAX_CLOCK_SD_NS

    def wait(
        self,
        condition: Callable[[], bool],
        timeout_s: float,
        what: str,
        remedy: str,
        on_tick: Callable[[float], None] = lambda elapsed_s: None,
    ) -> None:
        """Spin until a condition holds.

        Parameters
        ----------
        condition : callable -- what is waited for
        timeout_s : float -- patience
        what, remedy : str -- for the error: what did not happen, and what to do
        on_tick : callable -- called with the seconds waited so far, for progress

        Raises
        ------
        RigUnavailableError
            The time is over, or a node has fallen.
        """
        start = time.monotonic()
        while not condition():
            elapsed = time.monotonic() - start
            if elapsed > timeout_s:
                raise RigUnavailableError(f"{what} within {timeout_s:g} s; {remedy}")
            self.check()
            on_tick(elapsed)
            self._executor.spin_once(timeout_sec=_SPIN_S)

    def call(self, service: str, *, value: bool | None = None, timeout_s: float = 15.0) -> str:
        """Call a service of the table and return its message.

        A hub that was frozen refuses what was asked meanwhile, since nobody may want it any more. Who calls here
        still waits for it, and asks again once the hub takes orders.

        Parameters
        ----------
        service : str -- key of ``beam_ros.interfaces.graph.SERVICES``
        value : bool, optional -- for a SetBool service
        timeout_s : float -- patience, discovery included

        Raises
        ------
        RigUnavailableError
            The service is not there, does not answer, or refuses.
        """
        service_class = self._types.service_class(graph.SERVICES[service].type_name)
        client = self._node.create_client(service_class, service)
        log_hint = f"is the rig up (`beam up`) on {reach()}? If so, its nodes' logs say more"
        try:
            self.wait(client.service_is_ready, timeout_s, f"service {service} did not appear", log_hint)
            request = service_class.Request()
            if value is not None:
                request.data = value
            end = time.monotonic() + timeout_s
            while True:
                future = client.call_async(request)
                self.wait(future.done, timeout_s, f"service {service} did not answer", log_hint)
                response = future.result()
                if response.success or not response.message.endswith(ASK_AGAIN) or time.monotonic() > end:
                    break
                self._spin(WAKING_NS * 1e-9)
        finally:
            self._node.destroy_client(client)
        if not response.success:
            raise RigUnavailableError(f"{service} was refused: {response.message}")
        return str(response.message)

    def identify(
        self,
        timeout_s: float,
        on_tick: Callable[[float], None],
        on_begun: Callable[[], None] = lambda: None,
    ) -> dict[str, Any]:
        """Have the identifier work on its bag and return what it publishes.

        Parameters
        ----------
        timeout_s : float -- patience
        on_tick : callable -- called with the seconds waited so far, for progress
        on_begun : callable -- called once the identifier works

        Raises
        ------
        RigUnavailableError
            The identifier is not there, refuses, or publishes nothing in time.
        """
        results: list[dict[str, Any]] = []
        self._on_result = results.append
        self.call("identifier/identify")
        on_begun()
        what, remedy = "the identifier published no result", "look at identifier.log"
        self.wait(lambda: bool(results), timeout_s, what, remedy, on_tick)
        return results[-1]

    def __enter__(self) -> RigClient:
        return self

    def __exit__(self, *raised: object) -> None:
        self._executor.shutdown(timeout_sec=0.0)
        self._node.destroy_node()
        rclpy.try_shutdown()
