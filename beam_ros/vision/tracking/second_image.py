"""A second image that lies over a marker: of a reflection, or of a frame blended into the next.

One that holds the share q of the light, no more than one half, and lies d aside pulls the centre by q d and adds
q (1 - q) d^2 to the second moments. A smear adds to them, too, as its speed and the exposure say. What is beyond
that tells how far the centre may be pulled: of one marker (``pull``), wherever its second image lies, and of all
markers of a frame (``SecondImages``), which it lies over together.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from statistics import quantiles
from typing import NamedTuple

from beam_ros.vision.tracking.appearance import Appearance
from beam_ros.vision.tracking.disc_model import DiscFit

_STRIKING = 4.0
"""A smear is longer than what explains it beyond so many standard deviations, once in 30000 frames by chance, ..."""
_DOUBTED = 1.0
"""... or so many where it was so in the frame before, ..."""
_MAX_PULL_PX = 0.35
"""... and not believed where a second image of the marker that makes it so could pull the centre by more [px]."""
_SIGNIFICANT = 5.0
_PLAIN = 3.0
"""A moment within so many standard deviations is no sign of a frame before, or of a reflection, either."""
_SUSPECT = 1.0
"""So many standard deviations may be one, where a frame before ..."""
_SUSPECT_STEPS = 1.0, 8.0
"""... of a step whose square lies between so many of them would add about as much."""
_BLENDED_SHARE = 0.2
"""Share of the frames that are blended in a film that has such frames, ..."""
_MIN_ODDS, _MAX_ODDS = 0.03, 1e3
"""... and between which the odds stay that it has: what began, or ended, is noticed after some frames."""
_FORGOTTEN = 0.98
"""With every frame the odds shrink to so much, too."""
_MIN_WEIGHT = 1e-4
"""Where a frame before is known to a share with less weight, the steps are so short that none would matter."""
_MEMORY_FRAMES = 100
"""For so many frames a reflection that was seen may lie over any marker."""
_MEAN_RATIO = 2 * math.log(2) - 1
"""Mean of q / (1 - q), the square of the pull over the second moment, where every share q up to 1/2 is as likely."""
_NOTABLE = 0.012
"""Where a frame is blended with a greater probability than in a film of which nothing is known, the farthest that it
may pull a marker is ..."""
_FARTHEST = 6.0
"""... no more than so many standard deviations that are stated for it."""
_STEADY = 0.2
"""A speed is known for a measure of the exposure where it is uncertain by no more than this share, ..."""
_EXPOSURES = 32, 256
"""... of so many smears at least, and the last so many at most, ..."""
_AGREEING = 1.25
"""... whose quartiles agree up to this ratio."""
_TOO_SHORT = 2
"""For each of these, no more than so many other smears may be too short for such an exposure."""
TELLING_PX = 1.0
"""A step that is shorter leaves no exposure out [px]."""
_LONGER = 1.1
"""An exposure that is so many times the stated one is another one."""
_EXCLUDED = 3.0
"""So many standard deviations below none a share of the frame before is excluded."""


class Motion(NamedTuple):
    """What a marker's speed makes of its image: length of the smear [px], and shift of every row [px/px]."""

    smear: float
    shear: float


AT_REST = Motion(0.0, 0.0)


def is_explained(found: DiscFit, appearance: Appearance, step: float, exposed: float) -> bool:
    """True where a step [px], a share of which is exposed, leaves nothing but noise that tells of no second image."""
    excess, tilt = found.excess - appearance.excess, found.tilt - appearance.tilt
    squared, sigma = step * step, found.sigma_excess
    excess = (excess if excess > 0.0 else 0.0) - exposed * exposed * squared / 12
    moment = math.sqrt(excess * excess + tilt * tilt)
    is_telling = _SUSPECT_STEPS[0] * sigma < squared < _SUSPECT_STEPS[1] * sigma
    return (
        excess <= (_SUSPECT if is_telling else _PLAIN) * sigma
        and (moment + excess) * moment <= 2 * _STRIKING * _STRIKING * sigma * sigma
    )


class Disc(NamedTuple):
    """What a marker may look like where its own look may hold a second image, with the names of ``Appearance``."""

    excess: float
    tilt: float
    variance_v: float


def _round(appearance: Appearance, flatness: float) -> Disc:
    """What a marker looks like that is as round as it should be; a shape that most share is known."""
    return Disc(flatness, appearance.tilt if appearance.is_shared else 0.0, appearance.variance_v)


def _unexplained(found: DiscFit, motion: Motion, appearance: Appearance | Disc) -> tuple[float, float]:
    """Excess and tilt that are left of a marker that moved by so much at most [px^2]."""
    excess, tilt = found.excess - appearance.excess, abs(found.tilt - appearance.tilt)
    if motion is not AT_REST:
        tilt -= 2 * appearance.variance_v * motion.shear
        excess = (excess if excess > 0.0 else 0.0) - motion.smear**2 / 12
        tilt = tilt if tilt > 0.0 else 0.0
    return excess, tilt


def pull(found: DiscFit, motion: Motion, appearance: Appearance | Disc, striking: float = _STRIKING) -> float:
    """How far a second image may pull the centre of a marker that moved by so much at most [px].

    Zero where its own shape, motion and noise, by so many standard deviations, explain what is seen.

    Notes
    -----
    What a second image adds to the moments is along u at least the square of the pull. Of all it adds, the difference
    of the moments along u and v, and twice the one along both, are known, each with the standard deviation s:

        E = m (cos^2 - sin^2)    C = 2 m cos sin    m = sqrt(E^2 + C^2)    m cos^2 = (m + E) / 2

    The standard deviation of the last one is s |cos|.
    """
    excess, tilt = _unexplained(found, motion, appearance)
    moment = math.sqrt(excess * excess + tilt * tilt)
    along = (moment + excess) / 2
    if along * moment <= (striking * found.sigma_excess) ** 2:
        return 0.0
    return math.sqrt(along)


def usual_pull(found: DiscFit, motion: Motion, appearance: Appearance | Disc) -> float:
    """Standard deviation of the pull by a second image that is there, though the noise may hide it [px].

    Notes
    -----
    The square of the pull is q / (1 - q) of the moment along u that ``pull`` finds, for which s stands in where it is
    lost in the noise.
    """
    excess, tilt = _unexplained(found, motion, appearance)
    moment = math.sqrt(excess * excess + tilt * tilt + found.sigma_excess**2)
    return math.sqrt(_MEAN_RATIO * (moment + excess) / 2)


class Sighting(NamedTuple):
    """A marker in a frame.

    Attributes
    ----------
    found : DiscFit
    appearance : Appearance -- its look until then
    flatness : float -- excess that a marker has which is as round as it should be [px^2]
    step : float -- since its true place in the frame before; NaN where not known, 0 where they do not touch [px]
    speed, doubt : float -- how fast it moves by its places, and how far that may be wrong [px per frame]
    was_pulled : bool -- in the frame before, a second image of it may have lain over it
    """

    found: DiscFit
    appearance: Appearance
    flatness: float
    step: float
    speed: float
    doubt: float
    was_pulled: bool


class Pull(NamedTuple):
    """What moves a marker's light in a frame.

    Attributes
    ----------
    motion : Motion -- at most
    centre_px : float -- standard deviation by a second image, infinity where that leaves nothing to believe [px]
    is_seen : bool -- its own smear shows a second image
    behind_px : float -- how far it was, most likely, pulled back by the frame before [px]
    """

    motion: Motion
    centre_px: float
    is_seen: bool
    behind_px: float = 0.0


class _Exposure(NamedTuple):
    """An exposure that a smear shows, or that is the longest one of which it can be [s]."""

    seconds: float
    is_most: bool


NO_PULL = Pull(AT_REST, 0.0, False)


class SecondImages:
    """Judges by all markers of a frame how far a second image may pull each.

    Parameters
    ----------
    exposed_s : float -- exposure of a frame [s]
    row_delay_s : float -- from one row's exposure to the next one's [s]

    Notes
    -----
    Where one marker shows a second image, it lies over all of them. What the others show is then explained only by
    the slowest that they may be and by a disc as round as it should be: what was learned of them may hold it, too.
    A marker whose look is not settled, and that hardly moves, shows one already where it is no such disc. What it
    shows for two frames, and was not where the marker was in the frame before, is a reflection. That stays where it
    is, and the markers may move into it at any time.

    The frame before, blended into this one with the share q, makes a true step d one of (1 - q) d, pulled by
    a = q / (1 - q) times that, and adds q (1 - q) d^2 to the second moment: a times the square of the step that is
    seen. All markers have one a, between 0 and 1, and its weighted mean over them has the standard deviation s. By
    Bayes' rule the frame is blended with the odds

        P / (1 - P) = p / (1 - p) L        L = integral over a of N(a; mean, s) / N(0; mean, s)

    where p is a fifth of the probability that the film has such frames. The odds of that grow by 1 + (L - 1) / 5 with
    every frame. The mean square of the pull is P E[a^2] of the step's, with a of the normal distribution between 0
    and 1, and its mean P E[a]: from there the next step is counted.
    """

    def __init__(self, exposed_s: float, row_delay_s: float) -> None:
        self._exposed_s = exposed_s
        self._row_delay_s = row_delay_s
        self._odds = _MIN_ODDS
        self._exposures: deque[_Exposure] = deque(maxlen=_EXPOSURES[1])
        self._unreflected_frames = _MEMORY_FRAMES

    @property
    def exposure_s(self) -> float:
        """Exposure that smears show which are too long for the stated one [s]; that one where they do not agree.

        A second image of any kind is longer than a smear by amounts that no one exposure explains. The speed is at
        times another one than the places tell: that makes about as many smears too short as too long, and of a wrong
        exposure nearly all are too short.
        """
        shown = [exposure.seconds for exposure in self._exposures if not exposure.is_most]
        if len(shown) < _EXPOSURES[0]:
            return self._exposed_s
        lower, middle, upper = quantiles(shown)
        n_against = sum(exposure.is_most and exposure.seconds < middle for exposure in self._exposures)
        is_another = upper <= _AGREEING * lower and middle > _LONGER * self._exposed_s
        return middle if is_another and n_against <= _TOO_SHORT * len(shown) else self._exposed_s

    @property
    def is_usual(self) -> bool:
        """True where a second image may have been there of late."""
        return self._odds > _MIN_ODDS or self._is_reflected

    @property
    def _is_reflected(self) -> bool:
        return self._unreflected_frames < _MEMORY_FRAMES

    def note_explained(self, sigma_excess: float, step: float, since_s: float) -> None:
        """Take note of the longest exposure that a marker whose step [px] explains its smear leaves possible."""
        squared, doubt = (self._exposed_s * step / since_s) ** 2, 12 * _PLAIN * sigma_excess
        if squared > doubt:
            self._exposures.append(_Exposure(self._exposed_s * math.sqrt(1.0 + doubt / squared), True))

    def pulls(self, sightings: Sequence[Sighting], since_s: float, *, is_seen: bool) -> list[Pull]:
        """Judge a frame.

        Parameters
        ----------
        sightings : sequence of Sighting
        since_s : float -- time in which the markers made their steps [s]
        is_seen : bool -- a marker that is not among them shows a second image
        """
        self._unreflected_frames += 1
        pulls = [self._alone(sighting, since_s) for sighting in sightings]
        if is_seen or self._is_reflected or any(each.is_seen for each in pulls):
            pulls = [
                self._beside(each, sighting, since_s) for each, sighting in zip(pulls, sightings, strict=True)
            ]
        share, mean = self._blended(sightings, self._exposed_s / since_s)
        return [
            self._with_frame_before(each, sighting, share, mean)
            for each, sighting in zip(pulls, sightings, strict=True)
        ]

    def _alone(self, sighting: Sighting, since_s: float) -> Pull:
        """What a marker by itself shows of a second image."""
        found, appearance, _, step, speed, doubt, was_pulled = sighting
        motion = self._motion((speed + doubt) / since_s)
        px = pull(found, motion, appearance, _DOUBTED if was_pulled else _STRIKING)
        is_longer = px > 0.0
        is_too_far = px * px > _MAX_PULL_PX**2 + _SIGNIFICANT * found.sigma_excess
        if math.isnan(step) and pull(found, AT_REST, appearance) > 0.0:
            # Whether it moved, or a second image lies over it, nobody knows.
            px = max(px, usual_pull(found, AT_REST, appearance))
        self._note_exposure(sighting, px, since_s)
        is_suspect = self._is_reflection(sighting, motion) or is_longer
        return Pull(motion, math.inf if is_too_far else px, is_suspect)

    def _is_reflection(self, sighting: Sighting, motion: Motion) -> bool:
        """True where a marker that hardly moves may show one; takes note of one that is certain."""
        found, appearance, flatness, step, _, _, was_pulled = sighting
        if (appearance.is_settled and not was_pulled) or motion.smear**2 / 12 > found.sigma_excess:
            return False
        look = appearance if appearance.is_settled else _round(appearance, flatness)
        aside = pull(found, motion, look, _PLAIN if was_pulled else _STRIKING)
        if was_pulled and aside > abs(step):
            self._unreflected_frames = 0
        return aside > 0.0

    def _note_exposure(self, sighting: Sighting, px: float, since_s: float) -> None:
        """Take note of the exposure that a smear shows, or of the longest that one leaves possible without a pull."""
        found, appearance, _, _, speed, doubt, _ = sighting
        if px == 0.0:
            self.note_explained(found.sigma_excess, speed, since_s)
        elif doubt < _STEADY * speed:
            smear_s = math.sqrt(12 * max(found.excess - appearance.excess, 0.0)) * since_s / speed
            if smear_s <= since_s:
                self._exposures.append(_Exposure(smear_s, False))

    def _beside(self, alone: Pull, sighting: Sighting, since_s: float) -> Pull:
        """Add the second image that others show, and that a disc as round as it should be leaves possible."""
        found, appearance, flatness, _, speed, doubt, _ = sighting
        disc, motion = _round(appearance, flatness), self._motion(max(speed - doubt, 0.0) / since_s)
        if not (self._is_reflected or pull(found, motion, disc, _DOUBTED) > 0.0):
            return alone
        return alone._replace(centre_px=max(alone.centre_px, usual_pull(found, motion, disc)))

    def _with_frame_before(self, pull_: Pull, sighting: Sighting, share: float, mean: float) -> Pull:
        """Add what the frame before does to a marker: root mean square and mean of its pull over its step."""
        step = sighting.step
        px, behind = share * abs(step), mean * step
        if math.isnan(step):
            # Its square times the share is what it adds to the second moment.
            excess = sighting.found.excess - sighting.appearance.excess
            px, behind = math.sqrt(share * max(excess, 0.0)), 0.0
        px = math.hypot(pull_.centre_px, px) if px <= _MAX_PULL_PX else math.inf
        return Pull(pull_.motion, px, pull_.is_seen, behind)

    def _motion(self, speed: float) -> Motion:
        """What a speed [px/s] makes of a marker's image."""
        return Motion(self._exposed_s * speed, self._row_delay_s * speed)

    def _blended(self, sightings: Sequence[Sighting], exposed: float) -> tuple[float, float]:
        """Root mean square and mean of the markers' pulls by the frame before, over their steps."""
        weighted = weight = 0.0
        moment = exposed * exposed / 12
        for found, appearance, _, step, speed, doubt, _ in sightings:
            spread = moment * doubt * (2 * speed + doubt)
            variance = found.sigma_excess**2 * (1 + 1 / appearance.frames) + spread * spread
            squared = 0.0 if math.isnan(step) else step * step
            weighted += squared * (found.excess - appearance.excess - moment * speed * speed) / variance
            weight += squared * squared / variance
        self._odds = max(self._odds * _FORGOTTEN, _MIN_ODDS)
        if weight < _MIN_WEIGHT:
            return 0.0, 0.0
        s = 1.0 / math.sqrt(weight)
        mean = min(weighted / weight, 1.0)
        ratio = likely = usual = square = 0.0
        if mean > -_EXCLUDED * s:
            none, whole = mean / s, (1.0 - mean) / s
            at_none, at_whole = _normal(none), _normal(whole)
            within = 0.5 * (math.erf(whole * math.sqrt(0.5)) + math.erf(none * math.sqrt(0.5)))
            ratio = within * s / at_none if at_none > 0.0 else math.inf
            prior = _BLENDED_SHARE * self._odds / (1.0 + self._odds)
            likely = 1.0 / (1.0 + (1.0 - prior) / (prior * ratio))
            usual = mean + s * (at_none - at_whole) / within
            square = mean * mean + s * s + s * (mean * at_none - (1.0 + mean) * at_whole) / within
        self._odds = min(max(self._odds * (1.0 + _BLENDED_SHARE * (ratio - 1.0)), _MIN_ODDS), _MAX_ODDS)
        share = math.sqrt(likely * max(square, 0.0))
        if likely > _NOTABLE:
            share = max(share, min(mean + _EXCLUDED * s, 1.0) / _FARTHEST)
        return share, likely * usual


def _normal(x: float) -> float:
    return math.exp(-0.5 * x * x) / math.sqrt(2 * math.pi)
