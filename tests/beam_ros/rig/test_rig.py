"""The rig object: from a file to what the rooms want, and back."""

from __future__ import annotations

import hashlib
import math
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from beam_ros.errors import ParameterFileError
from beam_ros.hub.contract import HostTime
from beam_ros.hub.simulated.axis import VirtualAxis
from beam_ros.hub.simulated.simulated_hub import SimulatedHub
from beam_ros.interfaces.imperfections import PRESETS
from beam_ros.rig.filming import Film
from beam_ros.rig.rig import Rig
from beam_ros.vision.errors import VisionParameterError
from beam_ros.vision.rendering.frames import SceneRenderer
from beam_ros.vision.tracking.tracker import MarkerTracker


def test_the_default_rig_has_the_frequencies_that_its_theory_gives() -> None:
    """E = 200 GPa, 0.30 m of 25 x 0.5 mm, upright: 4.384, 28.26, 79.36 Hz (closed forms with gravity)."""
    frequencies = Rig.from_file().beam_model().natural_frequencies / (2 * math.pi)
    assert frequencies[:3] == pytest.approx([4.384, 28.262, 79.358], abs=5e-4)


def test_what_is_written_is_read_back_the_same(tmp_path: Path) -> None:
    rig = Rig.from_file().with_values(
        {"beam.gravity": "off", "hub.encoder_resolution": 1e-9, "serial.port": "x"}
    )
    rig.write(tmp_path / "rig.yaml")
    assert Rig.from_file(tmp_path / "rig.yaml") == rig
    assert Rig.from_nested(rig.to_nested()) == rig


def test_a_file_needs_only_what_differs(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("/**: {ros__parameters: {beam: {length: 0.25}, markers: {heights: [0.01, 0.1, 0.2]}}}")
    rig = Rig.from_file(path)
    assert rig.beam.length == 0.25
    assert rig.beam.width == Rig.from_file().beam.width


def test_parameters_from_a_command_line_are_yaml() -> None:
    rig = Rig.from_file().with_texts(["camera.rate:=50", "markers.names:=[a, b, c]", "serial.port:="])
    assert rig.camera.rate == 50.0
    assert rig.markers.names == ("a", "b", "c")


@pytest.mark.parametrize("text", ["camera.rate=50", ":=3", "camera.rate:=[1", "camera.rat:=50"])
def test_a_wrong_assignment_is_refused(text: str) -> None:
    with pytest.raises(ParameterFileError):
        Rig.from_file().with_texts([text])


def test_given_rigidity_and_mass_take_precedence_over_the_section() -> None:
    rig = Rig.from_file().with_values({"beam.flexural_rigidity": 0.06, "beam.mass_per_length": 0.1})
    beam = rig.beam_parameters()
    assert (beam.flexural_rigidity, beam.mass_per_length) == (0.06, 0.1)


def test_marker_masses_lower_the_frequencies() -> None:
    bare = Rig.from_file().with_values({"beam.gravity": "off"})
    loaded = bare.with_values({"markers.masses": [0.0, 2e-4, 0.0]})
    shift = loaded.beam_model().natural_frequencies / bare.beam_model().natural_frequencies - 1
    # 0.2 g at 225 mm: -0.58, -0.02, -0.45 % by perturbation theory; second order is below 0.01 %.
    assert shift[:3] * 100 == pytest.approx([-0.58, -0.02, -0.45], abs=0.02)


def test_every_room_takes_the_default_parameters() -> None:
    rig = Rig.from_file()
    assert rig.axis_parameters().period_ns == 1_000_000
    assert rig.link_parameters().serial_baud == 921_600
    assert rig.camera_parameters().marker_diameter_px == pytest.approx(12.0)
    assert len(rig.tracker_parameters().expected_rows_px or ()) == 3


def test_dark_markers_take_one_word_and_are_found() -> None:
    rig = Rig.from_file().with_values({"tracker.polarity": "dark"})
    camera = rig.camera_parameters()
    assert (camera.background, camera.contrast) == (235.0, -180.0)
    heights = rig.markers.heights
    tracker = MarkerTracker(rig.tracker_parameters(), len(heights))
    x = [0.001, 0.002, 0.003]
    result = tracker.process(SceneRenderer(camera, heights).render(x, np.random.default_rng(2)), 0)
    assert [marker.u_px for marker in result.markers] == pytest.approx(camera.columns(x), abs=0.04)


def test_a_ground_on_which_dark_markers_can_be_drawn_is_taken_as_it_is() -> None:
    camera = (
        Rig.from_file()
        .with_values({"tracker.polarity": "dark", "camera.background": 200.0})
        .camera_parameters()
    )
    assert (camera.background, camera.contrast) == (200.0, -180.0)


@pytest.mark.parametrize(("key", "seconds"), [("camera.exposure", 0.05), ("camera.readout", 0.04)])
def test_what_does_not_fit_into_a_frame_is_named_by_its_keys(key, seconds):
    rig = Rig.from_file().with_values({key: seconds})
    with pytest.raises(
        VisionParameterError, match=rf"{key} is {seconds} s.*frame period.*camera\.rate 100 Hz"
    ):
        rig.camera_parameters()
    assert rig.with_values({"camera.rate": 20.0}).camera_parameters().rate_hz == 20.0


@pytest.mark.parametrize(
    ("polarity", "grey"),
    [("dark", -80), ("bright", 280)],
)
def test_markers_that_no_image_can_show_are_named_by_their_keys(polarity: str, grey: int) -> None:
    rig = Rig.from_file().with_values({"tracker.polarity": polarity, "camera.background": 100.0})
    keys = f"camera.background 100, camera.contrast 180 and tracker.polarity {polarity}"
    with pytest.raises(
        VisionParameterError, match=rf"{keys} is {grey}; expected .*: correct it .*camera\.contrast"
    ):
        rig.camera_parameters()


def test_the_strip_is_as_wide_in_the_image_as_it_is_thick():
    rig = Rig.from_file().with_values({"beam.thickness": 0.0008})
    assert rig.camera_parameters().strip_width_m == 0.0008


@pytest.mark.parametrize(("stated_px", "used_px"), [(0.0, 0.0003), (0.02, 0.02)])
def test_no_position_is_stated_better_than_sampling_leaves_it(stated_px: float, used_px: float):
    rig = Rig.from_file().with_values({"tracker.sigma_floor": stated_px})
    assert rig.tracker_parameters().sigma_floor_px == used_px


def test_a_links_own_settings_are_one_text_of_yaml() -> None:
    rig = Rig.from_file()
    assert rig.axis_options() == {}
    rig = rig.with_values({"axis.options": "{gain: 2.0, port: /dev/ttyUSB0}"})
    assert rig.axis_options() == {"gain": 2.0, "port": "/dev/ttyUSB0"}
    for text in ("[1, 2]", "{", "gain"):
        with pytest.raises(ParameterFileError, match="expected a mapping in YAML"):
            rig.with_values({"axis.options": text}).axis_options()


def test_every_link_gets_what_the_rig_file_says_of_its_controller() -> None:
    rig = Rig.from_file().with_values(
        {
            "axis.rate": 100.0,
            "axis.home": "device",
            "axis.drive_watchdog": 0.2,
            "odrive.axis": 1,
            "dynamixel.id": 7,
        }
    )
    odrive, servo = rig.odrive_parameters(), rig.dynamixel_parameters()
    assert (odrive.rate, odrive.homes_here, odrive.axis) == (100.0, False, 1)
    assert (servo.rate, servo.homes_here, servo.servo_id) == (100.0, False, 7)
    assert rig.trajectory_parameters().drive_watchdog_s == 0.2


def test_an_axis_without_a_scale_is_refused() -> None:
    with pytest.raises(ParameterFileError, match=r"axis\.metres_per_unit is 0"):
        Rig.from_file().with_values({"axis.metres_per_unit": 0.0})
    rig = Rig.from_file().with_values({"axis.metres_per_unit": -0.02, "csv.velocity_column": 3})
    assert rig.odrive_parameters().metres_per_turn == -0.02
    assert rig.dynamixel_parameters().metres_per_turn == -0.02
    assert rig.trajectory_parameters().metres_per_unit == -0.02
    assert (rig.csv_columns().position_scale, rig.csv_columns().last) == (-0.02, 3)


def _realistic() -> Rig:
    """A rig whose servo is weak and whose travel is short, so that the hub strikes its stops."""
    return Rig.from_file().with_values(
        {
            "simulation.preset": "realistic",
            "simulation.frame_drops": 0.1,
            "hub.travel": 0.04,
            "hub.max_effort": 4.0,
            "hub.max_speed": 2.0,
            "hub.max_acceleration": 100.0,
        }
    )


@cache
def _seen_of_the_realistic() -> bytes:
    return _seen(_realistic())


def _seen(rig: Rig) -> bytes:
    """All that device and camera say of a short, violent experiment: counts, stamps and pixels."""
    model, drift_ppm = rig.beam_model(), rig.simulation.hub_clock_ppm
    device = rig.simulated_device(drift_ppm)
    axis = VirtualAxis(rig.axis_parameters(), rig.simulated_plant(model, drift_ppm), device)
    hub = SimulatedHub(axis)
    start = 1_700_000_000_000_000_000
    hub.poll(HostTime(0, start))
    film = Film(rig, model, hub.snapshots, hub.reached_ns)
    renderer = SceneRenderer(film.camera, rig.markers.heights, full_well=rig.simulation.full_well)
    axis.request(1, "home")
    # Hard to and fro: the weak servo cannot keep up, and runs into the stops.
    values = np.concatenate([np.full(70, 9.0), np.full(140, -9.0), np.full(70, 9.0)])
    digest, rng = hashlib.sha256(), np.random.default_rng(1)
    for k in range(1, 60):
        report = hub.poll(HostTime(k * 10_000_000, start + k * 10_000_000))
        if k == 3:
            axis.request(2, "enable")
            assert axis.arm(axis.device_ns, len(values)).success
            assert axis.append(0, values.tolist()).success
        for batch in report.measured:
            digest.update(batch.positions.tobytes() + str(batch.stamp_ns).encode())
        for exposure in film.due(hub.reached_ns):
            digest.update(renderer.render(exposure.markers, rng).tobytes())
            digest.update(str(exposure.stamp_ns).encode())
    return digest.digest()


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(PRESETS["ideal"]))
def test_every_imperfection_of_the_file_reaches_what_device_and_camera_say(name: str) -> None:
    other = {
        **{key: value for key, value in PRESETS["ideal"].items() if not isinstance(value, str)},
        "stamp_offset": 0.4,
        "servo_damping": 0.9,
        "servo_frequency": 50.0,
        "stop_restitution": 0.6,
        "ripple_period": 0.007,
        "friction_static": 4.5,
        "friction_coulomb_difference": 1.0,
        "friction_viscous_difference": 4.0,
        "encoder_at": "drive",
    }[name]
    assert _seen(_realistic().with_values({f"simulation.{name}": other})) != _seen_of_the_realistic()


@pytest.mark.slow
def test_a_seed_gives_the_same_imperfections_and_another_one_others() -> None:
    assert _seen(_realistic()) == _seen_of_the_realistic()
    assert _seen(_realistic().with_values({"simulation.seed": 2})) != _seen_of_the_realistic()
