"""A sensor_msgs/Image as it is on the wire: its header read from the CDR bytes, its pixels seen in place.

A message class would copy every pixel into an array of its own before anybody has looked at one. Here the few
numbers in front of the pixels are read from the bytes that DDS hands over, and the pixels stay where they are.

The layout (OMG DDS-XTYPES 1.3, section 7.6.3; plain CDR, version 1 or 2, in which this type is the same): four
octets that name the representation, of which the last bit of the second is the byte order; then, each aligned to its
own size counted from behind those four octets,

    int32 sec, uint32 nanosec, string frame_id, uint32 height, uint32 width, string encoding,
    uint8 is_bigendian, uint32 step, sequence<uint8> data

where a string is its length with the closing zero, then its octets.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from beam_ros.arrays import ImageArray
from beam_ros.vision.camera.images import grey_image
from beam_ros.vision.errors import ImageFormatError

_BYTE_ORDERS = {b"\x00\x00": ">", b"\x00\x01": "<", b"\x00\x06": ">", b"\x00\x07": "<"}
_SECOND_NS = 1_000_000_000


@dataclass(frozen=True)
class WireImage:
    """The fields of an Image message.

    Attributes
    ----------
    stamp_ns : int -- header.stamp [ns]
    frame_id : str
    height, width : int -- [px]
    encoding : str
    is_bigendian : bool -- byte order of 16-bit pixels
    step : int -- bytes from one row to the next
    data : memoryview -- the pixels, in the bytes of the message
    """

    stamp_ns: int
    frame_id: str
    height: int
    width: int
    encoding: str
    is_bigendian: bool
    step: int
    data: memoryview

    def grey(self) -> ImageArray:
        """Pixels as one grey channel, shape (height, width); a view for mono8 and mono16.

        Raises
        ------
        ImageFormatError -- unknown encoding, or sizes that do not fit together
        """
        return grey_image(
            self.encoding, self.height, self.width, self.step, self.data, is_bigendian=self.is_bigendian
        )


def read_image(message: bytes | memoryview) -> WireImage:
    """Read an Image message from its bytes.

    Parameters
    ----------
    message : bytes-like -- CDR with its four octets of encapsulation, as a raw subscription hands it over

    Returns
    -------
    WireImage -- whose ``data`` is a view into ``message``

    Raises
    ------
    ImageFormatError -- another representation, or a message that ends before its data do
    """
    octets = memoryview(message)
    order = _BYTE_ORDERS.get(bytes(octets[:2]))
    if order is None:
        raise ImageFormatError(
            f"image message begins with the octets {bytes(octets[:4]).hex(' ') or '(none)'}: expected plain CDR, "
            "which begins with 00 00 or 00 01; check the camera driver's middleware"
        )
    try:
        seconds, nanoseconds = struct.unpack_from(f"{order}iI", octets, 4)
        frame_id, end = _text(octets, 12, order)
        height, width = struct.unpack_from(f"{order}II", octets, _aligned(end))
        encoding, end = _text(octets, _aligned(end) + 8, order)
        is_bigendian = bool(octets[end])
        step, length = struct.unpack_from(f"{order}II", octets, _aligned(end + 1))
    except (struct.error, IndexError) as err:
        raise ImageFormatError(
            f"image message ends within its header, after {len(octets)} bytes: expected stamp, sizes, encoding and "
            "pixels; check the camera driver and the transport"
        ) from err
    start = _aligned(end + 1) + 8
    if len(octets) < start + length:
        raise ImageFormatError(
            f"image message is truncated: {len(octets) - start} bytes of pixels where it announces {length}; check "
            "the camera driver and the transport"
        )
    return WireImage(
        seconds * _SECOND_NS + nanoseconds,
        frame_id,
        height,
        width,
        encoding,
        is_bigendian,
        step,
        octets[start : start + length],
    )


def _aligned(at: int) -> int:
    """Next offset at which a 32-bit number may stand; the four octets in front keep the count."""
    return (at + 3) & ~3


def _text(octets: memoryview, at: int, order: str) -> tuple[str, int]:
    """Read the string at an offset; returns it with the offset behind it."""
    (length,) = struct.unpack_from(f"{order}I", octets, at)
    end = at + 4 + length
    if end > len(octets):
        raise IndexError(end)
    # Octets that are not text stay visible in the message that refuses the encoding.
    return bytes(octets[at + 4 : end]).rstrip(b"\0").decode("utf-8", "backslashreplace"), end
