"""`beam render`: films with their truth; and `beam track --points full` on a beam without dots, to the modes."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from beam_ros.bags.reading import Bag
from beam_ros.cli.main import main
from beam_ros.offline.identification import identification_of_bags
from beam_ros.offline.loading.experiment import load_experiment
from beam_ros.rig.rig import Rig

pytest.importorskip("cv2")

from beam_ros.offline.tracked_film import track_video
from beam_ros.vision.camera.matroska import MatroskaWriter
from beam_ros.vision.camera.video import VideoFile
from beam_ros.vision.errors import VideoError
from beam_ros.vision.rendering.imaging import CameraFaults, FaultyCamera
from tests.beam_ros.vision.packaged_rig import packaged_camera

SMALL = [
    *("-p", "camera.width:=96", "-p", "camera.height:=240", "-p", "camera.pixels_per_metre:=750.0"),
    *("-p", "camera.origin_u:=47.3", "-p", "camera.origin_v:=229.0"),
    *(
        "-p",
        "excitation.duration:=2.5",
        "-p",
        "excitation.still:=0.6",
        "-p",
        "excitation.end_frequency:=40.0",
    ),
    *("-p", "excitation.start_frequency:=2.0"),
]


def truth_of(folder: Path) -> tuple[list[str], np.ndarray, np.ndarray, np.ndarray]:
    """Names, stamps [ns], columns [px] and displacements [m] of a film's truth."""
    with (folder / "truth.csv").open(encoding="utf-8") as file:
        header, *rows = csv.reader(file)
    n = (len(header) - 2) // 2
    values = np.array([[float(cell) for cell in row[2:]] for row in rows])
    stamps = np.array([int(row[1]) for row in rows])
    return [name.removesuffix("_u_px") for name in header[2 : 2 + n]], stamps, values[:, :n], values[:, n:]


@pytest.fixture(scope="module")
def whole_film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("whole") / "film"
    lit = ["--whole", "--row-step", "6", "--strip-contrast", "200", "-p", "camera.noise:=0.7"]
    assert main(["render", "--out", str(folder), *lit, *SMALL]) == 0
    return folder


@pytest.mark.slow
def test_a_beam_without_dots_is_filmed_followed_and_identified(whole_film: Path, tmp_path: Path) -> None:
    target = tmp_path / "tracked"
    command = ["track", str(whole_film / "film.mkv"), "--into", str(whole_film / "bag"), "--out", str(target)]
    assert main([*command, "--points", "full", "--row-step", "6"]) == 0
    names, stamps, _, x = truth_of(whole_film)
    with Bag(target) as bag:
        table = bag.displacements()
        summary = bag.texts("tracker/video")[-1]
    assert list(table.names) == names
    assert np.abs(table.stamps_ns - stamps).max() < 4e9 * summary["synchronisation"]["offset_sd_s"] < 1.6e6
    sigma = np.array([summary["markers"][name]["sigma_m"] for name in names])
    # What a clock that is a little off makes of the motion is the clock's error, not the points'.
    late = table.stamps_ns.astype(float) - stamps
    error = table.positions - x - np.gradient(x, stamps * 1e-9, axis=0) * (late * 1e-9)[:, None]
    assert np.isfinite(error).mean() > 0.99
    assert 0.9 < np.sqrt(np.nanmean((error / sigma) ** 2)) < 1.15

    found = identification_of_bags(target).content
    model = Rig.from_file(whole_film / "rig.yaml").beam_model()
    assert len(found["modes"]) == 2
    for mode, omega in zip(found["modes"], model.natural_frequencies, strict=False):
        assert mode["frequency_hz"] == pytest.approx(omega / (2 * np.pi), rel=2e-3)
        assert abs(mode["frequency_z"]) < 4
        assert abs(mode["damping_ratio_z"]) < 4
    # The rig of the experiment has the points for markers, at their heights.
    rig = load_experiment(target).rig
    assert rig is not None
    assert rig.markers.names == tuple(names)
    assert rig.markers.heights == pytest.approx(
        json.loads((whole_film / "truth.json").read_text())["heights_m"]
    )


def test_the_strip_is_said_to_be_missing_where_there_is_none(
    whole_film: Path, tmp_path: Path, capsys
) -> None:
    rig = Rig.from_file(whole_film / "rig.yaml")
    with MatroskaWriter(tmp_path / "empty.mkv", 96, 240, 100.0) as writer:
        rng = np.random.default_rng(0)
        for k in range(30):
            writer.write(k * 10_000_000, rng.integers(15, 26, (240, 96)).astype(np.uint8))
    with pytest.raises(VideoError, match="points of the strip are ever seen"):
        track_video(VideoFile(tmp_path / "empty.mkv"), rig, is_whole=True, row_step=6)
    command = [
        "track",
        str(whole_film / "film.mkv"),
        "--into",
        str(whole_film / "bag"),
        "--out",
        str(tmp_path / "t"),
    ]
    assert main([*command, "--points", "full", "--row-step", "100"]) == 2
    assert "at least 12 points" in capsys.readouterr().err


@pytest.mark.slow
def test_a_shaken_film_of_dots_beside_twins_is_where_its_truth_says(tmp_path: Path) -> None:
    folder = tmp_path / "film"
    faults = ["--shake", "0.4", "--gradient", "0.2", "--texture", "2", "--light-step", "0.8", "--images"]
    faults += ["--uneven", "0.002", "-p", "simulation.full_well:=10000.0", "-p", "excitation.duration:=0.6"]
    assert main(["render", "--out", str(folder), *SMALL, *faults]) == 0
    _, stamps, columns, _ = truth_of(folder)
    video = VideoFile(folder / "film.mkv")
    tracked = track_video(video, Rig.from_file(folder / "rig.yaml"))
    # Matroska counts microseconds.
    assert np.abs(tracked.frame_times_ns - (stamps - stamps[0])).max() <= 1000
    assert tracked.period_s is None
    seen = np.isfinite(tracked.u_px)
    assert seen.mean() > 0.5
    assert np.sqrt(np.mean((tracked.u_px - columns)[seen] ** 2)) < 0.05
    with Bag(folder / "bag") as bag:
        assert bag.count("camera/image_raw") == len(stamps)
        assert not bag.count("beam/displacement")


@pytest.mark.slow
@pytest.mark.parametrize("rate_hz", [50, 60, 100])
def test_a_lamp_flickers_at_any_rate_of_the_camera(rate_hz: int) -> None:
    camera, light = packaged_camera(noise_grey=0.0), np.full((480, 640), 100.0, np.float32)
    faulty = FaultyCamera(camera, CameraFaults(flicker=0.2), 400, 0.0, 1)
    rng = np.random.default_rng(1)
    levels = [faulty.picture(k, 10**18 + k * 10**9 // rate_hz, light, rng)[0, 0] for k in range(400)]
    assert (min(levels), max(levels)) == (pytest.approx(80, abs=2), pytest.approx(120, abs=2))


@pytest.mark.slow
def test_faults_are_seen_in_the_pictures(tmp_path: Path) -> None:
    short = ["-p", "excitation.duration:=0.3", "-p", "excitation.still:=0.1"]
    plain, faulty = tmp_path / "plain", tmp_path / "faulty"
    assert main(["render", "--out", str(plain), *SMALL, *short, "--container", "avi"]) == 0
    faults = [
        "--gain",
        "3",
        "--twins",
        "2",
        "--cover",
        "0.5",
        "--jpeg",
        "60",
        "--light-step",
        "0.1",
        "--drift",
        "0.2",
    ]
    assert main(["render", "--out", str(faulty), *SMALL, *short, *faults]) == 0
    before = np.array([image for _, image in VideoFile(plain / "film.avi").frames()], dtype=float)
    after = np.array([image for _, image in VideoFile(faulty / "film.mkv").frames()], dtype=float)
    assert before.shape == after.shape
    assert (after[0] == 255).sum() > (before[0] > 150).sum()
    assert after[0].mean() > 2 * before[0].mean()
    assert after[-1].mean() < 0.4 * before[-1].mean()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--jpeg", "200"], "--jpeg"),
        (["--gain", "nan"], "--gain"),
        (["--whole", "--row-step", "0"], "expected 1 to 200 rows"),
        (["--strip-width", "-1"], "strip_width_m"),
    ],
)
def test_what_cannot_be_filmed_is_refused_in_one_line(tmp_path: Path, capsys, options, message) -> None:
    assert main(["render", "--out", str(tmp_path / "film"), *SMALL, *options]) == 2
    error = capsys.readouterr().err.strip().splitlines()
    assert message in error[-1]


def test_a_folder_that_holds_something_is_not_written_into(tmp_path: Path, capsys) -> None:
    (tmp_path / "kept").write_text("mine", encoding="utf-8")
    assert main(["render", "--out", str(tmp_path), *SMALL]) == 2
    assert "not an empty folder" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["kept"]
