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


def run_core_only(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run the command in an interpreter that has nothing but the pure core."""
    return subprocess.run(
        [sys.executable, "-c", CORE_ONLY + RUN, *arguments],
        cwd=folder,
        env=child_environment(),
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


@pytest.mark.parametrize("verb", VERBS)
def test_the_help_of_every_verb_needs_the_pure_core_alone(tmp_path: Path, verb: str) -> None:
    ended = run_core_only(tmp_path, "beam", verb, "--help")
    assert (ended.returncode, ended.stderr) == (0, "")
    assert f"beam {verb}" in ended.stdout


SHORT = ("-p", "excitation.duration:=6.0", "-p", "excitation.still:=2.0")
OFFLINE_VERBS = {
    "model": (),
    "design": (),
    "simulate": ("--bag", "bag", *SHORT),
    "info": ("bag",),
    "export": ("bag", "--csv", "folder"),
    "recover": ("bag", "--to", "whole"),
    "check": ("bag",),
    "study": ("bag", "--csv", "--modes", "1", "--out", "rows"),
    "compare": ("bag", "bag", "--modes", "1"),
    "identify": ("bag", "--report", "report", "--json"),
}


def test_every_verb_that_the_readme_promises_without_ros_needs_the_pure_core_alone(tmp_path: Path) -> None:
    readme = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
    sentence = re.search(r"The verbs\s([^.]*?) need\s+no ROS", readme)
    assert sentence is not None
    assert set(re.findall(r"`(\w+)`", sentence.group(1))) == set(OFFLINE_VERBS)
    for verb, arguments in OFFLINE_VERBS.items():
        ended = run_core_only(tmp_path, "beam", verb, *arguments)
        assert ended.returncode == 0, ended.stderr
        assert "Traceback" not in ended.stderr
    assert json.loads(ended.stdout)["modes"]
    assert "<svg" in (tmp_path / "report" / "report.html").read_text(encoding="utf-8")


def test_what_needs_ros_says_so_in_one_line(tmp_path: Path) -> None:
    for arguments in (("simulator",), ("beam", "run", "simulator"), ("beam", "demo")):
        ended = run_core_only(tmp_path, *arguments)
        assert ended.returncode == 2, ended.stderr
        assert ended.stderr.count("\n") == 1, ended.stderr
        assert "rclpy" in ended.stderr
        assert "make setup" in ended.stderr


@pytest.mark.parametrize("package", ["beam_model", "beam_ident", "beam_ros", "beam_ros.hub", "beam_ros.bags"])
def test_the_pure_packages_import_nothing_but_the_core(tmp_path: Path, package: str) -> None:
    ended = subprocess.run(
        [sys.executable, "-c", f"{CORE_ONLY}\nABSENT.add('matplotlib')\nimport {package}"],
        cwd=tmp_path,
        env=child_environment(),
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert (ended.returncode, ended.stderr) == (0, "")
