"""The camera's frame as the page gets it."""

from __future__ import annotations

import json
import struct

import cv2
import numpy as np
import pytest

from beam_ros import messages
from beam_ros.messages import MARKER_DTYPE, BagTypes, MarkerCloud
from beam_ros.view.pictures import Pictures
from beam_ros.vision.errors import ImageFormatError

TYPES = BagTypes()


def frame(stamp_ns: int, height: int = 60, width: int = 40) -> bytes:
    pixels = np.tile(np.linspace(0, 200, width, dtype=np.uint8), (height, 1))
    return TYPES.serialize(messages.image(TYPES, stamp_ns, pixels), "sensor_msgs/msg/Image")


def unpacked(data: bytes) -> tuple[dict, np.ndarray]:
    (length,) = struct.unpack_from(">I", data)
    pixels = cv2.imdecode(np.frombuffer(data[4 + length :], np.uint8), cv2.IMREAD_GRAYSCALE)
    return json.loads(data[4 : 4 + length]), pixels


def cloud(stamp_ns: int) -> bytes:
    rows = np.zeros(2, dtype=MARKER_DTYPE)
    rows["u"], rows["v"], rows["id"], rows["valid"] = [3.25, 0.0], [7.5, 0.0], [0, 1], [1, 0]
    message = messages.marker_cloud(TYPES, MarkerCloud(stamp_ns, rows))
    return TYPES.serialize(message, "sensor_msgs/msg/PointCloud2")


def test_a_frame_comes_with_the_markers_that_were_found_in_it_and_no_others():
    pictures = Pictures()
    assert pictures.packed() == b""
    pictures.take_frame(frame(100), 0.0, is_compressed=False)
    pictures.take_markers(cloud(99))
    about, pixels = unpacked(pictures.packed())
    assert about == {"width": 40, "height": 60, "markers": []}
    assert abs(int(pixels[30, 39]) - 200) < 10
    pictures.take_frame(frame(200), 1.0, is_compressed=False)
    pictures.take_markers(cloud(200))
    assert unpacked(pictures.packed())[0]["markers"] == [{"u": 3.25, "v": 7.5, "id": 0}]


def test_markers_that_cannot_be_read_cost_the_picture_nothing():
    pictures = Pictures()
    pictures.take_frame(frame(200), 0.0, is_compressed=False)
    for length in (0, 3, 12, 20, 60):
        pictures.take_markers(cloud(200)[:length])
    assert unpacked(pictures.packed())[0]["markers"] == []


def test_frames_that_come_too_soon_are_passed_over():
    pictures = Pictures(period_s=0.1)
    for k in range(100):
        pictures.take_frame(frame(k), 0.01 * k, is_compressed=False)
    assert pictures.shown() == (10, False)


def test_a_frame_waits_for_the_tracker_as_long_as_it_is_kept():
    pictures = Pictures(period_s=0.1, kept_s=0.5)
    for k in range(1, 6):
        pictures.take_frame(frame(k), 0.11 * k, is_compressed=False)
    pictures.take_markers(cloud(3))
    assert pictures.shown() == (3, True)
    for k in range(6, 8):
        pictures.take_frame(frame(k), 0.11 * k, is_compressed=False)
    assert pictures.shown() == (3, True)
    pictures.take_frame(frame(8), 0.88, is_compressed=False)
    assert pictures.shown() == (8, False)  # the tracker has stopped: its last answer is not shown for ever


def test_a_large_frame_is_shown_smaller_and_its_markers_stay_in_its_own_pixels():
    pictures = Pictures(max_side_px=100)
    pictures.take_frame(frame(200, height=400, width=300), 0.0, is_compressed=False)
    about, pixels = unpacked(pictures.packed())
    assert (about["width"], about["height"]) == (300, 400)
    assert pixels.shape == (100, 75)


def test_what_is_no_frame_is_refused():
    with pytest.raises(ImageFormatError):
        Pictures().take_frame(b"nonsense", 0.0, is_compressed=False)
