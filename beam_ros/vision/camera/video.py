"""Frames from a video file, with the times that the file or its user states.

Fast cameras and telephones leave a file afterwards. Its frame rate may be the one it was recorded with, one
for slow replay, or none at all; times that the user gives always come first. Where the container holds a time for
every frame, as Matroska and MP4 do, these are read: they tell a variable rate, and frames that are missing.

A damaged file is decoded as far as it goes: a frame that cannot be decoded is missing, those behind it keep their
times. What the decoder complains about, it writes to the standard error of the process; this is caught, and counted
for the frame that was being read.
"""

from __future__ import annotations

import contextlib
import math
import os
import sys
import tempfile
from collections.abc import Generator, Iterator, Sequence
from decimal import Decimal, InvalidOperation
from pathlib import Path
from queue import Empty, Queue
from threading import Event, Thread
from typing import Any

import cv2
import numpy as np

from beam_ros.arrays import ImageArray, StampArray
from beam_ros.vision.camera.display_matrix import display_matrix, upright
from beam_ros.vision.camera.images import grey_frame
from beam_ros.vision.errors import ImageFormatError, VideoError

_NS = 1_000_000_000
_DECODED_AHEAD = 8
"""Frames that a file's decoder may be ahead of who takes them."""
_MILLISECOND_NS = 1_000_000
_RESOLUTION_NS = 520_000
"""Containers that count milliseconds round by half of one; a time may be so far off a frame's [ns]."""
_EXACT_NS = 2_000
_MAX_STATED_HZ = 50_000.0
"""Where a file states a higher rate, it states its clock's."""
_FFV1, _MOTION_JPEG = b"ffv1", b"mjpg"
_PICTURE, _PICTURE_RAW, _IS_KEY = (int.from_bytes(word, "little") for word in (b"dc", b"db", b"\x10"))
_MAX_STAMP_S = 9_150_000_000
"""Stamps are 64-bit nanoseconds since 1970, which end in 2262 [s]."""


class VideoFile:
    """Frames of a video, in grey.

    Parameters
    ----------
    path : Path -- the file
    rate_hz : float or None -- frame rate; None believes the file
    frame_times_ns : sequence of int or None -- time of every frame [ns]; comes before any rate
    heeds_decoder : bool -- catch what the decoder complains about (from the standard error of this process), for
        ``damaged_frames``

    Attributes
    ----------
    width, height : int -- as the camera saw it, turned upright where the file says so [px]
    rate_hz : float -- frame rate; NaN where only times are given, or the file states none
    is_turned : bool -- the file says that its pictures lie on their side or are mirrored
    n_frames : int -- what the file claims; 0 where it does not say
    n_times : int or None -- how many frame times were given
    n_undecodable : int -- frames between others that could not be decoded, as far as the file was read
    """

    def __init__(
        self,
        path: Path,
        *,
        rate_hz: float | None = None,
        frame_times_ns: Sequence[int] | None = None,
        heeds_decoder: bool = False,
    ) -> None:
        self.path = Path(path)
        self._complaints = _Complaints() if heeds_decoder else None
        self._damaged: list[int] = []
        self.n_undecodable = 0
        self._keys: frozenset[int] | None = None
        capture = self._open()
        try:
            self.width = int(capture.get(cv2.CAP_PROP_FRAME_WIDTH))
            self.height = int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
            self.n_frames = max(0, int(capture.get(cv2.CAP_PROP_FRAME_COUNT)))
            stated = float(capture.get(cv2.CAP_PROP_FPS))
        finally:
            capture.release()
        self._matrix = display_matrix(self.path)
        self.is_turned = self._matrix is not None
        if self._matrix is not None and self._matrix[0][0] == 0:
            self.width, self.height = self.height, self.width
        self._times = None if frame_times_ns is None else [int(time) for time in frame_times_ns]
        self.n_times = None if self._times is None else len(self._times)
        self._stated_hz = stated if math.isfinite(stated) and 0 < stated <= _MAX_STATED_HZ else math.nan
        self._is_rate_given = rate_hz is not None
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
        self.rate_hz = self._stated_hz if rate_hz is None else rate

    def _open(self) -> Any:
        if self.path.is_dir():
            raise VideoError(
                f"{self.path}: this is a folder; give the video file, not the folder that it is in"
            )
        if not self.path.is_file():
            raise VideoError(f"{self.path}: no such video file; check the path")
        fault: cv2.error | None = None
        with self._heeded():
            try:
                capture = self._capture()
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

    def _capture(self) -> Any:
        """Open the file; where the decoder is heeded, it works on one frame at a time."""
        if self._complaints is not None and hasattr(cv2, "CAP_PROP_N_THREADS"):
            capture = cv2.VideoCapture(str(self.path), cv2.CAP_FFMPEG, [cv2.CAP_PROP_N_THREADS, 1])
            if capture.isOpened():
                return self._untouched(capture)
            capture.release()
        return self._untouched(cv2.VideoCapture(str(self.path)))

    @staticmethod
    def _untouched(capture: Any) -> Any:
        """Have the pictures as they are stored: OpenCV turns them, but takes a mirror for a turn."""
        capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
        return capture

    def _heeded(self) -> contextlib.AbstractContextManager[None]:
        return contextlib.nullcontext() if self._complaints is None else self._complaints.heard()

    def frames(self) -> Iterator[tuple[int, ImageArray]]:
        """Read the frames, one after the other; a thread decodes some ahead while the caller works.

        Where the decoder is heeded, the caller's own thread decodes: nothing else may write meanwhile.

        Yields
        ------
        time_ns : int -- since the first frame, as the container or the rate tells, or as given [ns]
        image : ndarray, shape (height, width), uint8 or uint16

        Raises
        ------
        VideoError -- fewer times than frames, no frame at all, or one that cannot be decoded
        """
        yield from _ahead(self._decoded()) if self._complaints is None else self._decoded()

    def _decoded(self) -> Generator[tuple[int, ImageArray], None, None]:
        """Decode the frames where they are asked for."""
        capture = self._open()
        count, first_ns, last_ns, is_broken, failed = 0, 0, -1, False, 0
        self._damaged, self.n_undecodable = [], 0
        torn = self._torn_pictures(capture) if self._complaints is not None else frozenset()
        try:
            while True:
                image = self._read(capture, count)
                if image is None:
                    # Behind a frame that cannot be decoded there may be others, as many as the file says.
                    failed += 1
                    is_broken = True
                    if self._complaints is not None:
                        self._complaints.have_grown()
                    if count + self.n_undecodable + failed >= self.n_frames:
                        break
                    continue
                self.n_undecodable, failed = self.n_undecodable + failed, 0
                shown_ns = round(float(capture.get(cv2.CAP_PROP_POS_MSEC)) * _MILLISECOND_NS)
                if self._complaints is not None:
                    # A picture that builds on a damaged one is damaged, too, up to the next that stands by itself.
                    number = self._number(count + self.n_undecodable, shown_ns)
                    is_broken = self._complaints.have_grown() or (
                        is_broken and not self._stands_alone(number, capture)
                    )
                    is_broken |= number in torn
                    self._damaged += [count] if is_broken else []
                if count == 0:
                    first_ns = shown_ns
                last_ns = self._time(count + self.n_undecodable, shown_ns - first_ns, last_ns)
                yield last_ns, image if self._matrix is None else upright(image, self._matrix)
                count += 1
        finally:
            capture.release()
        if count == 0:
            raise VideoError(f"{self.path}: not one frame can be read; the file may be cut short")

    def _number(self, k: int, shown_ns: int) -> int:
        """Number of a picture in the file, by the time that the container gives it; else k, as many as were read."""
        return round(shown_ns * self._stated_hz / _NS) if math.isfinite(self._stated_hz) else k

    def _read(self, capture: Any, count: int) -> ImageArray | None:
        """Read the next frame; None where there is none, or it cannot be decoded."""
        try:
            with self._heeded():
                is_read, frame = capture.read()
            return grey_frame(frame) if is_read else None
        except (cv2.error, ImageFormatError) as err:
            raise VideoError(
                f"{self.path}: frame {count} cannot be decoded ({err}); convert the video, for example with "
                "`ffmpeg -i FILE -c:v ffv1 OUT.avi`"
            ) from err

    def _torn_pictures(self, capture: Any) -> frozenset[int]:
        """Numbers of the pictures of a Motion-JPEG film that a second decoder complains about.

        A JPEG has no checksum, and FFmpeg passes over some of what the library for JPEG notices. What neither does, a
        flipped bit that leaves every code as long as it was, cannot be told from a picture.
        """
        if self._complaints is None or _codec(capture) != _MOTION_JPEG:
            return frozenset()
        packets = cv2.VideoCapture(str(self.path), cv2.CAP_FFMPEG, [cv2.CAP_PROP_FORMAT, -1])
        torn, number = [], 0
        try:
            while packets.isOpened():
                is_read, packet = packets.read()
                if not is_read:
                    break
                with self._heeded():
                    picture = cv2.imdecode(np.asarray(packet).ravel(), cv2.IMREAD_REDUCED_GRAYSCALE_8)
                if self._complaints.have_grown() or picture is None:
                    torn.append(number)
                number += 1
        finally:
            packets.release()
        return frozenset(torn)

    def _stands_alone(self, k: int, capture: Any) -> bool:
        """Whether frame k, read last, is known to need no other."""
        if _codec(capture) == _FFV1:
            # Its pictures are of one type, though they build on what was learned since the last key frame.
            if self._keys is None:
                self._keys = _key_frames(self.path)
            return k in self._keys
        kind = getattr(cv2, "CAP_PROP_FRAME_TYPE", None)
        return kind is not None and int(capture.get(kind)) == ord("I")

    def _time(self, k: int, shown_ns: int, last_ns: int) -> int:
        """Time of frame k, which the container shows at ``shown_ns`` after the first [ns]."""
        if self._times is not None:
            if k >= len(self._times):
                raise VideoError(
                    f"{self.path}: {len(self._times)} frame times for more frames; expected one for each"
                )
            return self._times[k]
        if self._is_rate_given and math.isfinite(self._stated_hz):
            # Frames that the container left out are missing at the right rate, too.
            k = max(k, round(shown_ns * self._stated_hz / _NS))
        elif not self._is_rate_given and shown_ns > last_ns:
            return shown_ns
        if not math.isfinite(self.rate_hz):
            raise VideoError(
                f"{self.path}: says nothing about the times of its frames; expected a frame rate or a time for each: "
                "give --rate or --times"
            )
        return max(round(k * _NS / self.rate_hz), last_ns + 1)

    def settled_times(self, times_ns: StampArray) -> tuple[StampArray, float | None, list[str]]:
        """Decide, when all frames were read, between a constant rate and a time for every frame.

        Parameters
        ----------
        times_ns : ndarray of int64, shape (n,) -- as ``frames`` yielded them [ns]

        Returns
        -------
        times_ns : ndarray of int64, shape (n,) -- multiples of the period where the rate is constant [ns]
        period_s : float or None -- time between frames, where it is constant, though some may be missing [s]
        notes : list of str -- what a reader should know
        """
        if self._times is not None:
            return times_ns, None, []
        steps = np.diff(times_ns)
        rate = self.rate_hz
        if not math.isfinite(rate):
            rate = _NS / float(np.median(steps)) if len(steps) else math.nan
            if not math.isfinite(rate):
                return times_ns, None, []
        numbers = np.rint(times_ns * (rate / _NS))
        grid = np.rint(numbers * (_NS / rate)).astype(np.int64)
        counts_milliseconds = bool(np.all(times_ns % _MILLISECOND_NS == 0))
        limit = _RESOLUTION_NS if counts_milliseconds else _EXACT_NS
        if np.all(np.diff(numbers) >= 1) and np.all(np.abs(times_ns - grid) <= limit):
            missing = int(numbers[-1] - numbers[0]) - len(steps)
            notes = [
                f"{missing} frames are missing between the first and the last, as the container's times say"
            ]
            return grid, 1.0 / rate, notes if missing else []
        return (
            times_ns,
            None,
            ["the container has a time for every frame, at a variable rate; these were used"],
        )

    def damaged_frames(self, n_frames: int) -> np.ndarray:
        """Tell which frames the decoder complained about, ndarray of bool, shape (n_frames,)."""
        damaged = np.zeros(n_frames, dtype=bool)
        damaged[[k for k in self._damaged if k < n_frames]] = True
        return damaged


def _ahead(frames: Generator[tuple[int, ImageArray], None, None]) -> Iterator[tuple[int, ImageArray]]:
    """Take frames from a thread that is some of them ahead."""
    waiting: Queue[tuple[int, ImageArray] | VideoError | None] = Queue(_DECODED_AHEAD)
    is_over = Event()

    def decode() -> None:
        try:
            for frame in frames:
                waiting.put(frame)
                if is_over.is_set():
                    break
            waiting.put(None)
        except VideoError as err:
            waiting.put(err)
        finally:
            frames.close()

    decoder = Thread(target=decode, name="decoder", daemon=True)
    decoder.start()
    try:
        while (found := waiting.get()) is not None:
            if isinstance(found, VideoError):
                raise found
            yield found
    finally:
        is_over.set()
        while decoder.is_alive():  # one that waits for room sees that nobody wants more
            with contextlib.suppress(Empty):
                waiting.get(timeout=0.01)


def _codec(capture: Any) -> bytes:
    """Four letters of the codec; OpenCV 5 writes some small that were large in OpenCV 4."""
    return (int(capture.get(cv2.CAP_PROP_FOURCC)) & 0xFFFFFFFF).to_bytes(4, "little").lower()


def _key_frames(path: Path) -> frozenset[int]:
    """Numbers of the frames that need no other, as the index of an AVI file says; none where there is no index."""
    data = path.read_bytes()
    at = data.rfind(b"idx1")
    if not data.startswith(b"RIFF") or at < 0:
        return frozenset()
    size = int.from_bytes(data[at + 4 : at + 8], "little")
    entries = np.frombuffer(data[at + 8 : at + 8 + size - size % 16], dtype="<u4").reshape(-1, 4)
    pictures = entries[(entries[:, 0] >> 16 == _PICTURE_RAW) | (entries[:, 0] >> 16 == _PICTURE)]
    return frozenset(np.flatnonzero(pictures[:, 1] & _IS_KEY).tolist())


class _Complaints:
    """What is written to the standard error of this process while a frame is read."""

    def __init__(self) -> None:
        self._file = tempfile.TemporaryFile()  # noqa: SIM115 -- it lives as long as its film
        self._size = 0

    @contextlib.contextmanager
    def heard(self) -> Iterator[None]:
        """Catch it, for the time of a call."""
        sys.stderr.flush()
        kept = os.dup(2)
        try:
            os.dup2(self._file.fileno(), 2)
            yield
        finally:
            os.dup2(kept, 2)
            os.close(kept)

    def have_grown(self) -> bool:
        """Whether something was caught since this was asked last."""
        before, self._size = self._size, os.fstat(self._file.fileno()).st_size
        return self._size > before


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
