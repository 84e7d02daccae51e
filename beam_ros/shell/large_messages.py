"""Memory for messages of megabytes: kept by the process that receives them, shared by the one that sends them.

By default the C library returns a freed buffer of megabytes to the kernel, and the next frame's buffer is fetched
anew: page by page, each cleared first. For frames of 2 MB that costs more than receiving them.

By default Fast DDS has 512 kB of shared memory for all that a process sends. Of a larger message parts are dropped as
soon as the receiver is a little late, and a reliable topic sends them again 10 ms later. The packaged profile gives a
sender 32 MB beside the transports that it has anyway. Such a segment is in use for as long as its owner holds a lock;
a killed owner leaves both behind in /dev/shm, and the next sender takes them away.
"""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import os
import re
import shutil
import time
from collections.abc import MutableMapping
from pathlib import Path
from xml.etree import ElementTree

PROFILE = Path(__file__).parents[1] / "config" / "large_messages.xml"
PROFILE_VARIABLE = "FASTRTPS_DEFAULT_PROFILES_FILE"
"""What Fast DDS 2 reads; FASTDDS_DEFAULT_PROFILES_FILE is for Fast DDS 3 and without effect in ROS 2 Jazzy."""
SHARED_MEMORY = Path("/dev/shm")

_CHOICES_OF_THE_USER = (PROFILE_VARIABLE, "FASTDDS_DEFAULT_PROFILES_FILE", "FASTDDS_BUILTIN_TRANSPORTS")
_MIN_FREE_SEGMENTS = 4
_NEWBORN_S = 60.0
_LOCK_OF_SEGMENT = re.compile(r"(fastrtps_[0-9a-f]{16})_el")

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
_KEPT_BYTES = 256 * 2**20
_MAX_ON_HEAP_BYTES = 32 * 2**20
"""The most that glibc accepts for its threshold."""


def keep_freed_memory() -> None:
    """Let this process keep up to 256 MB of freed memory; without effect where the C library is not glibc."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_M_MMAP_THRESHOLD, _MAX_ON_HEAP_BYTES)
        mallopt(_M_TRIM_THRESHOLD, _KEPT_BYTES)


def widen_shared_memory(environ: MutableMapping[str, str], folder: Path = SHARED_MEMORY) -> None:
    """Give what this process will send room for several frames in shared memory; call it before ``rclpy.init``.

    Nothing changes where the environment already chooses a profile or transports, or where the machine has little
    shared memory, as a container has.

    Parameters
    ----------
    environ : mutable mapping -- ``os.environ``
    folder : Path -- where the kernel shows shared memory
    """
    size = segment_bytes()
    remove_orphans(size, folder)
    if any(environ.get(name) for name in _CHOICES_OF_THE_USER):
        return
    if not folder.is_dir() or shutil.disk_usage(folder).free < _MIN_FREE_SEGMENTS * size:
        return
    environ[PROFILE_VARIABLE] = str(PROFILE)


def segment_bytes() -> int:
    """Size of a sender's shared memory in the packaged profile [bytes]."""
    size = ElementTree.parse(PROFILE).findtext(".//{*}segment_size")
    if size is None:
        raise ValueError(f"{PROFILE} has no segment_size; expected the shared memory of a sender in bytes")
    return int(size)


def remove_orphans(least_bytes: int, folder: Path = SHARED_MEMORY) -> list[str]:
    """Take away the large segments of this user whose owner was killed.

    Parameters
    ----------
    least_bytes : int -- smaller segments stay
    folder : Path -- where the kernel shows shared memory

    Returns
    -------
    list of str -- names of the segments

    Notes
    -----
    An owner makes the lock's file, locks it, and makes the segment. So a lock that can be had belongs to a process
    that is gone, or to one that has made its file this instant: young files are not touched.
    """
    removed = []
    for lock in sorted(folder.glob("fastrtps_*_el")):
        found = _LOCK_OF_SEGMENT.fullmatch(lock.name)
        if found is None:
            continue
        segment = folder / found[1]
        # Another process may clean up at the same time, and other users' files are not ours.
        with contextlib.suppress(OSError):
            is_newborn = time.time() - lock.stat().st_mtime < _NEWBORN_S
            if is_newborn or segment.stat().st_uid != os.getuid() or segment.stat().st_size < least_bytes:
                continue
            with lock.open("rb") as stream:
                fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
                segment.unlink()
                lock.unlink()
            removed.append(segment.name)
    return removed
