from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

N_FRAMES = 12


@pytest.fixture
def video(tmp_path: Path) -> Path:
    path = tmp_path / "film.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 50.0, (64, 48))
    for k in range(N_FRAMES):
        writer.write(np.full((48, 64, 3), 10 * k, np.uint8))
    writer.release()
    return path
