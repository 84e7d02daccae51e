"""Images as they are on the wire: their headers read from the CDR bytes, their pixels seen in place.

A message class would copy every pixel into an array of its own before anybody has looked at one. Here the few
numbers in front of the pixels are read from the bytes that DDS hands over, and the pixels stay where they are.

The layout (OMG DDS-XTYPES 1.3, section 7.6.3; plain CDR, version 1 or 2, in which these types are the same): four
octets that name the representation, of which the last bit of the second is the byte order; then, each aligned to its
own size counted from behind those four octets, of a sensor_msgs/Image

    int32 sec, uint32 nanosec, string frame_id, uint32 height, uint32 width, string encoding,
    uint8 is_bigendian, uint32 step, sequence<uint8> data

and of a sensor_msgs/CompressedImage

    int32 sec, uint32 nanosec, string frame_id, string format, sequence<uint8> data

where a string is its length with the closing zero, then its octets.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from beam_ros.arrays import ImageArray
from beam_ros.vision.camera.images import grey_image, uncompressed
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
        """Pixels as one grey channel, shape (height, width); a view where the pixels are grey as they lie.

        Raises
        ------
        ImageFormatError -- unknown encoding, or sizes that do not fit together
        """
        return grey_image(
            self.encoding, self.height, self.width, self.step, self.data, is_bigendian=self.is_bigendian
        )


@dataclass(frozen=True)
class WireCompressedImage:
    """The fields of a CompressedImage message.

    Attributes
    ----------
    stamp_ns : int -- header.stamp [ns]
    frame_id, format : str
    data : memoryview -- the compressed picture, in the bytes of the message
    """

    stamp_ns: int
    frame_id: str
    format: str
    data: memoryview

    def grey(self) -> ImageArray:
        """Pixels as one grey channel, shape (height, width).

        Raises
        ------
        ImageFormatError -- no JPEG or PNG, or a damaged one
        """
        return uncompressed(self.data, self.format)


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
    with _Reader(message) as wire:
        stamp_ns, frame_id = wire.header()
        height, width = wire.number(), wire.number()
        encoding = wire.text()
        is_bigendian, step = wire.flag(), wire.number()
        return WireImage(stamp_ns, frame_id, height, width, encoding, is_bigendian, step, wire.octets())


def read_compressed_image(message: bytes | memoryview) -> WireCompressedImage:
    """Read a CompressedImage message from its bytes; parameters and errors are those of ``read_image``."""
    with _Reader(message) as wire:
        return WireCompressedImage(*wire.header(), wire.text(), wire.octets())


class _Reader:
    """Reads the fields of a message one after the other; where it ends before they do, it is refused."""

    def __init__(self, message: bytes | memoryview) -> None:
        self._octets = memoryview(message)
        order = _BYTE_ORDERS.get(bytes(self._octets[:2]))
        if order is None:
            raise ImageFormatError(
                f"image message begins with the octets {bytes(self._octets[:4]).hex(' ') or '(none)'}: expected "
                "plain CDR, which begins with 00 00 or 00 01; check the camera driver's middleware"
            )
        self._order = order
        self._at = 4

    def __enter__(self) -> _Reader:
        return self

    def __exit__(self, kind: object, err: BaseException | None, trace: object) -> None:
        if isinstance(err, (struct.error, IndexError)):
            raise ImageFormatError(
                f"image message ends within its header, after {len(self._octets)} bytes: expected stamp, sizes, "
                "encoding and pixels; check the camera driver and the transport"
            ) from err

    def number(self, kind: str = "I") -> int:
        """Read a number of 32 bits, aligned; the four octets in front keep the count."""
        at = (self._at + 3) & ~3
        (value,) = struct.unpack_from(self._order + kind, self._octets, at)
        self._at = at + 4
        return int(value)

    def header(self) -> tuple[int, str]:
        """Read stamp [ns] and frame_id."""
        return self.number("i") * _SECOND_NS + self.number(), self.text()

    def flag(self) -> bool:
        """Read an octet as a truth value."""
        self._at += 1
        return bool(self._octets[self._at - 1])

    def text(self) -> str:
        """Read a string."""
        length = self.number()
        start, self._at = self._at, self._at + length
        if self._at > len(self._octets):
            raise IndexError(self._at)
        # Octets that are not text stay visible in the message that refuses the encoding.
        return bytes(self._octets[start : self._at]).rstrip(b"\0").decode("utf-8", "backslashreplace")

    def octets(self) -> memoryview:
        """See a sequence of octets in place."""
        length = self.number()
        found = self._octets[self._at : self._at + length]
        if len(found) < length:
            raise ImageFormatError(
                f"image message is truncated: {len(found)} bytes of pixels where it announces {length}; check the "
                "camera driver and the transport"
            )
        return found
