from __future__ import annotations

from pathlib import Path

import pytest

from beam_ros.vision.camera.playback import VideoPlayback
from beam_ros.vision.errors import CaptureError, VideoError


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(VideoError, match="no such video file"):
        VideoPlayback(tmp_path / "nowhere.avi", None)


def test_a_file_that_has_gone_is_named(video: Path) -> None:
    camera = VideoPlayback(video, None)
    video.unlink()
    camera.open()
    with pytest.raises(CaptureError, match=r"no such video file.*tracker\.video"):
        camera.read()
