"""A film alone becomes a table of its markers, and a picture that says what was seen in a frame, and why.

Without the bag of an experiment nobody knows the hub's time: times count from the film's first frame.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from beam_ros.arrays import ByteArray, ImageArray
from beam_ros.errors import UsageError
from beam_ros.offline.tracked_film import TrackedVideo, Watch, track_video
from beam_ros.rig.rig import Rig
from beam_ros.vision.calibration.linear import LinearCalibration
from beam_ros.vision.camera.video import VideoFile, read_frame_times
from beam_ros.vision.measurement.measuring_chain import Measurement, MeasuringChain
from beam_ros.vision.measurement.overlay import draw_overlay, draw_spots

QUANTITIES = "time_s", "x_m", "sd_m", "u_px", "v_px"
"""Columns of every point, after its name."""


class FrameExplanation:
    """Keeps a picture of the first frame in which the fewest markers were valid, with what was seen in it.

    Parameters
    ----------
    rig : Rig -- its markers

    Attributes
    ----------
    picture : ndarray or None, shape (height, width, 3) -- blue, green, red; None before the first frame
    frame : int -- number of that frame
    """

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._fewest = math.inf
        self._count = -1
        self.picture: ByteArray | None = None
        self.frame = -1

    def look(self, chain: MeasuringChain, image: ImageArray, measured: Measurement) -> None:
        """Take note of a frame that was just measured."""
        self._count += 1
        n_valid = int(np.count_nonzero(np.isfinite(measured.u_px)))
        if n_valid >= self._fewest or measured.frame is None:
            return
        camera, markers = self._rig.camera_parameters(), self._rig.markers
        drawn = draw_overlay(
            image,
            measured.frame,
            markers.names,
            marker_diameter_px=camera.marker_diameter_px,
            rows_px=camera.rows(markers.heights).tolist(),
        )
        self.picture = draw_spots(drawn, chain.tracker.explained(image), markers.names)
        self._fewest, self.frame = n_valid, self._count

    def write(self, path: Path) -> None:
        """Write the picture.

        Raises
        ------
        UsageError
            The name is none of a picture that OpenCV writes, or there is no such folder.
        """
        if self.picture is None:
            return
        try:
            is_written = cv2.imwrite(str(path), self.picture)
        except cv2.error:
            is_written = False
        if not is_written:
            raise UsageError(
                f"{path}: cannot be written; expected a file such as frame.png in a folder that exists"
            )


def film_into_table(
    video_path: Path,
    table_path: Path,
    rig: Rig,
    *,
    rate_hz: float | None = None,
    times_path: Path | None = None,
    calibration: LinearCalibration | None = None,
    is_whole: bool = False,
    row_step: int = 10,
    watch: Watch | None = None,
    progress: Callable[[str, float], None] = lambda phrase, share: None,
) -> dict[str, Any]:
    """Track a film's markers, or its strip, into a CSV file: one row a frame, empty where nothing valid was seen.

    Parameters
    ----------
    video_path, table_path : Path -- the film, and the file to write
    rig : Rig -- its camera and markers
    rate_hz, times_path, calibration, is_whole, row_step, progress -- as in ``video_into_bag.track_into_bag``
    watch : callable, optional -- given every frame of the markers, measured

    Returns
    -------
    dict -- what ``beam track --csv --json`` prints

    Raises
    ------
    UsageError, VisionError
        Nothing is written.
    """
    if table_path.exists():
        raise UsageError(f"{table_path} exists already: expected a new file; give another --csv")
    times_ns = None if times_path is None else read_frame_times(times_path)
    video = VideoFile(video_path, rate_hz=rate_hz, frame_times_ns=times_ns, heeds_decoder=True)
    tracked = track_video(
        video,
        rig,
        calibration,
        lambda share: progress("tracking", share),
        is_whole=is_whole,
        row_step=row_step,
        watch=watch,
    )
    _write(table_path, tracked)
    seen = np.isfinite(tracked.x_m)
    return {
        "video": str(video.path),
        "table": str(table_path),
        "frames": len(tracked.times_ns),
        "rate_hz": video.rate_hz if math.isfinite(video.rate_hz) else None,
        "markers": {
            name: {
                "seen": int(np.count_nonzero(seen[:, k])),
                "sigma_m": float(np.sqrt(np.mean(tracked.sigma_m[seen[:, k], k] ** 2)))
                if seen[:, k].any()
                else None,
                "reasons": tracked.reasons[k],
            }
            for k, name in enumerate(tracked.names)
        },
        "notes": list(tracked.notes),
    }


def _write(path: Path, tracked: TrackedVideo) -> None:
    first_ns = int(tracked.times_ns.min())

    def row(k: int) -> Sequence[str]:
        cells = []
        for j in range(len(tracked.names)):
            cells.append(f"{(int(tracked.times_ns[k, j]) - first_ns) * 1e-9:.9f}")
            values = tracked.x_m[k, j], tracked.sigma_m[k, j], tracked.u_px[k, j], tracked.v_px[k, j]
            cells += [f"{value:.9g}" if np.isfinite(tracked.x_m[k, j]) else "" for value in values]
        return cells

    with path.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow([f"{name}_{quantity}" for name in tracked.names for quantity in QUANTITIES])
        table.writerows(row(k) for k in range(len(tracked.times_ns)))
