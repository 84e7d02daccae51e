"""Films with their truth, for people who want to try a tracker: theirs or ours.

The simulated rig does its experiment, a camera with the faults asked for films it, and beside the film lies what was
really there: the hub's bag, the time of every frame, and every marker's or point's column and displacement.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from beam_ident.report.page import write_whole
from beam_ros.arrays import ByteArray, FloatArray
from beam_ros.errors import UsageError
from beam_ros.excitation.recipes import recipe_of_rig
from beam_ros.messages import BagTypes
from beam_ros.offline.simulation import Measure, image_messages, simulate
from beam_ros.offline.whole_beam import point_names, strip_parameters
from beam_ros.process.strict_json import strict_json
from beam_ros.rig.filming import Exposure, Film
from beam_ros.rig.rig import Rig
from beam_ros.vision.camera.matroska import MatroskaWriter
from beam_ros.vision.errors import VideoError
from beam_ros.vision.parameters import CameraParameters
from beam_ros.vision.rendering.frames import SceneRenderer
from beam_ros.vision.rendering.imaging import CameraFaults, FaultyCamera
from beam_ros.vision.strip.moving_line import StripFollower
from beam_ros.vision.timing import exposure_weights

_STRIP_POINTS = 151
CONTAINERS = ("mkv", "avi")
"""With a time for every frame (Matroska, PNG), or without (AVI, FFV1)."""


@dataclass(frozen=True)
class FilmOrder:
    """What is to be filmed, beside the rig and its excitation.

    Attributes
    ----------
    faults : CameraFaults
    is_whole : bool -- the strip alone, without dots
    strip_contrast : float or None -- strip above ground [grey levels of 255]; None: 120 for the strip alone, else
        faint
    strip_width_px : float or None -- width of the strip in the image [px]; None: from beam.thickness
    container : str -- one of ``CONTAINERS``
    keeps_images : bool -- the frames on camera/image_raw in the bag, too
    unevenness_s : float -- frames come by up to so much sooner or later [s]
    row_step : int -- rows of a point of the strip, for the truth
    """

    faults: CameraFaults = field(default_factory=CameraFaults)
    is_whole: bool = False
    strip_contrast: float | None = None
    strip_width_px: float | None = None
    container: str = "mkv"
    keeps_images: bool = False
    unevenness_s: float = 0.0
    row_step: int = 10


def render_film(
    rig: Rig,
    folder: Path,
    order: FilmOrder,
    on_progress: Callable[[float, float], None] = lambda done, total: None,
) -> dict[str, Any]:
    """Film the rig's experiment.

    Parameters
    ----------
    rig : Rig -- its camera, noise, rolling shutter and lost frames are parameters of its own
    folder : Path -- new or empty: bag, film, rig.yaml, truth.csv, truth.json
    order : FilmOrder
    on_progress : callable -- called with simulated seconds so far and in all

    Returns
    -------
    dict -- what ``beam render --json`` prints

    Raises
    ------
    UsageError
        The folder is in use, or the excitation leaves a limit.
    VisionError
        A fault or the strip's size is out of range, or the film cannot be written.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise UsageError(f"{folder} exists and is not an empty folder; give another --out")
    camera = _camera_of(rig, order)
    n_frames = round((recipe_of_rig(rig).total_s + 1.0) * camera.rate_hz)
    folder.mkdir(parents=True, exist_ok=True)
    with ExitStack() as stack:
        film = stack.enter_context(_Film(rig, camera, folder, order, n_frames))
        count = simulate(
            rig,
            folder / "bag",
            measure=film.begin,
            strip_points=_STRIP_POINTS,
            unevenness_s=order.unevenness_s,
            on_progress=on_progress,
        )
    rig.write(folder / "rig.yaml")
    content = {
        "film": str(film.path),
        "bag": str(folder / "bag"),
        "frames": film.count,
        "points": list(film.names),
        "heights_m": [round(height, 6) for height in film.heights],
        "first_frame_ns": film.first_ns,
        "strip_width_px": camera.strip_width_m * camera.pixels_per_metre,
        "strip_contrast": camera.strip_contrast,
        "faults": asdict(order.faults),
        "messages": count,
    }
    write_whole(folder / "truth.json", strict_json(content, indent=2) + "\n")
    return content


def _camera_of(rig: Rig, order: FilmOrder) -> CameraParameters:
    camera = rig.camera_parameters()
    contrast = order.strip_contrast
    if contrast is None:
        room = camera.background if camera.contrast < 0 else 255.0 - camera.background
        contrast = min(120.0, room - 5.0) if order.is_whole else camera.strip_contrast
    width = camera.strip_width_m
    if order.strip_width_px is not None:
        width = order.strip_width_px / camera.pixels_per_metre
    return replace(camera, strip_contrast=contrast, strip_width_m=width)


class _Film:
    """The film, and the truth beside it, while they are made."""

    def __init__(
        self, rig: Rig, camera: CameraParameters, folder: Path, order: FilmOrder, n_frames: int
    ) -> None:
        self._rig, self._camera, self._order = rig, camera, order
        self._faulty = FaultyCamera(
            camera, order.faults, n_frames, rig.simulation.full_well, rig.simulation.seed
        )
        self.path = folder / f"film.{order.container}"
        self.count, self.first_ns = 0, 0
        self.names: tuple[str, ...] = rig.markers.names
        self.heights: tuple[float, ...] = tuple(rig.markers.heights)
        if order.is_whole:
            # The same points as `beam track --points full` follows.
            parameters = strip_parameters(camera, rig.beam.length, order.row_step)
            rows = StripFollower(parameters, (camera.height, camera.width)).rows_px
            self.heights = tuple(camera.heights(rows).tolist())
            self.names = point_names(self.heights)
        self._write_frame, self._close = self._opened()
        self._table = (folder / "truth.csv").open("w", encoding="utf-8", newline="")
        self._rows = csv.writer(self._table)
        self._rows.writerow(
            ["frame", "stamp_ns"] + [f"{name}_{what}" for what in ("u_px", "x_m") for name in self.names]
        )

    def _opened(self) -> tuple[Callable[[int, ByteArray], None], Callable[[], None]]:
        camera = self._camera
        if self._order.container == "mkv":
            writer = MatroskaWriter(self.path, camera.width, camera.height, camera.rate_hz)
            return writer.write, writer.close
        code = int.from_bytes(b"FFV1", "little")
        size = (camera.width, camera.height)
        capture = cv2.VideoWriter(str(self.path), code, camera.rate_hz, size, False)
        if not capture.isOpened():
            raise VideoError(f"{self.path}: OpenCV writes no FFV1 here; give --container mkv")

        def write(_time_ns: int, image: ByteArray) -> None:
            capture.write(image)

        return write, capture.release

    def __enter__(self) -> _Film:
        return self

    def __exit__(self, *_: object) -> None:
        self._close()
        self._table.close()

    def begin(self, rig: Rig, film: Film, types: BagTypes) -> Measure:
        """Return what films every exposure."""
        camera, faulty = self._camera, self._faulty
        heights = np.asarray(rig.markers.heights)
        renderer = SceneRenderer(camera, heights, strip_heights=film.strip_heights)
        rng = np.random.default_rng([rig.simulation.seed, 2])
        weights = exposure_weights(renderer.sub_instants)

        def measure(exposure: Exposure) -> Iterator[tuple[str, Any]]:
            k = self.count
            du, dv = faulty.shift(k)
            move = camera.direction * du / camera.pixels_per_metre
            markers = (
                np.full_like(exposure.markers, np.nan) if self._order.is_whole else exposure.markers + move
            )
            raised = heights - dv / camera.pixels_per_metre
            light = renderer.light(
                markers,
                exposure.strip + move,
                marker_z=np.broadcast_to(raised, markers.shape),
                disturbances=faulty.disturbances(k),
            )
            picture = faulty.picture(k, exposure.stamp_ns, light, rng)
            if k == 0:
                self.first_ns = exposure.stamp_ns
            self._write_frame(exposure.stamp_ns - self.first_ns, picture)
            self._tell(exposure, weights, film, du)
            self.count += 1
            if self._order.keeps_images:
                yield from image_messages(types, exposure.stamp_ns, picture)

        return measure

    def _tell(self, exposure: Exposure, weights: FloatArray, film: Film, du: float) -> None:
        """Write what was really there."""
        if self._order.is_whole:
            x = np.interp(self.heights, film.strip_heights, weights @ exposure.strip)
        else:
            x = weights @ exposure.markers
        columns = self._camera.columns(x) + du
        self._rows.writerow(
            [self.count, exposure.stamp_ns]
            + [f"{value:.5f}" for value in columns]
            + [f"{value:.9f}" for value in x]
        )
