"""Camera and tracker of the packaged rig, with fields set otherwise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from beam_ros.rig.rig import Rig
from beam_ros.vision.parameters import CameraParameters, TrackerParameters

RIG = Rig.from_file()


def packaged_camera(**changes: Any) -> CameraParameters:
    return replace(RIG.camera_parameters(), **changes)


def packaged_tracker(
    camera: CameraParameters | None = None, heights: Sequence[float] | None = None, **changes: Any
) -> TrackerParameters:
    """What the packaged rig's tracker expects, of another camera and markers; without heights no rows are known."""
    own = RIG.tracker_parameters()
    seen = TrackerParameters.for_camera(
        camera or packaged_camera(),
        heights or (),
        refinement=own.refinement,
        sigma_floor_px=own.sigma_floor_px,
        min_contrast_grey=own.min_contrast_grey,
    )
    return replace(seen, **{"expected_rows_px": seen.expected_rows_px or None, **changes})
