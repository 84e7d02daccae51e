"""What a marker looks like: the light about it, and the disc that later frames are compared with.

Both are slow averages: the light follows lamps and clouds, the disc is averaged over a marker's first frames.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from statistics import NormalDist

from beam_ros.vision.parameters import TrackerParameters
from beam_ros.vision.tracking.centres import disc_steps
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
_SLOW = 0.15
"""Weight of a new value in the slow averages of brightness, background and noise."""
QUANTISATION_VARIANCE = 1.0 / 12.0


class Light:
    """Brightness about one marker and the levels that follow from it.

    Attributes
    ----------
    background, contrast, noise : float -- [grey levels]
    level : float -- what is subtracted (for dark markers: subtracted from), a whole grey level
    above : float -- distance of this level from the background
    height : float -- of a marker above this level, at least 1
    bounds : (float, float) -- whatever lies outside counts as the nearer one: a whole grey level beyond the
        background, away from the markers, that noise does not reach; and infinity
    speck : float -- mean grey level that noise alone leaves beyond the level
    speck_variance : float -- its variance
    """

    def __init__(
        self, parameters: TrackerParameters, background: float, contrast: float, noise: float
    ) -> None:
        self._fraction = parameters.level_fraction
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
        above = max(self._fraction * self.contrast, quiet, _NOISE_LEVEL * self.noise, 1.0)
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
    model: DiscModel = field(init=False, default_factory=DiscModel)

    def __post_init__(self) -> None:
        self.disc = (0, 0)
        self.derive()

    def derive(self) -> None:
        """Derive the disc from the present averages."""
        shift, share = _cut(self.level)
        squared = self.area / math.pi
        # The second moment of a disc is radius^2 / 4; blur adds its own.
        rim = max(self.variance_v - squared / 4, 0.1)
        self.edge = math.sqrt(rim / share)
        seen = math.sqrt(max(squared - rim, 1.0))
        self.radius = seen + shift * self.edge + rim / share / (2 * seen)
        self.disc = disc_steps(self.radius, self.edge, self.disc)
        self.is_settled = self.frames >= _SETTLING_FRAMES

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
