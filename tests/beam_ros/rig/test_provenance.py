"""Provenance: what a bag says of how it came about is true, and what is not known is left out."""

from __future__ import annotations

import json
import platform
import subprocess
from pathlib import Path

from beam_ros.rig.provenance import provenance
from beam_ros.rig.rig import Rig


def test_rig_camera_operator_and_host_are_named():
    rig = Rig.from_file().with_values({"camera.name": "lab camera 2", "camera.focus": "25 mm, f/8"})
    said = provenance(rig, "A. Person")
    assert said["operator"] == "A. Person"
    assert said["host"] == platform.node()
    assert (said["camera"], said["lens"]) == ("lab camera 2", "25 mm, f/8")
    assert Rig.from_nested(json.loads(said["rig"])).values == rig.values
    assert "calibration" not in said


def test_a_calibration_is_carried_whole(tmp_path):
    file = tmp_path / "calibration.yaml"
    file.write_text("scale: 1.0\n")
    rig = Rig.from_file().with_values({"tracker.calibration": str(file)})
    assert provenance(rig)["calibration"] == "scale: 1.0\n"
    file.unlink()
    assert provenance(rig)["calibration_file"] == str(file)


def test_the_commit_is_the_one_that_git_names():
    folder = Path(__file__).parent
    answer = subprocess.run(
        ["git", "-C", str(folder), "rev-parse", "HEAD"], capture_output=True, text=True, check=False
    )
    said = provenance(Rig.from_file()).get("git", "")
    assert said.startswith(answer.stdout.strip())
