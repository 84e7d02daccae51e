"""A subscription that takes what its present and future publishers offer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from rclpy.subscription import Subscription

from beam_ros.interfaces.graph import QualityOfService, Topic
from beam_ros.shell.node import RigNode


class _Unwatched(CallbackGroup):  # type: ignore[misc]
    """Subscriptions that no executor waits for."""

    def can_execute(self, entity: Any) -> bool:
        del entity
        return False

    def beginning_execution(self, entity: Any) -> bool:
        del entity
        return False

    def ending_execution(self, entity: Any) -> None:
        del entity


def next_waiting(subscription: Subscription) -> tuple[Any, dict[str, int | None]] | None:
    """Return the message that has waited longest, with what is known of its coming; None where none waits."""
    with subscription.handle:
        taken: tuple[Any, dict[str, int | None]] | None
        taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
    return taken


class MatchedSubscription:
    """Subscribes to a topic whose publishers need not be ours.

    A reliable subscription never hears a best-effort publisher, a latched one never a volatile publisher. So both are
    asked for only while all publishers offer them, and a camera that starts anew with another quality of service is
    followed.

    Parameters
    ----------
    node : RigNode -- owns the subscription
    topic : Topic -- row of the table
    callback : callable
    depth : int -- messages that may wait
    raw : bool -- hand over the wire's bytes
    is_early : bool -- subscribe before there is a publisher, as the table says, to miss nothing of its beginning
    takes_all : bool -- hand over all that waits at once: rclpy puts together anew, for every single message, all that
        the node waits for, which for a quick camera costs as much as its frames do
    wakes : bool -- False: what comes waits for ``take``, which hands it over with what is known of its coming

    Attributes
    ----------
    publishers : int -- how many there were when ``follow`` last looked
    """

    def __init__(
        self,
        node: RigNode,
        topic: Topic,
        callback: Callable[..., None],
        *,
        depth: int,
        raw: bool = False,
        is_early: bool = False,
        takes_all: bool = False,
        wakes: bool = True,
    ) -> None:
        self._node = node
        self._group = None if wakes else _Unwatched()
        self._topic = topic
        self._callback = self._take_all if takes_all else callback
        self._take = callback
        self._raw = raw
        self._qos = replace(topic.qos, depth=depth)
        self._known: frozenset[bytes] = frozenset()
        self._subscription: Subscription | None = None
        self.publishers = 0
        if is_early:
            self._subscribe()

    def _subscribe(self) -> None:
        self._subscription = self._node.listen(
            self._topic.name, self._callback, self._qos, raw=self._raw, callback_group=self._group
        )

    def take(self) -> None:
        """Hand over all that waits."""
        while self._subscription is not None and (taken := next_waiting(self._subscription)) is not None:
            self._take(*taken)

    def _take_all(self, message: Any) -> None:
        """Hand over a message and those that wait behind it, at most as many as can wait."""
        self._take(message)
        for _ in range(self._qos.depth - 1):
            subscription = self._subscription
            if subscription is None:
                return  # given up by who took the last message
            if (taken := next_waiting(subscription)) is None:
                return
            self._take(taken[0])

    def close(self) -> None:
        """Give the subscription up."""
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
            self._subscription = None

    def _endpoints(self) -> list[Any]:
        return list(self._node.get_publishers_info_by_topic(self._node.resolve_topic_name(self._topic.name)))

    def offers(self) -> tuple[QualityOfService, ...]:
        """Return what each publisher offers now."""
        return tuple(_offer(endpoint) for endpoint in self._endpoints())

    def follow(self, *, is_wanted: bool = True) -> bool:
        """Look who publishes, and listen to them as they offer.

        Parameters
        ----------
        is_wanted : bool -- False gives the subscription up

        Returns
        -------
        bool -- True when a publisher has come that was not there before
        """
        endpoints = self._endpoints()
        self.publishers = len(endpoints)
        found = frozenset(bytes(endpoint.endpoint_gid) for endpoint in endpoints)
        is_new = bool(found - self._known)
        self._known = found
        if not endpoints:
            return False
        offers = [_offer(endpoint) for endpoint in endpoints]
        qos = replace(
            self._qos,
            is_reliable=all(offer.is_reliable for offer in offers),
            is_latched=all(offer.is_latched for offer in offers),
        )
        if not is_wanted or qos != self._qos:
            self.close()
        self._qos = qos
        if self._subscription is None and is_wanted:
            self._subscribe()
        return is_new


def _offer(endpoint: Any) -> QualityOfService:
    profile = endpoint.qos_profile
    return QualityOfService(
        profile.depth,
        profile.reliability == ReliabilityPolicy.RELIABLE,
        profile.durability == DurabilityPolicy.TRANSIENT_LOCAL,
    )
