"""Copies of the tree and poisoned ROS prefixes for the packaging tests."""

from __future__ import annotations

import runpy
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.private_ros import executables, private_ros

__all__ = ["executables", "private_ros"]

ROOT = Path(__file__).parents[2]

_NOT_OURS = shutil.ignore_patterns(
    ".git",
    ".venv*",
    "build",
    "dist",
    "install",
    "log",
    "runs",
    "__pycache__",
    "*.egg-info",
    ".*_cache",
    ".hypothesis",
)


@pytest.fixture(scope="session")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the tree as a fresh clone has it; tests leave it as it is."""
    return copy_tree(tmp_path_factory.mktemp("clone") / "beam rig")


def copy_tree(target: Path) -> Path:
    """Copy what a clone would hold."""
    return Path(shutil.copytree(ROOT, target, ignore=_NOT_OURS))


@pytest.fixture
def setup_arguments(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """The arguments that setup.py gives to setuptools."""
    import setuptools

    given: dict[str, Any] = {}
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr(setuptools, "setup", lambda **arguments: given.update(arguments))
    runpy.run_path("setup.py")
    return given


@pytest.fixture
def foreign_ros(tmp_path: Path) -> dict[str, str]:
    """Variables of a sourced ROS 2 whose every module and library fails when it is loaded."""
    prefix = tmp_path / "opt" / "ros" / "jazzy"
    packages = prefix / "lib" / "python3" / "site-packages"
    for module in ("rclpy", "numpy", "rosbags", "std_msgs", "sensor_msgs", "rcl_interfaces"):
        (packages / module).mkdir(parents=True)
        (packages / module / "__init__.py").write_text(
            f"raise RuntimeError('foreign {module} was imported')\n"
        )
    for library in ("librcl.so", "librcutils.so", "librmw_fastrtps_cpp.so", "librmw_implementation.so"):
        (prefix / "lib" / library).write_text("no library\n")
    return {
        "PYTHONPATH": str(packages),
        "LD_LIBRARY_PATH": str(prefix / "lib"),
        "AMENT_PREFIX_PATH": str(prefix),
        "COLCON_PREFIX_PATH": str(prefix),
        "ROS_DISTRO": "jazzy",
        "ROS_VERSION": "2",
        "ROS_PYTHON_VERSION": "3",
        "RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp",
    }


FAKE = """
import platform, runpy, sys, sysconfig
{changes}
sys.executable = {path!r}
sys.path[:0] = {modules!r}
if sys.argv[1] == "-c":
    exec(sys.argv[2])
else:
    del sys.argv[0]
    runpy.run_path(sys.argv[0], run_name="__main__")
"""


@pytest.fixture
def fake_python(tmp_path: Path) -> Callable[..., Path]:
    """Write interpreters that are this one but for some facts about it, and that see no installed packages."""

    def write(changes: str = "", name: str = "python-fake", modules: Path | None = None) -> Path:
        path = tmp_path / "bin" / name
        path.parent.mkdir(exist_ok=True)
        fit = (
            "platform.system = lambda: 'Linux'; platform.machine = lambda: 'x86_64'; "
            "platform.libc_ver = lambda: ('glibc', '2.39'); "
        )
        facts = {"changes": fit + changes, "path": str(path), "modules": [str(modules)] if modules else []}
        path.with_suffix(".py").write_text(FAKE.format(**facts))
        path.write_text(f"#!/bin/sh\nexec '{sys.executable}' -S '{path.with_suffix('.py')}' \"$@\"\n")
        path.chmod(0o755)
        return path

    return write
