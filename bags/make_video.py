"""Make the video of this folder anew, with the truth that it was filmed from.

    python bags/make_video.py [FOLDER]

It shows the experiment of the recording `chirp_6s` as a small camera of its own saw it: lossless grey FFV1, which
OpenCV's own wheels read, and so little noise that it stays small. The camera began to film somewhere in the hub's
time, which the video does not tell and `beam track` finds.
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from make_bags import RECORDINGS

from beam_ros.messages import BagTypes
from beam_ros.offline.simulation import Measure, rendered, simulate
from beam_ros.rig.filming import Exposure, Film
from beam_ros.rig.rig import Rig
from beam_ros.vision.timing import exposure_weights

NAME = "video_96x240"
CAMERA: dict[str, object] = {
    "camera.width": 96,
    "camera.height": 240,
    "camera.pixels_per_metre": 750.0,
    "camera.origin_u": 47.3,
    "camera.origin_v": 229.0,
    "camera.noise": 0.15,
    "camera.name": "small camera of the recordings",
}
LEFT_OUT = 37
"""Frames before the video begins."""


def make(folder: Path) -> None:
    """Write the video, the rig file of its camera and the truth into a folder of this folder."""
    target = folder / NAME
    target.mkdir(exist_ok=True)
    rig = Rig.from_file().with_values({**RECORDINGS["chirp_6s"], **CAMERA})
    camera = rig.camera_parameters()
    code = cv2.VideoWriter_fourcc(*"FFV1")
    writer = cv2.VideoWriter(
        str(target / "video.avi"), code, camera.rate_hz, (camera.width, camera.height), False
    )
    exposures: list[Exposure] = []

    def filmed(rig: Rig, film: Film, _types: BagTypes) -> Measure:
        render = rendered(rig, film)

        def write(exposure: Exposure) -> Iterator[tuple[str, Any]]:
            image = render(exposure)
            exposures.append(exposure)
            if len(exposures) > LEFT_OUT:
                writer.write(image)
            yield from ()

        return write

    with tempfile.TemporaryDirectory() as scratch:
        simulate(rig, Path(scratch) / "bag", measure=filmed)
    writer.release()
    shown = exposures[LEFT_OUT:]
    columns = [camera.columns(exposure_weights(len(e.markers)) @ e.markers) for e in shown]
    truth = {"first_frame_ns": shown[0].stamp_ns, "columns_px": np.round(columns, 5).tolist()}
    (target / "truth.json").write_text(json.dumps(truth) + "\n", encoding="utf-8")
    rig.write(target / "rig.yaml")
    print(f"{target}: {len(shown)} frames")


if __name__ == "__main__":
    make(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
