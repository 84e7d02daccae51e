"""A video file played as a camera: at its own rate, from now on."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path

from beam_ros.arrays import ImageArray
from beam_ros.vision.camera.source import CameraSource, CapturedFrame
from beam_ros.vision.camera.video import VideoFile
from beam_ros.vision.errors import CaptureError


class VideoPlayback(CameraSource):
    """A video file, played at its own rate from now on.

    Parameters
    ----------
    path : Path
    rate_hz : float or None -- frames a second; None believes the file
    now_ns : callable -- the clock by which the first frame is stamped [ns, UNIX]

    Raises
    ------
    VideoError
        There is no such file, or it is not a video.
    """

    is_paced = True

    def __init__(self, path: Path, rate_hz: float | None, now_ns: Callable[[], int] = time.time_ns) -> None:
        self.name = str(path)
        self._video = VideoFile(path, rate_hz=rate_hz)
        self._now_ns = now_ns
        self._start_ns = 0
        self._frames: Iterator[tuple[int, ImageArray]] = iter(())

    def open(self) -> None:
        """Begin; the first frame is now."""
        self._frames = self._video.frames()
        self._start_ns = self._now_ns()

    def read(self) -> CapturedFrame | None:
        """Next frame, or None at the end of the file."""
        try:
            time_ns, image = next(self._frames)
        except StopIteration:
            return None
        except OSError as err:
            raise CaptureError(f"{err}; set tracker.video") from err
        return CapturedFrame(self._start_ns + time_ns, image)

    def close(self) -> None:
        """Let the file go."""
        self._frames = iter(())
