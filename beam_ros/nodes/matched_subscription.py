"""A subscription that takes what its publishers offer, whoever they are and whatever they become."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from rclpy.subscription import Subscription

from beam_ros.interfaces import Topic
from beam_ros.nodes.shell import RigNode, qos_profile


class MatchedSubscription:
    """Subscribes to a topic whose publishers need not be ours.

    A reliable subscription never hears a best-effort publisher, a latched one never a volatile publisher. So there is
    no subscription before there is a publisher, both are asked for only while all publishers offer them, and a camera
    that starts anew with another quality of service is followed.

    Parameters
    ----------
    node : RigNode -- owns the subscription
    topic : Topic -- row of the table
    callback : callable
    depth : int -- messages that may wait
    raw : bool -- hand over the wire's bytes

    Attributes
    ----------
    publishers : int -- how many there were when `follow` last looked
    """

    def __init__(
        self, node: RigNode, topic: Topic, callback: Callable[..., None], *, depth: int, raw: bool = False
    ) -> None:
        self._node = node
        self._topic = topic
        self._callback = callback
        self._raw = raw
        self._qos = replace(topic.qos, depth=depth)
        self._known: frozenset[bytes] = frozenset()
        self._subscription: Subscription | None = None
        self.publishers = 0

    def follow(self, *, is_wanted: bool = True) -> bool:
        """Look who publishes, and listen to them as they offer.

        Parameters
        ----------
        is_wanted : bool -- False gives the subscription up

        Returns
        -------
        bool -- True when a publisher has come that was not there before
        """
        offers: list[Any] = self._node.get_publishers_info_by_topic(
            self._node.resolve_topic_name(self._topic.name)
        )
        self.publishers = len(offers)
        found = frozenset(bytes(offer.endpoint_gid) for offer in offers)
        is_new = bool(found - self._known)
        self._known = found
        if not offers:
            return False
        profiles = [offer.qos_profile for offer in offers]
        qos = replace(
            self._qos,
            is_reliable=all(profile.reliability == ReliabilityPolicy.RELIABLE for profile in profiles),
            is_latched=all(profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for profile in profiles),
        )
        if self._subscription is not None and (not is_wanted or qos != self._qos):
            self._node.destroy_subscription(self._subscription)
            self._subscription = None
        self._qos = qos
        if self._subscription is None and is_wanted:
            self._subscription = self._node.create_subscription(
                self._node.types.message_class(self._topic.type_name),
                self._topic.name,
                self._callback,
                qos_profile(self._qos),
                raw=self._raw,
            )
        return is_new
