"""Films written here and read by OpenCV's own decoder: pictures and times come back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from beam_ros.vision.camera.matroska import MatroskaWriter
from beam_ros.vision.camera.video import VideoFile
from beam_ros.vision.errors import VideoError

RNG = np.random.default_rng(0)
FRAMES = RNG.integers(0, 80, (30, 48, 64)).astype(np.uint8)


def written(path: Path, times_ns: np.ndarray, quality: int | None = None) -> VideoFile:
    with MatroskaWriter(path, 64, 48, 100.0, quality) as writer:
        for time_ns, frame in zip(times_ns, FRAMES, strict=False):
            writer.write(int(time_ns), frame)
    return VideoFile(path)


def test_frames_at_a_variable_rate_come_back_with_their_times(tmp_path: Path) -> None:
    times = np.cumsum(RNG.integers(4_000_000, 20_000_000, 30)).astype(np.int64)
    times -= times[0]
    video = written(tmp_path / "film.mkv", times)
    read = list(video.frames())
    assert all(np.array_equal(image, frame) for (_, image), frame in zip(read, FRAMES, strict=True))
    # The file counts microseconds.
    found = np.array([time_ns for time_ns, _ in read])
    assert np.abs(found - times).max() <= 1000
    settled, period, notes = video.settled_times(found)
    assert period is None
    assert np.array_equal(settled, found)
    assert "variable rate" in notes[0]


@pytest.mark.parametrize("resolution_ns", [1, 1_000_000])
def test_frames_that_a_container_leaves_out_are_counted_and_the_others_are_on_the_grid(
    tmp_path: Path, resolution_ns: int
) -> None:
    numbers = np.delete(np.arange(33), [7, 20, 21])
    exact = numbers * (1e9 / 60.0)
    with MatroskaWriter(tmp_path / "film.mkv", 64, 48, 60.0) as writer:
        for time_ns, frame in zip(exact, FRAMES, strict=True):
            writer.write(round(time_ns / resolution_ns) * resolution_ns, frame)
    video = VideoFile(tmp_path / "film.mkv")
    times = np.array([time_ns for time_ns, _ in video.frames()])
    settled, period, notes = video.settled_times(times)
    assert period == pytest.approx(1 / 60.0, rel=1e-6)
    assert np.abs(settled - exact).max() < 100
    assert notes == ["3 frames are missing between the first and the last, as the container's times say"]


def test_jpeg_keeps_the_times_and_loses_only_grey_levels(tmp_path: Path) -> None:
    video = written(tmp_path / "film.mkv", np.arange(30) * 10_000_000, quality=95)
    times, images = zip(*video.frames(), strict=True)
    assert list(times) == [k * 10_000_000 for k in range(30)]
    assert np.abs(np.array(images, dtype=int) - FRAMES).mean() < 3


def test_a_film_that_is_cut_short_is_read_as_far_as_it_goes(tmp_path: Path) -> None:
    written(tmp_path / "film.mkv", np.arange(30) * 10_000_000)
    data = (tmp_path / "film.mkv").read_bytes()
    (tmp_path / "cut.mkv").write_bytes(data[: len(data) // 2])
    assert 10 <= len(list(VideoFile(tmp_path / "cut.mkv").frames())) <= 16


def test_a_place_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    with pytest.raises(VideoError, match="cannot be written"):
        MatroskaWriter(tmp_path / "none" / "film.mkv", 64, 48, 100.0)
