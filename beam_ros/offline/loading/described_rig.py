"""What a bag says of the rig it was recorded on, and the modes that theory gives that rig."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from beam_model import BeamModel
from beam_ros.arrays import FloatArray
from beam_ros.errors import ParameterFileError, UsageError
from beam_ros.interfaces.parameter_files import in_present_words
from beam_ros.process.remote_paths import AnyPath
from beam_ros.rig.rig import Rig


def described_rig(path: AnyPath, info: Mapping[str, Any]) -> Rig:
    """Build the rig that a bag's ``excitation/info`` describes.

    Parameters
    ----------
    path : Path -- the bag, for the message
    info : mapping -- the content of ``excitation/info``; empty where there is none

    Raises
    ------
    UsageError
        It describes none, or one that this version does not know.
    """
    if "rig" not in info:
        raise UsageError(
            f"{path}: has no excitation/info that describes its rig; give the rig file it was recorded "
            "with (--rig-file)"
        )
    try:
        return Rig.from_nested(in_present_words(info["rig"]))
    except (ParameterFileError, AttributeError) as err:
        raise UsageError(
            f"{path}: its excitation/info describes a rig that this version does not read ({err}); give the "
            "rig file it was recorded with (--rig-file)"
        ) from err


def theoretical_modes(rig: Rig, structure: str) -> tuple[FloatArray, FloatArray]:
    """Return natural frequencies [rad/s] and damping ratios of the poles that a structure identifies."""
    model: BeamModel = rig.beam_model()
    if structure == "force":
        return model.free_hub_natural_frequencies, model.free_hub_damping_ratios
    return model.natural_frequencies, model.damping_ratios
