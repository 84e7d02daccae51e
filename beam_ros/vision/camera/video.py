"""Frames from a video file, with the times that the file or its user states.

Fast cameras and telephones leave a file afterwards. Its frame rate may be the one it was recorded with, one
for slow replay, or none at all; times that the user gives always come first.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from decimal import Decimal, InvalidOperation
from pathlib import Path
from queue import Empty, Queue
from threading import Event, Thread
from typing import Any

import cv2

from beam_ros.arrays import ImageArray
from beam_ros.vision.camera.images import grey_frame
from beam_ros.vision.errors import ImageFormatError, VideoError

_NS = 1_000_000_000
_DECODED_AHEAD = 8
"""Frames that a file's decoder may be ahead of who takes them."""
_MAX_STAMP_S = 9_150_000_000
"""Stamps are 64-bit nanoseconds since 1970, which end in 2262 [s]."""


class VideoFile:
    """Frames of a video, in grey.

    Parameters
    ----------
    path : Path -- the file
    rate_hz : float or None -- frame rate; None believes the file
    frame_times_ns : sequence of int or None -- time of every frame [ns]; comes before any rate

    Attributes
    ----------
    width, height : int -- [px]
    rate_hz : float -- frame rate; NaN where only times are given
    n_frames : int -- what the file claims; 0 where it does not say
    n_times : int or None -- how many frame times were given
    """

    def __init__(
        self, path: Path, *, rate_hz: float | None = None, frame_times_ns: Sequence[int] | None = None
    ) -> None:
        self.path = Path(path)
        capture = self._open()
        try:
            self.width = int(capture.get(cv2.CAP_PROP_FRAME_WIDTH))
            self.height = int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
            self.n_frames = max(0, int(capture.get(cv2.CAP_PROP_FRAME_COUNT)))
            stated = float(capture.get(cv2.CAP_PROP_FPS))
        finally:
            capture.release()
        self._times = None if frame_times_ns is None else [int(time) for time in frame_times_ns]
        self.n_times = None if self._times is None else len(self._times)
        if self._times is not None:
            if any(
                later <= earlier for earlier, later in zip(self._times[:-1], self._times[1:], strict=True)
            ):
                raise VideoError(
                    f"{self.path}: the frame times given do not rise; expected one later than the other"
                )
            self.rate_hz = math.nan
            return
        rate = stated if rate_hz is None else float(rate_hz)
        if not (math.isfinite(rate) and 0 < rate <= 1e6):
            whose = "the file states" if rate_hz is None else "given is"
            raise VideoError(
                f"{self.path}: {whose} a frame rate of {rate!r} Hz; expected one > 0: give the frame rate"
            )
        self.rate_hz = rate

    def _open(self) -> Any:
        if self.path.is_dir():
            raise VideoError(
                f"{self.path}: this is a folder; give the video file, not the folder that it is in"
            )
        if not self.path.is_file():
            raise VideoError(f"{self.path}: no such video file; check the path")
        fault: cv2.error | None = None
        try:
            capture = cv2.VideoCapture(str(self.path))
            # Some versions open whatever has a name, and find nothing in it.
            if capture.isOpened() and capture.get(cv2.CAP_PROP_FRAME_WIDTH) >= 1:
                return capture
            capture.release()
        except cv2.error as err:
            fault = err
        raise VideoError(
            f"{self.path}: no video that OpenCV {cv2.__version__} can read; convert it, for example with "
            "`ffmpeg -i FILE -c:v ffv1 OUT.avi`"
        ) from fault

    def frames(self) -> Iterator[tuple[int, ImageArray]]:
        """Read the frames, one after the other; a thread decodes some ahead while the caller works.

        Yields
        ------
        time_ns : int -- since the first frame, or as given [ns]
        image : ndarray, shape (height, width), uint8 or uint16

        Raises
        ------
        VideoError -- fewer times than frames, no frame at all, or one that cannot be decoded
        """
        waiting: Queue[ImageArray | VideoError | None] = Queue(_DECODED_AHEAD)
        is_over = Event()
        decoder = Thread(
            target=self._decode, args=(self._open(), waiting, is_over), name="decoder", daemon=True
        )
        decoder.start()
        count = 0
        try:
            while (image := waiting.get()) is not None:
                if isinstance(image, VideoError):
                    raise image
                yield self._time(count), image
                count += 1
        finally:
            is_over.set()
            with suppress(Empty):
                waiting.get_nowait()  # a decoder that waits for room sees that nobody wants more
            decoder.join()
        if count == 0:
            raise VideoError(f"{self.path}: not one frame can be read; the file may be cut short")

    def _decode(self, capture: Any, waiting: Queue[ImageArray | VideoError | None], is_over: Event) -> None:
        """Decode frames until the file ends (None), cannot be read on (the error), or nobody wants more."""
        count = 0
        try:
            while not is_over.is_set():
                try:
                    is_read, frame = capture.read()
                    image = grey_frame(frame) if is_read else None
                except (cv2.error, ImageFormatError) as err:
                    fault = VideoError(
                        f"{self.path}: frame {count} cannot be decoded ({err}); convert the video, for example with "
                        "`ffmpeg -i FILE -c:v ffv1 OUT.avi`"
                    )
                    fault.__cause__ = err
                    waiting.put(fault)
                    return
                waiting.put(image)
                if image is None:
                    return
                count += 1
        finally:
            capture.release()

    def _time(self, k: int) -> int:
        if self._times is None:
            return round(k * _NS / self.rate_hz)
        if k >= len(self._times):
            raise VideoError(
                f"{self.path}: {len(self._times)} frame times for more frames; expected one for each"
            )
        return self._times[k]


def read_frame_times(path: Path) -> tuple[int, ...]:
    """Read the times of a video's frames from a text file.

    Parameters
    ----------
    path : Path -- a time [s] in the first column of every line; a first line of words and lines that begin with #
        are left out

    Returns
    -------
    tuple of int -- [ns]

    Raises
    ------
    VideoError -- the file cannot be read, holds no time, or something else than times
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as err:
        reason = getattr(err, "strerror", None) or "it is no text"
        raise VideoError(
            f"{path}: frame times cannot be read ({reason}); expected one time in seconds a line"
        ) from err
    times: list[int] = []
    for number, line in enumerate(lines, start=1):
        words = line.replace(",", " ").replace(";", " ").split()
        if not words or words[0].startswith("#"):
            continue
        try:
            # Decimal keeps the nanoseconds of times since 1970, which a float does not.
            seconds = Decimal(words[0])
        except InvalidOperation as err:
            if number > 1:
                raise VideoError(
                    f"{path}: line {number} is {line!r}; expected a time in seconds first"
                ) from err
            continue
        if not (seconds.is_finite() and abs(seconds) < _MAX_STAMP_S):
            raise VideoError(
                f"{path}: line {number} is {line!r}; expected a time in seconds that ends before the year 2260"
            )
        times.append(int((seconds * _NS).to_integral_value()))
    if not times:
        raise VideoError(f"{path}: holds no frame times; expected one time in seconds a line")
    return tuple(times)
