"""Parameter files: what is read, and how a wrong file is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from beam_ros.errors import ParameterFileError
from beam_ros.interfaces.parameter_files import parameters_in_file


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
        parameters_in_file(path)
    message = str(caught.value)
    assert str(path) in message
    assert words in message
    assert "\n" not in message


def test_a_missing_file_is_told(tmp_path: Path) -> None:
    with pytest.raises(ParameterFileError, match="no such file"):
        parameters_in_file(tmp_path / "nowhere.yaml")
