"""The tutorials, followed word by word in an empty folder: their commands run, and give what the pages state."""

from __future__ import annotations

import contextlib
import io
import os
import re
import shlex
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.pages import run_page
from tests.real_processes import Executables, RunningExecutable

PAGES = Path(__file__).parents[2] / "docs" / "tutorials"
NUMBER = r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]\d+)?"


def blocks(page: str, kind: str) -> list[str]:
    """Return the blocks of one kind of a page."""
    text = (PAGES / f"{page}.md").read_text(encoding="utf-8")
    return re.findall(rf"^```{kind}\n(.*?)^```", text, re.M | re.S)


def run_code(page: str) -> str:
    """Run the Python of a page from top to bottom, and return what it prints."""
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        run_page(f"tutorials/{page}.md")
    return printed.getvalue()


def run_commands(page: str, folder: Path) -> str:
    """Run the commands of a page in a folder, in a shell, and return what they print."""
    path = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
    printed = ""
    for block in blocks(page, "sh"):
        ended = subprocess.run(
            ["bash", "-ec", block],
            cwd=folder,
            env={**os.environ, "PATH": path},
            capture_output=True,
            text=True,
            timeout=300.0,
            check=False,
        )
        assert ended.returncode == 0, f"{block}{ended.stdout}{ended.stderr}"
        printed += ended.stdout
    return printed


def assert_agree(stated: str, printed: str, rel: float) -> None:
    """Fail where no line has the words of the page, and its numbers as far as other versions of SciPy repeat them."""
    words = re.escape(re.sub(NUMBER, "N", stated.strip())).replace(r"\ ", " ")
    pattern = re.sub(r" +", " +", words).replace("N", f"({NUMBER})")
    wanted = pytest.approx([float(number) for number in re.findall(NUMBER, stated)], rel=rel, abs=1e-5)
    found = [[float(number) for number in match.groups()] for match in re.finditer(pattern, printed)]
    assert any(numbers == wanted for numbers in found), f"{stated!r} is not printed in\n{printed}"


def test_a_tutorial_is_short_and_ends_with_a_result() -> None:
    pages = sorted(PAGES.glob("*.md"))
    assert len(pages) == 5
    for page in pages:
        text = page.read_text(encoding="utf-8")
        assert len(text.splitlines()) <= 150
        assert "## The result" in text
        assert text.count("](../pictures/") >= 2


@pytest.mark.slow
def test_the_first_identification_finds_the_two_modes_that_it_states(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    printed = run_code("first-identification")
    stated = [line for block in blocks("first-identification", "text") for line in block.splitlines()]
    stated = [line for line in stated if line.startswith("mode ")]
    assert len(stated) == 2
    for line in stated:
        assert_agree(line.split(" +- ")[0], printed, rel=1e-5)
    assert "tip good prediction" in printed


@pytest.mark.slow
def test_from_a_bag_to_a_report_gives_the_modes_of_the_page(tmp_path: Path) -> None:
    printed = run_commands("bag-to-report", tmp_path)
    text = (PAGES / "bag-to-report.md").read_text(encoding="utf-8")
    stated = [line.split() for line in text.splitlines() if line.startswith("    ") and "+-" in line]
    rows = {line.split()[0]: line.split() for line in printed.splitlines() if re.match(r" +\d +\d", line)}
    assert len(stated) == 2
    for number, frequency, *_ in stated:
        assert float(rows[number][1]) == pytest.approx(float(frequency), rel=1e-5)
    assert "can be identified: yes" in printed
    assert "The model can be relied on" in printed
    for path in (
        "report/report.html",
        "report/model.json",
        "compared",
        "study/study.csv",
        "study/index.html",
    ):
        assert (tmp_path / path).exists()


@pytest.mark.slow
def test_the_quiet_move_leaves_a_thousandth_of_the_swing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    printed = run_commands("curves-and-a-quiet-move", tmp_path)
    stated = blocks("curves-and-a-quiet-move", "text")
    assert_agree(stated[0].splitlines()[0], printed, rel=0.02)
    for line in stated[1].splitlines():
        assert_agree(line, printed, rel=0.05)
    monkeypatch.chdir(tmp_path)
    left = run_code("curves-and-a-quiet-move")
    swings = [float(number) for number in re.findall(r"'z285': '(\d+) um'", left)]
    assert swings[0] == pytest.approx(9961.0, rel=0.02)
    assert 7.57 - 0.5 <= swings[1] <= 19.9 + 0.5  # the interval that the page states, to a rounded micrometre


def assert_ended(ended: RunningExecutable) -> None:
    """Fail where a command failed, unless other programs had the processors that real time needs."""
    if ended.wait() != 0 and re.search(
        r"end other programs|expected at least half of the samples", ended.output()
    ):
        pytest.skip(f"this computer is too busy for real time: {ended.name}")
    assert ended.wait() == 0, ended.output()


@pytest.mark.ros
@pytest.mark.slow
def test_the_whole_rig_runs_as_the_tutorial_conducts_it(executables: Executables, tmp_path: Path) -> None:
    demo, model, design, rig, calls, bag, identify = (
        [shlex.split(line)[1:] for line in block.splitlines()]
        for block in blocks("rig-without-hardware", "sh")
    )
    for words in (*demo, *model, *design):
        assert_ended(executables.run("beam", *words))
    up = executables.start("beam", *rig[0], timeout_s=240.0)
    up.wait_for("rig up", 60.0)
    for words in calls:
        assert_ended(executables.run("beam", *words, timeout_s=90.0))
    up.wait_for("has run to its end", 120.0)
    up.send_signal(signal.SIGINT)
    assert up.wait() == 0, up.output()
    for words in (*bag, *identify):
        ended = executables.run("beam", *words)
        assert_ended(ended)
    assert re.search(r" 1 +4\.3839", ended.output())
    assert (tmp_path / "first-report" / "report.html").is_file()


@pytest.mark.ros
@pytest.mark.slow
def test_an_axis_and_a_camera_are_connected_as_the_tutorial_does_it(
    executables: Executables, tmp_path: Path
) -> None:
    emulator, *others = (
        [shlex.split(line)[1:] for line in block.splitlines()] for block in blocks("axis-and-camera", "sh")
    )
    running = executables.start("beam", *emulator[0], timeout_s=120.0)
    port = re.search(r"motion controller on (\S+)", running.wait_for("motion controller on"))[1]
    (tmp_path / "my_rig.yaml").write_text(blocks("axis-and-camera", "yaml")[0], encoding="utf-8")
    for words in (words for block in others for words in block):
        if running.process.poll() is None and port not in words and words[0] != "axis":
            running.send_signal(signal.SIGINT)
            assert running.wait() == 0
        assert_ended(executables.run("beam", *(port if word == "/dev/pts/0" else word for word in words)))
    assert (tmp_path / "probed.yaml").is_file()
    assert (tmp_path / "lab.yaml").is_file()
