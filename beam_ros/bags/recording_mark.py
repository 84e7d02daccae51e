"""The mark that tells a bag in the making, or one that was cut off, from a finished one.

While a bag is written, its folder holds a file ``RECORDING`` that says who writes since when. The writer keeps
it locked; the lock goes with the process, however it ends, so that a reader can tell a running recording from
one that was killed.
"""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from typing import IO

from beam_ros.process.strict_json import strict_json

try:
    import fcntl
except ImportError:  # Windows has no flock: there every mark looks as if its writer had gone.
    fcntl = None  # type: ignore[assignment]

MARK_NAME = "RECORDING"


class RecordingMark:
    """The mark in a bag's folder, held while the bag is written.

    Parameters
    ----------
    folder : Path -- the bag's folder, which exists
    file_name : str -- the file that is written
    """

    def __init__(self, folder: Path, file_name: str) -> None:
        self._path = folder / MARK_NAME
        self._file: IO[str] = self._path.open("x", encoding="utf-8")
        if fcntl is not None:
            with contextlib.suppress(OSError):  # a file system without locks: the mark alone must do
                fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        note = "this bag is being written, or its recording was cut off; `beam recover` repairs it"
        self._file.write(strict_json({"writer_pid": os.getpid(), "file": file_name, "note": note}))
        self._file.flush()

    def lift(self) -> None:
        """Remove the mark: the bag is whole."""
        self._file.close()
        self._path.unlink()

    def leave(self) -> None:
        """Let go of the mark and leave it where it is: the bag is not whole."""
        self._file.close()


def is_marked(folder: Path) -> bool:
    """Whether a bag's folder carries the mark."""
    return (folder / MARK_NAME).is_file()


def is_being_written(folder: Path) -> bool:
    """Whether the process that marked a bag's folder still writes it."""
    if fcntl is None or not is_marked(folder):
        return False
    with (folder / MARK_NAME).open("r", encoding="utf-8") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except OSError:
            return True
    return False
