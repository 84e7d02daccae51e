"""The kinds of camera source that ``tracker.source`` names: one table, to which installed packages add theirs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from beam_ident.plug_ins import find_kind
from beam_ros.errors import ParameterFileError, RigUnavailableError
from beam_ros.rig.rig import Rig
from beam_ros.vision.camera.device import DeviceCamera
from beam_ros.vision.camera.playback import VideoPlayback
from beam_ros.vision.camera.source import CameraSource

GROUP = "beam_ros.camera_sources"
"""Entry points of packages: each a callable that makes a ``CameraSource`` from the ``Rig``."""

CameraKind = Callable[[Rig], CameraSource] | None


def _device(rig: Rig) -> DeviceCamera:
    wanted = rig.tracker
    return DeviceCamera(
        wanted.device, rig.camera_parameters(), wanted.device_format, sets_exposure=wanted.sets_exposure
    )


def _video(rig: Rig) -> VideoPlayback:
    return VideoPlayback(Path(rig.tracker.video), rig.tracker.video_rate or None)


CAMERA_SOURCES: Mapping[str, CameraKind] = {
    "topic": None,  # the frames come from another process, on camera/image_raw, ...
    "device": _device,
    "file": _video,
    "compressed": None,  # ... or on camera/image_raw/compressed
}


def camera_kind(name: str) -> CameraKind:
    """Return what makes the camera of a kind; None where its frames come from another process.

    Raises
    ------
    ParameterFileError
        Neither the suite nor an installed package has a kind of this name.
    RigUnavailableError
        The package that has it cannot be imported.
    """
    return find_kind("tracker.source", name, CAMERA_SOURCES, GROUP, ParameterFileError, RigUnavailableError)
