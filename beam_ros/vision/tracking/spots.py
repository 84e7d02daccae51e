"""One spot in a small region: whether it still looks as it did, then its centre and its uncertainty.

The background plus a twentieth of the contrast (more where the noise asks for it) is subtracted with
saturation, which silences the background without the error of a hard threshold. Zeroth to third moments of
what remains give place, area, second moments and asymmetry: a spot that is partly covered, merged with another
one or lit from beside changes them long before its centre has moved far. Tolerances are a floor for what real
markers do plus five standard deviations of what the image noise does. Where a spot that passes is centred is
then measured in an aperture (``vision.tracking.centres``), which has no bias by the pixel grid and gives the mean
position over the exposure however far the marker moved.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from itertools import repeat
from typing import Literal, NamedTuple

import cv2
import numpy as np

from beam_ros.arrays import ImageArray
from beam_ros.vision.mosaic import is_mosaic
from beam_ros.vision.parameters import TrackerParameters
from beam_ros.vision.tracking.appearance import (
    QUANTISATION_VARIANCE,
    Appearance,
    Light,
    Smeared,
    SmearedLooks,
    smear_of,
    smeared_looks,
)
from beam_ros.vision.tracking.centres import (
    aperture_at,
    clipped_sums,
    compiled_clipped_sums,
    has_flat_top,
    radial_symmetry_centre,
)
from beam_ros.vision.tracking.disc_model import DiscFit, DiscModel
from beam_ros.vision.tracking.moments import (
    SEEN,
    UNKNOWN,
    compiled_spot_numbers,
    first_moments,
    spot_numbers,
)
from beam_ros.vision.tracking.second_image import Motion

Reason = Literal[
    "ok",
    "not_acquired",
    "no_contrast",
    "mosaic",
    "ring",
    "out_of_round",
    "repeated",
    "hidden",
    "ambiguous",
    "area",
    "shape",
    "asymmetry",
    "smear",
    "brightness",
    "jump",
    "border",
]
"""Why a measurement is not valid; "ok" where it is.

not_acquired: the marker has not been found yet; no_contrast: nothing in the image stands out; mosaic: the
pixels differ as behind the filters of a colour sensor; ring: what is like a marker has a hole; out_of_round:
most of what is like a marker is wider than high, or the reverse, by more than its motion explains; repeated: the
image is the one before, noise aside, though the markers moved; hidden: no spot where the marker should be;
ambiguous: it cannot be distinguished from another spot; area, shape, asymmetry, brightness: the spot differs from
the marker as acquired (covered, merged with another spot, glare, out of focus); smear: longer than its speed
explains, as of a second image over it; jump: too far from the prediction or from the marker's row; border:
cut by the edge of the image.
"""

_REASONS: tuple[Reason, ...] = "ok", "hidden", "border"
"""What comes of looking for a spot, in words: SEEN, HIDDEN and BORDER."""
_UNEVEN_NOISE, _UNEVEN_PIXELS = 1.8, 0.6
"""What noise and pixels do to a disc's asymmetry (``SpotMeter.uneven_pull``)."""
_UNEVEN_SHARE, _UNEVEN_DOUBT, _STRIKING = 1 / 8, 0.8, 16.0
"""Share of a new frame in the mean square of the asymmetry, what of that is doubted, and what of one frame is not,
both over the square of its noise."""
_REFINED_PX = 4
"""A refinement uses the pixels up to this far beyond a marker's radius [px]."""
_SIDE_PX = 2
"""Width of the columns at either side of the region in which the background is measured [px]."""
_CLEAR_SHARE, _CLEAR_NOISE = 2.0, 2.5
"""The level lies so many times as far from the background as what a marker lies on, and so many standard deviations
of the noise beyond, ..."""
_MAX_CLEAR = 0.5
"""... up to so much of the contrast: the rim then looks about as wide above and below as at the sides."""
_CLEAR_PX = 3
"""Room between the longest smear of a marker and these columns [px]."""
APART_PX = 4
"""A thing whose half height lies so far from a region is not seen in it: its blur, and a step of the region [px]."""
_SIGNIFICANT = 5.0
"""Standard deviations of the image noise that a gate leaves room for."""
_DIP = 2.5
"""Whatever is further than so many noise standard deviations from the background, away from the markers or beyond
their rim, counts as no more than that to the disc model."""
_EXCESS_SCATTER = math.sqrt(2.0) * 1.6
"""Standard deviation of the difference of two second moments over ``disc_scatter`` times such a moment."""
_BENT = 0.5 / 120
"""A speed v that grows by a during the exposure adds v^2 a / 120 to the third moment; it may by half of itself."""
_ROUND = 0.01
"""No marker is made to a smaller part of its radius."""
_SHORT_PX = 1.5
"""A smear that is shorter is not seen in the moments, which the pixel grid moves by about as much [px]."""
_MAX_SMEARS = 1.5
"""What has so many times the second moment of the longest smear is none."""
_SMEARED = 2.0
"""A second moment along u shows a smear beyond so many standard deviations of its noise."""
_ALIKE = 9.0
"""Either side shows the same noise and texture where its variance is no more than so many times the other one's: a
coarse texture has few grains in so few columns."""
_CHANGED = 2.0
"""A disc has changed by what is more than so many standard deviations of its noise."""
_LONGER = 1.2
"""A smear is so many times as long as the part of it that stands above the subtracted level."""
_BELOW = 2.0
"""The least of the values over which an appearance is averaged lies so many standard deviations below them all."""
_SIDES = 8
"""A ring is seen in so many directions."""
_EVEN = 0.1
"""A marker is acquired only where the background at either side agrees to this fraction of its contrast."""


class Spot(NamedTuple):
    """What a region shows.

    Attributes
    ----------
    u, v : float -- centre of gravity [px]
    mass : float -- sum of the grey levels beyond the subtracted level
    area : float -- mass over the height of the plateau [px^2]
    variance_u, variance_v, covariance : float -- second central moments over the mass [px^2]
    skew_u, skew_v : float -- third central moments over the cube of the radius of gyration
    plateau : float -- mean of the five pixels at the centre [grey levels]
    region : tuple of int -- left, top, right, bottom of the region, the last two exclusive [px]
    """

    u: float
    v: float
    mass: float
    area: float
    variance_u: float
    variance_v: float
    covariance: float
    skew_u: float
    skew_v: float
    plateau: float
    region: tuple[int, int, int, int]


class Sides(NamedTuple):
    """The background at either side of a spot: mean grey levels, and the mean of the two variances where alike."""

    left: float
    right: float
    variance: float


class Relief(NamedTuple):
    """What stands out of its neighbourhood in a part of an image.

    Attributes
    ----------
    height : ndarray, shape (height, width) -- by how much every pixel does, towards the markers' light [grey levels]
    ground : ndarray, shape (height, width) -- what it stands out of [grey levels]
    """

    height: ImageArray
    ground: ImageArray

    @property
    def most(self) -> float:
        """The most by which anything stands out [grey levels]."""
        return cv2.minMaxLoc(self.height)[1]


class Blob(NamedTuple):
    """Where something of about a marker's size stands out.

    Attributes
    ----------
    u, v : float -- middle of its bounding box [px]
    ground : float -- what it stands out of [grey levels]
    is_crowded : bool -- another spot reaches into its surroundings
    """

    u: float
    v: float
    ground: float
    is_crowded: bool


Bounds = tuple[float, float]
Way = tuple[float | None, float]
"""Shear and bend that a marker's motion makes of its image, as in ``DiscModel.fit`` [px/px, px]."""


class Smears(NamedTuple):
    """What is known of smears of a marker.

    Attributes
    ----------
    own_u, scatter : float -- second moment along u without smear, and its standard deviation by noise [px^2]
    background : float -- [grey levels]
    rest : tuple of 4 float -- area and second moment along v at rest [px^2]; level and noise [of the contrast]
    longest_px : float -- the longest smear that counts [px]
    """

    own_u: float
    scatter: float
    background: float
    rest: tuple[float, float, float, float]
    longest_px: float

    @property
    def looks(self) -> SmearedLooks:
        """What smears make of the marker."""
        return smeared_looks(*self.rest, self.longest_px)


class Gates(NamedTuple):
    """Bounds between which a spot passes for the marker, in the units of ``Spot``.

    Attributes
    ----------
    row, brightness, area, variance_v, variance_u, skew_u, skew_v : (float, float)
    correlation, lean : float -- largest covariance over the geometric mean of the variances, beside its own [px^2]
    plain_u : float -- second moment along u up to which noise explains it [px^2]
    smears : Smears -- what a smear makes of the others beyond that
    """

    row: Bounds
    brightness: Bounds
    area: Bounds
    variance_v: Bounds
    variance_u: Bounds
    correlation: float
    lean: float
    skew_u: Bounds
    skew_v: Bounds
    plain_u: float
    smears: Smears


def disc_scatter(light: Light, area: float) -> float:
    """Relative scatter of a disc by white noise.

    The standard deviations of area, second moments and asymmetry are this number times 1, 1.6 and 2.2.
    """
    return light.noise / (light.height * math.sqrt(area))


def upright_spot(spot: Spot, shear: float, doubt: float) -> Spot:
    """Return a spot without the covariance that a rolling shutter's shear explains, give or take a doubt [px/px].

    Less shear than that is none, or of a readout that is shorter than stated.
    """
    half = 0.5 * shear
    left = _beyond(spot.covariance - half * spot.variance_v, (abs(half) + doubt) * spot.variance_v)
    return spot._replace(covariance=left)


def _middle(bounds: Bounds) -> tuple[float, float]:
    """Middle of some bounds, and how far they are from it."""
    return 0.5 * (bounds[0] + bounds[1]), 0.5 * (bounds[1] - bounds[0])


def _beyond(value: float, noise: float) -> float:
    """What of a value is more than so much noise of either sign."""
    return math.copysign(max(abs(value) - noise, 0.0), value)


def _at_rest(value: float, bounds: Bounds, scatter: float, *shares: float) -> float:
    """What a smeared spot would show at rest, by noise that is there so many times less.

    Of what the smear may leave of it, between two shares, that counts which is nearest to the middle of its bounds.
    """
    usual = 0.5 * (bounds[0] + bounds[1])
    below, above = sorted(value / share - usual for share in shares)
    return usual + (below if below > 0.0 else min(above, 0.0)) / scatter


def _bent(excess: float, variance_u: float) -> float:
    """Asymmetry along u that a smear may have of its own, of which so much of a second moment is [px^2]."""
    squared = max(12.0 * excess, 0.0) / variance_u
    return _BENT * squared * math.sqrt(squared)


class SpotMeter:
    """Measures spots of a marker's size.

    Parameters
    ----------
    parameters : TrackerParameters
    """

    def __init__(self, parameters: TrackerParameters) -> None:
        self.parameters = parameters
        self.radius = parameters.marker_diameter_px / 2
        self.half = math.ceil(self.radius + parameters.max_smear_px / 2 + _CLEAR_PX)
        self.narrow_half = math.ceil(self.radius + _CLEAR_PX)
        self.smear_variance = parameters.max_smear_px**2 / 12
        self._tallest = (1 + parameters.diameter_tolerance) * parameters.marker_diameter_px + 2
        self._column = np.ones((2 * math.ceil(self._tallest / 2) + 1, 1), np.uint8)
        self._is_dark = parameters.polarity == "dark"
        self._least_area = 0.25 * math.pi * self.radius**2
        self._compiled = compiled_spot_numbers()
        self._clipped_sums = compiled_clipped_sums() or clipped_sums
        self._sums = np.empty(3, np.float32)

    # -- moments -------------------------------------------------------------------------------------------

    def measure(
        self, image: ImageArray, u: float, v: float, light: Light, *, is_narrow: bool = False
    ) -> tuple[Spot | None, Reason]:
        """Measure the spot near (u, v), as ``measure_all`` does."""
        return self.measure_all(image, [(u, v, light, is_narrow)])[0]

    def measure_all(
        self, image: ImageArray, places: Collection[tuple[float, float, Light, bool]]
    ) -> list[tuple[Spot | None, Reason]]:
        """Measure the spots near some places.

        Parameters
        ----------
        image : ndarray, shape (height, width), uint8 or uint16
        places : collection of (float, float, Light, bool) -- where to look, u and v [px]; background, contrast
            and noise there; and whether to leave no room for smear, because another spot is near

        Returns
        -------
        list of (Spot or None, Reason) -- "ok", or "hidden" or "border" with None
        """
        is_dark, measure = self._is_dark, self._compiled or spot_numbers
        sums: Iterator[Sequence[float]] = repeat(UNKNOWN)
        if self._compiled is None:
            wide = [(u, v, light.level) for u, v, light, is_narrow in places if not is_narrow]
            if len(wide) == len(places) > 1:
                sums = iter(first_moments(image, wide, self.half, is_dark))
        found: list[tuple[Spot | None, Reason]] = []
        reach, least_area = self.radius + 1.0, self._least_area
        for u, v, light, is_narrow in places:
            half, least = self.narrow_half if is_narrow else self.half, least_area * light.contrast
            seen, numbers = measure(
                image, u, v, half, light.level, light.speck, least, reach, is_dark, next(sums)
            )
            found.append((Spot._make(numbers) if seen == SEEN else None, _REASONS[seen]))
        return found

    def sides(self, image: ImageArray, spot: Spot) -> Sides:
        """Measure the outermost columns of a spot's region."""
        left, top, right, bottom = spot.region
        mean_left, at_left = cv2.meanStdDev(image[top:bottom, left : left + _SIDE_PX])
        mean_right, at_right = cv2.meanStdDev(image[top:bottom, right - _SIDE_PX : right])
        count = _SIDE_PX * (bottom - top)
        lower, higher = sorted((at_left.item(), at_right.item()))
        lower = max(lower * lower * count / (count - 1), QUANTISATION_VARIANCE)
        # What passes on one side is no noise of the background.
        variance = 0.5 * (lower + min(max(higher * higher * count / (count - 1), lower), _ALIKE * lower))
        return Sides(mean_left.item(), mean_right.item(), variance)

    def is_clipped(self, image: ImageArray, u: float, v: float) -> bool:
        """True when the pixels about a place are all of the one grey level that no pixel of the picture exceeds."""
        return has_flat_top(image, max(1, round(u)), max(1, round(v)), is_dark=self._is_dark)

    @staticmethod
    def is_mosaic(image: ImageArray, spot: Spot, light: Light) -> bool:
        """True when the pixels about a spot differ as behind a mosaic of colour filters."""
        left, top, right, bottom = spot.region
        return is_mosaic(image[top:bottom, left:right], light.background, light.noise)

    def is_ring(self, image: ImageArray, u: float, v: float, background: float) -> bool:
        """True when what lies about a place is a ring: as bright as a marker on all sides and not in the middle."""
        parameters = self.parameters
        turns = np.arange(_SIDES) * 2.0 * math.pi / _SIDES
        away = np.arange(math.ceil(self.radius * (1.0 + parameters.diameter_tolerance)) + 1)[:, None]
        height, width = image.shape
        columns = np.clip(np.rint(u + away * np.cos(turns)), 0, width - 1).astype(np.intp)
        rows = np.clip(np.rint(v + away * np.sin(turns)), 0, height - 1).astype(np.intp)
        light = image[rows, columns] - background
        around = float((-light if self._is_dark else light).max(axis=0).min())
        middle = abs(float(image[rows[:2], columns[:2]].mean()) - background)
        return around >= parameters.min_contrast_grey and middle < 0.5 * around

    def is_compact(self, image: ImageArray, spot: Spot, light: Light) -> bool:
        """True when a spot ends within its region above and below, as discs do that touch; a bar does not."""
        left, top, right, bottom = spot.region
        edges = image[[top, bottom - 1], left:right]
        even = light.above + 3.0 * light.noise
        if self._is_dark:
            return bool(edges.min() > light.background - even)
        return bool(edges.max() < light.background + even)

    def _smear(self, variance_u: float, unsmeared: float) -> float:
        """Length of a spot's motion in the exposure by its second moments, a sixth too short for the level [px]."""
        excess, most = variance_u - unsmeared, self.smear_variance
        return math.sqrt(12.0 * (excess if excess < most else most)) if excess > 0.0 else 0.0

    def centre(self, image: ImageArray, spot: Spot, light: Light, appearance: Appearance) -> DiscFit | Reason:
        """Centre of gravity in a smooth aperture about a spot, with its standard deviation along u.

        Returns
        -------
        DiscFit; or "border" where the edge of the image cuts the aperture, "hidden" where it is
            empty
        """
        smear = self._smear(spot.variance_u, appearance.variance_v)
        aperture, left, top, u, v = aperture_at(spot.u, spot.v, appearance.disc, smear)
        _, _, width, height, weights, beyond, (sum_w, sum_u, sum_v), gain_u, gain_v, noise = aperture
        right, bottom, (rows, columns), (low, high) = left + width, top + height, image.shape, light.bounds
        if left < 0 or top < 0 or right > columns or bottom > rows:
            return "border"
        sums = self._sums
        self._clipped_sums(image, left, top, right, bottom, weights, beyond, low, high, self._is_dark, sums)
        mass, first_u, first_v = sums.tolist()
        base = light.background
        mass -= base * sum_w
        if (-mass if self._is_dark else mass) < self._least_area * light.contrast:
            return "hidden"
        return DiscFit(
            u + (first_u - base * sum_u) / (mass * gain_u),
            v + (first_v - base * sum_v) / (mass * gain_v),
            light.noise * noise / mass,
            light.contrast,
            0.0,
            spot.variance_u - spot.variance_v,
            2.0 * spot.covariance,
            self._excess_scatter(light, appearance),
        )

    def _excess_scatter(self, light: Light, appearance: Appearance) -> float:
        """Standard deviation by noise of the second moment along u beyond that along v [px^2]."""
        return _EXCESS_SCATTER * disc_scatter(light, appearance.area) * appearance.variance_v

    def located(
        self, image: ImageArray, spot: Spot, light: Light, disc: Appearance, way: Way | None
    ) -> DiscFit | Reason:
        """Find a marker as ``refine`` does, or without its way in the exposure as ``centre`` does.

        The first time its own shape is learned, which may be no disc's.
        """
        known = image, spot, light, disc
        found = self.centre(*known) if way is None else self.refine(*known, *way)
        if disc.frames == 1 and isinstance(found, DiscFit):
            was_disc = disc.is_disc
            self.begin(found, disc)
            if was_disc and not disc.is_disc:
                return self.located(*known, way)
        return found

    def refine(
        self,
        image: ImageArray,
        spot: Spot,
        light: Light,
        appearance: Appearance,
        shear: float | None = None,
        bend: float = math.inf,
    ) -> DiscFit | Reason:
        """Centre and standard deviation by the disc model, or by radial symmetry where the parameters ask for it.

        Parameters
        ----------
        image : ndarray, shape (height, width), uint8 or uint16
        spot, light, appearance : Spot, Light, Appearance -- what is seen, and what is known of the marker
        shear, bend : float or None, float -- as in ``DiscModel.fit`` [px/px, px]

        Returns
        -------
        DiscFit -- that of ``centre`` where the disc model fails; or a reason as there, or "shape" where the rim is
            disturbed by more than the tolerance of the shape
        """
        if not appearance.is_disc:
            return self.centre(image, spot, light, appearance)
        # A smear that the moments do not show beyond their noise, and that of their pixels, the fit itself finds.
        still = max(appearance.variance_u, appearance.variance_v + appearance.excess)
        noise = max(_SMEARED * self._excess_scatter(light, appearance), _SHORT_PX**2 / 12)
        smear = _LONGER * self._smear(spot.variance_u, still) if spot.variance_u - still > noise else 0.0
        found = self._fitted(image, spot, light, appearance, smear, shear, bend)
        if found is None:
            return self.centre(image, spot, light, appearance)
        if found.wave > self.parameters.shape_tolerance * self.radius:
            return "shape"
        if self.parameters.refinement == "radial_symmetry":
            found = self._crossing(image, spot, light, appearance.model, smear, found)
        return found

    def _fitted(
        self,
        image: ImageArray,
        spot: Spot,
        light: Light,
        appearance: Appearance,
        smear: float,
        shear: float | None = None,
        bend: float = math.inf,
    ) -> DiscFit | None:
        """Fit the disc model to a spot, with a smear of some length to begin with [px]."""
        return appearance.model.fit(
            image,
            spot.u,
            spot.v,
            radius=appearance.radius,
            edge=appearance.edge,
            smear=smear,
            least=-0.5 * light.contrast if self._is_dark else 0.5 * light.contrast,
            ground=(light.background - _DIP * light.noise, light.background + _DIP * light.noise),
            shear=shear,
            bend=bend,
        )

    def _crossing(
        self, image: ImageArray, spot: Spot, light: Light, model: DiscModel, smear: float, found: DiscFit
    ) -> DiscFit:
        """Centre of a spot's gradients, with the noise that the disc model has found; the model's where it fails."""
        reach = self.radius + _REFINED_PX
        left = max(math.floor(spot.u - reach - smear / 2), spot.region[0])
        right = min(math.ceil(spot.u + reach + smear / 2) + 1, spot.region[2])
        top = max(math.floor(spot.v - reach), spot.region[1])
        bottom = min(math.ceil(spot.v + reach) + 1, spot.region[3])
        region = image[top:bottom, left:right]
        brightness = (region - light.background) / (-light.contrast if self._is_dark else light.contrast)
        variance = model.rim * (model.alpha + model.beta * np.clip(brightness, 0.0, 1.0))
        crossing = radial_symmetry_centre(region, spot.u - left, spot.v - top, reach + smear / 2, variance)
        if crossing is None:
            return found
        sigma = max(crossing[2], found.wave)
        return found._replace(u=left + crossing[0], v=top + crossing[1], sigma_u=sigma)

    # -- gates ---------------------------------------------------------------------------------------------

    def gates(self, light: Light, appearance: Appearance) -> Gates:
        """Bounds for a spot that is to pass for the marker in this light."""
        parameters = self.parameters
        contrast, noise = light.contrast, light.noise
        # Specks add to the asymmetry with the region's size.
        scatter = disc_scatter(light, appearance.area)
        area = parameters.area_tolerance + _SIGNIFICANT * (scatter + 0.4 * noise / contrast)
        shape = parameters.shape_tolerance + _SIGNIFICANT * 1.6 * scatter
        asymmetry = parameters.shape_tolerance + _SIGNIFICANT * 2.2 * scatter
        if light.speck_variance > 0.0:
            half = float(self.half)
            specks = math.sqrt(light.speck_variance * 4 * half * half / 7) * half**3
            asymmetry += _SIGNIFICANT * specks / (light.height * appearance.area * appearance.variance_v**1.5)
        dimming = parameters.brightness_tolerance * contrast + 2.0 * noise
        low, high = contrast - dimming, contrast + dimming
        if self._is_dark:
            low, high = -high, -low
        more_area, more_variance = appearance.changes(light.above / contrast)
        own_area, own_u = appearance.area + more_area, appearance.variance_u + more_variance
        own_v = appearance.variance_v + more_variance
        noise_u = self._excess_scatter(light, appearance)
        return Gates(
            row=(appearance.row - parameters.row_gate_px, appearance.row + parameters.row_gate_px),
            brightness=(light.background + low, light.background + high),
            area=(own_area * (1 - area), own_area * (1 + area)),
            variance_v=(own_v * (1 - shape), own_v * (1 + shape)),
            variance_u=(own_u * (1 - shape), own_u * (1 + shape) + self.smear_variance),
            correlation=shape,
            lean=appearance.tilt / 2 if appearance.is_shared else 0.0,
            skew_u=(appearance.skew_u - asymmetry, appearance.skew_u + asymmetry),
            skew_v=(appearance.skew_v - asymmetry, appearance.skew_v + asymmetry),
            plain_u=own_v + appearance.excess + _SMEARED * noise_u,
            smears=Smears(
                own_v + appearance.excess,
                noise_u,
                light.background,
                (own_area, own_v, light.above / contrast, noise / contrast),
                parameters.max_smear_px,
            ),
        )

    def change(self, spot: Spot, gates: Gates) -> tuple[float, float]:
        """By how much a spot is larger, and wider, than its marker was.

        Returns
        -------
        area : float -- growth of the area, relative
        variance : float -- growth of the second moments [px^2]; of both, what is surely more than noise
        """
        parameters, smears = self.parameters, gates.smears
        area, area_room = _middle(gates.area)
        variance_v, room = _middle(gates.variance_v)
        wider = spot.variance_v - variance_v
        # A disc out of focus is wider along u and v; only beyond that it is smeared.
        look = smears.looks.at(spot.variance_u - smears.own_u - wider - _SMEARED * smears.scatter)
        noise = look.scatter * (area_room - parameters.area_tolerance * area) / _SIGNIFICANT
        noise_v = look.scatter * (room - parameters.shape_tolerance * variance_v) / _SIGNIFICANT
        return (
            _beyond(spot.area / look.area - area, _CHANGED * noise) / area,
            _beyond(spot.variance_v / look.variance_v - variance_v, _CHANGED * noise_v),
        )

    def undimmed(
        self, image: ImageArray, spot: Spot, light: Light, appearance: Appearance, *, is_narrow: bool
    ) -> tuple[Spot, Light, Gates]:
        """Measure a spot again in the light that its marker has at rest, where a smear has taken some from it.

        Returns
        -------
        Spot, Light, and the Gates in this light
        """
        gates = self.gates(light, appearance)
        share = self.lit_share(spot, gates)
        if share == 1.0:
            return spot, light, gates
        contrast = abs(spot.plateau - light.background) / share
        whole = Light(self.parameters, light.background, contrast, light.noise, light.fraction)
        again, _ = self.measure(image, spot.u, spot.v, whole, is_narrow=is_narrow)
        return again or spot, whole, self.gates(whole, appearance)

    def lit_share(self, spot: Spot, gates: Gates) -> float:
        """Share of its contrast that a smear has left to a spot."""
        if spot.variance_u <= gates.plain_u:
            return 1.0
        return gates.smears.looks.at(spot.variance_u - gates.smears.own_u).plateau

    def judge(self, spot: Spot, gates: Gates) -> Reason:
        """Name the first gate that a spot fails."""
        row, brightness, areas, of_v, of_u, correlation, lean, of_skew_u, of_skew_v, plain_u, smears = gates
        _, v, _, area, variance_u, variance_v, covariance, skew_u, skew_v, plateau, _ = spot
        if not row[0] <= v <= row[1]:
            return "jump"
        if variance_u > plain_u:
            own_u, scatter, ground, looks = smears.own_u, smears.scatter, smears.background, smears.looks
            most, least = looks.at(variance_u - own_u), looks.at(variance_u - own_u - _SIGNIFICANT * scatter)
            plateau = ground + (plateau - ground) / most.plateau
            area = _at_rest(area, areas, most.scatter, least.area, most.area)
            variance_v = _at_rest(variance_v, of_v, most.scatter, least.variance_v, most.variance_v)
            bent = _bent(variance_u - own_u, variance_u)
            skew_u = _beyond(skew_u, bent) / most.scatter
            skew_v = skew_v / most.scatter
        if not brightness[0] <= plateau <= brightness[1]:
            return "brightness"
        if not areas[0] <= area <= areas[1]:
            return "area"
        if not (
            of_v[0] <= variance_v <= of_v[1]
            and of_u[0] <= variance_u <= of_u[1]
            and abs(covariance - lean) <= correlation * math.sqrt(variance_u * variance_v)
        ):
            return "shape"
        if not (of_skew_u[0] <= skew_u <= of_skew_u[1] and of_skew_v[0] <= skew_v <= of_skew_v[1]):
            return "asymmetry"
        return "ok"

    def _seen_smear(self, spot: Spot, light: Light, appearance: Appearance) -> Smeared:
        """What the smear that is seen beyond the noise makes of a marker."""
        smears = self.gates(light, appearance).smears
        return smears.looks.at(spot.variance_u - smears.own_u - _SMEARED * smears.scatter)

    def begin(self, found: DiscFit, appearance: Appearance) -> None:
        """Take a marker's own shape from the first frame."""
        tolerance, flat = self.parameters.shape_tolerance, self.flatness(appearance)
        is_round = max(abs(found.excess - flat), abs(found.tilt)) <= tolerance * appearance.variance_v
        # What is longer one way than the other may be two images of a disc, and no other shape.
        if is_round and appearance.model.misfit > tolerance * self.radius:
            appearance.is_disc, appearance.is_shared = False, True
        appearance.excess, appearance.tilt = self._own(appearance, found.excess, found.tilt)

    def flatness(self, appearance: Appearance) -> float:
        """Excess of a disc that is turned about the beam as the rig says, or a thing's of another shape [px^2]."""
        if appearance.is_shared:
            return appearance.excess
        aspect = self.parameters.aspect
        return appearance.area / (4 * math.pi) * (aspect - 1 / aspect)

    def _own(self, appearance: Appearance, excess: float, tilt: float) -> tuple[float, float]:
        """Excess and tilt, as far as discs are out of round."""
        if appearance.is_shared:
            return excess, tilt
        tolerance, flat = self.parameters.shape_tolerance * appearance.variance_v, self.flatness(appearance)
        return (
            min(max(excess, min(flat, 0.0) - tolerance), max(flat, 0.0) + tolerance),
            min(max(tilt, -tolerance), tolerance),
        )

    def settle(
        self, spot: Spot, light: Light, appearance: Appearance, found: DiscFit, motion: Motion
    ) -> None:
        """Average a marker's appearance over the first frames that show it, moved by so much at most."""
        appearance.frames += 1
        share = 1.0 / appearance.frames
        look = self._seen_smear(spot, light, appearance)
        appearance.area += share * (spot.area / look.area - appearance.area)
        appearance.variance_v += share * (spot.variance_v / look.variance_v - appearance.variance_v)
        appearance.variance_u = min(appearance.variance_u, spot.variance_u)
        tilt = appearance.tilt + share * (found.tilt - appearance.tilt)
        excess = min(appearance.excess, found.excess + _BELOW * found.sigma_excess)
        if motion.smear**2 / 12 <= found.sigma_excess:
            excess = appearance.excess + share * (found.excess - appearance.excess)
        appearance.excess, appearance.tilt = self._own(appearance, excess, tilt)
        appearance.skew_u += share * (spot.skew_u - appearance.skew_u)
        appearance.skew_v += share * (spot.skew_v - appearance.skew_v)
        appearance.row += share * (spot.v - appearance.row)
        appearance.level += share * (light.above / light.contrast - appearance.level)
        appearance.derive()

    def uneven_pull(self, spot: Spot, gates: Gates, appearance: Appearance, sigma_u: float) -> float:
        """Standard deviation of what uneven light on a marker, or something over it, does to its centre [px].

        Notes
        -----
        Light with the slope s across a disc of radius r moves its centre of gravity by s r^2 / 4, and its asymmetry
        by -s r / 2: by as much as the asymmetry times the standard deviation of the disc's points, r / 2. Noise moves
        that by 1.8 of what it moves the centre by, and pixels by up to 0.6 of the level, as a fraction of the
        contrast, over the radius, where the rim is sharp; of the mean of some frames less is left to doubt.
        """
        pixels = _UNEVEN_PIXELS * appearance.level / appearance.radius
        noise = (_UNEVEN_NOISE * sigma_u) ** 2 + pixels * pixels
        skew = abs(spot.skew_u - appearance.skew_u)
        if spot.variance_u > gates.plain_u:
            skew = max(skew - _bent(spot.variance_u - gates.smears.own_u, spot.variance_u), 0.0)
        squared = skew * skew * appearance.variance_v
        appearance.uneven += _UNEVEN_SHARE * (squared - noise - appearance.uneven)
        surely = squared if squared > _STRIKING * noise else 0.0
        return math.sqrt(max(appearance.uneven - _UNEVEN_DOUBT * noise, surely, 0.0))

    # -- whole images --------------------------------------------------------------------------------------

    def relief(self, image: ImageArray) -> Relief:
        """Look at what stands out of its own neighbourhood, lone pixels aside.

        Notes
        -----
        Of a marker the highest column is known. What is longer than that along v is ground: a label, a strip, a wall,
        a step of the light. That is what a closing (of dark markers; an opening of bright ones) with a line of this
        length leaves of the image.
        """
        even = cv2.blur(image, (3, 3))
        mode = cv2.MORPH_CLOSE if self._is_dark else cv2.MORPH_OPEN
        ground: ImageArray = cv2.morphologyEx(even, mode, self._column)
        return Relief(cv2.absdiff(ground, even), ground)

    def centres(self, relief: Relief, height: float) -> list[Blob]:
        """Find spots of about a marker's size by threshold and contours.

        Parameters
        ----------
        relief : Relief -- of a part of an image
        height : float -- by how much they stand out of their ground [grey levels]

        Returns
        -------
        list of Blob -- [px of the part]
        """
        _, mask = cv2.threshold(relief.height, math.floor(height), 255, cv2.THRESH_BINARY)
        if mask.dtype != np.uint8:
            mask = mask.astype(np.uint8)
        contours = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[-2]
        parameters = self.parameters
        smallest = (1 - parameters.diameter_tolerance) * parameters.marker_diameter_px * min(
            parameters.aspect, 1.0
        ) - 2
        widest = 2 * self._tallest + parameters.max_smear_px  # two that touch are one object
        boxes = [cv2.boundingRect(contour) for contour in contours]
        boxes = [(x + (w - 1) / 2, y + (h - 1) / 2, w, h) for x, y, w, h in boxes if w >= 3 and h >= 3]
        return [
            Blob(u, v, float(relief.ground[round(v), round(u)]), self._is_crowded(relief, u, v, boxes))
            for u, v, w, h in boxes
            if smallest <= w <= widest and smallest <= h <= self._tallest
        ]

    def _is_crowded(
        self, relief: Relief, u: float, v: float, boxes: list[tuple[float, float, int, int]]
    ) -> bool:
        """True when another spot, by its box, or another ground reaches into a spot's surroundings."""
        near = self.half + APART_PX
        if any(
            (u, v) != (other_u, other_v)
            and abs(u - other_u) < near + other_w / 2
            and abs(v - other_v) < near + other_h / 2
            for other_u, other_v, other_w, other_h in boxes
        ):
            return True
        return self._is_bounded(relief, float(relief.height[round(v), round(u)]), u, v)

    def is_bounded(self, image: ImageArray, spot: Spot, contrast: float) -> bool:
        """True when the ground about a spot of some contrast ends within its region."""
        reach = self.half + self._column.shape[0]
        left, top = max(round(spot.u) - reach, 0), max(round(spot.v) - reach, 0)
        near = image[top : round(spot.v) + reach + 1, left : round(spot.u) + reach + 1]
        return self._is_bounded(self.relief(near), contrast, spot.u - left, spot.v - top)

    def _is_bounded(self, relief: Relief, contrast: float, u: float, v: float) -> bool:
        """True when a ground that counts beside a marker of such a contrast reaches into the region of a spot."""
        left, top, reach = max(0, round(u) - self.half), max(0, round(v) - self.half), self.half + 1
        lowest, highest, _, _ = cv2.minMaxLoc(relief.ground[top : round(v) + reach, left : round(u) + reach])
        own = float(relief.ground[round(v), round(u)])
        other = own - lowest if self._is_dark else highest - own
        return other > max(_EVEN * contrast, self.parameters.min_contrast_grey)

    def is_alone(self, region: ImageArray, light: Light, height: float, u: float) -> bool:
        """True when a region shows nothing so far from the background but within a marker's radius of a column.

        What stands out of its neighbourhood as a marker does is as bright as one: ``centres`` finds nothing there.
        This takes a tenth of the time.
        """
        first, last = math.floor(u - self.radius), math.ceil(u + self.radius)
        threshold = math.floor(light.background - height if self._is_dark else light.background + height)
        for beside in (region[:, : max(first, 0)], region[:, last + 1 :]):
            if beside.size:
                lowest, highest, _, _ = cv2.minMaxLoc(beside)
                if lowest <= threshold if self._is_dark else highest > threshold:
                    return False
        return True

    def candidate(
        self,
        image: ImageArray,
        u: float,
        v: float,
        background: float,
        *,
        known_noise: float = math.inf,
        is_narrow: bool = False,
    ) -> tuple[Spot, Light] | None:
        """Measure a spot with its own light; None when it is no marker.

        Parameters
        ----------
        image : ndarray, shape (height, width)
        u, v : float -- where to look [px]
        background : float -- to begin with [grey levels]
        known_noise : float -- noise that is known from before: what is beside the spot may not hide it
            [grey levels]
        is_narrow : bool -- another spot is near

        Returns
        -------
        (Spot, Light) or None
        """
        measured = self._measured(image, u, v, background, known_noise, is_narrow=is_narrow)
        if measured is None:
            return None
        spot, light, disc, sides = measured
        parameters = self.parameters
        aspect = parameters.aspect
        noise = min(math.sqrt(sides.variance), known_noise)
        roundness = 0.1 + 2 * parameters.shape_tolerance + _SIGNIFICANT * noise / light.contrast
        # A uniform disc of this area has a second moment of area / (4 pi); blur up to radius / 2 adds to it.
        uniform = disc.area / (4 * math.pi)
        round_u = disc.variance_v + self.flatness(disc)
        is_marker = (
            self._has_size(disc.area)
            and spot.variance_u >= round_u * (1 - roundness)
            and spot.variance_u <= round_u * (1 + roundness) + self.smear_variance
            and abs(spot.covariance) <= roundness * disc.variance_v
            and disc.variance_v <= (uniform / aspect + max(2.0, self.radius**2 / 4)) * (1 + roundness)
            and abs(spot.skew_u) <= roundness
            and abs(spot.skew_v) <= roundness
            and abs(sides.left - sides.right) <= _EVEN * light.contrast + noise
        )
        return (spot, light) if is_marker else None

    def compact(
        self, image: ImageArray, u: float, v: float, background: float, *, is_narrow: bool = False
    ) -> tuple[Spot, Light, Appearance] | None:
        """Measure a compact thing of about a marker's size that is no disc by its rim; None where there is none.

        Parameters are those of ``candidate``.
        """
        measured = self._measured(image, u, v, background, math.inf, is_narrow=is_narrow)
        if measured is None:
            return None
        spot, light, _, sides = measured
        if not (
            self._has_size(spot.area)
            and self.is_compact(image, spot, light)
            and abs(sides.left - sides.right) <= _EVEN * light.contrast + light.noise
        ):
            return None
        own = Appearance(
            spot.area,
            spot.variance_u,
            spot.variance_v,
            spot.skew_u,
            spot.skew_v,
            spot.v,
            level=light.above / light.contrast,
        )
        found = self._fitted(image, spot, light, own, 0.0)
        if (
            found is None
            or max(own.model.misfit, found.wave) <= self.parameters.shape_tolerance * self.radius
        ):
            return None
        own.is_disc, own.is_shared = False, True
        own.excess, own.tilt = spot.variance_u - spot.variance_v, 2.0 * spot.covariance
        return spot, light, own

    def _has_size(self, area: float) -> bool:
        """True for the area of a marker, as far as the rig knows it [px^2]."""
        parameters = self.parameters
        nominal, tolerance = math.pi * self.radius**2 * parameters.aspect, parameters.diameter_tolerance
        return (1 - tolerance) ** 2 * nominal <= area <= (1 + tolerance) ** 2 * nominal

    def _measured(
        self, image: ImageArray, u: float, v: float, background: float, known_noise: float, *, is_narrow: bool
    ) -> tuple[Spot, Light, Appearance, Sides] | None:
        """Measure a spot with its own light, as the disc that it may be; None where nothing stands out enough."""
        parameters = self.parameters
        height, width = image.shape
        column, row = round(u), round(v)
        if not (1 <= column < width - 1 and 1 <= row < height - 1):
            return None
        plateau = float(image[row - 1 : row + 2, column - 1 : column + 2].mean())
        noise = strip = 0.0
        light: Light | None = None
        spot: Spot | None = None
        disc: Appearance | None = None
        sides = Sides(background, background, 0.0)
        for _ in range(2):
            contrast = background - plateau if self._is_dark else plateau - background
            if contrast < parameters.min_contrast_grey:
                return None
            light = Light(parameters, background, contrast, noise, strip)
            if light.above >= contrast:
                return None
            spot, _ = self.measure(image, u, v, light, is_narrow=is_narrow)
            if spot is None:
                return None
            sides = self.sides(image, spot)
            background, noise = 0.5 * (sides.left + sides.right), min(math.sqrt(sides.variance), known_noise)
            shown = abs(spot.plateau - background)
            if Light(parameters, background, shown, noise).above >= shown:
                return None  # no more than what lies beside it: not worth the search for a smear
            strip = self._strip_fraction(image, spot, background, shown, noise)
            disc, share = self._at_rest(spot, light)
            plateau, u, v = background + (spot.plateau - background) / share, spot.u, spot.v
        if spot is None or light is None or disc is None:
            return None
        return spot, light, disc, sides

    def _strip_fraction(
        self, image: ImageArray, spot: Spot, background: float, contrast: float, noise: float
    ) -> float:
        """Level above what a spot lies on, which is seen above and below it, as a fraction of its contrast; or 0."""
        _, top, _, bottom = spot.region
        first, last = max(round(spot.u - self.radius), 0), round(spot.u + self.radius) + 1
        above, below = (
            cv2.reduce(image[rows, first:last], 0, cv2.REDUCE_AVG, dtype=cv2.CV_32F)
            for rows in (slice(top, top + _SIDE_PX), slice(bottom - _SIDE_PX, bottom))
        )
        least = np.maximum(above, below) if self._is_dark else np.minimum(above, below)
        lowest, highest, _, _ = cv2.minMaxLoc(cv2.blur(least, (_SIDE_PX + 1, 1)))
        shown = background - lowest if self._is_dark else highest - background
        if shown <= noise:
            return 0.0
        return min((_CLEAR_SHARE * shown + _CLEAR_NOISE * noise) / contrast, _MAX_CLEAR)

    def bare(self, image: ImageArray, spot: Spot, light: Light) -> tuple[Spot, Light, Appearance]:
        """Measure a spot as it would be without what it lies on, where that is seen above and below it.

        Notes
        -----
        A disc T of the contrast A hides what it lies on, s. Of

            I = A T + s (1 - T)        A (I - s) / (A - s) = A T

        is left, which has the look of a disc also at its rim, where the level that is clear of s has not.
        """
        parameters = self.parameters
        if light.fraction > parameters.level_fraction:
            left, top, right, bottom = spot.region
            sign = -1.0 if self._is_dark else 1.0
            seen = sign * (image[top:bottom, left:right] - light.background)
            down = np.linspace(0.0, 1.0, bottom - top)[:, None]
            behind = (1.0 - down) * seen[:_SIDE_PX].mean(axis=0) + down * seen[-_SIDE_PX:].mean(axis=0)
            behind = np.minimum(behind, _MAX_CLEAR * light.contrast)
            disc = light.background + sign * light.contrast * (seen - behind) / (light.contrast - behind)
            info = np.iinfo(image.dtype)
            disc = np.clip(np.rint(disc), info.min, info.max).astype(image.dtype)
            bare = Light(parameters, light.background, light.contrast, light.noise)
            found, _ = self.measure(disc, spot.u - left, spot.v - top, bare)
            if found is not None:
                spot, light = found, bare
        return spot, light, self.appearance(spot, light)

    def appearance(self, spot: Spot, light: Light) -> Appearance:
        """Appearance of a marker that has just been found."""
        return self._at_rest(spot, light)[0]

    def _at_rest(self, spot: Spot, light: Light) -> tuple[Appearance, float]:
        """Appearance of a marker of which nothing is known, and the share of its contrast that a smear has left."""
        found = Appearance(
            area=spot.area,
            variance_u=min(spot.variance_u, spot.variance_v),
            variance_v=spot.variance_v,
            skew_u=spot.skew_u,
            skew_v=spot.skew_v,
            row=spot.v,
            level=light.above / light.contrast,
        )
        found.model = DiscModel(self.parameters.noise_line)
        variance_u = spot.variance_u - self.flatness(found)
        excess, least = variance_u - spot.variance_v, _SMEARED * self._excess_scatter(light, found)
        shown = abs(spot.plateau - light.background)
        if not least < excess < _MAX_SMEARS * self.smear_variance or shown - light.above <= 1.0:
            return found, 1.0
        shares = light.above / shown, light.noise / shown
        radius = self.radius, self.radius * max(self.parameters.diameter_tolerance / 2, _ROUND)
        seen = smear_of(spot.area, variance_u, spot.variance_v, *shares, radius, self.parameters.max_smear_px)
        found.area, found.variance_v = spot.area / seen.area, spot.variance_v / seen.variance_v
        found.derive()
        return found, seen.plateau
