"""An environment is made once, from what its stamp says, by one call at a time, and never over somebody's work."""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import sysconfig
import time
import uuid
import venv as venvs
from pathlib import Path
from typing import Any

import pytest

from beam_ros.errors import InstallationError
from beam_ros.process.stamped_environment import STAMP, StampedEnvironment
from tests.real_processes import MARK, marked_processes

ROOT = Path(__file__).parents[3]
WISH: dict[str, Any] = {"extras": {"ros"}, "requested": "", "constraint": ""}
COMPLETE = {
    "extras": ["ros", "test"],
    "requested": "",
    "python": os.path.realpath(sys.executable),
    "link": os.path.realpath(sys.executable),
    "source": "wheels",
    "sourced": "",
    "is_complete": True,
}


@pytest.fixture
def clone(tmp_path: Path) -> Path:
    """What the set-up reads of a tree, in a folder whose name has a blank."""
    root = tmp_path / "beam rig"
    shutil.copytree(ROOT / "beam_ros" / "process", root / "beam_ros" / "process")
    for name in ("bootstrap.py", "setup.py", "pyproject.toml", "beam_ros/__init__.py", "beam_ros/errors.py"):
        shutil.copy(ROOT / name, root / name)
    return root


@pytest.fixture
def environment(clone: Path) -> StampedEnvironment:
    """The environment of that tree, as a set-up leaves it, but that it has nothing beside pip."""
    made = StampedEnvironment(str(clone), ".venv", "", pytest.fail)
    venvs.create(made.venv, with_pip=False, symlinks=True)
    (site,) = made.venv.glob("lib/python*/site-packages")
    (site / "pip").symlink_to(Path(sysconfig.get_path("purelib")) / "pip")
    (made.scripts / "beam").touch()
    stamp(made)
    return made


def stamp(made: StampedEnvironment, **changes: Any) -> None:
    """Write the stamp of a finished set-up."""
    (made.venv / STAMP).write_text(json.dumps(made.sources("") | COMPLETE | changes))


def call(clone: Path, *arguments: str, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run the set-up of a clone, with no ROS 2 sourced and no package index."""
    inherited = {name: value for name, value in os.environ.items() if name != "ROS_DISTRO"}
    return subprocess.run(
        [sys.executable, str(clone / "bootstrap.py"), *arguments],
        env=inherited | NO_INDEX | variables,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


NO_INDEX = {"PIP_INDEX_URL": "http://127.0.0.1:9/simple", "PIP_CONFIG_FILE": os.devnull, "PIP_RETRIES": "1"}


def test_a_second_call_starts_at_once_and_its_command_sees_the_environment(
    environment: StampedEnvironment, clone: Path
) -> None:
    code = "import os, sys; print(os.environ['VIRTUAL_ENV'], os.environ.get('PYTHONPATH')); sys.exit(7)"
    ended = call(clone, "--", "python", "-S", "-c", code, PYTHONPATH="/opt/ros/jazzy/lib")
    assert (ended.returncode, ended.stdout, ended.stderr) == (7, f"{environment.venv} None\n", "")
    ended = call(clone, "--", "no-such-command")
    assert (ended.returncode, ended.stdout, ended.stderr.count("\n")) == (2, "", 1)
    assert "no-such-command" in ended.stderr


def test_an_environment_that_was_made_from_the_same_is_ready(environment: StampedEnvironment) -> None:
    assert environment.is_ready(**WISH)
    assert not environment.is_ready(**WISH | {"extras": {"docs"}})
    assert not environment.is_ready(**WISH | {"requested": "3.9"})
    assert not environment.is_ready(**WISH | {"constraint": "setup.py"})
    with pytest.raises(InstallationError, match=r"none\.txt cannot be read"):
        environment.is_ready(**WISH | {"constraint": "none.txt"})


@pytest.mark.parametrize(
    "changes",
    [
        {"is_complete": False},
        {"digests": ["other"]},
        {"packages": ["other"]},
        {"extras": ["rig"]},
        {"link": "/usr/bin/python3.0"},
        {"venv": "/elsewhere/.venv"},
        {"sourced": "other"},
        {"format": 0},
    ],
    ids=lambda changes: next(iter(changes)),
)
def test_an_environment_that_was_made_from_something_else_is_not_ready(
    environment: StampedEnvironment, changes: dict[str, Any]
) -> None:
    stamp(environment, **changes)
    assert not environment.is_ready(**WISH)


@pytest.mark.parametrize("lost", ["bin/beam", "bin/python", STAMP])
def test_half_an_environment_is_not_ready(environment: StampedEnvironment, lost: str) -> None:
    (environment.venv / lost).unlink()
    assert not environment.is_ready(**WISH)


def test_a_half_written_stamp_is_that_of_an_interrupted_set_up(environment: StampedEnvironment) -> None:
    (environment.venv / STAMP).write_text('{"is_complete": tr')
    assert environment.stamp() == {}
    assert not environment.is_ready(**WISH)


def test_what_only_asks_for_less_installs_nothing_and_keeps_what_is_there(
    environment: StampedEnvironment, clone: Path
) -> None:
    """Another name for the same interpreter, or another ROS 2 sourced: a stamp, and no network."""
    python = os.path.realpath(sys.executable)
    ended = call(clone, "--extras", "ros", "--python", sys.executable)
    assert (ended.returncode, ended.stderr) == (0, "")
    written = environment.stamp()
    assert (written["requested"], written["extras"], written["python"]) == (
        sys.executable,
        ["ros", "test"],
        python,
    )
    assert written["source"] == "wheels"


@pytest.mark.slow
def test_without_a_network_an_update_is_refused_in_one_line_and_what_is_left_counts_as_unfinished(
    environment: StampedEnvironment, clone: Path
) -> None:
    # As the first version wrote it: with other sources, and without the link, which was the interpreter.
    old = {name: value for name, value in COMPLETE.items() if name != "link"}
    (environment.venv / STAMP).write_text(json.dumps({"format": 1, "venv": str(environment.venv)} | old))
    ended = call(clone, "--extras", "docs")
    assert ended.returncode == 2
    assert ended.stderr.count("\n") == 1, ended.stderr
    assert "the package index cannot be reached" in ended.stderr
    assert "127.0.0.1" not in ended.stderr
    assert "Bringing up to date" in ended.stdout
    assert not environment.is_ready(**WISH)


@pytest.mark.slow
def test_an_interrupted_set_up_says_so_and_leaves_no_process(
    environment: StampedEnvironment, clone: Path
) -> None:
    # A package index that accepts the connection and never answers keeps pip waiting.
    mark = uuid.uuid4().hex
    with socket.create_server(("127.0.0.1", 0)) as index:
        url = f"http://127.0.0.1:{index.getsockname()[1]}/simple"
        process = subprocess.Popen(
            [sys.executable, str(clone / "bootstrap.py"), "--extras", "docs"],
            env=os.environ | NO_INDEX | {"PIP_INDEX_URL": url, MARK: mark},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        index.settimeout(60)
        connection, _ = index.accept()
        with connection:
            assert len(marked_processes(mark)) >= 2
            process.send_signal(signal.SIGTERM)
            _, stderr = process.communicate(timeout=30)
    assert (process.returncode, stderr.count("\n")) == (130, 1)
    assert "interrupted" in stderr
    end = time.monotonic() + 30
    while marked_processes(mark) and time.monotonic() < end:
        time.sleep(0.05)
    assert marked_processes(mark) == []
    assert not environment.is_ready(**WISH)


def test_a_second_set_up_waits_for_the_first(environment: StampedEnvironment, clone: Path) -> None:
    import fcntl

    stamp(environment, is_complete=False)
    descriptor = os.open(clone, os.O_RDONLY)
    fcntl.flock(descriptor, fcntl.LOCK_EX)
    second = subprocess.Popen(
        [sys.executable, str(clone / "bootstrap.py"), "--extras", "none"],
        env=os.environ | NO_INDEX,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert second.stderr is not None
    assert "Waiting" in second.stderr.readline()
    stamp(environment)  # The first one ends meanwhile.
    os.close(descriptor)
    stdout, _ = second.communicate(timeout=30)
    assert (second.returncode, stdout.strip()) == (0, "Ready: .venv/bin/beam")
