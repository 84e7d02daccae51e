from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
import pytest

from beam_ros.vision.calibration import board_fits
from beam_ros.vision.calibration.board_fits import fit_lens, fit_scale
from beam_ros.vision.calibration.boards import Board, BoardView
from beam_ros.vision.calibration.lens import Lens
from beam_ros.vision.errors import CalibrationError, UndeterminedLensError

BOARD = Board(8, 6, 0.02)
LENS = Lens((900.0, 905.0), (322.0, 238.0), (-0.21, 0.08, 0.0, 0.0, 0.0))


@lru_cache(maxsize=4)
def rays_of(lens):
    """Direction of every pixel."""
    u, v = np.meshgrid(np.arange(640.0), np.arange(480.0))
    x, y = lens.undistort(u, v)
    return np.stack(
        [
            (x - lens.centre_px[0]) / lens.focal_px[0],
            (y - lens.centre_px[1]) / lens.focal_px[1],
            np.ones_like(x),
        ]
    )


def soft_wave(s, pixels_per_square):
    """A square wave of unit height with edges at the integers, blurred by 0.9 px."""
    distance = (s - np.rint(s)) * pixels_per_square
    return np.tanh(distance / 0.9 * 0.8) * np.where(np.rint(s) % 2 == 0, 1.0, -1.0)


def picture(rotation, translation, lens=LENS, seed=0):
    """A board filmed through a lens: every pixel looked up on the board."""
    turn, _ = cv2.Rodrigues(np.array(rotation, dtype=float))
    inverse = np.linalg.inv(np.stack([turn[:, 0], turn[:, 1], np.array(translation)], axis=1))
    on_board = np.einsum("ij,jkl->ikl", inverse, rays_of(lens))
    s, t = on_board[0] / on_board[2] / BOARD.square_m, on_board[1] / on_board[2] / BOARD.square_m
    inside = (s > -1) & (s < BOARD.columns) & (t > -1) & (t < BOARD.rows)
    size = lens.focal_px[0] * BOARD.square_m / translation[2]
    frame = np.where(inside, 125.0 - 85.0 * soft_wave(s, size) * soft_wave(t, size), 210.0)
    frame += np.random.default_rng(seed).normal(0, 2, frame.shape)
    return np.clip(np.rint(frame), 0, 255).astype(np.uint8)


POSES = [
    ([0.0, 0.0, 0.0], [-0.07, -0.05, 0.35]),
    ([0.35, 0.1, 0.0], [-0.09, -0.07, 0.38]),
    ([-0.35, 0.1, 0.1], [-0.05, -0.03, 0.38]),
    ([0.1, 0.4, -0.1], [-0.08, -0.05, 0.40]),
    ([0.1, -0.4, 0.2], [-0.04, -0.06, 0.36]),
    ([0.25, 0.25, 0.0], [-0.02, -0.02, 0.42]),
    ([-0.25, -0.25, 0.0], [-0.12, -0.08, 0.42]),
]


def test_the_lens_is_recovered_from_tilted_boards():
    fit = fit_lens([picture(*pose, seed=k) for k, pose in enumerate(POSES)], BOARD)
    assert fit.n_pictures == len(POSES)
    assert fit.residual_rms_px < 0.1
    u, v = np.meshgrid(np.linspace(80, 560, 7), np.linspace(60, 420, 5))
    found, true = fit.lens.undistort(u, v), LENS.undistort(u, v)
    # Focal length and distance trade off; what must agree is the bend, the image up to a similarity.
    design = np.stack([true[0].ravel(), true[1].ravel(), np.ones(u.size)], axis=1)
    for axis in (0, 1):
        rest = found[axis].ravel() - design @ np.linalg.lstsq(design, found[axis].ravel(), rcond=None)[0]
        assert np.abs(rest).max() < 0.25


def test_the_scale_in_the_boards_plane():
    plain = Lens((900.0, 900.0), (320.0, 240.0))
    fit = fit_scale(picture([0.0, 0.0, 0.05], [-0.07, -0.05, 0.36], plain), BOARD)
    # 40 corners known to about 0.05 px over 200 px; the stated sd is smaller by their number.
    assert fit.pixels_per_metre == pytest.approx(900.0 / 0.36, rel=3e-4)
    assert fit.sd < 1.0
    assert fit.tilt < 0.003
    tilted = fit_scale(picture([0.0, 0.15, 0.0], [-0.07, -0.05, 0.36], plain), BOARD)
    assert tilted.tilt > 5 * fit.tilt


def test_undistortion_comes_before_the_scale():
    lens = Lens((900.0, 900.0), (320.0, 240.0), (-0.21, 0.08, 0.0, 0.0, 0.0))
    frame = picture([0.0, 0.0, 0.0], [-0.07, -0.05, 0.36], lens)
    with_lens = fit_scale(frame, BOARD, lens)
    assert with_lens.pixels_per_metre == pytest.approx(2500.0, rel=5e-4)
    assert with_lens.residual_rms_px < 0.3 * fit_scale(frame, BOARD).residual_rms_px


def test_the_ruler_limits_the_scale():
    plain = Lens((900.0, 900.0), (320.0, 240.0))
    board = Board(8, 6, 0.02, 0.00002)
    fit = fit_scale(picture([0.0, 0.0, 0.0], [-0.07, -0.05, 0.36], plain), board)
    assert fit.sd == pytest.approx(2500.0 * 0.001, rel=0.05)


def test_what_is_no_board_is_refused():
    with pytest.raises(CalibrationError, match="no checkerboard of 8 x 6"):
        board_fits.find_board(np.full((480, 640), 128, np.uint8), BOARD)
    with pytest.raises(CalibrationError, match="0 of 2 pictures"):
        fit_lens([np.zeros((480, 640), np.uint8)] * 2, BOARD)
    with pytest.raises(CalibrationError, match="one size"):
        fit_lens([np.zeros((480, 640), np.uint8), np.zeros((40, 64), np.uint8)], BOARD)
    with pytest.raises(CalibrationError, match="2 x 6 inner corners"):
        Board(2, 6, 0.02)
    with pytest.raises(CalibrationError, match="metres > 0"):
        Board(8, 6, 0.0)


def test_the_standard_deviation_of_a_scale_is_that_of_the_corners_noise(monkeypatch):
    # q = a p with 2 n numbers for 4 unknowns: var |a| = s^2 / sum |p|^2, and s^2 from 92 degrees of freedom.
    scale, noise = 1500.0, 0.05
    rng = np.random.default_rng(0)
    place = BOARD.corners()
    turned = place @ (scale * np.array([[np.cos(0.1), np.sin(0.1)], [-np.sin(0.1), np.cos(0.1)]])) + 200.0
    found = []
    for _ in range(300):
        corners = turned + noise * rng.standard_normal(turned.shape)
        view = BoardView(place, corners)
        monkeypatch.setattr(board_fits, "find_board", lambda image, board, view=view: view)
        found.append(fit_scale(np.zeros((480, 640), np.uint8), BOARD))
    true = noise / np.sqrt(np.sum((place - np.mean(place, axis=0)) ** 2))
    # 300 estimates of a variance with 92 degrees of freedom: 0.9 %; 300 scales: 4 % of their scatter.
    assert np.sqrt(np.mean([fit.sd**2 for fit in found])) == pytest.approx(true, rel=0.015)
    assert np.std([fit.pixels_per_metre for fit in found]) == pytest.approx(true, rel=0.15)
    assert np.mean([fit.pixels_per_metre for fit in found]) == pytest.approx(scale, rel=1e-4)


def test_the_smallest_board_has_three_by_three_corners():
    assert (Board(3, 3, 0.02).columns, Board(3, 3, 0.02).rows) == (3, 3)
    with pytest.raises(CalibrationError, match="6 x 2 inner corners"):
        Board(6, 2, 0.02)


@pytest.mark.parametrize("truth", [(), ("k1",), ("k1", "p1", "p2")])
def test_the_coefficients_that_corners_support_are_chosen_and_scatter_as_stated(truth):
    rng = np.random.default_rng([7, len(truth)])
    values = {"k1": -0.2, "p1": 0.004, "p2": -0.003}
    distortion = np.array(
        [values.get(name, 0.0) if name in truth else 0.0 for name in board_fits.COEFFICIENTS]
    )
    matrix = np.array([[900.0, 0.0, 322.0], [0.0, 905.0, 238.0], [0.0, 0.0, 1.0]])
    place = np.hstack([BOARD.corners(), np.zeros((48, 1))])
    deviations = []
    for _ in range(4):
        views = []
        for _ in range(6):
            shift = np.array([-0.07, -0.05, 0.36]) + rng.uniform(-0.03, 0.03, 3)
            seen, _ = cv2.projectPoints(place, rng.uniform(-0.4, 0.4, 3), shift, matrix, distortion)
            corners = seen.reshape(-1, 2) + 0.05 * rng.standard_normal((48, 2))
            views.append(BoardView(BOARD.corners(), corners))
        fit = board_fits.fit_lens_to_views(views, (640, 480))
        assert fit.coefficients == truth
        deviations += [
            (found - true) / sd
            for found, true, sd in zip(
                (*fit.lens.focal_px, *fit.lens.centre_px),
                (900.0, 905.0, 322.0, 238.0),
                (*fit.focal_sd_px, *fit.centre_sd_px),
                strict=True,
            )
        ]
    # Sixteen numbers, of which fx and fy go together.
    assert 0.5 < np.sqrt(np.mean(np.square(deviations))) < 1.6


MATRIX = np.array([[900.0, 0.0, 322.0], [0.0, 900.0, 238.0], [0.0, 0.0, 1.0]])
CORNERS = np.hstack([BOARD.corners(), np.zeros((48, 1))])


def seen(rng, rotation, translation, k1=0.0, noise=0.04):
    """Corners where a pinhole images them, with white noise."""
    distortion = np.array([k1, 0.0, 0.0, 0.0, 0.0])
    places, _ = cv2.projectPoints(
        CORNERS, np.array(rotation, float), np.array(translation, float), MATRIX, distortion
    )
    return BoardView(BOARD.corners(), places.reshape(-1, 2) + noise * rng.standard_normal((48, 2)))


def tilted_about(rng, tilt, spread):
    """A pose with this tilt in any direction [rad], shifted by so much of what leaves it in view."""
    around = rng.uniform(0.0, 2.0 * np.pi)
    shift = np.array([-0.07, -0.05, 0.55]) + spread * np.array([0.05, 0.04, 0.1]) * rng.uniform(-1.0, 1.0, 3)
    return tilt * np.array([np.cos(around), np.sin(around), 0.0]), shift


@pytest.mark.slow
@pytest.mark.parametrize("k1", [0.0, -0.2])
@pytest.mark.parametrize("spread", [0.0, 1.0])
@pytest.mark.parametrize("n_views", [6, 12])
def test_a_board_that_is_never_tilted_gives_no_lens(k1, spread, n_views):
    for seed in range(2):
        rng = np.random.default_rng([seed, n_views])
        views = [seen(rng, *tilted_about(rng, 0.0, spread), k1) for _ in range(n_views)]
        with pytest.raises(
            UndeterminedLensError, match=r"leave the focal length open .* tilt it by 20 to 40"
        ):
            board_fits.fit_lens_to_views(views, (640, 480))


@pytest.mark.slow
def test_a_board_that_keeps_one_tilt_gives_no_lens():
    # All turned alike, wherever they are: each picture repeats what the first one says of the matrix.
    for seed in range(2):
        rng = np.random.default_rng(seed)
        turn, _ = tilted_about(rng, 0.5, 0.0)
        views = [seen(rng, turn, tilted_about(rng, 0.0, 1.0)[1]) for _ in range(6)]
        with pytest.raises(UndeterminedLensError):
            board_fits.fit_lens_to_views(views, (640, 480))


def test_copies_of_a_picture_count_once():
    with pytest.raises(CalibrationError, match="in 3 of 9 pictures, of which 3 are different ones"):
        fit_lens([picture(*pose) for pose in POSES[:3]] * 3, BOARD)


@pytest.mark.slow
@pytest.mark.parametrize("tilt", [0.1, 0.5])
def test_lens_and_scale_scatter_as_stated(tilt, monkeypatch):
    deviations, scales = [], []
    for seed in range(16):
        rng = np.random.default_rng([seed, 5])
        views = [seen(rng, *tilted_about(rng, tilt, 1.0), -0.2) for _ in range(8)]
        # Away from the centre, so that the lens's part is most of it.
        plane = seen(rng, [0.0, 0.0, 0.0], [0.05, 0.02, 0.6], -0.2)
        fit = board_fits.fit_lens_to_views([plane, *views], (640, 480))
        found = (*fit.lens.focal_px, *fit.lens.centre_px, fit.lens.distortion[0])
        sds = (*fit.focal_sd_px, *fit.centre_sd_px, fit.distortion_sd[0])
        deviations.append((np.array(found) - [900.0, 900.0, 322.0, 238.0, -0.2]) / sds)
        monkeypatch.setattr(board_fits, "find_board", lambda image, board, view=plane: view)
        blank = np.zeros((480, 640), np.uint8)
        scale = fit_scale(blank, BOARD, fit.lens, fit.covariance)
        scales.append((scale.pixels_per_metre - 900.0 / 0.6) / scale.sd)
        assert scale.sd > 2.0 * fit_scale(blank, BOARD, fit.lens).sd
    # 16 draws: an RMS is known to 18 %; three of these.
    assert np.all(np.abs(np.sqrt(np.mean(np.square(deviations), axis=0)) - 1.0) < 0.54)
    assert abs(np.sqrt(np.mean(np.square(scales))) - 1.0) < 0.54


@pytest.mark.parametrize(("bend_px", "is_plane"), [(0.0, True), (4.0, True), (30.0, False)])
def test_a_board_that_is_no_plane_gives_no_scale(bend_px, is_plane):
    flat = picture(*POSES[0])
    v, u = np.mgrid[:480, :640].astype(np.float32)
    bent = cv2.remap(flat, u + bend_px * np.sin(v / 60).astype(np.float32), v, cv2.INTER_LINEAR)
    if is_plane:
        assert fit_scale(bent, BOARD).residual_rms_px < 5.0
    else:
        with pytest.raises(
            CalibrationError, match=r"lie \d+ px \(RMS\) off the image of any plane; .* hold the board flat"
        ):
            fit_scale(bent, BOARD)
