"""The wire's bytes of an image: read in place, whatever their byte order, and refused when anything is missing."""

from __future__ import annotations

import struct

import cv2
import numpy as np
import pytest

from beam_ros import messages
from beam_ros.messages import BagTypes
from beam_ros.vision.errors import ImageFormatError

pytest.importorskip("cv2")
from beam_ros.vision.camera.image_messages import read_compressed_image, read_image

STAMP_NS = 1_700_000_000_123_456_789
PIXELS = np.arange(5 * 7, dtype=np.uint8).reshape(5, 7)


def _wire(
    order: str,
    *,
    representation: int = 0,
    frame: str = "camera",
    encoding: str = "mono8",
    pixels: bytes = PIXELS.tobytes(),
    height: int = 5,
    width: int = 7,
    step: int = 7,
    is_bigendian: int = 0,
) -> bytes:
    """CDR of an Image, field by field as the specification says."""
    body = struct.pack(f"{order}iI", *divmod(STAMP_NS, 10**9))

    def padded(octets: bytes, alignment: int) -> bytes:
        return octets + bytes(-len(octets) % alignment)

    def text(words: str) -> bytes:
        return struct.pack(f"{order}I", len(words) + 1) + words.encode() + b"\0"

    body += text(frame)
    body = padded(body, 4) + struct.pack(f"{order}II", height, width) + text(encoding) + bytes([is_bigendian])
    body = padded(body, 4) + struct.pack(f"{order}II", step, len(pixels)) + pixels
    return bytes([0, representation + (order == "<"), 0, 0]) + body


@pytest.mark.parametrize("representation", [0, 6])
@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("frame", ["", "c", "ca", "cam", "camera_optical_frame"])
def test_every_field_is_read_in_both_byte_orders_whatever_the_padding(order, frame, representation) -> None:
    for encoding in ("mono8", "8UC1", "bayer_rggb8"):
        image = read_image(_wire(order, representation=representation, frame=frame, encoding=encoding))
        assert (image.stamp_ns, image.frame_id, image.encoding) == (STAMP_NS, frame, encoding)
        assert (image.height, image.width, image.step, image.is_bigendian) == (5, 7, 7, False)
        np.testing.assert_array_equal(np.frombuffer(image.data, np.uint8), PIXELS.ravel())


def test_the_bytes_of_another_library_are_read_alike() -> None:
    types = BagTypes()
    data = types.serialize(messages.image(types, STAMP_NS, PIXELS), "sensor_msgs/msg/Image")
    image = read_image(data)
    assert (image.stamp_ns, image.frame_id) == (STAMP_NS, "camera_optical_frame")
    np.testing.assert_array_equal(image.grey(), PIXELS)


def test_the_pixels_of_a_grey_image_are_not_copied() -> None:
    wire = _wire("<")
    grey = read_image(wire).grey()
    assert np.shares_memory(grey, np.frombuffer(wire, np.uint8))
    wide = np.arange(35, dtype="<u2")
    wire = _wire("<", encoding="mono16", pixels=wide.tobytes(), step=14)
    grey = read_image(wire).grey()
    assert np.shares_memory(grey, np.frombuffer(wire, np.uint8))
    np.testing.assert_array_equal(grey.ravel(), wide)


def test_the_byte_order_of_pixels_is_not_that_of_the_message() -> None:
    wide = (np.arange(35) * 257 + 1).astype(">u2")
    for order in "<>":
        wire = _wire(order, encoding="mono16", pixels=wide.tobytes(), step=14, is_bigendian=1)
        np.testing.assert_array_equal(read_image(wire).grey().ravel(), wide.astype(np.uint16))


def test_every_truncation_is_refused() -> None:
    wire = _wire("<")
    assert read_image(wire + b"\0\0\0").data.nbytes == 35  # padding behind the message is none of ours
    for length in range(len(wire)):
        with pytest.raises(ImageFormatError, match="check the camera driver"):
            read_image(wire[:length])


def test_every_flipped_bit_is_refused_or_read_without_leaving_the_message() -> None:
    wire = _wire("<")
    for bit in range(8 * len(wire)):
        damaged = bytearray(wire)
        damaged[bit // 8] ^= 1 << bit % 8
        try:
            grey = read_image(bytes(damaged)).grey()
        except ImageFormatError:
            continue
        assert grey.shape == (5, 7) or grey.nbytes <= 35


def test_compressed_images_are_read_alike_and_their_truncations_refused() -> None:
    types = BagTypes()
    wide = (PIXELS.astype(np.uint16) << 8) + 7
    for pixels, suffix in ((PIXELS, ".png"), (wide, ".png"), (np.full((16, 16), 90, np.uint8), ".jpg")):
        picture = cv2.imencode(suffix, pixels)[1].tobytes()
        message = messages.compressed_image(types, STAMP_NS, picture)
        data = types.serialize(message, "sensor_msgs/msg/CompressedImage")
        image = read_compressed_image(data)
        assert (image.stamp_ns, image.frame_id) == (STAMP_NS, "camera_optical_frame")
        assert bytes(image.data) == picture
        np.testing.assert_array_equal(image.grey(), pixels)
        assert image.grey().dtype == pixels.dtype
        for length in range(len(data) - 3):  # 3: the padding behind it
            with pytest.raises(ImageFormatError, match="check the camera driver"):
                read_compressed_image(data[:length])


def test_a_foreign_representation_is_named() -> None:
    with pytest.raises(ImageFormatError, match="00 03"):
        read_image(b"\x00\x03" + _wire("<")[2:])
