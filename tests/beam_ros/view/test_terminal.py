"""The rig in a few lines of a terminal."""

from __future__ import annotations

import io
import re

import pytest

from beam_ros.messages import LiveIdentification
from beam_ros.process.strict_json import strict_json
from beam_ros.rig.rig import Rig
from beam_ros.view.losses import Loss
from beam_ros.view.scene import Cursor, Scene
from beam_ros.view.terminal import ChangingLines, log_line, status_lines
from tests.beam_ros.view.live_example import live_example


class Terminal(io.StringIO):
    """A terminal that somebody watches, as far as these lines need one."""

    def isatty(self) -> bool:
        return True

    def screen(self) -> list[str]:
        """What is to be seen: text, line feeds, CPL (up to the beginning of an earlier line) and ED (clear below)."""
        rows, at = [""], 0
        for text, up, _ in re.findall(r"([^\x1b\n]+|\n)|\x1b\[(\d+)F|(\x1b\[J)", self.getvalue()):
            if up:
                at -= int(up)
            elif text == "\n":
                at += 1
                rows += [""] * (at + 1 - len(rows))
            elif text:
                rows[at] += text
            else:
                rows[at:] = [""]
        return rows[:-1]


@pytest.fixture
def scene() -> Scene:
    return Scene(Rig.from_file(), source="rig", title="a rig")


def test_the_lines_say_what_the_page_says(scene):
    scene.show("axis", {"words": "switched on, a sequence runs", "mode": {}, "silent": False})
    scene.show("recorder", {"recording": True, "messages": 70, "lost": 0, "path": "a", "failure": ""})
    scene.show_losses([Loss("tracker", "camera frames that never came", 3), Loss("hub", "damaged frames", 0)])
    scene.show_live(LiveIdentification.from_json(strict_json(live_example())), 0.0)
    lines = "\n".join(status_lines(scene))
    for said in (
        "axis      switched on, a sequence runs",
        "hub       not known of ± 50 mm; tip against it not known of ± 30 mm",
        "recorder  70 messages, 0 lost, to a",
        "lost      3 camera frames that never came",
        "estimate  two modes so far.",
        "f1: reached",
        "zeta1: 41 s to go",
    ):
        assert said in lines
    assert "damaged" not in lines
    assert re.search(r"mode 1  4\.38\d{3} ± 0\.000\d\d Hz, damping 0\.5000 ± 0\.00\d\d %", lines), lines


def test_lines_change_in_place_and_what_is_said_stays_above_them():
    terminal = Terminal()
    lines = ChangingLines(terminal)
    lines.say("begun")
    lines.show(["axis idle", "hub 0"])
    lines.show(["axis moves", "hub 1", "lost 3"])
    lines.say("something happened")
    lines.show(["axis rests"])
    assert terminal.screen() == ["begun", "something happened", "axis rests"]


def test_a_line_that_is_too_long_is_cut_so_that_it_stays_one(monkeypatch):
    monkeypatch.setenv("COLUMNS", "20")
    terminal = Terminal()
    ChangingLines(terminal).show(["x" * 50])
    assert terminal.screen() == ["x" * 18 + "…"]


def test_where_output_is_kept_only_what_happened_is_printed(scene):
    kept = io.StringIO()
    lines, cursor = ChangingLines(kept), Cursor()
    scene.note("warning", "stop was asked for", 0.0)
    for _ in range(3):
        for entry in scene.new_entries(cursor):
            lines.say(log_line(entry))
        lines.show(status_lines(scene))
    assert re.fullmatch(r"\d\d:\d\d:\d\d  ! stop was asked for\n", kept.getvalue())
