"""`beam up` and `beam call`: the rig kept running, its services called, a second hub refused."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest

pytestmark = pytest.mark.ros
pytest.importorskip("rclpy")


def test_a_rig_is_kept_up_its_services_answer_as_the_hub_does_and_no_second_one_starts(
    executables, tmp_path: Path
) -> None:
    up = executables.start(
        "beam", "up", "--rig", "simulated", "-p", "simulation.images:=false", timeout_s=90.0
    )
    up.wait_for("Ctrl-C ends it", 40.0)
    refused = executables.run("beam", "call", "excitation/start")
    assert refused.process.returncode == 2
    assert "expected enabled" in refused.output()
    for words in (("hub/home",), ("hub/enable", "true")):
        called = executables.run("beam", "call", *words)
        assert called.process.returncode == 0, called.output()
    folders = sorted(path.name for path in (tmp_path / "runs").iterdir())
    second = executables.run("beam", "up", "--rig", "simulated")
    assert second.process.returncode == 2
    assert "a hub is already on this graph" in second.output()
    assert sorted(path.name for path in (tmp_path / "runs").iterdir()) == folders
    up.send_signal(signal.SIGINT)
    assert up.wait(20.0) == 0
    assert "Traceback" not in up.output()
    assert (tmp_path / "runs" / folders[0] / "logs" / "simulator.log").exists()


def test_a_real_rig_without_its_controller_stays_up_and_says_what_it_waits_for(
    executables, tmp_path: Path
) -> None:
    port = tmp_path / "controller"
    up = executables.start("beam", "up", "--rig", "real", "-p", f"serial.port:={port}", timeout_s=90.0)
    output = up.wait_for("Ctrl-C ends it", 40.0)
    assert f"hub disconnected: serial port {port} cannot be opened" in output
    up.send_signal(signal.SIGINT)
    assert up.wait(20.0) == 0
    assert "Traceback" not in up.output()
