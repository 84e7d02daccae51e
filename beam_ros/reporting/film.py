"""A bag's frames as a film, with the model's prediction drawn over the markers."""

from __future__ import annotations

from collections.abc import Callable
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from beam_ident.figures.identification import Fitted
from beam_ident.report.evidence import fitted_outputs
from beam_ros.arrays import ImageArray
from beam_ros.bags.reading import Bag
from beam_ros.errors import RigUnavailableError
from beam_ros.offline.identification_summary import IdentificationOutcome
from beam_ros.offline.loading.experiment import IMAGES
from beam_ros.rig.rig import Rig

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
    n_frames = min(experiment.n_images, _MAX_FRAMES)
    if experiment.rig is None or not n_frames or not outputs:
        return ""
    try:  # here: few bags have images
        from beam_ros.vision.camera.image_messages import read_image
    except ImportError:
        return ""
    with Bag(experiment.path) as bag:
        step_s = float(np.median(np.diff(outputs[0].times_s)))
        rate = min(_SHOWN_RATE, 1.0 / step_s)
        predicted = _Predicted(experiment.rig, outputs, step_s)
        writer: Any = None
        try:
            for number, message in enumerate(islice(bag.raw_messages(IMAGES), n_frames), 1):
                image = read_image(message.data)
                frame = predicted.over(image.grey(), (image.stamp_ns - experiment.record.start_ns) * 1e-9)
                writer = writer or _writer(path, rate, (frame.shape[1], frame.shape[0]))
                writer.write(frame)
                progress("drawing the film", number / n_frames)
        finally:
            if writer is not None:
                writer.release()
    if not predicted.drawn:
        return ""
    slower = 1.0 / (step_s * rate)
    slowed = f", {slower:.3g} times slower than it was" if slower > 1.05 else ""
    return f"The first {n_frames} frames{slowed}: crosses mark where the model says that the markers are."


class _Predicted:
    """Draws over frames where the model says that the markers are.

    Attributes
    ----------
    drawn : int -- crosses so far
    """

    def __init__(self, rig: Rig, outputs: Fitted, step_s: float) -> None:
        heights = dict(zip(rig.markers.names, rig.markers.heights, strict=True))
        self._camera = rig.camera_parameters()
        self._rows = [(own, heights[own.name]) for own in outputs if own.name in heights]
        self._near_s = _NEAR * step_s
        self.drawn = 0

    def over(self, grey: ImageArray, at_s: float) -> ImageArray:
        """Return a frame that was taken at a time of the record, in colour, with a cross at every marker."""
        import cv2

        frame: ImageArray = cv2.cvtColor(_eight_bits(grey), cv2.COLOR_GRAY2BGR)
        for output, height in self._rows:
            nearest = int(np.argmin(np.abs(output.times_s - at_s)))
            if abs(output.times_s[nearest] - at_s) > self._near_s:
                continue
            said = float(output.measured[nearest] - output.residuals[nearest])
            place = round(float(self._camera.columns(said))), round(float(self._camera.rows(height)))
            cv2.drawMarker(frame, place, _COLOUR, cv2.MARKER_CROSS, 15, 1, cv2.LINE_AA)
            self.drawn += 1
        if grey.shape[1] >= _WIDE:
            corner = (8, grey.shape[0] - 10)
            cv2.putText(frame, f"{at_s:.3f} s", corner, cv2.FONT_HERSHEY_SIMPLEX, 0.5, _COLOUR, 1)
        return frame


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
