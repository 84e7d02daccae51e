"""The controller and its driver on one host, everything else on another, with a real network stack between them."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import Reader

from beam_ros.bags.batches import decode_batch
from beam_ros.excitation.plan import plan_excitation
from beam_ros.process.environment import child_environment
from beam_ros.rig.rig import Rig
from tests.beam_ros.nodes.two_hosts import QUICK

pytestmark = [pytest.mark.ros, pytest.mark.verify]
pytest.importorskip("rclpy")

ROOT = Path(__file__).parents[3]
APART = ["unshare", "--map-root-user", "--net", "--mount"]


def test_an_experiment_commanded_and_recorded_on_another_host_loses_nothing(tmp_path: Path) -> None:
    for tool in ("ip", "unshare", "nsenter"):
        if shutil.which(tool) is None:
            pytest.skip(f"two hosts need the command {tool}: expected the packages iproute2 and util-linux")
    tried = subprocess.run(
        [*APART, "mount", "-t", "tmpfs", "none", "/run"], capture_output=True, text=True, check=False
    )
    if tried.returncode:
        pytest.skip(f"two hosts need network namespaces, which this machine refuses: {tried.stderr.strip()}")
    ended = subprocess.run(
        [*APART, sys.executable, "-m", "tests.beam_ros.nodes.two_hosts", str(tmp_path)],
        cwd=ROOT,
        env=child_environment(),
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr
    told = json.loads(ended.stdout)
    assert told["answers"]["hub/enable"] == "enabled\n"
    assert told["answers"]["excitation/start"].endswith(" starts\n")
    assert set(told["statuses"].values()) == {0}
    batches, states = [], []
    with Reader(tmp_path / "bag") as reader:
        for connection, _, data in reader.messages():
            if connection.topic == "/hub/applied":
                batches.append(decode_batch(data))
            elif connection.topic == "/hub/sequence_state":
                states.append(json.loads(bytes(data)[8:].rstrip(b"\0"))["state"])
    assert states[-1] == "done"
    stamps = np.array([batch.stamp_ns for batch in batches])
    assert np.all(np.diff(stamps) < 1.5 * np.median(np.diff(stamps))), "batches were lost on the network"
    applied = np.concatenate([batch.accelerations for batch in batches])
    design = plan_excitation(Rig.from_file().with_texts(QUICK)).values
    first = np.flatnonzero(applied)[0] - np.flatnonzero(design)[0]
    # The line carries single precision.
    np.testing.assert_allclose(applied[first : first + len(design)], design, rtol=1e-7, atol=1e-12)
