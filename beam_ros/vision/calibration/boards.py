"""Printed boards and their points in a picture: checkerboards, ChArUco boards, grids of ArUco markers.

A checkerboard is described by its inner corners, as everywhere in ROS (9 x 7 squares have 8 x 6 of them), and must be
in view as a whole. The markers on the other two say which point is which, so that a part of them will do. OpenCV
finds the points; its interface to the markers changed in version 4.7, and both are served here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal, get_args

import cv2
import numpy as np

from beam_ros.arrays import FloatArray, ImageArray, IndexArray
from beam_ros.errors import suggestion
from beam_ros.vision.errors import CalibrationError

Pattern = Literal["checkerboard", "charuco", "aruco"]
PATTERNS: tuple[Pattern, ...] = get_args(Pattern)

_MIN_COUNTS = {"checkerboard": 3, "charuco": 3, "aruco": 2}
_COUNTED = {"checkerboard": "inner corners", "charuco": "inner corners", "aruco": "markers"}
_MIN_POINTS = 6
CORNER_WINDOW_PX = 5
"""A corner is looked for so far to every side of where it first seems to be [px]."""
_FLAT = 0.05
"""Points whose spread across is a smaller share of that along lie on a line, from which nothing can be fitted."""


@dataclass(frozen=True)
class Board:
    """A printed board.

    Attributes
    ----------
    columns, rows : int -- inner corners; of a grid of ArUco markers: markers
    square_m : float -- edge of a square; of a grid: from one marker's edge to the same edge of the next [m]
    square_sd_m : float -- its standard deviation, by the ruler that measured it [m]
    pattern : str -- checkerboard, charuco or aruco
    marker_m : float -- edge of a marker, for charuco and aruco [m]
    dictionary : str -- of the markers, as "5x5_100"
    """

    columns: int
    rows: int
    square_m: float
    square_sd_m: float = 0.0
    pattern: Pattern = "checkerboard"
    marker_m: float = 0.0
    dictionary: str = ""

    def __post_init__(self) -> None:
        if self.pattern not in PATTERNS:
            raise CalibrationError(f"board is a {self.pattern!r}; expected one of {', '.join(PATTERNS)}")
        least = _MIN_COUNTS[self.pattern]
        if self.columns < least or self.rows < least:
            raise CalibrationError(
                f"{self.pattern} has {self.columns} x {self.rows} {self.counted}; expected at least {least} x "
                f"{least}: count them again for --board"
            )
        if not (0 < self.square_m < math.inf and 0 <= self.square_sd_m < math.inf):
            raise CalibrationError(
                f"{self.pattern} has squares of {self.square_m!r} +- {self.square_sd_m!r} m; expected metres > 0 and "
                "a standard deviation of 0 or more: measure them, and give --square and --square-sd"
            )
        if self.pattern != "checkerboard":
            if not 0 < self.marker_m < self.square_m:
                raise CalibrationError(
                    f"markers of the {self.pattern} board are {self.marker_m!r} m wide; expected more than 0 and "
                    f"less than {self.square_m:g} m, the distance from one to the next: give --marker"
                )
            _dictionary(self.dictionary)

    @property
    def counted(self) -> str:
        """What columns and rows count."""
        return _COUNTED[self.pattern]

    def corners(self) -> FloatArray:
        """Positions of the inner corners, or of the markers' first corners, shape (columns * rows, 2) [m]."""
        y, x = np.mgrid[: self.rows, : self.columns]
        return np.stack([x.ravel(), y.ravel()], axis=1) * self.square_m


@dataclass(frozen=True)
class BoardView:
    """Points of a board in a picture.

    Attributes
    ----------
    board_m : ndarray, shape (n, 2) -- on the board [m]
    image_px : ndarray, shape (n, 2) -- u, v in the picture [px]
    """

    board_m: FloatArray
    image_px: FloatArray


def find_board(image: ImageArray, board: Board) -> BoardView:
    """Find a board's points in a picture.

    Parameters
    ----------
    image : ndarray, shape (height, width), uint8 or uint16
    board : Board

    Returns
    -------
    BoardView -- all points of a checkerboard, those in view of the other boards

    Raises
    ------
    CalibrationError -- the board, or enough of it, is not in view; or this OpenCV knows no ArUco markers
    """
    grey = image
    if image.dtype == np.uint16:
        grey = np.asarray(image.astype(np.float32) * (255.0 / max(int(image.max()), 1)), dtype=np.uint8)
    grey = np.ascontiguousarray(grey)
    find = {"checkerboard": _checkerboard, "charuco": _charuco, "aruco": _aruco}[board.pattern]
    numbers, found = find(grey, board)
    place = _points(board)[numbers]
    if len(place) < _MIN_POINTS or _is_line(place):
        raise CalibrationError(
            f"no {board.pattern} of {board.columns} x {board.rows} {board.counted} in the image of {image.shape[1]} "
            f"x {image.shape[0]}; expected {'all' if board.pattern == 'checkerboard' else 'most'} of it in view, "
            "sharp and evenly lit"
            + ("" if board.pattern == "checkerboard" else f", of dictionary {board.dictionary}")
        )
    return BoardView(place, found)


def _points(board: Board) -> FloatArray:
    """All points that a picture may show, in the order of their numbers [m]."""
    corners = board.corners()
    if board.pattern != "aruco":
        return corners
    around = board.marker_m * np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    return np.asarray((corners[:, None, :] + around).reshape(-1, 2))


def _is_line(place: FloatArray) -> bool:
    spread = np.linalg.svd(place - place.mean(axis=0), compute_uv=False)
    return bool(spread[1] < _FLAT * spread[0])


def _checkerboard(grey: ImageArray, board: Board) -> tuple[IndexArray, FloatArray]:
    """Numbers and places of the corners, all or none."""
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
    is_found, corners = cv2.findChessboardCorners(grey, (board.columns, board.rows), flags=flags)
    if not is_found:
        return np.empty(0, dtype=np.intp), np.empty((0, 2))
    window = (CORNER_WINDOW_PX, CORNER_WINDOW_PX)
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 60, 1e-4)
    refined = cv2.cornerSubPix(grey, corners, window, (-1, -1), criteria)
    return np.arange(board.columns * board.rows), np.asarray(refined, dtype=np.float64).reshape(-1, 2)


# --- markers ----------------------------------------------------------------------------------------------


def dictionary_names() -> tuple[str, ...]:
    """Names of the dictionaries that this OpenCV knows, "4x4_50" and so on.

    Raises
    ------
    CalibrationError -- this OpenCV knows no ArUco markers
    """
    aruco = _module()
    return tuple(sorted({name[5:].lower() for name in dir(aruco) if name.startswith("DICT_")}))


def _module() -> Any:
    aruco = getattr(cv2, "aruco", None)
    if aruco is None or not hasattr(aruco, "getPredefinedDictionary"):
        raise CalibrationError(
            f"OpenCV {cv2.__version__} is without ArUco markers: expected 4.7 or newer, or an older one with its "
            "contributed modules; use a checkerboard, or install a newer opencv-python-headless"
        )
    return aruco


def _dictionary(name: str) -> Any:
    aruco, known = _module(), dictionary_names()
    if name.lower() not in known:
        raise CalibrationError(
            f"there is no dictionary of markers {name!r} ({suggestion(name.lower(), known)}): give --dictionary the "
            "one that the board was printed with"
        )
    constants = {constant.lower(): constant for constant in dir(aruco)}
    return aruco.getPredefinedDictionary(getattr(aruco, constants[f"dict_{name.lower()}"]))


def _charuco(grey: ImageArray, board: Board) -> tuple[IndexArray, FloatArray]:
    """Numbers and places of the corners between the markers that were read."""
    aruco, dictionary = _module(), _dictionary(board.dictionary)
    squares = (board.columns + 1, board.rows + 1)
    if not hasattr(aruco, "CharucoDetector"):
        printed = aruco.CharucoBoard_create(*squares, board.square_m, board.marker_m, dictionary)
        corners, ids, _ = aruco.detectMarkers(grey, dictionary)
        if ids is None:
            return _numbered(None, None)
        _, corners, ids = aruco.interpolateCornersCharuco(corners, ids, grey, printed)
        return _numbered(ids, corners)
    found = []
    # Boards with an even number of rows of squares were printed the other way round before OpenCV 4.6.
    for is_old in (False, True):
        printed = aruco.CharucoBoard(squares, board.square_m, board.marker_m, dictionary)
        printed.setLegacyPattern(is_old)
        corners, ids, _, _ = aruco.CharucoDetector(printed).detectBoard(grey)
        found.append(_numbered(ids, corners))
    return max(found, key=lambda numbered: len(numbered[0]))


def _aruco(grey: ImageArray, board: Board) -> tuple[IndexArray, FloatArray]:
    """Numbers and places of the corners of the markers that were read, four each."""
    aruco, dictionary = _module(), _dictionary(board.dictionary)
    is_old = not hasattr(aruco, "ArucoDetector")
    parameters = aruco.DetectorParameters_create() if is_old else aruco.DetectorParameters()
    # Lines through a marker's edges cross at its corner; the other refinements draw blurred corners inwards, which
    # makes the scale 0.1 to 0.4 % too small.
    parameters.cornerRefinementMethod = aruco.CORNER_REFINE_APRILTAG
    if is_old:
        corners, ids, _ = aruco.detectMarkers(grey, dictionary, parameters=parameters)
    else:
        corners, ids, _ = aruco.ArucoDetector(dictionary, parameters).detectMarkers(grey)
    if ids is None or not len(ids):
        return _numbered(None, None)
    numbers, places = np.asarray(ids).ravel(), np.asarray(corners, dtype=np.float64).reshape(-1, 4, 2)
    is_own = numbers < board.columns * board.rows
    return (
        np.asarray((4 * numbers[is_own][:, None] + np.arange(4)).ravel(), dtype=np.intp),
        places[is_own].reshape(-1, 2),
    )


def _numbered(ids: Any, corners: Any) -> tuple[IndexArray, FloatArray]:
    if ids is None or corners is None or not len(ids):
        return np.empty(0, dtype=np.intp), np.empty((0, 2))
    return (
        np.asarray(ids, dtype=np.intp).ravel(),
        np.asarray(corners, dtype=np.float64).reshape(-1, 2),
    )
