"""The node ``excitation``: samples the rig's excitation, checks it, and hands it to the hub whole."""

from __future__ import annotations

import time
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.task import Future

from beam_ros import messages
from beam_ros.bags.batches import encode_chunk
from beam_ros.errors import faults_of_the_user
from beam_ros.excitation.plan import ExcitationPlan, plan_excitation
from beam_ros.hub.gate.sequence_assembly import MAX_CHUNK_POINTS
from beam_ros.messages import MessageContentError
from beam_ros.shell.node import RigNode, run_node

_CHUNKS_PER_TICK = 4
_TICK_S = 0.02
_MARGIN_S = 1.0
"""Between the last chunk and the start, for the hub to check the whole."""
_ANSWER_S = 10.0
"""Patience with a hub that does not answer."""


class ExcitationGenerator(RigNode):
    """Hands over one sequence at a time and follows what becomes of it."""

    def __init__(self) -> None:
        super().__init__("excitation_generator")
        self._sequence = self.offer("hub/sequence")
        self._info = self.offer("excitation/info")
        self._state: dict[str, Any] = {}
        self._started = 0
        self._current = ""
        self._outgoing: list[bytes] = []
        self.listen("hub/sequence_state", self._on_sequence_state)
        self._verdict: tuple[Future, float] | None = None
        # Both answer when the hub has; in a group of their own they keep nothing else waiting.
        group = ReentrantCallbackGroup()
        self.serve("excitation/start", self._on_start, callback_group=group)
        self.serve("excitation/stop", self._on_stop, callback_group=group)
        self._hub_stop = self.call_of("hub/stop", callback_group=group)
        self.create_timer(_TICK_S, self._send)
        self._plan = plan_excitation(self.rig)
        self._publish_info(self._plan, {})

    def _publish_info(self, plan: ExcitationPlan, more: dict[str, Any]) -> None:
        self._info.publish(messages.json_text(self.types, {**plan.info(self.rig), **more}))

    def _on_sequence_state(self, message: Any) -> None:
        try:
            self._state = messages.read_json(message)
        except MessageContentError as err:
            self.get_logger().warning(str(err), throttle_duration_sec=5.0)
            return
        if self._state.get("id") != self._current:
            return
        if self._state.get("state") == "refused":
            self._outgoing.clear()
            self._answer(False, f"the hub refused {self._current}: {self._state.get('reason')}")
        elif self._state.get("state") in ("ready", "running", "done"):
            self._answer(True, f"{self._current} starts")

    def _answer(self, success: bool, message: str) -> None:
        if self._verdict is not None:
            future, _ = self._verdict
            self._verdict = None
            future.set_result((success, message))

    @property
    def _is_busy(self) -> bool:
        ours = self._state.get("id") == self._current
        return (
            self._verdict is not None
            or bool(self._outgoing)
            or (ours and self._state.get("state") in ("loading", "ready", "running"))
        )

    async def _on_start(self, _request: Any, response: Any) -> Any:
        if self._is_busy:
            response.success, response.message = False, f"sequence {self._current} is under way"
            return response
        if self._sequence.get_subscription_count() == 0:
            response.success = False
            response.message = "nobody listens on hub/sequence: start the simulator or the hub driver first"
            return response
        try:
            plan = plan_excitation(self.rig)
        except faults_of_the_user() as err:
            response.success, response.message = False, str(err)
            return response
        self._started += 1
        self._current = f"{self.rig.excitation.kind}-{time.time_ns() // 1_000_000}-{self._started}"
        period_ns = round(plan.sampled.period_s * 1e9)
        handing_over_s = len(plan.values) / MAX_CHUNK_POINTS / _CHUNKS_PER_TICK * _TICK_S + _MARGIN_S
        delay_s = max(self.rig.excitation.start_delay, handing_over_s)
        start_ns = self.now_ns() + round(delay_s * 1e9)
        chunks = messages.split_sequence(self._current, start_ns, period_ns, plan.values)
        self._outgoing = [encode_chunk(chunk, plan.mode) for chunk in chunks]
        self._publish_info(plan, {"sequence_id": self._current, "start_ns": start_ns})
        future = Future()
        self._verdict = (future, time.monotonic() + delay_s + _ANSWER_S)
        response.success, response.message = await future
        return response

    def _send(self) -> None:
        for chunk in self._outgoing[:_CHUNKS_PER_TICK]:
            self._sequence.publish(chunk)
        del self._outgoing[:_CHUNKS_PER_TICK]
        if self._verdict is not None and time.monotonic() > self._verdict[1]:
            self._answer(False, f"the hub said nothing of {self._current}: is a hub on this graph?")

    async def _on_stop(self, _request: Any, response: Any) -> Any:
        self._outgoing.clear()
        if not self._hub_stop.service_is_ready():
            response.success, response.message = False, "hub/stop is not there: use the switch on the axis"
            return response
        stopped = await self._hub_stop.call_async(self._hub_stop.srv_type.Request())
        response.success, response.message = stopped.success, f"hub/stop: {stopped.message}"
        return response

    def health(self) -> tuple[str, str, dict[str, object]]:
        """Report which sequence was handed over last and what became of it."""
        state = f"{self._current}: {self._state.get('state', 'handed over')}" if self._current else "ready"
        return "OK", state, {"sequences": self._started}


def main(argv: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(ExcitationGenerator, argv)
