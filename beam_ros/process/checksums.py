"""Checksums that say whether files are still what they were."""

from __future__ import annotations

import hashlib

from beam_ros.process.remote_paths import AnyPath

_BLOCK = 1 << 20
"""As much of a file is held at a time [bytes]."""


def checksum(*files: AnyPath) -> str:
    """Return the SHA-256 of a file, or of several as if they were one.

    Parameters
    ----------
    files : Path or RemotePath -- in this order

    Returns
    -------
    str -- 64 hexadecimal digits

    Raises
    ------
    OSError
        A file cannot be read.
    """
    digest = hashlib.sha256()
    for file in files:
        with file.open("rb") as stream:
            while block := stream.read(_BLOCK):
                digest.update(block)
    return digest.hexdigest()
