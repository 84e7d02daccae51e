"""Frames to calibrate from: a picture, a folder of pictures, a video, or a bag with the camera's topic."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2

from beam_ros.arrays import ImageArray
from beam_ros.bags.errors import NotABagError
from beam_ros.bags.reading import Bag
from beam_ros.vision.camera.image_messages import read_image
from beam_ros.vision.camera.images import grey_frame
from beam_ros.vision.camera.video import VideoFile
from beam_ros.vision.errors import CalibrationError, VideoError

_IMAGES = "camera/image_raw"
_PICTURES = (".png", ".tif", ".tiff", ".bmp", ".pgm", ".jpg", ".jpeg")
_BAGS = (".mcap", ".db3")
_ANY_RATE_HZ = 1.0
"""Nobody asks when these frames were taken, and a file may not say it."""


def frames_of(path: Path) -> Iterator[ImageArray]:
    """Read the frames of a source, in grey.

    Parameters
    ----------
    path : Path -- a picture, a folder of pictures (in the order of their names), a video, or a bag with
        ``camera/image_raw``

    Yields
    ------
    ndarray, shape (height, width), uint8 or uint16

    Raises
    ------
    CalibrationError
        A picture cannot be read, a folder holds neither pictures nor a bag, or a bag holds no frames.
    VideoError
        The file is neither a picture nor a video.
    """
    if path.is_dir():
        pictures = sorted(file for file in path.iterdir() if file.suffix.lower() in _PICTURES)
        yield from (_picture(file) for file in pictures) if pictures else _of_bag(path)
    elif path.suffix.lower() in _BAGS:
        yield from _of_bag(path)
    elif not path.is_file():
        raise VideoError(f"{path}: no such picture or video; check the path")
    elif path.suffix.lower() in _PICTURES:
        yield _picture(path)
    else:
        yield from (image for _, image in VideoFile(path, rate_hz=_ANY_RATE_HZ).frames())


def _picture(path: Path) -> ImageArray:
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if image is None:
        size = path.stat().st_size
        raise CalibrationError(
            f"{path}: is not a picture that OpenCV can read ({size} bytes); expected a whole one: copy it again, or "
            "leave it out"
        )
    return grey_frame(image)


def _of_bag(path: Path) -> Iterator[ImageArray]:
    try:
        opened = Bag(path)
    except NotABagError as err:
        if not path.is_dir():
            raise
        raise CalibrationError(
            f"{path}: is a folder without pictures ({', '.join(_PICTURES)}), and without a bag; expected either: "
            "check the path, or give the files themselves"
        ) from err
    with opened as bag:
        if not bag.count(_IMAGES):
            raise CalibrationError(
                f"{path}: holds no frames on {_IMAGES}; expected a bag recorded with the camera's topic"
            )
        for message in bag.raw_messages(_IMAGES):
            yield read_image(message.data).grey()


def some_frames(path: Path, count: int) -> list[ImageArray]:
    """Read frames of a source, evenly over its length.

    Parameters
    ----------
    path : Path -- as of ``frames_of``
    count : int -- at least this many, and fewer than twice as many, where the source has them

    Raises
    ------
    CalibrationError, VideoError
        As of ``frames_of``.
    """
    kept: list[ImageArray] = []
    step = 1
    for k, image in enumerate(frames_of(path)):
        if k % step:
            continue
        kept.append(image)
        if len(kept) == 2 * count:
            kept, step = kept[::2], 2 * step
    return kept
