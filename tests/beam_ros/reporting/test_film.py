from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("cv2")

import cv2

from beam_ros.offline.identification import Identification, identification_of_bags
from beam_ros.reporting.film import write_film
from tests.beam_ros.reporting.conftest import N_FRAMES


def test_a_bag_without_images_has_no_film(outcome: Identification, tmp_path: Path) -> None:
    assert write_film(outcome, tmp_path / "film.mp4") == ""
    assert list(tmp_path.iterdir()) == []


def test_crosses_lie_on_the_markers_in_every_frame(filmed_bag: Path, tmp_path: Path) -> None:
    shares = []
    said = write_film(
        identification_of_bags(filmed_bag), tmp_path / "film.mp4", lambda phrase, share: shares.append(share)
    )
    assert said.startswith(f"The first {N_FRAMES} frames, 4 times slower")
    assert shares[-1] == 1.0
    film = cv2.VideoCapture(str(tmp_path / "film.mp4"))
    count = 0
    while True:
        is_read, frame = film.read()
        if not is_read:
            break
        count += 1
        blue, _, red = (frame[:, :, k].astype(float) for k in range(3))
        rows, columns = np.nonzero(red - blue > 80.0)
        columns, rows = columns[rows > 30], rows[rows > 30]  # below the clock in the corner
        grey = frame.min(axis=2).astype(float)
        for height in (0.010, 0.225, 0.285):
            row = round(465.0 - 1500.0 * height)
            near = np.abs(rows - row) <= 9
            assert np.count_nonzero(near) > 10
            # The middle of the cross is the middle of the bright disc under it.
            disc = grey[row - 8 : row + 9]
            _, across = np.nonzero(disc > 120.0)
            assert np.mean(columns[near]) == pytest.approx(np.mean(across), abs=2.0)
    assert count == N_FRAMES
