"""Wide devices, random commands, something goes wrong: the plant stays within the rig's travel."""

from __future__ import annotations

import pytest

from benchmarks.axis_safety import ACCIDENTS, LIES, LyingStream, Stream


def check(seed: int) -> None:
    excursion = Stream(seed).play()
    assert excursion.is_at_rest, (seed, excursion)
    assert excursion.beyond <= excursion.allowed, (seed, excursion)
    assert excursion.speed < 2.0, (seed, excursion)
    if excursion.mode != "effort":
        # The device looks ahead: what it has left is its slack for rounding.
        assert excursion.beyond < 0.01 * excursion.allowed + 1e-4, (seed, excursion)


@pytest.mark.slow
@pytest.mark.parametrize("accident", ACCIDENTS)
def test_a_device_with_wide_limits_stays_within_those_of_the_rig(accident):
    check(len(ACCIDENTS) * 7 + ACCIDENTS.index(accident))


@pytest.mark.verify
def test_a_thousand_random_streams_stay_within_the_rigs_travel():
    for seed in range(1000):
        check(seed)


def check_lie(seed: int) -> None:
    """Found in time, by a name that is right; at rest a watchdog's time later; and its way back is one."""
    stream = LyingStream(seed)
    found = stream.find()
    assert found.name in found.lie.names, (seed, found)
    assert found.after <= found.lie.within, (seed, found)
    assert found.rest_after <= stream.axis.watchdog_s + 0.1, (seed, found)
    assert found.beyond <= 0.0, (seed, found)
    assert found.remedy, (seed, found)
    assert found.is_enabled_again, (seed, found)


@pytest.mark.slow
@pytest.mark.parametrize("lie", LIES, ids=lambda lie: lie.kind)
def test_a_device_that_lies_is_found_out_and_stopped(lie):
    check_lie(len(LIES) * 5 + LIES.index(lie))


@pytest.mark.verify
def test_two_hundred_devices_that_lie_are_found_out_and_stopped():
    for seed in range(200):
        check_lie(seed)
