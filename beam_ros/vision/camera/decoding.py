"""Pictures of a film file as OpenCV decodes them, and which of them the decoder complained about.

A thread decodes ahead while the caller works, on all processors. What a decoder complains about, it writes to the
standard error of the process. Where that is heeded, a film is decoded so up to the first complaint: what the decoder
says of a picture it has said before it gives the picture. From there on the film is decoded anew, one picture after
the other, so that each complaint is counted for the picture that was being read.
"""

from __future__ import annotations

import contextlib
import io
import math
import os
import sys
import tempfile
from collections.abc import Generator, Iterator
from itertools import islice
from pathlib import Path
from queue import Empty, Queue
from threading import Event, Thread
from typing import Any, NamedTuple, TypeVar

import cv2
import numpy as np

from beam_ros.arrays import ImageArray
from beam_ros.vision.camera.images import grey_frame
from beam_ros.vision.errors import ImageFormatError, VideoError

_NS, _MILLISECOND_NS = 1_000_000_000, 1_000_000
_DECODED_AHEAD = 8
"""Pictures that a decoder may be ahead of who takes them."""
_MAX_COMPLAINT = 300
"""Of a decoder's complaint so much is read [bytes]."""
_MAX_STATED_HZ = 50_000.0
"""Where a file states a higher rate, it states its clock's."""
_FFV1, _MOTION_JPEG, _GREY = b"ffv1", b"mjpg", b"y800"
_PREDICTED = "P", "B", "S"
"""Types of pictures that hold what changed since others."""
_PICTURE, _PICTURE_RAW, _IS_KEY = (int.from_bytes(word, "little") for word in (b"dc", b"db", b"\x10"))
_Item = TypeVar("_Item")


class Picture(NamedTuple):
    """A picture of a film.

    Attributes
    ----------
    shown_ns : int -- when the container shows it [ns]
    n_undecodable : int -- pictures before it that could not be decoded
    is_damaged : bool -- the decoder complained about it, or about one that it builds on
    image : ndarray, shape (height, width), uint8 or uint16 -- as it is stored, not turned upright
    """

    shown_ns: int
    n_undecodable: int
    is_damaged: bool
    image: ImageArray


class Decoder:
    """Decodes a film file.

    Parameters
    ----------
    path : Path -- the file
    is_heeded : bool -- catch what the decoder complains about (from the standard error of this process)

    Attributes
    ----------
    width, height : int -- of the pictures as they are stored [px]
    n_frames : int -- what the file claims; 0 where it does not say
    rate_hz : float -- what the file claims, its clock's rate, too [Hz]
    stated_hz : float -- the same where it can be the rate of frames, else NaN [Hz]

    Raises
    ------
    VideoError -- there is no such file, or OpenCV cannot read it
    """

    def __init__(self, path: Path, *, is_heeded: bool) -> None:
        self.path = path
        self._complaints = _Complaints() if is_heeded else None
        self._keys: frozenset[int] | None = None
        self._is_whole = True
        self._is_predicted = False
        capture = self._open()
        try:
            self.width = int(capture.get(cv2.CAP_PROP_FRAME_WIDTH))
            self.height = int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
            self.n_frames = max(0, int(capture.get(cv2.CAP_PROP_FRAME_COUNT)))
            self.rate_hz = float(capture.get(cv2.CAP_PROP_FPS))
            self._codec = _letters(capture, cv2.CAP_PROP_FOURCC)
        finally:
            capture.release()
        is_frames = math.isfinite(self.rate_hz) and 0 < self.rate_hz <= _MAX_STATED_HZ
        self.stated_hz = self.rate_hz if is_frames else math.nan

    def _open(self, *, is_one_by_one: bool = False) -> Any:
        if self.path.is_dir():
            raise VideoError(
                f"{self.path}: this is a folder; give the video file, not the folder that it is in"
            )
        if not self.path.is_file():
            raise VideoError(f"{self.path}: no such video file; check the path")
        fault: cv2.error | None = None
        with self._heeded():
            try:
                capture = self._capture(is_one_by_one)
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

    def _capture(self, is_one_by_one: bool) -> Any:
        """Open the file, for a decoder that works on one picture at a time, or on as many as there are processors."""
        if is_one_by_one and hasattr(cv2, "CAP_PROP_N_THREADS"):
            capture = cv2.VideoCapture(str(self.path), cv2.CAP_FFMPEG, [cv2.CAP_PROP_N_THREADS, 1])
            if capture.isOpened():
                return self._untouched(capture)
            capture.release()
        return self._untouched(cv2.VideoCapture(str(self.path)))

    @staticmethod
    def _untouched(capture: Any) -> Any:
        """Have the pictures as they are stored: OpenCV turns them, takes a mirror for a turn, and colours grey."""
        capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
        if _letters(capture, cv2.CAP_PROP_CODEC_PIXEL_FORMAT) == _GREY:
            capture.set(cv2.CAP_PROP_CONVERT_RGB, 0)
        return capture

    def _heeded(self) -> contextlib.AbstractContextManager[None]:
        return contextlib.nullcontext() if self._complaints is None else self._complaints.heard()

    @property
    def predicting_codec(self) -> str:
        """Letters of a codec that wrote what changes from picture to picture; "" where none of those read is such."""
        return self._codec.decode("ascii", "replace").upper() if self._is_predicted else ""

    @property
    def first_complaint(self) -> str:
        """What a heeded decoder complained about first, in its own words; "" where it did not."""
        return "" if self._complaints is None else self._complaints.first()

    def pictures(self) -> Generator[Picture, None, None]:
        """Decode the pictures, one after the other; a thread is some ahead while the caller works.

        Where the decoder is heeded, nothing but Python may write to the standard error until the last picture, or
        until the generator is closed.

        Raises
        ------
        VideoError -- a picture that cannot be decoded, and does not let the next be
        """
        if self._complaints is None:
            yield from _ahead(self._decoded())
            return
        n_whole = 0
        with self._complaints.heard_beside(), contextlib.closing(_ahead(self._undamaged())) as pictures:
            for picture in pictures:
                n_whole += 1
                yield picture
        if not self._is_whole:
            yield from islice(self._decoded(is_one_by_one=True), n_whole, None)

    def _undamaged(self) -> Generator[Picture, None, None]:
        """Decode the pictures up to the first that is damaged, or may be."""
        assert self._complaints is not None
        size, self._is_whole, looked_at = self._complaints.size(), False, -1
        with contextlib.closing(_ahead(self._looked_at())) as looks:
            for count, picture in enumerate(self._decoded()):
                number = max(self._number(count, picture.shown_ns), count)
                while looked_at < number and (look := next(looks, None)) is not None:
                    looked_at, is_torn = look
                    if is_torn:
                        return
                if picture.n_undecodable or self._complaints.size() > size:
                    return
                yield picture
        self._is_whole = self._complaints.size() == size

    def _decoded(self, *, is_one_by_one: bool = False) -> Generator[Picture, None, None]:
        """Decode the pictures where they are asked for; one by one, tell which are damaged."""
        heard = self._complaints if is_one_by_one else None
        if heard is not None:
            heard.have_grown()  # what was said before is about nothing that is read now
        capture = self._open(is_one_by_one=is_one_by_one)
        count, n_undecodable, is_broken, failed = 0, 0, False, 0
        torn = frozenset(number for number, is_torn in self._looked_at() if is_torn) if heard else frozenset()
        try:
            while True:
                image = self._read(capture, count, heard)
                if image is None:
                    # Behind a frame that cannot be decoded there may be others, as many as the file says.
                    failed += 1
                    is_broken = heard is not None
                    if heard is not None:
                        heard.have_grown()
                    if count + n_undecodable + failed >= self.n_frames:
                        break
                    continue
                n_undecodable, failed = n_undecodable + failed, 0
                shown_ns = round(float(capture.get(cv2.CAP_PROP_POS_MSEC)) * _MILLISECOND_NS)
                self._is_predicted = self._is_predicted or _type(capture) in _PREDICTED
                if heard is not None:
                    # A picture that builds on a damaged one is damaged, too, up to the next that stands by itself.
                    number = self._number(count + n_undecodable, shown_ns)
                    is_broken = heard.have_grown() or (is_broken and not self._stands_alone(number, capture))
                    is_broken |= number in torn
                yield Picture(shown_ns, n_undecodable, is_broken, image)
                count += 1
        finally:
            capture.release()

    def _number(self, k: int, shown_ns: int) -> int:
        """Number of a picture in the file, by the time that the container gives it; else k, as many as were read."""
        return round(shown_ns * self.stated_hz / _NS) if math.isfinite(self.stated_hz) else k

    def _read(self, capture: Any, count: int, heard: _Complaints | None) -> ImageArray | None:
        """Read the next frame; None where there is none, or it cannot be decoded."""
        try:
            with contextlib.nullcontext() if heard is None else heard.heard():
                is_read, frame = capture.read()
            return grey_frame(frame) if is_read else None
        except (cv2.error, ImageFormatError) as err:
            raise VideoError(
                f"{self.path}: frame {count} cannot be decoded ({err}); convert the video, for example with "
                "`ffmpeg -i FILE -c:v ffv1 OUT.avi`"
            ) from err

    def _looked_at(self) -> Generator[tuple[int, bool], None, None]:
        """Look at the pictures of a Motion-JPEG film with a second decoder.

        A JPEG has no checksum, and FFmpeg passes over some of what the library for JPEG notices. What neither does, a
        flipped bit that leaves every code as long as it was, cannot be told from a picture.

        Yields
        ------
        int, bool -- number of the picture, and whether this decoder complains about it
        """
        if self._complaints is None or self._codec != _MOTION_JPEG:
            return
        packets = cv2.VideoCapture(str(self.path), cv2.CAP_FFMPEG, [cv2.CAP_PROP_FORMAT, -1])
        number = 0
        try:
            while packets.isOpened():
                is_read, packet = packets.read()
                if not is_read:
                    break
                with self._complaints.heard():
                    picture = cv2.imdecode(np.asarray(packet).ravel(), cv2.IMREAD_REDUCED_GRAYSCALE_8)
                yield number, self._complaints.have_grown() or picture is None
                number += 1
        finally:
            packets.release()

    def _stands_alone(self, k: int, capture: Any) -> bool:
        """Whether frame k, read last, is known to need no other."""
        if self._codec == _FFV1:
            # Its pictures are of one type, though they build on what was learned since the last key frame.
            if self._keys is None:
                self._keys = _key_frames(self.path)
            return k in self._keys
        return _type(capture) == "I"


def _ahead(items: Generator[_Item, None, None]) -> Generator[_Item, None, None]:
    """Take items from a thread that is some of them ahead."""
    waiting: Queue[tuple[_Item] | Exception | None] = Queue(_DECODED_AHEAD)
    is_over = Event()

    def decode() -> None:
        end: Exception | None = None
        try:
            with contextlib.closing(items):
                for item in items:
                    waiting.put((item,))
                    if is_over.is_set():
                        break
        except Exception as err:  # noqa: BLE001 -- raised where the items are taken
            end = err
        waiting.put(end)

    decoder = Thread(target=decode, name="decoder", daemon=True)
    decoder.start()
    try:
        while (found := waiting.get()) is not None:
            if isinstance(found, Exception):
                raise found
            yield found[0]
    finally:
        is_over.set()
        while decoder.is_alive():  # one that waits for room sees that nobody wants more
            with contextlib.suppress(Empty):
                waiting.get(timeout=0.01)


def _letters(capture: Any, what: int) -> bytes:
    """Four letters of a codec or a pixel format; OpenCV 5 writes some small that were large in OpenCV 4."""
    return (int(capture.get(what)) & 0xFFFFFFFF).to_bytes(4, "little").lower()


def _type(capture: Any) -> str:
    """Letter of the type of the picture read last; "" where OpenCV does not say it."""
    kind = getattr(cv2, "CAP_PROP_FRAME_TYPE", None)
    return "" if kind is None else chr(max(int(capture.get(kind)), 0))


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
    """What is written to the standard error of this process while a film is read."""

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

    @contextlib.contextmanager
    def heard_beside(self) -> Iterator[None]:
        """Catch it while the process does other things, too; what Python writes goes where it went before."""
        with contextlib.ExitStack() as until_end:
            if _writes_to_descriptor(sys.stderr, 2):
                kept = os.fdopen(os.dup(2), "w", buffering=1, encoding="utf-8", errors="backslashreplace")
                until_end.enter_context(contextlib.redirect_stderr(until_end.enter_context(kept)))
            until_end.enter_context(self.heard())
            yield

    def first(self) -> str:
        """Return the first line that was caught, without the decoder's name for itself."""
        said = os.pread(self._file.fileno(), _MAX_COMPLAINT, 0).decode(errors="replace").strip()
        return said.splitlines()[0].rpartition("] ")[2].rstrip(". ") if said else ""

    def size(self) -> int:
        """How much was caught until now [bytes]."""
        return os.fstat(self._file.fileno()).st_size

    def have_grown(self) -> bool:
        """Whether something was caught since this was asked last."""
        before, self._size = self._size, self.size()
        return self._size > before


def _writes_to_descriptor(stream: Any, number: int) -> bool:
    try:
        return bool(stream.fileno() == number)
    except (AttributeError, ValueError, io.UnsupportedOperation):
        return False
