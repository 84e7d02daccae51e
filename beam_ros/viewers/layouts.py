"""The files for viewers as one table, and into a folder."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from beam_ros.errors import UsageError
from beam_ros.process.folders import make_folder
from beam_ros.viewers.foxglove import foxglove_layout
from beam_ros.viewers.plotjuggler import plotjuggler_layout
from beam_ros.viewers.ros_tools import qos_overrides, rviz_configuration

LAYOUTS: dict[str, Callable[[Sequence[str], str], str]] = {
    "plotjuggler.xml": plotjuggler_layout,
    "foxglove.json": foxglove_layout,
    "rig.rviz": rviz_configuration,
    "qos_overrides.yaml": qos_overrides,
}
"""What makes each file from the markers' names and the rig's namespace."""


def write_layouts(folder: Path, markers: Sequence[str], namespace: str = "") -> tuple[Path, ...]:
    """Write all files into a new folder.

    Parameters
    ----------
    folder : Path -- must not exist, or be empty
    markers : sequence of str -- names of the markers
    namespace : str -- of the rig; empty for none

    Returns
    -------
    tuple of Path -- the files

    Raises
    ------
    UsageError
        Something is in the folder, or it cannot be written.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise UsageError(f"{folder} exists and is not an empty folder: expected a new one; give another path")
    make_folder(folder)
    for name, layout in LAYOUTS.items():
        (folder / name).write_text(layout(markers, namespace.strip("/")), encoding="utf-8")
    return tuple(folder / name for name in LAYOUTS)
