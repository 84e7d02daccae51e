from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("cv2")

import cv2

from beam_ros.offline.identification import identification_of_bags
from beam_ros.offline.identification_summary import IdentificationOutcome
from beam_ros.reporting.film import write_film

FRAMES = Path(__file__).resolve().parents[3] / "bags" / "frames"
N_FRAMES = 227


@pytest.mark.slow
def test_a_bag_without_images_has_no_film(outcome: IdentificationOutcome, tmp_path: Path) -> None:
    assert write_film(outcome, tmp_path / "film.mp4") == ""
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_crosses_lie_on_the_markers_in_every_frame(tmp_path: Path) -> None:
    shares: list[float] = []
    found = identification_of_bags(FRAMES)
    said = write_film(found, tmp_path / "film.mp4", lambda phrase, share: shares.append(share))
    assert said.startswith(f"The first {N_FRAMES} frames, 2 times slower")
    assert shares[-1] == 1.0
    rig = found.experiment.rig
    assert rig is not None
    camera = rig.camera_parameters()
    film = cv2.VideoCapture(str(tmp_path / "film.mp4"))
    crosses, frames = 0, 0
    while True:
        is_read, frame = film.read()
        if not is_read:
            break
        frames += 1
        blue, _, red = (frame[:, :, k].astype(float) for k in range(3))
        grey = frame.min(axis=2).astype(float)
        for height in rig.markers.heights:
            row = round(float(camera.rows(height)))
            band = slice(max(row - 8, 0), row + 9)
            _, of_cross = np.nonzero((red - blue)[band] > 60.0)
            _, of_disc = np.nonzero(grey[band] > 90.0)
            if len(of_cross) < 5 or len(of_disc) < 3:  # before the first sample, or at the frame's edge
                continue
            crosses += 1
            # The middle of the cross is the middle of the bright disc under it.
            assert np.mean(of_cross) == pytest.approx(np.mean(of_disc), abs=2.5)
    assert frames == N_FRAMES
    assert crosses > 2.5 * N_FRAMES
