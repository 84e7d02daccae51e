"""The disc model: where a blurred, smeared disc lies, at the bound that the noise sets, in one step.

    I(p) = B + A T(p - c) + noise        T(p) = mean over the exposure of Phi((R - |p - s|) / e)

Near a tabulated point the model is linear in whatever is unknown, so that the step of Gauss-Newton which the whole
fit needs is a product of tabulated weights with the grey levels,

    (A du, A dv, A, B, ...) = (X' W X)^-1 X' W I        X = dT/du, dT/dv, T, 1, dT/dR, dT/de, dT/ds

where W follows the noise, var I = alpha + beta T: larger where there is more light, or, where the disc hides a
texture of the background, smaller. Radius, blur and length of the smear are fitted along: by symmetry they cost the
centre nothing, and what they are wrong by does not pull. The error of the linear step is of third order, below 1e-4
px at a sixteenth of a pixel; where the start was further away, the step is made again from the nearer point.

More things pull the centre and are known in part only: a slope of the background and one of the light on the disc,
and the bend of the motion within the exposure. Each has a row of weights of its own, and an expectation learned from
the frames before (``Habit``): a slope that is always there is taken off without cost, and a bend that never shows is
not fitted, as it would cost up to a quarter more noise. What the bend usually is has two answers, one for frames
between which the disc's speed hardly changes, and one for the rest.

The standard deviation is what the frames show: alpha and beta come from the residuals of the fit, and modes of the
rim in which a disc that moves has no part (two, three and four waves around it) show what compression, texture or
print add. A rolling shutter shears a disc that moves, which is one of these waves: the shear is fitted along for the
residuals, and the waves say no more than what the disc's speed may make of them leaves.

A disc that is brighter than the sensor can say has a flat top without noise, and a rim that is no Phi up to there.
What the model leaves of it sets W, as if it were noise, so that pixels which the model does not fit weigh little; but
it lies the same way on all sides, and hardly pulls. Alpha and beta are those of the other pixels about a profile that
is free.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import cv2
import numpy as np

from beam_ros.arrays import Float32Array, FloatArray, ImageArray
from beam_ros.vision.tracking.centres import (
    EDGE_STEP_PX,
    RADIUS_STEP_PX,
    clipped,
    clipped_sums,
    compiled_clipped_sums,
    cumulative_normal,
    disc_steps,
    has_flat_top,
)

_PHASES = 8
"""Tabulated points per pixel and axis."""
_NEAR_PX = 0.125
"""A step that is longer is made again from where it led [px]."""
_MAX_STEPS = 4
_ALIKE_PX = 0.55
"""A smear that is longer or shorter by more than this is tabulated anew [px]."""
_LOST_PX = 1.5
"""No disc is found further than this from the start [px]."""
_SMEAR_STEP_PX = 1.0
_POSITIONS_PER_STEP = 2
"""A smeared disc is modelled by so many positions for each step of its length, ..."""
_MIN_POSITIONS = 4
"""... and by so many at least: two show no bend."""
_SMEARED = 2.0
"""A disc that seems to rest moves where its second moment is so many standard deviations too large."""
_RIM = 2.5
_GROUND_PX = 2.0
"""The fit ends this far beyond so many standard deviations of the rim's blur outside of the radius [px]."""
_OUTSIDE = 0.003
"""Pixels with less than this share of the disc are background."""
_LIGHT_STEPS = (-0.95, -0.8, -0.5, 0.0, 0.7, 1.6, 3.2, 6.5, 13.0)
"""Ratios beta / alpha for which weights are tabulated, below 0 where the disc hides a texture, ..."""
_LIGHT_MIDDLES = [(lower + upper) / 2 for lower, upper in pairwise(_LIGHT_STEPS)]
"""... and those where one gives way to the next."""
_LONG_MODES = 1
"""So many of these, the first, are long: they notice what is smooth over some pixels, and the rest what is not."""
_SAME = 1e-3
"""Frames between which a mode of the rim changes by less than so much of its variance are the same frame."""
_FREE_POWERS = 2, 3
"""With these powers of the disc the profile of a rim below a flat top is free."""
_ROUNDING = 1.0 / 12.0
"""Variance of rounding to grey levels."""
_FAINT = 1e-6
"""What changes the image less than this fraction of what a move of the disc does is not looked for."""
_OWN = 7
"""Columns of the model; first dT/du, dT/dv, T and 1."""
_SLOPES, _BEND, _MODES, _LENGTH, _TILT = (4, 5), 6, slice(7, 12), 12, 13
"""Rows of weights after those of u, v, A and B."""
_UNLIKELY = 5.0
"""Waves of the rim are a disturbance beyond so many times their usual mean square: once in 5000 frames by chance."""
_SLOW_FRAMES = 64
"""Frames over which noise and expectations are averaged."""
_CONSTANT_FRAMES = 512
"""The same for what is constant."""
_SURPRISE_FRAMES, _SURPRISED = 8, 2.5
"""What is constant has changed where its mean square over so many frames, of which one counts for no more than all
usual ones together, is so many times its usual one."""
_STEEP = 3e-5
"""Square of a slope of the light that is expected of an unknown scene, over the contrast [1/px^2]."""
_BENT = 0.1
"""Square of a bend that is expected, over the length of the smear."""
_NOISE_EVERY_FRAMES = 8
"""The noise is measured anew once in so many frames, after the first as many."""
_BESIDE_PX = 60
"""So far to either side of the fit the background is looked at for a texture [px], ..."""
_BESIDE_ROWS_PX = (-8, 0, 8)
"""... in the rows of the fit, and in those so far below [px]."""
_TEXTURES = 16
"""Looks at the background over which its texture is averaged."""
_MEDIAN = 0.6745
"""Median of the absolute value of a normal variable of unit variance."""
_PRIOR_FRAMES = 4
"""Frames' weight of what is expected of a marker that has just been found."""


class Gain(NamedTuple):
    """How a sum changes with a move of the disc [1/px] where radius, blur or smear are other than tabulated."""

    of_radius: float
    of_edge: float
    of_smear: float

    def at(self, thicker: float, softer: float, longer: float) -> float:
        """Change with a move where the three are so much larger [px]."""
        return self.of_radius * thicker + self.of_edge * softer + self.of_smear * longer


class DiscTable(NamedTuple):
    """Tabulated weights about one point.

    Attributes
    ----------
    left, top, width, height : int -- the pixels of the fit, relative to the whole pixel of the point [px]
    weights : ndarray of float32, shape (14, height * width) -- A du, A dv, A, B; the slopes along u of the background
        and of the disc; A times the bend, the modes of the rim, what the smear is longer than tabulated (its second
        moment where none is), and twice the second moment along u and v
    columns : ndarray of float32, shape (11 or 12, height * width) -- the model's, the slopes along u and v, and the
        shear where there is one
    inverse : ndarray, shape (11, 11) or (12, 12) -- of X' W X of all these
    gains : tuple of 4 Gain -- of A du, the slopes and A times the bend, over A du
    pull : tuple of 3 float -- change of A du with the slopes, and of du with the bend
    sheared : tuple of 5 float -- change of the modes with the shear [px]; empty where there is none
    bent : tuple of 2 float -- change of A times the bend with the slopes
    sloped : tuple of 2 float -- change of the slopes with A times the bend
    variances : list of 14 (float, float) -- of the sums for alpha = 1 and for beta = 1
    noise : ndarray, shape (2, 2) -- from sums of squared residuals, plain and times T, to alpha and beta
    beyond : ndarray of float32, shape (height * width,) -- 0 beyond the rim, infinity within
    behind : ndarray of float32, shape (height, width) -- A du by what the disc does not hide, of a disc at rest
        with the slopes taken off
    """

    left: int
    top: int
    width: int
    height: int
    weights: Float32Array
    columns: Float32Array
    inverse: FloatArray
    gains: tuple[Gain, Gain, Gain, Gain]
    pull: tuple[float, float, float]
    sheared: tuple[float, ...]
    bent: tuple[float, float]
    sloped: tuple[float, float]
    variances: list[tuple[float, float]]
    noise: FloatArray
    beyond: Float32Array
    behind: Float32Array


@lru_cache(maxsize=1024)
def _tabulated(
    phase_u: int,
    phase_v: int,
    radius_steps: int,
    edge_steps: int,
    smear_steps: int,
    light: int,
    is_sheared: bool,
) -> DiscTable:
    """Compute the weights about one point."""
    radius, edge = radius_steps * RADIUS_STEP_PX, edge_steps * EDGE_STEP_PX
    smear = smear_steps * _SMEAR_STEP_PX
    u, v = phase_u / _PHASES, phase_v / _PHASES
    reach = radius + _RIM * edge + _GROUND_PX
    left, right = math.ceil(u - smear / 2 - reach), math.floor(u + smear / 2 + reach)
    top, bottom = math.ceil(v - reach), math.floor(v + reach)
    x = np.arange(left, right + 1, dtype=np.float64)[None, None, :] - u
    y = np.arange(top, bottom + 1, dtype=np.float64)[None, :, None] - v
    count = max(_MIN_POSITIONS, _POSITIONS_PER_STEP * smear_steps) if smear_steps else 1
    instants = (((np.arange(count) + 0.5) / count) - 0.5)[:, None, None]
    if smear_steps:
        # Their mean square is that of all instants, 1/12, so that a bend moves the disc by nothing on average.
        instants /= math.sqrt(1.0 - 1.0 / count**2)
    dx = x - smear * instants
    distance = np.maximum(np.hypot(dx, y), 1e-6)
    depth = (radius - distance) / edge
    slope = np.exp(-0.5 * depth * depth) / (math.sqrt(2 * math.pi) * edge)
    along, across = slope * dx / distance, slope * y / distance

    def seen(*fields: FloatArray) -> FloatArray:
        """Means over the exposure, shape (n_fields, height * width)."""
        return np.asarray(np.stack(fields).reshape(len(fields), count, -1).mean(axis=1))

    turned = slope * (depth / edge * dx * dx + y * y / distance) / (distance * distance)
    # d^2 T/du^2 / 2 where there is no smear: a short motion shows by its second moment only.
    of_smear = instants * along if smear_steps else -0.5 * turned
    one = np.ones_like(depth)
    own = seen(along, across, cumulative_normal(depth), one, slope, -slope * depth, of_smear)
    disc = own[2]
    weight = 1.0 / (1.0 + _LIGHT_STEPS[light] * disc)
    solution = np.linalg.inv((own * weight) @ own.T) @ (own * weight)
    changes = seen(-along * depth / edge, along * (depth * depth - 1.0) / edge, -instants * turned)
    once = (dx + 1j * y) / distance  # exp(i angle)
    twice, thrice = once * once, once * once * once
    four = twice * twice
    # Waves around the rim that show its noise; the other one of two waves is what a smear along u makes.
    modes = seen(*(slope * wave for wave in (twice.imag, thrice.real, thrice.imag, four.real, four.imag)))
    bend = (instants**2 - 1 / 12) * along
    turn = 0.5 * slope * dx * y / (distance * distance) * (1.0 / distance - depth / edge)  # d^2 T/(du dv) / 2
    bent, turning, aside, below, shear = seen(bend, turn, x * one, y * one, along * y)
    outside, inside = aside * (1.0 - disc), aside * disc

    faint = _FAINT * float(np.sum(weight * own[0] * own[0]))

    def beside(extras: FloatArray, others: FloatArray) -> tuple[FloatArray, list[float]]:
        """Weights that see each of some more things beside others, the model's own first; and their share in A du."""
        weighted = others * weight
        shares = np.linalg.solve(weighted @ others.T, weighted @ extras.T)
        alone = extras - shares.T @ others
        seeing = alone * weight
        norms = np.sum(seeing * alone, axis=1)
        is_seen = norms >= faint
        seeing *= (is_seen / np.where(is_seen, norms, 1.0))[:, None]
        return seeing, (shares[0] * is_seen).tolist()

    (outside_weights, bend_weights), (outside_pull, bend_pull) = beside(np.stack([outside, bent]), own)
    inside_weights, (inside_pull,) = beside(inside[None, :], np.vstack([own, outside]))
    taken = np.vstack([own, bent]) if bend_pull else own
    rows = [outside_weights, *inside_weights, bend_weights, *beside(modes, taken)[0]]
    rows += [solution[6], *beside(turning[None, :], taken)[0]]
    weights = np.vstack([solution[:4], rows])

    def gain(row: FloatArray) -> Gain:
        return Gain(*(changes @ row).tolist())

    columns = np.vstack([own, outside, inside, below * (1.0 - disc), below * disc])
    sheared: list[float] = []
    if is_sheared:  # every row is moved along u by its distance from the centre
        columns = np.vstack([columns, shear])
        sheared = (weights[_MODES] @ shear).tolist()
    inverse = np.linalg.inv((columns * weight) @ columns.T)
    # What rests behind a disc at rest has slopes that are known; what a smear passes has new ones in every frame.
    behind = weights[0] if smear_steps else weights[0] - [outside_pull, inside_pull] @ weights[4:6]
    squared = weights * weights
    share = 1.0 - np.sum(columns * (inverse @ (columns * weight)), axis=0)
    sums = [float(np.sum(share * disc**power)) for power in range(3)]
    return DiscTable(
        left,
        top,
        x.size,
        y.size,
        weights.astype(np.float32),
        columns.astype(np.float32),
        inverse,
        (gain(weights[0]), gain(weights[4]), gain(weights[5]), gain(weights[_BEND])),
        (outside_pull, inside_pull, bend_pull),
        tuple(sheared),
        (float(bend_weights @ outside), float(bend_weights @ inside)),
        (float(weights[4] @ bent), float(weights[5] @ bent)),
        list(zip(squared.sum(axis=1).tolist(), (squared @ disc).tolist(), strict=True)),
        np.linalg.inv(np.array([[sums[0], sums[1]], [sums[1], sums[2]]])),
        np.where(disc > _OUTSIDE, math.inf, 0.0).astype(np.float32),
        ((1.0 - disc) * behind).reshape(y.size, x.size).astype(np.float32),
    )


def _noise_beside_flat_top(
    table: DiscTable, grey: Float32Array, top: float, light: int
) -> tuple[float, float]:
    """Alpha and beta of the pixels that are not of the flat top, about a profile that is free."""
    is_beside = grey != top
    columns = table.columns[:, is_beside].astype(np.float64)
    disc = columns[2]
    columns = np.vstack([columns, *(disc**power for power in _FREE_POWERS)])
    root = 1.0 / np.sqrt(1.0 + _LIGHT_STEPS[light] * disc)
    basis = np.linalg.qr((columns * root).T)[0]
    weighted = grey[is_beside] * root
    squared = ((weighted - basis @ (basis.T @ weighted)) / root) ** 2
    share = 1.0 - np.sum(basis * basis, axis=1)
    sums = [float(np.sum(share * disc**power)) for power in range(3)]
    noise = np.linalg.pinv(np.array([[sums[0], sums[1]], [sums[1], sums[2]]]))
    alpha, beta = (noise @ [squared.sum(), squared @ disc]).tolist()
    return alpha, beta


class DiscFit(NamedTuple):
    """A disc found in an image.

    Attributes
    ----------
    u, v : float -- centre: the mean position over the exposure [px]
    sigma_u : float -- standard deviation of u [px]
    contrast : float -- height of the disc above its background [grey levels]
    wave : float -- by how much the rim is out of its usual round in this frame, beyond its noise; 0 where it is not
        [px]
    excess, tilt : float -- second moment along u beyond that of the disc at rest, and twice that along u and v [px^2]
    sigma_excess : float -- standard deviation of the less certain one of these two [px^2]
    """

    u: float
    v: float
    sigma_u: float
    contrast: float
    wave: float
    excess: float
    tilt: float
    sigma_excess: float


class Habit:
    """What a quantity usually is, and how much it varies beyond its noise: an expectation for the next frame.

    Parameters
    ----------
    spread : float -- by which variance it is expected to vary from frame to frame, before anything has been seen
    doubt : float -- variance of its mean before anything has been seen; 0: the mean is zero
    is_constant : bool -- True: what seems to vary is noise, unless it is too much for that

    Attributes
    ----------
    mean, spread, doubt : float
    """

    def __init__(self, spread: float, doubt: float, *, is_constant: bool = False) -> None:
        self.mean = 0.0
        self.spread = spread
        self.doubt = doubt
        self._is_constant = is_constant
        self._forgotten = 1.0 / (_CONSTANT_FRAMES if is_constant else _SLOW_FRAMES) if doubt > 0.0 else 0.0
        self._weight = self._telling = 0.0
        self._surprise, self._usual, self._values = 1.0, 1.0, 0

    def expect(self, value: float, variance: float, *, may_change: bool = True) -> tuple[float, float]:
        """Return the best estimate from a measured value and all before it, and its variance; then learn from it."""
        away = value - self.mean
        if self._is_constant and may_change:
            surprise = min(away * away / (self.doubt + variance), _SURPRISE_FRAMES * self._usual)
            self._surprise += (surprise - self._surprise) / _SURPRISE_FRAMES
            self._values += 1
            if self._surprise > _SURPRISED * self._usual and self._values > _SURPRISE_FRAMES:
                self.doubt = max(self.doubt, away * away)  # it has changed
            else:
                share = max(1.0 / self._values, 1.0 / _SLOW_FRAMES)
                self._usual = max(self._usual + share * (surprise - self._usual), 1.0)
        known = self.doubt + self.spread
        trust = known / (known + variance)
        best = self.mean + trust * away
        total = self.spread + variance
        # A frame that tells little is no reason to forget what others told.
        share = self._forgotten if self._telling > 0.0 else 1.0
        self._telling += share * (1.0 / total - self._telling)
        self.doubt = max(self.doubt, self._forgotten / self._telling)
        gain = self.doubt / (self.doubt + total)
        self.mean += gain * away
        self.doubt *= 1.0 - gain
        if not self._is_constant:
            # The information of a value about a variance goes with the inverse square of its own.
            information = 1.0 / (total * total)
            if self._weight == 0.0:
                self._weight = _PRIOR_FRAMES * information
            self._weight = (1.0 - 1.0 / _SLOW_FRAMES) * self._weight + information
            away = value - self.mean
            self.spread += (away * away - variance - self.spread) * information / self._weight
            self.spread = max(self.spread, 0.0)
        return best, trust * variance


class DiscModel:
    """The disc model of one marker: finds it, and learns its noise.

    Parameters
    ----------
    line : (float, float) or None -- variance of a pixel at level 0 [grey levels^2] and its growth with the level
        [grey levels], where they are known

    Attributes
    ----------
    disc : tuple of int -- radius and blur as they are tabulated, ``disc_steps``
    alpha, beta : float -- variance of a pixel in the background, and how much more it is on the marker [grey
        levels^2]
    rim : float -- variance of the rim's modes over what alpha and beta make of them
    """

    def __init__(self, line: tuple[float, float] | None = None) -> None:
        self._line = line
        self._clipped_sums = compiled_clipped_sums() or clipped_sums
        self._sums = np.empty(_TILT + 1, np.float32)
        self.disc = (0, 0)
        self.alpha = self.beta = 0.0
        self._left = 0.0, 0.0
        self.rim = 1.0
        self._frames = 0
        self._noise_frames = 0
        self._radius = self._edge = 0.0
        self._slopes = (Habit(_STEEP, _STEEP), Habit(0.0, _STEEP, is_constant=True))
        self._even_bend, self._bend = Habit(_BENT, 0.0), Habit(_BENT, 0.0)
        self._modes = [0.0] * (_MODES.stop - _MODES.start)
        self._mode_noise = 0.0
        self._last = math.nan
        self._roughness = 1.0, 1.0
        self._beside = self._behind = 0.0
        self._textures = 0

    @property
    def misfit(self) -> float:
        """Amplitude of the waves that the rim always shows, beyond what noise makes of them: 0 of a disc [px]."""
        squared = sum(mode * mode for mode in self._modes)
        return math.sqrt(max(squared - _UNLIKELY * self._mode_noise, 0.0))

    def fit(
        self,
        image: ImageArray,
        u: float,
        v: float,
        *,
        radius: float,
        edge: float,
        smear: float,
        least: float,
        ground: tuple[float, float],
        shear: float | None = None,
        bend: float = math.inf,
    ) -> DiscFit | None:
        """Find the disc near a point.

        Parameters
        ----------
        image : ndarray, shape (height, width), uint8 or uint16
        u, v : float -- where it is, to a pixel [px]
        radius, edge : float -- what is expected of it, until enough frames have shown it [px]
        smear : float -- length of its motion during the exposure, along u [px]
        least : float -- contrast below which it is none; negative for dark discs [grey levels]
        ground : (float, float) -- the background's grey levels: what lies outside of them, by more than the slope
            explains and away from the disc's side of them or beyond its rim, counts as the nearer one [grey levels]
        shear : float or None -- by how much its speed and a rolling shutter move every row, at most [px/px]; None
            where no shutter rolls
        bend : float -- how far its motion within the exposure bends, by its last places: b of b (t^2 - 1/12), from
            t = -1/2 to 1/2 [px]; infinity where they do not tell

        Returns
        -------
        DiscFit or None -- None where the image's edge cuts the fit, or no such disc is near
        """
        if self._noise_frames == 0:
            self._radius, self._edge = radius, edge
            self.disc = disc_steps(radius, edge, self.disc)
        disc = self.disc
        ratio = self._left[1] / self._left[0] if self._left[0] > 0.0 else 0.0
        light = bisect_left(_LIGHT_MIDDLES, ratio)
        start_u, start_v = u, v
        for _ in range(_MAX_STEPS):
            smear_steps = round(smear / _SMEAR_STEP_PX)
            at_u, at_v = round(u * _PHASES), round(v * _PHASES)
            table = _tabulated(at_u % _PHASES, at_v % _PHASES, *disc, smear_steps, light, shear is not None)
            left, top = at_u // _PHASES + table.left, at_v // _PHASES + table.top
            right, bottom = left + table.width, top + table.height
            if left < 0 or top < 0 or right > image.shape[1] or bottom > image.shape[0]:
                return None
            dip = abs(self._slopes[0].mean * least) * table.width
            bounds = ground[0] - dip, ground[1] + dip, least < 0.0
            self._clipped_sums(
                image, left, top, right, bottom, table.weights, table.beyond, *bounds, self._sums
            )
            sums = self._sums.tolist()
            contrast = sums[2]
            if contrast < least if least > 0.0 else contrast > least:
                return None
            thicker, softer = self._radius - disc[0] * RADIUS_STEP_PX, self._edge - disc[1] * EDGE_STEP_PX
            longer = (
                sums[_LENGTH] / contrast
                if smear_steps
                else self._unseen_smear(table, sums[_LENGTH], contrast)
            )
            gain = 1.0 + table.gains[0].at(thicker, softer, longer)
            step_u, step_v = sums[0] / (contrast * gain), sums[1] / contrast
            u, v = at_u / _PHASES + step_u, at_v / _PHASES + step_v
            if abs(u - start_u) > _LOST_PX or abs(v - start_v) > _LOST_PX:
                return None
            is_near = -_NEAR_PX <= step_u <= _NEAR_PX and -_NEAR_PX <= step_v <= _NEAR_PX
            if is_near and -_ALIKE_PX <= longer <= _ALIKE_PX:
                break
            # Each end of a smear moves by half of what its length changes.
            longer = min(max(longer, -2.0 * _LOST_PX), 2.0 * _LOST_PX)
            smear = max(smear_steps * _SMEAR_STEP_PX + longer, 0.0)
        self._frames += 1
        if self._frames <= _NOISE_EVERY_FRAMES or self._frames % _NOISE_EVERY_FRAMES == 0:
            grey = clipped(image, left, top, right, bottom, table.beyond, *bounds)
            self._look_closely(table, grey, light)
        if self._frames & (self._frames - 1) == 0 or self._frames % _CONSTANT_FRAMES == 0:
            self._look_beside(table, image, left, top, ground, contrast)
        shares = [value / contrast for value in sums]
        alpha, beta = self.alpha / (contrast * contrast), self.beta / (contrast * contrast)
        noise = [alpha * unit + beta * lit for unit, lit in table.variances]
        # Of the background's scatter, alpha includes what rests; so much of alpha changes with the frames as the rim
        # shows, and the remainder pulls as it lies there.
        fresh = min(self.rim, 1.0)
        behind = fresh * (noise[0] - self._behind * alpha) + self._beside
        variance = max(self.rim * noise[0], behind) / (gain * gain)
        # A texture adds to the second moments as to the place. What rests of the scatter, as of a picture that is
        # interpolated, is another one where the disc's own moments were learned: it counts for both places. Of the
        # rim's waves the short ones count, for a near second image makes long ones.
        rough = max(2.0 - fresh, self._roughness[1], behind / noise[0])
        length, other = smear_steps * _SMEAR_STEP_PX, (thicker, softer, longer)
        pull, pull_variance = self._pull(table, shares, noise, step_u, other, length, bend)
        u -= pull
        variance += pull_variance
        sheared = [] if shear is None else [(shear * change) ** 2 for change in table.sheared]
        wave = self._learn_rim(shares[_MODES], noise[_MODES], sheared)
        self._mode_noise = sum(noise[_MODES])
        # In the second moments, what the model leaves of a flat top shows.
        unit, lit = table.variances[_LENGTH]
        alpha, beta = (left / (contrast * contrast) for left in self._left)
        # A disc that is a step away from the tabulated point has the moments of that step, too.
        excess = shares[_LENGTH] - (step_u * step_u - step_v * step_v)
        tilt = shares[_TILT] - 2.0 * step_u * step_v
        sigma_excess = math.sqrt(rough * (alpha * unit + beta * lit))
        if smear_steps:
            # A motion of length s has the second moment s^2 / 12.
            excess, sigma_excess = (length + longer) ** 2 / 12, length / 6 * sigma_excess
        unit, lit = table.variances[_TILT]
        sigma_tilt = math.sqrt(rough * (alpha * unit + beta * lit))
        sigma = max(math.sqrt(variance), wave)
        return DiscFit(u, v, sigma, contrast, wave, excess, tilt, max(sigma_excess, sigma_tilt))

    def _pull(
        self,
        table: DiscTable,
        shares: list[float],
        noise: list[float],
        step_u: float,
        other: tuple[float, float, float],
        length: float,
        bend: float,
    ) -> tuple[float, float]:
        """What slopes and bend pull a centre by, and its variance [px, px^2]; learns from what is seen of them.

        Parameters
        ----------
        shares, noise : list of 14 float -- the sums over the contrast, and their variances by the noise
        step_u : float -- step from the tabulated point [px]
        other : tuple of 3 float -- what radius, blur and smear are more than tabulated [px]
        length : float -- of the tabulated smear [px]
        bend : float -- as in ``fit`` [px]
        """
        is_even = bend * bend <= noise[_BEND]
        told = 0.0 if is_even or math.isinf(bend) else bend
        # Of the step, what the slopes usually pull is none of the disc.
        moved = step_u - sum(tug * habit.mean for tug, habit in zip(table.pull, self._slopes, strict=False))
        shown = shares[_BEND] - moved * table.gains[3].at(*other)
        pull = variance = 0.0
        for i, habit in enumerate(self._slopes):
            # Of a smear the slopes tell less: how it bends may look like them, and is foretold to a part only.
            k, tug = _SLOPES[i], table.pull[i]
            slope, slope_variance = habit.expect(
                shares[k] - moved * table.gains[1 + i].at(*other) - table.sloped[i] * told,
                noise[k] + (table.sloped[i] * told) ** 2,
                may_change=length == 0.0,
            )
            pull += tug * slope
            shown -= table.bent[i] * slope
            variance += tug * tug * slope_variance
        if table.pull[2]:
            habit = self._even_bend if is_even else self._bend
            bent, bend_variance = habit.expect(shown / length, noise[_BEND] / (length * length))
            pull += table.pull[2] * bent * length
            variance += (table.pull[2] * length) ** 2 * bend_variance
        return pull, variance

    def _unseen_smear(self, table: DiscTable, moment: float, contrast: float) -> float:
        """Length of a smear that only the fit of a disc at rest shows, by its second moment along u [px]."""
        unit, lit = table.variances[_LENGTH]
        noise = math.sqrt(self._left[0] * unit + self._left[1] * lit)
        return (
            math.sqrt(12.0 * moment / contrast)
            if moment / contrast > _SMEARED * noise / abs(contrast)
            else 0.0
        )

    def _look_closely(self, table: DiscTable, grey: Float32Array, light: int) -> None:
        """Take alpha and beta from the residuals, and radius and blur from the whole fit."""
        columns = table.columns
        weighted = grey / (1.0 + np.float32(_LIGHT_STEPS[light]) * columns[2])
        solved = table.inverse @ (columns @ weighted)
        residual = grey - solved @ columns
        squared = residual * residual
        sums = np.array([float(squared.sum()), float(squared @ columns[2])])
        alpha, beta = left_alpha, left_beta = (table.noise @ sums).tolist()
        if self._line is not None:
            alpha = max(self._line[0] + self._line[1] * float(solved[3]), _ROUNDING)
            beta = self._line[1] * float(solved[2])
            left_alpha, left_beta = alpha, beta
        else:
            region, column, row = grey.reshape(table.height, table.width), -table.left, -table.top
            if has_flat_top(region, column, row, is_dark=solved[2] < 0.0):
                alpha, beta = _noise_beside_flat_top(table, grey, region[row, column], light)
        # The variance of a texture falls with T faster than this line, which must not lead below that of rounding.
        beta, left_beta = max(beta, _ROUNDING - alpha), max(left_beta, _ROUNDING - left_alpha)
        self._noise_frames += 1
        share = max(1.0 / self._noise_frames, _NOISE_EVERY_FRAMES / _SLOW_FRAMES)
        # Where all that scatters lies on the disc, the line leads below nothing beside it.
        self.alpha = max(self.alpha + share * (alpha - self.alpha), _ROUNDING)
        self.beta += share * (beta - self.beta)
        old_alpha, old_beta = self._left
        left_alpha = max(old_alpha + share * (left_alpha - old_alpha), _ROUNDING)
        self._left = left_alpha, old_beta + share * (left_beta - old_beta)
        radius = self.disc[0] * RADIUS_STEP_PX + float(solved[4] / solved[2])
        edge = self.disc[1] * EDGE_STEP_PX + float(solved[5] / solved[2])
        self._radius += share * (radius - self._radius)
        self._edge += share * (edge - self._edge)
        self.disc = disc_steps(self._radius, self._edge, self.disc)

    def _look_beside(
        self,
        table: DiscTable,
        image: ImageArray,
        left: int,
        top: int,
        ground: tuple[float, float],
        contrast: float,
    ) -> None:
        """Measure what the background on either side, were it behind the disc, would add to the variance of du.

        The weights of the fit are applied to it as it lies there, so that its scatter counts with whatever
        correlation it has. The part that its noise has in this is measured beside. Where something else than
        background lies, nothing is measured.
        """
        height, width = table.behind.shape
        seen = []
        for first in (max(0, left - width - _BESIDE_PX), left + width):
            last = min(first + width + _BESIDE_PX, left if first < left else image.shape[1])
            for row in _BESIDE_ROWS_PX:
                band = image[max(0, top + row) : top + row + height, max(0, first) : last].astype(np.float32)
                if band.shape[0] < height or band.shape[1] < width:
                    continue
                other = np.abs(band - 0.5 * (ground[0] + ground[1])).max(axis=0) > ground[1] - ground[0]
                others = np.concatenate([[0], np.cumsum(other)])
                pulls = cv2.matchTemplate(band, table.behind, cv2.TM_CCORR)[0]
                seen.append(np.abs(pulls[others[width:] == others[:-width]]))
        found = np.concatenate(seen) if seen else np.empty(0)
        if found.size < _BESIDE_PX:
            return
        squared = (float(np.median(found)) / _MEDIAN) ** 2
        self._textures += 1
        share = max(1.0 / self._textures, 1.0 / _TEXTURES)
        self._beside += share * (squared / (contrast * contrast) - self._beside)
        self._behind += share * (float(np.sum(table.behind**2)) - self._behind)

    def _learn_rim(self, modes: list[float], variances: list[float], sheared: Sequence[float] = ()) -> float:
        """Compare how the modes of the rim vary with what the noise makes of them.

        Parameters
        ----------
        modes, variances : list of float -- the modes, and their variances by the noise [px, px^2]
        sheared : sequence of float -- square of what a shear makes of each, at most [px^2]

        Returns
        -------
        float -- amplitude of the waves of a rim that is disturbed [px]; 0 where it is not

        Notes
        -----
        What lies beside the disc or covers a part of it excites all waves about alike, among them the one that is a
        move of the centre. Where n normal values of one variance are squared and summed, the sum over n - 2 is what
        makes the mean square of another such value over it 1. A frame in which the disc may be sheared tells as much
        less of where the long waves rest as their noise is less than all that may be in them.
        """
        # A frame that was seen before has no noise of its own.
        is_seen = (modes[0] - self._last) ** 2 <= _SAME * variances[0]
        self._last = modes[0]
        known = 1.0
        if sheared:
            known = variances[0] / (variances[0] + sheared[0])
            variances = [variance + of_shear for variance, of_shear in zip(variances, sheared, strict=True)]
        share = max(1.0 / self._frames, 1.0 / _SLOW_FRAMES)
        shares = [known * share] * _LONG_MODES + [share] * (len(modes) - _LONG_MODES)
        aways = [mode - mean for mode, mean in zip(modes, self._modes, strict=True)]
        squares = [
            (1.0 - s) * a * a / variance for s, a, variance in zip(shares, aways, variances, strict=True)
        ]
        most, total = _UNLIKELY * self.rim, sum(squares)
        is_disturbed = total > most * len(modes)
        if not is_disturbed:
            self._modes = [mean + s * away for s, mean, away in zip(shares, self._modes, aways, strict=True)]
        seen = self._frames - _NOISE_EVERY_FRAMES
        if seen > 0 and not is_seen:
            # About a mean of few frames they vary more than about the true one.
            pace = max(1.0 / (seen + _PRIOR_FRAMES), 1.0 / _SLOW_FRAMES)
            if max(squares) > most:
                squares = [min(square, most) for square in squares]
                total = sum(squares)
            of_long = sum(squares[:_LONG_MODES])
            of_short = total - of_long
            long, short = self._roughness
            long += pace * (of_long / _LONG_MODES - long)
            short += pace * (of_short / (len(modes) - _LONG_MODES) - short)
            self._roughness, self.rim = (long, short), max(long, short)
        return math.sqrt(sum(away * away for away in aways) / (len(modes) - 2)) if is_disturbed else 0.0
