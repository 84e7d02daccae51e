"""Settings of the camera and the tracker: frozen, validated parameters.

Pixel convention, everywhere in this package: u runs to the right along the columns, v downwards along the
rows, and *integer coordinates lie at pixel centres*: the centre of the image's first pixel is (0, 0), its
outer corner (-0.5, -0.5). A position of 320.25 is a quarter of a pixel to the right of the centre of
column 320. The beam stands upright in the image:

    u = u0 + s x pixels_per_metre        s = +1, or -1 where ``flip`` says that the camera looks from behind
    v = v0 - z pixels_per_metre          z along the beam from the clamp, so that the tip is at the top
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from beam_ros.arrays import FloatArray
from beam_ros.vision.errors import VisionParameterError

StampMeaning = Literal["start", "mid", "end", "arrival"]
Polarity = Literal["bright", "dark"]
Refinement = Literal["none", "radial_symmetry", "disc_model"]

WHITES = frozenset(white for k in (10, 12, 14) for white in (2**k - 1, 2**16 - 2 ** (16 - k)))
"""White of cameras that fill part of 16 bits, from below or from above."""
PERFECT_DISC_SIGMA_PX = 0.0003
"""What sampling leaves of a perfect disc's position [px]: no standard deviation is smaller."""


_SMEAR = 0.75
"""Longest smear that leaves a marker's image its plateau, over the marker's diameter."""
_APART_PX = 5.5
"""Room between two markers, one above the other, beside half a smear [px]: their blurred rims, and some ground."""
_ROOM = 0.45
"""The tolerance of a marker's row is at most this share of the way to the next marker."""


def _require(condition: bool, name: str, value: object, expected: str) -> None:
    if not condition:
        raise VisionParameterError(f"{name} is {value!r}; expected {expected}: correct it in the rig file")


def _is_finite(value: object) -> bool:
    return isinstance(value, (int, float, np.integer, np.floating)) and math.isfinite(float(value))


def _require_number(
    owner: object, name: str, minimum: float, maximum: float = math.inf, *, open_below: bool = False
) -> None:
    value = getattr(owner, name)
    bound = f"{'>' if open_below else '>='} {minimum:g}" + (
        f" and <= {maximum:g}" if maximum < math.inf else ""
    )
    inside = False
    if _is_finite(value):
        number = float(value)
        inside = (number > minimum if open_below else number >= minimum) and number <= maximum
    _require(inside, f"{type(owner).__name__}.{name}", value, f"a number {bound}")


def _require_word(owner: object, name: str, words: object) -> None:
    value, known = getattr(owner, name), get_args(words)
    _require(value in known, f"{type(owner).__name__}.{name}", value, f"one of {', '.join(known)}")


@dataclass(frozen=True)
class CameraParameters:
    """The camera, as the renderer imitates it and the tracker's time stamps need it.

    Attributes
    ----------
    width, height : int -- image size [px]
    rate_hz : float -- frames per second [Hz]
    exposure_s : float -- exposure of every row [s]; must fit into a frame period
    readout_s : float -- rolling shutter: delay of the last row's exposure after the first row's [s];
        0 is a global shutter
    pixels_per_metre : float -- scale [px/m]
    origin_px : (float, float) -- (u0, v0), image of the clamp at home [px]
    flip : bool -- True for a camera that looks from behind: +x points to the left in the image
    marker_diameter_m : float -- diameter of the round markers [m]
    contrast : float -- marker above background [grey levels of 255]; negative is dark on bright
    background : float -- background [grey levels of 255]
    strip_width_m : float -- apparent width of the strip seen edge-on [m]
    blur_px : float -- standard deviation of the lens's Gaussian blur [px]
    noise_grey : float -- standard deviation of the white noise of a pixel [grey levels of 255]
    stamp : "start", "mid", "end", "arrival" -- which instant of the exposure the image's stamp means; see
        ``vision.timing``
    latency_s : float -- how much later the stamp is than that instant [s]
    name, focus : str -- camera and setting of its lens, which calibrations hold for; "" where it is not said
    strip_contrast : float -- strip above background [grey levels of 255]; its sign follows the contrast
    """

    width: int
    height: int
    rate_hz: float
    exposure_s: float
    readout_s: float
    pixels_per_metre: float
    origin_px: tuple[float, float]
    flip: bool
    marker_diameter_m: float
    contrast: float
    background: float
    strip_width_m: float
    blur_px: float
    noise_grey: float
    stamp: StampMeaning
    latency_s: float
    name: str
    focus: str
    strip_contrast: float = 12.0

    def __post_init__(self) -> None:
        for name in ("width", "height"):
            value = getattr(self, name)
            _require(
                isinstance(value, (int, np.integer)) and 16 <= int(value) <= 16384,
                f"CameraParameters.{name}",
                value,
                "a whole number of pixels from 16 to 16384",
            )
        _require_number(self, "rate_hz", 0.0, 100_000.0, open_below=True)
        _require_number(self, "exposure_s", 0.0)
        _require_number(self, "readout_s", 0.0)
        _require_number(self, "pixels_per_metre", 0.0, open_below=True)
        _require_number(self, "marker_diameter_m", 0.0, open_below=True)
        _require_number(self, "contrast", -255.0, 255.0)
        _require_number(self, "background", 0.0, 255.0)
        _require_number(self, "strip_contrast", 0.0, 255.0)
        _require_number(self, "strip_width_m", 0.0)
        _require_number(self, "blur_px", 0.0, 20.0)
        _require_number(self, "noise_grey", 0.0, 128.0)
        _require_number(self, "latency_s", -1.0, 10.0)
        for key, seconds in (("camera.exposure", self.exposure_s), ("camera.readout", self.readout_s)):
            if seconds > self.period_s * (1 + 1e-9):
                raise VisionParameterError(
                    f"{key} is {seconds:g} s; expected at most the frame period of {self.period_s:g} s "
                    f"(camera.rate {self.rate_hz:g} Hz): correct it, or the rate, in the rig file"
                )
        origin = self.origin_px
        _require(
            isinstance(origin, Sequence) and len(origin) == 2 and all(_is_finite(c) for c in origin),
            "CameraParameters.origin_px",
            origin,
            "two numbers (u0, v0) in pixels",
        )
        object.__setattr__(self, "origin_px", (float(origin[0]), float(origin[1])))
        _require(self.contrast != 0, "CameraParameters.contrast", self.contrast, "a contrast other than 0")
        grey, polarity = self.background + self.contrast, "bright" if self.contrast > 0 else "dark"
        if not 0 <= grey <= 255:
            raise VisionParameterError(
                f"the markers' grey level by camera.background {self.background:g}, camera.contrast "
                f"{abs(self.contrast):g} and tracker.polarity {polarity} is {grey:g}; "
                "expected a level from 0 to 255: correct it in the rig file, by a lower camera.contrast"
            )
        _require_word(self, "stamp", StampMeaning)
        _require(
            self.marker_diameter_px >= 2.0,
            "CameraParameters.marker_diameter_m",
            self.marker_diameter_m,
            f"markers of at least 2 px in the image (they are {self.marker_diameter_px:.2g} px)",
        )

    @property
    def period_s(self) -> float:
        """Frame period [s]."""
        return 1.0 / self.rate_hz

    @property
    def marker_diameter_px(self) -> float:
        """Diameter of a marker in the image [px]."""
        return self.marker_diameter_m * self.pixels_per_metre

    @property
    def direction(self) -> int:
        """Sign of du/dx: +1, or -1 with ``flip``."""
        return -1 if self.flip else 1

    def columns(self, x: npt.ArrayLike) -> FloatArray:
        """Image columns u of positions along x.

        Parameters
        ----------
        x : array_like -- positions along the hub's travel [m]

        Returns
        -------
        ndarray, same shape -- u [px]
        """
        scale = self.direction * self.pixels_per_metre
        return np.asarray(self.origin_px[0] + scale * np.asarray(x, dtype=np.float64))

    def rows(self, heights: npt.ArrayLike) -> FloatArray:
        """Image rows v of heights above the clamp.

        Parameters
        ----------
        heights : array_like -- z along the beam [m]

        Returns
        -------
        ndarray, same shape -- v [px]
        """
        return np.asarray(self.origin_px[1] - self.pixels_per_metre * np.asarray(heights, dtype=np.float64))

    def heights(self, rows: FloatArray) -> FloatArray:
        """Heights above the clamp of image rows [m]: the reverse of ``rows``."""
        return np.asarray((self.origin_px[1] - rows) / self.pixels_per_metre)


@dataclass(frozen=True)
class TrackerParameters:
    """What the tracker expects of the markers and when it distrusts them.

    Attributes
    ----------
    marker_diameter_px : float -- expected diameter of the markers [px]
    polarity : "bright" or "dark" -- markers bright on dark, or dark on bright
    min_contrast_grey : float -- contrast below which nothing is a marker [grey levels of the image]
    sigma_floor_px : float -- added in quadrature to every stated standard deviation [px]: at least
        ``PERFECT_DISC_SIGMA_PX``; print, lighting and pixel response leave some 0.02 on real dots
    refinement : "none", "radial_symmetry", "disc_model" -- what is made of the centre of gravity: nothing, for
        markers that are no discs; the centre of the gradients; or a fitted disc, which is at the noise limit and sure
        of its noise
    expected_rows_px : tuple of float or None -- image rows of the markers, lowest marker (largest row)
        first [px]; lets the tracker distinguish markers from other spots. None: exactly as many spots as markers
        must be in view when they are acquired
    expected_row_tolerance_px : float -- tolerance of these rows, and how far a jump may take the markers across
        the rows [px]
    max_bend_px : float -- farthest that two markers may be apart along u; what is farther from the markers that
        are followed is not acquired [px]
    aspect : float -- width of a marker's image over its height: 1 for a disc seen head-on, cos(angle) for one
        that is turned about the beam
    level_fraction : float -- what is subtracted from the region before its centroid is taken, as a fraction
        of the marker's contrast above the background
    max_jump_px : float -- largest distance between prediction and measurement of a seen marker [px]; a lost
        marker's grows by a quarter of it with every frame, up to ``max_gate_px``
    row_gate_px : float -- largest distance across the rows from where the marker was last seen [px]: the
        beam moves along u
    max_smear_px : float -- longest motion within an exposure that still counts as a marker's image [px]; a
        marker that moves by more than its diameter has no plateau left and is not recognised
    diameter_tolerance : float -- relative tolerance of the diameter against ``marker_diameter_px`` when
        markers are acquired
    area_tolerance : float -- relative tolerance of the area against the marker's own at acquisition, beside
        five standard deviations of the image noise
    shape_tolerance : float -- tolerance of the second moments (relative) and of the asymmetry (third moments
        over the cube of the radius of gyration) against the marker's own, beside five standard deviations
    brightness_tolerance : float -- relative tolerance of the brightness against its slow average
    region_px : tuple of 4 float or None -- first and last column, first and last row of the part of the picture in
        which markers are looked for [px]; None: all of it
    noise_grey : float or None -- noise of a pixel [grey levels of the image]; None measures it
    noise_line : (float, float) or None -- variance of a pixel at level 0 [grey levels^2], and its growth with the
        level [grey levels]; None measures them
    """

    marker_diameter_px: float
    polarity: Polarity
    min_contrast_grey: float
    sigma_floor_px: float
    refinement: Refinement
    expected_rows_px: tuple[float, ...] | None = None
    expected_row_tolerance_px: float = 15.0
    max_bend_px: float = math.inf
    aspect: float = 1.0
    level_fraction: float = 0.05
    max_jump_px: float = 24.0
    row_gate_px: float = 5.0
    max_smear_px: float = 9.0
    diameter_tolerance: float = 0.35
    area_tolerance: float = 0.04
    shape_tolerance: float = 0.03
    brightness_tolerance: float = 0.30
    region_px: tuple[float, ...] | None = None
    noise_grey: float | None = None
    noise_line: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        _require_number(self, "marker_diameter_px", 3.0, 500.0)
        _require_number(self, "min_contrast_grey", 1.0)
        _require(self.max_bend_px > 0, "TrackerParameters.max_bend_px", self.max_bend_px, "a number > 0")
        _require_number(self, "aspect", 0.5, 2.0)
        _require_number(self, "level_fraction", 0.02, 0.6)
        _require_number(self, "max_jump_px", 1.0)
        _require_number(self, "row_gate_px", 0.5)
        _require_number(self, "max_smear_px", 0.0)
        for name in (
            "diameter_tolerance",
            "area_tolerance",
            "shape_tolerance",
            "brightness_tolerance",
        ):
            _require_number(self, name, 0.01, 0.9)
        _require_number(self, "sigma_floor_px", 0.0)
        _require_number(self, "expected_row_tolerance_px", 0.0, open_below=True)
        if self.noise_grey is not None:
            _require_number(self, "noise_grey", 0.0)
        if self.noise_line is not None:
            _require(
                len(self.noise_line) == 2
                and all(_is_finite(value) for value in self.noise_line)
                and self.noise_line[1] >= 0.0,
                "TrackerParameters.noise_line",
                self.noise_line,
                "a variance and its growth with the level, >= 0",
            )
        _require_word(self, "polarity", Polarity)
        _require_word(self, "refinement", Refinement)
        if self.region_px is not None:
            self._require_region(self.region_px)
        if self.expected_rows_px is not None:
            rows = tuple(float(row) for row in self.expected_rows_px)
            least = self.marker_diameter_px + self.max_smear_px / 2 + _APART_PX
            gaps = [lower - upper for lower, upper in pairwise(rows)]
            if not all(math.isfinite(row) for row in rows) or min(gaps, default=math.inf) < least:
                raise VisionParameterError(
                    f"the markers' rows in the image are {[round(row, 1) for row in rows]}; expected them falling, "
                    f"at least {least:.3g} px apart: correct markers.heights and camera.pixels_per_metre"
                )
            object.__setattr__(self, "expected_rows_px", rows)
            # A row between two markers belongs to neither.
            tolerance = min([self.expected_row_tolerance_px, *(_ROOM * gap for gap in gaps)])
            object.__setattr__(self, "expected_row_tolerance_px", tolerance)

    def _require_region(self, region: tuple[float, ...]) -> None:
        """Check that a part of the picture has room for the markers, and holds their rows."""
        room = 2 * self.marker_diameter_px
        _require(
            len(region) == 4
            and all(map(_is_finite, region))
            and min(region[0], region[2]) >= 0.0
            and min(region[1] - region[0], region[3] - region[2]) >= room,
            "tracker.region",
            region,
            f"first and last column, first and last row, at least {room:g} px apart",
        )
        # Whether the rows lie in the picture is not this check's business.
        first = region[2] or -math.inf
        outside = [row for row in self.expected_rows_px or () if not first <= row <= region[3]]
        _require(
            not outside,
            "tracker.region",
            region,
            f"rows that hold all markers (outside lie {[round(row, 1) for row in outside]})",
        )

    @property
    def max_gate_px(self) -> float:
        """How far from where it was last seen a lost marker is believed, at most [px]."""
        return 10.0 / 3.0 * self.max_jump_px

    @property
    def gate_growth_px(self) -> float:
        """By how much the distance at which a lost marker is believed grows with every frame [px]."""
        return 0.25 * self.max_jump_px

    @classmethod
    def for_camera(
        cls, camera: CameraParameters, marker_heights: npt.ArrayLike, **others: object
    ) -> TrackerParameters:
        """Parameters that follow from the camera and the marker heights.

        Parameters
        ----------
        camera : CameraParameters -- gives diameter, polarity and rows
        marker_heights : array_like, shape (n_markers,) -- heights above the clamp, rising [m]
        **others -- the other fields

        Returns
        -------
        TrackerParameters
        """
        derived: dict[str, object] = {
            "marker_diameter_px": camera.marker_diameter_px,
            "max_smear_px": max(cls.max_smear_px, _SMEAR * camera.marker_diameter_px),
            "polarity": "bright" if camera.contrast > 0 else "dark",
            "expected_rows_px": tuple(float(row) for row in camera.rows(marker_heights)),
        }
        return cls(**{**derived, **others})  # type: ignore[arg-type]
