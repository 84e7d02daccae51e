"""How an MP4 or QuickTime film wants to be shown: turned by a quarter, upside down, or mirrored.

A telephone held upright stores pictures that lie on their side, and one that films with its front camera mirrored
ones; the matrix of the track header says so (ISO/IEC 14496-12, 8.3.2). A picture that is turned the wrong way has its
hub moving along the beam, and one that is mirrored moving backwards.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import BinaryIO

from beam_ros.arrays import ImageArray

Matrix = tuple[tuple[int, int], tuple[int, int]]
"""(a, b), (c, d): a pixel at (x, y) is shown at (a x + c y, b x + d y), each of them -1, 0 or 1."""

_UPRIGHT: Matrix = ((1, 0), (0, 1))
_CONTAINERS = frozenset({b"moov", b"trak"})
_FIXED_POINT = 65536


def display_matrix(path: Path) -> Matrix | None:
    """Read how a film wants to be shown.

    Parameters
    ----------
    path : Path -- any video file

    Returns
    -------
    ((a, b), (c, d)) or None -- None: as it is stored, or the file is of another kind
    """
    try:
        with path.open("rb") as file:
            size = path.stat().st_size
            file.seek(4)
            if file.read(4) != b"ftyp":
                return None
            return _search(file, 0, size)
    except (OSError, struct.error):
        return None


def _search(file: BinaryIO, start: int, end: int) -> Matrix | None:
    """First matrix of a visible track that is not upright, between two places of the file."""
    at = start
    while at + 8 <= end:
        file.seek(at)
        size, kind = struct.unpack(">I4s", file.read(8))
        header = 8
        if size == 1:
            (size,) = struct.unpack(">Q", file.read(8))
            header = 16
        if size < header:
            break
        if kind in _CONTAINERS:
            found = _search(file, at + header, min(at + size, end))
            if found is not None:
                return found
        elif kind == b"tkhd":
            found = _of_track(file.read(size - header))
            if found is not None:
                return found
        at += size
    return None


def _of_track(header: bytes) -> Matrix | None:
    place = 52 if header[0] == 1 else 40
    a, b, _, c, d = struct.unpack_from(">5i", header, place)
    if struct.unpack_from(">2I", header, place + 36) == (0, 0):
        # A track without a picture: sound.
        return None
    signs = tuple((value > _FIXED_POINT // 2) - (value < -_FIXED_POINT // 2) for value in (a, b, c, d))
    matrix: Matrix = ((signs[0], signs[1]), (signs[2], signs[3]))
    is_whole = abs(signs[0] * signs[3] - signs[1] * signs[2]) == 1 and sum(map(abs, signs)) == 2
    return matrix if is_whole and matrix != _UPRIGHT else None


def upright(image: ImageArray, matrix: Matrix) -> ImageArray:
    """Turn and mirror a picture as its film wants to be shown.

    Parameters
    ----------
    image : ndarray, shape (height, width)
    matrix : ((a, b), (c, d)) -- from ``display_matrix``

    Returns
    -------
    ndarray -- of shape (width, height) where it is turned by a quarter
    """
    (a, b), (c, d) = matrix
    shown = image if b == 0 else image.T
    across, down = (a, d) if b == 0 else (c, b)
    return shown[:: -1 if down < 0 else 1, :: -1 if across < 0 else 1]
