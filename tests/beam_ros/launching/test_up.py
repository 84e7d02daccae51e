"""`beam up` and `beam call`: the rig kept running, its services called, a second hub refused."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest

from beam_ros.bags.reading import Bag
from tests.beam_ros.bags.small_bags import write_experiment

pytestmark = pytest.mark.ros
pytest.importorskip("rclpy")


def test_a_rig_is_kept_up_its_services_answer_as_the_hub_does_and_no_second_one_starts(
    executables, tmp_path: Path
) -> None:
    up = executables.start(
        "beam",
        "up",
        "--rig",
        "simulated",
        "-p",
        "simulation.images:=false",
        "-p",
        "hub.watchdog:=1.0",
        timeout_s=90.0,
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
    assert "another hub is on this graph" in second.output()
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


def test_no_rig_starts_beside_a_replay_which_would_look_live(executables, tmp_path: Path) -> None:
    path = write_experiment(tmp_path / "run", batches=20)
    words = ["-p", f"player.bag:={path}", "-p", "player.loop:=true"]
    player = executables.start("bag_player", "--ros-args", *words, timeout_s=90.0)
    player.wait_for("playing", 40.0)
    up = executables.run("beam", "up", "--rig", "simulated")
    assert up.process.returncode == 2
    assert "node `player` publishes /hub/measured" in up.output()
    player.send_signal(signal.SIGINT)
    assert player.wait() == 0


def test_a_rig_that_records_ends_with_a_whole_bag_and_status_0(executables, tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    words = ("--rig", "simulated", "-p", "simulation.images:=false", "--record", str(bag))
    up = executables.start("beam", "up", *words, timeout_s=90.0)
    up.wait_for("Ctrl-C ends it", 40.0)
    up.send_signal(signal.SIGINT)
    assert up.wait(20.0) == 0, up.output()
    with Bag(bag) as recorded:
        assert recorded.count("hub/measured")
        assert "rig" in recorded.provenance()
        assert not list(recorded.damage())
