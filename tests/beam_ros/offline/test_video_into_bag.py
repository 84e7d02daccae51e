"""A video and a bag of the hub alone become a bag that identifies: `beam track`, then `beam identify`."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from beam_ros import messages
from beam_ros.bags.batches import decode_batch
from beam_ros.bags.reading import Bag
from beam_ros.bags.signals import Unreadable, join_batches
from beam_ros.bags.writing import BagWriter
from beam_ros.cli.main import main
from beam_ros.messages import BagTypes
from beam_ros.offline.identification import identification_of_bags
from beam_ros.rig.rig import Rig
from tests.whole_bags import messages_of_whole_bag

cv2 = pytest.importorskip("cv2")

from beam_ros.offline.tracked_film import track_video  # noqa: E402
from beam_ros.offline.video_into_bag import synchronise_with_hub  # noqa: E402
from beam_ros.vision.calibration.linear import LinearCalibration  # noqa: E402
from beam_ros.vision.calibration.storage import save_calibration  # noqa: E402
from beam_ros.vision.camera.matroska import MatroskaWriter  # noqa: E402
from beam_ros.vision.camera.video import VideoFile  # noqa: E402
from beam_ros.vision.rendering.frames import SceneRenderer  # noqa: E402
from beam_ros.vision.timing import FrameTiming  # noqa: E402

RECORDINGS = Path(__file__).parents[3] / "bags"
VIDEO = RECORDINGS / "video_96x240" / "video.avi"
RIG_FILE = VIDEO.with_name("rig.yaml")
TRUTH = json.loads(VIDEO.with_name("truth.json").read_text())

tells_key_frames = pytest.mark.skipif(
    not hasattr(cv2, "CAP_PROP_FRAME_TYPE"), reason="this OpenCV does not tell key frames from others"
)


@pytest.fixture(scope="module")
def hub_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recording of the experiment without its displacements, as a rig without a camera leaves it."""
    path = tmp_path_factory.mktemp("hub") / "bag"
    with Bag(RECORDINGS / "chirp_6s") as whole, BagWriter(path) as writer:
        for message in whole.raw_messages():
            if message.topic != "/beam/displacement":
                writer.write(message.topic.lstrip("/"), message.receive_ns, message.data)
    return path


@pytest.fixture
def bag(hub_bag: Path, tmp_path: Path) -> Path:
    shutil.copytree(hub_bag, tmp_path / "bag")
    return tmp_path / "bag"


def contents(path: Path) -> list[tuple[str, bytes]]:
    with Bag(path) as opened:
        return [(message.topic, message.data) for message in opened.raw_messages()]


def write_video(path: Path, frames: list[np.ndarray], codec: str = "FFV1") -> Path:
    height, width = frames[0].shape
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*codec), 100.0, (width, height), False)
    for frame in frames:
        writer.write(frame)
    writer.release()
    return path


@pytest.mark.slow
def test_the_committed_video_is_tracked_to_its_truth() -> None:
    rig = Rig.from_file(RIG_FILE)
    tracked = track_video(VideoFile(VIDEO), rig)
    error = tracked.u_px - np.array(TRUTH["columns_px"])
    assert all(counts == {"ok": len(error)} for counts in tracked.reasons)
    # Markers of 6 px with hardly any noise: what is left is the rounding to grey levels.
    assert np.sqrt(np.mean(error**2)) < 0.0015
    assert np.abs(error.mean(axis=0)).max() < 0.0005
    assert np.abs(error).max() < 0.008


@pytest.mark.slow
def test_a_video_whose_markers_are_smeared_for_longer_than_the_rig_says_names_the_exposure(
    tmp_path: Path,
) -> None:
    rig = Rig.from_file(RIG_FILE)
    camera, shares = rig.camera_parameters(), np.array([0.1, 0.8, 1.0])
    renderer, rng = SceneRenderer(camera, rig.markers.heights), np.random.default_rng(4)
    frames = []
    for k in range(100):
        instants = k + camera.exposure_s * camera.rate_hz * np.linspace(-0.5, 0.5, renderer.sub_instants)
        x = 16.0 / camera.pixels_per_metre * np.sin(0.3 * instants)[:, None] * shares
        frames.append(renderer.render(x, rng))
    video = VideoFile(write_video(tmp_path / "swing.mkv", frames))
    assert track_video(video, rig).notes == ()
    stated = replace(rig, camera=replace(rig.camera, exposure=0.002))
    (note,) = track_video(video, stated).notes
    assert "times as long as camera.exposure, 0.002 s, allows" in note


@pytest.mark.slow
def test_frames_that_a_converter_repeats_are_left_out_and_said(tmp_path: Path) -> None:
    rig = Rig.from_file(RIG_FILE)
    camera, rng = rig.camera_parameters(), np.random.default_rng(4)
    renderer, frames = SceneRenderer(camera, rig.markers.heights), []
    for k in range(60):
        x = 8.0 / camera.pixels_per_metre * np.sin(0.3 * k) * np.array([0.1, 0.8, 1.0])
        frames.append(frames[-1] if k % 5 == 4 else renderer.render(x, rng))
    tracked = track_video(VideoFile(write_video(tmp_path / "padded.mkv", frames)), rig)
    assert all(counts == {"ok": 48, "repeated": 12} for counts in tracked.reasons)
    (note,) = tracked.notes
    assert "12 of 60 frames are the one before, noise aside" in note


@pytest.mark.parametrize("n_stated", [60, 66])
def test_frames_that_the_container_leaves_out_cut_no_film_short(tmp_path: Path, n_stated: int) -> None:
    rig = Rig.from_file(RIG_FILE)
    camera, rng = rig.camera_parameters(), np.random.default_rng(4)
    renderer = SceneRenderer(camera, rig.markers.heights)
    with MatroskaWriter(tmp_path / "gaps.mkv", camera.width, camera.height, 100.0) as writer:
        for k in np.delete(np.arange(60), [20, 21, 40]):
            writer.write(int(k) * 10_000_000, renderer.render(1e-3 * np.sin(0.3 * k) * np.ones(3), rng))
    video = VideoFile(tmp_path / "gaps.mkv")
    # As OpenCV makes it of the duration that other programs write.
    video.n_frames = n_stated
    notes = track_video(video, rig).notes
    assert any("3 frames are missing" in note for note in notes)
    assert any("cut short" in note for note in notes) == (n_stated > 60)


@pytest.mark.slow
@pytest.mark.parametrize("codec", ["FFV1", "mp4v"])
def test_a_film_that_is_filled_up_from_behind_loses_the_frames_that_come_early(
    tmp_path: Path, codec: str
) -> None:
    # What is the frame before, bit for bit, is the one that was taken at its time: it was left out, and the other, up
    # to 2 px wrong, stayed. A codec that keeps what changes gives it back with a residual, and most were not noticed.
    rig = Rig.from_file(RIG_FILE)
    camera, rng = rig.camera_parameters(), np.random.default_rng(4)
    renderer, shares = SceneRenderer(camera, rig.markers.heights), np.array([0.1, 0.8, 1.0])
    truth = 16.0 / camera.pixels_per_metre * np.sin(0.15 * np.arange(100))[:, None] * shares
    frames = [renderer.render(x, rng) for x in truth]
    early = np.arange(3, 98, 7)
    for k in early:
        frames[k] = frames[k + 1]
    tracked = track_video(VideoFile(write_video(tmp_path / "filled.mkv", frames, codec)), rig)
    wrong = np.abs(tracked.x_m - truth) * camera.pixels_per_metre
    assert np.nanmax(wrong) < (0.05 if codec == "FFV1" else 0.5)
    assert np.count_nonzero(np.isnan(tracked.x_m).all(axis=1)) < 1.5 * len(early)
    assert any("give it the camera's own file" in note for note in tracked.notes)
    assert all(sum(counts.values()) == 100 for counts in tracked.reasons)


@pytest.mark.slow
def test_an_interlaced_film_is_named_with_the_remedy(tmp_path: Path) -> None:
    rig = Rig.from_file(RIG_FILE)
    camera, rng = rig.camera_parameters(), np.random.default_rng(4)
    renderer, shares = SceneRenderer(camera, rig.markers.heights), np.array([0.3, 0.8, 1.0])
    frames = []
    for k in range(90):
        x = [8.0 / camera.pixels_per_metre * np.sin(0.2 * at) * shares for at in (k, k + 0.5)]
        frame, later = (renderer.render(at, rng) for at in x)
        frame[::2] = later[::2]
        frames.append(frame)
    notes = track_video(VideoFile(write_video(tmp_path / "interlaced.mkv", frames)), rig).notes
    (note,) = (note for note in notes if "interlaced" in note)
    assert "-vf bwdif" in note


@pytest.mark.slow
def test_a_film_behind_a_noise_reduction_is_named_also_where_it_is_refused(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = Rig.from_file(RIG_FILE)
    camera, rng = replace(rig.camera_parameters(), noise_grey=3.0), np.random.default_rng(4)
    renderer = SceneRenderer(camera, rig.markers.heights)
    frames, shown = [], np.array(0.0)
    for k in range(80):
        shown = 0.5 * renderer.render(1e-3 * np.sin(0.05 * k) * np.ones(3), rng) + 0.5 * shown
        frames.append(np.rint(shown).astype(np.uint8))
    film = write_video(tmp_path / "reduced.mkv", frames[10:])
    assert any("(3DNR) off" in note for note in track_video(VideoFile(film), rig).notes)
    assert main(["track", str(film), "--into", str(bag), "--rig-file", str(RIG_FILE)]) == 2
    assert "(3DNR) off" in capsys.readouterr().err


@tells_key_frames
def test_a_codec_that_keeps_what_changes_is_named_and_one_of_whole_pictures_not(tmp_path: Path) -> None:
    rig = Rig.from_file(RIG_FILE)
    renderer, rng = SceneRenderer(rig.camera_parameters(), rig.markers.heights), np.random.default_rng(4)
    frames = [renderer.render(1e-3 * np.sin(0.3 * k) * np.ones(3), rng) for k in range(30)]
    for codec, said in (("mp4v", ["FMP4"]), ("MJPG", []), ("FFV1", [])):
        notes = track_video(VideoFile(write_video(tmp_path / f"{codec}.mkv", frames, codec)), rig).notes
        assert [
            word for note in notes for word in re.findall("the codec (.*) keeps what changes", note)
        ] == said


@pytest.mark.slow
def test_the_video_finds_its_time_in_the_hubs() -> None:
    rig = Rig.from_file(RIG_FILE)
    tracked = track_video(VideoFile(VIDEO), rig)
    with Bag(RECORDINGS / "chirp_6s") as opened:
        hub = opened.hub_samples()
    begun_s = (TRUTH["first_frame_ns"] - int(hub.stamps_ns[0])) * 1e-9
    for has_exact_rate in (False, True):
        found = synchronise_with_hub(tracked, hub, has_exact_rate=has_exact_rate).synchronisation
        assert abs(found.offset_s - begun_s) < 0.2e-3
        assert abs(found.offset_s - begun_s) < 4 * found.offset_sd_s
        assert abs(found.drift) <= 4 * found.drift_sd
        assert found.gain == pytest.approx(1.0, abs=0.01)


@pytest.mark.slow
def test_a_gap_in_the_hubs_record_does_not_move_the_time_found() -> None:
    tracked = track_video(VideoFile(VIDEO), Rig.from_file(RIG_FILE))
    with Bag(RECORDINGS / "chirp_6s") as opened:
        batches = [decode_batch(message.data) for message in opened.raw_messages("hub/measured")]
        hub = opened.hub_samples()
    # A second and a half is lost in the middle of the motion.
    lossy = join_batches("hub/measured", batches[:80] + batches[155:], Unreadable())
    assert lossy.lost > 1000
    found = synchronise_with_hub(tracked, lossy, has_exact_rate=True).synchronisation
    begun_s = (TRUTH["first_frame_ns"] - int(hub.stamps_ns[0])) * 1e-9
    assert abs(found.offset_s - begun_s) < 0.4e-3
    assert abs(found.offset_s - begun_s) < 4 * found.offset_sd_s


@pytest.mark.slow
def test_a_bag_of_the_hub_and_a_video_identify_as_the_truth(
    bag: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = contents(bag)
    arguments = ["track", str(VIDEO), "--into", str(bag), "--rig-file", str(RIG_FILE), "--json"]
    assert main(arguments) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["frames"] == len(TRUTH["columns_px"])
    assert abs(result["synchronisation"]["drift"]) < 4 * result["synchronisation"]["drift_sd"]

    # Nothing of the old bag is lost: it stays beside the new one, which holds all of it and the markers.
    assert contents(Path(result["original"])) == before
    after = contents(bag)
    assert len(messages_of_whole_bag(bag)) == len(after)
    kept = set(before)
    assert [content for content in after if content in kept] == before
    with Bag(bag) as opened:
        table = opened.displacements()
        assert opened.count("beam/markers") == result["frames"]
    assert table.names == ("z010", "z225", "z285")
    assert not np.isnan(table.positions).any()

    identified = identification_of_bags(bag).content
    truth = Rig.from_file(RIG_FILE).beam_model()
    assert len(identified["modes"]) == 2
    for mode, omega, zeta in zip(
        identified["modes"], truth.natural_frequencies[:2], truth.damping_ratios[:2], strict=True
    ):
        assert mode["frequency_hz"] == pytest.approx(omega / (2 * np.pi), rel=1e-4)
        assert mode["damping_ratio"] == pytest.approx(zeta, rel=0.01)
        assert abs(mode["frequency_z"]) < 4
        assert abs(mode["damping_ratio_z"]) < 4


@pytest.mark.slow
def test_markers_carry_the_frames_stamp_and_displacements_the_middle_of_their_rows_exposure(
    bag: Path,
) -> None:
    """As the tracker's node and the simulation stamp them, whatever a stamp means."""
    camera = {"camera.stamp": "arrival", "camera.readout": 0.004, "camera.latency": 0.001}
    assert (
        main(
            ["track", str(VIDEO), "--into", str(bag), "--rig-file", str(RIG_FILE)]
            + [word for name, value in camera.items() for word in ("-p", f"{name}:={value}")]
        )
        == 0
    )
    rig = Rig.from_file(RIG_FILE).with_values(camera)
    timing = FrameTiming(rig.camera_parameters())
    rows = rig.camera_parameters().rows(rig.markers.heights)
    types = BagTypes()
    with Bag(bag) as opened:
        clouds = [
            messages.read_marker_cloud(types.deserialize(message.data, message.type_name))
            for message in opened.raw_messages("beam/markers")
        ]
        stamps = opened.displacements().stamps_ns
    expected = [timing.row_middle(cloud.stamp_ns, float(row)) for cloud in clouds for row in reversed(rows)]
    # A row of measured height, and a clock that runs by some ppm differently over 5 ms: below 2 us.
    assert np.abs(stamps - np.array(expected)).max() < 2000


@pytest.mark.slow
def test_a_new_bag_leaves_the_old_one_and_a_second_video_replaces_the_first(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = contents(bag)
    common = ["--rig-file", str(RIG_FILE)]
    assert main(["track", str(VIDEO), "--into", str(bag), "--out", str(tmp_path / "new"), *common]) == 0
    shown = capsys.readouterr().out
    assert "offset   0.37" in shown
    assert "z225   seen in 666 of 666 frames" in shown
    assert contents(bag) == before
    first = len(contents(tmp_path / "new"))

    again = ["track", str(VIDEO), "--into", str(tmp_path / "new"), *common]
    assert main(again) == 2
    assert "--replace leaves these out" in capsys.readouterr().err
    assert main([*again, "--replace"]) == 0
    assert len(contents(tmp_path / "new")) == first
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bag", "new", "new_untracked"]


@pytest.mark.slow
def test_frame_times_of_the_users_come_before_the_files(bag: Path, tmp_path: Path) -> None:
    times = tmp_path / "times.csv"
    period = 0.01 * (1 + 2e-3)
    lines = [f"{1.7e9 + k * period:.9f}, {k}" for k in range(len(TRUTH["columns_px"]) + 3)]
    times.write_text("\n".join(["time_s, frame", *lines]) + "\n", encoding="utf-8")
    assert (
        main(["track", str(VIDEO), "--into", str(bag), "--rig-file", str(RIG_FILE), "--times", str(times)])
        == 0
    )
    with Bag(bag) as opened:
        summary = opened.texts("tracker/video")[-1]
    found = summary["synchronisation"]
    assert any("669 frame times are given for 666 frames" in note for note in summary["notes"])
    # These frame times are 0.2 % too far apart, and the low marker tells.
    assert found["drift"] == pytest.approx(-2e-3, abs=4 * found["drift_sd"])
    assert found["drift_sd"] < 2e-4


@pytest.mark.slow
def test_a_scale_that_is_wrong_is_told(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    wrong = ["-p", "camera.pixels_per_metre:=750.0"]
    rows = ["-p", "camera.width:=96", "-p", "camera.height:=240", "-p", "camera.origin_v:=229.0"]
    calibration = LinearCalibration.from_camera(Rig.from_file(RIG_FILE).camera_parameters(), 3)
    path = bag.parent / "calibration.yaml"
    document = calibration.to_dict()
    document.update(pixels_per_metre=[700.0] * 3, camera_name="", focus="")
    save_calibration(LinearCalibration.from_dict(document), path)
    command = ["track", str(VIDEO), "--into", str(bag), *wrong, *rows, "-p", "camera.origin_u:=47.3"]
    # The rig's own calibration file counts as the one that is given.
    assert main([*command, "-p", f"tracker.calibration:={path}", "-p", "camera.focus:=f8"]) == 0
    shown = capsys.readouterr().out
    assert "times as far as the hub: the scale is not right" in shown
    assert "does not say for which camera and focus it was made: expected the rig's focus ('f8')" in shown


@pytest.mark.slow
def test_a_time_that_is_not_known_to_a_fifth_of_a_millisecond_is_told(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    frames = [image for _, image in VideoFile(VIDEO).frames()]
    command = ["--into", str(bag), "--rig-file", str(RIG_FILE), "--json", "--out"]
    notes = {}
    for name, piece in (("whole", frames), ("short", frames[20:60])):
        video = write_video(tmp_path / f"{name}.avi", piece)
        assert main(["track", str(video), *command, str(tmp_path / name)]) == 0
        result = json.loads(capsys.readouterr().out)
        notes[name] = [note for note in result["notes"] if "time in the hub's" in note]
        assert (result["synchronisation"]["offset_sd_s"] > 0.2e-3) == (name == "short")
    assert notes["whole"] == []
    assert len(notes["short"]) == 1
    assert (
        "expected 0.2 ms or less: let the hub move more, or film it longer; --exact-rate" in notes["short"][0]
    )


@pytest.mark.slow
def test_a_time_that_is_known_at_the_beginning_of_a_film_and_not_at_its_end_is_told(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # Offset and drift were compared with 0.2 ms one by one, and the drift not at all.
    rng = np.random.default_rng(3)
    noisy = [
        np.clip(image + 5.0 * rng.standard_normal(image.shape), 0, 255).astype(np.uint8)
        for _, image in VideoFile(VIDEO).frames()
    ]
    video = write_video(tmp_path / "noisy.avi", noisy)
    command = ["track", str(video), "--into", str(bag), "--rig-file", str(RIG_FILE), "--json"]
    assert main([*command, "--out", str(tmp_path / "fitted")]) == 0
    result = json.loads(capsys.readouterr().out)
    found = result["synchronisation"]
    assert found["offset_sd_s"] < 0.2e-3 < found["time_sd_s"]
    (note,) = (note for note in result["notes"] if "time in the hub's" in note)
    assert "ms at its end; expected 0.2 ms or less" in note
    assert main([*command, "--out", str(tmp_path / "exact"), "--exact-rate"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["synchronisation"]["time_sd_s"] == result["synchronisation"]["offset_sd_s"]
    assert not any("time in the hub's" in note for note in result["notes"])


@pytest.mark.slow
@tells_key_frames
def test_what_a_codec_holds_back_is_fitted_where_it_keeps_what_changes(tmp_path: Path) -> None:
    rig = Rig.from_file(RIG_FILE)
    frames = [image for _, image in VideoFile(VIDEO).frames()][:40]
    whole = track_video(VideoFile(VIDEO), rig)
    with Bag(RECORDINGS / "chirp_6s") as opened:
        hub = opened.hub_samples()
    for codec, is_predicted in (("FFV1", False), ("mp4v", True)):
        video = write_video(tmp_path / f"{codec}.mkv", frames, codec)
        assert track_video(VideoFile(video), rig).is_predicted == is_predicted
        found = synchronise_with_hub(replace(whole, is_predicted=is_predicted), hub).synchronisation
        assert (found.lag_sd_m > 0) == is_predicted
        assert abs(found.lag_m) <= 4 * found.lag_sd_m


@pytest.mark.slow
def test_what_cannot_be_tracked_is_refused_in_one_line_and_leaves_the_bag(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = contents(bag)
    blank = write_video(tmp_path / "blank.avi", [np.full((240, 96), 20, np.uint8)] * 30)
    still_frame = next(VideoFile(VIDEO).frames())[1]
    one = write_video(tmp_path / "one.avi", [still_frame])
    pictures = [image for _, image in VideoFile(VIDEO).frames()]
    mirrored = write_video(tmp_path / "mirrored.avi", [image[:, ::-1].copy() for image in pictures])
    aside = write_video(tmp_path / "aside.avi", [still_frame.T.copy()])
    still = write_video(tmp_path / "still.avi", [still_frame] * 60)
    raw_frame = still_frame.copy()
    raw_frame[::2, 1::2] //= 2
    raw_frame[1::2, ::2] //= 2
    raw = write_video(tmp_path / "raw.mkv", [raw_frame] * 30)
    hollow_frame = still_frame.copy()
    hollow_frame[cv2.erode(still_frame, np.ones((3, 3))) > 100] = 20
    hollow = write_video(tmp_path / "hollow.avi", [hollow_frame] * 30)
    cut = tmp_path / "cut.avi"
    cut.write_bytes(VIDEO.read_bytes()[:3000])
    (tmp_path / "times.txt").write_text("0.0\n0.01\nsoon\n", encoding="utf-8")
    (tmp_path / "few.txt").write_text("0.0\n0.01\n", encoding="utf-8")
    for name, time in (("far", "1e12"), ("vast", "1e999999")):
        (tmp_path / f"{name}.txt").write_text(f"0.0\n0.01\n{time}\n", encoding="utf-8")
    (tmp_path / "wrong.yaml").write_text("a: 1\n", encoding="utf-8")
    other = LinearCalibration.from_camera(Rig.from_file().camera_parameters(), 3)
    save_calibration(other, tmp_path / "other.yaml")
    focused = LinearCalibration.from_camera(
        Rig.from_file(RIG_FILE).with_values({"camera.focus": "f8"}).camera_parameters(), 3
    )
    save_calibration(focused, tmp_path / "focused.yaml")
    two = LinearCalibration.from_camera(Rig.from_file(RIG_FILE).camera_parameters(), 2)
    save_calibration(two, tmp_path / "two.yaml")
    rig = ["--rig-file", str(RIG_FILE)]
    for video, options, message in (
        (tmp_path / "absent.avi", rig, "no such video file"),
        (RIG_FILE, rig, "no video that OpenCV"),
        (cut, rig, "cut.avi"),
        (VIDEO, [], "is 96 x 240; expected 640 x 480"),
        (blank, rig, "the low marker z010 is in none of 30 frames (no_contrast 30)"),
        (still, rig, "never moved"),
        (raw, rig, "(mosaic 30); expected grey or colour images, no raw mosaic of a colour sensor: set"),
        (hollow, rig, "(ring 30); expected full discs of one brightness: fill or cover their middles"),
        (one, rig, "seen in 1 frames"),
        (mirrored, rig, "set camera.is_mirrored"),
        (aside, rig, "turn a film that lies on its side"),
        (VIDEO, [*rig, "--rate", "25"], "frame rate?"),
        (VIDEO, [*rig, "--rate", "25"], "25 frames/s, and camera.rate is 100 Hz: give the rate"),
        (VIDEO, [*rig, "--rate", "-1"], "expected one > 0"),
        (VIDEO, [*rig, "--rate", "400"], "at 400 frames/s"),
        (VIDEO, [*rig, "--times", str(tmp_path / "times.txt")], "line 3 is 'soon'"),
        (VIDEO, [*rig, "--times", str(tmp_path / "few.txt")], "2 frame times for more frames"),
        (VIDEO, [*rig, "--times", str(tmp_path / "far.txt")], "line 3 is '1e12'"),
        (VIDEO, [*rig, "--times", str(tmp_path / "vast.txt")], "line 3 is '1e999999'"),
        (
            VIDEO,
            [*rig, "--calibration", str(tmp_path / "wrong.yaml")],
            "wrong.yaml: file holds no linear calib",
        ),
        (VIDEO, [*rig, "--calibration", str(tmp_path / "other.yaml")], "expected 640 x 480"),
        (VIDEO, [*rig, "--calibration", str(tmp_path / "two.yaml")], "holds for 2 markers"),
        (VIDEO, [*rig, "-p", f"tracker.calibration:={tmp_path / 'none.yaml'}"], "none.yaml: no such file"),
        (VIDEO, [*rig, "--calibration", str(tmp_path / "focused.yaml")], "names no focus; expected 'f8'"),
    ):
        status = main(["track", str(video), "--into", str(bag), *options])
        error = capsys.readouterr().err.strip().splitlines()
        assert (status, len(error)) == (2, 1), (video, options, error)
        assert message in error[0]
    assert main(["track", str(VIDEO), "--into", str(tmp_path / "no_bag"), *rig]) == 2
    assert "does not exist" in capsys.readouterr().err
    assert contents(bag) == before
    assert not [path for path in tmp_path.iterdir() if path.name.startswith((".", "bag_"))]


@pytest.mark.slow
def test_a_video_that_is_cut_short_is_used_as_far_as_it_goes(bag: Path, tmp_path: Path) -> None:
    data = VIDEO.read_bytes()
    cut = tmp_path / "cut.avi"
    cut.write_bytes(data[: int(0.7 * len(data))])
    assert main(["track", str(cut), "--into", str(bag), "--rig-file", str(RIG_FILE)]) == 0
    with Bag(bag) as opened:
        result = opened.texts("tracker/video")[-1]
    assert 300 < result["frames"] < 666
    assert "cut short" in result["notes"][0]


def beam(*arguments: str) -> tuple[int, str, str]:
    """Run the command in a process of its own: what a decoder writes to its standard error is heard only there."""
    found = subprocess.run(
        [
            sys.executable,
            "-c",
            "import sys; from beam_ros.cli.main import main; sys.exit(main())",
            *arguments,
        ],
        capture_output=True,
        text=True,
        timeout=120,
        # Other verbs of this process have set it: they want silence.
        env={name: value for name, value in os.environ.items() if name != "OPENCV_FFMPEG_LOGLEVEL"},
    )
    return found.returncode, found.stdout, found.stderr


def flipped(path: Path, count: int) -> Path:
    """Copy of the video with some bytes changed."""
    data = bytearray(VIDEO.read_bytes())
    rng = np.random.default_rng(count)
    for place in rng.integers(len(data) // 20, len(data) - 20_000, count):
        data[place] ^= int(rng.integers(1, 256))
    path.write_bytes(data)
    return path


@pytest.mark.slow
def test_frames_that_the_decoder_complains_about_are_no_measurements(bag: Path, tmp_path: Path) -> None:
    damaged = flipped(tmp_path / "damaged.avi", 14)
    target = tmp_path / "tracked"
    status, shown, error = beam(
        "track",
        str(damaged),
        "--into",
        str(bag),
        "--out",
        str(target),
        "--rig-file",
        str(RIG_FILE),
        "--json",
    )
    assert status == 0, error
    assert "mismatch" not in error + shown
    result = json.loads(shown)
    # FFV1 learns from picture to picture: what builds on a damaged one is damaged up to the next key frame.
    assert 14 <= result["damaged"] < result["frames"] / 2
    assert any("frames are damaged in the file" in note for note in result["notes"])
    with Bag(target) as opened:
        table = opened.displacements()
    truth = (np.array(TRUTH["columns_px"]) - 47.3) / 750.0
    index = np.rint((table.stamps_ns - TRUTH["first_frame_ns"]) * 1e-7).astype(int)
    error_m = np.abs(table.positions - truth[np.clip(index, 0, len(truth) - 1)])
    assert not np.any(error_m > 0.35 / 750.0)
    assert np.isfinite(table.positions).all(axis=1).sum() > 400
    hopeless = flipped(tmp_path / "hopeless.avi", 200)
    status, _, error = beam("track", str(hopeless), "--into", str(bag), "--rig-file", str(RIG_FILE))
    assert status == 2
    assert re.search(r"frames are damaged, as the decoder says \(first: \w[^)\n]+\)", error)


@pytest.mark.slow
def test_damage_in_motion_jpeg_costs_the_frames_that_it_hit_and_no_point_is_wrong(
    bag: Path, tmp_path: Path
) -> None:
    whole = tmp_path / "film.avi"
    writer = cv2.VideoWriter(str(whole), cv2.VideoWriter_fourcc(*"MJPG"), 100.0, (96, 240), False)
    writer.set(cv2.VIDEOWRITER_PROP_QUALITY, 90)
    for _, frame in VideoFile(VIDEO).frames():
        writer.write(frame)
    writer.release()
    clean = VideoFile(whole, heeds_decoder=True)
    n_frames = sum(1 for _ in clean.frames())
    assert not clean.damaged_frames(n_frames).any()
    data, rng = bytearray(whole.read_bytes()), np.random.default_rng(5)
    pictures = [at for at in range(len(data)) if data.startswith(b"\xff\xd8\xff", at)]
    for k in rng.choice(n_frames - 1, 150, replace=False):
        data[int(rng.integers(pictures[k], pictures[k + 1] - 10))] ^= int(rng.integers(1, 256))
    whole.write_bytes(data)
    words = ["track", str(whole), "--into", str(bag), "--rig-file", str(RIG_FILE), "--json"]
    status, shown, error = beam(*words)
    assert status == 0, error
    result = json.loads(shown)
    missing = n_frames - result["frames"]
    assert missing > 0
    assert any(f"{missing} frames cannot be decoded" in note for note in result["notes"])
    assert 90 <= result["damaged"] + missing <= 150
    with Bag(bag) as opened:
        table = opened.displacements()
    truth = (np.array(TRUTH["columns_px"]) - 47.3) / 750.0
    index = np.rint((table.stamps_ns - TRUTH["first_frame_ns"]) * 1e-7).astype(int)
    off_px = 750.0 * np.abs(table.positions - truth[np.clip(index, 0, len(truth) - 1)])
    # The film without damage is off by 0.03 px at most.
    assert not np.any(off_px > 0.1)


@pytest.mark.slow
def test_dropped_frames_that_the_file_does_not_tell_of_are_found(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    frames = [image for _, image in VideoFile(VIDEO).frames()]
    left = np.delete(np.arange(len(frames)), np.random.default_rng(3).integers(40, 480, 25))
    video = write_video(tmp_path / "gaps.avi", [frames[k] for k in left])
    assert main(["track", str(video), "--into", str(bag), "--rig-file", str(RIG_FILE), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["lost"] == len(frames) - len(left)
    assert any("the camera dropped" in note for note in result["notes"])
    with Bag(bag) as opened:
        table = opened.displacements()
    known = np.isfinite(table.positions).all(axis=1)
    assert known.sum() > 0.6 * len(left)
    late_s = (table.stamps_ns - TRUTH["first_frame_ns"]) * 1e-9 - left * 0.01
    assert np.abs(late_s[known]).max() < 0.2e-3
