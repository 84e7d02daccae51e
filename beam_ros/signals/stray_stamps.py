"""Messages of the rig's own topics whose stamps cannot be right: left out, and named.

A joined signal shows such a message by samples that stand too close to others, twice at one time, alone far away, or
in another order than that of the bag. Only then are the stamps looked at in the order of the bag.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import replace

import numpy as np

from beam_ident.data.stamp_order import StampOrder
from beam_ros.arrays import StampArray
from beam_ros.bags.batches import decode_batch
from beam_ros.bags.errors import BagError, MessageDecodeError
from beam_ros.bags.reading import Bag
from beam_ros.bags.signals import Displacements, HubSamples, join_batches
from beam_ros.hub.contract import SampleBatch
from beam_ros.messages import MessageContentError
from beam_ros.signals.fields import message_stamps

_CLOSE = 0.75  # of the usual interval
_FAR_NS = 1_000_000_000
_CONTRADICTIONS = 0.05  # of the batches: more are no damage


def well_placed(bag: Bag, displacements: Displacements, origin_ns: int, notes: list[str]) -> Displacements:
    """Return the displacements without those of misplaced messages.

    Parameters
    ----------
    bag : Bag -- that they were read from
    displacements : Displacements
    origin_ns : int -- from which instants are counted [ns]
    notes : list of str -- gets what was found
    """
    steps = np.diff(displacements.stamps_ns)
    if (
        displacements.is_in_order
        and not displacements.duplicates
        and not (len(steps) and (np.min(steps) < _CLOSE * np.median(steps) or np.max(steps) > _FAR_NS))
    ):
        return displacements
    stamps, order = message_stamps(bag, "beam/displacement")
    notes += order.sentences(bag.full_name("beam/displacement"), origin_ns)
    keep = ~np.isin(displacements.stamps_ns, _misplaced(stamps, order))
    return replace(
        displacements, stamps_ns=displacements.stamps_ns[keep], positions=displacements.positions[keep]
    )


def without_stray_batches(bag: Bag, samples: HubSamples, notes: list[str]) -> HubSamples:
    """Return the hub's samples without those of misplaced batches.

    Parameters
    ----------
    bag : Bag -- that they were read from
    samples : HubSamples
    notes : list of str -- gets what was found

    Raises
    ------
    BagError
        Many batches of one stamp hold other samples: those of another recording, or of another device.
    """
    is_far = any(gap.end_ns - gap.start_ns > _FAR_NS for gap in samples.gaps)
    if samples.is_in_order and not samples.duplicates and not is_far:
        return samples
    if samples.duplicates:
        _refuse_contradictions(bag, samples.topic)
    stamps, order = message_stamps(bag, samples.topic)
    notes += order.sentences(samples.topic, int(stamps[order.order[0]]))
    wrong = set(_misplaced(stamps, order).tolist())
    if not wrong:
        return samples
    # Among others in the order of time, a stray batch has hidden those that belong there: all are joined anew.
    return join_batches(samples.topic, _batches(bag, samples.topic, wrong), samples.unreadable)


def _refuse_contradictions(bag: Bag, topic: str) -> None:
    """Refuse batches that say different things of the same time; the same said twice does no harm."""
    said: dict[int, bytes] = {}
    count = contradictions = 0
    for raw in bag.raw_messages(topic):
        try:
            stamp_ns = decode_batch(raw.data).stamp_ns
        except (MessageDecodeError, MessageContentError):
            continue  # counted already
        count += 1
        contradictions += said.setdefault(stamp_ns, raw.data) != raw.data
    if contradictions > _CONTRADICTIONS * count:
        raise BagError(
            f"{topic}: {contradictions} of {count} messages have the stamp of another one and hold other samples; "
            "expected one device in one recording. Two devices publish on this topic, or two recordings were put "
            "into one bag: give one of them"
        )


def _batches(bag: Bag, topic: str, wrong: Collection[int]) -> Iterator[SampleBatch]:
    """Yield the batches of a topic that can be read, but for those of some stamps [ns]."""
    for raw in bag.raw_messages(topic):
        try:
            batch = decode_batch(raw.data)
        except (MessageDecodeError, MessageContentError):
            continue  # counted already
        if batch.stamp_ns > 0 and batch.stamp_ns not in wrong:
            yield batch


def _misplaced(stamps_ns: StampArray, order: StampOrder) -> StampArray:
    """Return the stamps that cannot be right [ns]."""
    places = [k for event in order.misplaced for k in range(event.first, event.first + event.count)]
    return stamps_ns[places]
