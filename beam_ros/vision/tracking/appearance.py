"""What a marker looks like: the light about it, and the disc that later frames are compared with.

Both are slow averages: the light follows lamps and clouds, the disc is averaged over a marker's first frames. How the
disc looks when it moves far during the exposure follows from how it looks at rest.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from statistics import NormalDist
from typing import NamedTuple

import numpy as np

from beam_ros.arrays import FloatArray
from beam_ros.vision.parameters import TrackerParameters
from beam_ros.vision.tracking.centres import cumulative_normal, disc_steps
from beam_ros.vision.tracking.disc_model import DiscModel

_NORMAL = NormalDist()
_NOISE_LEVEL = 2.5
"""The subtracted level lies at least this many noise standard deviations above the background, ..."""
_QUIET_LEVEL = 5.0
"""... and this many, which a texture behind the marker does not reach, ..."""
_MAX_QUIET = 1 / 3
"""... where they are no more than this fraction of the contrast."""
_FLOOR = 4.0
"""Whatever is further than so many noise standard deviations beyond the background, away from the markers, counts
as no more than that: a dark object beside a bright marker does not pull."""
_SETTLING_FRAMES = 32
"""Frames over which a marker's own appearance is averaged."""
_SAME_LEVEL = 0.01
"""Levels that differ by less show the same disc [of the contrast]."""
_MAX_LEVEL = 0.9
"""Of a contrast, at most so much is subtracted where a disc is derived."""
_LOOK_STEP = 0.01
"""Relative steps of area and second moment, and steps of level and noise [of the contrast], in which smeared markers
are computed."""
_DISC_STEPS, _DISC_STEP_PX, _MAX_DISC_STEP_PX = 5, 0.02, 1.0
"""A disc is found by its look in so many steps of Gauss-Newton, by differences over this and no longer than [px]."""
_MIN_DISC_PX = 1.0, 0.3, 0.5
"""Its radius, blur and smear are no less [px]."""
_LOOK_DOUBT = 0.003
"""Relative uncertainty of how a disc that is drawn looks."""
_USUAL_EDGE_PX, _EDGE_SPREAD_PX = 0.8, 0.4
"""Blur of a rim that is expected of an unknown lens, and its standard deviation [px]."""
_MAX_LENGTHS = 24
"""Smears are tabulated by the pixel, but for no more lengths than these."""
_MIN_NOISE = 1e-3
"""There is so much noise at least [of the contrast]."""
_SAMPLES_PER_PX = 2
"""Such discs are sampled so often per pixel, ..."""
_RIM = 4.0
"""... to so many standard deviations of the rim's blur beyond the radius."""
_MIN_VARIANCE = 0.1
"""No rim is sharper [px^2]."""
_ROOT = math.sqrt(2 * math.pi)
_SLOW = 0.15
"""Weight of a new value in the slow averages of brightness, background and noise."""
QUANTISATION_VARIANCE = 1.0 / 12.0


class Light:
    """Brightness about one marker and the levels that follow from it.

    Attributes
    ----------
    background, contrast, noise : float -- [grey levels]
    fraction : float -- of the contrast is subtracted at least
    level : float -- what is subtracted (for dark markers: subtracted from), a whole grey level
    above : float -- distance of this level from the background
    height : float -- of a marker above this level, at least 1
    bounds : (float, float) -- whatever lies outside counts as the nearer one: a whole grey level beyond the
        background, away from the markers, that noise does not reach; and infinity
    speck : float -- mean grey level that noise alone leaves beyond the level
    speck_variance : float -- its variance
    """

    def __init__(
        self,
        parameters: TrackerParameters,
        background: float,
        contrast: float,
        noise: float,
        fraction: float = 0.0,
    ) -> None:
        self.fraction = max(parameters.level_fraction, fraction)
        self._is_dark = parameters.polarity == "dark"
        self._fixed_noise = parameters.noise_grey
        self.background = background
        self.contrast = contrast
        self.noise = noise
        self.settle()

    def settle(self) -> None:
        """Derive the levels from the present averages."""
        if self._fixed_noise is not None:
            self.noise = self._fixed_noise
        quiet = min(_QUIET_LEVEL * self.noise, _MAX_QUIET * self.contrast)
        above = max(self.fraction * self.contrast, quiet, _NOISE_LEVEL * self.noise, 1.0)
        below = _FLOOR * self.noise
        if self._is_dark:
            self.level = float(math.floor(self.background - above))
            self.above = self.background - self.level
            self.bounds = -math.inf, float(math.ceil(self.background + below))
        else:
            self.level = float(math.ceil(self.background + above))
            self.above = self.level - self.background
            self.bounds = float(math.floor(self.background - below)), math.inf
        self.height = max(self.contrast - self.above, 1.0)
        self.speck = self.speck_variance = 0.0
        depth = self.above / self.noise if self.noise > 0 else math.inf
        if depth < 4.0:
            density = math.exp(-depth * depth / 2) / math.sqrt(2 * math.pi)
            tail = 0.5 * math.erfc(depth / math.sqrt(2))
            self.speck = self.noise * (density - depth * tail)
            self.speck_variance = (
                self.noise**2 * ((1 + depth * depth) * tail - depth * density) - self.speck**2
            )

    def absorb(self, plateau: float, left: float, right: float, variance: float) -> None:
        """Carry a valid spot's plateau, and the means and the variance at either side of it, into the averages."""
        # An object beside the marker is not background: the side that changed less counts.
        at_left, at_right = abs(left - self.background), abs(right - self.background)
        side = left if at_left < at_right else right
        if abs(at_left - at_right) < self.noise:
            side = 0.5 * (left + right)
        self.background += _SLOW * (side - self.background)
        self.contrast += _SLOW * (abs(plateau - self.background) - self.contrast)
        average = self.noise**2 + _SLOW * (variance - self.noise**2)
        self.noise = math.sqrt(max(average, QUANTISATION_VARIANCE))
        self.settle()


class Smeared(NamedTuple):
    """What a smear makes of a disc, over what it is at rest.

    Attributes
    ----------
    area, plateau, variance_v : float -- with the names of a ``Spot``
    scatter : float -- of the area and of the moments by noise, relative
    """

    area: float
    plateau: float
    variance_v: float
    scatter: float

    def over(self, rest: Smeared) -> Smeared:
        """Return this look over that at rest."""
        return Smeared(*(own / other for own, other in zip(self, rest, strict=True)))


UNSMEARED = Smeared(1.0, 1.0, 1.0, 1.0)


def _drawn(radius: float, edge: float, room: float) -> FloatArray:
    """Draw a blurred disc Phi((R - r) / e): a quarter of the plane, with so much room along u [px]."""
    reach = (radius + _RIM * edge) * _SAMPLES_PER_PX
    rows, columns = np.arange(reach), np.arange(reach + room * _SAMPLES_PER_PX)
    away = np.hypot(columns, rows[:, None]) / _SAMPLES_PER_PX
    return cumulative_normal((radius - away) / edge)


def _integral(disc: FloatArray) -> FloatArray:
    """Integral of a drawn disc along whole rows, from their middle [px]."""
    half = np.cumsum(disc[:, 1:] + disc[:, :-1], axis=1) / (2 * _SAMPLES_PER_PX)
    return np.hstack([-half[:, ::-1], np.zeros((len(disc), 1)), half])


def _smeared(integral: FloatArray, length: float) -> FloatArray:
    """Light of a smear, which is the difference of the integral over its length [px], as far as that is drawn."""
    away, share = divmod(length * _SAMPLES_PER_PX / 2, 1.0)
    middle, near = integral.shape[1] // 2, int(away)
    light = np.zeros((len(integral), middle + 1))
    at = middle + np.arange(middle - near)
    ahead = (1.0 - share) * integral[:, at + near] + share * integral[:, at + near + 1]
    behind = (1.0 - share) * integral[:, at - near] + share * integral[:, at - near - 1]
    light[:, : at.size] = (ahead - behind) / length
    return light


def _seen(light: FloatArray, level: float, noise: float) -> tuple[Smeared, float]:
    """Look of what is drawn above a level in noise, fractions of the contrast; and its second moment along u [px^2].

    Noise is never nothing, as grey levels are whole. Of light a above the level, noise s leaves a mean of
    a Phi(a / s) + s phi(a / s).
    """
    above, noise = light - level, max(noise, _MIN_NOISE)
    depth = above / noise
    above = above * cumulative_normal(depth) + noise * np.exp(-0.5 * depth * depth) / _ROOT
    above[1:] *= 2.0
    above[:, 1:] *= 2.0
    one = _SAMPLES_PER_PX
    plateau = float(light[0, 0] + 2.0 * light[one, 0] + 2.0 * light[0, one]) / 5.0
    if plateau <= level:
        return Smeared(math.inf, plateau, math.inf, math.inf), math.inf
    area = float(above.sum()) / one**2 / (plateau - level)
    along, across = (
        float(sums @ (np.arange(sums.size) / one) ** 2) / float(sums.sum())
        for sums in (above.sum(axis=0), above.sum(axis=1))
    )
    return Smeared(area, plateau, across, 1.0 / ((plateau - level) * math.sqrt(area))), along


def _solved(
    look: Callable[[FloatArray], Sequence[float]],
    seen: Sequence[float],
    doubt: Sequence[float],
    usual: Sequence[float],
    spread: Sequence[float],
) -> FloatArray:
    """Sizes of a disc, and of its smear, that most likely look as something is seen [px].

    Parameters
    ----------
    look : callable -- numbers by which discs of some sizes look
    seen, doubt : sequence of float -- these numbers, and their relative standard deviations
    usual, spread : sequence of float -- usual sizes, from which the search begins, and their standard deviations [px]
    """
    sizes, logs, known = np.array(usual), np.log(seen), np.diag(1.0 / np.array(spread))
    weight = 1.0 / np.array(doubt)[:, None]
    for _ in range(_DISC_STEPS):
        now = np.log(look(sizes))
        if not np.isfinite(now).all():  # nothing is left above the level
            break
        ahead = np.array([np.log(look(sizes + step)) - now for step in _DISC_STEP_PX * np.eye(sizes.size)])
        rows = np.vstack([weight * ahead.T / _DISC_STEP_PX, known])
        left = np.concatenate([weight[:, 0] * (logs - now), known @ (usual - sizes)])
        step = np.linalg.lstsq(np.nan_to_num(rows), left, rcond=None)[0]
        sizes = np.maximum(
            sizes + np.clip(step, -_MAX_DISC_STEP_PX, _MAX_DISC_STEP_PX), _MIN_DISC_PX[: sizes.size]
        )
    return sizes


class SmearedLooks:
    """How a marker looks above a level however far it moved along u during the exposure.

    Parameters
    ----------
    area, variance : float -- of the marker at rest, and its second moment along v [px^2]
    level, noise : float -- what is subtracted, and the noise of a pixel, as fractions of the contrast
    longest_px : float -- smear up to which it is needed [px]

    Notes
    -----
    The marker is taken for the blurred disc that has its area and moment at rest. A smear lengthens it along u, sinks
    its ends below the level, and takes light from its middle once it is about as long as a chord.
    """

    def __init__(self, area: float, variance: float, level: float, noise: float, longest_px: float) -> None:
        self._area, self._variance, self._longest_px = area, variance, longest_px
        self._level, self._noise = level, noise
        self._table: tuple[list[float], list[Smeared]] | None = None

    def _made_table(self) -> tuple[list[float], list[Smeared]]:
        """Growing second moments along u beyond that at rest [px^2], and what is seen with each."""
        level, noise = self._level, self._noise

        def look(size: FloatArray) -> tuple[float, float]:
            seen, _ = _seen(_drawn(size[0], size[1], 0.0), level, noise)
            return seen.area, seen.variance_v

        radius = math.sqrt(self._area / math.pi)
        usual, spread = (radius, _USUAL_EDGE_PX), (radius, _EDGE_SPREAD_PX)
        size = _solved(look, (self._area, self._variance), (_LOOK_DOUBT, _LOOK_DOUBT), usual, spread)
        disc = _drawn(size[0], size[1], self._longest_px / 2 + 1.0)
        integral, (own, own_u) = _integral(disc), _seen(disc, level, noise)
        excesses, looks = [0.0], [UNSMEARED]
        count = min(math.ceil(self._longest_px), _MAX_LENGTHS)
        for length in np.linspace(0.0, self._longest_px, count + 1)[1:].tolist():
            seen, along = _seen(_smeared(integral, length), level, noise)
            if math.isinf(seen.area):
                break
            if along - own_u > excesses[-1]:
                excesses.append(along - own_u)
                looks.append(seen.over(own))
        return excesses, looks

    def at(self, excess: float) -> Smeared:
        """Look of the smear that adds so much to the second moment along u [px^2]; the longest one's beyond it."""
        if excess <= 0.0:
            return UNSMEARED  # which the table begins with: most markers never need one
        if self._table is None:
            self._table = self._made_table()
        excesses, looks = self._table
        after = bisect_left(excesses, excess)
        if after == len(excesses):
            return looks[-1]
        share = (excess - excesses[after - 1]) / (excesses[after] - excesses[after - 1])
        area, plateau, variance_v, scatter = looks[after - 1]
        beyond = looks[after]
        return Smeared(
            area + share * (beyond.area - area),
            plateau + share * (beyond.plateau - plateau),
            variance_v + share * (beyond.variance_v - variance_v),
            scatter + share * (beyond.scatter - scatter),
        )


def smear_of(
    area: float,
    variance_u: float,
    variance_v: float,
    level: float,
    noise: float,
    radius: tuple[float, float],
    longest_px: float,
) -> Smeared:
    """What a smear has most likely made of a disc of which nothing is known but its look, and about how large it is.

    Parameters
    ----------
    area, variance_u, variance_v : float -- of what is seen [px^2]
    level, noise : float -- what is subtracted, and the noise of a pixel, as fractions of the height that is seen
    radius : (float, float) -- of the disc, and its standard deviation [px]
    longest_px : float -- about the longest smear [px]
    """

    def drawn(size: FloatArray) -> tuple[Smeared, float]:
        light = _smeared(_integral(_drawn(size[0], size[1], size[2] / 2 + 1.0)), size[2])
        shown = float(light[0, 0])
        return _seen(light, level * shown, noise * shown)

    def look(size: FloatArray) -> tuple[float, float, float]:
        seen, along = drawn(size)
        return seen.area, seen.variance_v, along

    scatter = noise / ((1.0 - level) * math.sqrt(area))
    doubt = [_LOOK_DOUBT + part * scatter for part in (1.0, 1.6, 1.6)]
    length = min(math.sqrt(12.0 * max(variance_u - variance_v, 0.0)), longest_px)
    usual, spread = (radius[0], _USUAL_EDGE_PX, length), (radius[1], _EDGE_SPREAD_PX, longest_px)
    size = _solved(look, (area, variance_v, variance_u), doubt, usual, spread)
    seen, _ = drawn(size)
    rest, _ = _seen(_drawn(size[0], size[1], 0.0), level * seen.plateau, noise * seen.plateau)
    return seen.over(rest) if math.isfinite(seen.area) else UNSMEARED


def smeared_looks(
    area: float, variance: float, level: float, noise: float, longest_px: float
) -> SmearedLooks:
    """Return how a marker looks smeared, to a percent of what a ``SmearedLooks`` is made for."""
    known = math.log(max(area, 1.0)), math.log(max(variance, 0.1)), level, noise
    return _tabulated(*(round(number / _LOOK_STEP) for number in known), longest_px)


@lru_cache(maxsize=512)
def _tabulated(
    area_steps: int, variance_steps: int, level_steps: int, noise_steps: int, longest_px: float
) -> SmearedLooks:
    area, variance = (math.exp(steps * _LOOK_STEP) for steps in (area_steps, variance_steps))
    return SmearedLooks(area, variance, level_steps * _LOOK_STEP, noise_steps * _LOOK_STEP, longest_px)


@dataclass(slots=True)
class Appearance:
    """A marker as it was acquired: what later frames are compared with.

    Attributes
    ----------
    area : float -- [px^2]
    variance_u, variance_v : float -- second moments without smear [px^2]
    skew_u, skew_v : float -- asymmetry
    row : float -- v [px]
    frames : int -- frames averaged
    level : float -- height of the subtracted level above the background, as a fraction of the contrast
    excess : float -- second moment along u beyond that along v, without smear [px^2]
    tilt : float -- twice the second moment along u and v [px^2]
    radius, edge : float -- of the disc, and the standard deviation of its rim's blur [px]
    disc : tuple of int -- the two, as the apertures are tabulated
    is_settled : bool -- it is averaged over enough frames
    is_disc : bool -- False: a compact thing of another shape, of which only the centre of gravity is meant
    is_shared : bool -- most markers share that other shape, so that it is no second image
    is_bounded : bool -- the ground about it ends nearer than a smear may reach, as that of a label
    uneven : float -- mean square of how far uneven light pulls the centre, as far as it shows beyond noise [px^2]
    model : DiscModel -- what is fitted to it, and learns its noise
    """

    area: float
    variance_u: float
    variance_v: float
    skew_u: float
    skew_v: float
    row: float
    frames: int = 1
    level: float = 0.0
    excess: float = 0.0
    tilt: float = 0.0
    radius: float = field(init=False)
    edge: float = field(init=False)
    disc: tuple[int, int] = field(init=False)
    is_settled: bool = field(init=False)
    is_disc: bool = field(init=False, default=True)
    is_shared: bool = field(init=False, default=False)
    is_bounded: bool = field(init=False, default=False)
    uneven: float = field(init=False, default=0.0)
    model: DiscModel = field(init=False, default_factory=DiscModel)

    def __post_init__(self) -> None:
        self.disc = (0, 0)
        self.derive()

    def derive(self) -> None:
        """Derive the disc from the present averages."""
        shift, share = _cut(self.level)
        squared = self.area / math.pi
        # The second moment of a disc is radius^2 / 4; blur adds its own.
        rim = max(self.variance_v - squared / 4, _MIN_VARIANCE)
        self.edge = math.sqrt(rim / share)
        seen = math.sqrt(max(squared - rim, 1.0))
        self.radius = seen + shift * self.edge + rim / share / (2 * seen)
        self.disc = disc_steps(self.radius, self.edge, self.disc)
        self.is_settled = self.frames >= _SETTLING_FRAMES

    def change(self, area: float, variance: float) -> None:
        """Take a growth of the area, relative, and of the second moments [px^2] into the averages."""
        self.area *= 1.0 + area
        self.variance_u = max(self.variance_u + variance, _MIN_VARIANCE)
        self.variance_v = max(self.variance_v + variance, _MIN_VARIANCE)
        self.derive()

    def changes(self, level: float) -> tuple[float, float]:
        """Changes of the area and of both second moments where another level is subtracted [px^2]."""
        if abs(level - self.level) < _SAME_LEVEL:
            return 0.0, 0.0
        (area, variance), (own_area, own_variance) = self._seen(level), self._seen(self.level)
        return area - own_area, variance - own_variance

    def _seen(self, level: float) -> tuple[float, float]:
        """Area and second moment of the disc above a level: the reverse of ``derive`` [px^2]."""
        shift, share = _cut(level)
        inside = self.radius - shift * self.edge
        seen = 0.5 * (inside + math.sqrt(max(inside * inside - 2 * self.edge * self.edge, 0.0)))
        rim = share * self.edge * self.edge
        squared = seen * seen + rim
        return math.pi * squared, rim + squared / 4


def _cut(level: float) -> tuple[float, float]:
    """What a level leaves of a rim that is blurred by a normal distribution.

    That is a distribution cut off there, whose mean lies so many standard deviations (the first number) inside of the
    whole one's and whose variance is smaller by a factor (the second).
    """
    if level <= 0.0:
        return 0.0, 1.0
    depth = _NORMAL.inv_cdf(min(level, _MAX_LEVEL))
    shift = _NORMAL.pdf(depth) / (1 - min(level, _MAX_LEVEL))
    return shift, 1 + depth * shift - shift * shift
