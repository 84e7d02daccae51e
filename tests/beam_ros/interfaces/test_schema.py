"""The one schema: what may be in a rig file, and how a wrong one is told."""

from __future__ import annotations

import contextlib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from beam_ros.errors import ParameterFileError
from beam_ros.interfaces import schema


def test_the_packaged_rig_gives_a_default_for_every_parameter_and_nothing_else() -> None:
    defaults = schema.packaged_defaults()
    assert set(defaults) == set(schema.RIG_PARAMETERS)
    schema.check_relations(defaults)


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
        schema.check_parameters({name: value})
    assert "\n" not in str(caught.value)
    for word in words:
        assert word in str(caught.value)


def test_whole_numbers_pass_for_numbers_and_bare_off_for_the_word() -> None:
    checked = schema.check_parameters({"beam.length": 1, "beam.gravity": False})
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
    values = {**schema.packaged_defaults(), **schema.check_parameters(change)}
    with pytest.raises(ParameterFileError, match=words):
        schema.check_relations(values)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "holds no parameters"),
        ("a: [1, 2", "no valid YAML"),
        ("beam: {length: 0.3}", "no set of ROS parameters"),
        ("/tracker: {ros__parameters: {camera: {rate: 50.0}}}", "`/**` alone"),
        ("/**: {ros__parameters: {beam: {length: -1.0}}}", "beam.length is -1.0 m"),
        ("/**: {ros__parameters: {beam: {lenght: 1.0}}}", "did you mean"),
        ("/**: {ros__parameters: }", "empty"),
    ],
)
def test_a_wrong_file_is_told_in_one_line_with_its_path(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text(text)
    with pytest.raises(ParameterFileError) as caught:
        schema.parameters_in_file(path)
    message = str(caught.value)
    assert str(path) in message
    assert words in message
    assert "\n" not in message


def test_a_missing_file_is_told(tmp_path: Path) -> None:
    with pytest.raises(ParameterFileError, match="no such file"):
        schema.parameters_in_file(tmp_path / "nowhere.yaml")


_ANYTHING = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=4),
    max_leaves=6,
)


@given(st.sampled_from(sorted(schema.RIG_PARAMETERS)), _ANYTHING)
def test_any_value_is_either_taken_in_its_type_or_refused(name: str, value: object) -> None:
    types = {"bool": bool, "int": int, "float": float, "str": str, "floats": list, "strs": list}
    with contextlib.suppress(ParameterFileError):
        checked = schema.check_parameters({name: value})
        assert isinstance(checked[name], types[schema.RIG_PARAMETERS[name].kind])
