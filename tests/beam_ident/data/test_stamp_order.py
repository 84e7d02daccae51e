"""Stamps that run backward, repeat, or come late."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ident.data.stamp_order import StampOrder

MS = 1_000_000
REGULAR = np.arange(200, dtype=np.int64) * 10 * MS


def test_stamps_that_rise_are_all_kept() -> None:
    found = StampOrder.of(REGULAR)
    assert found.order.tolist() == list(range(200))
    assert found.sentences("/imu", 0) == []


@pytest.mark.parametrize("seconds", [-3.0, -0.5, 3.0, 400.0])
def test_a_single_stamp_that_is_far_off_is_named_and_its_sample_left_out(seconds: float) -> None:
    stamps = REGULAR.copy()
    stamps[120] += round((seconds - 0.001) * 1e9)  # not on another sample's stamp
    found = StampOrder.of(stamps)
    assert found.order.tolist() == [k for k in range(200) if k != 120]
    assert found.late == found.repeated == 0
    (event,) = found.misplaced
    assert (event.first, event.count) == (120, 1)
    assert event.step_ns == pytest.approx((seconds + 0.009) * 1e9)
    way = "back" if seconds < 0 else "ahead"
    assert f"{abs(seconds + 0.009):.3f} s {way} at 1.190 s" in found.sentences("/imu", 0)[0]


def test_a_clock_that_steps_back_is_one_event() -> None:
    stamps = REGULAR.copy()
    stamps[150:] -= 1_003 * MS
    found = StampOrder.of(stamps)
    (event,) = found.misplaced
    assert (event.first, event.count) == (150, 50)


def test_samples_that_came_late_are_put_where_they_belong() -> None:
    order = [0, 1, 2, 4, 5, 3, 6, *range(7, 200)]
    found = StampOrder.of(REGULAR[order])
    assert found.late == 1
    assert found.misplaced == ()
    assert REGULAR[order][found.order].tolist() == REGULAR.tolist()


def test_a_stamp_that_is_there_already_is_counted() -> None:
    stamps = np.insert(REGULAR, 50, REGULAR[49])
    found = StampOrder.of(stamps)
    assert found.repeated == 1
    assert len(found.order) == 200


def test_a_stray_sample_beside_a_whole_record_did_not_come_late() -> None:
    found = StampOrder.of(np.insert(REGULAR, 50, REGULAR[-1] + 400_000 * MS))
    assert found.late == 0
    assert len(found.misplaced) == 1
    assert len(found.order) == 200
