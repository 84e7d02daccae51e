"""The node ``hub``: one shell for the simulated hub and for the one behind a serial port.

Everything that can differ between the two is behind the ``Hub`` protocol; names, types, qualities of service,
services and shared parameters are the same because they are written here once.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.task import Future

from beam_ros import messages
from beam_ros.bags.batches import decode_chunk, encode_batch, faulty_chunk
from beam_ros.bags.errors import BagError
from beam_ros.hub.contract import HostTime, Hub, HubEvent, HubReport, HubStatus, NewsBearer, RequestKind
from beam_ros.messages import MessageContentError
from beam_ros.rig.rig import Rig
from beam_ros.shell.freeze_watch import FreezeWatch
from beam_ros.shell.node import RigNode, request_sent_ns

_POLL_S = 0.01
_CALM_POLL_S = 0.04
"""A hub that bears news is polled when it has some, and so long after the last time [s]."""
_ALWAYS_TAKEN: tuple[RequestKind, ...] = ("stop", "disable")
"""Requests that are never too old."""


def host_time() -> HostTime:
    """Read the host's two clocks together."""
    return HostTime(time.monotonic_ns(), time.time_ns())


class HubNode(RigNode):
    """A hub on the graph.

    Parameters
    ----------
    executable : str -- ``simulator`` or ``hub_driver``
    build : callable -- makes the hub from the rig's parameters
    **options -- as of ``RigNode``
    """

    def __init__(self, executable: str, build: Callable[[Rig], Hub], **options: Any) -> None:
        super().__init__(executable, **options)
        self._hub = build(self.rig)
        self._status = HubStatus()
        self._told_mode: tuple[object, ...] = ()
        self._refused_setpoints = 0
        self._waiting: dict[int, Future] = {}
        self._freeze = FreezeWatch()
        self._mode = self.rig.hub.command_mode
        self._period_ns = self.rig.axis_parameters().period_ns
        self._applied = self.offer("hub/applied")
        self._measured = self.offer("hub/measured")
        self._state = self.offer("hub/state")
        self._clock_sync = self.offer("hub/clock_sync")
        self._sequence_state = self.offer("hub/sequence_state")
        self._mode_state = self.offer("hub/mode")
        self.listen("hub/setpoint", self._on_setpoint)
        # 500 points cost rclpy milliseconds to unpack, the suite's own codec microseconds.
        self.listen("hub/sequence", self._on_chunk, raw=True)
        services = {"hub/home": "home", "hub/stop": "stop", "hub/clear_fault": "clear_fault"}
        # A service waits for the device's answer; in a group of its own it keeps nothing else from running.
        group = ReentrantCallbackGroup()
        for name, kind in services.items():
            self.serve(name, self._answer(kind), callback_group=group)  # type: ignore[arg-type]
        self.serve("hub/enable", self._on_enable, callback_group=group)
        for shortcoming in self._hub.capabilities.shortcomings:
            self.get_logger().warning(f"this axis cannot promise: {shortcoming}")
        if isinstance(self._hub, NewsBearer):
            self._poll_timer = self.create_timer(_CALM_POLL_S, self._poll)
            self._hub.call_on_news(self.create_guard_condition(self._on_news).trigger)
        else:
            self._poll_timer = self.create_timer(_POLL_S, self._poll)

    def _answer(self, kind: RequestKind) -> Callable[[Any, Any], Any]:
        async def answer(_request: Any, response: Any) -> Any:
            return await self._ask(kind, response)

        return answer

    async def _on_enable(self, request: Any, response: Any) -> Any:
        return await self._ask("enable" if request.data else "disable", response)

    async def _ask(self, kind: RequestKind, response: Any) -> Any:
        objection = None
        if kind not in _ALWAYS_TAKEN:
            objection = self._freeze.objection(time.monotonic_ns(), request_sent_ns())
        if objection:
            response.success, response.message = False, f"{kind} refused: the hub's process {objection}"
            self.get_logger().warning(response.message)
            return response
        future = Future()
        self._waiting[self._hub.request(kind)] = future
        outcome = await future
        response.success, response.message = outcome.success, outcome.message
        return response

    def _on_setpoint(self, message: Any) -> None:
        try:
            point = messages.read_setpoint(message)
        except MessageContentError as err:
            self._refuse_setpoint(str(err))
            return
        if point.mode != self._mode:
            self._refuse_setpoint(f"set-point in {point.mode}: the hub is commanded in {self._mode}")
            return
        outcome = self._hub.setpoint(point.stamp_ns, point.value, host_time())
        if not outcome.success:
            self._refuse_setpoint(outcome.message)

    def _refuse_setpoint(self, reason: str) -> None:
        self._refused_setpoints += 1
        self.get_logger().warning(reason, throttle_duration_sec=1.0)

    def _on_chunk(self, data: bytes) -> None:
        try:
            mode, chunk = decode_chunk(data, self._period_ns)
        except (MessageContentError, BagError) as err:
            self.get_logger().warning(f"sequence chunk refused: {err}", throttle_duration_sec=1.0)
            mode, chunk = self._mode, faulty_chunk(data, str(err))
        if mode != self._mode:
            fault = f"samples in {mode}: the hub is commanded in {self._mode}"
            chunk = dataclasses.replace(chunk, fault=fault)
        self._hub.load(chunk, host_time())

    def _poll(self) -> None:
        self._freeze.beat(time.monotonic_ns())
        self.publish_report(self._hub.poll(host_time()))

    def _on_news(self) -> None:
        self._poll_timer.reset()
        self._poll()

    def publish_report(self, report: HubReport) -> None:
        """Publish what a poll brought and answer the services that it completes."""
        for publisher, batches in ((self._applied, report.applied), (self._measured, report.measured)):
            for batch in batches:
                publisher.publish(encode_batch(batch))
        for sync in report.clock:
            self._clock_sync.publish(messages.clock_sync(self.types, sync))
        for sequence in report.sequences:
            self._sequence_state.publish(messages.sequence_state(self.types, sequence))
        # Samples of an axis that cannot be believed are recorded, but nobody is told that the hub is there.
        if report.measured and not report.status.fault.is_of_host:
            self._state.publish(messages.hub_state(self.types, _newest_sample(report.measured[-1])))
        for number, outcome in report.completed:
            if number in self._waiting:
                self._waiting.pop(number).set_result(outcome)
        for event in report.events:
            self._log(event)
        self._status = report.status
        self._publish_mode(report.status)

    def _publish_mode(self, status: HubStatus) -> None:
        """Publish what the hub is about, when that has changed."""
        mode = (status.state, status.activity, status.fault.number, status.reason)
        if mode != self._told_mode:
            self._told_mode = mode
            self._mode_state.publish(messages.hub_mode(self.types, status, host_time().unix_ns))

    def _log(self, event: HubEvent) -> None:
        # rclpy ties a line of code to one severity, hence a line for each.
        logger = self.get_logger()
        if event.level == "error":
            logger.error(event.text)
        elif event.level == "warning":
            logger.warning(event.text)
        else:
            logger.info(event.text)

    def health(self) -> tuple[str, str, dict[str, object]]:
        """Report the axis's state and what was lost or refused."""
        status = self._status
        level = {"disconnected": "ERROR", "fault": "ERROR"}.get(status.state, "OK")
        sentence = f"{status.state}: {status.reason}" if status.reason else status.state
        about: dict[str, object] = {"activity": status.activity, "fault": status.fault.number}
        if status.remedy:
            about["remedy"] = status.remedy
        for number, shortcoming in enumerate(self._hub.capabilities.shortcomings, start=1):
            about[f"cannot promise {number}"] = shortcoming
        jumps = status.counters.get("real_time_jumps", 0)
        if jumps:
            # Recorded with the bag, so that whoever reads it later knows.
            level, sentence = "ERROR", f"the computer's real-time clock jumped {jumps} times; {sentence}"
        return level, sentence, {**about, **status.counters, "refused set-points": self._refused_setpoints}

    def close(self) -> None:
        """Leave the axis stopped."""
        self._hub.close()


def _newest_sample(batch: Any) -> messages.HubSample:
    def last(values: Any) -> float:
        return float("nan") if values is None else float(values[-1])

    stamp_ns = batch.stamp_ns + (len(batch) - 1) * batch.period_ns
    return messages.HubSample(stamp_ns, last(batch.positions), last(batch.velocities), last(batch.efforts))
