"""Signals as people write them."""

from __future__ import annotations

from pathlib import Path

import pytest

from beam_ros.errors import ParameterFileError, UsageError
from beam_ros.signals.descriptions import Signals, SignalSource


def test_a_text_gives_topic_field_and_options() -> None:
    found = SignalSource.of(
        "/imu:linear_acceleration.x,kind=accelerance,delay=2e-3,sd=0.02,scale=-9.81", False
    )
    assert (found.topic, found.field) == ("/imu", "linear_acceleration.x")
    assert (found.delay, found.sd, found.scale) == (2e-3, 0.02, -9.81)
    assert found.title == "imu:linear_acceleration.x"
    assert SignalSource.of("/j:position[a,b],hold=linear", True).field == "position[a,b]"


@pytest.mark.parametrize(
    ("text", "as_input", "as_output", "held"),
    [
        ("/j:position[axis]", "position", "receptance", "cubic"),
        ("/j:velocity[axis]", "velocity", "mobility", "cubic"),
        ("/j:effort[axis]", "force", "receptance", "zoh"),
        ("/w:wrench.force.x", "force", "receptance", "zoh"),
        ("/imu:linear_acceleration.x", "acceleration", "accelerance", "cubic"),
    ],
)
def test_what_a_field_measures_is_known_by_its_name(
    text: str, as_input: str, as_output: str, held: str
) -> None:
    assert SignalSource.of(text, True).input_kind == as_input
    assert SignalSource.of(text, True).held == held
    assert SignalSource.of(text, False).output_kind == as_output


@pytest.mark.parametrize(
    ("text", "is_input", "words"),
    [
        ("/imu", False, "names no field"),
        (":x", False, "names no field"),
        ("/imu:x,kind=position", False, "one of receptance, mobility, accelerance"),
        ("/imu:x,kind=accelerance", True, "one of position, velocity, acceleration, force"),
        ("/imu:x,hold=zoh", False, "unknown option 'hold' of an output"),
        ("/imu:x,dely=1", False, "did you mean delay"),
        ("/imu:x,delay=soon", False, "seconds by which"),
        ("/imu:x,sd=0", False, "> 0"),
        ("/imu:x,scale=0", False, "not 0"),
        ("/imu:x,exposure=-1", False, ">= 0"),
        ("/imu:x,low_pass=0", False, "a frequency > 0 in Hz"),
        ("/imu:x,low_pass=30,order=3", False, "one of 1, 2"),
        ("/imu:x,order=2", False, "expected low_pass beside it"),
        ("/imu:x,sd", False, "option=value"),
    ],
)
def test_a_wrong_text_is_refused_with_what_is_expected(text: str, is_input: bool, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        SignalSource.of(text, is_input)


def test_a_file_holds_the_same_signals_and_texts_stand_before_it(tmp_path: Path) -> None:
    file = tmp_path / "signals.yaml"
    file.write_text(
        "input: /joint_states:position[axis]\n"
        "outputs:\n"
        "  - /laser/range:range,delay=0.002\n"
        "  - {topic: /imu, field: linear_acceleration.x, sd: 0.02}\n"
    )
    kept = Signals.of(file=file)
    assert kept == Signals.of(
        "/joint_states:position[axis]",
        ["/laser/range:range,delay=0.002", "/imu:linear_acceleration.x,sd=0.02"],
    )
    other = Signals.of("/joint_states:velocity[axis]", file=file)
    assert other.drive is not None
    assert other.drive.field == "velocity[axis]"
    assert other.outputs == kept.outputs


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("- 1", "expected `input`"),
        ("inputs: /a:b", "did you mean input"),
        ("outputs: /a:b", "expected a list"),
        ("outputs: [{topic: /a}]", "topic and field"),
        ("outputs: [/a:b, /a:b]", "two signals have the name"),
        ("input: [", "no YAML"),
    ],
)
def test_a_wrong_file_is_refused_by_its_name(tmp_path: Path, text: str, words: str) -> None:
    file = tmp_path / "signals.yaml"
    file.write_text(text)
    with pytest.raises((ParameterFileError, UsageError), match=words):
        Signals.of(file=file)
