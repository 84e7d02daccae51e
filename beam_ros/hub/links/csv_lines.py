"""Lines of separated numbers, as a board prints them: bytes in, rows of numbers out, whatever noise is between.

A line is a row when all of its columns are finite numbers and it has as many as its like. The first line after the
port was opened may be the end of one, and is left out; a heading, a remark or a damaged line is counted and left out
too.
"""

from __future__ import annotations

import math

MAX_LINE = 1024
"""A line without an end that is longer is noise [bytes]."""
SEPARATORS = (",", ";", "\t", " ")


def split_row(line: bytes) -> tuple[float, ...] | None:
    """Return the numbers of a line, or None where it is no row of numbers."""
    try:
        text = line.decode("ascii").strip()
    except UnicodeDecodeError:
        return None
    for separator in SEPARATORS:
        if separator in text:
            words = text.split() if separator == " " else text.split(separator)
            break
    else:
        words = [text]
    try:
        values = tuple(float(word) for word in words)
    except ValueError:
        return None
    return values if values and all(map(math.isfinite, values)) else None


class CsvReader:
    """Cuts a stream of bytes into rows of numbers.

    Attributes
    ----------
    n_bad : int
        Lines that were no rows.
    bad_line : bytes
        The last of them.
    """

    def __init__(self) -> None:
        self.n_bad = 0
        self.bad_line = b""
        self._rest = b""
        self._is_whole = False
        self._count = 0

    def reset(self) -> None:
        """Forget what came before: the port was opened anew."""
        self._rest = b""
        self._is_whole = False

    def reject(self, line: bytes) -> None:
        """Count a line that says nothing."""
        self.n_bad += 1
        self.bad_line = line

    def feed(self, data: bytes) -> list[tuple[float, ...]]:
        """Take bytes; return the rows that they complete."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        if len(self._rest) > MAX_LINE:
            self.reject(self._rest)
            self._rest, self._is_whole = b"", False
        rows = []
        for line in lines:
            row = split_row(line) if self._is_whole and len(line) <= MAX_LINE else None
            if row is not None and self._count in (0, len(row)):
                self._count = len(row)
                rows.append(row)
            elif self._is_whole and line.strip():
                self.reject(line)
                # A heading or a first damaged row must not decide for ever how long a row is.
                self._count = 0 if row is not None else self._count
            self._is_whole = True
        return rows
