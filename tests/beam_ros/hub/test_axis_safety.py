"""Wide devices, random commands, something goes wrong: the plant stays within the rig's travel."""

from __future__ import annotations

import pytest

from benchmarks.axis_safety import ACCIDENTS, Stream


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
