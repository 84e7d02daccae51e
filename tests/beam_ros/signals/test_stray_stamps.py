"""A message of the rig's own topics whose stamp is far off."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from beam_ros import messages
from beam_ros.bags.errors import BagError
from beam_ros.bags.reading import Bag
from beam_ros.bags.writing import BagWriter
from beam_ros.signals.stray_stamps import well_placed, without_stray_batches
from tests.beam_ros.bags.small_bags import BATCH, FRAME, NAMES, PERIOD, START, TYPES, batch, displacement_row


def write(path: Path, stray: dict[int, int], n: int = 300) -> Path:
    """A batch and two frames every 20 ms; some by their number at other stamps."""
    with BagWriter(path) as bag:
        for k in range(n):
            now = START + (k + 1) * BATCH * PERIOD
            moved = stray.get(k, 0)
            own = batch(k)
            bag.write_batch(
                "hub/measured", now, type(own)(own.stamp_ns + moved, PERIOD, 1, positions=own.positions)
            )
            for frame in (2 * k, 2 * k + 1):
                stamp = START + frame * FRAME + (moved if frame % 2 == 0 else 0)
                message = messages.displacement(TYPES, stamp, NAMES, displacement_row(frame))
                bag.write_message("beam/displacement", now, message)
    return path


@pytest.mark.parametrize("seconds", [-3.0005, -200.0, 3.0005, 200.0])
def test_a_batch_and_a_frame_far_off_are_named_and_left_out(tmp_path: Path, seconds: float) -> None:
    notes: list[str] = []
    with Bag(write(tmp_path / "bag", {200: round(seconds * 1e9)})) as bag:
        hub = without_stray_batches(bag, bag.hub_samples(), notes)
        frames = well_placed(bag, bag.displacements(), START, notes)
    assert len(hub.stamps_ns) == 299 * BATCH
    assert hub.lost == BATCH
    assert hub.stamps_ns[0] == START
    assert hub.stamps_ns[-1] == START + (300 * BATCH - 1) * PERIOD
    np.testing.assert_allclose(hub.positions, 1e-6 * np.rint((hub.stamps_ns - START) / PERIOD), atol=1e-12)
    assert len(frames.stamps_ns) == 599
    way = "back" if seconds < 0 else "ahead"
    assert len([note for note in notes if f"s {way} at " in note]) == 2, notes


def test_two_batches_that_have_each_others_stamps_are_left_out(tmp_path: Path) -> None:
    # Their samples fill each other's places, so that neither a hole nor a doubled stamp shows them.
    notes: list[str] = []
    apart = 37 * BATCH * PERIOD
    with Bag(write(tmp_path / "bag", {100: apart, 137: -apart})) as bag:
        hub = without_stray_batches(bag, bag.hub_samples(), notes)
    assert len(hub.stamps_ns) == 298 * BATCH
    np.testing.assert_allclose(hub.positions, 1e-6 * np.rint((hub.stamps_ns - START) / PERIOD), atol=1e-12)
    assert any("2 stamps cannot be right" in note for note in notes)


def test_two_recordings_of_the_same_time_are_refused_and_one_said_twice_is_not(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "twice") as twice, BagWriter(tmp_path / "two") as two:
        for k in range(40):
            now = START + (k + 1) * BATCH * PERIOD
            other = batch(k, positions=np.full(BATCH, 1e-3 * k))
            for own in (batch(k), batch(k)):
                twice.write_batch("hub/measured", now, own)
            for own in (batch(k), other if k > 20 else batch(k)):
                two.write_batch("hub/measured", now, own)
    notes: list[str] = []
    with Bag(tmp_path / "twice") as bag:
        assert len(without_stray_batches(bag, bag.hub_samples(), notes).stamps_ns) == 40 * BATCH
    assert any("40 samples repeat a stamp" in note for note in notes)
    with Bag(tmp_path / "two") as bag, pytest.raises(BagError, match=r"19 of 80 messages.*two recordings"):
        without_stray_batches(bag, bag.hub_samples(), notes)


def test_a_whole_bag_is_not_touched(tmp_path: Path) -> None:
    notes: list[str] = []
    with Bag(write(tmp_path / "bag", {}, 20)) as bag:
        hub, frames = bag.hub_samples(), bag.displacements()
        assert without_stray_batches(bag, hub, notes) is hub
        assert well_placed(bag, frames, START, notes) is frames
    assert notes == []
