"""The one table of formats that models are written in: a new one is a module with a writer, and a row here.

A writer returns the whole file and opens none: so nothing is written over, and a file appears whole or not at all.
"""

from __future__ import annotations

import contextlib
import importlib
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from beam_ros.errors import UsageError

if TYPE_CHECKING:
    from beam_ros.model_files.exported_model import ExportedModel
    from beam_ros.rig.rig import Rig


@dataclass(frozen=True)
class WriteRequest:
    """What a writer is given.

    Attributes
    ----------
    model : ExportedModel
    rig : Rig -- whose axis carries the beam, for formats of mechanisms
    target : Path -- the file that will be; its name without suffix names the model inside
    model_file : Path -- that the model comes from
    """

    model: ExportedModel
    rig: Rig
    target: Path
    model_file: Path


Writer = Callable[[WriteRequest], bytes]

MOTIONS = ("acceleration", "velocity", "base_motion")
"""What a moved base may be driven by; the first needs no differentiation."""


@dataclass(frozen=True)
class ModelFormat:
    """A format of models.

    Attributes
    ----------
    flag : str -- of ``beam export --model``
    meaning : str -- in a line of its help
    metavar : str
    module, writer : str -- the function that makes the file, and where it stands
    """

    flag: str
    meaning: str
    metavar: str
    module: str
    writer: str


FORMATS = (
    ModelFormat(
        "mat", "MATLAB file: A, B, C, D, num, den, covariances, names, units", "FILE.mat", "mat", "mat_file"
    ),
    ModelFormat(
        "uff", "universal file: mode shapes (55), responses (58)", "FILE.uff", "universal", "universal_file"
    ),
    ModelFormat(
        "fmu", "FMU 3.0, co-simulation and model exchange, C source inside", "FILE.fmu", "fmu", "fmu_file"
    ),
    ModelFormat("modelica", "Modelica model", "FILE.mo", "modelica", "modelica_file"),
    ModelFormat("urdf", "axis and modes as links and joints", "FILE.urdf", "mechanism", "urdf_file"),
    ModelFormat("mjcf", "axis and modes for MuJoCo", "FILE.xml", "mechanism", "mjcf_file"),
    ModelFormat("klipper", "lines for Klipper's input shaper", "FILE.cfg", "shapers", "klipper_file"),
    ModelFormat("marlin", "line for Marlin's input shaper", "FILE.gcode", "shapers", "marlin_file"),
    ModelFormat(
        "ros2-filter",
        "notches for ros2_controllers' filter chain",
        "FILE.yaml",
        "filter_chain",
        "filter_chain_file",
    ),
    ModelFormat(
        "ro-crate", "ro-crate-metadata.json, for the folder of a report", "DIR", "ro_crate", "ro_crate_file"
    ),
)
"""Formats in the order in which they are listed for people, and written: the crate lists the others beside it."""

CRATE_NAME = "ro-crate-metadata.json"
"""What the metadata of an RO-Crate are called in its folder."""


def target_of(own: ModelFormat, given: Path) -> Path:
    """Return the file that a format writes; refuse one that is there.

    Raises
    ------
    UsageError
        Something is at the path, or its folder is not there.
    """
    target = given / CRATE_NAME if own.flag == "ro-crate" else given
    if target.exists() or target.is_symlink():
        raise UsageError(f"--{own.flag} {target}: exists and is not written over; give another path")
    if not target.parent.is_dir():
        raise UsageError(f"--{own.flag} {target}: there is no folder {target.parent}; make it first")
    return target


def make_file(own: ModelFormat, request: WriteRequest) -> bytes:
    """Return the file of a format.

    Raises
    ------
    UsageError
        The format cannot hold the model, or a library that writes it is missing.
    """
    writer: Writer = getattr(importlib.import_module(f"beam_ros.model_files.{own.module}"), own.writer)
    return writer(request)


def write_new(target: Path, content: bytes) -> None:
    """Write a file that appears whole or not at all, and never over another.

    Raises
    ------
    UsageError
        Something is at the path meanwhile, or the disk refuses.
    """
    partial = target.with_name(f".{target.name}.partial")
    try:
        partial.write_bytes(content)
        os.link(partial, target)
    except FileExistsError as err:
        raise UsageError(f"{target}: exists and is not written over; give another path") from err
    except OSError as err:
        raise UsageError(
            f"{target}: cannot be written ({err.strerror}); give a path that you may write to"
        ) from err
    finally:
        with contextlib.suppress(OSError):
            partial.unlink()
