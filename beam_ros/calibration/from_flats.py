"""The camera's noise from videos, folders of pictures, or bags of scenes at rest."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2

from beam_ros.arrays import ImageArray
from beam_ros.bags.reading import Bag
from beam_ros.vision.calibration.camera_noise import CameraNoise, Series, photon_transfer
from beam_ros.vision.camera.image_messages import read_image
from beam_ros.vision.camera.images import grey_frame
from beam_ros.vision.camera.video import VideoFile
from beam_ros.vision.errors import CalibrationError

_IMAGES = "camera/image_raw"
_PICTURES = (".png", ".tif", ".tiff", ".bmp", ".pgm", ".jpg", ".jpeg")


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
    series = [Series.of(_frames(path), str(path)) for path in sources]
    return photon_transfer(series, None if dark is None else Series.of(_frames(dark), str(dark)))


def _frames(path: Path) -> Iterator[ImageArray]:
    """Read the frames of a source."""
    if path.is_dir():
        pictures = sorted(file for file in path.iterdir() if file.suffix.lower() in _PICTURES)
        if pictures:
            for picture in pictures:
                image = cv2.imread(str(picture), cv2.IMREAD_UNCHANGED)
                if image is None:
                    raise CalibrationError(
                        f"{picture}: is no picture; expected one: take it out of the folder"
                    )
                yield grey_frame(image)
            return
    if path.is_dir() or path.suffix in (".mcap", ".db3"):
        with Bag(path) as bag:
            if not bag.count(_IMAGES):
                raise CalibrationError(
                    f"{path}: holds no frames on {_IMAGES}; expected a bag recorded with the camera's topic"
                )
            for message in bag.raw_messages(_IMAGES):
                yield read_image(message.data).grey()
        return
    for _, image in VideoFile(path).frames():
        yield image


def save_parameters(noise: CameraNoise, path: Path, date: str) -> None:
    """Write the tracker's two noise parameters as a parameter file, the rest as its comments.

    Raises
    ------
    CalibrationError
        The file cannot be written.
    """
    figures = "".join(f"# {name}: {value}\n" for name, value in noise.to_dict().items())
    text = (
        f"# The camera's noise by photon transfer, {date}\n{figures}/**:\n  ros__parameters:\n    tracker:\n"
        f"      noise_variance: {noise.variance:.6g}\n      noise_per_grey: {noise.per_grey:.6g}\n"
    )
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as err:
        raise CalibrationError(
            f"{path}: cannot be written ({err.strerror}); give --save a path that can"
        ) from err
