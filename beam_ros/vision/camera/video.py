"""Frames from a video file, with the times that the file or its user states.

Fast cameras and telephones leave a file afterwards. Its frame rate may be the one it was recorded with, one
for slow replay, or none at all; times that the user gives always come first. Where the container holds a time for
every frame, as Matroska and MP4 do, these are read: they tell a variable rate, and frames that are missing.

A damaged file is decoded as far as it goes (``vision.camera.decoding``): a frame that cannot be decoded is missing,
those behind it keep their times.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Generator, Sequence
from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np

from beam_ros.arrays import ImageArray, StampArray
from beam_ros.vision.camera.decoding import Decoder
from beam_ros.vision.camera.display_matrix import display_matrix, upright
from beam_ros.vision.errors import VideoError

_NS = 1_000_000_000
_MILLISECOND_NS = 1_000_000
_RESOLUTION_NS = 520_000
"""Containers that count milliseconds round by half of one; a time may be so far off a frame's [ns]."""
_EXACT_NS = 2_000
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
        self._decoder = Decoder(self.path, is_heeded=heeds_decoder)
        self.width, self.height, self.n_frames = (
            self._decoder.width,
            self._decoder.height,
            self._decoder.n_frames,
        )
        self._damaged: list[int] = []
        self.n_undecodable = 0
        self._matrix = display_matrix(self.path)
        self.is_turned = self._matrix is not None
        if self._matrix is not None and self._matrix[0][0] == 0:
            self.width, self.height = self.height, self.width
        self._times = None if frame_times_ns is None else [int(time) for time in frame_times_ns]
        self.n_times = None if self._times is None else len(self._times)
        self._stated_hz = self._decoder.stated_hz
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
        rate = self._decoder.rate_hz if rate_hz is None else float(rate_hz)
        if not (math.isfinite(rate) and 0 < rate <= 1e6):
            whose = "the file states" if rate_hz is None else "given is"
            raise VideoError(
                f"{self.path}: {whose} a frame rate of {rate!r} Hz; expected one > 0: give the frame rate"
            )
        self.rate_hz = self._stated_hz if rate_hz is None else rate

    def frames(self) -> Generator[tuple[int, ImageArray], None, None]:
        """Read the frames, one after the other; a thread decodes some ahead while the caller works.

        Where the decoder is heeded, nothing but Python may write to the standard error until the last frame, or until
        the generator is closed.

        Yields
        ------
        time_ns : int -- since the first frame, as the container or the rate tells, or as given [ns]
        image : ndarray, shape (height, width), uint8 or uint16

        Raises
        ------
        VideoError -- fewer times than frames, no frame at all, or one that cannot be decoded
        """
        count, first_ns, last_ns = 0, 0, -1
        self._damaged, self.n_undecodable = [], 0
        with contextlib.closing(self._decoder.pictures()) as pictures:
            for count, picture in enumerate(pictures, start=1):
                if count == 1:
                    first_ns = picture.shown_ns
                if picture.is_damaged:
                    self._damaged.append(count - 1)
                self.n_undecodable = picture.n_undecodable
                number = count - 1 + picture.n_undecodable
                last_ns = self._time(number, picture.shown_ns - first_ns, last_ns)
                yield last_ns, picture.image if self._matrix is None else upright(picture.image, self._matrix)
        if count == 0:
            raise VideoError(f"{self.path}: not one frame can be read; the file may be cut short")

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

    @property
    def predicting_codec(self) -> str:
        """Letters of a codec that wrote what changes from picture to picture; "" where none of those read is such."""
        return self._decoder.predicting_codec

    @property
    def first_complaint(self) -> str:
        """What the decoder, where it is heeded, complained about first; "" where it did not."""
        return self._decoder.first_complaint

    def damaged_frames(self, n_frames: int) -> np.ndarray:
        """Tell which frames the decoder complained about, ndarray of bool, shape (n_frames,)."""
        damaged = np.zeros(n_frames, dtype=bool)
        damaged[[k for k in self._damaged if k < n_frames]] = True
        return damaged


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
