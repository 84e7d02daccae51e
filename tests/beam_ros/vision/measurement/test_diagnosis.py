"""What the tracker says of itself once a second."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from beam_ros.vision.calibration.linear import LinearCalibration

pytest.importorskip("cv2")
import cv2

from beam_ros.vision.measurement.diagnosis import Complaint, Diagnosis
from beam_ros.vision.measurement.lateness import LatenessWatch
from beam_ros.vision.measurement.measuring_chain import MeasuringChain
from beam_ros.vision.rendering.frames import SceneRenderer
from tests.beam_ros.vision.packaged_rig import packaged_camera, packaged_tracker

CAMERA = packaged_camera()
HEIGHTS = (0.010, 0.225, 0.285)
NAMES = ("low", "middle", "top")
PERIOD_NS = 10_000_000
MS = 1_000_000


class _Day:
    """A chain, its diagnosis, and frames at will."""

    def __init__(self, calibration: LinearCalibration | None = None, **stated) -> None:
        given = calibration or LinearCalibration.from_camera(CAMERA, 3)
        tracker = packaged_tracker(CAMERA, HEIGHTS)
        self.chain = MeasuringChain(replace(CAMERA, **stated), tracker, HEIGHTS, given)
        self.lateness = LatenessWatch(100.0)
        self.diagnosis = Diagnosis(NAMES, self.chain, self.lateness)
        self.frame = SceneRenderer(CAMERA, HEIGHTS).render(np.zeros(3), np.random.default_rng(0))

    def film(self, numbers, latency_ns=MS, frame=None) -> None:
        for k in numbers:
            self.diagnosis.frame_arrived()
            if self.chain.admit(k * PERIOD_NS):
                measured = self.chain.measure(k * PERIOD_NS, self.frame if frame is None else frame)
                self.diagnosis.frame_measured(measured, latency_ns() if callable(latency_ns) else latency_ns)


def test_a_good_second_is_ok_with_rate_latency_noise_and_deviation() -> None:
    day = _Day()
    latencies = iter([MS] * 98 + [9 * MS] * 2)
    day.film(range(1, 101), latency_ns=lambda: next(latencies))
    report = day.diagnosis.report(1.0)
    assert (report.level, report.sentence) == ("OK", "3 markers in sight")
    assert report.values["rate_hz"] == 100.0
    assert (report.values["latency_median_ms"], report.values["latency_p99_ms"]) == (1.0, 9.0)
    assert report.values["middle noise_grey"] == pytest.approx(2.0, rel=0.2)
    assert 0.003 < report.values["top sigma_px"] < 0.008  # the noise limit is 0.0045
    assert report.values["low lost"] == 0


def test_a_lost_marker_is_named_with_its_reason_and_counted() -> None:
    day = _Day()
    day.film(range(1, 11))
    hidden = day.frame.copy()
    hidden[100:200] = day.frame[300:400]  # the middle marker's rows
    day.film(range(11, 18), frame=hidden)
    report = day.diagnosis.report(0.17)
    assert report.level == "WARN"
    assert "middle (hidden)" in report.sentence
    assert "low" not in report.sentence
    assert report.values["middle lost"] == report.values["middle hidden"] == 7


def test_dropped_and_repeated_frames_are_counted_and_said() -> None:
    day = _Day()
    day.film([1, 2, 3, 3, 4, 7, 8])
    report = day.diagnosis.report(0.08)
    assert report.level == "WARN"
    assert "1 frames came twice" in report.sentence
    assert "2 of 8 frames are missing" in report.sentence
    assert (report.values["dropped frames"], report.values["repeated frames"]) == (2, 1)
    day.film(range(9, 20))
    assert day.diagnosis.report(0.1).level == "OK"  # what is over is counted, not complained of


@pytest.mark.slow
def test_frames_that_show_the_one_before_again_are_counted_and_said() -> None:
    day, rng = _Day(), np.random.default_rng(1)
    renderer = SceneRenderer(CAMERA, HEIGHTS)
    for k in range(1, 101):
        if k % 4:
            day.frame = renderer.render(np.full(3, 0.003 * np.sin(0.3 * k)), rng)
        day.film([k], frame=day.frame.copy())
    report = day.diagnosis.report(1.0)
    assert report.level == "WARN"
    assert "25 of 100 frames are the one before, bit for bit" in report.sentence
    assert "not in sight" not in report.sentence
    assert report.values["low repeated"] == 25


def interlaced(n_frames: int, swing_px: float, rng: np.random.Generator) -> list[np.ndarray]:
    """Frames of the packaged camera whose odd rows come half a frame later."""
    renderer, frames = SceneRenderer(CAMERA, HEIGHTS), []
    for k in range(n_frames):
        first, second = (
            renderer.render(swing_px / 1500 * np.sin(0.2 * at) * np.array([0.3, 0.8, 1.0]), rng)
            for at in (k, k + 0.5)
        )
        first[1::2] = second[1::2]
        frames.append(first)
    return frames


def test_interlaced_frames_are_said_with_the_remedy() -> None:
    day, rng = _Day(), np.random.default_rng(2)
    for k, frame in enumerate(interlaced(80, 8.0, rng), 1):
        day.film([k], frame=frame)
    report = day.diagnosis.report(0.8)
    assert report.level == "WARN"
    assert re.search(r"two instants, 0\.(4[5-9]|5\d?) of a frame apart \(interlaced\)", report.sentence)
    assert "set the camera to progressive" in report.sentence
    assert "camera.exposure" not in report.sentence


@pytest.mark.parametrize("rim_px", [0, 5, 6, 7])
def test_markers_that_are_rings_are_said_with_the_remedy(rim_px: int) -> None:
    day = _Day()
    frame = day.frame.copy()
    if rim_px:
        frame[cv2.erode(frame, np.ones((rim_px, rim_px))) > 100] = 20
    for k in range(1, 20):
        day.film([k], frame=frame)
    said = day.diagnosis.report(0.2).sentence
    assert ("(ring): expected full discs of one brightness: fill or cover" in said) == (rim_px > 0)


def test_a_temporal_noise_reduction_is_said_with_the_remedy() -> None:
    day, rng = _Day(), np.random.default_rng(2)
    renderer = SceneRenderer(CAMERA, HEIGHTS)
    shown = renderer.render([0.0, 0.0, 0.0], rng).astype(np.float64)
    for k in range(1, 40):
        shown = 0.6 * renderer.render([0.0, 0.0, 0.0], rng) + 0.4 * shown
        day.film([k], frame=np.rint(shown).astype(np.uint8))
    report = day.diagnosis.report(0.4)
    assert report.level == "WARN"
    late = re.search(r"up to (.*) frames late", report.sentence)
    assert late is not None
    assert 0.4 < float(late.group(1)) < 1.0
    assert "switch the camera's temporal noise reduction (3DNR) off" in report.sentence


@pytest.mark.slow
def test_a_raw_mosaic_that_is_called_grey_is_said_with_the_remedy() -> None:
    day, rng = _Day(), np.random.default_rng(2)
    renderer = SceneRenderer(CAMERA, HEIGHTS)
    for k in range(1, 20):
        frame = renderer.render([0.0, 0.0, 0.0], rng)
        frame[::2, 1::2] //= 2
        frame[1::2, ::2] //= 2
        day.film([k], frame=frame)
    report = day.diagnosis.report(0.2)
    assert report.level == "WARN"
    assert "raw mosaic of a colour sensor" in report.sentence
    assert "set the images' encoding to the one of the sensor (bayer_rggb8" in report.sentence


@pytest.mark.parametrize("every", [2, 4])
def test_a_camera_at_another_rate_is_named_and_misses_nothing(every) -> None:
    day = _Day()
    day.film(range(0, 40 * every, every))
    report = day.diagnosis.report(0.4 * every)
    assert report.level == "WARN"
    assert f"frames come at {100 / every:g} a second" in report.sentence
    assert "expected camera.rate, 100" in report.sentence
    assert "missing" not in report.sentence
    assert report.values["dropped frames"] == 0


def test_a_driver_that_stamps_all_frames_alike_is_an_error() -> None:
    day = _Day()
    day.film([0])
    day.diagnosis.report(1.0)
    day.film([0] * 50)
    report = day.diagnosis.report(1.0)
    assert report.level == "ERROR"
    assert "same time stamp" in report.sentence


def test_unusable_frames_are_an_error_with_their_reason() -> None:
    day = _Day()
    day.film(range(1, 10))
    day.diagnosis.frame_arrived()
    day.diagnosis.frame_unusable("image encoding 'yuv9' is not supported")
    report = day.diagnosis.report(0.1)
    assert (report.level, report.values["unusable frames"]) == ("ERROR", 1)
    assert "yuv9" in report.sentence


def test_stamps_that_are_not_of_this_clock_are_said() -> None:
    for latency_ns, words in ((2000 * MS, "2 s old"), (-50 * MS, "-0.05 s old")):
        day = _Day()
        day.film(range(1, 20), latency_ns=latency_ns)
        report = day.diagnosis.report(0.2)
        assert report.level == "WARN"
        assert words in report.sentence


def test_the_age_of_frames_is_that_of_the_last_period() -> None:
    day = _Day()
    day.film(range(1, 101), latency_ns=2000 * MS)
    assert "2 s old" in day.diagnosis.report(1.0).sentence
    day.film(range(101, 121), latency_ns=MS)
    report = day.diagnosis.report(1.0)
    assert (report.level, report.values["latency_median_ms"]) == (
        "OK",
        2000.0,
    )  # the value is of a thousand frames


def test_silence_is_said_once_and_by_whoever_knows_the_reason() -> None:
    day = _Day()
    assert (
        day.diagnosis.report(1.0, silence="no frames on camera/image_raw").sentence
        == "no frames on camera/image_raw"
    )
    report = day.diagnosis.report(1.0, [Complaint("ERROR", "camera /dev/video7 is not there")])
    assert (report.level, report.sentence) == ("ERROR", "camera /dev/video7 is not there")


def test_a_calibration_that_may_be_of_another_focus_is_a_warning_and_one_that_names_one_an_error() -> None:
    day = _Day(focus="f8")
    day.film(range(1, 10))
    report = day.diagnosis.report(0.1)
    assert report.level == "WARN"
    assert "does not say for which camera and focus" in report.sentence
    day = _Day(LinearCalibration.from_camera(replace(CAMERA, focus="f8"), 3))
    day.film(range(1, 10))
    report = day.diagnosis.report(0.1)
    assert report.level == "ERROR"
    assert "set camera.focus" in report.sentence


@pytest.mark.parametrize("stated_s", [0.002, 0.005])
def test_an_exposure_that_is_stated_too_short_is_a_warning_with_the_likely_one(stated_s) -> None:
    day, renderer, rng = _Day(exposure_s=stated_s), SceneRenderer(CAMERA, HEIGHTS), np.random.default_rng(3)
    shares = np.array([[0.1, 0.8, 1.0]])
    for k in range(1, 101):
        instants = k + CAMERA.exposure_s * CAMERA.rate_hz * np.linspace(-0.5, 0.5, renderer.sub_instants)
        x = 20.0 / CAMERA.pixels_per_metre * np.sin(0.3 * instants)[:, None] * shares
        day.film([k], frame=renderer.render(x, rng))
    report = day.diagnosis.report(1.0)
    if stated_s == CAMERA.exposure_s:
        assert "camera.exposure" not in report.sentence
    else:
        assert report.level == "WARN"
        assert "times as long as camera.exposure, 0.002 s, allows" in report.sentence
        likely = re.search("likely some (.*) s; set camera.exposure to it", report.sentence)
        # Second moments of what exceeds all other explanations show it to a fifth.
        assert likely is not None
        assert float(likely[1]) == pytest.approx(CAMERA.exposure_s, rel=0.2)


def test_a_calibration_of_another_camera_is_an_error_though_markers_are_seen() -> None:
    day = _Day(replace(LinearCalibration.from_camera(CAMERA, 3), image_size=(1280, 960)))
    day.film(range(1, 10))
    report = day.diagnosis.report(0.1)
    assert report.level == "ERROR"
    assert "1280 x 960" in report.sentence
