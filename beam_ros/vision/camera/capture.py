"""Frames that this process takes itself: from a camera through OpenCV, or from a video file at its own pace.

A camera blocks while it waits for a frame, so that it is read in a thread. ``CaptureLoop`` is that thread: it opens
what it is given, hands every frame on, and when the device fails or vanishes it closes it and tries again, here and
nowhere else. What it reads from is a ``Camera``; a device and a video file are two of them.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np

from beam_ros.arrays import ImageArray
from beam_ros.vision.camera.images import grey_frame
from beam_ros.vision.camera.video import VideoFile
from beam_ros.vision.errors import CaptureError, ImageFormatError

_NS = 1_000_000_000
_WAITING_FRAMES = 16
_OLDEST_FRAME_NS = 2 * _NS
_RATE_TOLERANCE = 0.02


@dataclass(frozen=True)
class CapturedFrame:
    """A frame with the time that its source gives it.

    Attributes
    ----------
    stamp_ns : int -- [ns, UNIX]
    clock : str -- whose time it is: "driver", "arrival" or "file"
    image : ndarray, shape (height, width), uint8 or uint16
    """

    stamp_ns: int
    clock: str
    image: ImageArray


class Camera(Protocol):
    """What frames are read from; opened, read and closed by one thread."""

    name: str
    is_paced: bool
    """True where frames are there before their time: they are then held back until their stamp."""

    def open(self) -> tuple[str, ...]:
        """Begin; returns remarks on what the source could not do. Raises CaptureError."""

    def read(self) -> CapturedFrame | None:
        """Wait for the next frame; None when there will be no more. Raises CaptureError."""

    def close(self) -> None:
        """Release the source; may be called at any time."""


@dataclass(frozen=True)
class DeviceSettings:
    """What is asked of a camera.

    Attributes
    ----------
    device : str -- "/dev/video0", the number of a camera, or any address that OpenCV opens
    width, height : int -- [px]
    rate_hz : float -- frames a second
    pixel_format : str -- four characters such as GREY, YUYV or MJPG; "" leaves it to the driver
    exposure_s : float or None -- manual exposure [s]; None leaves it to the driver
    """

    device: str
    width: int
    height: int
    rate_hz: float
    pixel_format: str = ""
    exposure_s: float | None = None


def driver_stamp(position_ms: float, monotonic_ns: int, realtime_ns: int) -> tuple[int, str]:
    """Stamp of a frame that has just been read.

    V4L2 drivers stamp frames by the monotonic clock, some by the real-time clock, others not at all; which one a
    number comes from shows in its being recent.

    Parameters
    ----------
    position_ms : float -- what OpenCV calls the position of the frame (CAP_PROP_POS_MSEC) [ms]
    monotonic_ns, realtime_ns : int -- both clocks now [ns]

    Returns
    -------
    stamp_ns : int -- [ns, UNIX]
    clock : str -- "driver", or "arrival" where the driver's number is no recent time
    """
    if np.isfinite(position_ms) and position_ms > 0:
        stamp_ns = round(position_ms * 1e6)
        for now_ns in (monotonic_ns, realtime_ns):
            if 0 <= now_ns - stamp_ns <= _OLDEST_FRAME_NS:
                return stamp_ns - now_ns + realtime_ns, "driver"
    return realtime_ns, "arrival"


class DeviceCamera:
    """A camera that OpenCV opens, on Linux by V4L2.

    Parameters
    ----------
    settings : DeviceSettings
    """

    is_paced = False

    def __init__(self, settings: DeviceSettings) -> None:
        self.name = settings.device
        self._settings = settings
        self._capture: Any = None

    def open(self) -> tuple[str, ...]:
        """Open the device and ask it for the settings.

        Returns
        -------
        tuple of str -- settings that the device did not take

        Raises
        ------
        CaptureError
            There is no such device, or it is none that gives frames, or another program has it.
        """
        device = self._settings.device
        is_file_like = device.startswith("/")
        if is_file_like and not Path(device).exists():
            present = ", ".join(sorted(str(path) for path in Path("/dev").glob("video*"))) or "none"
            raise CaptureError(
                f"camera {device} is not there: expected a video device (present: {present}); connect the camera, or "
                "set tracker.device"
            )
        is_v4l2 = device.startswith("/dev/") or device.isdigit()
        source: str | int = int(device) if device.isdigit() else device
        try:
            self._capture = cv2.VideoCapture(source, cv2.CAP_V4L2 if is_v4l2 else cv2.CAP_ANY)
            if self._capture.isOpened():
                return self._ask() if is_v4l2 else ()
        except cv2.error as err:
            raise CaptureError(f"camera {device} cannot be opened: {err}; check tracker.device") from err
        self.close()
        raise CaptureError(
            f"camera {device} cannot be opened: expected a camera that no other program uses and that this user "
            "may read (group video); end the other program, or set tracker.device"
        )

    def _ask(self) -> tuple[str, ...]:
        settings, capture = self._settings, self._capture
        if settings.pixel_format:
            capture.set(cv2.CAP_PROP_FOURCC, _fourcc(settings.pixel_format))
            # Grey levels come as they are; everything else is decoded.
            capture.set(cv2.CAP_PROP_CONVERT_RGB, 0 if settings.pixel_format in ("GREY", "Y16 ") else 1)
        wanted: list[tuple[str, int, float]] = [
            ("columns", cv2.CAP_PROP_FRAME_WIDTH, settings.width),
            ("rows", cv2.CAP_PROP_FRAME_HEIGHT, settings.height),
            ("frames a second", cv2.CAP_PROP_FPS, settings.rate_hz),
        ]
        for _, number, value in wanted:
            capture.set(number, value)
        # Old frames that wait in the driver would only be late.
        capture.set(cv2.CAP_PROP_BUFFERSIZE, 4)
        if settings.exposure_s is not None:
            capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, 1)  # V4L2_EXPOSURE_MANUAL
            wanted.append(("units of 0.1 ms exposure", cv2.CAP_PROP_EXPOSURE, settings.exposure_s * 1e4))
            capture.set(cv2.CAP_PROP_EXPOSURE, settings.exposure_s * 1e4)
        remarks = []
        for what, number, value in wanted:
            given = float(capture.get(number))
            if abs(given - value) > _RATE_TOLERANCE * value:
                remarks.append(f"camera {self.name} gives {given:g} {what} where {value:g} were asked for")
        return tuple(remarks)

    def read(self) -> CapturedFrame:
        """Wait for the next frame.

        Raises
        ------
        CaptureError
            The device gives no more frames: unplugged, or its driver has failed; or frames that are no images.
        """
        try:
            is_read, frame = self._capture.read()
            monotonic_ns, realtime_ns = time.monotonic_ns(), time.time_ns()
            position_ms = self._capture.get(cv2.CAP_PROP_POS_MSEC)
        except cv2.error as err:
            raise CaptureError(
                f"camera {self.name} failed: {err}; check its cable and tracker.device_format"
            ) from err
        if not is_read or frame is None:
            raise CaptureError(
                f"camera {self.name} gives no more frames: expected {self._settings.rate_hz:g} a second; check its "
                "cable"
            )
        stamp_ns, clock = driver_stamp(position_ms, monotonic_ns, realtime_ns)
        try:
            return CapturedFrame(stamp_ns, clock, grey_frame(frame))
        except ImageFormatError as err:
            raise CaptureError(f"camera {self.name}: {err}") from err

    def close(self) -> None:
        """Release the device."""
        if self._capture is not None:
            self._capture.release()
            self._capture = None


def _fourcc(pixel_format: str) -> int:
    """Number by which drivers know a pixel format: its four characters as a little-endian integer."""
    return int.from_bytes(pixel_format.encode("ascii"), "little")


class FileCamera:
    """A video file, played at its own rate from now on.

    Parameters
    ----------
    path : Path
    rate_hz : float or None -- frames a second; None believes the file
    now_ns : callable -- the clock by which the first frame is stamped [ns, UNIX]
    """

    is_paced = True

    def __init__(self, path: Path, rate_hz: float | None, now_ns: Callable[[], int] = time.time_ns) -> None:
        self.name = str(path)
        self._path = path
        self._rate_hz = rate_hz
        self._now_ns = now_ns
        self._start_ns = 0
        self._frames: Iterator[tuple[int, ImageArray]] = iter(())

    def open(self) -> tuple[str, ...]:
        """Open the file; its first frame is now.

        Raises
        ------
        CaptureError
            There is no such file, or it is no video.
        """
        try:
            self._frames = VideoFile(self._path, rate_hz=self._rate_hz).frames()
        except OSError as err:
            raise CaptureError(f"{err}; set tracker.video") from err
        self._start_ns = self._now_ns()
        return ()

    def read(self) -> CapturedFrame | None:
        """Next frame, or None at the end of the file."""
        try:
            time_ns, image = next(self._frames)
        except StopIteration:
            return None
        except OSError as err:
            raise CaptureError(str(err)) from err
        return CapturedFrame(self._start_ns + time_ns, "file", image)

    def close(self) -> None:
        """Let the file go."""
        self._frames = iter(())


@dataclass(frozen=True)
class CaptureState:
    """How the capture is doing.

    Attributes
    ----------
    phase : str -- opening, running, failed or ended
    sentence : str -- why it failed, or what ended
    remarks : tuple of str -- what the source could not do
    """

    phase: str
    sentence: str = ""
    remarks: tuple[str, ...] = ()


class CaptureLoop:
    """Reads a camera in a thread of its own, and opens it again when it fails.

    Parameters
    ----------
    camera : Camera
    retry_s : float -- between a failure and the next attempt [s]
    notify : callable -- called in the thread when frames wait to be taken, and when the state changes

    Attributes
    ----------
    state : CaptureState -- the newest one
    overruns : int -- frames that nobody took in time
    clock : str -- whose stamps the frames carry, "" before the first
    """

    def __init__(self, camera: Camera, retry_s: float, notify: Callable[[], None]) -> None:
        self.state = CaptureState("opening")
        self.overruns = 0
        self.clock = ""
        self._camera = camera
        self._retry_s = retry_s
        self._notify = notify
        self._waiting: deque[CapturedFrame] = deque(maxlen=_WAITING_FRAMES)
        self._stop = threading.Event()
        # A device that hangs must not keep the process from ending.
        self._thread = threading.Thread(target=self._run, name=f"capture {camera.name}", daemon=True)

    def start(self) -> None:
        """Begin to read."""
        self._thread.start()

    def close(self, patience_s: float = 1.0) -> None:
        """Stop reading; a device that hangs is left to the end of the process."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(patience_s)

    def take(self) -> Iterator[CapturedFrame]:
        """Yield the frames that wait, oldest first."""
        while True:
            try:
                frame = self._waiting.popleft()
            except IndexError:
                return
            yield frame

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                self._film()
            except CaptureError as err:
                self._enter(CaptureState("failed", str(err)))
                self._stop.wait(self._retry_s)
            except Exception as err:  # noqa: BLE001 - a thread that ends on what a backend comes up with says nothing
                self._enter(
                    CaptureState(
                        "failed",
                        f"camera {self._camera.name} failed ({type(err).__name__}: {err}): expected frames; it is "
                        f"opened again every {self._retry_s:g} s, see whether another program can read it",
                    )
                )
                self._stop.wait(self._retry_s)
            else:
                return
            finally:
                with contextlib.suppress(cv2.error):
                    self._camera.close()

    def _film(self) -> None:
        """Open the camera and read it until it ends or fails."""
        remarks = self._camera.open()
        self._enter(CaptureState("running", "", remarks))
        count = 0
        while not self._stop.is_set():
            frame = self._camera.read()
            if frame is None:
                self._enter(CaptureState("ended", f"{self._camera.name} has ended after {count} frames"))
                return
            if self._camera.is_paced:
                self._stop.wait(max(0, frame.stamp_ns - time.time_ns()) * 1e-9)
                while len(self._waiting) == _WAITING_FRAMES and not self._stop.is_set():
                    self._stop.wait(0.002)  # a file can wait, where a camera cannot
            count += 1
            self.clock = frame.clock
            self.overruns += len(self._waiting) == _WAITING_FRAMES
            self._waiting.append(frame)
            self._notify()

    def _enter(self, state: CaptureState) -> None:
        if state != self.state:
            self.state = state
            self._notify()
