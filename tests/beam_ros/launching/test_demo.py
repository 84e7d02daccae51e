"""The whole experiment over real processes and DDS, shortened; and that nothing of it is left behind."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

from beam_ros.bags.reading import Bag
from beam_ros.bags.summary import summarise
from beam_ros.cli.main import main
from beam_ros.errors import RigUnavailableError
from beam_ros.interfaces.graph import TOPICS
from beam_ros.launching import demo as demo_of_rig
from beam_ros.launching.processes import NodeGroup, PrivateDomain, stay_on_this_machine
from beam_ros.messages import BagTypes
from tests.whole_bags import messages_of_whole_bag

pytestmark = pytest.mark.ros
pytest.importorskip("rclpy")
pytest.importorskip("cv2")

SHORT = (
    *("-p", "excitation.duration:=4.0"),
    *("-p", "excitation.still:=1.0"),
    *("-p", "excitation.end_frequency:=45.0"),
    *("-p", "excitation.start_delay:=1.0"),
)


GUARD_S = 900.0
"""A busy computer takes two attempts and the simulator's core: this ends one that hangs [s]."""


@pytest.mark.slow
@pytest.mark.parametrize("rig", ["simulated", "emulated"])
def test_the_demo_identifies_the_simulated_beam(executables, tmp_path: Path, rig: str) -> None:
    """By its nodes, or, where this computer is too busy for them, by the core; and it says which."""
    demo = executables.run("beam", "demo", "--rig", rig, "--out", "run", "--json", *SHORT, timeout_s=GUARD_S)
    output = demo.output()
    result = json.loads(output[output.index("{\n") :])
    is_by_nodes = result["made_by"] == "nodes"
    assert demo.process.returncode == (0 if is_by_nodes else 1), output
    assert is_by_nodes or result["failed_attempts"], output
    first, second = result["modes"][:2]
    assert first["frequency_hz"] == pytest.approx(first["theory_frequency_hz"], rel=3e-3)
    assert second["frequency_hz"] == pytest.approx(second["theory_frequency_hz"], rel=3e-3)
    run = tmp_path / "run"
    written = {"bag", "figures", "model.json", "poles.csv", "report.html", "rig.yaml"}
    logs = {"logs"} if is_by_nodes else set()
    aside = {f"attempt-{number}" for number, _ in enumerate(result["failed_attempts"], start=1)}
    assert written | logs | aside == {path.name for path in run.iterdir()}
    if is_by_nodes:
        _read_back(run / "bag")


def _read_back(bag: Path) -> None:
    """Both libraries find it whole; every topic but the images is there."""
    counts = Counter(topic for topic, *_ in messages_of_whole_bag(bag))
    needed = {
        "hub/applied",
        "hub/measured",
        "hub/state",
        "hub/clock_sync",
        "hub/sequence_state",
        "beam/displacement",
        "beam/markers",
        "excitation/info",
    }
    assert all(counts[f"/{name}"] > 0 for name in needed)
    assert not any(f"/{name}" in counts for name, row in TOPICS.items() if row.is_image)


@pytest.mark.verify
def test_frames_that_a_busy_computer_loses_are_counted_and_explained(executables, tmp_path: Path) -> None:
    hogs = [
        subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(4 * (os.cpu_count() or 1))
    ]
    try:
        demo = executables.run("beam", "demo", "--out", "run", "--json", *SHORT, timeout_s=GUARD_S)
    finally:
        for hog in hogs:
            hog.kill()
            hog.wait(10.0)
    assert demo.process.returncode == 0, demo.output()
    said: dict[str, set[str]] = {"tracker": set(), "hub": set()}
    types = BagTypes()
    with Bag(tmp_path / "run" / "bag") as bag:
        (frames,) = [one for one in summarise(bag).signals if one.topic == "/beam/displacement"]
        for raw in bag.raw_messages("/diagnostics"):
            for status in types.deserialize(raw.data, raw.type_name).status:
                said.setdefault(status.name.split(":")[0], set()).add(status.message)
    assert frames.lost > 0, "the computer was not busy enough to lose a frame"
    # In the report, with the count and the longest gap; in the diagnostics of who missed them and of who lost them.
    report = (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    lacks = re.search(r"beam/displacement lacks (\d+) of \d+ frames, at the longest \d+ ms", report)
    assert lacks is not None
    assert int(lacks[1]) == frames.lost
    assert any("frames are missing by their stamps" in message for message in said["tracker"])
    assert any("because this computer fell behind" in message for message in said["hub"])


@pytest.mark.slow
def test_a_demo_whose_nodes_cannot_do_it_says_so_and_reports_what_the_core_did(
    monkeypatch, capsys, tmp_path: Path
) -> None:
    """Every attempt is given its end: what comes of it does not depend on this computer."""
    late = "its stamp is 0.202 s old; expected at most 0.2 s"

    def fail(*_arguments: object, **_options: object) -> dict[str, object]:
        (tmp_path / "run" / "logs").mkdir()
        raise RigUnavailableError(late)

    monkeypatch.setattr(demo_of_rig, "_with_nodes", fail)
    status = main(["demo", "--out", str(tmp_path / "run"), *SHORT])
    said = capsys.readouterr()
    assert status == 1
    assert said.err.count(late) == 2
    assert said.err.count("nothing moved") == 2
    assert "trying again" in said.err
    assert "not shown: the nodes" in said.out
    assert (tmp_path / "run" / "report.html").is_file()
    assert [(tmp_path / "run" / f"attempt-{number}" / "logs").is_dir() for number in (1, 2)] == [True, True]


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_demo_ends_every_process(executables, number: signal.Signals) -> None:
    demo = executables.start("beam", "demo", "--out", "run", *SHORT)
    demo.wait_for("home and enable", GUARD_S)
    demo.send_signal(number)
    assert demo.wait(60.0) == 130
    assert "Traceback" not in demo.output()
    assert "ended with status 0" in demo.output()


def test_an_excitation_that_leaves_a_limit_is_refused_before_anything_starts(
    executables, tmp_path: Path
) -> None:
    demo = executables.run(
        "beam", "demo", "--out", "run", "-p", "excitation.acceleration:=3.0", timeout_s=30.0
    )
    assert demo.process.returncode == 2
    assert len(demo.output().strip().splitlines()) == 1
    assert "predicted tip deflection" in demo.output()
    assert not (tmp_path / "run").exists()


def test_a_fallen_node_is_told_with_its_last_words(tmp_path: Path) -> None:
    with NodeGroup(tmp_path / "logs") as nodes:
        nodes.start("hub_driver", ("--ros-args", "-p", "serial.port:=sokcet://there")).process.wait(20.0)
        with pytest.raises(RigUnavailableError, match=r"hub_driver ended with status 2.*sokcet://there"):
            nodes.check()


def test_what_a_shell_says_of_discovery_does_not_reach_a_private_graph(tmp_path: Path) -> None:
    environ = {
        "ROS_STATIC_PEERS": "192.0.2.1",
        "ROS_DISCOVERY_SERVER": "192.0.2.1:11811",
        "FASTDDS_BUILTIN_TRANSPORTS": "LARGE_DATA",
        "HOME": "/",
    }
    stay_on_this_machine(environ, 5, tmp_path)
    assert "FASTDDS_BUILTIN_TRANSPORTS" not in environ
    assert "192.0.2.1" not in "".join(environ.values())
    assert environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"
    assert environ["HOME"] == "/"


def test_two_private_domains_are_never_the_same() -> None:
    first, second = PrivateDomain(), PrivateDomain()
    assert first.number != second.number
    first.release()
    second.release()
