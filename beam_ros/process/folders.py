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


def new_folder(path: Path, overwrite: bool) -> Path:
    """Make a folder for results where nothing is lost by it.

    Parameters
    ----------
    path : Path
    overwrite : bool -- whether results that are there may be written over

    Raises
    ------
    UsageError
        There is something at the path, or no folder can be made there.
    """
    if not overwrite and path.exists() and (not path.is_dir() or any(path.iterdir())):
        raise UsageError(f"{path} exists and is not an empty folder; give another path, or --overwrite")
    return make_folder(path)
