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
from rclpy.serialization import deserialize_message
from rclpy.task import Future

from beam_ros import messages
from beam_ros.bags.batches import decode_chunk, encode_batch, faulty_chunk
from beam_ros.bags.errors import BagError
from beam_ros.hub.contract import HostTime, Hub, HubEvent, HubReport, HubStatus, NewsBearer, RequestKind
from beam_ros.interfaces import graph
from beam_ros.messages import MessageContentError
from beam_ros.rig.rig import Rig
from beam_ros.shell.freeze_watch import FreezeWatch
from beam_ros.shell.node import RigNode, request_sent_ns
from beam_ros.shell.other_hubs import count_hubs, refuse_second_hub, two_hubs

_POLL_S = 0.01
"""A spin of the hub [s]: so often it is polled, and at most so often a set-point is checked."""
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
        refuse_second_hub(self)
        self._hub = build(self.rig)
        self._status = HubStatus()
        self._told_mode: tuple[object, ...] = ()
        self._refused_setpoints = 0
        self._waiting: dict[int, Future] = {}
        parameters = self.rig.axis_parameters()
        self._freeze = FreezeWatch(round(parameters.watchdog_s * 1e9))
        self._mode = self.rig.hub.command_mode
        self._period_ns = parameters.period_ns
        self._applied = self.offer("hub/applied")
        self._measured = self.offer("hub/measured")
        self._state = self.offer("hub/state")
        self._clock_sync = self.offer("hub/clock_sync")
        self._sequence_state = self.offer("hub/sequence_state")
        self._mode_state = self.offer("hub/mode")
        self._newest_setpoint: bytes | None = None
        self._next_check_s = 0.0
        self._setpoint_class = self.types.message_class(graph.TOPICS["hub/setpoint"].type_name)
        self.listen("hub/setpoint", self._on_setpoint, raw=True)
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
        # It was started before the look round: the first poll comes before the first health.
        self.health_timer.reset()

    def _answer(self, kind: RequestKind) -> Callable[[Any, Any], Any]:
        async def answer(_request: Any, response: Any) -> Any:
            return await self._ask(kind, response)

        return answer

    async def _on_enable(self, request: Any, response: Any) -> Any:
        return await self._ask("enable" if request.data else "disable", response)

    async def _ask(self, kind: RequestKind, response: Any) -> Any:
        objection = None
        if kind in _ALWAYS_TAKEN:
            self._newest_setpoint = None
        else:
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

    def _on_setpoint(self, data: bytes) -> None:
        """Take a set-point: the first of a spin at once, and of those that follow it the newest at its end.

        So a flood costs its sender, not the link: what is superseded is not even unpacked.
        """
        self._newest_setpoint = data
        self._check_newest_setpoint()

    def _check_newest_setpoint(self) -> None:
        now_s = time.monotonic()
        if self._newest_setpoint is None or now_s < self._next_check_s:
            return
        message = deserialize_message(self._newest_setpoint, self._setpoint_class)
        self._newest_setpoint, self._next_check_s = None, now_s + _POLL_S
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
        self._check_newest_setpoint()
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
        if count_hubs(self) > 1:
            level, sentence = "ERROR", f"{two_hubs()}; {sentence}"
            self.get_logger().error(two_hubs(), throttle_duration_sec=10.0)
        return level, sentence, {**about, **status.counters, "refused set-points": self._refused_setpoints}

    def close(self) -> None:
        """Leave the axis stopped, and say that nobody leads it any more."""
        self._hub.close()
        if self.context.ok():
            # What became of a sequence.
            HubNode.publish_report(self, self._hub.poll(host_time()))
            gone = HubStatus(reason="the node has ended: start it again")
            self.say_last(self._mode_state, messages.hub_mode(self.types, gone, host_time().unix_ns))


def _newest_sample(batch: Any) -> messages.HubSample:
    def last(values: Any) -> float:
        return float("nan") if values is None else float(values[-1])

    stamp_ns = batch.stamp_ns + (len(batch) - 1) * batch.period_ns
    return messages.HubSample(stamp_ns, last(batch.positions), last(batch.velocities), last(batch.efforts))
