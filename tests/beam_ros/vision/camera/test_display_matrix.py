"""Films that want to be shown turned or mirrored, made by another library's writer and marked as telephones do."""

from __future__ import annotations

import struct
from pathlib import Path

import cv2
import numpy as np
import pytest

from beam_ros.vision.camera.display_matrix import display_matrix
from beam_ros.vision.camera.video import VideoFile

ONE = 65536


@pytest.fixture(scope="module")
def upright_film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bright block in the top left corner of wide pictures."""
    path = tmp_path_factory.mktemp("film") / "film.mp4"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), 50.0, (96, 64))
    if not writer.isOpened():
        pytest.skip("this OpenCV writes no MP4")
    picture = np.zeros((64, 96, 3), np.uint8)
    picture[:16, :32] = 220
    for _ in range(5):
        writer.write(picture)
    writer.release()
    return path


def marked(film: Path, target: Path, a: int, b: int, c: int, d: int) -> Path:
    data = bytearray(film.read_bytes())
    at = data.index(b"tkhd") + 4 + 40
    struct.pack_into(">5i", data, at, a * ONE, b * ONE, 0, c * ONE, d * ONE)
    target.write_bytes(data)
    return target


@pytest.mark.parametrize(
    ("matrix", "corner", "shape"),
    [
        # Where the block is then: the words of ISO/IEC 14496-12, (x, y) -> (a x + c y, b x + d y).
        ((1, 0, 0, 1), "top left", (64, 96)),
        ((0, 1, -1, 0), "top right", (96, 64)),
        ((-1, 0, 0, -1), "bottom right", (64, 96)),
        ((0, -1, 1, 0), "bottom left", (96, 64)),
        ((-1, 0, 0, 1), "top right", (64, 96)),
        ((1, 0, 0, -1), "bottom left", (64, 96)),
        ((0, 1, 1, 0), "top left", (96, 64)),
    ],
)
def test_pictures_are_turned_as_the_film_says(upright_film, tmp_path, matrix, corner, shape):
    video = VideoFile(marked(upright_film, tmp_path / "film.mp4", *matrix))
    assert (video.height, video.width) == shape
    assert video.is_turned == (matrix != (1, 0, 0, 1))
    _, image = next(video.frames())
    assert image.shape == shape
    rows, columns = np.nonzero(image > 128)
    down = "top" if rows.mean() < shape[0] / 2 else "bottom"
    across = "left" if columns.mean() < shape[1] / 2 else "right"
    assert f"{down} {across}" == corner


def test_other_files_and_broken_ones_are_shown_as_they_are(tmp_path, video):
    assert display_matrix(video) is None
    (tmp_path / "broken.mp4").write_bytes(b"\0\0\0\x18ftypisom" + b"\0" * 12 + b"\0\0\0\x05moov")
    assert display_matrix(tmp_path / "broken.mp4") is None
    assert display_matrix(tmp_path / "absent.mp4") is None
