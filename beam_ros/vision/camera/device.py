"""A camera of this machine, opened by OpenCV (on Linux by V4L2), with its driver's time stamps."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from beam_ros.vision.camera.images import grey_frame
from beam_ros.vision.camera.source import CameraSource, CapturedFrame
from beam_ros.vision.errors import CaptureError, ImageFormatError, VisionParameterError
from beam_ros.vision.parameters import CameraParameters, StampMeaning

_OLDEST_FRAME_NS = 2_000_000_000
_RATE_TOLERANCE = 0.02


def driver_stamp(position_ms: float, monotonic_ns: int, realtime_ns: int) -> tuple[int, StampMeaning | None]:
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
    stamp_means : "arrival" or None -- "arrival" where the driver's number is not a recent time
    """
    if np.isfinite(position_ms) and position_ms > 0:
        stamp_ns = round(position_ms * 1e6)
        for now_ns in (monotonic_ns, realtime_ns):
            if 0 <= now_ns - stamp_ns <= _OLDEST_FRAME_NS:
                return stamp_ns - now_ns + realtime_ns, None
    return realtime_ns, "arrival"


class DeviceCamera(CameraSource):
    """A camera that OpenCV opens, on Linux by V4L2.

    Parameters
    ----------
    device : str -- "/dev/video0", the number of a camera, or any address that OpenCV opens
    camera : CameraParameters -- the size and rate that are asked of it
    pixel_format : str -- four characters such as GREY, YUYV or MJPG; "" leaves it to the driver
    sets_exposure : bool -- the camera's exposure is asked of it too; else it is left to the driver

    Raises
    ------
    VisionParameterError
        The pixel format is not four characters.
    """

    def __init__(
        self, device: str, camera: CameraParameters, pixel_format: str, *, sets_exposure: bool
    ) -> None:
        if pixel_format and not (pixel_format.isascii() and len(pixel_format) == 4):
            raise VisionParameterError(
                f"tracker.device_format is {pixel_format!r}: expected four characters such as GREY or MJPG, or "
                "nothing; `v4l2-ctl --list-formats` shows what the camera gives"
            )
        self.name = device
        self._camera = camera
        self._pixel_format = pixel_format
        self._sets_exposure = sets_exposure
        self._capture: Any = None

    def open(self) -> None:
        """Open the device and ask it for the settings; what it did not take is in ``remarks``.

        Raises
        ------
        CaptureError
            There is no such device, or it does not give frames, or another program has it.
        """
        device = self.name
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
                self.remarks = self._ask() if is_v4l2 else ()
                return
        except cv2.error as err:
            raise CaptureError(f"camera {device} cannot be opened: {err}; check tracker.device") from err
        self.close()
        raise CaptureError(
            f"camera {device} cannot be opened: expected a camera that no other program uses and that this user "
            "may read (group video); end the other program, or set tracker.device"
        )

    def _ask(self) -> tuple[str, ...]:
        camera, capture = self._camera, self._capture
        if self._pixel_format:
            capture.set(cv2.CAP_PROP_FOURCC, _fourcc(self._pixel_format))
            # Grey levels come as they are; everything else is decoded.
            capture.set(cv2.CAP_PROP_CONVERT_RGB, 0 if self._pixel_format in ("GREY", "Y16 ") else 1)
        wanted: list[tuple[str, int, float]] = [
            ("columns", cv2.CAP_PROP_FRAME_WIDTH, camera.width),
            ("rows", cv2.CAP_PROP_FRAME_HEIGHT, camera.height),
            ("frames a second", cv2.CAP_PROP_FPS, camera.rate_hz),
        ]
        for _, number, value in wanted:
            capture.set(number, value)
        # Old frames that wait in the driver would only be late.
        capture.set(cv2.CAP_PROP_BUFFERSIZE, 4)
        if self._sets_exposure:
            capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, 1)  # V4L2_EXPOSURE_MANUAL
            wanted.append(("units of 0.1 ms exposure", cv2.CAP_PROP_EXPOSURE, camera.exposure_s * 1e4))
            capture.set(cv2.CAP_PROP_EXPOSURE, camera.exposure_s * 1e4)
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
                f"camera {self.name} gives no more frames: expected {self._camera.rate_hz:g} a second; check its "
                "cable"
            )
        stamp_ns, stamp_means = driver_stamp(position_ms, monotonic_ns, realtime_ns)
        try:
            return CapturedFrame(stamp_ns, grey_frame(frame), stamp_means)
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
