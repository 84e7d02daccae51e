"""Values with their units."""

from __future__ import annotations

import pytest

from beam_ros.errors import ParameterFileError
from beam_ros.experiments.quantities import in_si
from beam_ros.interfaces.rig_parameters import RIG_PARAMETERS


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("excitation.duration", "20 s", 20.0),
        ("excitation.duration", "1.5min", 90.0),
        ("excitation.duration", "250 ms", 0.25),
        ("excitation.step_size", "-2 mm", -0.002),
        ("excitation.speed", "5e1 mm/s", 0.05),
        ("excitation.end_frequency", "0.045 kHz", 45.0),
        ("excitation.acceleration", "0.7", 0.7),
        ("excitation.acceleration", 0.7, 0.7),
        ("excitation.waypoints", ["1 mm", 0, "-0.001"], [0.001, 0, -0.001]),
        ("excitation.kind", "chirp", "chirp"),
        ("simulation.frame_drops", "2 %", 0.02),
    ],
)
def test_a_value_comes_out_in_si(name: str, value: object, expected: object) -> None:
    assert in_si(RIG_PARAMETERS[name], value) == pytest.approx(expected) or expected == "chirp"


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        (
            "excitation.duration",
            "20 mm",
            ("excitation.duration", "'mm' is not a unit", "ms", "from 0.01 to 3600 s"),
        ),
        ("excitation.end_frequency", "45 rad/s", ("'rad/s'", "Hz")),
        ("excitation.waypoints", ["1 s"], ("excitation.waypoints", "'s'")),
    ],
)
def test_a_wrong_unit_is_named_with_those_that_there_are(
    name: str, value: object, words: tuple[str, ...]
) -> None:
    with pytest.raises(ParameterFileError) as caught:
        in_si(RIG_PARAMETERS[name], value)
    for word in words:
        assert word in str(caught.value)
