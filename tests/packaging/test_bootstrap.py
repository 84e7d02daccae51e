"""The set-up finds what it needs, says in one line what cannot work, and does nothing twice."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
import uuid
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from tests.packaging.conftest import ROOT, copy_tree
from tests.real_processes import MARK, marked_processes

pytestmark = pytest.mark.slow

FIT = {
    "path": "/usr/bin/python3",
    "real_path": "/usr/bin/python3.12",
    "version": [3, 12, 3],
    "implementation": "CPython",
    "has_gil": True,
    "is_64_bit": True,
    "has_venv": True,
    "system": "Linux",
    "machine": "x86_64",
    "libc": ["glibc", "2.39"],
}

NO_INDEX = {
    "PIP_INDEX_URL": "http://127.0.0.1:9/simple",
    "PIP_CONFIG_FILE": os.devnull,
    "PIP_RETRIES": "1",
    "PIP_NO_CACHE_DIR": "1",
}

Interpreters = Callable[..., Path]


@pytest.fixture
def clone(tmp_path: Path) -> Path:
    """What the set-up reads of a tree, in a folder whose name has a blank."""
    root = tmp_path / "beam rig"
    (root / "beam_ros" / "process").mkdir(parents=True)
    for name in (
        "bootstrap.py",
        "setup.py",
        "pyproject.toml",
        "beam_ros/__init__.py",
        "beam_ros/process/__init__.py",
        "beam_ros/process/environment.py",
    ):
        shutil.copy(ROOT / name, root / name)
    return root


@pytest.fixture
def bootstrap(clone: Path) -> ModuleType:
    """The set-up as a module."""
    spec = importlib.util.spec_from_file_location("bootstrap_under_test", clone / "bootstrap.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def call(
    clone: Path, *arguments: str, python: str = sys.executable, **environment: str
) -> subprocess.CompletedProcess[str]:
    """Run the set-up of a clone, with no ROS 2 sourced."""
    hidden = ("PIP_FIND_LINKS", "PIP_EXTRA_INDEX_URL", "ROS_DISTRO")
    inherited = {name: value for name, value in os.environ.items() if name not in hidden}
    return subprocess.run(
        [python, str(clone / "bootstrap.py"), *arguments],
        env=inherited | environment,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


def assert_refused(ended: subprocess.CompletedProcess[str], *parts: str) -> None:
    """One line on stderr that holds all parts, and status 2."""
    assert ended.returncode == 2, ended.stderr
    assert ended.stderr.startswith("bootstrap: ")
    assert ended.stderr.count("\n") == 1, ended.stderr
    for part in ("expected", *parts):
        assert part in ended.stderr


def make_ready(bootstrap: ModuleType, clone: Path, **changes: Any) -> Path:
    """Write the environment and the stamp that a finished set-up leaves."""
    setup = bootstrap.Setup(bootstrap.parse(["--extras", "ros,test"]))
    bin_folder = clone / ".venv" / "bin"
    bin_folder.mkdir(parents=True)
    (bin_folder / "python").symlink_to(os.path.realpath(sys.executable))
    stamp = {
        "extras": ["ros", "test"],
        "requested": "",
        "python": os.path.realpath(sys.executable),
        "source": "wheels",
        "sourced": "",
        "is_complete": True,
    }
    setup.write_stamp({**setup.wanted(), **stamp, **changes})
    return bin_folder


@pytest.mark.first_case
@pytest.mark.parametrize(
    ("changes", "parts"),
    [
        ({"version": [3, 9, 18]}, ("3.9.18", "3.10 to 3.13", "python3-venv", "--python")),
        ({"version": [3, 14, 0]}, ("3.14.0", "3.10 to 3.13")),
        ({"implementation": "PyPy"}, ("PyPy", "CPython")),
        ({"has_gil": False, "version": [3, 13, 0]}, ("without GIL",)),
        ({"has_venv": False}, ("venv", "sudo apt install python3.12-venv")),
        ({"machine": "aarch64"}, ("aarch64", "/opt/ros/jazzy/setup.bash", "--extras none")),
        ({"is_64_bit": False}, ("32-bit", "x86-64")),
        ({"libc": ["", ""]}, ("musl", "--extras none")),
        ({"libc": ["glibc", "2.17"]}, ("glibc 2.17", "2.28")),
        ({"system": "Darwin", "machine": "arm64"}, ("macOS", "--extras none")),
        ({"system": "Windows", "machine": "AMD64"}, ("Windows", "--extras none")),
    ],
    ids=lambda value: "-".join(map(str, value)) if isinstance(value, dict) else "",
)
def test_a_machine_that_cannot_run_ros_is_refused_in_one_line(
    clone: Path, fake_python: Interpreters, changes: dict[str, Any], parts: tuple[str, ...]
) -> None:
    python = fake_python(json.dumps(FIT | changes))
    assert_refused(call(clone, "--python", str(python)), *parts)
    assert not (clone / ".venv").exists()


@pytest.mark.parametrize(
    "changes", [{"machine": "aarch64"}, {"system": "Darwin"}, {"libc": ["", ""]}], ids=str
)
def test_offline_extras_are_for_every_platform(bootstrap: ModuleType, changes: dict[str, Any]) -> None:
    assert bootstrap.unfitness(FIT | changes, is_for_wheels=False) == ""
    assert bootstrap.unfitness(FIT | changes, is_for_wheels=True) != ""


def test_an_unknown_interpreter_extra_or_constraint_is_refused(clone: Path) -> None:
    assert_refused(call(clone, "--python", "python9.9"), "python9.9")
    assert_refused(
        call(clone, "--extras", "ros,everything"),
        "'everything'",
        "rig,ros,dask,compiled,remote,study,test,dev,browser,docs, or none",
    )
    assert_refused(call(clone, "--constraint", "none.txt"), "none.txt")
    assert not (clone / ".venv").exists()


def test_every_extra_can_be_set_up_by_name(bootstrap: ModuleType, setup_arguments: dict[str, Any]) -> None:
    assert set(bootstrap.EXTRAS) == set(setup_arguments["extras_require"])


def test_every_target_names_extras_that_there_are(bootstrap: ModuleType) -> None:
    lines = re.findall(r"--extras (\S+)", (ROOT / "Makefile").read_text())
    assert lines
    assert {extra for line in lines for extra in line.split(",")} <= set(bootstrap.EXTRAS)


def test_a_newer_interpreter_on_the_path_is_used_rather_than_refused(
    bootstrap: ModuleType, fake_python: Interpreters, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    old = fake_python(json.dumps(FIT | {"version": [3, 8, 1]}), name="python3")
    fit = fake_python(json.dumps(FIT), name="python3.12")
    monkeypatch.setattr(sys, "executable", str(old))
    monkeypatch.setenv("PATH", f"{fit.parent}:{os.environ['PATH']}")
    monkeypatch.setenv("PYENV_ROOT", str(tmp_path))
    assert bootstrap.candidates("")[:2] == [str(old), str(fit)]
    assert bootstrap.find_python("", is_for_wheels=True) == FIT


def test_an_interpreter_too_old_for_the_suite_still_runs_the_set_up(clone: Path) -> None:
    versions = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    old = next((path for name in "6789" for path in versions.glob(f"3.{name}.*/bin/python")), None)
    if old is None:
        pytest.skip("no Python 3.6 to 3.9 on this machine")
    ended = call(clone, "--python", sys.executable, "--print-python", python=str(old))
    assert (ended.returncode, ended.stderr) == (0, "")
    assert Path(ended.stdout.strip()).samefile(sys.executable)


def test_a_sourced_jazzy_is_used_and_no_wheels(
    bootstrap: ModuleType, fake_python: Interpreters, monkeypatch: pytest.MonkeyPatch
) -> None:
    python = fake_python(json.dumps(FIT | {"machine": "aarch64"}), sourced_ros="1.26.4")
    monkeypatch.setenv("ROS_DISTRO", "jazzy")
    monkeypatch.setenv("AMENT_PREFIX_PATH", "/opt/ros/jazzy")
    monkeypatch.setenv("PYTHONPATH", "/opt/ros/jazzy/lib/python3.12/site-packages")
    setup = bootstrap.Setup(bootstrap.parse(["--python", str(python)]))
    assert setup.choose() == (FIT | {"machine": "aarch64"}, "system", "1.26.4")
    assert setup.environment("system")["PYTHONPATH"] == "/opt/ros/jazzy/lib/python3.12/site-packages"

    commands: list[list[str]] = []
    monkeypatch.setattr(setup, "run", lambda command, *_rest: commands.append(command))
    Path(setup.venv).mkdir()
    setup.install({}, "system", ["ros", "test"], "1.26.4")
    assert commands[0][commands[0].index("-e") + 1] == ".[rig,test]"
    assert (Path(setup.venv) / "constraints.txt").read_text().startswith("numpy<2\n")


@pytest.mark.parametrize("distribution", ["jazzy", "humble"])
def test_a_ros_that_does_not_fit_is_left_alone(
    bootstrap: ModuleType,
    fake_python: Interpreters,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    foreign_ros: dict[str, str],
    distribution: str,
) -> None:
    python = fake_python(json.dumps(FIT))
    for name, value in (foreign_ros | {"ROS_DISTRO": distribution}).items():
        monkeypatch.setenv(name, value)
    setup = bootstrap.Setup(bootstrap.parse(["--python", str(python)]))
    assert setup.choose() == (FIT, "wheels", "")
    assert "left alone" in capsys.readouterr().out
    environment = setup.environment("wheels")
    assert "PYTHONPATH" not in environment
    assert "ROS_DISTRO" not in environment
    assert environment["AMENT_PREFIX_PATH"] == setup.venv


def test_a_second_call_starts_at_once(bootstrap: ModuleType, clone: Path) -> None:
    """The environment made ready here has no pip and no index: whatever wanted to install would fail."""
    make_ready(bootstrap, clone)
    ended = call(clone, "--extras", "ros", "--", "python", "-S", "-c", "print('ran', *[1, 2])")
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "ran 1 2\n", "")


def test_the_command_sees_the_environment_and_its_own_status_comes_back(
    bootstrap: ModuleType, clone: Path, foreign_ros: dict[str, str]
) -> None:
    bin_folder = make_ready(bootstrap, clone)
    code = "import os, sys; print(os.environ['VIRTUAL_ENV'], os.environ.get('PYTHONPATH')); sys.exit(7)"
    ended = call(clone, "--", "python", "-S", "-c", code, PYTHONPATH=foreign_ros["PYTHONPATH"])
    assert (ended.returncode, ended.stdout) == (7, f"{bin_folder.parent} None\n")
    assert_refused(call(clone, "--", "no-such-command"), "no-such-command")


@pytest.mark.parametrize(
    "changes",
    [
        {"is_complete": False},
        {"requirements": "other"},
        {"extras": ["rig"]},
        {"python": "/usr/bin/python3.0"},
        {"venv": "/elsewhere/.venv"},
        {"constraint": "other"},
        {"sourced": "other"},
        {"format": 0},
    ],
    ids=lambda changes: next(iter(changes)),
)
def test_an_environment_made_from_something_else_is_not_ready(
    bootstrap: ModuleType, clone: Path, changes: dict[str, Any]
) -> None:
    make_ready(bootstrap, clone, **changes)
    assert not bootstrap.Setup(bootstrap.parse(["--extras", "ros"])).is_ready()


def test_without_a_network_one_line_names_the_log_and_the_next_call_starts_anew(clone: Path) -> None:
    (clone / ".venv").mkdir()
    (clone / ".venv" / "beam-setup.json").write_text('{"is_complete": false}')
    (clone / ".venv" / "half-written").touch()
    ended = call(clone, "--extras", "none", **NO_INDEX)
    assert_refused(ended, "the package index cannot be reached", "setup.log")
    assert "127.0.0.1" not in ended.stderr
    assert "This is done once" in ended.stdout
    assert not (clone / ".venv" / "half-written").exists()
    assert json.loads((clone / ".venv" / "beam-setup.json").read_text())["is_complete"] is False
    assert "Retrying" in (clone / ".venv" / "setup.log").read_text()


def test_a_folder_that_the_set_up_did_not_make_is_left_as_it_is(clone: Path) -> None:
    (clone / ".venv").mkdir()
    (clone / ".venv" / "thesis.tex").write_text("years of work")
    assert_refused(call(clone, "--extras", "none", **NO_INDEX), ".venv", "move it away", "--venv")
    assert (clone / ".venv" / "thesis.tex").read_text() == "years of work"


def test_the_suites_commands_start_with_signals_held_back_and_others_as_pip_made_them(
    bootstrap: ModuleType, clone: Path
) -> None:
    """The folder's name has a blank."""
    bin_folder = make_ready(bootstrap, clone)
    code = "import signal; print(sorted(map(int, signal.pthread_sigmask(signal.SIG_BLOCK, []))))"
    own = f"#!/usr/bin/python3\nif 0:\n    from beam_ros.process.executables import beam\n{code}\n"
    (bin_folder / "beam").write_text(own)
    (bin_folder / "other").write_text(other := f"#!{sys.executable}\n{code}\n")
    (bin_folder / "beam").chmod(0o755)
    if subprocess.call(["/usr/bin/env", "--block-signal=INT", "true"], stderr=subprocess.DEVNULL):
        pytest.skip("this machine's env cannot block signals: expected GNU coreutils 8.31 or later")
    for _ in range(2):
        bootstrap.Setup(bootstrap.parse([])).hold_signals_back()
        ended = subprocess.run([bin_folder / "beam"], capture_output=True, text=True, timeout=30, check=False)
        assert (ended.stdout, ended.stderr) == ("[2, 15]\n", "")
    assert (bin_folder / "other").read_text() == other


def test_an_interrupted_set_up_says_so_and_leaves_no_process(clone: Path) -> None:
    # A package index that accepts the connection and never answers keeps pip and its own children waiting.
    mark = uuid.uuid4().hex
    with socket.create_server(("127.0.0.1", 0)) as index:
        port = index.getsockname()[1]
        process = subprocess.Popen(
            [sys.executable, str(clone / "bootstrap.py"), "--extras", "none"],
            env=os.environ | NO_INDEX | {"PIP_INDEX_URL": f"http://127.0.0.1:{port}/simple", MARK: mark},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        index.settimeout(60)
        connection, _ = index.accept()
        with connection:
            assert len(marked_processes(mark)) >= 3
            process.send_signal(signal.SIGTERM)
            _, stderr = process.communicate(timeout=30)
    assert process.returncode == 130
    assert stderr.count("\n") == 1
    assert "interrupted" in stderr
    time.sleep(0.5)
    assert marked_processes(mark) == []
    assert json.loads((clone / ".venv" / "beam-setup.json").read_text())["is_complete"] is False


@pytest.mark.verify
def test_a_fresh_clone_is_set_up_and_runs_without_ros(tmp_path: Path) -> None:
    """The pure core alone, from the package index: half a minute and a network."""
    clone = copy_tree(tmp_path / "beam rig")
    bag, report = str(tmp_path / "bag"), str(tmp_path / "report")
    short = ("-p", "excitation.duration:=6.0", "-p", "excitation.still:=2.0")
    for arguments in (
        ("model",),
        ("--help",),
        ("simulate", "--bag", bag, *short),
        ("identify", bag, "--report", report),
    ):
        ended = call(clone, "--extras", "none", "--", "beam", *arguments)
        assert ended.returncode == 0, ended.stderr
    listed = call(clone, "--extras", "none", "--", "python", "-m", "pip", "list").stdout
    for absent in ("ros-rclpy", "opencv", "pyserial"):
        assert absent not in listed
    node = call(clone, "--extras", "none", "--", "simulator")
    assert node.returncode == 2
    assert "ROS 2 cannot be used" in node.stderr
