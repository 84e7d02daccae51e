"""The camera's newest frame as a JPEG, with where the markers were found in it.

A frame is compressed when a reader asks for it and not before, and once for all readers. Frames that come sooner
than the page shows them are passed over unread: their stamps alone are looked at.
"""

from __future__ import annotations

import struct
from collections import deque
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


class Pictures:
    """Keeps the newest frame.

    Parameters
    ----------
    period_s : float -- between two frames that are shown, at least [s]
    max_side_px : int -- larger frames are shown smaller [px]
    quality : int -- of the JPEG, up to 100

    Attributes
    ----------
    number : int -- of the newest frame, counted from 1
    """

    def __init__(self, *, period_s: float = 0.1, max_side_px: int = 800, quality: int = 70) -> None:
        self._period_s, self._max_side_px, self._quality = period_s, max_side_px, quality
        self.number = 0
        self._shown_at_s: float | None = None
        self._frame: ImageArray | None = None
        self._stamp_ns = 0
        self._packed: tuple[int, bytes] = (0, b"")
        # The tracker's answer comes near the frame, before or after it. It is read where its stamp is the frame's.
        self._clouds: deque[bytes] = deque(maxlen=100)
        self._types = BagTypes()

    def is_due(self, now_s: float) -> bool:
        """Tell whether a frame that comes now would be shown."""
        return self._shown_at_s is None or not 0.0 <= now_s - self._shown_at_s < self._period_s

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
        pixels = message.grey()
        self._frame = np.array(pixels)  # the message's bytes are not kept
        self._stamp_ns, self._shown_at_s = message.stamp_ns, now_s
        self.number += 1

    def take_markers(self, data: bytes) -> None:
        """Take a message of ``beam/markers``: where the markers were found in some frame."""
        self._clouds.append(data)

    def forget(self) -> None:
        """Show the next frame at once, and no marker of before."""
        self._shown_at_s = None
        self._clouds.clear()

    def packed(self) -> bytes:
        """Return the newest frame as the page reads it; empty where there is none.

        Returns
        -------
        bytes -- length of the JSON (four bytes, big endian), JSON of size [px] and markers, JPEG
        """
        if self._frame is None:
            return b""
        if self._packed[0] != self.number:
            self._packed = (self.number, self._pack(self._frame))
        return self._packed[1]

    def _pack(self, frame: ImageArray) -> bytes:
        height, width = frame.shape[:2]
        if frame.dtype != np.uint8:
            frame = cv2.convertScaleAbs(frame, alpha=255.0 / max(int(frame.max()), 1))
        share = min(1.0, self._max_side_px / max(height, width))
        if share < 1.0:
            size = (max(1, round(width * share)), max(1, round(height * share)))
            frame = cv2.resize(frame, size, interpolation=cv2.INTER_AREA)
        jpeg = cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, self._quality])[1].tobytes()
        about = strict_json({"width": width, "height": height, "markers": self._markers()}).encode()
        return _LENGTH.pack(len(about)) + about + jpeg

    def _markers(self) -> list[dict[str, Any]]:
        wanted = _STAMP.pack(*divmod(self._stamp_ns, SECOND_NS))
        data = next((data for data in self._clouds if data[4 : 4 + _STAMP.size] == wanted), None)
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
