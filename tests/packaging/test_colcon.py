"""The tree as a package of a ROS 2 workspace: colcon builds it, and what it installs runs."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from beam_ros.process.environment import child_environment
from beam_ros.process.executables import MODULES
from tests.packaging.conftest import ROOT, copy_tree
from tests.real_processes import MARK, marked_processes

pytestmark = pytest.mark.slow

VERSION = "99.1.2"
"""Given to the copy, so that it cannot be mistaken for the tree that the tests' environment has installed."""


@pytest.fixture(scope="module", params=[(), ("--symlink-install",)], ids=["copied", "symlinked"])
def workspace(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A workspace with this package built in it; its folder."""
    folder = tmp_path_factory.mktemp("workspace")
    source = copy_tree(folder / "src" / "beam")
    for name in ("setup.py", "package.xml"):
        text = (source / name).read_text()
        assert text.count("0.1.0") == 1
        (source / name).write_text(text.replace("0.1.0", VERSION))
    variables = child_environment({"COLCON_LOG_PATH": str(folder / "log")})
    for name in ("PYTHONDONTWRITEBYTECODE", "AMENT_PREFIX_PATH"):  # of which setuptools and colcon would warn
        variables.pop(name, None)
    built = subprocess.run(
        [sys.executable, "-m", "colcon", "build", *request.param],
        cwd=folder,
        env=variables,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert (built.returncode, built.stderr) == (0, "")
    assert "1 package finished" in built.stdout
    return folder


def in_workspace(workspace: Path, line: str, **environment: str) -> subprocess.Popen[str]:
    """Start a shell line where the workspace has been sourced, as `ros2 run` would find its executables."""
    executables = workspace / "install" / "beam_ros" / "lib" / "beam_ros"
    return subprocess.Popen(
        ["bash", "-c", f'. install/setup.bash && PATH="{executables}:$PATH" && {line}'],
        cwd=workspace,
        env=child_environment(environment),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def test_ros2_finds_the_package_its_files_and_its_executables(
    workspace: Path, request: pytest.FixtureRequest
) -> None:
    prefix = workspace / "install" / "beam_ros"
    for path in (
        "share/ament_index/resource_index/packages/beam_ros",
        "share/beam_ros/package.xml",
        "share/beam_ros/launch/record.launch.py",
        "share/beam_ros/launch/replay.launch.py",
        "share/beam_ros/launch/rig.launch.py",
        "share/beam_ros/config/rig.yaml",
        "share/beam_ros/config/large_messages.xml",
        "share/beam_ros/config/70-beam-axis.rules",
        "share/beam_ros/viewers/plotjuggler.xml",
    ):
        assert (prefix / path).is_file(), path
    executables = [path for path in (prefix / "lib" / "beam_ros").iterdir() if os.access(path, os.X_OK)]
    assert {path.name for path in executables} == set(MODULES)
    can_block = (
        subprocess.call(["/usr/bin/env", "--block-signal=INT", "true"], stderr=subprocess.DEVNULL) == 0
    )
    # In a linked workspace newer setuptools let pip write the scripts, with first lines of its own.
    if can_block and request.node.callspec.id == "copied":
        assert all("--block-signal=INT" in path.read_text().partition("\n")[0] for path in executables)


def test_the_command_that_runs_is_the_workspaces_own(workspace: Path) -> None:
    process = in_workspace(workspace, "beam --version && beam model")
    stdout, stderr = process.communicate(timeout=60)
    assert (process.returncode, stderr) == (0, "")
    assert stdout.startswith(f"beam {VERSION}\n")


def test_colcon_test_runs_what_make_test_runs(workspace: Path) -> None:
    def selected(words: list[str], folder: Path) -> list[str]:
        listed = subprocess.run(
            [sys.executable, "-m", *words],
            cwd=folder,
            env=child_environment({"COLCON_LOG_PATH": str(workspace / "log")}),
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )
        assert listed.returncode == 0, listed.stdout + listed.stderr
        return re.findall(r"\d+/\d+ tests collected \(\d+ deselected\)", listed.stdout)

    some = ["tests/beam_ident/noise", "--collect-only", "-q"]
    by_colcon = ["colcon", "test", "--event-handlers", "console_direct+", "--pytest-args", *some]
    assert selected(by_colcon, workspace) == selected(["pytest", *some], ROOT) != []


@pytest.mark.ros
def test_a_node_of_the_workspace_runs_and_ends_on_ctrl_c(workspace: Path) -> None:
    mark = str(workspace)
    process = in_workspace(workspace, "exec simulator --ros-args -r __ns:=/built", **{MARK: mark})
    try:
        wait_for_log(process.pid)
        process.send_signal(signal.SIGINT)
        stdout, stderr = process.communicate(timeout=20)
    finally:
        for pid in marked_processes(mark):
            os.kill(pid, signal.SIGKILL)
    assert process.returncode == 0, stdout + stderr
    assert "Traceback" not in stdout + stderr


def test_colcon_does_not_look_into_the_environment_of_the_recipe(tmp_path: Path) -> None:
    """Neither into the workspace's nor into the tree's own; into a folder of another name it does look."""
    recipe = re.search(r"-m venv --system-site-packages (\S+)", (ROOT / "README.md").read_text())
    assert recipe is not None
    source = tmp_path / "src" / "beam_ros"
    source.mkdir(parents=True)
    for name in ("setup.py", "package.xml", "README.md"):
        (source / name).write_text((ROOT / name).read_text())
    for environment in (tmp_path / recipe.group(1), source / ".venv", tmp_path / "other"):
        package = environment / "lib" / "installed"
        package.mkdir(parents=True)
        (package / "package.xml").write_text(
            (ROOT / "package.xml").read_text().replace("beam_ros", f"in_{environment.name.strip('.')}")
        )
    listed = subprocess.run(
        [sys.executable, "-m", "colcon", "--log-base", str(tmp_path / "log"), "list", "--names-only"],
        cwd=tmp_path,
        env=child_environment(),
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert listed.stdout.split() == ["beam_ros", "in_other"], listed.stderr


def wait_for_log(pid: int) -> None:
    """Wait until a node has joined the graph: it then has its own sockets for DDS."""
    end = time.monotonic() + 20
    while time.monotonic() < end:
        threads = [path.read_text().strip() for path in Path(f"/proc/{pid}/task").glob("*/comm")]
        if any(name.startswith("dds.") for name in threads):
            time.sleep(0.5)
            return
        time.sleep(0.05)
    raise AssertionError(f"process {pid} joined no graph within 20 s")
