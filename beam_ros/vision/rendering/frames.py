"""Frames as the camera would see them: the beam and its markers at known sub-pixel positions.

A marker is a disc, blurred by the lens, integrated over each pixel and averaged over the exposure. The
blurred and integrated disc is tabulated once at eighths of a pixel; in between, the table is interpolated
bilinearly, which moves the centre of gravity by exactly what was asked for. The exposure is averaged over
the positions that the caller gives at ``FrameTiming.exposure_instants``, with their quadrature weights: the
image's centre of gravity is the mean position over the exposure.

The noise of a pixel is white and fresh around the markers: the camera's own, and, where the renderer is given the
sensor's full well, the shot noise of the light that falls there (the strip, which is hardly brighter than the
background, keeps the background's). Elsewhere, where nobody measures, it is a random
cut-out of a large prepared tile, which costs a copy. All randomness comes from the generator passed in and
from the seed of the tile.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
import numpy.typing as npt

from beam_ros.arrays import ByteArray, Float32Array, FloatArray, ImageArray, IndexArray, StampArray
from beam_ros.vision.calibration.lens import Lens
from beam_ros.vision.errors import VisionParameterError
from beam_ros.vision.parameters import CameraParameters
from beam_ros.vision.rendering.disturbances import Disturbances, Glare, Occluder
from beam_ros.vision.timing import FrameTiming, exposure_weights

_PHASES = 8
"""Tabulated positions of the disc per pixel and axis."""
_OVERSAMPLING = 32
"""Samples per pixel from which the table is integrated; a multiple of _PHASES."""
_FRESH_MARGIN_PX = 10
"""Fresh noise reaches this far beyond the blurred disc [px]."""
_TILE_EXCESS_PX = 256
"""The noise tile is larger than the frame by this much [px]."""


class _DiscTable:
    """A blurred, pixel-integrated disc of unit height at every eighth of a pixel.

    Attributes
    ----------
    values : ndarray, shape (9, 9, size, size) -- [v phase, u phase, row, column]; the centre of phase
        (a, b) lies at pixel (half + a / 8, half + b / 8)
    half : int -- pixel of the centre at phase 0 [px]
    """

    def __init__(self, diameter_px: float, blur_px: float) -> None:
        reach = diameter_px / 2 + 4.0 * blur_px + 1.0
        self.half = math.ceil(reach)
        self.size = 2 * self.half + 2
        fine = _OVERSAMPLING
        # Fine samples sit symmetrically about the disc's centre, so that the table is exactly centred.
        extent = 2 * (self.half + 2)
        axis = (np.arange(extent * fine) + 0.5) / fine - extent / 2
        inside = (axis[:, None] ** 2 + axis[None, :] ** 2 <= (diameter_px / 2) ** 2).astype(np.float32)
        inside *= np.float32(math.pi * (diameter_px / 2) ** 2 * fine**2 / float(inside.sum()))
        if blur_px > 0:
            width = 2 * math.ceil(4.5 * blur_px * fine) + 1
            kernel = cv2.getGaussianKernel(width, blur_px * fine, cv2.CV_32F)
            inside = np.asarray(
                cv2.sepFilter2D(inside, cv2.CV_32F, kernel, kernel, borderType=cv2.BORDER_CONSTANT)
            )
        sums = np.zeros((extent * fine + 1, extent * fine + 1))
        sums[1:, 1:] = np.cumsum(np.cumsum(inside, axis=0, dtype=np.float64), axis=1)
        self.values = np.empty((_PHASES + 1, _PHASES + 1, self.size, self.size), dtype=np.float32)
        # Pixel k of phase p covers k - half - p/8 +- 1/2 about the disc's centre.
        edges = [
            np.rint(
                (np.arange(self.size + 1) - 0.5 - self.half - phase / _PHASES + extent / 2) * fine
            ).astype(np.intp)
            for phase in range(_PHASES + 1)
        ]
        for a in range(_PHASES + 1):
            by_rows = np.diff(sums[edges[a], :], axis=0)
            for b in range(_PHASES + 1):
                self.values[a, b] = np.diff(by_rows[:, edges[b]], axis=1) / fine**2

    def average(self, u: FloatArray, v: FloatArray, weights: FloatArray) -> tuple[Float32Array, int, int]:
        """Weighted mean of the discs centred at (u, v).

        Returns
        -------
        coverage : ndarray, shape (rows, columns) -- 0 outside the disc, 1 inside
        top, left : int -- image position of its first pixel [px]
        """
        column, row = np.floor(u).astype(np.intp), np.floor(v).astype(np.intp)
        left, top = int(column.min()), int(row.min())
        coverage = np.zeros(
            (self.size + int(row.max()) - top, self.size + int(column.max()) - left), dtype=np.float32
        )
        phase_u, phase_v = (u - column) * _PHASES, (v - row) * _PHASES
        b, a = (
            np.minimum(phase_u.astype(np.intp), _PHASES - 1),
            np.minimum(phase_v.astype(np.intp), _PHASES - 1),
        )
        fu, fv = phase_u - b, phase_v - a
        corner = (
            np.stack([(1 - fv) * (1 - fu), (1 - fv) * fu, fv * (1 - fu), fv * fu], axis=1) * weights[:, None]
        )
        rows_of = np.stack([a, a, a + 1, a + 1], axis=1)
        columns_of = np.stack([b, b + 1, b, b + 1], axis=1)
        flat = self.values.reshape(-1, self.size * self.size)
        indices = rows_of * (_PHASES + 1) + columns_of
        place = (row - top) * coverage.shape[1] + (column - left)
        for offset in np.unique(place):
            chosen = place == offset
            patch = corner[chosen].ravel().astype(np.float32) @ flat[indices[chosen].ravel()]
            y, x = divmod(int(offset), coverage.shape[1])
            coverage[y : y + self.size, x : x + self.size] += patch.reshape(self.size, self.size)
        return coverage, top - self.half, left - self.half


def _strip_profile_table(width_px: float, blur_px: float) -> tuple[Float32Array, int]:
    """Cross-section of the blurred strip by pixel, at 1/64 px phases; and its half width [px]."""
    sigma = math.hypot(blur_px, 1e-3)
    half = math.ceil(width_px / 2 + 4 * sigma + 1)
    pixels = np.arange(-half, half + 2, dtype=np.float64)

    def integral(x: FloatArray) -> FloatArray:
        # Integral of the cumulative normal: x Phi(x) + phi(x), scaled.
        t = x / sigma
        cumulative = 0.5 * (1 + np.vectorize(math.erf)(t / math.sqrt(2)))
        return np.asarray(sigma * (t * cumulative + np.exp(-t * t / 2) / math.sqrt(2 * math.pi)))

    table = np.empty((64, pixels.size), dtype=np.float32)
    for phase in range(64):
        x = pixels - (phase + 0.5) / 64
        lower, upper = x + width_px / 2, x - width_px / 2
        table[phase] = (integral(lower + 0.5) - integral(lower - 0.5)) - (
            integral(upper + 0.5) - integral(upper - 0.5)
        )
    return table, half


_StripPixels = tuple[IndexArray, IndexArray, Float32Array]
"""Rows, columns and grey levels of the strip's pixels."""


class SceneRenderer:
    """Renders the camera's frames of one beam.

    Parameters
    ----------
    camera : CameraParameters -- size, scale, optics and noise
    marker_heights : array_like, shape (n_markers,) -- heights of the markers at rest [m]
    strip_heights : array_like or None, shape (n_strip,) -- heights at which ``render`` gets where the
        strip is, rising [m]; None: the markers' own
    sub_instants : int -- positions per exposure; six are exact, more smooth the look of a long smear
    lens : Lens or None -- distortion of the positions in the image; None is a perfect lens
    seed : int -- seed of the prepared noise tile
    full_well : float -- electrons at grey level 255; 0 leaves shot noise out
    """

    def __init__(
        self,
        camera: CameraParameters,
        marker_heights: npt.ArrayLike,
        *,
        strip_heights: npt.ArrayLike | None = None,
        sub_instants: int = 6,
        lens: Lens | None = None,
        seed: int = 0,
        full_well: float = 0.0,
    ) -> None:
        self.camera = camera
        # N electrons vary by sqrt(N): a variance of so many squared grey levels for each grey level.
        self._shot_noise = np.float32(255.0 / full_well if full_well else 0.0)
        self._is_noisy = camera.noise_grey > 0 or full_well > 0
        self.timing = FrameTiming(camera)
        self.marker_heights = np.atleast_1d(np.asarray(marker_heights, dtype=np.float64))
        self.strip_heights = (
            self.marker_heights
            if strip_heights is None
            else np.atleast_1d(np.asarray(strip_heights, dtype=np.float64))
        )
        self.sub_instants = sub_instants
        self.lens = lens
        for name, heights in (("marker_heights", self.marker_heights), ("strip_heights", self.strip_heights)):
            if not np.all(np.isfinite(heights)) or np.any(np.diff(heights) <= 0):
                raise VisionParameterError(
                    f"{name} are {heights.tolist()} m; expected finite heights, rising from the clamp"
                )
        if sub_instants < 1:
            raise VisionParameterError(f"sub_instants is {sub_instants}; expected at least 1")
        self.exposure_weights = exposure_weights(sub_instants)
        self._marker_rows = camera.rows(self.marker_heights)
        self._disc = _DiscTable(camera.marker_diameter_px, camera.blur_px)
        self._strip_table, self._strip_half = _strip_profile_table(
            camera.strip_width_m * camera.pixels_per_metre, camera.blur_px
        )
        self._strip_grey = math.copysign(camera.strip_contrast, camera.contrast)
        rows = camera.rows(self.strip_heights)
        first, last = max(0, math.ceil(rows[-1])), min(camera.height - 1, math.floor(rows[0]))
        self._strip_rows = np.arange(first, last + 1)
        self._strip_row_heights = (camera.origin_px[1] - self._strip_rows) / camera.pixels_per_metre
        self._tile = self._noise_tile(np.random.default_rng(seed))
        self._canvas = np.full((camera.height, camera.width), camera.background, dtype=np.float32)

    def _noise_tile(self, rng: np.random.Generator) -> ByteArray:
        camera = self.camera
        excess = _TILE_EXCESS_PX if self._is_noisy else 0
        shape = (camera.height + excess, camera.width + excess)
        return self._exposed(np.full(shape, camera.background, dtype=np.float32), rng)

    def exposure_instants(self, stamp_ns: int) -> StampArray:
        """Instants at which ``render`` needs the markers' positions.

        Parameters
        ----------
        stamp_ns : int -- stamp of the frame, in the camera's own meaning [ns]

        Returns
        -------
        ndarray of int64, shape (sub_instants, n_markers) -- [ns]
        """
        return self.timing.exposure_instants(stamp_ns, self.marker_heights, self.sub_instants)

    def render(
        self,
        marker_x: npt.ArrayLike,
        rng: np.random.Generator,
        strip: npt.ArrayLike | None = None,
        *,
        marker_z: npt.ArrayLike | None = None,
        disturbances: Disturbances | None = None,
    ) -> ByteArray:
        """Render one frame.

        Parameters
        ----------
        marker_x : array_like, shape (sub_instants, n_markers) or (n_markers,) -- positions u(z, t) of the
            markers at ``exposure_instants`` [m]; one row for markers that stand still. NaN leaves a marker out
        rng : numpy.random.Generator -- source of this frame's noise
        strip : array_like or None, shape (n_strip,) or (sub_instants, n_strip) -- position of the strip at
            ``strip_heights``, its mean over the exposure or at the exposure's instants [m]; None draws no strip
        marker_z : array_like or None, shape like marker_x -- heights of the markers at the same instants
            where they differ from those at rest [m]
        disturbances : Disturbances or None -- second spots, glare and occluders in this frame

        Returns
        -------
        ndarray, shape (height, width), uint8
        """
        frame = self._background(rng)
        touched, strip_pixels = self._draw(marker_x, strip, marker_z, disturbances)
        for rows, columns, grey in strip_pixels:
            noisy = frame[rows, columns] + np.rint(grey)
            frame[rows, columns] = np.clip(noisy, 0, 255).astype(np.uint8)
        for region in touched:
            frame[region] = self._exposed(self._canvas[region], rng)
        self._wipe(touched, strip_pixels)
        return frame

    def light(
        self,
        marker_x: npt.ArrayLike,
        strip: npt.ArrayLike | None = None,
        *,
        marker_z: npt.ArrayLike | None = None,
        disturbances: Disturbances | None = None,
    ) -> Float32Array:
        """Light that falls on the sensor in one frame, before noise, rounding and saturation.

        Parameters
        ----------
        marker_x, strip, marker_z, disturbances -- as of ``render``

        Returns
        -------
        ndarray, shape (height, width) -- [grey levels of 255]
        """
        touched, strip_pixels = self._draw(marker_x, strip, marker_z, disturbances)
        seen: Float32Array = self._canvas.copy()
        self._wipe(touched, strip_pixels)
        return seen

    def _draw(
        self,
        marker_x: npt.ArrayLike,
        strip: npt.ArrayLike | None,
        marker_z: npt.ArrayLike | None,
        disturbances: Disturbances | None,
    ) -> tuple[list[tuple[slice, slice]], list[_StripPixels]]:
        """Draw a scene into the canvas; returns the regions touched, and the strip's pixels at each instant."""
        u, v, weights = self._exposure(marker_x, marker_z)
        touched: list[tuple[slice, slice]] = []
        strip_pixels = [] if strip is None else self._smeared_strip(strip)
        for rows, columns, grey in strip_pixels:
            self._canvas[rows, columns] += grey
        for k in range(u.shape[1]):
            if np.all(np.isfinite(u[:, k])):
                self._draw_disc(u[:, k], v[:, k], weights, touched)
        if disturbances is not None:
            self._disturb(disturbances, touched)
        return touched, strip_pixels

    def _wipe(self, touched: list[tuple[slice, slice]], strip_pixels: list[_StripPixels]) -> None:
        """Give the canvas its background again."""
        for region in touched:
            self._canvas[region] = self.camera.background
        for rows, columns, _ in strip_pixels:
            self._canvas[rows, columns] = self.camera.background

    def _smeared_strip(self, strip: npt.ArrayLike) -> list[_StripPixels]:
        """Pixels of the strip at every instant of the exposure, each with its share of the light."""
        x = np.asarray(strip, dtype=np.float64)
        if x.shape == (self.sub_instants, self.strip_heights.size):
            return [
                (rows, columns, grey * np.float32(weight))
                for weight, at in zip(self.exposure_weights, x, strict=True)
                for rows, columns, grey in [self._strip(at)]
            ]
        return [self._strip(x)]

    def _draw_disc(
        self, u: FloatArray, v: FloatArray, weights: FloatArray, touched: list[tuple[slice, slice]]
    ) -> None:
        """Blend a smeared disc into the canvas and note the region that needs fresh noise."""
        coverage, top, left = self._disc.average(u, v, weights)
        region = self._clip(top, left, *coverage.shape)
        if region is None:
            return
        rows, columns = region
        cut = coverage[rows.start - top : rows.stop - top, columns.start - left : columns.stop - left]
        grey = np.float32(self.camera.background + self.camera.contrast)
        self._canvas[region] += cut * (grey - self._canvas[region])
        margin = _FRESH_MARGIN_PX
        fresh = self._clip(
            top - margin, left - margin, coverage.shape[0] + 2 * margin, coverage.shape[1] + 2 * margin
        )
        if fresh is not None:
            touched.append(fresh)

    def _disturb(self, disturbances: Disturbances, touched: list[tuple[slice, slice]]) -> None:
        """Draw what does not belong to the beam: spots, then light, then what stands before the camera."""
        for spot in disturbances.spots:
            self._draw_disc(np.array([spot.u_px]), np.array([spot.v_px]), np.ones(1), touched)
        for glare in disturbances.glares:
            self._draw_glare(glare, touched)
        for occluder in disturbances.occluders:
            self._draw_occluder(occluder, touched)

    def _draw_glare(self, glare: Glare, touched: list[tuple[slice, slice]]) -> None:
        reach = math.ceil(4 * glare.radius_px)
        top, left = round(glare.v_px) - reach, round(glare.u_px) - reach
        region = self._clip(top, left, 2 * reach + 1, 2 * reach + 1)
        if region is None:
            return
        rows, columns = np.arange(region[0].start, region[0].stop), np.arange(region[1].start, region[1].stop)
        down = np.exp(-0.5 * ((rows - glare.v_px) / glare.radius_px) ** 2)
        across = np.exp(-0.5 * ((columns - glare.u_px) / glare.radius_px) ** 2)
        self._canvas[region] += (glare.grey * np.outer(down, across)).astype(np.float32)
        touched.append(region)

    def _draw_occluder(self, occluder: Occluder, touched: list[tuple[slice, slice]]) -> None:
        top, left = math.floor(occluder.top_px), math.floor(occluder.left_px)
        bottom, right = math.ceil(occluder.bottom_px), math.ceil(occluder.right_px)
        region = self._clip(top, left, bottom - top + 1, right - left + 1)
        if region is None:
            return
        rows, columns = np.arange(region[0].start, region[0].stop), np.arange(region[1].start, region[1].stop)
        down = np.clip(np.minimum(rows + 0.5 - occluder.top_px, occluder.bottom_px - rows + 0.5), 0, 1)
        across = np.clip(
            np.minimum(columns + 0.5 - occluder.left_px, occluder.right_px - columns + 0.5), 0, 1
        )
        cover = np.outer(down, across).astype(np.float32)
        self._canvas[region] += cover * (np.float32(occluder.grey) - self._canvas[region])
        touched.append(region)

    def _exposure(
        self, marker_x: npt.ArrayLike, marker_z: npt.ArrayLike | None
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Positions (n_instants, n_markers) in pixels and the weights of the instants."""
        x = np.atleast_2d(np.asarray(marker_x, dtype=np.float64))
        n_markers = self.marker_heights.size
        if x.shape not in ((1, n_markers), (self.sub_instants, n_markers)):
            raise VisionParameterError(
                f"marker_x has shape {x.shape}; expected ({self.sub_instants}, {n_markers}), the positions "
                f"at exposure_instants(), or ({n_markers},) for markers at rest"
            )
        u = self.camera.columns(x)
        if marker_z is None:
            v = np.broadcast_to(self._marker_rows, u.shape)
        else:
            v = np.broadcast_to(np.atleast_2d(self.camera.rows(marker_z)), u.shape)
        if self.lens is not None:
            u, v = self.lens.distort(u, v)
        weights = self.exposure_weights if x.shape[0] == self.sub_instants else np.ones(1)
        return u, v, weights

    def _background(self, rng: np.random.Generator) -> ByteArray:
        camera = self.camera
        top, left = rng.integers(0, _TILE_EXCESS_PX, size=2, endpoint=True) if self._is_noisy else (0, 0)
        return np.array(self._tile[top : top + camera.height, left : left + camera.width])

    def _exposed(self, signal: Float32Array, rng: np.random.Generator) -> ByteArray:
        """Grey levels of a region: signal, white noise, rounding, saturation."""
        noisy: ImageArray = signal
        if self._is_noisy:
            noise = np.float32(self.camera.noise_grey)
            if self._shot_noise > 0:
                noise = np.sqrt(noise**2 + self._shot_noise * np.clip(signal, 0, 255))
            noisy = signal + noise * rng.standard_normal(signal.shape, dtype=np.float32)
        return np.asarray(np.clip(np.rint(noisy), 0, 255), dtype=np.uint8)

    def _strip(self, strip: npt.ArrayLike) -> _StripPixels:
        """Rows, columns and grey levels of the strip's pixels."""
        x = np.asarray(strip, dtype=np.float64)
        if x.shape != self.strip_heights.shape:
            raise VisionParameterError(
                f"strip has shape {x.shape}; expected {self.strip_heights.shape}, one position per strip "
                "height"
            )
        if self.lens is None:
            u = self.camera.columns(np.interp(self._strip_row_heights, self.strip_heights, x))
        else:
            bent_u, bent_v = self.lens.distort(self.camera.columns(x), self.camera.rows(self.strip_heights))
            u = np.interp(self._strip_rows, bent_v[::-1], bent_u[::-1])
        column = np.floor(u).astype(np.intp)
        phase = ((u - column) * 64).astype(np.intp)
        columns = column[:, None] + np.arange(-self._strip_half, self._strip_half + 2)[None, :]
        grey = self._strip_table[phase] * np.float32(self._strip_grey)
        rows = np.broadcast_to(self._strip_rows[:, None], columns.shape)
        inside = (columns >= 0) & (columns < self.camera.width)
        return rows[inside], columns[inside], grey[inside]

    def _clip(self, top: int, left: int, rows: int, columns: int) -> tuple[slice, slice] | None:
        y0, y1 = max(0, top), min(self.camera.height, top + rows)
        x0, x1 = max(0, left), min(self.camera.width, left + columns)
        return None if y0 >= y1 or x0 >= x1 else (slice(y0, y1), slice(x0, x1))
