"""A clock that is known by receipts alone: drift, wraps, restarts, and delays as an operating system makes them."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ros.hub.host.receipt_clock import ReceiptClock

START_NS = 4_000_000_000_000


def no_fault(name: str, reason: str) -> None:
    raise AssertionError(f"{name}: {reason}")


def _receipts(seconds: float, drift: float, seed: int, shortest_ns: float = 300_000.0):
    """Device times of lines 5 ms apart by the device's clock, when they were printed, and when they came."""
    rng = np.random.default_rng(seed)
    device = np.arange(0, round(seconds * 200)) * 5_000_000
    truth = START_NS + device / (1 + drift)
    # Most lines come at once; every tenth waits for the scheduler, some for long.
    delay = shortest_ns + rng.exponential(100_000.0, len(device))
    late = rng.random(len(device)) < 0.1
    delay[late] += rng.exponential(4_000_000.0, int(late.sum()))
    return device, truth, np.maximum.accumulate(truth + delay)


@pytest.mark.parametrize("drift", [0.0, 60e-6, -3e-3])
@pytest.mark.parametrize("seed", [1, 2])
def test_stamps_are_wrong_by_the_shortest_delay_alone(drift: float, seed: int) -> None:
    device, truth, received = _receipts(20.0, drift, seed)
    clock = ReceiptClock(1000.0, 1 << 32, no_fault)
    errors = []
    for micros, true_ns, came_ns in zip(device // 1000, truth, received, strict=True):
        device_ns = clock.add(int(micros), round(came_ns))
        if clock.is_usable:
            errors.append(clock.host_ns(device_ns) - true_ns)
    settled = np.array(errors[len(errors) // 2 :])
    assert np.median(settled) == pytest.approx(300_000.0, abs=40_000.0)
    # Receipts themselves wander by milliseconds; the line through the least delayed does not.
    assert np.quantile(np.abs(settled - np.median(settled)), 0.99) < 60_000.0
    assert clock.epoch == 1


def test_a_counter_that_wraps_goes_on() -> None:
    clock = ReceiptClock(1000.0, 1 << 32, no_fault)
    first = (1 << 32) - 2_000_000
    seen = [
        clock.add((first + k * 5000) % (1 << 32), START_NS + k * 5_000_000 + 300_000) for k in range(2000)
    ]
    assert np.all(np.diff(seen) == 5_000_000)
    assert clock.epoch == 1
    wrapped = [
        clock.add((first + k * 5000) % (1 << 32), START_NS + k * 5_000_000 + 300_000)
        for k in range(2000, 2010)
    ]
    assert np.all(np.diff(wrapped) == 5_000_000)


def test_a_counter_that_begins_anew_is_another_epoch() -> None:
    found: list[str] = []
    clock = ReceiptClock(1000.0, 1 << 32, lambda name, _reason: found.append(name))
    for k in range(1000):
        clock.add(50_000_000 + k * 5000, START_NS + k * 5_000_000)
    assert clock.is_usable
    restart_ns = START_NS + 1000 * 5_000_000
    for k in range(400):
        device_ns = clock.add(k * 5000, restart_ns + k * 5_000_000)
    assert (clock.epoch, found) == (2, ["clock_backwards"])
    assert clock.host_ns(device_ns) == pytest.approx(restart_ns + 399 * 5_000_000, abs=20_000)


def test_one_damaged_reading_and_a_process_that_was_frozen_leave_the_clock_as_it_is() -> None:
    clock = ReceiptClock(1000.0, 1 << 32, no_fault)
    for k in range(1000):
        # Lines 600 to 999 waited for two seconds, and come at once.
        came_ns = START_NS + (k if k < 600 else 1000) * 5_000_000
        device_ns = clock.add(50_000_000 + k * 5000, came_ns)
        assert device_ns == (50_000_000 + k * 5000) * 1000
        if k == 300:
            assert clock.add(90_000_000 + k * 5000, came_ns) is None
    assert clock.epoch == 1
