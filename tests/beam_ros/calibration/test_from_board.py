"""`beam calibrate --board`: scale and lens from pictures of a checkerboard, as files."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

cv2 = pytest.importorskip("cv2")

import numpy as np  # noqa: E402

from beam_ros.cli.main import main  # noqa: E402
from beam_ros.vision.calibration.lens import Lens  # noqa: E402
from beam_ros.vision.calibration.storage import load_calibration  # noqa: E402
from tests.beam_ros.vision.calibration.test_board_fits import POSES, picture  # noqa: E402

PERFECT = Lens((900.0, 900.0), (320.0, 240.0), (0.0, 0.0, 0.0, 0.0, 0.0))
BENT = Lens((900.0, 900.0), (322.0, 238.0), (-0.21, 0.08, 0.0, 0.0, 0.0))
BOARD = ["--board", "8x6", "--square", "0.02"]


def write(path: Path, image: np.ndarray) -> Path:
    assert cv2.imwrite(str(path), image)
    return path


def test_a_picture_in_the_beams_plane_gives_the_scale(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plane = write(tmp_path / "plane.png", picture(*POSES[0], lens=PERFECT))
    file = tmp_path / "scale.yaml"
    words = ["calibrate", str(plane), *BOARD, "--square-sd", "2e-5", "--save", str(file)]
    assert main([*words, "-p", "camera.focus:=0.35 m"]) == 0
    shown = capsys.readouterr().out
    assert "px/m" in shown
    assert "no tilted pictures" in shown
    calibration = load_calibration(file)
    assert calibration.pixels_per_metre == pytest.approx([900 / 0.35] * 3, rel=5e-4)
    # The ruler's 0.1 % is nearly all of it.
    assert np.sqrt(calibration.covariance[0][0][0]) == pytest.approx(900 / 0.35 * 1e-3, rel=0.1)
    assert (calibration.focus, calibration.image_size) == ("0.35 m", (640, 480))
    assert calibration.provenance["square_m"] == 0.02


def test_tilted_pictures_give_the_lens_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = [
        str(write(tmp_path / f"{k}.png", picture(*pose, lens=BENT, seed=k))) for k, pose in enumerate(POSES)
    ]
    assert main(["calibrate", *files, *BOARD, "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["calibration"]["pixels_per_metre"][0] == pytest.approx(900 / 0.35, rel=3e-3)
    lens = result["calibration"]["provenance"]["lens"]
    assert lens["focal_px"] == pytest.approx([900.0, 900.0], rel=3e-3)
    assert lens["distortion"][0] == pytest.approx(-0.21, abs=0.02)


@pytest.mark.slow
def test_pictures_without_the_board_are_counted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = [
        str(write(tmp_path / f"{k}.png", picture(*pose, lens=BENT, seed=k))) for k, pose in enumerate(POSES)
    ]
    empty = str(write(tmp_path / "empty.png", np.full((480, 640), 60, np.uint8)))
    assert main(["calibrate", *files, *BOARD, "--json"]) == 0
    assert "left out" not in capsys.readouterr().out
    assert main(["calibrate", *files, empty, *BOARD, "--json"]) == 0
    found = f"the checkerboard was found in {len(files)} of {len(files) + 1} pictures"
    assert found in capsys.readouterr().out


def test_a_picture_of_another_size_is_left_out_with_a_note(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for k, pose in enumerate(POSES):
        write(tmp_path / f"{k}.png", picture(*pose, lens=BENT, seed=k))
    write(tmp_path / "9.png", picture(*POSES[1], lens=BENT)[:240, :320])
    assert main(["calibrate", str(tmp_path / "0.png"), str(tmp_path), *BOARD]) == 0
    said = capsys.readouterr().out
    assert f"{tmp_path}: holds one of 320 x 240; expected 640 x 480" in said
    assert f"1 of {len(POSES) + 1} left out" in said
    assert main(["calibrate", str(tmp_path / "9.png"), str(tmp_path), *BOARD]) == 2
    assert f"{tmp_path / '9.png'}: is 320 x 240; expected 640 x 480" in capsys.readouterr().err


@pytest.mark.slow
def test_a_folder_of_a_charuco_board_gives_scale_and_lens_with_their_deviations(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    boards = pytest.importorskip("tests.beam_ros.vision.calibration.test_boards")
    sheet = boards.printed(boards.CHARUCO)
    (tmp_path / "tilted").mkdir()
    for k, pose in enumerate(boards.POSES):
        place = tmp_path / ("tilted" if k else "") / f"{k}.png"
        write(place, boards.picture(sheet, boards.CHARUCO, *pose, boards.BENT, seed=k))
    words = [
        "calibrate",
        str(tmp_path / "0.png"),
        str(tmp_path / "tilted"),
        "--board",
        "7x5",
        "--square",
        "0.03",
    ]
    marked = [*words, "--pattern", "charuco", "--marker", "0.022", "--dictionary", "5x5_100"]
    assert main([*marked, "--save", str(tmp_path / "c.yaml")]) == 0
    assert "distortion k1 -0.2" in capsys.readouterr().out
    calibration = load_calibration(tmp_path / "c.yaml")
    assert calibration.pixels_per_metre[0] == pytest.approx(900 / 0.40, rel=3e-3)
    assert calibration.provenance["lens_sd"]["focal_px"][0] > 0
    assert main([*words, "--marker", "0.022"]) == 2
    assert "go with --pattern" in capsys.readouterr().err
    assert main([*marked[:-1], "5x5_101"]) == 2
    assert "there is no dictionary" in capsys.readouterr().err


@pytest.mark.slow
def test_a_board_that_is_never_tilted_gives_the_scale_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    turns = np.linspace(-0.3, 0.3, 6)
    for pictures in (
        [picture(*POSES[0], lens=PERFECT, seed=k) for k in range(6)],
        [
            picture([0.0, 0.0, turn], [-0.07 + 0.1 * turn, -0.05, 0.36], lens=PERFECT, seed=k)
            for k, turn in enumerate(turns)
        ],
    ):
        files = [str(write(tmp_path / f"{k}.png", image)) for k, image in enumerate(pictures)]
        assert main(["calibrate", files[0], *BOARD, "--json"]) == 0
        alone = json.loads(capsys.readouterr().out)
        assert main(["calibrate", *files, *BOARD, "--json"]) == 0
        result = json.loads(capsys.readouterr().out)
        assert result["calibration"]["pixels_per_metre"] == alone["calibration"]["pixels_per_metre"]
        assert result["scale_sd"] == alone["scale_sd"]
        assert result["calibration"]["provenance"]["lens"] is None
        assert "6 pictures leave the focal length open" in result["warnings"][0]


@pytest.mark.parametrize(
    ("square", "is_noted"), [("0.02", False), ("0.04", False), ("2", True), ("20", True)]
)
def test_squares_in_another_unit_than_metres_are_noted(
    square: str, is_noted: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plane = write(tmp_path / "plane.png", picture(*POSES[0], lens=PERFECT))
    assert main(["calibrate", str(plane), "--board", "8x6", "--square", square]) == 0
    shown = capsys.readouterr().out
    assert ("camera.pixels_per_metre is 1500: is --square in metres?" in shown) is is_noted
    assert (f"by squares of {square} m" in shown) is is_noted


def test_a_video_of_the_board_will_do(tmp_path: Path) -> None:
    frame = picture(*POSES[0], lens=PERFECT)
    video = tmp_path / "board.avi"
    writer = cv2.VideoWriter(str(video), cv2.VideoWriter_fourcc(*"FFV1"), 25.0, (640, 480), False)
    for _ in range(3):
        writer.write(frame)
    writer.release()
    assert main(["calibrate", str(video), *BOARD, "--save", str(tmp_path / "c.yaml")]) == 0
    assert load_calibration(tmp_path / "c.yaml").pixels_per_metre[0] == pytest.approx(900 / 0.35, rel=5e-4)


def test_what_shows_no_board_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    empty = write(tmp_path / "empty.png", np.full((480, 640), 90, np.uint8))
    small = write(tmp_path / "small.png", np.full((240, 320), 90, np.uint8))
    zero = tmp_path / "zero.png"
    zero.touch()
    (tmp_path / "nothing").mkdir()
    text = tmp_path / "text.png"
    text.write_text("no picture", encoding="utf-8")
    for words, message in (
        ([str(empty), *BOARD], "no checkerboard of 8 x 6"),
        ([str(small), *BOARD], "is 320 x 240; expected 640 x 480"),
        ([str(text), *BOARD], "text.png"),
        ([str(text), *BOARD], "text.png: is not a picture that OpenCV can read (10 bytes)"),
        ([str(zero), *BOARD], "zero.png: is not a picture that OpenCV can read (0 bytes)"),
        ([str(tmp_path / "nothing"), *BOARD], "nothing: is a folder without pictures (.png"),
        ([str(tmp_path / "absent.png"), *BOARD], "no such picture or video"),
        ([str(empty), "--board", "8by6", "--square", "0.02"], "as 8x6"),
        ([str(empty), "--board", "8x6"], "needs --square"),
        ([str(empty), "--board", "2x6", "--square", "0.02"], "at least 3 x 3"),
        ([str(empty), "--board", "8x6", "--square", "0"], "squares of 0.0 +- 0.0 m; expected metres > 0"),
        ([str(empty), "--board", "8x6", "--square", "0"], "give --square and --square-sd"),
        ([str(empty), *BOARD, "--square-sd", "inf"], "a standard deviation of 0 or more"),
        ([str(empty), "--board", "8x6", "--square", "-1"], "expected metres > 0"),
    ):
        status = main(["calibrate", *words])
        error = capsys.readouterr().err.strip().splitlines()
        assert (status, len(error)) == (2, 1), (words, error)
        assert message in error[0]
