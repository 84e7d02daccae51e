"""Signals: messages taken as tables say what the same messages say when each is decoded."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from beam_ros import messages
from beam_ros.bags.batches import encode_batch
from beam_ros.bags.blocks import Block, TypedTopic
from beam_ros.bags.signals import ClockIntake, DisplacementIntake, HubIntake
from beam_ros.hub.contract import ClockSync, SampleBatch
from beam_ros.interfaces import graph
from tests.beam_ros.bags.small_bags import BATCH, FRAME, NAMES, PERIOD, START, TYPES


def filled(intake, type_name, data, parts=1):
    """Hand messages to an intake, in one block or in several."""
    edges = np.linspace(0, len(data), parts + 1).astype(int)
    for first, last in itertools.pairwise(edges.tolist()):
        own = data[first:last]
        sizes = np.array([len(item) for item in own], dtype=np.int64)
        buffer = np.frombuffer(b"".join(own), dtype=np.uint8)
        times = np.arange(first, last)
        intake.take(Block(TypedTopic("/x", type_name), buffer, np.cumsum(sizes) - sizes, sizes, times))
    return intake


def big_endian(data):
    """The same numbers would read otherwise: no table takes such a message, and the general reader says why."""
    return b"\0\0" + data[2:]


def batches(rng, count=80):
    """Batches of several lengths, periods, epochs and quantities; some twice, some out of order, some bad."""
    made = []
    for k in range(count):
        n = int(rng.choice([BATCH, BATCH, BATCH, 7, 1]))
        columns = {"positions": rng.normal(size=n)}
        if rng.random() < 0.5:
            columns["efforts"] = rng.normal(size=n)
        stamp = START + k * BATCH * PERIOD if rng.random() > 0.05 else 0
        made.append(SampleBatch(stamp, PERIOD, int(k > count // 2), **columns))
    order = np.arange(count)
    order[10:20] = rng.permutation(order[10:20])
    return [made[k] for k in (*order, 5, 6, 7, 70)]


@pytest.mark.parametrize("parts", [1, 5])
def test_batches_taken_as_tables_join_as_those_taken_one_by_one(parts):
    rng = np.random.default_rng(11)
    data = [encode_batch(batch) for batch in batches(rng)]
    data[33] = data[33][:-9]
    data[34] = big_endian(data[34])
    fast = filled(HubIntake(TYPES, "/x"), graph.JOINT_TRAJECTORY, data, parts).samples()
    # A block of one message is never a table.
    slow = filled(HubIntake(TYPES, "/x"), graph.JOINT_TRAJECTORY, data, len(data)).samples()
    assert fast.duplicates > 4 * 7
    assert fast.unreadable.count >= 2
    for name in ("stamps_ns", "positions", "efforts", "epochs"):
        np.testing.assert_array_equal(getattr(fast, name), getattr(slow, name))
    assert (fast.gaps, fast.duplicates, fast.period_ns) == (slow.gaps, slow.duplicates, slow.period_ns)
    assert fast.unreadable.count == slow.unreadable.count


@pytest.mark.parametrize("parts", [1, 4])
def test_displacements_taken_as_tables_are_those_taken_one_by_one(parts):
    rng = np.random.default_rng(12)
    data, truth = [], {}
    for k in rng.permutation(60):
        stamp = START + int(k) * FRAME
        # A rolling shutter: each marker at a time of its own, or two of them together.
        for group in ((0,), (2, 1)) if k % 3 else ((1, 0, 2),):
            values = rng.normal(size=len(group))
            names = [NAMES[j] for j in group]
            for name, value in zip(names, values, strict=True):
                truth.setdefault((stamp + group[0], name), value)
            data.append(
                TYPES.serialize(
                    messages.displacement(TYPES, stamp + group[0], names, values), graph.JOINT_STATE
                )
            )
    again = messages.displacement(TYPES, START + 1, [NAMES[1]], [99.0])  # the first one stays
    data.append(TYPES.serialize(again, graph.JOINT_STATE))
    unstamped = messages.displacement(TYPES, 0, [NAMES[1]], [1.0])
    data.append(TYPES.serialize(unstamped, graph.JOINT_STATE))
    intake = filled(DisplacementIntake(TYPES), graph.JOINT_STATE, data, parts)
    table = intake.table()
    assert table.unreadable.count == 1
    assert np.all(np.diff(table.stamps_ns) > 0)
    found = {
        (int(stamp), name): table.positions[row, table.names.index(name)]
        for row, stamp in enumerate(table.stamps_ns)
        for name in table.names
        if np.isfinite(table.positions[row, table.names.index(name)])
    }
    assert found == truth
    assert table.duplicates == 1


def test_comparisons_of_clocks_keep_the_numbers_of_their_own_texts():
    syncs = [
        ClockSync(START + k * 10**8, 10**9 + k * 10**8 + 7, 1 + k // 30, 100_000 + 37 * k) for k in range(50)
    ]
    type_name = graph.TOPICS["hub/clock_sync"].type_name
    data = [TYPES.serialize(messages.clock_sync(TYPES, sync), type_name) for sync in syncs]
    wrong = TYPES.make(
        type_name,
        header=messages.header(TYPES, START, ""),
        time_ref=TYPES.deserialize(data[0], type_name).time_ref,
        source="x",
    )
    data.insert(20, TYPES.serialize(wrong, type_name))
    intake = filled(ClockIntake(TYPES), type_name, data)
    assert intake.syncs() == tuple(syncs)
    assert intake.unreadable.count == 1


def test_messages_of_another_type_are_left_out_and_counted():
    data = [TYPES.serialize(messages.json_text(TYPES, {}), graph.STRING)] * 3
    intake = filled(HubIntake(TYPES, "/x"), graph.STRING, data)
    assert intake.samples() is None
    assert intake.unreadable.count == 3
    assert "type std_msgs/msg/String" in intake.unreadable.first_reason
