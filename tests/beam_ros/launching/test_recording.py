"""A plan on a rig of nodes: recorded over DDS, interrupted, and gone on with; nothing of it is left behind."""

from __future__ import annotations

import json
import signal
import time
from pathlib import Path

import pytest

pytestmark = pytest.mark.ros
pytest.importorskip("rclpy")
pytest.importorskip("cv2")

PLAN = """
title: Short, with nodes
parameters:
  excitation.start_delay: 4 s
recordings:
  E1:
    excitation: {kind: chirp, duration: 4 s, still: 1 s, end_frequency: 45 Hz}
  V1:
    excitation: {kind: chirp, duration: 4 s, still: 1 s, end_frequency: 40 Hz}
estimations:
  modal: {recordings: [E1], modes: 2}
validations:
  - {estimation: modal, recordings: [V1]}
"""


def test_a_plan_on_the_emulated_rig_goes_on_after_ctrl_c_and_keeps_what_the_axis_moved_for(
    executables, tmp_path: Path
) -> None:
    (tmp_path / "plan.yaml").write_text(PLAN)
    words = ("experiment", "plan.yaml", "--rig", "emulated", "--out", "run")
    first = executables.start("beam", *words)
    first.wait_for("record E1  ", 100.0)
    first.wait_for("home and enable  ", 100.0)
    end = time.monotonic() + 60.0
    while first.output().count("home and enable  ") < 2 and time.monotonic() < end:
        time.sleep(0.05)
    first.send_signal(signal.SIGINT)
    assert first.wait(30.0) == 130, first.output()
    assert list(json.loads((tmp_path / "run" / "state.json").read_text())["steps"]) == ["record E1"]
    for _ in range(5):
        second = executables.run("beam", *words, "--resume", "--json", timeout_s=150.0)
        # A computer that is too busy for a sequence is named, and what the message says to do is done.
        if second.process.returncode == 0 or "go on with --resume" not in second.output():
            break
    assert second.process.returncode == 0, second.output()
    output = second.output()
    outcome = json.loads(output[output.index("{\n") :])
    assert "record E1" in output
    assert "(done before)" in output
    modes = outcome["estimates"][0]["modes"]
    assert modes[0]["frequency_hz"] == pytest.approx(4.3839, rel=3e-3)
    assert modes[1]["frequency_hz"] == pytest.approx(28.262, rel=3e-3)
    assert (tmp_path / "run" / "interrupted").is_dir()
    assert {path.name for path in (tmp_path / "run" / "bags").iterdir()} == {"E1", "V1"}
