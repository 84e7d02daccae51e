"""The commands' first lines hold signals back, and the first start imports what there is."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from beam_ros.process.environment import child_environment
from beam_ros.process.first_start import hold_signals_back


def test_the_suites_commands_start_with_signals_held_back_and_others_as_they_were(tmp_path: Path) -> None:
    if subprocess.call(["/usr/bin/env", "--block-signal=INT", "true"], stderr=subprocess.DEVNULL):
        pytest.skip("this machine's env cannot block signals: expected GNU coreutils 8.31 or later")
    scripts = tmp_path / "beam rig" / "bin"
    scripts.mkdir(parents=True)
    (scripts / "python").symlink_to(sys.executable)
    code = "import signal; print(sorted(map(int, signal.pthread_sigmask(signal.SIG_BLOCK, []))))"
    own = f"#!/usr/bin/python3\nif 0:\n    from beam_ros.process.executables import beam\n{code}\n"
    (scripts / "beam").write_text(own)
    (scripts / "other").write_text(other := f"#!{sys.executable}\n{code}\n")
    (scripts / "beam").chmod(0o755)
    for _ in range(2):
        hold_signals_back(scripts, str(scripts / "python"))
        ended = subprocess.run([scripts / "beam"], capture_output=True, text=True, timeout=30, check=False)
        assert (ended.stdout, ended.stderr) == ("[2, 15]\n", "")
    assert (scripts / "other").read_text() == other


@pytest.mark.slow
def test_without_ros_the_command_alone_is_started_and_with_it_the_nodes_too() -> None:
    code = (
        "import sys; sys.modules['rclpy'] = None\n"
        "from beam_ros.process.first_start import start_once\n"
        "start_once(has_ros=False)\n"
        "try:\n    start_once(has_ros=True)\n"
        "except ImportError as error:\n    print(error.name.split('.')[0])\n"
    )
    ended = subprocess.run(
        [sys.executable, "-c", code],
        env=child_environment(),
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert (ended.stdout, ended.stderr) == ("rclpy\n", "")
