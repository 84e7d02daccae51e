"""An Image message's fields to a NumPy array, without cv_bridge and without a copy where none is needed.

``image_view`` looks at the message's bytes in place, honouring ``step``; ``grey_image`` goes on to the single
channel that the tracker works on, as ``grey_frame`` does for frames that OpenCV read. Whatever does not fit is
refused with an error that names the numbers. ``uncompressed`` decodes pictures of compressed topics.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from beam_ros.arrays import ByteArray, ImageArray
from beam_ros.vision.errors import ImageFormatError


@dataclass(frozen=True)
class _Encoding:
    channels: int
    bytes_per_channel: int
    to_grey: int | None


# ROS names a Bayer pattern by its first two pixels of the first row, OpenCV by the second row's.
_ENCODINGS: dict[str, _Encoding] = {
    "mono8": _Encoding(1, 1, None),
    "8UC1": _Encoding(1, 1, None),
    "mono16": _Encoding(1, 2, None),
    "16UC1": _Encoding(1, 2, None),
    "bgr8": _Encoding(3, 1, cv2.COLOR_BGR2GRAY),
    "8UC3": _Encoding(3, 1, cv2.COLOR_BGR2GRAY),
    "rgb8": _Encoding(3, 1, cv2.COLOR_RGB2GRAY),
    "bgra8": _Encoding(4, 1, cv2.COLOR_BGRA2GRAY),
    "rgba8": _Encoding(4, 1, cv2.COLOR_RGBA2GRAY),
    # Luminance and colour in turns, each by its deprecated and its present name; ...
    "yuv422": _Encoding(2, 1, cv2.COLOR_YUV2GRAY_UYVY),
    "uyvy": _Encoding(2, 1, cv2.COLOR_YUV2GRAY_UYVY),
    "yuv422_yuy2": _Encoding(2, 1, cv2.COLOR_YUV2GRAY_YUY2),
    "yuyv": _Encoding(2, 1, cv2.COLOR_YUV2GRAY_YUY2),
    # ... or all luminance in front of all colour.
    "nv21": _Encoding(1, 1, None),
    "nv24": _Encoding(1, 1, None),
    "bayer_rggb8": _Encoding(1, 1, cv2.COLOR_BayerBG2GRAY),
    "bayer_bggr8": _Encoding(1, 1, cv2.COLOR_BayerRG2GRAY),
    "bayer_gbrg8": _Encoding(1, 1, cv2.COLOR_BayerGR2GRAY),
    "bayer_grbg8": _Encoding(1, 1, cv2.COLOR_BayerGB2GRAY),
    "bayer_rggb16": _Encoding(1, 2, cv2.COLOR_BayerBG2GRAY),
    "bayer_bggr16": _Encoding(1, 2, cv2.COLOR_BayerRG2GRAY),
    "bayer_gbrg16": _Encoding(1, 2, cv2.COLOR_BayerGR2GRAY),
    "bayer_grbg16": _Encoding(1, 2, cv2.COLOR_BayerGB2GRAY),
}

SUPPORTED_ENCODINGS: tuple[str, ...] = tuple(_ENCODINGS)

_COMPRESSED = {b"\xff\xd8\xff": b"\xff\xd9", b"\x89PNG": b"IEND\xaeB`\x82"}
"""How JPEG and PNG begin and end."""
_GREY_AS_STORED = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION


def image_view(
    encoding: str,
    height: int,
    width: int,
    step: int,
    data: Any,
    *,
    is_bigendian: bool = False,
) -> ImageArray:
    """See the bytes of an Image message as an array.

    Parameters
    ----------
    encoding : str -- one of SUPPORTED_ENCODINGS
    height, width : int -- image size [px]
    step : int -- bytes from one row to the next
    data : bytes-like -- at least step * (height - 1) + the bytes of one row; anything with the buffer
        protocol, such as ``bytes``, ``array.array`` or a uint8 ndarray
    is_bigendian : bool -- byte order of 16-bit encodings

    Returns
    -------
    ndarray, shape (height, width) or (height, width, channels), uint8 or uint16 -- of nv21 and nv24 the luminance; a
        read-only or writable view as ``data`` is; only 16-bit samples of the other byte order or at odd addresses are
        copied

    Raises
    ------
    ImageFormatError -- unknown encoding, or sizes that do not fit together
    """
    kind = _ENCODINGS.get(encoding)
    if kind is None:
        raise ImageFormatError(
            f"image encoding {encoding!r} is not supported; expected one of "
            f"{', '.join(SUPPORTED_ENCODINGS)}: set the camera driver to mono8"
        )
    if height <= 0 or width <= 0:
        raise ImageFormatError(
            f"image size is {width} x {height}; expected a positive width and height: check the camera driver"
        )
    row_bytes = width * kind.channels * kind.bytes_per_channel
    if step < row_bytes:
        raise ImageFormatError(
            f"image step is {step} bytes; expected at least {row_bytes} for {width} px of {encoding}: "
            "check the camera driver"
        )
    try:
        octets = np.frombuffer(data, dtype=np.uint8)
    except (TypeError, ValueError, BufferError) as err:
        raise ImageFormatError(
            f"image data is a {type(data).__name__} without bytes; expected the message's data field"
        ) from err
    needed = step * (height - 1) + row_bytes
    if octets.size < needed:
        raise ImageFormatError(
            f"image is truncated: {octets.size} bytes of data; expected {needed} for {width} x {height} "
            f"{encoding} with step {step}: check the transport and the camera driver"
        )
    if kind.bytes_per_channel == 2:
        wide = np.ndarray(
            (height, width), dtype=">u2" if is_bigendian else "<u2", buffer=octets, strides=(step, 2)
        )
        # OpenCV reads whole samples: rows at odd addresses are copied.
        is_seen_in_place = wide.dtype == np.uint16 and wide.flags.aligned
        return wide if is_seen_in_place else np.asarray(wide.astype(np.uint16))
    shape = (height, width) if kind.channels == 1 else (height, width, kind.channels)
    strides = (step, 1) if kind.channels == 1 else (step, kind.channels, 1)
    return np.asarray(np.ndarray(shape, dtype=np.uint8, buffer=octets, strides=strides))


def grey_image(
    encoding: str,
    height: int,
    width: int,
    step: int,
    data: Any,
    *,
    is_bigendian: bool = False,
) -> ImageArray:
    """Reduce the bytes of an Image message to one grey channel.

    Parameters and errors are those of ``image_view``. mono8, mono16, nv21 and nv24 stay a view on the message's
    bytes; other colour and Bayer patterns are converted (at 1920x1080 that costs more than all tracking: ask the
    camera for mono8).

    Returns
    -------
    ndarray, shape (height, width), uint8 or uint16
    """
    view = image_view(encoding, height, width, step, data, is_bigendian=is_bigendian)
    code = _ENCODINGS[encoding].to_grey
    if code is None:
        return np.asarray(view)
    return _converted(np.ascontiguousarray(view), code)


def as_jpeg(pixels: ByteArray) -> bytes:
    """Compress grey pixels of shape (height, width) to a JPEG, as good as camera drivers make them (quality 95)."""
    return cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()


def uncompressed(data: Any, kind: str) -> ImageArray:
    """Decode a JPEG or a PNG to one grey channel.

    Parameters
    ----------
    data : bytes-like -- the picture; zeros may follow it
    kind : str -- what the sender calls it, for the message that refuses it

    Returns
    -------
    ndarray, shape (height, width), uint8 or uint16 -- of colour the luminance; not turned as a tag of a JPEG asks

    Raises
    ------
    ImageFormatError -- it is neither, is cut off before its end, or cannot be decoded
    """
    octets = bytes(data).rstrip(b"\0")
    end = next((end for start, end in _COMPRESSED.items() if octets.startswith(start)), None)
    if end is None:
        raise ImageFormatError(
            f"compressed image is {kind!r} and begins with {octets[:4].hex(' ') or '(nothing)'}; expected a JPEG "
            "or a PNG: set the format of the camera driver's compressed topic to jpeg or png"
        )
    image = None
    # Of what is cut off, decoders make up the rest.
    if octets.endswith(end):
        with contextlib.suppress(cv2.error):
            image = cv2.imdecode(np.frombuffer(octets, dtype=np.uint8), _GREY_AS_STORED)
    if image is None:
        raise ImageFormatError(
            f"compressed image {kind!r} of {len(octets)} bytes is damaged or cut off; expected a whole JPEG or PNG: "
            "check the camera's cable and the network"
        )
    return np.asarray(image)


def grey_frame(frame: ImageArray) -> ImageArray:
    """Reduce a frame that OpenCV captured or decoded to one grey channel.

    Parameters
    ----------
    frame : ndarray, shape (height, width) or (height, width, channels), uint8 or uint16 -- grey; luminance before
        something else; blue, green and red; or these and opacity

    Returns
    -------
    ndarray, shape (height, width), uint8 or uint16 -- contiguous

    Raises
    ------
    ImageFormatError -- it is none of these
    """
    channels = frame.shape[2] if frame.ndim == 3 else 1
    if (
        frame.dtype not in (np.uint8, np.uint16)
        or frame.ndim not in (2, 3)
        or channels not in (1, 2, 3, 4)
        or 0 in frame.shape
    ):
        raise ImageFormatError(
            f"frame is {frame.dtype} of shape {frame.shape}; expected 8 or 16 bits, (height, width) and up to four "
            "channels: set tracker.device_format to GREY, or convert the video"
        )
    if channels <= 2:
        return np.ascontiguousarray(frame if frame.ndim == 2 else frame[:, :, 0])
    return _converted(frame, cv2.COLOR_BGR2GRAY if channels == 3 else cv2.COLOR_BGRA2GRAY)


def _converted(pixels: ImageArray, code: int) -> ImageArray:
    try:
        return np.asarray(cv2.cvtColor(pixels, code))
    except cv2.error as err:
        raise ImageFormatError(
            f"image of shape {pixels.shape} and {pixels.dtype} cannot be converted to grey ({str(err).strip()}): set "
            "the camera driver to mono8"
        ) from err
