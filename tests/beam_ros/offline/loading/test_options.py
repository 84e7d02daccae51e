"""The texts of the identifier's parameters."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from beam_ident import Prior
from beam_ros.errors import RigError
from beam_ros.offline.loading.options import FitOptions, listed
from beam_ros.rig.rig import Rig

USUAL = Rig.from_file().identifier


def test_the_packaged_parameters_say_nothing_special() -> None:
    assert FitOptions.of(USUAL) == FitOptions()


def test_every_text_becomes_what_it_says() -> None:
    told = replace(
        USUAL,
        modes=2,
        orders="4/3, 5/4 6",
        without="ramp,free_response",
        delay="0.004+-0.001",
        clock="free",
        hold="linear",
        segments="0:10,12:",
        input="/j:position[axis]",
        outputs="/laser:range; /imu:linear_acceleration.x",
    )
    found = FitOptions.of(told)
    assert (found.n_modes, found.max_modes) == (2, None)
    assert found.orders == ((4, 3), (5, 4), (6, 0))
    assert found.without == ("ramp", "free_response")
    assert found.delay == Prior(0.004, 0.001)
    assert found.clock == Prior(0.0, math.inf)
    assert found.segments == ((0.0, 10.0), (12.0, math.inf))
    assert [own.topic for own in found.signals.outputs] == ["/laser", "/imu"]
    settings = found.settings("base_motion", Prior(0.0, 1e-6), None)
    assert settings.latency == Prior(0.004, 0.001)
    assert settings.clock_rate == found.clock
    assert replace(found, clock=None).settings("force", Prior(0.0, 1e-6), None).clock_rate == Prior(0.0, 1e-6)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"orders": "4-3"}, "poles/zeros"),
        ({"without": "rmp"}, "did you mean ramp"),
        ({"delay": "late"}, "auto, free"),
        ({"clock": "1+-x"}, "auto, free"),
        ({"delay": "1+--1"}, "auto, free"),
        ({"segments": "10:2"}, "start:end"),
        ({"segments": "10"}, "start:end"),
        ({"input": "/nonsense"}, "names no field"),
        ({"signals": "nowhere.yaml"}, "cannot be read"),
    ],
)
def test_a_wrong_text_is_refused_with_what_is_expected(changes: dict[str, str], words: str) -> None:
    with pytest.raises(RigError, match=words):
        FitOptions.of(replace(USUAL, **changes))


def test_parts_stand_between_semicolons() -> None:
    assert listed(" a b ;c; ") == ["a b", "c"]
