"""A folder in which one process is at work, and no other.

The lock is one of the operating system on a file in the folder, which says who works there since when. It goes with
the process, however that ends: the file of a process that was killed is taken over, and holds nobody up.
"""

from __future__ import annotations

import contextlib
import json
import os
import platform
import sys
from datetime import datetime, timezone
from pathlib import Path
from typing import IO

from beam_ros.errors import UsageError
from beam_ros.process.strict_json import strict_json

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl

LOCK_NAME = ".lock"

_FAR = 1 << 30
"""Which byte Windows locks: one that is not there, so that others can read who works [bytes]."""


class FolderLock:
    """Holds a folder until ``release``; a context manager.

    Parameters
    ----------
    folder : Path -- exists

    Raises
    ------
    UsageError
        Another process works in the folder, or no file can be made there.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / LOCK_NAME
        try:
            self._file = self._take(folder)
        except OSError as err:
            raise UsageError(
                f"{folder}: no lock can be made there ({err.strerror or err}); give a path in a folder that you may "
                "write to"
            ) from err

    def _take(self, folder: Path) -> IO[str]:
        while True:
            file = self._path.open("a+", encoding="utf-8")
            if not _lock(file):
                file.seek(0)
                said = file.read()
                file.close()
                raise UsageError(
                    f"{folder}: {_owner(said)} is at work there: expected a folder of its own for every process; "
                    "wait for it, end it, or give another --out"
                )
            with contextlib.suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(file.fileno()), self._path.stat()):
                    break
            file.close()  # The last owner took it away between these lines; somebody else may have a new one.
        file.truncate(0)
        since = datetime.now(timezone.utc).isoformat(timespec="seconds")
        file.write(strict_json({"pid": os.getpid(), "host": platform.node(), "since": since}))
        file.flush()
        return file

    def release(self) -> None:
        """Give the folder back; a second call does nothing."""
        if self._file.closed:
            return
        if sys.platform == "win32":  # An open file cannot be taken away there.
            self._file.close()
            with contextlib.suppress(OSError):
                self._path.unlink()
        else:
            self._path.unlink(missing_ok=True)
            self._file.close()

    def __enter__(self) -> FolderLock:
        return self

    def __exit__(self, *raised: object) -> None:
        self.release()


def _lock(file: IO[str]) -> bool:
    """Lock a file, and say whether that went: not where another process has."""
    try:
        if sys.platform == "win32":
            file.seek(_FAR)
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        else:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        return False
    except OSError:
        return True  # A file system without locks: there, nobody can be kept out.
    return True


def _owner(said: str) -> str:
    try:
        content = json.loads(said)
        return f"process {content['pid']} on {content['host']}, since {content['since']},"
    except (ValueError, KeyError, TypeError):
        return "another process"  # It has the lock, and has not yet said who it is.
