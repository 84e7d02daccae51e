"""Two ROS 2 installations are never mixed: foreign variables go where the wheels are, and only there."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from beam_ros.process import environment
from beam_ros.process.executables import command
from tests.real_processes import Executables

pytestmark = pytest.mark.slow

SITE = Path("lib") / f"python{sys.version_info.major}.{sys.version_info.minor}" / "site-packages"


@pytest.fixture
def wheels_prefix(tmp_path: Path) -> Path:
    """A virtual environment's folder that holds ROS 2 from wheels."""
    prefix = tmp_path / "venv"
    (prefix / SITE / "ros_rclpy-7.1.6.dist-info").mkdir(parents=True)
    (prefix / SITE / "ros_rclpy.libs").mkdir()
    return prefix


def test_foreign_variables_go_and_the_users_own_choices_stay(
    wheels_prefix: Path, foreign_ros: dict[str, str]
) -> None:
    own_library = str(wheels_prefix / SITE / "ros_rclpy.libs")
    found = {
        **foreign_ros,
        "LD_LIBRARY_PATH": f"{foreign_ros['LD_LIBRARY_PATH']}:{own_library}",
        "ROS_DOMAIN_ID": "7",
        "HOME": "/home/someone",
    }
    clean = environment.without_foreign_ros(found, prefix=wheels_prefix)
    assert clean == {
        "LD_LIBRARY_PATH": own_library,
        "AMENT_PREFIX_PATH": str(wheels_prefix),
        "ROS_DOMAIN_ID": "7",
        "HOME": "/home/someone",
    }


def test_a_workspace_stays_on_the_path_unless_it_brings_its_own_rclpy(
    wheels_prefix: Path, tmp_path: Path
) -> None:
    workspace = tmp_path / "install"
    workspace.mkdir()
    found = {"PYTHONPATH": f"/opt/ros/jazzy/lib:{workspace}"}

    def python_path() -> str | None:
        clean = environment.without_foreign_ros(found, prefix=wheels_prefix, package_root=workspace)
        return clean.get("PYTHONPATH")

    assert python_path() == str(workspace)
    (workspace / "rclpy").mkdir()
    assert python_path() is None


def test_the_directory_of_the_interpreters_own_library_stays(wheels_prefix: Path, tmp_path: Path) -> None:
    (tmp_path / "libpython3.12.so.1.0").touch()
    clean = environment.without_foreign_ros({"LD_LIBRARY_PATH": str(tmp_path)}, prefix=wheels_prefix)
    assert clean["LD_LIBRARY_PATH"] == str(tmp_path)


def test_a_sourced_ros_is_left_alone_where_there_are_no_wheels(
    tmp_path: Path, foreign_ros: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    for name, value in foreign_ros.items():
        monkeypatch.setenv(name, value)
    before = dict(os.environ)
    environment.enter()
    assert dict(os.environ) == before
    child = environment.child_environment()
    assert {name: child[name] for name in foreign_ros if name != "PYTHONPATH"} == {
        name: value for name, value in foreign_ros.items() if name != "PYTHONPATH"
    }
    assert child["PYTHONPATH"].endswith(foreign_ros["PYTHONPATH"])


def test_children_drop_the_wheels_guard_when_their_libraries_are_not_in_reach(
    wheels_prefix: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "prefix", str(wheels_prefix))
    monkeypatch.setenv(environment.WHEELS_GUARD, "1")
    monkeypatch.setenv("LD_LIBRARY_PATH", "/another/venv/lib")
    assert environment.WHEELS_GUARD not in environment.child_environment()
    monkeypatch.setenv("LD_LIBRARY_PATH", str(wheels_prefix / SITE / "ros_rclpy.libs"))
    assert environment.child_environment({"EXTRA": "1"})[environment.WHEELS_GUARD] == "1"


@pytest.mark.ros
def test_a_process_whose_variables_come_back_refuses_instead_of_looping() -> None:
    code = (
        "import os; from beam_ros.process import environment\n"
        "os.environ[environment.RESTART_GUARD] = str(os.getpid())\n"
        "os.environ['PYTHONPATH'] = '/opt/ros/jazzy/lib'\n"
        "environment.enter()\n"
    )
    ended = subprocess.run(
        [sys.executable, "-c", code],
        env=environment.child_environment(),
        capture_output=True,
        text=True,
        timeout=30,
        check=False,
    )
    assert ended.returncode == 2
    assert "/opt/ros/jazzy/lib" in ended.stderr
    assert ended.stderr.count("\n") == 1


@pytest.mark.ros
def test_the_command_works_in_a_shell_with_a_foreign_ros(
    executables: Executables, foreign_ros: dict[str, str]
) -> None:
    running = executables.start("beam", "model", environment=foreign_ros)
    assert running.wait(30) == 0, running.output()
    assert "foreign" not in running.output()


@pytest.mark.ros
@pytest.mark.parametrize("guard", [{}, {environment.WHEELS_GUARD: "1"}], ids=["fresh", "guard-inherited"])
def test_a_node_works_in_a_shell_with_a_foreign_ros(
    executables: Executables, foreign_ros: dict[str, str], guard: dict[str, str]
) -> None:
    running = executables.start("bag_recorder", environment={**foreign_ros, **guard})
    mapped = wait_for_libraries(running.process.pid)
    assert all(path.startswith(str(Path(sys.prefix).resolve())) for path in mapped)
    running.send_signal(signal.SIGINT)
    assert running.wait() == 0, running.output()
    assert "Traceback" not in running.output()


def wait_for_libraries(pid: int) -> set[str]:
    """Return where the node's ROS libraries come from, once its middleware is loaded."""
    end = time.monotonic() + 15
    while time.monotonic() < end:
        lines = Path(f"/proc/{pid}/maps").read_text().splitlines()
        paths = {line.split(maxsplit=5)[-1] for line in lines if "librcl" in line or "librmw" in line}
        if any("rmw_fastrtps" in path for path in paths):
            return paths
        time.sleep(0.05)
    raise AssertionError(f"no middleware loaded by process {pid} within 15 s")


def test_a_missing_ros_is_one_line_with_its_remedy() -> None:
    """An interpreter that cannot import rclpy stands for a machine without ROS 2."""
    code = (
        "import sys; sys.modules['rclpy'] = None\n"
        "from beam_ros.process.executables import simulator; sys.exit(simulator())"
    )
    ended = subprocess.run(
        [sys.executable, "-c", code],
        env=environment.child_environment(),
        capture_output=True,
        text=True,
        timeout=30,
        check=False,
    )
    assert ended.returncode == 2
    assert ended.stdout == ""
    assert ended.stderr.count("\n") == 1
    for part in ("simulator: ROS 2 cannot be used", "expected rclpy 7.1", "make setup", "setup.bash"):
        assert part in ended.stderr


@pytest.mark.ros
@pytest.mark.parametrize(("executable", "status"), [("simulator", 0), ("beam", 130)])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interruption_while_modules_load_ends_at_once_without_a_traceback(
    executable: str, status: int, number: signal.Signals
) -> None:
    code = (
        "import os, sys\n"
        "from beam_ros.process.executables import MODULES, run_executable\n"
        "class Interrupt:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        f"        if name == MODULES['{executable}']: os.kill(os.getpid(), {int(number)})\n"
        "sys.meta_path.insert(0, Interrupt())\n"
        f"sys.exit(run_executable('{executable}', ['--help']))\n"
    )
    ended = subprocess.run(
        [sys.executable, "-c", code],
        env=environment.child_environment(),
        capture_output=True,
        text=True,
        timeout=30,
        check=False,
    )
    assert (ended.returncode, ended.stdout, ended.stderr) == (status, "", "")


@pytest.mark.ros
def test_a_signal_blocked_by_the_parent_ends_a_node_as_soon_as_it_listens() -> None:
    def block() -> None:
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})

    process = subprocess.Popen(
        command("simulator"),
        env=environment.child_environment(),
        preexec_fn=block,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    )
    process.send_signal(signal.SIGINT)  # long before Python itself has started
    output, _ = process.communicate(timeout=30)
    assert (process.returncode, output) == (0, b"")


def test_an_unknown_executable_is_refused() -> None:
    ended = subprocess.run(
        [*command("simulater")],
        env=environment.child_environment(),
        capture_output=True,
        text=True,
        timeout=30,
        check=False,
    )
    assert ended.returncode == 2
    assert "simulater" in ended.stderr
    assert "vision_tracker" in ended.stderr
