"""Sub-pixel positions of the beam's markers, frame after frame, and when not to believe them.

Markers are *acquired* in the whole image (threshold, contours, gates on size and roundness) and named by
their order along the beam: marker 0 is the lowest in the image. From then on each is *tracked* in a small
region about its prediction. There the background plus a tenth of the marker's contrast is subtracted with
saturation, which silences the background without the error of a hard threshold, and the centre of gravity
of the rest is the measurement. It is the mean position over the exposure, however far the marker moved.

Every measurement passes gates on area, shape, asymmetry, brightness, surroundings and motion. One that
fails is reported as not valid, with the reason, in the same frame; the gate about the prediction then grows
until a spot with the marker's own area and shape is found in the marker's own row, alone. A marker that
cannot be told from another spot stays lost: nothing is invented and identities are never exchanged.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from beam_ros.vision.errors import ImageFormatError, VisionParameterError
from beam_ros.vision.parameters import TrackerParameters
from beam_ros.vision.timing import FrameTiming

Reason = Literal[
    "ok",
    "not_acquired",
    "no_contrast",
    "hidden",
    "ambiguous",
    "area",
    "shape",
    "asymmetry",
    "brightness",
    "surroundings",
    "jump",
    "border",
]
"""Why a measurement is not valid; "ok" where it is.

not_acquired: the marker has not been found yet; no_contrast: nothing in the image stands out; hidden: no
spot where the marker should be; ambiguous: more spots than markers; area, shape, asymmetry, brightness: the
spot differs from the marker as acquired (covered, merged with another spot, out of focus); surroundings: the
background beside the marker has changed (glare, an object); jump: too far from the prediction; border: cut
by the edge of the image.
"""

_MAX_PASSES = 4
"""The region is centred anew on what it shows at most this often."""
_CENTRED_PX = 0.8
"""A marker this close to its region's centre needs no further pass [px]; rounding alone leaves 0.5."""
_SLOW = 0.02
"""Weight of a new frame in the slow averages of brightness, background and noise."""
_ACQUISITION_THRESHOLDS = (0.5, 0.3, 0.7)
"""Fractions of the image's brightest contrast at which spots are looked for."""
_NOISE_LEVEL = 2.5
"""The subtracted level lies at least this many noise standard deviations above the background."""
_QUANTISATION_VARIANCE = 1.0 / 12.0
_FORGET_AFTER_FRAMES = 100
"""A marker lost for longer is acquired anew: its own area and shape may have changed."""


class MarkerMeasurement(NamedTuple):
    """One marker in one frame (a named tuple because four are made in every 100 microseconds).

    Attributes
    ----------
    u_px, v_px : float -- centre, integer coordinates at pixel centres [px]; NaN when not valid
    sigma_px : float -- standard deviation of u_px [px]; NaN when not valid
    is_valid : bool -- False: not seen, or seen and not believed
    reason : Reason -- "ok", or why not
    stamp_ns : int -- middle of the exposure of the marker's row [ns]
    contrast_grey : float -- slow average of the marker above its background [grey levels]
    area_px : float -- effective area of what was seen [px^2]; NaN when nothing was
    """

    u_px: float
    v_px: float
    sigma_px: float
    is_valid: bool
    reason: Reason
    stamp_ns: int
    contrast_grey: float
    area_px: float


class FrameResult(NamedTuple):
    """What the tracker saw in one frame.

    Attributes
    ----------
    stamp_ns : int -- stamp of the frame [ns]
    markers : tuple of MarkerMeasurement -- lowest marker first
    """

    stamp_ns: int
    markers: tuple[MarkerMeasurement, ...]

    @property
    def is_complete(self) -> bool:
        """True when every marker is valid."""
        return all(marker.is_valid for marker in self.markers)


@dataclass(frozen=True)
class _Reference:
    """A marker as it was acquired: what later frames are compared with."""

    area: float
    variance: float
    skew_u: float
    skew_v: float
    row: float


@dataclass
class _Marker:
    """State of one marker between frames."""

    reference: _Reference | None = None
    known_row: float | None = None
    u: float = math.nan
    v: float = math.nan
    velocity: float = 0.0
    hold_error: float = 1.0
    linear_error: float = 1.0
    lost_frames: int = 0
    background: float = math.nan
    contrast: float = math.nan
    noise: float = math.nan
    support: float = 1.5


class _Spot(NamedTuple):
    """What a region shows: centre, moments and surroundings."""

    u: float
    v: float
    mass: float
    area: float
    variance_u: float
    variance_v: float
    covariance: float
    skew_u: float
    skew_v: float
    centre_grey: float
    side_grey: float
    side_variance: float
    side_difference: float
    speck_variance: float
    half: int


class MarkerTracker:
    """Follows the markers of one beam.

    Parameters
    ----------
    parameters : TrackerParameters -- expectations and gates
    n_markers : int -- number of markers on the beam
    timing : FrameTiming or None -- gives every measurement the middle of its own row's exposure; None
        gives it the stamp of the frame

    Notes
    -----
    The standard deviation of the centroid sum(s x) / sum(s) of the subtracted grey levels s is, for noise
    of variance sigma_n^2 in every pixel with s > 0 (the support) and its rectified rest elsewhere,

        sigma_u^2 = [ sigma_n^2 sum_support (u - u_c)^2 + sigma_r^2 sum_rest (u - u_c)^2 ] / (sum s)^2
    """

    def __init__(
        self, parameters: TrackerParameters, n_markers: int, timing: FrameTiming | None = None
    ) -> None:
        if n_markers < 1:
            raise VisionParameterError(f"n_markers is {n_markers}; expected at least one marker")
        rows = parameters.expected_rows_px
        if rows is not None and len(rows) != n_markers:
            raise VisionParameterError(
                f"TrackerParameters.expected_rows_px has {len(rows)} rows; expected {n_markers}, one per "
                "marker"
            )
        self.parameters = parameters
        self.n_markers = n_markers
        self.timing = timing
        radius = parameters.marker_diameter_px / 2
        self._half = math.ceil(radius + parameters.max_smear_px / 2 + 3)
        self._smear_variance = parameters.max_smear_px**2 / 12
        self._is_dark = parameters.polarity == "dark"
        self._markers: list[_Marker] = []
        self._shape: tuple[int, int] | None = None
        self._frame = 0
        self.reset()

    # -- state ---------------------------------------------------------------------------------------------

    def reset(self) -> None:
        """Forget every marker; the next frame starts with acquisition."""
        rows = self.parameters.expected_rows_px
        self._markers = [_Marker(known_row=None if rows is None else rows[k]) for k in range(self.n_markers)]
        self._shape = None
        self._frame = 0

    @property
    def is_acquired(self) -> bool:
        """True when every marker has been found since the last reset and none was given up."""
        return all(marker.reference is not None for marker in self._markers)

    @property
    def noise_grey(self) -> tuple[float, ...]:
        """Measured noise of a pixel about each marker [grey levels]; NaN before acquisition."""
        return tuple(marker.noise for marker in self._markers)

    @property
    def lost_frames(self) -> tuple[int, ...]:
        """Frames in a row in which each marker was not valid."""
        return tuple(marker.lost_frames for marker in self._markers)

    # -- frames --------------------------------------------------------------------------------------------

    def process(self, image: npt.NDArray[Any], stamp_ns: int) -> FrameResult:
        """Measure every marker in a frame.

        Parameters
        ----------
        image : ndarray, shape (height, width), uint8 or uint16 -- grey image
        stamp_ns : int -- stamp of the frame [ns]

        Returns
        -------
        FrameResult

        Raises
        ------
        ImageFormatError -- the image is not a two-dimensional uint8 or uint16 array
        """
        if image.ndim != 2 or (image.dtype != np.uint8 and image.dtype != np.uint16):
            raise ImageFormatError(
                f"image is {image.dtype} of shape {image.shape}; expected (height, width) of uint8 or "
                "uint16: "
                "convert it with grey_image()"
            )
        if self._shape != image.shape:
            if self._shape is not None:
                self.reset()
            self._shape = (int(image.shape[0]), int(image.shape[1]))
        self._frame += 1
        unknown: dict[int, Reason] = {}
        if any(marker.reference is None for marker in self._markers):
            unknown = self._acquire(image)
        measurements = []
        for k, marker in enumerate(self._markers):
            if k in unknown:
                measurements.append(self._invalid(marker, unknown[k], stamp_ns, math.nan))
            else:
                measurements.append(self._follow(image, marker, stamp_ns, k))
        return FrameResult(stamp_ns, tuple(measurements))

    def _stamp(self, stamp_ns: int, row: float) -> int:
        if self.timing is None or not math.isfinite(row):
            return stamp_ns
        return self.timing.row_middle(stamp_ns, row)

    def _invalid(self, marker: _Marker, reason: Reason, stamp_ns: int, area: float) -> MarkerMeasurement:
        marker.lost_frames += 1
        row = marker.v if math.isfinite(marker.v) else math.nan
        stamp = self._stamp(stamp_ns, row)
        return MarkerMeasurement(math.nan, math.nan, math.nan, False, reason, stamp, marker.contrast, area)

    def _follow(self, image: npt.NDArray[Any], marker: _Marker, stamp_ns: int, k: int) -> MarkerMeasurement:
        """Measure a known marker, look around for it when it is not where it should be."""
        reference = marker.reference
        assert reference is not None
        parameters = self.parameters
        lost = marker.lost_frames
        is_linear = lost == 0 and marker.linear_error < marker.hold_error
        predicted_u = marker.u + marker.velocity if is_linear else marker.u
        spot: _Spot | None = None
        reason: Reason = "hidden"
        if lost == 0:
            spot, reason = self._examine(image, predicted_u, marker.v, marker, reference)
            if reason == "ok" and spot is not None and abs(spot.u - predicted_u) > parameters.max_jump_px:
                reason = "jump"
        area = math.nan if spot is None else spot.area
        if reason == "hidden":
            gate = min(parameters.max_jump_px + lost * parameters.gate_growth_px, parameters.max_gate_px)
            spot, reason = self._search(image, predicted_u, marker, reference, gate)
            area = math.nan if spot is None else spot.area
        if reason == "ok" and spot is not None and self._is_taken(spot, k):
            reason = "ambiguous"
        if reason != "ok" or spot is None:
            result = self._invalid(marker, reason, stamp_ns, area)
            if marker.lost_frames > _FORGET_AFTER_FRAMES:
                marker.reference = None
            return result
        self._remember(image, marker, reference, spot, is_fresh=lost > 0, k=k)
        return MarkerMeasurement(
            spot.u,
            spot.v,
            self._sigma(marker, spot),
            True,
            "ok",
            self._stamp(stamp_ns, spot.v),
            marker.contrast,
            spot.area,
        )

    def _is_taken(self, spot: _Spot, k: int) -> bool:
        """True when another marker was last seen on this very spot."""
        near = self.parameters.marker_diameter_px / 2
        return any(
            j != k
            and other.reference is not None
            and other.lost_frames == 0
            and abs(other.u - spot.u) < near
            and abs(other.v - spot.v) < near
            for j, other in enumerate(self._markers)
        )

    def _remember(
        self,
        image: npt.NDArray[Any],
        marker: _Marker,
        reference: _Reference,
        spot: _Spot,
        *,
        is_fresh: bool,
        k: int,
    ) -> None:
        """Carry a valid measurement into the state."""
        if is_fresh:
            marker.velocity = 0.0
            marker.hold_error = marker.linear_error = 1.0
        else:
            step = spot.u - marker.u
            marker.hold_error += 0.2 * (abs(step) - marker.hold_error)
            marker.linear_error += 0.2 * (abs(step - marker.velocity) - marker.linear_error)
            marker.velocity = step
        marker.u, marker.v = spot.u, spot.v
        marker.lost_frames = 0
        marker.background += _SLOW * (spot.side_grey - marker.background)
        marker.contrast += _SLOW * (abs(spot.centre_grey - spot.side_grey) - marker.contrast)
        if self.parameters.noise_grey is None:
            variance = marker.noise**2 + _SLOW * (spot.side_variance - marker.noise**2)
            marker.noise = math.sqrt(max(variance, _QUANTISATION_VARIANCE))
        if (self._frame + k) % (8 * self.n_markers) == 0:
            marker.support += 0.1 * (self._support(image, marker, spot) - marker.support)

    # -- one region ----------------------------------------------------------------------------------------

    def _level(self, background: float, contrast: float, noise: float) -> float:
        """Distance of the subtracted level from the background [grey levels]."""
        noise = noise if math.isfinite(noise) else 0.0
        return max(self.parameters.level_fraction * contrast, _NOISE_LEVEL * noise, 1.0)

    def _weights(self, region: npt.NDArray[Any], background: float, above: float) -> tuple[Any, float]:
        """Grey levels beyond background and level, and the level really used (whole grey levels)."""
        if self._is_dark:
            level = math.floor(background - above)
            return cv2.subtract(float(level), region), background - level
        level = math.ceil(background + above)
        return cv2.subtract(region, float(level)), level - background

    def _measure(
        self,
        image: npt.NDArray[Any],
        u: float,
        v: float,
        background: float,
        contrast: float,
        noise: float,
    ) -> tuple[_Spot | None, Reason]:
        """Centroid and moments of the spot near (u, v); no gate but that there is one inside the image."""
        half = self._half
        height, width = image.shape
        above = self._level(background, contrast, noise)
        sigma = noise if math.isfinite(noise) else 0.0
        least = 0.25 * contrast * self.parameters.marker_diameter_px**2 * 0.785
        for _ in range(_MAX_PASSES):
            column, row = round(u), round(v)
            left, top = column - half, row - half
            right, bottom = column + half + 1, row + half + 1
            if left < 0 or top < 0 or right > width or bottom > height:
                return None, "border"
            region = image[top:bottom, left:right]
            weights, above_used = self._weights(region, background, above)
            moments = cv2.moments(weights)
            mass = moments["m00"]
            if mass < least:
                return None, "hidden"
            # Noise that rises above the level everywhere pulls towards the region's centre: its mean mass
            # is known and taken away.
            depth = above_used / sigma if sigma > 0 else 9.0
            first_u, first_v = moments["m10"], moments["m01"]
            n_pixels = region.size
            speck_variance = 0.0
            if depth < 4.0:
                density = math.exp(-depth * depth / 2) / 2.5066282746
                tail = 0.5 * math.erfc(depth * 0.70710678)
                speck = sigma * (density - depth * tail)
                speck_variance = (
                    sigma * sigma * ((1 + depth * depth) * tail - depth * density) - speck * speck
                )
                mass -= speck * n_pixels
                first_u -= speck * n_pixels * half
                first_v -= speck * n_pixels * half
                if mass < least:
                    return None, "hidden"
            u, v = left + first_u / mass, top + first_v / mass
            if abs(u - column) <= _CENTRED_PX and abs(v - row) <= _CENTRED_PX:
                break
        mean_left, deviation_left = cv2.meanStdDev(region[:, :2])
        mean_right, deviation_right = cv2.meanStdDev(region[:, -2:])
        side_left, side_right = mean_left.item(), mean_right.item()
        variance_u, variance_v = moments["mu20"] / mass, moments["mu02"] / mass
        spot = _Spot(
            u,
            v,
            mass,
            mass / max(contrast - above_used, 1.0),
            variance_u,
            variance_v,
            moments["mu11"] / mass,
            moments["mu30"] / (mass * max(variance_u, 1e-6) ** 1.5),
            moments["mu03"] / (mass * max(variance_v, 1e-6) ** 1.5),
            float(region.item(half, half)),
            0.5 * (side_left + side_right),
            0.5 * (deviation_left.item() ** 2 + deviation_right.item() ** 2),
            side_right - side_left,
            speck_variance,
            half,
        )
        return spot, "ok"

    def _examine(
        self, image: npt.NDArray[Any], u: float, v: float, marker: _Marker, reference: _Reference
    ) -> tuple[_Spot | None, Reason]:
        """Measure the spot near (u, v) and compare it with the marker as acquired."""
        spot, reason = self._measure(image, u, v, marker.background, marker.contrast, marker.noise)
        if spot is None:
            return None, reason
        return spot, self._judge(spot, marker, reference)

    def _judge(self, spot: _Spot, marker: _Marker, reference: _Reference) -> Reason:
        """Name the first gate that a spot fails."""
        parameters = self.parameters
        contrast, noise = marker.contrast, marker.noise
        relative_noise = noise / contrast
        if abs(spot.v - reference.row) > parameters.row_gate_px:
            return "jump"
        if (
            abs(spot.side_grey - marker.background) > 0.12 * contrast + noise
            or abs(spot.side_difference) > 0.12 * contrast + noise
        ):
            return "surroundings"
        # Motion within the exposure lengthens the spot along u and leaves more of it below the level.
        excess = max(0.0, spot.variance_u - reference.variance)
        smear = math.sqrt(12.0 * min(excess, self._smear_variance))
        expected_area = reference.area - 0.1 * smear * parameters.marker_diameter_px
        tolerance = parameters.area_tolerance + 2.0 * relative_noise
        if abs(spot.area / expected_area - 1.0) > tolerance:
            return "area"
        shape = parameters.shape_tolerance + 2.0 * relative_noise
        if (
            abs(spot.variance_v / reference.variance - 1.0) > shape
            or spot.variance_u < reference.variance * (1.0 - shape)
            or excess > shape * reference.variance + self._smear_variance
            or abs(spot.covariance) > shape * reference.variance
        ):
            return "shape"
        if abs(spot.skew_u - reference.skew_u) > shape or abs(spot.skew_v - reference.skew_v) > shape:
            return "asymmetry"
        brightness = abs(spot.centre_grey - spot.side_grey)
        if abs(brightness / contrast - 1.0) > parameters.brightness_tolerance + 5.0 * relative_noise:
            return "brightness"
        return "ok"

    def _support(self, image: npt.NDArray[Any], marker: _Marker, spot: _Spot) -> float:
        """Second moment of the pixels that carry weight, over that of the weights themselves."""
        half = self._half
        column, row = round(spot.u), round(spot.v)
        region = image[row - half : row + half + 1, column - half : column + half + 1]
        above = max(self._level(marker.background, marker.contrast, marker.noise), 4.0 * marker.noise)
        weights, _ = self._weights(region, marker.background, above)
        moments = cv2.moments(weights, True)
        return float(moments["mu20"] / (spot.area * spot.variance_u))

    def _sigma(self, marker: _Marker, spot: _Spot) -> float:
        """Standard deviation of the centroid along u [px]."""
        second_moment = marker.support * spot.area * spot.variance_u
        noise = marker.noise if self.parameters.noise_grey is None else self.parameters.noise_grey
        variance = noise * noise * second_moment
        if spot.speck_variance > 0:
            side = 2 * spot.half + 1
            rest = side * side * (side * side - 1) / 12.0 - second_moment
            variance += spot.speck_variance * max(rest, 0.0)
        return math.sqrt(variance / (spot.mass * spot.mass) + self.parameters.sigma_floor_px**2)

    # -- looking for spots ---------------------------------------------------------------------------------

    def _search(
        self,
        image: npt.NDArray[Any],
        u: float,
        marker: _Marker,
        reference: _Reference,
        gate: float,
    ) -> tuple[_Spot | None, Reason]:
        """Look for the marker within `gate` of u in its own row; it must be the only one there."""
        reach = gate + 2 * self.parameters.marker_diameter_px + self._half
        tall = self.parameters.row_gate_px + self._half
        height, width = image.shape
        left, right = max(0, math.floor(u - reach)), min(width, math.ceil(u + reach) + 1)
        top, bottom = (
            max(0, math.floor(reference.row - tall)),
            min(height, math.ceil(reference.row + tall) + 1),
        )
        if right - left < 3 or bottom - top < 3:
            return None, "border"
        spots: list[_Spot] = []
        reason: Reason = "hidden"
        for centre_u, centre_v in self._centres(
            image[top:bottom, left:right], marker.background, 0.5 * marker.contrast
        ):
            spot, why = self._examine(image, left + centre_u, top + centre_v, marker, reference)
            if why == "ok" and spot is not None:
                spots.append(spot)
            elif abs(left + centre_u - u) <= gate:
                reason = why
        near = [spot for spot in spots if abs(spot.u - u) <= gate]
        if not near:
            return None, reason
        if len(spots) > 1:
            return None, "ambiguous"
        return near[0], "ok"

    def _centres(
        self, region: npt.NDArray[Any], background: float, above: float
    ) -> list[tuple[float, float]]:
        """Centres of the spots of about a marker's size in a region [px of the region]."""
        weights, _ = self._weights(region, background, above)
        _, mask = cv2.threshold(weights, 0, 255, cv2.THRESH_BINARY)
        if mask.dtype != np.uint8:
            mask = mask.astype(np.uint8)
        contours = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[-2]
        parameters = self.parameters
        diameter = parameters.marker_diameter_px
        smallest = (1 - parameters.diameter_tolerance) * diameter - 2
        widest = (1 + parameters.diameter_tolerance) * diameter + parameters.max_smear_px + 2
        tallest = (1 + parameters.diameter_tolerance) * diameter + 2
        centres = []
        for contour in contours:
            x, y, w, h = cv2.boundingRect(contour)
            if w >= smallest and smallest <= h <= tallest and w <= widest:
                centres.append((x + (w - 1) / 2, y + (h - 1) / 2))
        return centres

    # -- acquisition ---------------------------------------------------------------------------------------

    def _acquire(self, image: npt.NDArray[Any]) -> dict[int, Reason]:
        """Find the markers that are not known; returns the reasons for those that still are not."""
        unknown = [k for k, marker in enumerate(self._markers) if marker.reference is None]
        background, extreme = self._image_levels(image)
        contrast = abs(extreme - background)
        if contrast < self.parameters.min_contrast_grey:
            return dict.fromkeys(unknown, "no_contrast")
        reasons: dict[int, Reason] = {}
        for fraction in _ACQUISITION_THRESHOLDS:
            found = []
            for u, v in self._centres(image, background, fraction * contrast):
                candidate = self._candidate(image, u, v, background)
                if candidate is not None:
                    found.append(candidate)
            reasons = self._assign(image, unknown, found)
            if not reasons:
                break
        return reasons

    def _image_levels(self, image: npt.NDArray[Any]) -> tuple[float, float]:
        """Median grey level and the extreme of the markers' polarity, a lone pixel aside."""
        background = float(np.median(image[::4, ::4]))
        smooth = cv2.blur(image, (3, 3))
        lowest, highest, _, _ = cv2.minMaxLoc(smooth)
        return background, float(lowest if self._is_dark else highest)

    def _candidate(
        self, image: npt.NDArray[Any], u: float, v: float, background: float
    ) -> tuple[_Spot, float, float, float] | None:
        """Measure a spot with its own background, contrast and noise; None when it is no marker."""
        parameters = self.parameters
        height, width = image.shape
        column, row = round(u), round(v)
        if not (0 <= column < width and 0 <= row < height):
            return None
        patch = image[max(0, row - 1) : row + 2, max(0, column - 1) : column + 2]
        contrast = float(patch.mean()) - background
        contrast = -contrast if self._is_dark else contrast
        noise = math.nan
        spot: _Spot | None = None
        for _ in range(2):
            if contrast < parameters.min_contrast_grey:
                return None
            spot, _ = self._measure(image, u, v, background, contrast, noise)
            if spot is None:
                return None
            background = spot.side_grey
            measured = math.sqrt(max(spot.side_variance, _QUANTISATION_VARIANCE))
            noise = measured if parameters.noise_grey is None else parameters.noise_grey
            column, row = round(spot.u), round(spot.v)
            patch = image[row - 1 : row + 2, column - 1 : column + 2]
            contrast = abs(float(patch.mean()) - background)
        assert spot is not None
        nominal = 0.785398 * parameters.marker_diameter_px**2
        low, high = (1 - parameters.diameter_tolerance) ** 2, (1 + parameters.diameter_tolerance) ** 2
        roundness = 2 * parameters.shape_tolerance + 2.0 * noise / contrast
        is_marker = (
            low * nominal <= spot.area <= high * nominal
            and spot.variance_u >= spot.variance_v * (1 - roundness)
            and spot.variance_u <= spot.variance_v * (1 + roundness) + self._smear_variance
            and abs(spot.covariance) <= roundness * spot.variance_v
            # A uniform disc of this area has a second moment of area / (4 pi); blur adds to it.
            and spot.variance_v <= (spot.area / 12.566 + 2.0) * (1 + roundness)
            and abs(spot.skew_u) <= roundness
            and abs(spot.skew_v) <= roundness
            and abs(spot.side_difference) <= 0.12 * contrast + noise
        )
        return (spot, background, contrast, noise) if is_marker else None

    def _assign(
        self,
        image: npt.NDArray[Any],
        unknown: list[int],
        found: list[tuple[_Spot, float, float, float]],
    ) -> dict[int, Reason]:
        """Name the spots by their order along the beam, or by their rows where these are known."""
        reasons: dict[int, Reason] = {}
        if all(self._markers[k].known_row is None for k in unknown):
            # The first acquisition, without expected rows: the order alone gives the names.
            if len(found) != len(unknown):
                why: Reason = "ambiguous" if len(found) > len(unknown) else "not_acquired"
                return dict.fromkeys(unknown, why)
            found = sorted(found, key=lambda candidate: -candidate[0].v)
            rows = [candidate[0].v for candidate in found]
            if any(lower - upper < self.parameters.marker_diameter_px for lower, upper in pairwise(rows)):
                return dict.fromkeys(unknown, "ambiguous")
            for k, candidate in zip(unknown, found, strict=True):
                self._introduce(image, self._markers[k], *candidate)
            return reasons
        tolerance = self.parameters.expected_row_tolerance_px
        for k in unknown:
            marker = self._markers[k]
            assert marker.known_row is not None
            near = [candidate for candidate in found if abs(candidate[0].v - marker.known_row) <= tolerance]
            if len(near) == 1 and not self._is_taken(near[0][0], k):
                self._introduce(image, marker, *near[0])
            else:
                reasons[k] = "ambiguous" if near else "not_acquired"
        return reasons

    def _introduce(
        self,
        image: npt.NDArray[Any],
        marker: _Marker,
        spot: _Spot,
        background: float,
        contrast: float,
        noise: float,
    ) -> None:
        """Start to follow a spot as this marker."""
        marker.background, marker.contrast, marker.noise = background, contrast, noise
        excess = max(0.0, spot.variance_u - spot.variance_v)
        smear = math.sqrt(12.0 * excess)
        marker.reference = _Reference(
            area=spot.area + 0.1 * smear * self.parameters.marker_diameter_px,
            variance=min(spot.variance_u, spot.variance_v),
            skew_u=spot.skew_u,
            skew_v=spot.skew_v,
            row=spot.v,
        )
        marker.known_row = spot.v
        marker.u, marker.v = spot.u, spot.v
        marker.velocity = 0.0
        marker.hold_error = marker.linear_error = 1.0
        marker.lost_frames = 0
        marker.support = self._support(image, marker, spot)
