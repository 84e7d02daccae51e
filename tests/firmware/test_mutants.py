"""The table of the core's defects fits the core, and the conformance suite finds them."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

from tests.firmware.builds import FIRMWARE
from tests.firmware.mutants import MUTANTS, Workshop, killer


def test_every_defect_has_its_own_name_and_one_place_in_the_core():
    assert max(Counter(mutant.name for mutant in MUTANTS).values()) == 1
    text = {file.name: file.read_text() for file in (FIRMWARE / "core").iterdir()}
    assert {m.name for m in MUTANTS if text[m.file].count(m.before) != 1 or m.before == m.after} == set()


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        "frames that do not fit feed the watchdog",
        "homing is twice as fast",
        "homing accelerates ten times as much",
        "the end switch at -x is ignored",
    ],
)
def test_the_suite_finds_a_defect(tmp_path: Path, name: str):
    (mutant,) = [mutant for mutant in MUTANTS if mutant.name == name]
    program = Workshop(tmp_path / "workshop").build(mutant)
    assert program is not None
    assert killer(program)


@pytest.mark.verify
def test_the_suite_finds_every_defect_that_can_be_seen(tmp_path: Path):
    workshop = Workshop(tmp_path / "workshop")
    found = {}
    for mutant in MUTANTS:
        program = workshop.build(mutant)
        found[mutant.name] = program is not None and bool(killer(program))
    assert {name for name, is_found in found.items() if not is_found} == {
        m.name for m in MUTANTS if m.equivalent
    }
