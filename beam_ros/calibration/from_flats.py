"""The camera's noise from videos, folders of pictures, or bags of scenes at rest."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from beam_ident.report.page import write_whole
from beam_ros.calibration.pictures import frames_of
from beam_ros.vision.calibration.camera_noise import CameraNoise, Series, photon_transfer
from beam_ros.vision.errors import CalibrationError


def noise_from_flats(sources: Sequence[Path], dark: Path | None) -> CameraNoise:
    """Measure a camera's noise.

    Parameters
    ----------
    sources : sequence of Path -- each a video, a folder of pictures or a bag with ``camera/image_raw``, of a scene at
        rest
    dark : Path or None -- the same without light

    Raises
    ------
    CalibrationError
        A source holds no frames, or the series do not show how noise grows with light.
    """
    series = [Series.of(frames_of(path), str(path)) for path in sources]
    return photon_transfer(series, None if dark is None else Series.of(frames_of(dark), str(dark)))


def save_parameters(noise: CameraNoise, path: Path, circumstances: Mapping[str, Any]) -> None:
    """Write the tracker's two noise parameters as a parameter file, the rest as its comments.

    Raises
    ------
    CalibrationError
        The file cannot be written.
    """
    figures = "".join(f"# {name}: {value}\n" for name, value in {**circumstances, **noise.to_dict()}.items())
    text = (
        f"# The camera's noise by photon transfer\n{figures}/**:\n  ros__parameters:\n    tracker:\n"
        f"      noise_variance: {noise.variance:.6g}\n      noise_per_grey: {noise.per_grey:.6g}\n"
    )
    try:
        write_whole(path, text)
    except OSError as err:
        raise CalibrationError(
            f"{path}: cannot be written ({err.strerror}); give --save a path that can"
        ) from err
