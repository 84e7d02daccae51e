"""What the firmware's headers repeat is what the suite's tables say; no compiler is needed to see it."""

from __future__ import annotations

import re

from beam_ros.hub.faults import DEVICE_FAULTS
from beam_ros.hub.line import protocol
from beam_ros.hub.simulated.transitions import CONDITIONS, TRANSITIONS
from beam_ros.rig.rig import Rig
from tests.firmware.builds import FIRMWARE

CORE = FIRMWARE / "core"


def numbers(enumeration: str, header: str) -> dict[str, int]:
    """The names of an enumeration that gives every number."""
    body = re.search(rf"enum class {enumeration}\b[^{{]*{{(.*?)}}", (CORE / header).read_text(), re.S)
    assert body is not None
    return {name: int(number) for name, number in re.findall(r"(\w+) = (\d+)", body[1])}


def plain(words: str) -> str:
    return re.sub(r"[ -]", "_", words)


def test_the_cores_faults_are_those_of_the_table():
    assert numbers("Fault", "faults.hpp") == {"none": 0, **{row.name: row.number for row in DEVICE_FAULTS}}


def test_the_cores_transitions_are_those_of_the_table_row_by_row():
    text = (CORE / "transitions.hpp").read_text()
    rows = re.findall(r"^    (row|refused)\(in\({(.*?)}\), on\({(.*?)}\), (.*)\),$", text, re.M)
    found = []
    for kind, origins, causes, rest in rows:
        answer = re.search(r'"(.*)"$', rest)
        goal, effects = (None, "") if kind == "refused" else re.match(r"C::(\w+), ([\w |]+)", rest).groups()
        found.append(
            (
                {name.removeprefix("C::") for name in origins.split(", ")},
                {name.removeprefix("K::") for name in causes.split(", ")},
                None if goal == "same" else goal,
                [] if effects in ("", "0") else effects.split(" | "),
                answer[1] if answer else "",
                kind == "refused",
            )
        )
    expected = [
        (
            {plain(condition.name) for condition in row.origins},
            {plain(cause) for cause in row.causes},
            None if row.goal is None else plain(row.goal.name),
            [plain(effect) for effect in row.effects],
            row.answer,
            row.is_refused,
        )
        for row in TRANSITIONS
    ]

    def sort(row):
        return sorted(row[0]), sorted(row[1])

    assert sorted(found, key=sort) == sorted(expected, key=sort)


def test_the_core_does_effects_in_the_order_in_which_the_table_names_them():
    text = (CORE / "transitions.hpp").read_text()
    order = re.findall(r"(\w+) = 1U << \d+U", text)
    for row in TRANSITIONS:
        places = [order.index(plain(effect)) for effect in row.effects]
        assert places == sorted(places)


def test_the_cores_conditions_look_as_the_tables_do():
    text = (CORE / "transitions.hpp").read_text()
    rows = re.findall(r'{State::(\w+), Activity::(\w+), "(.*?)"}', text)
    assert rows == [(c.state, c.activity, str(c)) for c in CONDITIONS]


def test_the_cores_message_types_are_those_of_the_codec():
    text = (CORE / "core.cpp").read_text()
    body = re.search(r"enum Type[^{]*{(.*?)}", text, re.S)[1]
    number, found = 0, {}
    for name, value in re.findall(r"(\w+)(?: = (0x\w+))?,", body):
        number = int(value, 16) if value else number + 1
        found[name] = number
    assert found == {name: getattr(protocol, name.upper()) for name in found}
    assert len(found) == 16


def test_the_default_rig_of_the_firmware_is_the_packaged_one():
    text = (FIRMWARE / "plant" / "default_rig.hpp").read_text().replace("'", "")
    found = dict(re.findall(r"settings\.([\w.]+) = ([^;]+);", text))
    axis = Rig.from_file().axis_parameters()
    limits = vars(protocol.DeviceLimits.of(axis))
    assert {name.removeprefix("widest."): float(v) for name, v in found.items() if "widest" in name} == limits
    assert int(found["period_ns"]) == axis.period_ns
    assert int(found["batch_ticks"]) == axis.batch_ticks
    assert found["mode"] == f"CommandMode::{axis.command_mode}"
    assert float(found["encoder_resolution"]) == axis.encoder_resolution
