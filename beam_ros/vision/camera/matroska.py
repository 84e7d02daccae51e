"""Films whose frames carry their own times: Matroska files, written frame by frame.

Every frame is a picture by itself (PNG, lossless, or JPEG) with its own time to the microsecond, so that dropped
frames and a variable rate can be said. What is written is a part of RFC 9559: one segment of unknown size, one video
track, and a cluster for each frame; a film that is cut short can be read as far as it goes.
"""

from __future__ import annotations

import struct
from pathlib import Path
from types import TracebackType

import cv2

from beam_ros.arrays import ByteArray
from beam_ros.vision.errors import VideoError

_TICK_NS = 1000
_UNKNOWN_SIZE = b"\x01\xff\xff\xff\xff\xff\xff\xff"


def _element(identity: int, content: bytes) -> bytes:
    """EBML element: its identity, its size in eight bytes, its content."""
    name = identity.to_bytes((identity.bit_length() + 7) // 8, "big")
    return name + (len(content) | 1 << 56).to_bytes(8, "big") + content


def _number(identity: int, value: int) -> bytes:
    return _element(identity, value.to_bytes(max(1, (value.bit_length() + 7) // 8), "big"))


class MatroskaWriter:
    """Writes grey frames with their times.

    Parameters
    ----------
    path : Path -- the new file
    width, height : int -- size of the frames [px]
    rate_hz : float -- nominal rate, for players [Hz]
    jpeg_quality : int or None -- 1 to 100; None writes PNG, without loss

    Raises
    ------
    VideoError
        The file cannot be written.
    """

    def __init__(
        self, path: Path, width: int, height: int, rate_hz: float, jpeg_quality: int | None = None
    ) -> None:
        self._path, self._quality = path, jpeg_quality
        try:
            self._file = path.open("wb")
        except OSError as err:
            raise VideoError(f"{path}: cannot be written ({err.strerror}); give another place") from err
        code = b"MPNG" if jpeg_quality is None else b"MJPG"
        # BITMAPINFOHEADER, as films of the AVI kind have it: 24 bits a pixel, the codec's four letters.
        header = struct.pack("<IiiHH4sIiiII", 40, width, height, 1, 24, code, width * height * 3, 0, 0, 0, 0)
        picture = _number(0xB0, width) + _number(0xBA, height)
        track = b"".join(
            (
                _number(0xD7, 1),
                _number(0x73C5, 1),
                _number(0x83, 1),
                _number(0x23E383, round(1e9 / rate_hz)),
                _element(0x86, b"V_MS/VFW/FOURCC"),
                _element(0x63A2, header),
                _element(0xE0, picture),
            )
        )
        self._write(
            _element(
                0x1A45DFA3,
                _number(0x4286, 1)
                + _number(0x42F7, 1)
                + _number(0x42F2, 4)
                + _number(0x42F3, 8)
                + _element(0x4282, b"matroska")
                + _number(0x4287, 4)
                + _number(0x4285, 2),
            )
            + bytes.fromhex("18538067")
            + _UNKNOWN_SIZE
            + _element(
                0x1549A966,
                _number(0x2AD7B1, _TICK_NS) + _element(0x4D80, b"beam rig suite") + _element(0x5741, b"beam"),
            )
            + _element(0x1654AE6B, _element(0xAE, track))
        )

    def write(self, time_ns: int, image: ByteArray) -> None:
        """Append a frame.

        Parameters
        ----------
        time_ns : int -- since the first frame, rising [ns]
        image : ndarray, shape (height, width), uint8
        """
        if self._quality is None:
            _, data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])
        else:
            _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, self._quality])
        # SimpleBlock: track 1, no time of its own against its cluster's, key frame.
        block = _element(0xA3, b"\x81\x00\x00\x80" + data.tobytes())
        self._write(_element(0x1F43B675, _number(0xE7, round(time_ns / _TICK_NS)) + block))

    def _write(self, data: bytes) -> None:
        try:
            self._file.write(data)
        except OSError as err:
            raise VideoError(f"{self._path}: cannot be written ({err.strerror}); free some room") from err

    def close(self) -> None:
        """End the file."""
        self._file.close()

    def __enter__(self) -> MatroskaWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
