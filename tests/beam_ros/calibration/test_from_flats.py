from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from beam_ros.cli.main import main
from beam_ros.rig.rig import Rig

GAIN, READ = 0.08, 1.5


def film(path: Path, grey: float, seed: int, n_frames: int = 12) -> Path:
    """Frames of even light, as a folder of pictures."""
    rng = np.random.default_rng(seed)
    path.mkdir()
    for k in range(n_frames):
        read = 5.0 + GAIN * rng.poisson(np.full((48, 64), grey / GAIN)) + READ * rng.standard_normal((48, 64))
        cv2.imwrite(str(path / f"{k:03}.png"), np.clip(np.rint(read), 0, 255).astype(np.uint8))
    return path


def as_video(folder: Path) -> Path:
    path = folder.with_suffix(".avi")
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"FFV1"), 25.0, (64, 48), False)
    for picture in sorted(folder.iterdir()):
        writer.write(cv2.imread(str(picture), cv2.IMREAD_GRAYSCALE))
    writer.release()
    return path


def test_the_saved_file_gives_the_tracker_the_cameras_noise(tmp_path, capsys):
    dark, dim, bright = (
        film(tmp_path / name, grey, k) for k, (name, grey) in enumerate({"a": 0, "b": 50, "c": 180}.items())
    )
    saved = tmp_path / "noise.yaml"
    words = ["calibrate", "camera-noise", str(dim), str(as_video(bright)), "--dark", str(dark)]
    assert main([*words, "--save", str(saved)]) == 0
    assert "read noise   1.5" in capsys.readouterr().out
    line = Rig.from_file(saved).tracker_parameters().noise_line
    assert line[1] == pytest.approx(GAIN, rel=0.05)
    assert line[0] == pytest.approx(READ**2 + 1 / 12 - GAIN * 5.0, rel=0.1)
    assert main([*words, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["camera_noise"]
    assert found["bias"] == pytest.approx(5.0, abs=0.05)
    assert found["n_frames"] == [12, 12, 12]


def test_a_users_fault_is_one_line(tmp_path, capsys):
    assert main(["calibrate", "camera-noise"]) == 2
    assert "needs series of frames" in capsys.readouterr().err
    (tmp_path / "empty").mkdir()
    assert main(["calibrate", "camera-noise", str(tmp_path / "empty")]) == 2
    assert main(["calibrate", str(tmp_path / "empty"), "--dark", str(tmp_path / "empty")]) == 2
    assert "--dark goes with" in capsys.readouterr().err
    assert main(["calibrate", "camera-noise", str(tmp_path / "empty"), "--board", "8x6"]) == 2
    assert "--board goes with pictures of a board" in capsys.readouterr().err
