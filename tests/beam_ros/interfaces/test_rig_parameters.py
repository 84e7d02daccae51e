"""The table of the rig's parameters: what a value may be, and how a wrong one is refused."""

from __future__ import annotations

import contextlib
import math
import re
from typing import get_args, get_origin

import pytest
from hypothesis import given
from hypothesis import strategies as st

from beam_ros.errors import ParameterFileError, likeliest
from beam_ros.interfaces.parameter_files import packaged_defaults
from beam_ros.interfaces.rig_parameters import RIG_PARAMETERS, check_parameters, check_relations
from beam_ros.rig.rig import Rig


def test_the_packaged_rig_gives_a_default_for_every_parameter_and_nothing_else() -> None:
    assert set(packaged_defaults()) == set(RIG_PARAMETERS)
    check_relations(Rig.from_file())


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("beam.length", 300, ("beam.length is 300 m", "0.01 to 5 m")),
        ("beam.length", "300 mm", ("'300 mm'", "give it in m")),
        ("beam.length", float("nan"), ("nan", "a number")),
        ("beam.length", True, ("True", "a number")),
        ("beam.modes", 2.5, ("2.5", "whole number")),
        ("hub.command_mode", "force", ("'force'", "acceleration, velocity, position, effort")),
        ("markers.heights", 0.1, ("0.1", "list of numbers")),
        ("markers.heights", [], ("[]", "list of numbers")),
        ("markers.names", [1, 2], ("[1, 2]", "list of words")),
        ("simulation.images", "yes", ("'yes'", "true or false")),
        ("beam.lenght", 0.3, ("unknown parameter beam.lenght", "did you mean beam.length [m]?")),
        ("beam.length_mm", 300, ("unknown parameter beam.length_mm", "beam.length [m]")),
        ("zzz.qqq", 1, ("unknown parameter zzz.qqq", "beam model --parameters")),
    ],
)
def test_a_wrong_parameter_is_told_with_its_name_value_expectation_and_remedy(
    name: str, value: object, words: tuple[str, ...]
) -> None:
    with pytest.raises(ParameterFileError) as caught:
        check_parameters({name: value})
    assert "\n" not in str(caught.value)
    for word in words:
        assert word in str(caught.value)


def test_whole_numbers_pass_for_numbers_and_bare_off_for_the_word() -> None:
    checked = check_parameters({"beam.length": 1, "beam.gravity": False})
    assert checked == {"beam.length": 1.0, "beam.gravity": "off"}
    assert isinstance(checked["beam.length"], float)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"markers.heights": [0.01, 0.2]}, "markers.heights has 2 entries for 3 markers"),
        ({"markers.heights": [0.2, 0.1, 0.25]}, "expected heights that rise"),
        ({"markers.heights": [0.01, 0.2, 0.31]}, "above the tip"),
        ({"markers.names": ["a", "a", "b"]}, "every name once"),
        ({"excitation.start_frequency": 100.0}, "start below the end"),
    ],
)
def test_parameters_that_do_not_go_together_are_refused(change: dict[str, object], words: str) -> None:
    with pytest.raises(ParameterFileError, match=words):
        Rig.from_file().with_values(change)


@pytest.mark.parametrize(
    ("name", "limit"),
    [  # of a hub with 100 mm of travel, 0.5 m/s and 10 m/s^2
        ("hub.homing_speed", 0.5),
        ("excitation.acceleration", 10.0),
        ("excitation.max_displacement", 0.05),
        ("excitation.step_size", 0.05),
        ("excitation.step_size", -0.05),
        ("excitation.max_velocity", 0.5),
        ("excitation.speed", 0.5),
        ("excitation.waypoints", -0.05),
    ],
)
def test_what_the_hub_cannot_do_is_refused_where_it_is_asked_for(name: str, limit: float) -> None:
    def value(size: float) -> object:
        return [0.01, size, 0.0] if name == "excitation.waypoints" else size

    rig = Rig.from_file().with_values({"hub.travel": 0.1, "hub.max_speed": 0.5, "hub.max_acceleration": 10.0})
    rig.with_values({name: value(limit)})
    with pytest.raises(ParameterFileError, match=f"{name} is .*: expected at most {abs(limit):g} "):
        rig.with_values({name: value(1.001 * limit)})


_ANYTHING = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=4),
    max_leaves=6,
)


@given(st.sampled_from(sorted(RIG_PARAMETERS)), _ANYTHING)
def test_any_value_is_either_taken_in_its_type_or_refused(name: str, value: object) -> None:
    kind = RIG_PARAMETERS[name].kind
    with contextlib.suppress(ParameterFileError):
        checked = check_parameters({name: value})
        assert isinstance(checked[name], get_origin(kind) or kind)


LIMITED = [row for row in RIG_PARAMETERS.values() if row.minimum is not None and row.maximum is not None]


def test_every_range_takes_its_ends_and_its_default_and_refuses_what_lies_beyond_by_name() -> None:
    defaults = packaged_defaults()
    for row in LIMITED:
        kind = get_args(row.kind)[0] if get_origin(row.kind) else row.kind
        for end, beyond in ((row.minimum, -math.inf), (row.maximum, math.inf)):
            # What is no list is taken as the only element of one.
            inside = kind(end)
            outside = (
                inside + int(math.copysign(1, beyond)) if kind is int else math.nextafter(inside, beyond)
            )
            assert row.minimum <= inside <= row.maximum
            check_parameters({row.name: [inside] if get_origin(row.kind) else inside})
            with pytest.raises(ParameterFileError, match=re.escape(row.expectation())):
                check_parameters({row.name: [outside] if get_origin(row.kind) else outside})
        check_parameters({row.name: defaults[row.name]})


PREPOSITIONS = {"of", "from", "while", "between", "below", "above", "per", "by", "until", "on", "in", "for"}


def test_every_description_names_a_thing_and_says_what_limits_it() -> None:
    """Read alone, in `ros2 param describe`, "of the multisine" says nothing."""
    for parameter in RIG_PARAMETERS.values():
        assert parameter.description.split()[0] not in PREPOSITIONS, parameter.name
        assert not parameter.unit or f"[{parameter.unit}]" in parameter.meaning(), parameter.name
    assert RIG_PARAMETERS["excitation.acceleration"].meaning().endswith("; limited by hub.max_acceleration")
    assert RIG_PARAMETERS["excitation.step_size"].meaning().endswith("; limited by 0.5 times hub.travel")


@pytest.mark.parametrize(
    ("name", "meant"),
    [
        ("excitation.amplitude", "excitation.amplitudes"),
        ("hub.travle", "hub.travel"),
        ("hub.exposure", "camera.exposure"),
        ("excitation.xyz", ""),
        ("hub.colour", ""),
        ("nonsense", ""),
    ],
)
def test_a_name_is_suggested_where_one_is_near_and_none_where_only_the_group_is(
    name: str, meant: str
) -> None:
    assert likeliest(name, RIG_PARAMETERS) == meant
