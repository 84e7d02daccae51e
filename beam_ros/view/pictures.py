"""The camera's newest frame as a JPEG, with where the markers were found in it.

A frame is compressed when a reader asks for it and not before, and once for all readers. Frames that come sooner
than the page shows them are passed over unread. The tracker takes its time: the newest frame of the last second that
it has answered is shown, and where it has answered none the newest.
"""

from __future__ import annotations

import struct
from collections import OrderedDict, deque
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from beam_ros.arrays import ImageArray
from beam_ros.bags.errors import BagError
from beam_ros.bags.signals import message_decoder
from beam_ros.interfaces import graph
from beam_ros.messages import SECOND_NS, BagTypes, MessageContentError, read_marker_cloud
from beam_ros.process.strict_json import strict_json
from beam_ros.vision.camera.image_messages import read_compressed_image, read_image

_LENGTH = struct.Struct(">I")
_STAMP = struct.Struct("<iI")
"""Stamp of a message with a header, behind the four octets that say how it is written, as ROS 2 writes it here."""


@dataclass(frozen=True)
class _Frame:
    """A frame as it is shown: its number, its stamp as it lies in a message, its own size [px], and pixels."""

    number: int
    stamp: bytes
    width: int
    height: int
    pixels: ImageArray


class Pictures:
    """Keeps the newest frames.

    Parameters
    ----------
    period_s : float -- between two frames that are shown, at least [s]
    kept_s : float -- so long a frame waits for the tracker's answer [s]
    max_side_px : int -- larger frames are shown smaller [px]
    quality : int -- of the JPEG, up to 100
    """

    def __init__(
        self, *, period_s: float = 0.1, kept_s: float = 1.0, max_side_px: int = 800, quality: int = 70
    ) -> None:
        self._period_s, self._max_side_px, self._quality = period_s, max_side_px, quality
        self._total = 0
        self._taken_at_s: float | None = None
        self._frames: deque[_Frame] = deque(maxlen=max(1, round(kept_s / period_s)))
        # By their stamps, as bytes: they are read where the frame is shown.
        self._clouds: OrderedDict[bytes, bytes] = OrderedDict()
        self._types = BagTypes()
        self._packed: tuple[tuple[int, bool], bytes] = (0, False), b""

    def is_due(self, now_s: float) -> bool:
        """Tell whether a frame that comes now would be shown."""
        return self._taken_at_s is None or not 0.0 <= now_s - self._taken_at_s < self._period_s

    def take_frame(self, data: bytes, now_s: float, *, is_compressed: bool) -> None:
        """Take a frame as it came from the wire or a bag.

        Raises
        ------
        ImageFormatError
            It cannot be read.
        """
        if not self.is_due(now_s):
            return
        message = read_compressed_image(data) if is_compressed else read_image(data)
        pixels = np.array(message.grey())  # the message's bytes are not kept
        self._total, self._taken_at_s = self._total + 1, now_s
        height, width = pixels.shape[:2]
        stamp = _STAMP.pack(*divmod(message.stamp_ns, SECOND_NS))
        self._frames.append(_Frame(self._total, stamp, width, height, self._reduced(pixels)))

    def _reduced(self, pixels: ImageArray) -> ImageArray:
        height, width = pixels.shape[:2]
        share = min(1.0, self._max_side_px / max(height, width))
        if share == 1.0:
            return pixels
        size = (max(1, round(width * share)), max(1, round(height * share)))
        return np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA))

    def take_markers(self, data: bytes, *, remembered: int = 1000) -> None:
        """Take a message of ``beam/markers``: where the markers were found in some frame."""
        self._clouds[data[4 : 4 + _STAMP.size]] = data
        while len(self._clouds) > remembered:
            self._clouds.popitem(last=False)

    def forget(self) -> None:
        """Show the next frame at once, and nothing of before."""
        self._taken_at_s = None
        self._frames.clear()
        self._clouds.clear()

    def shown(self) -> tuple[int, bool]:
        """Return which frame is shown, counted from 1, and whether the tracker has answered it; 0: none."""
        frame = self._frame()
        return (0, False) if frame is None else (frame.number, frame.stamp in self._clouds)

    def _frame(self) -> _Frame | None:
        answered = (frame for frame in reversed(self._frames) if frame.stamp in self._clouds)
        return next(answered, self._frames[-1] if self._frames else None)

    def packed(self) -> bytes:
        """Return the frame that is shown as the page reads it; empty where there is none.

        Returns
        -------
        bytes -- length of the JSON (four bytes, big endian), JSON of size [px] and markers, JPEG
        """
        frame, shown = self._frame(), self.shown()
        if frame is None:
            return b""
        if self._packed[0] != shown:
            self._packed = (shown, self._pack(frame))
        return self._packed[1]

    def _pack(self, frame: _Frame) -> bytes:
        pixels = frame.pixels
        if pixels.dtype != np.uint8:
            pixels = cv2.convertScaleAbs(pixels, alpha=255.0 / max(int(pixels.max()), 1))
        jpeg = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, self._quality])[1].tobytes()
        content = {"width": frame.width, "height": frame.height, "markers": self._markers(frame)}
        about = strict_json(content).encode()
        return _LENGTH.pack(len(about)) + about + jpeg

    def _markers(self, frame: _Frame) -> list[dict[str, Any]]:
        data = self._clouds.get(frame.stamp)
        if data is None:
            return []
        type_name = graph.TOPICS["beam/markers"].type_name
        try:
            cloud = message_decoder(self._types, type_name, read_marker_cloud)(data)
        except (MessageContentError, BagError):
            return []  # The picture is shown without; the page says so.
        return [
            {"u": round(float(row["u"]), 2), "v": round(float(row["v"]), 2), "id": int(row["id"])}
            for row in cloud.rows
            if row["valid"]
        ]
