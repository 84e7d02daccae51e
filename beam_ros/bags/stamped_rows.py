"""Many messages that differ by their stamp and some numbers alone, made by filling in one prepared message."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from beam_ros.arrays import FloatArray, StampArray
from beam_ros.messages import SECOND_NS

_STAMP = slice(4, 12)  # behind the encapsulation, in messages whose first field is a header


class StampedRows:
    """CDR bytes of a message for any stamp and any numbers in one of its arrays.

    Parameters
    ----------
    template : bytes -- little-endian CDR of the message, which begins with a header
    n_values : int -- numbers that are filled in, as doubles
    bytes_behind : int -- what comes behind the last of them
    """

    def __init__(self, template: bytes, n_values: int, bytes_behind: int) -> None:
        end = len(template) - bytes_behind
        self._head = template[: _STAMP.start]
        self._middle = template[_STAMP.stop : end - 8 * n_values]
        self._tail = template[end:]

    def rows(self, stamps_ns: StampArray, values: FloatArray) -> Iterator[bytes]:
        """Yield the messages.

        Parameters
        ----------
        stamps_ns : ndarray of int64, shape (n,) -- [ns, UNIX]
        values : ndarray, shape (n, n_values)
        """
        times = np.column_stack(np.divmod(stamps_ns, SECOND_NS)).astype("<u4")
        numbers = np.ascontiguousarray(values, dtype="<f8")
        for stamp, row in zip(times, numbers, strict=True):
            yield b"".join((self._head, stamp.tobytes(), self._middle, row.tobytes(), self._tail))
