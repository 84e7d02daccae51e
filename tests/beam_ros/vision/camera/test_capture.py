"""Frames that the process takes itself: stamps, ends, and devices that vanish and come back.

A video file that OpenCV opens through the same call as a device stands for the camera: what it gives ends, and its
path can vanish.
"""

from __future__ import annotations

import threading
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from beam_ros.vision.camera.capture import CaptureLoop
from beam_ros.vision.camera.device import DeviceCamera, DeviceSettings, driver_stamp
from beam_ros.vision.camera.playback import VideoPlayback
from beam_ros.vision.camera.source import CameraSource, CapturedFrame
from beam_ros.vision.errors import CaptureError, VideoError

SECOND = 1_000_000_000
N_FRAMES = 12


@pytest.fixture
def video(tmp_path: Path) -> Path:
    path = tmp_path / "film.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 50.0, (64, 48))
    for k in range(N_FRAMES):
        writer.write(np.full((48, 64, 3), 10 * k, np.uint8))
    writer.release()
    return path


class _Run:
    """A loop, and what it has given so far."""

    def __init__(self, camera, retry_s: float = 0.02) -> None:
        self.changed = threading.Event()
        self.frames = []
        self.states = []
        self.loop = CaptureLoop(camera, retry_s, self.changed.set)
        self.loop.start()

    def until(self, condition) -> None:
        end = time.monotonic() + 10.0
        while not condition():
            assert time.monotonic() < end, (self.states, len(self.frames))
            self.changed.wait(0.01)
            self.changed.clear()
            self.frames.extend(self.loop.take())
            if not self.states or self.states[-1] != self.loop.state:
                self.states.append(self.loop.state)


def _device(path: Path) -> DeviceCamera:
    return DeviceCamera(DeviceSettings(str(path), 64, 48, 50.0, "", None))


def test_a_drivers_stamp_is_taken_from_whichever_clock_it_is_of() -> None:
    monotonic, real = 5000 * SECOND, 1_700_000_000 * SECOND
    assert driver_stamp((5000 - 0.02) * 1e3, monotonic, real) == (real - SECOND // 50, None)
    assert driver_stamp((1_700_000_000 - 0.02) * 1e3, monotonic, real) == (real - SECOND // 50, None)
    for nothing in (0.0, -1.0, float("nan"), 40.0, 5001e3):
        assert driver_stamp(nothing, monotonic, real) == (real, "arrival")


def test_a_missing_device_is_named_and_tried_again_until_it_is_closed(tmp_path: Path) -> None:
    run = _Run(_device(tmp_path / "video7"))
    run.until(lambda: run.states and run.states[-1].phase == "failed")
    assert "video7 is not there" in run.states[-1].sentence
    assert "tracker.device" in run.states[-1].sentence
    run.loop.close()
    assert not run.loop._thread.is_alive()


def test_a_device_that_vanishes_is_reported_and_found_again(video: Path) -> None:
    hidden = video.with_name("unplugged.avi")
    run = _Run(_device(video))
    run.until(lambda: len(run.frames) >= N_FRAMES)
    video.rename(hidden)
    run.until(lambda: "is not there" in run.states[-1].sentence)
    count = len(run.frames)
    hidden.rename(video)
    run.until(lambda: len(run.frames) > count)
    run.loop.close()
    assert run.frames[0].image.shape == (48, 64)
    assert run.frames[0].stamp_means == "arrival"
    stamps = [frame.stamp_ns for frame in run.frames]
    assert stamps == sorted(stamps)


def test_a_device_that_stops_giving_frames_says_so(video: Path) -> None:
    camera = _device(video)
    camera.open()
    for _ in range(N_FRAMES):
        camera.read()
    with pytest.raises(CaptureError, match="gives no more frames"):
        camera.read()
    camera.close()


class _Flickering(CameraSource):
    """A camera that fails, in its own way, at every third frame."""

    name = "flickering"

    def __init__(self, fault: Exception) -> None:
        self._fault = fault
        self._count = 0

    def open(self) -> None: ...

    def read(self) -> CapturedFrame:
        self._count += 1
        if self._count % 3 == 0:
            raise self._fault
        return CapturedFrame(self._count * SECOND, np.zeros((4, 4), np.uint8))

    def close(self) -> None: ...


@pytest.mark.parametrize("fault", [cv2.error("(-215:Assertion failed) !ssize.empty()"), ValueError("odd")])
def test_a_failure_that_nobody_thought_of_is_reported_and_the_thread_goes_on(fault: Exception) -> None:
    run = _Run(_Flickering(fault), retry_s=0.05)
    run.until(lambda: len(run.frames) >= 8)
    run.loop.close()
    sentences = {state.sentence for state in run.states if state.phase == "failed"}
    assert len(sentences) == 1
    assert str(fault) in sentences.pop()


def test_a_device_whose_frames_are_no_images_says_so(video: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    camera = _device(video)
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
        _device(text).open()


def test_a_file_is_played_at_its_rate_to_its_end(video: Path) -> None:
    begun = time.time_ns()
    run = _Run(VideoPlayback(video, None))
    run.until(lambda: run.loop.state.phase == "ended")
    run.frames.extend(run.loop.take())
    assert f"has ended after {N_FRAMES} frames" in run.loop.state.sentence
    stamps = np.array([frame.stamp_ns for frame in run.frames])
    assert np.all(np.diff(stamps) == SECOND // 50)
    assert time.time_ns() - begun >= (N_FRAMES - 1) * SECOND // 50
    assert [round(float(frame.image.mean()), -1) for frame in run.frames] == [
        10.0 * k for k in range(N_FRAMES)
    ]


def test_a_file_waits_for_whoever_takes_its_frames(video: Path) -> None:
    run = _Run(VideoPlayback(video, 5000.0))
    time.sleep(0.1)
    run.until(lambda: run.loop.state.phase == "ended" and len(run.frames) == N_FRAMES)
    assert run.loop.overruns == 0


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(VideoError, match="no such video file"):
        VideoPlayback(tmp_path / "nowhere.avi", None)


def test_a_file_that_has_gone_is_named(video: Path) -> None:
    camera = VideoPlayback(video, None)
    video.unlink()
    camera.open()
    with pytest.raises(CaptureError, match=r"no such video file.*tracker\.video"):
        camera.read()
