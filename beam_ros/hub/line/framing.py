"""Frames on a serial line: bytes to payloads and back, whatever the line does to them.

A frame is a zero byte, COBS(payload + CRC-32) and a zero byte. COBS (Cheshire & Baker 1999) leaves no zero
inside, so that a reader who starts anywhere, or lost anything, is in step again after the next zero; the
leading one parts the frame from whatever noise came before it. The CRC is the one of Ethernet and zlib; at
these lengths it detects every error of up to three bits.
"""

from __future__ import annotations

import struct
import zlib

from beam_ros.hub.errors import HubProtocolError

MAX_PAYLOAD = 2048
"""Longest payload [bytes]; a longer run without a zero byte is thrown away."""

_DELIMITER = 0
_CRC = struct.Struct("<I")
_MAX_ENCODED = MAX_PAYLOAD + _CRC.size + (MAX_PAYLOAD + _CRC.size) // 254 + 1


def cobs_encode(data: bytes) -> bytes:
    """Return ``data`` without zero bytes, at most one byte in 254 longer, plus one."""
    out = bytearray()
    segments = data.split(b"\0")
    for number, segment in enumerate(segments):
        is_last = number == len(segments) - 1
        # A full block stands for 254 bytes and no zero; where the data end with one, nothing follows it.
        while len(segment) > 254 or (len(segment) == 254 and not is_last):
            out.append(255)
            out += segment[:254]
            segment = segment[254:]
        out.append(len(segment) + 1)
        out += segment
    return bytes(out)


def cobs_decode(data: bytes) -> bytes:
    """Return what ``cobs_encode`` was given.

    Raises
    ------
    HubProtocolError
        A block reaches beyond the end, or a zero byte stands inside.
    """
    if _DELIMITER in data:
        raise HubProtocolError("zero byte inside a frame; the line changed bytes")
    # Every code stands where the zero before its block was, but for those after a full block.
    out = bytearray(data)
    superfluous = [0]
    place, n_bytes = 0, len(data)
    while place < n_bytes:
        out[place] = 0
        code = data[place]
        place += code
        if code == 255:
            superfluous.append(place)
    if place > n_bytes:
        raise HubProtocolError(
            f"COBS block of {code} bytes at {place - code} of {n_bytes}: expected 1 to {n_bytes - place + code}; "
            "the line lost or changed bytes"
        )
    for place in reversed(superfluous):
        del out[place : place + 1]
    return bytes(out)


def encode_frame(payload: bytes) -> bytes:
    """Return one frame around a payload, with its zero bytes.

    Raises
    ------
    HubProtocolError
        The payload is empty or longer than ``MAX_PAYLOAD``.
    """
    if not 1 <= len(payload) <= MAX_PAYLOAD:
        raise HubProtocolError(f"payload of {len(payload)} bytes: expected 1 to {MAX_PAYLOAD}")
    return b"\0" + cobs_encode(payload + _CRC.pack(zlib.crc32(payload))) + b"\0"


class FrameDecoder:
    """Finds the payloads in a stream of bytes that comes in pieces of any size.

    Attributes
    ----------
    n_good, n_bad : int
        Frames that passed and frames that were thrown away.
    """

    def __init__(self) -> None:
        self.n_good = 0
        self.n_bad = 0
        self._pending = bytearray()
        self._is_overlong = False

    def feed(self, data: bytes) -> list[bytes]:
        """Take the next bytes; return the payloads of the frames that they complete."""
        payloads = []
        pieces = data.split(b"\0")
        for number, piece in enumerate(pieces):
            if not self._is_overlong:
                self._pending += piece
                if len(self._pending) > _MAX_ENCODED:
                    self._is_overlong = True
                    self._pending.clear()
            if number < len(pieces) - 1:
                payload = self._close()
                if payload is not None:
                    payloads.append(payload)
        return payloads

    def reset(self) -> None:
        """Forget an unfinished frame."""
        self._pending.clear()
        self._is_overlong = False

    def _close(self) -> bytes | None:
        """Return the payload of the frame that ends here, if it is whole."""
        encoded = bytes(self._pending)
        was_overlong = self._is_overlong
        self.reset()
        if not encoded and not was_overlong:
            return None
        try:
            data = b"" if was_overlong else cobs_decode(encoded)
        except HubProtocolError:
            data = b""
        payload = data[: -_CRC.size]
        if not payload or _CRC.pack(zlib.crc32(payload)) != data[-_CRC.size :]:
            self.n_bad += 1
            return None
        self.n_good += 1
        return payload
