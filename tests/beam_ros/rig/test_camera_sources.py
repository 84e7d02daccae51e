from __future__ import annotations

from pathlib import Path

import pytest

from beam_ros.errors import ParameterFileError
from beam_ros.interfaces.rig_parameters import RIG_PARAMETERS
from beam_ros.rig.camera_sources import CAMERA_SOURCES, camera_kind
from beam_ros.rig.rig import Rig
from beam_ros.vision.camera.device import DeviceCamera
from beam_ros.vision.errors import VideoError

RIG = Rig.from_file()


def test_the_parameters_description_names_every_kind_of_the_table():
    assert all(kind in RIG_PARAMETERS["tracker.source"].description for kind in CAMERA_SOURCES)


def test_a_kind_makes_the_camera_that_the_rig_describes(tmp_path: Path):
    assert camera_kind(RIG.tracker.source) is None
    device, file = camera_kind("device"), camera_kind("file")
    assert device is not None
    assert file is not None
    camera = device(RIG.with_values({"tracker.device": "/dev/video7"}))
    assert isinstance(camera, DeviceCamera)
    assert camera.name == "/dev/video7"
    with pytest.raises(VideoError, match=r"nowhere\.avi: no such video file"):
        file(RIG.with_values({"tracker.video": str(tmp_path / "nowhere.avi")}))


def test_a_rig_with_a_kind_of_another_computer_can_be_read_and_only_its_tracker_refuses():
    rig = RIG.with_values({"tracker.source": "vendor"})
    with pytest.raises(
        ParameterFileError, match=r"tracker\.source is 'vendor': expected one of topic, device, file"
    ):
        camera_kind(rig.tracker.source)
