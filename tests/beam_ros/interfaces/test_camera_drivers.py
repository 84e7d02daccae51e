"""Every packaged driver's file parses, sets keys that exist, says its own name, and stands in the page's table."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from beam_ros.errors import ParameterFileError
from beam_ros.interfaces.camera_drivers import camera_drivers, with_driver
from beam_ros.interfaces.parameter_files import parameters_in_file
from beam_ros.rig.rig import Rig

PAGE = Path(__file__).parents[3] / "docs" / "cameras.md"
ROW = re.compile(r"^\| `(\w+)` \| [^|]+ \| (\w+) \| ([\d.e-]+) \|", re.MULTILINE)


def test_the_page_states_what_every_file_sets() -> None:
    told = {name: (stamp, float(tolerance)) for name, stamp, tolerance in ROW.findall(PAGE.read_text())}
    files = {name: parameters_in_file(path) for name, path in camera_drivers().items()}
    assert (
        set(told) == set(files) == {"usb_cam", "v4l2_camera", "spinnaker", "pylon", "camera_ros", "realsense"}
    )
    for name, values in files.items():
        assert (values["camera.stamp"], values["camera.clock_tolerance"]) == told[name]
        assert values["camera.driver"] == name


@pytest.mark.parametrize("name", sorted(camera_drivers()))
def test_one_key_is_the_file_and_what_is_given_itself_counts(name: str) -> None:
    by_key = Rig.from_file().with_values({"camera.driver": name})
    assert by_key == Rig.from_file(camera_drivers()[name])
    own = Rig.from_file().with_values({"camera.driver": name, "camera.stamp": "mid"})
    assert own.camera.stamp == "mid"
    assert own.camera.clock_tolerance == by_key.camera.clock_tolerance


def test_a_driver_that_nobody_knows_is_refused_with_the_likeliest() -> None:
    with pytest.raises(ParameterFileError, match="did you mean usb_cam"):
        Rig.from_file().with_values({"camera.driver": "usbcam"})
    assert with_driver({"camera.rate": 50.0}) == {"camera.rate": 50.0}
