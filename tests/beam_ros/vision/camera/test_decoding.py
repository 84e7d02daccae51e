from __future__ import annotations

import sys
import threading
from pathlib import Path

import cv2
import numpy as np
import pytest

from beam_ros.process.progress import Progress
from beam_ros.vision.camera.decoding import Decoder
from tests.beam_ros.vision.camera.test_video import write_video


def film(path: Path, codec: str, n_frames: int = 60) -> list[np.ndarray]:
    """Write a grey film of bars that move; returns its pictures."""
    rng, x = np.random.default_rng(3), np.arange(160.0)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*codec), 100.0, (160, 96), False)
    assert writer.isOpened()
    pictures = []
    for k in range(n_frames):
        row = 120 + 80 * np.sin(0.3 * x + 0.5 * k)
        pictures.append(np.rint(row + rng.normal(0, 3, (96, 160))).astype(np.uint8))
        writer.write(pictures[-1])
    writer.release()
    return pictures


def damage(path: Path, n_bytes: int, seed: int) -> None:
    """Flip bytes in the second half of a film."""
    data, rng = bytearray(path.read_bytes()), np.random.default_rng(seed)
    for at in rng.integers(len(data) // 2, int(0.95 * len(data)), n_bytes):
        data[int(at)] ^= int(rng.integers(1, 256))
    path.write_bytes(data)


def packets(path: Path) -> list[bytes]:
    """The pictures as they lie in a film; the codec's own data first where it has some."""
    capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG, [cv2.CAP_PROP_FORMAT, -1])
    _, header = capture.retrieve(flag=int(capture.get(cv2.CAP_PROP_CODEC_EXTRADATA_INDEX)))
    found = [b"" if header is None else header.tobytes()]
    while (read := capture.read())[0]:
        found.append(read[1].tobytes())
    return found


def read_alone(path: Path) -> tuple[list[np.ndarray], list[float]]:
    """Pictures and times as OpenCV gives them one by one, in colour."""
    capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG, [cv2.CAP_PROP_N_THREADS, 1])
    pictures, times = [], []
    for _ in range(int(capture.get(cv2.CAP_PROP_FRAME_COUNT))):
        is_read, picture = capture.read()
        if is_read:
            pictures.append(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY))
            times.append(capture.get(cv2.CAP_PROP_POS_MSEC))
    return pictures, times


@pytest.mark.parametrize("is_heeded", [False, True])
@pytest.mark.parametrize("codec", ["FFV1", "MJPG"])
def test_pictures_come_in_order_as_they_were_written(tmp_path: Path, codec: str, is_heeded: bool) -> None:
    path = tmp_path / "film.avi"
    written = film(path, codec)
    found = list(Decoder(path, is_heeded=is_heeded).pictures())
    assert [round(picture.shown_ns / 1e7) for picture in found] == list(range(60))
    assert not any(picture.is_damaged or picture.n_undecodable for picture in found)
    worst = max(np.abs(a.image.astype(int) - b).max() for a, b in zip(found, written, strict=True))
    assert worst <= (0 if codec == "FFV1" else 30)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("codec", ["FFV1", "MJPG"])
def test_damage_marks_pictures_and_changes_none_of_the_others(tmp_path: Path, codec: str, seed: int) -> None:
    path = tmp_path / "film.avi"
    film(path, codec)
    (whole, _), (header, *written) = read_alone(path), packets(path)
    if codec == "FFV1" and not header:
        pytest.skip(f"OpenCV {cv2.__version__} writes FFV1 without checksums")
    damage(path, 6, seed)
    alone, times = read_alone(path)
    found = list(Decoder(path, is_heeded=True).pictures())
    # All processors or one, what is decoded stays the same, damaged or not.
    assert len(found) == len(alone)
    assert all(np.array_equal(a.image, b) for a, b in zip(found, alone, strict=True))
    assert [picture.shown_ns for picture in found] == [round(time * 1e6) for time in times]
    differ = [not np.array_equal(picture.image, whole[round(picture.shown_ns / 1e7)]) for picture in found]
    marked = [picture.is_damaged for picture in found]
    assert any(marked) or found[-1].n_undecodable
    spoilt = [before != now for before, now in zip(written, packets(path)[1:], strict=False)]
    early = differ.index(True) if any(differ) else 30
    assert not any(mark and not is_spoilt for mark, is_spoilt in zip(marked[:early], spoilt, strict=False))
    one_by_one = Decoder(path, is_heeded=True)._decoded(is_one_by_one=True)
    assert marked == [picture.is_damaged for picture in one_by_one]


def test_what_python_says_meanwhile_is_seen_and_marks_nothing(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "film.avi"
    film(path, "FFV1")
    marked = 0
    saved = sys.stderr
    try:
        sys.stderr = open(2, "w", buffering=1, closefd=False, encoding="utf-8")  # noqa: SIM115
        stage = Progress("track", 1.0)
        for picture in Decoder(path, is_heeded=True).pictures():
            marked += picture.is_damaged
            stage.finish("a line")
    finally:
        sys.stderr = saved
    assert marked == 0
    assert capfd.readouterr().err.count("a line") == 60


@pytest.mark.slow
@pytest.mark.parametrize("is_heeded", [False, True])
def test_who_stops_early_leaves_no_decoder_behind(tmp_path: Path, is_heeded: bool) -> None:
    path = tmp_path / "beam.avi"
    write_video(path)
    for n_taken in (1, 12, 40):
        pictures = Decoder(path, is_heeded=is_heeded).pictures()
        taken = [round(next(pictures).shown_ns / 1e7) for _ in range(n_taken)]
        assert taken == list(range(n_taken))
        assert "decoder" in [thread.name for thread in threading.enumerate()] or n_taken > 30
        pictures.close()
        assert "decoder" not in [thread.name for thread in threading.enumerate()]
