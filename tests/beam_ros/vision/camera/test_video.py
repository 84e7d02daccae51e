from __future__ import annotations

import cv2
import numpy as np
import pytest

from beam_ros.vision.calibration.linear import LinearCalibration
from beam_ros.vision.camera.video import VideoFile
from beam_ros.vision.errors import VideoError
from beam_ros.vision.measurement.measuring_chain import MeasuringChain
from beam_ros.vision.rendering.frames import SceneRenderer
from tests.beam_ros.vision.packaged_rig import packaged_camera, packaged_tracker

HEIGHTS = (0.010, 0.225, 0.285)
CAMERA = packaged_camera()


def write_video(path, n_frames=40, codec="FFV1", rate=100.0):
    """A lossless video of three markers; returns their true columns."""
    renderer = SceneRenderer(CAMERA, HEIGHTS)
    rng = np.random.default_rng(1)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*codec), rate, (640, 480), True)
    assert writer.isOpened()
    truth = []
    for k in range(n_frames):
        x = 0.01 * np.sin(0.2 * k + np.arange(3.0))
        frame = renderer.render(x, rng)
        writer.write(cv2.cvtColor(frame, cv2.COLOR_GRAY2BGR))
        truth.append(CAMERA.columns(x))
    writer.release()
    return np.array(truth)


@pytest.mark.slow
def test_a_video_is_tracked_to_its_truth(tmp_path):
    path = tmp_path / "beam.avi"
    truth = write_video(path)
    video = VideoFile(path)
    assert (video.width, video.height, video.rate_hz, video.n_frames) == (640, 480, 100.0, 40)
    chain = MeasuringChain(
        CAMERA,
        packaged_tracker(CAMERA, HEIGHTS),
        HEIGHTS,
        LinearCalibration.from_camera(CAMERA, 3),
    )
    measured = [chain.measure(time_ns, image) for time_ns, image in video.frames()]
    # 0.0055 px of image noise; the colour conversion of the codec adds rounding.
    assert np.sqrt(np.mean((np.array([frame.u_px for frame in measured]) - truth) ** 2)) < 0.008
    assert {reason for frame in measured for reason in frame.reasons} == {"ok"}
    assert [frame.stamp_ns for frame in measured] == [k * 10_000_000 for k in range(40)]


def test_a_rate_or_times_of_the_users_come_before_the_files(tmp_path):
    path = tmp_path / "beam.avi"
    write_video(path, 5, rate=25.0)
    assert [time for time, _ in VideoFile(path, rate_hz=500.0).frames()] == [
        0,
        2_000_000,
        4_000_000,
        6_000_000,
        8_000_000,
    ]
    times = [10, 20, 40, 50, 60]
    assert [time for time, _ in VideoFile(path, frame_times_ns=times).frames()] == times
    with pytest.raises(VideoError, match="4 frame times for more frames"):
        list(VideoFile(path, frame_times_ns=times[:4]).frames())


def test_what_is_no_video_is_refused(tmp_path):
    with pytest.raises(VideoError, match="this is a folder; give the video file"):
        VideoFile(tmp_path)
    with pytest.raises(VideoError, match="no such video file"):
        VideoFile(tmp_path / "absent.avi")
    text = tmp_path / "text.avi"
    text.write_text("no video", encoding="utf-8")
    with pytest.raises(VideoError, match="that OpenCV"):
        VideoFile(text)
    path = tmp_path / "beam.avi"
    write_video(path, 3)
    for bad in (0.0, -1.0, float("nan")):
        with pytest.raises(VideoError, match="expected one > 0"):
            VideoFile(path, rate_hz=bad)
    with pytest.raises(VideoError, match="do not rise"):
        VideoFile(path, frame_times_ns=[3, 2, 1])


class _Reader:
    """A capture whose frames come from a list; an exception in it is raised."""

    def __init__(self, frames) -> None:
        self._frames = iter(frames)

    def read(self):
        frame = next(self._frames, None)
        if isinstance(frame, Exception):
            raise frame
        return frame is not None, frame

    def get(self, _what) -> float:
        return 0.0

    def release(self) -> None: ...


@pytest.mark.parametrize("bad", [np.zeros((480, 640, 3)), cv2.error("decoder lost")])
def test_a_frame_that_cannot_be_decoded_is_named(tmp_path, monkeypatch, bad):
    path = tmp_path / "beam.avi"
    write_video(path, 3)
    video = VideoFile(path)
    good = np.zeros((480, 640, 3), np.uint8)
    monkeypatch.setattr(video._decoder, "_open", lambda **_: _Reader([good, good, bad, good]))
    seen = []
    with pytest.raises(VideoError, match=r"beam\.avi: frame 2 cannot be decoded.*convert the video"):
        seen.extend(time for time, _ in video.frames())
    assert seen == [0, 10_000_000]
