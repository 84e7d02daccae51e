"""Printed boards as OpenCV draws them, seen straight, turned, in part, and through a lens."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from beam_ros.vision.calibration.board_fits import fit_lens, fit_scale
from beam_ros.vision.calibration.boards import Board, find_board
from beam_ros.vision.calibration.lens import Lens
from beam_ros.vision.errors import CalibrationError

aruco = pytest.importorskip("cv2.aruco", reason="this OpenCV has no markers")
if not hasattr(aruco, "getPredefinedDictionary"):
    pytest.skip("this OpenCV has no markers", allow_module_level=True)

CHARUCO = Board(7, 5, 0.03, pattern="charuco", marker_m=0.022, dictionary="5x5_100")
GRID = Board(5, 4, 0.04, pattern="aruco", marker_m=0.024, dictionary="4X4_50")
SQUARE_PX = 100


def printed(board: Board, *, is_old: bool = False) -> np.ndarray:
    """The board at 100 px a square; a white margin of half a square around."""
    names = {name.lower(): name for name in dir(aruco)}
    dictionary = aruco.getPredefinedDictionary(getattr(aruco, names[f"dict_{board.dictionary.lower()}"]))
    share = board.marker_m / board.square_m
    if board.pattern == "aruco":
        # OpenCV draws a grid smaller than asked by a pixel.
        draw = getattr(aruco, "generateImageMarker", None) or aruco.drawMarker
        side = round(share * SQUARE_PX)
        sheet = np.full((board.rows * SQUARE_PX, board.columns * SQUARE_PX), 255, np.uint8)
        for k in range(board.rows * board.columns):
            row, column = divmod(k, board.columns)
            top, left = row * SQUARE_PX, column * SQUARE_PX
            sheet[top : top + side, left : left + side] = draw(dictionary, k, side)
    else:
        size = (board.columns + 1, board.rows + 1)
        if hasattr(aruco, "CharucoBoard_create"):
            drawn = aruco.CharucoBoard_create(*size, 1.0, share, dictionary)
        else:
            drawn = aruco.CharucoBoard(size, 1.0, share, dictionary)
            drawn.setLegacyPattern(is_old)
        draw = drawn.generateImage if hasattr(drawn, "generateImage") else drawn.draw
        sheet = draw((size[0] * SQUARE_PX, size[1] * SQUARE_PX))
    return cv2.copyMakeBorder(sheet, *[SQUARE_PX // 2] * 4, cv2.BORDER_CONSTANT, value=255)


def picture(sheet: np.ndarray, board: Board, rotation, translation, lens: Lens, seed: int = 0) -> np.ndarray:
    """The sheet in space, its lower left printed corner at the translation, seen through a lens."""
    u, v = np.meshgrid(np.arange(640.0), np.arange(480.0))
    x, y = lens.undistort(u, v)
    rays = np.stack(
        [(x - lens.centre_px[0]) / lens.focal_px[0], (y - lens.centre_px[1]) / lens.focal_px[1], 1 + 0 * x]
    )
    turn, _ = cv2.Rodrigues(np.array(rotation, dtype=float))
    plane = np.linalg.inv(np.stack([turn[:, 0], turn[:, 1], np.array(translation)], axis=1))
    on = np.einsum("ij,jkl->ikl", plane, rays)
    # A pixel's centre is at half a pixel of the sheet.
    columns, rows = (on[k] / on[2] / board.square_m * SQUARE_PX + SQUARE_PX / 2 - 0.5 for k in (0, 1))
    soft = cv2.GaussianBlur(sheet, (0, 0), 1.2)
    seen = cv2.remap(
        soft,
        columns.astype(np.float32),
        rows.astype(np.float32),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )
    noisy = 40 + 0.7 * seen + np.random.default_rng(seed).normal(0, 2, seen.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


PERFECT = Lens((900.0, 900.0), (320.0, 240.0))
BENT = Lens((900.0, 905.0), (322.0, 238.0), (-0.25, 0.0, 0.0, 0.0, 0.0))
POSES = [
    ([0.0, 0.0, 0.0], [-0.11, -0.08, 0.40]),
    ([0.4, 0.1, 0.0], [-0.12, -0.09, 0.42]),
    ([-0.4, 0.1, 0.1], [-0.09, -0.07, 0.42]),
    ([0.1, 0.45, -0.1], [-0.11, -0.08, 0.42]),
    ([0.1, -0.45, 0.2], [-0.08, -0.10, 0.40]),
    ([0.3, 0.3, 0.0], [-0.05, -0.05, 0.46]),
    ([-0.3, -0.3, 0.0], [-0.14, -0.10, 0.46]),
]


@pytest.mark.first_case
@pytest.mark.parametrize("board", [CHARUCO, GRID], ids=["charuco", "aruco"])
def test_the_scale_comes_from_boards_with_markers_whole_or_in_part(board):
    sheet = printed(board)
    for place in ([-0.10, -0.08, 0.36], [-0.25, -0.15, 0.36]):
        frame = picture(sheet, board, [0.0, 0.0, 0.07], place, PERFECT)
        fit = fit_scale(frame, board)
        # Corners to some 0.1 px over 300 px.
        assert fit.pixels_per_metre == pytest.approx(2500.0, rel=1e-3)
        assert fit.residual_rms_px < 0.4
    assert len(find_board(frame, board).image_px) < len(
        find_board(picture(sheet, board, *POSES[0], PERFECT), board).image_px
    )


@pytest.mark.slow
def test_the_lens_has_the_coefficients_that_the_pictures_support_and_their_deviations():
    sheet = printed(CHARUCO)
    frames = [picture(sheet, CHARUCO, *pose, BENT, seed=k) for k, pose in enumerate(POSES)]
    fit = fit_lens(frames, CHARUCO)
    assert "k1" in fit.coefficients
    assert {"k2", "k3"} - set(fit.coefficients)
    assert fit.lens.distortion[0] == pytest.approx(-0.25, abs=max(0.02, 4 * fit.distortion_sd[0]))
    assert fit.lens.focal_px == pytest.approx((900.0, 905.0), rel=5e-3)
    assert 0 < fit.focal_sd_px[0] < 5


@pytest.mark.skipif(
    not hasattr(aruco, "CharucoDetector"), reason="OpenCV before 4.7 knows one way of printing"
)
def test_a_board_that_was_printed_the_old_way_is_read_too():
    board = Board(7, 5, 0.03, pattern="charuco", marker_m=0.022, dictionary="5x5_100")
    for is_old in (True, False):
        frame = picture(printed(board, is_old=is_old), board, *POSES[0], PERFECT)
        assert len(find_board(frame, board).image_px) == 35


def test_what_is_no_such_board_is_refused():
    grey = np.full((480, 640), 128, np.uint8)
    for board in (CHARUCO, GRID):
        with pytest.raises(
            CalibrationError, match=f"no {board.pattern} of .* of dictionary {board.dictionary}"
        ):
            find_board(grey, board)
    with pytest.raises(CalibrationError, match=r"dictionary of markers '5x5_10'.*did you mean 5x5_100"):
        Board(7, 5, 0.03, pattern="charuco", marker_m=0.022, dictionary="5x5_10")
    with pytest.raises(CalibrationError, match=r"0\.03 m, the distance"):
        Board(7, 5, 0.03, pattern="charuco", marker_m=0.03, dictionary="5x5_100")
    with pytest.raises(CalibrationError, match="at least 2 x 2"):
        Board(1, 5, 0.03, pattern="aruco", marker_m=0.02, dictionary="5x5_100")
