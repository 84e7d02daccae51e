"""The set-up finds an interpreter that fits, says in one line what cannot work, and starts what is ready at once."""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from tests.packaging.conftest import ROOT, copy_tree

Interpreters = Callable[..., Path]

NO_INDEX = {"PIP_INDEX_URL": "http://127.0.0.1:9/simple", "PIP_CONFIG_FILE": os.devnull, "PIP_RETRIES": "1"}
"""pip's settings on a machine without a network."""


@pytest.fixture
def clone(tmp_path: Path) -> Path:
    """What the set-up reads of a tree, in a folder whose name has a blank."""
    root = tmp_path / "beam rig"
    shutil.copytree(ROOT / "beam_ros" / "process", root / "beam_ros" / "process")
    for name in ("bootstrap.py", "setup.py", "pyproject.toml", "beam_ros/__init__.py", "beam_ros/errors.py"):
        shutil.copy(ROOT / name, root / name)
    return root


@pytest.fixture(scope="module")
def bootstrap() -> ModuleType:
    """The set-up as a module."""
    spec = importlib.util.spec_from_file_location("bootstrap_under_test", ROOT / "bootstrap.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def call(
    clone: Path, *arguments: str, python: str = sys.executable, **environment: str
) -> subprocess.CompletedProcess[str]:
    """Run the set-up of a clone, with no ROS 2 sourced."""
    inherited = {name: value for name, value in os.environ.items() if name != "ROS_DISTRO"}
    return subprocess.run(
        [python, str(clone / "bootstrap.py"), *arguments],
        env=inherited | environment,
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )


def assert_refused(ended: subprocess.CompletedProcess[str], *parts: str) -> None:
    """One line on stderr that holds all parts, and status 2."""
    assert ended.returncode == 2, ended.stderr
    assert ended.stderr.startswith("bootstrap: ")
    assert ended.stderr.count("\n") == 1, ended.stderr
    for part in ("expected", *parts):
        assert part in ended.stderr


def version(text: str) -> str:
    """Facts of an interpreter of another version."""
    numbers = tuple(map(int, text.split(".")))
    return f"sys.version_info = {numbers}; platform.python_version = lambda: {text!r}"


@pytest.mark.first_case
@pytest.mark.parametrize(
    ("changes", "parts"),
    [
        (
            version("3.9.18"),
            ("3.9.18", "CPython 3.10 to 3.14", "--python", "pyenv install", "uv python install"),
        ),
        (version("3.15.0"), ("3.15.0", "CPython 3.10 to 3.14")),
        ("platform.python_implementation = lambda: 'PyPy'", ("PyPy", "CPython")),
        ("sysconfig.get_config_var = lambda name: name == 'Py_GIL_DISABLED'", ("without GIL",)),
        ("import importlib.util; importlib.util.find_spec = lambda name: None", ("venv", "sudo apt install")),
        ("platform.machine = lambda: 'aarch64'", ("aarch64", "/opt/ros/jazzy/setup.bash", "--extras none")),
        ("sys.maxsize = 2**31 - 1", ("32-bit", "x86-64")),
        ("platform.libc_ver = lambda: ('', '')", ("musl", "--extras none")),
        ("platform.libc_ver = lambda: ('glibc', '2.17')", ("glibc 2.17", "2.28")),
        ("platform.system = lambda: 'Darwin'", ("macOS", "--extras none")),
        ("platform.system = lambda: 'Windows'", ("Windows", "--extras none")),
    ],
)
def test_a_machine_that_cannot_run_ros_says_why_in_one_line(
    bootstrap: ModuleType, fake_python: Interpreters, changes: str, parts: tuple[str, ...]
) -> None:
    with pytest.raises(OSError, match="expected") as refusal:
        bootstrap.find_python(str(fake_python(changes)), is_for_wheels=True)
    text = str(refusal.value)
    assert "\n" not in text
    assert all(part in text for part in parts), text


@pytest.mark.parametrize("text", ["3.9.18", "3.15.0"])
def test_the_remedy_for_an_unfit_interpreter_names_another(fake_python: Interpreters, text: str) -> None:
    ended = call(ROOT, "--judge", "True", python=str(fake_python(version(text), name="python3")))
    remedy = ended.stdout.partition("expected CPython")[2]
    assert re.findall(r"python3?[ .]?\S*", remedy)
    assert not re.search(r"install python3?\b(?!\.)", remedy), "that is what is there already"
    assert text.rpartition(".")[0] not in remedy.replace("3.10 to 3.14", "")


@pytest.mark.parametrize("text", ["3.10.0", "3.14.0"])
def test_the_oldest_and_the_newest_interpreter_fit(
    bootstrap: ModuleType, fake_python: Interpreters, text: str
) -> None:
    path = str(fake_python(version(text)))
    assert bootstrap.find_python(path, is_for_wheels=True) == path


def test_what_needs_no_ros_is_for_every_platform(bootstrap: ModuleType, fake_python: Interpreters) -> None:
    path = str(fake_python("platform.machine = lambda: 'aarch64'; platform.libc_ver = lambda: ('', '')"))
    assert bootstrap.find_python(path, is_for_wheels=False) == path


@pytest.mark.slow
def test_what_the_command_line_cannot_mean_is_refused(clone: Path, fake_python: Interpreters) -> None:
    assert_refused(call(clone, "--python", "python9.9"), "python9.9")
    assert_refused(call(clone, "--python", "/bin/true"), "/bin/true", "CPython")
    assert_refused(call(clone, "--python", str(fake_python(version("3.9.18")))), "3.9.18")
    assert_refused(
        call(clone, "--extras", "ros,everything"),
        "'everything'",
        "rig,view,ros,dask,compiled,remote,study,files,test,dev,browser,docs, or none",
    )
    assert_refused(call(clone, "--constraint", "none.txt"), "none.txt")
    assert not (clone / ".venv").exists()


def test_a_folder_that_the_set_up_did_not_make_is_left_as_it_is(clone: Path) -> None:
    (clone / ".venv").mkdir()
    (clone / ".venv" / "thesis.tex").write_text("years of work")
    assert_refused(call(clone, "--extras", "none", **NO_INDEX), ".venv", "move it away", "--venv")
    assert (clone / ".venv" / "thesis.tex").read_text() == "years of work"


def test_a_folder_that_cannot_be_made_is_one_line(clone: Path) -> None:
    (clone / "taken").touch()
    assert_refused(call(clone, "--extras", "none", "--venv", "taken", **NO_INDEX), "taken", "of your own")
    assert_refused(call(clone, "--extras", "none", "--venv", "taken/x", **NO_INDEX), "taken", "of your own")


def test_every_extra_can_be_set_up_by_name(bootstrap: ModuleType, setup_arguments: dict[str, Any]) -> None:
    assert set(bootstrap.EXTRAS) == set(setup_arguments["extras_require"])


def test_every_target_names_extras_that_there_are(bootstrap: ModuleType) -> None:
    lines = re.findall(r"--extras (\S+)", (ROOT / "Makefile").read_text())
    assert lines
    assert {extra for line in lines for extra in line.split(",")} <= set(bootstrap.EXTRAS)


def test_the_interpreters_of_the_set_up_are_those_that_the_package_states(
    bootstrap: ModuleType, setup_arguments: dict[str, Any]
) -> None:
    stated = [line.rpartition(" ")[2] for line in setup_arguments["classifiers"] if ":: 3." in line]
    assert stated == [f"3.{minor}" for minor in range(bootstrap.OLDEST[1], bootstrap.NEWEST[1] + 1)]
    assert sorted(bootstrap.PREFERRED) == stated
    assert setup_arguments["python_requires"] == f">={stated[0]}"
    wheels = [line for line in setup_arguments["extras_require"]["ros"] if line.startswith("ros-")]
    assert all(f'python_version < "3.{bootstrap.NEWEST[1] + 1}"' in line for line in wheels)
    for page in ("README.md", "CONTRIBUTING.md"):
        assert f"Python {stated[0]} to {stated[-1]}" in (ROOT / page).read_text()


def test_a_newer_interpreter_on_the_path_is_used_rather_than_refused(
    bootstrap: ModuleType, fake_python: Interpreters, monkeypatch: pytest.MonkeyPatch
) -> None:
    old = fake_python(version("3.8.1"), name="python3")
    fit = fake_python(name="python3.12")
    monkeypatch.setattr(sys, "executable", str(old))
    monkeypatch.setenv("PATH", f"{fit.parent}:{os.environ['PATH']}")
    assert bootstrap.candidates("")[:2] == [str(old), str(fit)]
    assert bootstrap.find_python("", is_for_wheels=True) == str(fit)


def test_interpreters_of_pyenv_and_uv_are_found(
    bootstrap: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("PATH", "")
    installed = (
        ".pyenv/versions/3.14.2/bin/python",
        ".local/share/uv/python/cpython-3.14.2-linux-x86_64-gnu/bin/python3.14",
    )
    for name in installed:
        (tmp_path / name).parent.mkdir(parents=True)
        (tmp_path / name).touch()
    assert [path for path in bootstrap.candidates("3.14") if path != sys.executable] == [
        str(tmp_path / name) for name in installed
    ]


def test_an_interpreter_too_old_for_the_suite_still_runs_the_set_up(clone: Path) -> None:
    versions = Path.home() / ".pyenv" / "versions"
    old = next((path for name in "6789" for path in versions.glob(f"3.{name}.*/bin/python")), None)
    if old is None:
        pytest.skip("no Python 3.6 to 3.9 on this machine")
    ended = call(clone, "--python", sys.executable, "--print-python", python=str(old))
    assert (ended.returncode, ended.stderr) == (0, "")
    assert Path(ended.stdout.strip()).samefile(sys.executable)
    assert_refused(call(clone, "--python", str(old), python=str(old)), "3.10 to 3.14")


def sourced(modules: Path, numpy_version: str) -> dict[str, str]:
    """Variables of a sourced Jazzy whose modules lie in a folder."""
    for name, text in (("rclpy", ""), ("numpy", f"__version__ = {numpy_version!r}")):
        (modules / name).mkdir(parents=True)
        (modules / name / "__init__.py").write_text(text)
    return {"ROS_DISTRO": "jazzy", "AMENT_PREFIX_PATH": "/opt/ros/jazzy", "PYTHONPATH": str(modules)}


def test_a_sourced_jazzy_is_used_and_no_wheels(
    bootstrap: ModuleType, fake_python: Interpreters, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    for name, value in sourced(tmp_path / "modules", "1.26.4").items():
        monkeypatch.setenv(name, value)
    python = str(fake_python("platform.machine = lambda: 'aarch64'"))
    assert bootstrap.choose(python, wants_ros=True, say=pytest.fail) == (python, "system", "1.26.4")


@pytest.mark.parametrize("distribution", ["jazzy", "humble"])
def test_a_ros_that_does_not_fit_is_left_alone(
    bootstrap: ModuleType,
    fake_python: Interpreters,
    monkeypatch: pytest.MonkeyPatch,
    foreign_ros: dict[str, str],
    distribution: str,
) -> None:
    for name, value in (foreign_ros | {"ROS_DISTRO": distribution}).items():
        monkeypatch.setenv(name, value)
    lines: list[str] = []
    python = str(fake_python())
    assert bootstrap.choose(python, wants_ros=True, say=lines.append) == (python, "wheels", "")
    assert "left alone" in lines[0]


@pytest.mark.slow
def test_a_fresh_clone_is_set_up_once_and_runs_without_ros_and_without_a_network(tmp_path: Path) -> None:
    """The pure core from the package index, where an interrupted set-up has left something."""
    clone = copy_tree(tmp_path / "beam rig")
    (clone / ".venv").mkdir()
    (clone / ".venv" / "beam-setup.json").write_text('{"is_comp')
    (clone / ".venv" / "half-written").touch()
    first = call(clone, "--extras", "none", "--", "beam", "model")
    assert (first.returncode, first.stderr) == (0, "")
    assert "Setting up .venv" in first.stdout
    assert not (clone / ".venv" / "half-written").exists()
    again = call(clone, "--extras", "none", "--", "beam", "model", **NO_INDEX)
    assert (again.returncode, again.stderr) == (0, "")
    assert first.stdout.endswith(again.stdout)
    listed = call(clone, "--extras", "none", "--", "python", "-m", "pip", "list").stdout
    for absent in ("ros-rclpy", "opencv", "pyserial"):
        assert absent not in listed
    node = call(clone, "--extras", "none", "--", "simulator")
    assert node.returncode == 2
    assert "ROS 2 cannot be used" in node.stderr
