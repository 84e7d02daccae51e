"""`beam calibrate` on recorded bags: the truth comes back, faults of the rig are seen, those of the user refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from beam_ros import messages
from beam_ros.bags.reading import Bag
from beam_ros.bags.writing import BagWriter
from beam_ros.calibration.from_bag import calibrate_from_bags, find_rests
from beam_ros.cli.main import main
from beam_ros.errors import UsageError
from beam_ros.hub.contract import SampleBatch
from beam_ros.messages import BagTypes
from beam_ros.rig.rig import Rig
from beam_ros.vision.calibration.linear import LinearCalibration
from beam_ros.vision.calibration.storage import load_calibration
from beam_ros.vision.errors import CalibrationError

START = 1_700_000_000_000_000_000
RIG = Rig.from_file().with_values({"camera.name": "lab", "camera.focus": "0.6 m"})
SCALES = np.array([1500.0, 1497.0, 1494.0])
ZEROS = np.array([320.2, 319.7, 321.1])
NOISE_PX = 0.005
REST_S, MOVE_S = 1.0, 0.25
THERE_AND_BACK = np.concatenate([np.linspace(-0.03, 0.03, 8), np.linspace(0.03, -0.03, 8)[1:-1]])


def record(
    path: Path,
    stops=THERE_AND_BACK,
    *,
    play_px=0.0,
    bend_px_m2=0.0,
    laser_m=None,
    swing_px=0.0,
    swings=(),
    angle=0.0,
) -> Path:
    """A bag in which the hub stops at positions; `play_px` is where moves in +x end up ahead of others.

    The camera sees the hub travel at `angle` to its rows.
    At the stops numbered `swings` the upper markers swing at 4.4 Hz with the amplitude `swing_px`.
    """
    rng = np.random.default_rng(3)
    times = np.arange(0.0, len(stops) * (REST_S + MOVE_S), 1e-3)
    stop, within = np.divmod(times, REST_S + MOVE_S)
    here = stops[stop.astype(int)]
    there = stops[np.minimum(stop.astype(int) + 1, len(stops) - 1)]
    share = np.clip((within - REST_S) / MOVE_S, 0.0, 1.0)
    smooth = share * share * (3.0 - 2.0 * share)
    positions = here + smooth * (there - here)
    directions = np.sign(np.diff(stops, prepend=stops[0]))[stop.astype(int)]
    resolution = RIG.hub.encoder_resolution
    types = BagTypes()
    with BagWriter(path) as bag:
        bag.write_message(
            "excitation/info", START, messages.json_text(types, {"rig": RIG.to_nested(), "mode": "position"})
        )
        for k in range(0, len(times), 100):
            stamp_ns = START + k * 1_000_000
            part = resolution * np.round(positions[k : k + 100] / resolution)
            bag.write_batch("hub/measured", stamp_ns, SampleBatch(stamp_ns, 1_000_000, 0, positions=part))
        if laser_m is not None:
            bag.add_topic("laser", "sensor_msgs/msg/JointState")
        for k in range(0, len(times), 20):
            stamp_ns = START + k * 1_000_000
            x = positions[k]
            u = ZEROS + SCALES * x + bend_px_m2 * x**2 + 0.5 * play_px * directions[k]
            if stop[k] in swings:
                u = u + swing_px * np.sin(2 * np.pi * 4.4 * times[k]) * np.array([0.0, 0.7, 1.0])
            rows = np.zeros(3, dtype=messages.MARKER_DTYPE)
            way = u - ZEROS
            rows["u"] = ZEROS + way * np.cos(angle) + NOISE_PX * rng.standard_normal(3)
            rows["v"] = 400.0 + way * np.sin(angle) + (NOISE_PX * rng.standard_normal(3) if angle else 0.0)
            rows["id"], rows["valid"] = np.arange(3), 1
            bag.write_message(
                "beam/markers", stamp_ns, messages.marker_cloud(types, messages.MarkerCloud(stamp_ns, rows))
            )
            if laser_m is not None:
                reading = laser_m * x + 2e-6 * rng.standard_normal()
                bag.write_message(
                    "laser",
                    stamp_ns,
                    messages.displacement(types, stamp_ns, ["foot", "spare"], [reading, 0.0]),
                )
    return path


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("calibrate") / "bag")


def test_the_command_finds_the_truth_and_saves_it(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "calibration.yaml"
    assert main(["calibrate", str(bag), "--save", str(file), "--temperature", "21.5"]) == 0
    shown = capsys.readouterr().out
    assert "scale [px/m]" in shown
    assert "z225" in shown
    assert "curved" not in shown
    calibration = load_calibration(file)
    sd = np.sqrt([matrix[0][0] for matrix in calibration.covariance])
    assert np.all(np.abs(np.array(calibration.pixels_per_metre) - SCALES) < 4 * sd)
    # 0.005 px over 50 frames at 14 positions: 0.0007 px at each, 0.02 m from the middle.
    assert np.all(sd < 0.015)
    assert calibration.zero_px == pytest.approx(ZEROS, abs=1e-3)
    assert (calibration.camera_name, calibration.focus) == ("lab", "0.6 m")
    provenance = calibration.provenance
    assert provenance["bags"] == [str(bag)]
    assert provenance["temperature_celsius"] == 21.5
    assert provenance["reference"] == "hub/measured"
    assert provenance["rows_px"] == pytest.approx([400.0] * 3, abs=1e-6)
    assert provenance["n_points"] == len(THERE_AND_BACK)
    assert provenance["reference_m"] == pytest.approx(THERE_AND_BACK, abs=1e-6)


@pytest.mark.slow
def test_play_and_curvature_are_seen_and_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    loose = record(tmp_path / "loose", play_px=0.02)
    fit, _ = calibrate_from_bags([loose])
    # The first position was reached from nowhere.
    assert all(line.has_hysteresis for line in fit.lines)
    assert fit.lines[0].hysteresis_px == pytest.approx(0.02, abs=0.003)
    bent = record(tmp_path / "bent", bend_px_m2=20.0)
    assert main(["calibrate", str(bent), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert all(marker["is_curved"] for marker in result["markers"].values())
    assert result["markers"]["z010"]["curvature_px_m2"] == pytest.approx(20.0, rel=0.1)
    assert any("distortion" in warning for warning in result["warnings"])


@pytest.mark.parametrize("angle", [0.03, -0.2])
def test_the_angle_between_rows_and_travel_is_found_and_taken_out(tmp_path: Path, angle: float) -> None:
    fit, _ = calibrate_from_bags([record(tmp_path / "turned", angle=angle)])
    found = fit.calibration
    assert abs(found.angle - angle) < 4 * found.angle_sd
    # As the scale: 0.0007 px at each of 14 positions some 20 mm from the middle, three markers, over 1500 px/m.
    assert found.angle_sd < 1e-5
    deviations = np.sqrt([matrix[0][0] for matrix in found.covariance])
    assert np.all(np.abs(np.array(found.pixels_per_metre) - SCALES) < 4 * deviations)
    # A marker that sinks by 10 px across the travel has not moved along it.
    along, _ = found.travel_axes(ZEROS - 10.0 * np.sin(angle), 400.0 + 10.0 * np.cos(angle))
    assert found.displacement(along, np.zeros(3)).x_m == pytest.approx(np.zeros(3), abs=2e-6)
    assert LinearCalibration.from_dict(found.to_dict()) == found


@pytest.mark.slow
def test_positions_where_the_beam_still_swings_are_left_out_and_told(tmp_path: Path) -> None:
    fit, _ = calibrate_from_bags([record(tmp_path / "some", swing_px=3.0, swings=(2, 5))])
    assert fit.calibration.provenance["n_points"] == len(THERE_AND_BACK) - 2
    assert "2 of 14 positions are left out" in fit.warnings[0]
    assert (
        "by up to 2.2 px" in fit.warnings[0]
    )  # 3 px over the square root of 2, over no whole number of periods
    deviations = np.sqrt([matrix[0][0] for matrix in fit.calibration.covariance])
    assert np.all(np.abs(np.array(fit.calibration.pixels_per_metre) - SCALES) < 4 * deviations)
    with pytest.raises(CalibrationError, match=r"14 of 14 positions .* rest longer"):
        calibrate_from_bags([record(tmp_path / "all", swing_px=3.0, swings=range(14))])


@pytest.mark.slow
def test_a_laser_is_a_reference_and_its_uncertainty_travels(tmp_path: Path) -> None:
    path = record(tmp_path / "bag", laser_m=1.002)
    fit, _ = calibrate_from_bags([path], reference="laser:foot", reference_sd_m=5e-6)
    assert fit.calibration.pixels_per_metre == pytest.approx(SCALES / 1.002, rel=1e-4)
    encoder, _ = calibrate_from_bags([path])
    # 5 um are 0.0075 px: far more than a hundred frames leave.
    assert fit.calibration.covariance[0][0][0] > 20 * encoder.calibration.covariance[0][0][0]
    with pytest.raises(UsageError, match="--reference-sd"):
        calibrate_from_bags([path], reference="laser:foot")
    with pytest.raises(UsageError, match="foot, spare; say which"):
        calibrate_from_bags([path], reference="laser", reference_sd_m=1e-6)
    with pytest.raises(UsageError, match="expected one of foot, spare"):
        calibrate_from_bags([path], reference="laser:top", reference_sd_m=1e-6)


def test_several_bags_are_one_calibration(bag: Path, tmp_path: Path) -> None:
    further = record(tmp_path / "further", np.array([0.035, 0.04, 0.035]))
    fit, _ = calibrate_from_bags([bag, further])
    assert fit.calibration.provenance["n_points"] == len(THERE_AND_BACK) + 3


def test_what_cannot_be_calibrated_is_refused_in_one_line(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    restless = record(tmp_path / "restless", np.array([0.01]))
    two = tmp_path / "two.yaml"
    RIG.with_values(
        {
            "markers.names": ["a", "b"],
            "markers.heights": [0.1, 0.2],
            "markers.height_uncertainties": [0.001, 0.001],
            "markers.masses": [0.0, 0.0],
        }
    ).write(two)
    for words, message in (
        ([str(tmp_path / "none")], "does not exist"),
        ([str(Path(__file__).parents[3] / "bags" / "chirp_6s")], "beam/markers"),
        ([str(restless)], "1 points; expected at least 3"),
        ([str(bag), "--rig-file", str(two)], "has 3 markers; expected 2"),
        ([str(bag), "--frames", "3"], "expected at least 10"),
        ([str(bag), "--square", "0.01"], "--square goes with --board"),
        ([str(bag), "--temperature", "300"], "expected degrees Celsius"),
        ([str(bag), "--save", str(two / "file.yaml")], "cannot be written"),
    ):
        status = main(["calibrate", *words])
        error = [line for line in capsys.readouterr().err.splitlines() if line.startswith("beam calibrate:")]
        assert (status, len(error)) == (2, 1), words
        assert message in error[0]


def test_rests_end_at_motion_and_at_gaps() -> None:
    stamps = START + np.arange(5000, dtype=np.int64) * 1_000_000
    positions = np.where(np.arange(5000) < 2000, 0.0, np.minimum((np.arange(5000) - 2000) * 1e-4, 0.1))
    rests = find_rests(stamps, positions, 2e-6)
    # Motion is looked for over 50 ms, of which the rest before keeps off.
    assert [(rest.end_ns - START) * 1e-9 for rest in rests] == pytest.approx([1.95, 5.0], abs=0.01)
    assert [rest.position_m for rest in rests] == pytest.approx([0.0, 0.1])
    with_gap = np.concatenate([stamps[:1000], stamps[1500:]])
    assert len(find_rests(with_gap, np.zeros(4500), 2e-6)) == 2


def _camera_info_with_lens() -> Any:
    info = messages.camera_info(BagTypes(), START, 640, 480)
    info.d, info.distortion_model = np.array([-0.2, 0.1, 0.0, 0.0, 0.0]), "plumb_bob"
    info.k = np.array([900.0, 0.0, 320.0, 0.0, 900.0, 240.0, 0.0, 0.0, 1.0])
    return info


def _with_camera_info(path: Path, target: Path, info: Any) -> Path:
    with Bag(path) as source, BagWriter(target) as writer:
        for message in source.raw_messages():
            writer.add_topic(message.topic, message.type_name)
            writer.write(message.topic, message.receive_ns, message.data)
        writer.write_message("camera/camera_info", START, info)
    return target


def test_bags_with_different_lenses_do_not_mix(bag: Path, tmp_path: Path) -> None:
    other = record(tmp_path / "other", np.array([0.0, 0.01, 0.0]))
    with_lens = _with_camera_info(other, tmp_path / "with_lens", _camera_info_with_lens())
    with pytest.raises(CalibrationError, match="another lens"):
        calibrate_from_bags([bag, with_lens])
    fit, _ = calibrate_from_bags([with_lens])
    assert fit.calibration.provenance["lens"]["focal_px"] == [900.0, 900.0]


def test_a_camera_that_reads_a_part_of_its_sensor_has_that_parts_lens(tmp_path: Path) -> None:
    plain = record(tmp_path / "plain", np.array([0.0, 0.01, 0.0]))
    info = _camera_info_with_lens()
    info.width, info.height = 1280, 1024
    info.roi.x_offset, info.roi.y_offset, info.roi.width, info.roi.height = 300, 200, 640, 480
    fit, _ = calibrate_from_bags([_with_camera_info(plain, tmp_path / "part", info)])
    lens = fit.calibration.provenance["lens"]
    assert lens["centre_px"] == [320.0 - 300.0, 240.0 - 200.0]
    info.roi.width = 600
    with pytest.raises(
        CalibrationError, match=r"other: camera_info is for images of 600 x 480; expected 640"
    ):
        calibrate_from_bags([_with_camera_info(plain, tmp_path / "other", info)])
