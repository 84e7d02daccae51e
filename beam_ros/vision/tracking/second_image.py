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
_RARELY = 1e-4
"""Share of the frames that are blended where none has been seen, ..."""
_MEMORY_FRAMES = 100
"""... and frames over which it is averaged, and for which a reflection that was seen may lie over any marker."""
_MEAN_RATIO = 2 * math.log(2) - 1
"""Mean of q / (1 - q), the square of the pull over the second moment, where every share q up to 1/2 is as likely."""
_NOTABLE = 0.01
"""Where a frame is blended with a greater probability, the farthest that it may pull a marker is ..."""
_FARTHEST = 6.0
"""... no more than so many standard deviations that are stated for it."""
_STEADY = 0.2
"""A speed is known for a measure of the exposure where it is uncertain by no more than this share, ..."""
_EXPOSURES = 32, 256
"""... of so many smears at least, and the last so many at most, ..."""
_AGREEING = 1.25
"""... whose quartiles agree up to this ratio."""
_LONGER = 1.1
"""An exposure that is so many times the stated one is another one."""
_EXCLUDED = 3.0
"""So many standard deviations below none a share of the frame before is excluded."""


class Motion(NamedTuple):
    """What a marker's speed makes of its image: length of the smear [px], and shift of every row [px/px]."""

    smear: float
    shear: float


AT_REST = Motion(0.0, 0.0)


def is_explained(found: DiscFit, appearance: Appearance, smear: float) -> bool:
    """True where a smear of this length [px] leaves nothing but noise, which ``pull`` does not notice, either."""
    excess, tilt = found.excess - appearance.excess, found.tilt - appearance.tilt
    excess = max(excess, 0.0) - smear * smear / 12
    moment, sigma = math.sqrt(excess * excess + tilt * tilt), found.sigma_excess
    return (
        excess <= _PLAIN * sigma and (moment + excess) * moment <= 2 * _STRIKING * _STRIKING * sigma * sigma
    )


class Disc(NamedTuple):
    """What a marker may look like where its own look may hold a second image, with the names of ``Appearance``."""

    excess: float
    tilt: float
    variance_v: float


def _unexplained(found: DiscFit, motion: Motion, appearance: Appearance | Disc) -> tuple[float, float]:
    """Excess and tilt that are left of a marker that moved by so much at most [px^2]."""
    excess, tilt = found.excess - appearance.excess, abs(found.tilt - appearance.tilt)
    if motion is not AT_REST:
        excess = max(excess, 0.0) - motion.smear**2 / 12
        tilt = max(tilt - 2 * appearance.variance_v * motion.shear, 0.0)
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
    step : float -- since the frame before; NaN where not known, 0 where the two places do not touch [px]
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
    """

    motion: Motion
    centre_px: float
    is_seen: bool


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

        P / (1 - P) = p / (1 - p)  integral over a of N(a; mean, s) / N(0; mean, s)

    where p is the share of frames that were blended of late. The mean square of the pull is P E[a^2] of the step's,
    with a of the normal distribution between 0 and 1.
    """

    def __init__(self, exposed_s: float, row_delay_s: float) -> None:
        self._exposed_s = exposed_s
        self._row_delay_s = row_delay_s
        self._usual = _RARELY
        self._smears_s: deque[float] = deque(maxlen=_EXPOSURES[1])
        self._unreflected_frames = _MEMORY_FRAMES

    @property
    def exposure_s(self) -> float:
        """Exposure that smears show which are too long for the stated one [s]; that one where they do not agree.

        A second image of any kind is longer than a smear by amounts that no one exposure explains.
        """
        if len(self._smears_s) < _EXPOSURES[0]:
            return self._exposed_s
        lower, middle, upper = quantiles(self._smears_s)
        is_another = upper <= _AGREEING * lower and middle > _LONGER * self._exposed_s
        return middle if is_another else self._exposed_s

    @property
    def is_usual(self) -> bool:
        """True where a second image may have been there of late."""
        return self._usual > _RARELY or self._is_reflected

    @property
    def _is_reflected(self) -> bool:
        return self._unreflected_frames < _MEMORY_FRAMES

    def pulls(self, sightings: Sequence[Sighting], since_s: float, *, is_seen: bool) -> list[Pull]:
        """Judge a frame.

        Parameters
        ----------
        sightings : sequence of Sighting
        since_s : float -- time in which the markers made their steps [s]
        is_seen : bool -- a marker that is not among them shows a second image
        """
        pulls = []
        self._unreflected_frames += 1
        for found, appearance, flatness, step, speed, doubt, was_pulled in sightings:
            motion = self._motion((speed + doubt) / since_s)
            px = pull(found, motion, appearance, _DOUBTED if was_pulled else _STRIKING)
            is_too_far = px * px > _MAX_PULL_PX**2 + _SIGNIFICANT * found.sigma_excess
            aside = 0.0
            if motion.smear**2 / 12 <= found.sigma_excess:
                look = appearance if appearance.is_settled else Disc(flatness, 0.0, appearance.variance_v)
                aside = pull(found, motion, look, _PLAIN if was_pulled else _STRIKING)
                if was_pulled and aside > abs(step):
                    self._unreflected_frames = 0
            pulls.append(Pull(motion, math.inf if is_too_far and px > 0.0 else px, px > 0.0 or aside > 0.0))
            if px > 0.0 and doubt < _STEADY * speed:
                smear_s = math.sqrt(12 * max(found.excess - appearance.excess, 0.0)) * since_s / speed
                if smear_s <= since_s:
                    self._smears_s.append(smear_s)
        if is_seen or self._is_reflected or any(each.is_seen for each in pulls):
            for k, (found, appearance, flatness, _, speed, doubt, _) in enumerate(sightings):
                disc = Disc(flatness, 0.0, appearance.variance_v)
                motion = self._motion(max(speed - doubt, 0.0) / since_s)
                px = 0.0
                if self._is_reflected or pull(found, motion, disc, _DOUBTED) > 0.0:
                    px = usual_pull(found, motion, disc)
                pulls[k] = pulls[k]._replace(centre_px=max(pulls[k].centre_px, px))
        share = self._blended(sightings, self._exposed_s / since_s)
        for k, (found, appearance, _, step, *_) in enumerate(sightings):
            px = share * abs(step)
            if math.isnan(step):
                # Its square times the share is what it adds to the second moment.
                px = math.sqrt(share * max(found.excess - appearance.excess, 0.0))
            px = math.hypot(pulls[k].centre_px, px) if px <= _MAX_PULL_PX else math.inf
            pulls[k] = pulls[k]._replace(centre_px=px)
        return pulls

    def _motion(self, speed: float) -> Motion:
        """What a speed [px/s] makes of a marker's image."""
        return Motion(self._exposed_s * speed, self._row_delay_s * speed)

    def _blended(self, sightings: Sequence[Sighting], exposed: float) -> float:
        """Standard deviation of the markers' pulls by the frame before, over their steps."""
        weighted = weight = 0.0
        moment = exposed * exposed / 12
        for found, appearance, _, step, speed, doubt, _ in sightings:
            spread = moment * doubt * (2 * speed + doubt)
            variance = found.sigma_excess**2 * (1 + 1 / appearance.frames) + spread * spread
            squared = 0.0 if math.isnan(step) else step * step
            weighted += squared * (found.excess - appearance.excess - moment * speed * speed) / variance
            weight += squared * squared / variance
        if weight <= 0.0:
            return 0.0
        s = 1.0 / math.sqrt(weight)
        mean = min(weighted / weight, 1.0)
        likely = square = 0.0
        if mean > -_EXCLUDED * s:
            none, whole = mean / s, (1.0 - mean) / s
            at_none, at_whole = _normal(none), _normal(whole)
            within = 0.5 * (math.erf(whole * math.sqrt(0.5)) + math.erf(none * math.sqrt(0.5)))
            blended, plain = self._usual * within, (1.0 - self._usual) * at_none / s
            likely = blended / (blended + plain)
            square = mean * mean + s * s + s * (mean * at_none - (1.0 + mean) * at_whole) / within
        self._usual = max(self._usual + (likely - self._usual) / _MEMORY_FRAMES, _RARELY)
        share = math.sqrt(likely * max(square, 0.0))
        return max(share, min(mean + _EXCLUDED * s, 1.0) / _FARTHEST) if likely > _NOTABLE else share


def _normal(x: float) -> float:
    return math.exp(-0.5 * x * x) / math.sqrt(2 * math.pi)
