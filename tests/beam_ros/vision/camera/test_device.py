from __future__ import annotations

import fcntl
import os
import struct
import time
from collections.abc import Iterator
from pathlib import Path
from threading import Event, Thread

import numpy as np
import pytest

from beam_ros.vision.camera.device import DeviceCamera, driver_stamp
from beam_ros.vision.errors import CaptureError, VisionParameterError
from tests.beam_ros.vision.camera.conftest import N_FRAMES
from tests.beam_ros.vision.packaged_rig import packaged_camera

SECOND = 1_000_000_000
SMALL = packaged_camera(width=64, height=48, rate_hz=50.0)


def device(path: Path) -> DeviceCamera:
    """A file in place of a device: OpenCV opens both alike."""
    return DeviceCamera(str(path), SMALL, "", sets_exposure=False)


def test_a_drivers_stamp_is_taken_from_whichever_clock_it_is_of() -> None:
    monotonic, real = 5000 * SECOND, 1_700_000_000 * SECOND
    assert driver_stamp((5000 - 0.02) * 1e3, monotonic, real) == (real - SECOND // 50, None)
    assert driver_stamp((1_700_000_000 - 0.02) * 1e3, monotonic, real) == (real - SECOND // 50, None)
    for nothing in (0.0, -1.0, float("nan"), 40.0, 5001e3):
        assert driver_stamp(nothing, monotonic, real) == (real, "arrival")


def test_a_device_that_stops_giving_frames_says_so(video: Path) -> None:
    camera = device(video)
    camera.open()
    for _ in range(N_FRAMES):
        camera.read()
    with pytest.raises(CaptureError, match="gives no more frames"):
        camera.read()
    camera.close()


def test_a_device_whose_frames_are_no_images_says_so(video: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    camera = device(video)
    camera.open()
    monkeypatch.setattr(camera, "_capture", _FloatingCapture())
    with pytest.raises(CaptureError, match=r"frame is float64 of shape \(4, 4, 3\).*device_format"):
        camera.read()


class _FloatingCapture:
    """A capture of frames that are no images."""

    def read(self):
        return True, np.zeros((4, 4, 3))

    def get(self, _number: int) -> float:
        return 0.0


def test_what_is_no_camera_is_refused_with_a_remedy(tmp_path: Path) -> None:
    text = tmp_path / "video9"
    text.write_text("no camera")
    with pytest.raises(CaptureError, match=r"cannot be opened.*tracker\.device"):
        device(text).open()


def test_a_pixel_format_is_four_characters() -> None:
    with pytest.raises(VisionParameterError, match=r"tracker\.device_format is 'grey scale': expected four"):
        DeviceCamera("/dev/video0", SMALL, "grey scale", sets_exposure=False)


VIDIOC_S_FMT = 0xC0D05605
"""Set the format of a device: struct v4l2_format, 208 bytes (linux/videodev2.h)."""
V4L2_BUF_TYPE_VIDEO_OUTPUT, V4L2_FIELD_NONE = 2, 1


@pytest.fixture
def loopback() -> Iterator[tuple[str, np.ndarray]]:
    """A virtual camera of the kernel, to which somebody writes 50 grey frames a second: brighter by one each."""
    found = [
        path
        for path in Path("/sys/devices/virtual/video4linux").glob("video*")
        if os.access(f"/dev/{path.name}", os.W_OK)
    ]
    if not found:
        pytest.skip("this kernel has no virtual camera: modprobe v4l2loopback, as root")
    path, size = f"/dev/{found[0].name}", SMALL.width * SMALL.height
    picture = np.arange(size, dtype=np.uint8).reshape(SMALL.height, SMALL.width) % 200
    output = os.open(path, os.O_RDWR)
    form = struct.pack("<II4s4I", SMALL.width, SMALL.height, b"GREY", V4L2_FIELD_NONE, SMALL.width, size, 0)
    fcntl.ioctl(
        output, VIDIOC_S_FMT, struct.pack("<I4x", V4L2_BUF_TYPE_VIDEO_OUTPUT) + form.ljust(200, b"\0")
    )
    is_over = Event()

    def write() -> None:
        number = 0
        while not is_over.wait(1.0 / SMALL.rate_hz):
            os.write(output, (picture + np.uint8(number % 50)).tobytes())
            number += 1

    writer = Thread(target=write, name="virtual camera")
    writer.start()
    try:
        yield path, picture
    finally:
        is_over.set()
        writer.join()
        os.close(output)


def test_a_virtual_camera_gives_its_pixels_and_recent_rising_stamps(loopback: tuple[str, np.ndarray]) -> None:
    path, picture = loopback
    camera = DeviceCamera(path, SMALL, "GREY", sets_exposure=False)
    camera.open()
    try:
        frames = [camera.read() for _ in range(20)]
    finally:
        camera.close()
    for frame in frames:
        brighter = frame.image.astype(int) - picture
        assert frame.image.shape == picture.shape
        assert brighter.min() == brighter.max()
    stamps = np.array([frame.stamp_ns for frame in frames])
    assert np.all(np.diff(stamps) > 0)
    assert 0 <= time.time_ns() - stamps[-1] < SECOND
