"""Memory for large messages, kept by the process instead of given back after each.

By default the C library returns a freed buffer of megabytes to the kernel, and the next frame's buffer is fetched
anew: page by page, each cleared first. For frames of 2 MB that costs more than receiving them.
"""

from __future__ import annotations

import ctypes

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
_KEPT_BYTES = 256 * 2**20
_LARGEST_ON_HEAP_BYTES = 32 * 2**20
"""The most that glibc accepts for its threshold."""


def keep_freed_memory() -> None:
    """Let this process keep up to 256 MB of freed memory; without effect where the C library is not glibc."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_M_MMAP_THRESHOLD, _LARGEST_ON_HEAP_BYTES)
        mallopt(_M_TRIM_THRESHOLD, _KEPT_BYTES)
