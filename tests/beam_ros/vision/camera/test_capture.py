"""Frames that the process takes itself: stamps, ends, and devices that vanish and come back.

A video file that OpenCV opens through the same call as a device stands for the camera: what it gives ends, and its
path can vanish.
"""

from __future__ import annotations

import threading
import time
from pathlib import Path
from queue import SimpleQueue

import cv2
import numpy as np
import pytest

from beam_ros.vision.camera.capture import CaptureLoop
from beam_ros.vision.camera.playback import VideoPlayback
from beam_ros.vision.camera.source import CameraSource, CapturedFrame
from tests.beam_ros.vision.camera.conftest import N_FRAMES
from tests.beam_ros.vision.camera.test_device import device

SECOND = 1_000_000_000


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


def test_a_missing_device_is_named_and_tried_again_until_it_is_closed(tmp_path: Path) -> None:
    run = _Run(device(tmp_path / "video7"))
    run.until(lambda: run.states and run.states[-1].phase == "failed")
    assert "video7 is not there" in run.states[-1].sentence
    assert "tracker.device" in run.states[-1].sentence
    run.loop.close()
    assert not run.loop._thread.is_alive()


def test_a_device_that_vanishes_is_reported_and_found_again(video: Path) -> None:
    hidden = video.with_name("unplugged.avi")
    run = _Run(device(video))
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


class _Bursts(CameraSource):
    """A camera that gives a burst of frames as soon as it is asked for one."""

    name = "bursts"

    def __init__(self) -> None:
        self.sizes: SimpleQueue[int] = SimpleQueue()
        self.is_over = threading.Event()
        self._left = self._count = 0

    def open(self) -> None: ...

    def read(self) -> CapturedFrame | None:
        if self._left == 0:
            self.is_over.set()
            self._left = self.sizes.get()
        if self._left == 0:
            return None
        self._left -= 1
        self._count += 1
        return CapturedFrame(self._count * SECOND, np.zeros((4, 4), np.uint8))

    def close(self) -> None: ...

    def burst(self, size: int) -> None:
        self.is_over.clear()
        self.sizes.put(size)
        assert self.is_over.wait(10.0)


def test_frames_that_nobody_took_in_time_are_counted_once_and_the_newest_sixteen_kept() -> None:
    camera = _Bursts()
    loop = CaptureLoop(camera, 0.02, lambda: None)
    loop.start()
    assert camera.is_over.wait(10.0)
    camera.burst(16)
    assert loop.take_overruns() == 0
    camera.burst(5)
    assert loop.take_overruns() == 5
    assert [frame.stamp_ns // SECOND for frame in loop.take()] == list(range(6, 22))
    assert loop.take_overruns() == 0
    camera.burst(18)
    assert loop.take_overruns() == 2
    camera.sizes.put(0)
    loop.close()


@pytest.mark.parametrize("fault", [cv2.error("(-215:Assertion failed) !ssize.empty()"), ValueError("odd")])
def test_a_failure_that_nobody_thought_of_is_reported_and_the_thread_goes_on(fault: Exception) -> None:
    run = _Run(_Flickering(fault), retry_s=0.05)
    run.until(lambda: len(run.frames) >= 8)
    run.loop.close()
    sentences = {state.sentence for state in run.states if state.phase == "failed"}
    assert len(sentences) == 1
    assert str(fault) in sentences.pop()


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
    assert run.loop.take_overruns() == 0
