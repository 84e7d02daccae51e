from __future__ import annotations

import array

import cv2
import numpy as np
import pytest

from beam_ros.vision.camera.images import (
    SUPPORTED_ENCODINGS,
    grey_frame,
    grey_image,
    image_view,
    uncompressed,
)
from beam_ros.vision.errors import ImageFormatError
from beam_ros.vision.rendering.frames import SceneRenderer
from beam_ros.vision.tracking.tracker import MarkerTracker
from tests.beam_ros.vision.packaged_rig import packaged_camera, packaged_tracker

RNG = np.random.default_rng(5)
GREY = RNG.integers(0, 256, (6, 8), dtype=np.uint8)
WIDE = RNG.integers(0, 65536, (6, 8)).astype(np.uint16)


def padded(rows: np.ndarray, padding: int) -> bytes:
    """Rows of bytes with padding after each."""
    flat = rows.reshape(rows.shape[0], -1).view(np.uint8)
    return np.pad(flat, ((0, 0), (0, padding)), constant_values=255).tobytes()


@pytest.mark.parametrize("padding", [0, 3])
@pytest.mark.parametrize(
    "kind", [bytes, bytearray, lambda b: array.array("B", b), lambda b: np.frombuffer(b, np.uint8)]
)
def test_mono8_is_seen_in_place_for_every_buffer_and_step(padding, kind):
    data = kind(padded(GREY, padding))
    image = grey_image("mono8", 6, 8, 8 + padding, data)
    assert np.array_equal(image, GREY)
    assert np.shares_memory(image, np.frombuffer(data, np.uint8))


@pytest.mark.parametrize("is_bigendian", [False, True])
@pytest.mark.parametrize("padding", [0, 1])
def test_mono16_is_read_in_both_byte_orders_and_odd_steps(is_bigendian, padding):
    data = padded(WIDE.astype(">u2" if is_bigendian else "<u2"), padding)
    image = grey_image("mono16", 6, 8, 16 + padding, data, is_bigendian=is_bigendian)
    assert image.dtype == np.uint16
    assert np.array_equal(image, WIDE)


@pytest.mark.parametrize(
    ("encoding", "padding"), [("mono8", 0), ("mono8", 7), ("mono16", 0), ("mono16", 1), ("mono16", 6)]
)
def test_the_tracker_works_on_the_bytes_of_a_message(encoding, padding):
    camera, heights = packaged_camera(), (0.010, 0.225, 0.285)
    frame = SceneRenderer(camera, heights).render([0.0, 0.0, 0.0], np.random.default_rng(0))
    pixels = frame if encoding == "mono8" else frame.astype("<u2") * 100
    step = 640 * pixels.itemsize + padding
    image = grey_image(encoding, 480, 640, step, padded(pixels, padding))
    result = MarkerTracker(packaged_tracker(camera, heights), 3).process(image, 0)
    assert [marker.u_px for marker in result.markers] == pytest.approx([320.0] * 3, abs=0.03)


@pytest.mark.parametrize(("encoding", "code"), [("bgr8", cv2.COLOR_BGR2GRAY), ("rgb8", cv2.COLOR_RGB2GRAY)])
def test_colour_becomes_the_grey_of_its_channel_order(encoding, code):
    colour = RNG.integers(0, 256, (6, 8, 3), dtype=np.uint8)
    assert np.array_equal(grey_image(encoding, 6, 8, 26, padded(colour, 2)), cv2.cvtColor(colour, code))


@pytest.mark.parametrize(
    ("encoding", "luminance"), [("yuv422", 1), ("uyvy", 1), ("yuv422_yuy2", 0), ("yuyv", 0)]
)
def test_luminance_and_colour_in_turns_give_the_luminance(encoding, luminance):
    """The sample layouts of image_encodings.hpp: yuv422 begins with a colour, yuv422_yuy2 with the luminance."""
    samples = RNG.integers(0, 256, (6, 8, 2), dtype=np.uint8)
    samples[:, :, luminance] = GREY
    assert np.array_equal(grey_image(encoding, 6, 8, 19, padded(samples, 3)), GREY)


@pytest.mark.parametrize(("encoding", "colour_rows"), [("nv21", 3), ("nv24", 12)])
def test_colour_behind_the_luminance_is_passed_over(encoding, colour_rows):
    data = padded(np.vstack([GREY, RNG.integers(0, 256, (colour_rows, 8), dtype=np.uint8)]), 2)
    image = grey_image(encoding, 6, 8, 10, data)
    assert np.array_equal(image, GREY)
    assert np.shares_memory(image, np.frombuffer(data, np.uint8))


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_bayer_patterns_are_named_by_the_first_row(pattern):
    """A scene that is pure red must come out as the grey of red, whatever the pattern."""
    mosaic = np.zeros((16, 16), np.uint8)
    for k, colour in enumerate(pattern):
        if colour == "r":
            mosaic[k // 2 :: 2, k % 2 :: 2] = 200
    grey = grey_image(f"bayer_{pattern}8", 16, 16, 16, mosaic.tobytes())
    assert grey[4:-4, 4:-4] == pytest.approx(np.full((8, 8), 0.299 * 200), abs=1.5)


def test_a_bayer_image_of_a_white_marker_keeps_its_position():
    camera = packaged_camera(noise_grey=0.0)
    frame = SceneRenderer(camera, [0.1]).render([0.0123], np.random.default_rng(0))
    grey = grey_image("bayer_rggb8", 480, 640, 640, frame).astype(float)
    # Older OpenCV truncates 30 to 29 in places.
    grey = np.where(grey < 32, 0.0, grey - 30.0)
    columns = np.arange(640)
    # Interpolation is symmetric about each site only on average: a few thousandths remain.
    assert (grey.sum(axis=0) @ columns) / grey.sum() == pytest.approx(camera.columns(0.0123), abs=0.01)


def test_every_truncation_is_refused_with_the_numbers():
    data = padded(GREY, 0)
    for length in range(len(data)):
        with pytest.raises(ImageFormatError, match=rf"truncated: {length} bytes of data; expected 48"):
            image_view("mono8", 6, 8, 8, data[:length])


def test_the_last_row_needs_no_padding():
    data = padded(GREY, 4)[:-4]
    assert np.array_equal(image_view("mono8", 6, 8, 12, data), GREY)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("32FC1", 6, 8, 32, bytes(192)), "'32FC1' is not supported; expected one of mono8"),
        (("yuyv", 6, 8, 15, bytes(96)), "step is 15 bytes; expected at least 16"),
        (("mono8", 0, 8, 8, b""), "size is 8 x 0"),
        (("mono16", 6, 8, 8, bytes(96)), "step is 8 bytes; expected at least 16"),
        (("mono8", 6, 8, 8, None), "NoneType without bytes"),
    ],
)
def test_what_does_not_fit_is_refused(arguments, message):
    with pytest.raises(ImageFormatError, match=message):
        image_view(*arguments)


def test_every_supported_encoding_gives_a_grey_image():
    for encoding in SUPPORTED_ENCODINGS:
        image = grey_image(encoding, 16, 16, 64, bytes(64 * 16))
        assert image.shape == (16, 16)
        assert image.dtype in (np.uint8, np.uint16)


def test_a_captured_frame_of_any_layout_becomes_grey():
    colour = np.repeat(GREY[:, :, None], 3, axis=2)
    for frame in (
        GREY,
        GREY[:, :, None],
        np.stack([GREY, GREY[::-1]], axis=2),  # YUYV as it is: luminance first
        colour,
        np.concatenate([colour, np.full_like(GREY, 255)[:, :, None]], axis=2),
    ):
        found = grey_frame(frame)
        assert found.flags.c_contiguous
        assert np.array_equal(found, GREY)
    assert np.array_equal(grey_frame(WIDE), WIDE)


@pytest.mark.parametrize(
    "frame",
    [
        np.zeros((4, 4, 3), np.float64),
        np.zeros((4, 4, 3), np.int8),
        np.zeros((4, 4, 5), np.uint8),
        np.zeros(4, np.uint8),
        np.zeros((0, 4, 3), np.uint8),
    ],
)
def test_a_captured_frame_that_is_no_image_is_refused_with_its_shape(frame):
    with pytest.raises(ImageFormatError, match=r"of shape .*expected 8 or 16 bits.*device_format"):
        grey_frame(frame)


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_a_compressed_picture_that_is_cut_off_is_refused_and_zeros_behind_it_are_none_of_it(suffix):
    pixels = np.full((48, 64), 90, np.uint8)
    pixels[20:30, 20:40] = 200
    whole = cv2.imencode(suffix, pixels)[1].tobytes()
    np.testing.assert_array_equal(uncompressed(whole, ""), uncompressed(whole + bytes(64), ""))
    for length in range(8, len(whole) - 1):
        with pytest.raises(ImageFormatError, match="damaged or cut off"):
            uncompressed(whole[:length], "jpeg")


def test_a_colour_picture_gives_its_luminance_and_other_kinds_are_named():
    colours = np.zeros((16, 16, 3), np.uint8)
    colours[...] = 30, 120, 200
    found = uncompressed(cv2.imencode(".png", colours)[1].tobytes(), "bgr8; png compressed bgr8")
    np.testing.assert_allclose(found, 0.114 * 30 + 0.587 * 120 + 0.299 * 200, atol=1.0)
    for data, start in ((b"", r"\(nothing\)"), (b"\0\0\1\x09\x10\1", "00 00 01 09")):
        with pytest.raises(
            ImageFormatError, match=f"'h264' and begins with {start}; expected a JPEG or a PNG"
        ):
            uncompressed(data, "h264")
