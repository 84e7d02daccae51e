"""A laboratory's own package adds to the suite's tables, installed by pip beside the suite, which is not edited."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from beam_ros import messages
from beam_ros.bags.batches import decode_batch
from beam_ros.messages import Displacement, Health, StampedSetpoint
from beam_ros.process.environment import child_environment
from beam_ros.process.executables import command
from tests.graph import Graph
from tests.real_processes import Executables

pytestmark = pytest.mark.ros

PLUG_IN = Path(__file__).parent / "plug_in"
TOY_PERIOD_NS = 20_000_000

Laboratory = Callable[[str], list[str]]
"""From an executable to the command that starts it where the package is installed."""


def _link_or_copy(source: str, target: str) -> None:
    try:
        os.link(source, target)
    except OSError:  # another file system
        shutil.copy2(source, target)


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Laboratory]:
    """Executables of a copy of this environment, into which pip has installed the package; nothing is downloaded."""
    if sys.prefix == sys.base_prefix:
        pytest.skip("this Python is not in a virtual environment that can be copied")
    folder = tmp_path_factory.mktemp("laboratory")
    prefix = folder / "venv"
    shutil.copytree(sys.prefix, prefix, symlinks=True, copy_function=_link_or_copy)
    package = shutil.copytree(PLUG_IN, folder / "package")  # pip builds in the package's own folder
    python = str(prefix / "bin" / "python")
    offline = ("--quiet", "--no-index", "--no-deps", "--no-build-isolation")
    subprocess.run(
        [python, "-m", "pip", "install", *offline, str(package)],
        env=child_environment(),
        check=True,
        timeout=120,
    )
    yield lambda executable: [python, *command(executable)[1:]]
    shutil.rmtree(folder)


def test_the_tracker_measures_the_frames_of_a_camera_that_a_package_adds(
    laboratory: Laboratory, executables: Executables
) -> None:
    seen: list[Displacement] = []
    health: list[Health] = []
    with Graph() as graph:
        graph.listen("beam/displacement", lambda m: seen.append(messages.read_displacement(m)))
        graph.listen("/diagnostics", lambda m: health.extend(messages.read_diagnostics(m)))
        executables.start(
            "vision_tracker", "--ros-args", "-p", "tracker.source:=toy", program=laboratory("vision_tracker")
        )
        graph.wait(lambda: len(seen) > 50 and bool(health), "frames and diagnostics", 40.0)
    # camera.stamp is mid: what is measured at the middle of the exposure has the frame's own stamp.
    stamps = np.array([displacement.stamp_ns for displacement in seen])
    assert np.all(stamps % TOY_PERIOD_NS == 0)
    assert np.all(np.diff(stamps) == TOY_PERIOD_NS)
    # 0.006 px of noise at 1500 px/m
    assert seen[-1].positions == pytest.approx([0.001] * 3, abs=2e-5)
    assert "the toy is not a real camera" in health[-1].message
    assert "the stamps of toy mean start, and camera.stamp is mid" in health[-1].message


def test_a_kind_that_nobody_adds_is_answered_with_all_there_are_and_the_nearest(
    laboratory: Laboratory, executables: Executables
) -> None:
    running = executables.start(
        "vision_tracker", "--ros-args", "-p", "tracker.source:=tooy", program=laboratory("vision_tracker")
    )
    assert running.wait(40.0) == 2
    assert running.output().count("\n") == 1
    assert "expected one of topic, device, file, compressed, toy; did you mean 'toy'?" in running.output()


def test_the_driver_moves_an_axis_whose_link_a_package_adds(
    laboratory: Laboratory, executables: Executables
) -> None:
    measured: list[bytes] = []
    # Settings of its own come as one text of YAML.
    own = ("-p", 'axis.options:="{offset: 0.25}"')
    options = ("-p", "axis.kind:=toy", "-p", "hub.command_mode:=position", *own)
    with Graph() as graph:
        graph.listen("hub/measured", measured.append, raw=True)
        setpoints = graph.publisher("hub/setpoint")
        executables.start("hub_driver", "--ros-args", *options, program=laboratory("hub_driver"))
        graph.wait(lambda: bool(measured), "a measurement", 40.0)
        for kind, data in (("home", None), ("enable", True)):
            assert graph.call(f"hub/{kind}", data=data).message == f"the toy did {kind}"
        point = StampedSetpoint(graph.node.get_clock().now().nanoseconds, "position", 0.012)
        setpoints.publish(messages.setpoint(graph.types, point))
        graph.wait(
            lambda: bool(measured) and decode_batch(measured[-1]).positions[-1] == 0.262, "a measured move"
        )
    batches = [decode_batch(data) for data in measured]
    assert batches[0].positions[0] == 0.25
    assert all(batch.stamp_ns % TOY_PERIOD_NS == 0 for batch in batches[1:])


def test_a_link_that_nobody_adds_is_answered_with_all_there_are_and_the_nearest(
    laboratory: Laboratory, executables: Executables
) -> None:
    running = executables.start(
        "hub_driver", "--ros-args", "-p", "axis.kind:=toyy", program=laboratory("hub_driver")
    )
    assert running.wait(40.0) == 2
    assert (
        "axis.kind is 'toyy': expected one of beam, trajectory_controller, odrive, dynamixel, csv, toy; did you mean "
        "'toy'?" in running.output()
    )
    assert running.output().count("\n") == 1
