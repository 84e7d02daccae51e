"""What can be wrong with a file of measurements."""

from pathlib import Path

from beam_ros.errors import RigError


class ColumnFileError(RigError, ValueError):
    """A file of columns cannot be read, or does not hold measurements; the message names the place."""


def unreadable_here(path: Path, kind: str, reader: str, instead: str) -> ColumnFileError:
    """Return the error of a file of such a ``kind`` whose reader is not installed; ``instead``: what else helps."""
    return ColumnFileError(
        f"{path}: is {kind}, which {reader} reads; install this package with its `files` extra, or {instead}"
    )
