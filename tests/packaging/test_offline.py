"""Without ROS 2, OpenCV and a serial library, whatever needs no graph works."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from beam_ros.cli.main import VERBS
from beam_ros.process.environment import child_environment

CORE_ONLY = """
import sys

ABSENT = {"rclpy", "cv2", "serial", "cobs", "pytest"}

class Blocker:
    def find_spec(self, name, path=None, target=None):
        top = name.partition(".")[0]
        if top in ABSENT or top.endswith(("_msgs", "_srvs", "_interfaces")):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        return None

sys.meta_path.insert(0, Blocker())
"""

RUN = """
from beam_ros.process.executables import run_executable
sys.exit(run_executable(sys.argv[1], sys.argv[2:]))
"""


def core_only(folder: Path, program: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run a program in an interpreter that has nothing but the pure core."""
    return subprocess.run(
        [sys.executable, "-c", CORE_ONLY + program, *arguments],
        cwd=folder,
        env=child_environment(),
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


@pytest.mark.slow
def test_the_help_of_every_verb_needs_the_pure_core_alone(tmp_path: Path) -> None:
    listed = (
        "from beam_ros.cli.main import VERBS, main\nsys.exit(max(main([verb, '--help']) for verb in VERBS))"
    )
    ended = core_only(tmp_path, listed)
    assert (ended.returncode, ended.stderr) == (0, "")
    for verb in VERBS:
        assert f"usage: beam {verb}" in ended.stdout


SHORT = (
    "-p",
    "excitation.duration:=2.0",
    "-p",
    "excitation.still:=1.0",
    "-p",
    "excitation.end_frequency:=20.0",
)
OFFLINE_VERBS = {
    "model": (),
    "design": (),
    "shape": ("--to", "0.01", "--aim", "1e-3", "--out", "quiet"),
    "simulate": ("--bag", "bag", *SHORT),
    "info": ("bag",),
    "export": ("bag", "--csv", "folder"),
    "recover": ("bag", "--to", "whole"),
    "check": ("bag",),
    "study": ("bag", "--csv", "--modes", "1", "--out", "rows"),
    "compare": ("bag", "bag", "--modes", "1"),
    "identify": ("bag", "--modes", "1", "--report", "report", "--json"),
}


@pytest.mark.slow
def test_every_verb_that_the_readme_promises_without_ros_needs_the_pure_core_alone(tmp_path: Path) -> None:
    readme = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
    sentence = re.search(r"The verbs\s([^.]*?) need\s+no ROS", readme)
    assert sentence is not None
    assert set(re.findall(r"`(\w+)`", sentence.group(1))) == set(OFFLINE_VERBS)
    calls = [[verb, *arguments] for verb, arguments in OFFLINE_VERBS.items()]
    one_after_another = (
        f"from beam_ros.cli.main import main\nfor call in {calls}: assert main(call) == 0, call"
    )
    ended = core_only(tmp_path, one_after_another)
    assert ended.returncode == 0, ended.stderr
    assert "Traceback" not in ended.stderr
    assert json.loads(ended.stdout[ended.stdout.rindex("\n{") :])["modes"]
    assert "<svg" in (tmp_path / "report" / "report.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_what_needs_ros_says_so_in_one_line(tmp_path: Path) -> None:
    for arguments in (("simulator",), ("beam", "run", "simulator"), ("beam", "demo")):
        ended = core_only(tmp_path, RUN, *arguments)
        assert ended.returncode == 2, ended.stderr
        assert ended.stderr.count("\n") == 1, ended.stderr
        assert "rclpy" in ended.stderr
        assert "make setup" in ended.stderr


@pytest.mark.slow
@pytest.mark.parametrize("package", ["beam_model", "beam_ident", "beam_ros", "beam_ros.hub", "beam_ros.bags"])
def test_the_pure_packages_import_nothing_but_the_core(tmp_path: Path, package: str) -> None:
    ended = core_only(tmp_path, f"ABSENT.add('matplotlib')\nimport {package}")
    assert (ended.returncode, ended.stderr) == (0, "")
