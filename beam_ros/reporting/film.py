"""A bag's frames as a film, with the model's prediction drawn over the markers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from beam_ident.report.evidence import fitted_outputs
from beam_ros.arrays import ImageArray
from beam_ros.bags.reading import Bag
from beam_ros.errors import RigUnavailableError
from beam_ros.files.formats import is_column_file
from beam_ros.offline.identification_summary import IdentificationOutcome

IMAGES = "camera/image_raw"
_MAX_FRAMES = 1500
_SHOWN_RATE = 25.0  # frames a second that a person follows
_WIDE = 200  # pixels from which the time stands in a corner
_NEAR = 0.6  # of the time between two samples
_COLOUR = (60, 110, 255)  # blue, green, red
_CODECS = ("vp09", "mp4v")  # the first is what browsers show


def write_film(
    outcome: IdentificationOutcome,
    path: Path,
    progress: Callable[[str, float], None] = lambda phrase, share: None,
) -> str:
    """Write the film of the first experiment; nothing where its bag has no images.

    Parameters
    ----------
    outcome : IdentificationOutcome
    path : Path -- of the film, .mp4
    progress : callable -- called with a phrase and the share done

    Returns
    -------
    str
        What it shows, in a sentence; empty where there is no film.

    Raises
    ------
    RigUnavailableError
        OpenCV has no encoder for a film.
    """
    experiment = outcome.experiment
    outputs = fitted_outputs(outcome.result, experiment.record)
    try:
        import cv2

        from beam_ros.vision.camera.image_messages import read_image
    except ImportError:
        return ""
    if experiment.rig is None or is_column_file(experiment.path):
        return ""
    with Bag(experiment.path) as bag:
        n_frames = min(bag.count(IMAGES), _MAX_FRAMES)
        if not n_frames or not outputs:
            return ""
        camera = experiment.rig.camera_parameters()
        heights = dict(zip(experiment.rig.markers.names, experiment.rig.markers.heights, strict=True))
        step_s = float(np.median(np.diff(outputs[0].times_s)))
        rate = min(_SHOWN_RATE, 1.0 / step_s)
        writer: Any = None
        drawn = 0
        try:
            for number, message in enumerate(bag.raw_messages(IMAGES)):
                if number >= n_frames:
                    break
                image = read_image(message.data)
                grey = image.grey()
                frame = cv2.cvtColor(_eight_bits(grey), cv2.COLOR_GRAY2BGR)
                at_s = (image.stamp_ns - experiment.record.start_ns) * 1e-9
                for output in outputs:
                    nearest = int(np.argmin(np.abs(output.times_s - at_s)))
                    if abs(output.times_s[nearest] - at_s) > _NEAR * step_s or output.name not in heights:
                        continue
                    said = float(output.measured[nearest] - output.residuals[nearest])
                    place = (
                        round(float(camera.columns(said))),
                        round(float(camera.rows(heights[output.name]))),
                    )
                    cv2.drawMarker(frame, place, _COLOUR, cv2.MARKER_CROSS, 15, 1, cv2.LINE_AA)
                    drawn += 1
                if grey.shape[1] >= _WIDE:
                    corner = (8, grey.shape[0] - 10)
                    cv2.putText(frame, f"{at_s:.3f} s", corner, cv2.FONT_HERSHEY_SIMPLEX, 0.5, _COLOUR, 1)
                if writer is None:
                    writer = _writer(path, rate, (grey.shape[1], grey.shape[0]))
                writer.write(frame)
                progress("drawing the film", (number + 1) / n_frames)
        finally:
            if writer is not None:
                writer.release()
    slower = 1.0 / (step_s * rate)
    slowed = f", {slower:.3g} times slower than it was" if slower > 1.05 else ""
    return (
        f"The first {n_frames} frames{slowed}: crosses mark where the model says that the markers are."
        if drawn
        else ""
    )


def _eight_bits(grey: ImageArray) -> ImageArray:
    return grey if grey.dtype == np.uint8 else (grey >> 8).astype(np.uint8)


def _writer(path: Path, rate: float, size: tuple[int, int]) -> Any:
    import cv2

    for codec in _CODECS:
        writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*codec), rate, size)
        if writer.isOpened():
            return writer
    raise RigUnavailableError(
        f"{path}: OpenCV here encodes none of {', '.join(_CODECS)}; install opencv-python-headless, whose wheel does"
    )
