"""The node ``excitation``: samples the rig's excitation, checks it, and hands it to the hub whole."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, field
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.task import Future

from beam_ros import messages
from beam_ros.bags.batches import encode_chunk
from beam_ros.errors import faults_of_the_user
from beam_ros.excitation.handing_over import SILENCE_S, HandingOver
from beam_ros.excitation.plan import ExcitationPlan, plan_excitation
from beam_ros.excitation.start_lead import CHUNKS_PER_TICK, TICK_S, StartLead, first_lead
from beam_ros.messages import MessageContentError
from beam_ros.shell.freeze_watch import FreezeWatch
from beam_ros.shell.node import RigNode, request_sent_ns, run_node


@dataclass
class _StartRequest:
    """Somebody who waits for the start: since when, for which plan, and the answer."""

    sent_ns: int
    answer: Future = field(default_factory=Future)
    plan: ExcitationPlan | None = None
    lead: StartLead | None = None


STOP_LIMIT_S = 5.0
"""A hub answers a stop at rest: after its ramp, and 0.3 s, in all below two seconds [s]."""

FROZEN_NS = 1_000_000_000
"""The design in another thread keeps this process busy for less; no axis stops by its silence [ns]."""


class ExcitationGenerator(RigNode):
    """Hands over one sequence at a time and follows what becomes of it."""

    def __init__(self, **options: Any) -> None:
        super().__init__("excitation_generator", **options)
        self._sequence = self.offer("hub/sequence")
        self._info = self.offer("excitation/info")
        self._started = 0
        self._current: HandingOver | None = None
        self._states = self.listen("hub/sequence_state", self._on_sequence_state)
        self.listen("hub/state", self._on_hub_state, raw=True)
        self._freeze = FreezeWatch(FROZEN_NS)
        self._planned: ExcitationPlan | str | None = None
        self._planning: threading.Thread | None = None
        self._request: _StartRequest | None = None
        self._heard_s: float | None = None
        # Both answer when the hub has; in a group of their own they keep nothing else waiting.
        group = ReentrantCallbackGroup()
        self.serve("excitation/start", self._on_start, callback_group=group)
        self.serve("excitation/stop", self._on_stop, callback_group=group)
        self._hub_stop = self.call_of("hub/stop", callback_group=group)
        self.create_timer(TICK_S, self._tick)
        self._publish_info(plan_excitation(self.rig), {})

    def _publish_info(self, plan: ExcitationPlan, more: dict[str, Any]) -> None:
        self._info.publish(messages.json_text(self.types, {**plan.info(self.rig), **more}))

    def _on_sequence_state(self, message: Any) -> None:
        try:
            report = messages.read_json(message)
        except MessageContentError as err:
            self.get_logger().warning(str(err), throttle_duration_sec=5.0)
            return
        if self._current is not None:
            self._current.note(report)

    def _on_hub_state(self, _data: bytes) -> None:
        self._heard_s = time.monotonic()
        if self._current is not None:
            self._current.hear(self._heard_s)

    async def _on_start(self, _request: Any, response: Any) -> Any:
        refusal = self._start_refusal()
        if refusal:
            response.success, response.message = False, refusal
            return response
        self._request, self._current = _StartRequest(request_sent_ns()), None
        # Half an hour at 1 kHz takes seconds to design, and excitation/stop must be heard meanwhile.
        self._planning = threading.Thread(target=self._plan, name="plan", daemon=True)
        self._planning.start()
        response.success, response.message = await self._request.answer
        return response

    def _start_refusal(self) -> str | None:
        objection = self._freeze.objection(time.monotonic_ns(), request_sent_ns())
        if objection:
            return f"start refused: the excitation's process {objection}"
        if self._planning is not None:
            return "a sequence is being designed"
        if self._current is not None and self._current.is_under_way:
            return f"sequence {self._current.sequence_id} is under way"
        if self._sequence.get_subscription_count() == 0:
            return "nobody listens on hub/sequence: start the simulator or the hub driver first"
        silence_s = 0.0 if self._heard_s is None else time.monotonic() - self._heard_s
        if silence_s > SILENCE_S:
            return f"the hub has been silent for {silence_s:.1f} s: start it, or connect its controller"
        return None

    def _plan(self) -> None:
        try:
            self._planned = plan_excitation(self.rig)
        except faults_of_the_user() as err:
            self._planned = str(err)
        except Exception as err:
            self._planned = f"{type(err).__name__}: {err}"
            raise

    def _hand_over(self, request: _StartRequest, plan: ExcitationPlan) -> None:
        self._started += 1
        name = f"{self.rig.excitation.kind}-{time.time_ns() // 1_000_000}-{self._started}"
        n_ticks, period_ns = len(plan.values), round(plan.sampled.period_s * 1e9)
        if request.lead is None:
            first_s = first_lead(n_ticks, self.rig.excitation.start_delay)
            request.plan, request.lead = plan, StartLead(first_s, time.monotonic())
        start_ns = self.now_ns() + round(request.lead.lead_s * 1e9)
        chunks = messages.split_sequence(name, start_ns, period_ns, plan.values)
        self._current = HandingOver(
            name,
            (encode_chunk(chunk, plan.mode) for chunk in chunks),
            start_ns,
            start_ns + n_ticks * period_ns,
            now_s=time.monotonic(),
            n_hubs=self._states.get_publisher_count(),
        )
        self._publish_info(plan, {"sequence_id": name, "start_ns": start_ns})

    def _tick(self) -> None:
        self._freeze.beat(time.monotonic_ns())
        planned, self._planned = self._planned, None
        if planned is not None:
            self._planning = None
        if isinstance(planned, str):
            self._answer((False, planned))
        elif planned is not None and self._request is not None:
            self._hand_over(self._request, planned)
        current = self._current
        if current is None:
            return
        for chunk in current.take_chunks(CHUNKS_PER_TICK):
            self._sequence.publish(chunk)
        if current.check(time.monotonic(), self.now_ns(), self._states.get_publisher_count()):
            self.get_logger().error(f"{current.sequence_id} is lost: {current.reason}")
        if not self._hand_over_later(current):
            self._answer(current.verdict)

    def _hand_over_later(self, refused: HandingOver) -> bool:
        """Hand a sequence over anew that was refused for its time alone, while somebody waits for its start."""
        request = self._request
        if not refused.is_late or request is None or request.lead is None or request.plan is None:
            return False
        now_ns, lead = time.monotonic_ns(), request.lead
        if self._freeze.objection(now_ns, request.sent_ns) or not lead.lengthen(now_ns * 1e-9):
            return False
        self.get_logger().warning(
            f"{refused.sequence_id} was refused: {refused.reason}. Nothing moved; it is handed over anew, "
            f"{lead.lead_s:.3g} s ahead of its start"
        )
        self._hand_over(request, request.plan)
        return True

    def _answer(self, verdict: tuple[bool, str] | None) -> None:
        if self._request is not None and verdict is not None:
            request, self._request = self._request, None
            success, sentence = verdict
            history = "" if request.lead is None else request.lead.history()
            request.answer.set_result((success, f"{sentence} ({history})" if history else sentence))

    async def _on_stop(self, _request: Any, response: Any) -> Any:
        if self._current is not None and self._request is not None:
            self._current.give_up("excitation/stop was asked for")
        self._answer((False, "excitation/stop was asked for"))
        if not self._hub_stop.service_is_ready():
            response.success, response.message = False, "hub/stop is not there: use the switch on the axis"
            return response
        answer = self._hub_stop.call_async(self._hub_stop.srv_type.Request())
        limit = self.create_timer(STOP_LIMIT_S, answer.cancel)
        stopped = await answer
        self.destroy_timer(limit)
        if stopped is None:
            late = f"hub/stop has not answered in {STOP_LIMIT_S:g} s"
            response.success = False
            response.message = f"{late}: see that the axis stands still, or use the switch on the axis"
            return response
        response.success, response.message = stopped.success, f"hub/stop: {stopped.message}"
        return response

    def health(self) -> tuple[str, str, dict[str, object]]:
        """Report which sequence was handed over last and what became of it."""
        counters: dict[str, object] = {"sequences": self._started}
        if self._current is None:
            return "OK", "ready", counters
        current = self._current
        sentence = f"{current.sequence_id}: {current.state}"
        if current.state == "lost":
            return "WARN", f"{sentence}: {current.reason}", counters
        return "OK", sentence, counters


def main(argv: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(ExcitationGenerator, argv)
