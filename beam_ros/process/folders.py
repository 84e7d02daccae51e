"""Folders for results: made before the work that fills them, so that a wrong path costs nobody a long run."""

from __future__ import annotations

from pathlib import Path

from beam_ros.errors import UsageError


def make_folder(path: Path) -> Path:
    """Make a folder for results, or use the one that is there.

    Raises
    ------
    UsageError
        It cannot be made or written to.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        probe = path / ".beam-writable"
        probe.touch()
        probe.unlink()
    except OSError as err:
        raise UsageError(
            f"{path}: no folder for results can be made there ({err.strerror or err}); give a path in a folder that "
            "you may write to"
        ) from err
    return path
