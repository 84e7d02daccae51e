"""What the stamps of well-known camera drivers mean, as parameter files that one key chooses.

``camera.driver`` names a packaged file below ``config/cameras``, which holds for every key that is not given itself.
The same files may be given to a node with ``--params-file``.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path

from beam_ros.errors import ParameterFileError, suggestion
from beam_ros.interfaces.parameter import Value
from beam_ros.interfaces.parameter_files import packaged_rig_file, parameters_in_file


@cache
def camera_drivers() -> Mapping[str, Path]:
    """Return the packaged files of camera drivers by their names."""
    folder = packaged_rig_file().with_name("cameras")
    return {path.stem: path for path in sorted(folder.glob("*.yaml"))}


def with_driver(changes: Mapping[str, Value]) -> dict[str, Value]:
    """Return dotted names and values with what a camera's driver among them gives beside them.

    Raises
    ------
    ParameterFileError
        No such driver is known.
    """
    driver = str(changes.get("camera.driver", ""))
    if not driver:
        return dict(changes)
    known = camera_drivers()
    if driver not in known:
        raise ParameterFileError(
            f"camera.driver is {driver!r} ({suggestion(driver, known)}): leave it empty, and set camera.stamp and "
            "camera.clock_tolerance to what your driver does"
        )
    return {**parameters_in_file(known[driver]), **changes}
