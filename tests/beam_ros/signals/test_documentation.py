"""The page "Add a sensor" says what there is."""

from __future__ import annotations

from pathlib import Path

import pytest

from beam_ros.interfaces.parameter import Parameter, parameters_of
from beam_ros.interfaces.rig_parameters import IdentifierSettings
from beam_ros.signals import descriptions

PAGE = (Path(__file__).parents[3] / "docs" / "sensors.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "row", list(parameters_of(IdentifierSettings, "identifier")), ids=lambda row: row.name
)
def test_the_page_lists_every_option_as_the_table_of_parameters_has_it(row: Parameter) -> None:
    words = f" ({', '.join(row.choices)})" if row.choices else ""
    assert f"| `{row.name}` | {row.description}{words} |" in PAGE


def test_the_page_lists_every_option_of_a_signal() -> None:
    for word in {*descriptions._INPUT_OPTIONS, *descriptions._OUTPUT_OPTIONS}:
        assert f"\n| `{word}` |" in PAGE
    for word in (*descriptions.INPUT_KINDS, *descriptions.SENSORS):
        assert f"`{word}`" in PAGE


def test_the_signals_of_the_page_can_be_read(tmp_path: Path) -> None:
    block = PAGE.partition("```yaml\n")[2].partition("```")[0]
    file = tmp_path / "signals.yaml"
    file.write_text(block)
    assert len(descriptions.Signals.of(file=file).outputs) == 2
