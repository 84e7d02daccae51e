"""Acquisition: which spots of the whole image are the markers, and what makes them doubtful.

A spot is a marker only if one disc explains it, smeared by no more than it moves. While anything else that is new
lies in its row, which may be the marker too, nothing is acquired. Markers are named by the rows in which the rig says
they lie, or by their order along the beam.
"""

from __future__ import annotations

import math
from itertools import pairwise
from statistics import median
from typing import NamedTuple

from beam_ros.arrays import ImageArray
from beam_ros.vision.tracking.appearance import Appearance, Light
from beam_ros.vision.tracking.association import Possible, SpotPath
from beam_ros.vision.tracking.marker_state import (
    CONFIRMED_FRAMES,
    LONELY_FRAMES,
    SAME_PLACE_PX,
    MarkerMotion,
    MarkerState,
    Thing,
    beam_reach,
    is_common,
    is_taken,
    shared,
)
from beam_ros.vision.tracking.recovery import Frame, Recovery
from beam_ros.vision.tracking.spot_search import OneDisc, one_disc
from beam_ros.vision.tracking.spots import Blob, Gates, Reason, Spot, SpotMeter

_THRESHOLDS = (0.5, 0.3, 0.7)
"""Fractions of the strongest contrast at which spots are looked for, in a marker's rows where they are known."""
_MAJORITY = 3
"""So many sizes have one that most of them agree on."""
_SPEED_SLACK = 0.15
"""Relative uncertainty of a smear that follows from two frames."""
_SIGNIFICANT = 3.0
_EQUAL_SIZE = 0.1
"""Relative tolerance of the area of a marker against that of the others."""

FULL_DISCS = "full discs of one brightness: fill or cover their middles"
"""What a person can do about markers that are rings."""


class Sighted(NamedTuple):
    """The only spot of its kind in a marker's row, in a frame: its column [px], excess and covariance [px^2]."""

    frame: int
    u: float
    excess: float
    covariance: float


Candidate = tuple[Spot, Light]
Found = tuple[dict[int, Candidate], dict[int, Reason]]
"""The spots that are markers, and why the other markers are not acquired."""


class Acquisition:
    """Finds the markers that are not followed.

    Parameters
    ----------
    meter : SpotMeter
    markers : list of MarkerState -- lowest first; those found are given their look and their place
    exposure_s : float -- of a frame [s]; infinity where it is not known

    Attributes
    ----------
    shows_mosaic : bool -- most of what last was like a marker lies in a mosaic of colours
    shows_rings : bool -- most of it has a hole
    aspect : float or None -- width over height of most of it, which is not what was expected; None where it is
    clutter : list of list of Thing -- what else is in the row of each marker that is not followed
    """

    def __init__(
        self, meter: SpotMeter, markers: list[MarkerState], recovery: Recovery, exposure_s: float
    ) -> None:
        self._meter = meter
        self._parameters = meter.parameters
        self._markers = markers
        self._recovery = recovery
        self._exposure_s = exposure_s
        self._sightings: list[Sighted | None] = [None] * len(markers)
        self.clutter: list[list[Thing]] = [[] for _ in markers]
        self._frame = self._elapsed_ns = 0
        self._now: Frame | None = None
        self._looks: dict[Spot, Appearance] = {}
        self._bare: dict[Spot, tuple[Spot, Light, Appearance]] = {}
        self._narrower = 0.0
        self._rings: list[tuple[float, float]] = []
        self.shows_mosaic = self.shows_rings = False
        self.aspect: float | None = None
        self._aspects: list[float] = []
        self._blobs: list[Blob] = []
        self._shapes: dict[int, tuple[int, Gates]] = {}

    def acquire(self, frame: Frame, elapsed_ns: int) -> dict[int, Reason]:
        """Find markers in a frame.

        Parameters
        ----------
        frame : Frame -- with the markers that are seen in it
        elapsed_ns : int -- time since the one before [ns]

        Returns
        -------
        dict -- what keeps the markers that were not found
        """
        image, self._now, self._frame = frame.image, frame, frame.number
        self._elapsed_ns = elapsed_ns
        missing = [k for k, marker in enumerate(self._markers) if not marker.is_followed]
        found: list[Candidate] = []
        others: list[tuple[float, float]] = []
        self._rings, self._aspects, self._blobs = [], [], []
        stands_out = [
            self._look(image, top, bottom, found, others)
            for top, bottom in self._bands(missing, image.shape[0])
        ]
        if not any(stands_out):
            return dict.fromkeys(missing, "no_contrast")
        if found:
            n_mosaics = sum(self._meter.is_mosaic(image, *candidate) for candidate in found)
            self.shows_mosaic = 2 * n_mosaics > len(found)
            if self.shows_mosaic:
                return dict.fromkeys(missing, "mosaic")
        self._looks = {candidate[0]: self._meter.appearance(*candidate) for candidate in found}
        self._bare = {candidate[0]: self._meter.bare(image, *candidate) for candidate in found}
        self._narrower = self._sharpened()
        self.shows_rings = len(self._rings) > len(found)
        has_rows = any(self._markers[k].known_row is not None for k in missing)
        chosen, reasons = (self._in_rows if has_rows else self._in_order)(missing, found, others)
        reasons = self._out_of_round(reasons)
        if not chosen and not self.shows_rings:
            reasons = self._own_shapes(image, missing, reasons)
        unequal = self._unequal(chosen)
        for k in chosen.keys() - unequal:
            spot, light = chosen[k]
            appearance = self._looks[spot]
            self._introduce(k, spot, light, appearance)
        if self.shows_rings:
            reasons = {k: "ring" if reason == "not_acquired" else reason for k, reason in reasons.items()}
        return {**reasons, **dict.fromkeys(unequal, "area")}

    def _introduce(self, k: int, spot: Spot, light: Light, appearance: Appearance) -> None:
        marker = self._markers[k]
        marker.introduce(spot, light, appearance, self._meter.gates(light, appearance), self._frame)
        self._sightings[k] = None

    def seen(self, image: ImageArray) -> list[tuple[float, float, str]]:
        """Columns, rows and names of what stands out where markers are looked for [px]: for people."""
        found: list[Candidate] = []
        others: list[tuple[float, float]] = []
        missing = [k for k, marker in enumerate(self._markers) if not marker.is_followed]
        for top, bottom in self._bands(missing, image.shape[0]):
            self._look(image, top, bottom, found, others)
        discs = [(spot.u, spot.v) for spot, _ in found]
        alone = [
            place
            for i, place in enumerate(others)
            if all(math.dist(place, other) > self._meter.radius for other in [*discs, *others[:i]])
        ]
        return [(*place, "a disc") for place in discs] + [
            (*place, "no disc of a marker's size") for place in alone
        ]

    def _out_of_round(self, reasons: dict[int, Reason]) -> dict[int, Reason]:
        """Name what keeps markers that are not as wide as high, if most of them are so alike, as of a pitched camera.

        A second image over the picture looks alike, too: a person has to say that the dots look like that.
        """
        if 2 * len(self._aspects) <= len(self._markers):
            return reasons
        away = [math.log(aspect / self._parameters.aspect) for aspect in self._aspects]
        if shared(away, len(away)) == 0.0 and len(away) > 1:
            return reasons
        self.aspect = median(self._aspects)
        odd: tuple[Reason, ...] = "smear", "shape"
        return {k: "out_of_round" if reason in odd else reason for k, reason in reasons.items()}

    def _own_shapes(
        self, image: ImageArray, missing: list[int], reasons: dict[int, Reason]
    ) -> dict[int, Reason]:
        """Take compact things that are no discs for markers, if most markers are so alike in several frames.

        Triangles, crosses, cuts of tape: each is alone in its marker's row, and what shows in one frame shows in the
        next. That most discs are covered or touched alike is not to be expected.
        """
        things = {k: thing for k in missing if (thing := self._alone(image, k)) is not None}
        for k in missing:
            count, gates = self._shapes.pop(k, (0, None))
            if k in things:
                spot, light, own = things[k]
                is_same = gates is not None and self._meter.judge(spot, gates) == "ok"
                self._shapes[k] = count + 1 if is_same else 1, self._meter.gates(light, own)
        ready = [k for k, (count, _) in self._shapes.items() if count >= CONFIRMED_FRAMES]
        if not is_common(len(ready), len(self._markers)):
            return reasons
        areas = [things[k][0].area for k in ready]
        if max(areas) > (1 + _EQUAL_SIZE) * min(areas):
            return reasons
        for k in ready:
            spot, light, own = things[k]
            self._markers[k].belief.clear()
            self._introduce(k, spot, light, own)
        return {k: reason for k, reason in reasons.items() if k not in ready}

    def _alone(self, image: ImageArray, k: int) -> tuple[Spot, Light, Appearance] | None:
        """Measure the one compact thing in a marker's row; None where there is none, or another one."""
        row, apart = self._markers[k].known_row, 2 * self._meter.radius
        if row is None:
            return None
        near = [
            blob for blob in self._blobs if abs(blob.v - row) <= self._parameters.expected_row_tolerance_px
        ]
        if not near or any(math.dist(near[0][:2], blob[:2]) > apart for blob in near):
            return None
        return self._meter.compact(image, near[0].u, near[0].v, near[0].ground, is_narrow=near[0].is_crowded)

    def _sharpened(self) -> float:
        """By how much the second moments of most spots are less than their areas allow, where cameras sharpen [px^2].

        A rim that overshoots adds to the area. A second disc that touches does so, too, but of one marker.
        """
        looks = [marker.appearance for marker in self._markers if marker.appearance is not None]
        looks += self._looks.values()
        narrower = [look.variance_v - look.area / (4 * math.pi * self._parameters.aspect) for look in looks]
        return min(shared(narrower, max(len(self._markers), len(looks))), 0.0)

    def _bands(self, missing: list[int], height: int) -> list[tuple[int, int]]:
        """First rows, and those after the last, in which to look for markers: their own, or the whole image."""
        rows = [row for k in missing if (row := self._markers[k].known_row) is not None]
        reach = self._parameters.expected_row_tolerance_px + self._meter.half
        bands = [(max(0, math.floor(row - reach)), min(height, math.ceil(row + reach) + 1)) for row in rows]
        return [(top, bottom) for top, bottom in bands if top < bottom] if rows else [(0, height)]

    def _look(
        self,
        image: ImageArray,
        top: int,
        bottom: int,
        found: list[Candidate],
        others: list[tuple[float, float]],
    ) -> bool:
        """Sort what stands out in a part of the image, by its own light, into markers and other things.

        Returns
        -------
        bool -- False: nothing does
        """
        relief = self._meter.relief(image[top:bottom])
        contrast = relief.most
        if contrast < self._parameters.min_contrast_grey:
            return False
        for fraction in _THRESHOLDS:
            for u, y, background, is_crowded in self._meter.centres(relief, fraction * contrast):
                v = top + y
                self._blobs.append(Blob(u, v, background, is_crowded))
                candidate = self._meter.candidate(image, u, v, background, is_narrow=is_crowded)
                if candidate is None:
                    others.append((u, v))
                    is_new = all(math.dist((u, v), ring) > self._meter.radius for ring in self._rings)
                    if is_new and self._meter.is_ring(image, u, v, background):
                        self._rings.append((u, v))
                    continue
                away = min((math.dist(candidate[0][:2], spot[:2]) for spot, _ in found), default=math.inf)
                if away > 2 * self._meter.radius:
                    found.append(candidate)
                elif away > self._meter.radius / 2:
                    # No room for two discs: one, and something that touches it.
                    others.append(candidate[0][:2])
        return True

    def _in_order(
        self, missing: list[int], found: list[Candidate], others: list[tuple[float, float]]
    ) -> Found:
        """Name spots by their order along the beam, where no rows are known."""
        found = sorted(found, key=lambda candidate: -candidate[0].v)
        if len(found) < len(missing):
            return {}, dict.fromkeys(missing, "not_acquired")
        gaps = [lower[0].v - upper[0].v for lower, upper in pairwise(found)]
        if len(found) > len(missing) or min(gaps, default=math.inf) < self._parameters.marker_diameter_px:
            return {}, dict.fromkeys(missing, "ambiguous")
        chosen = dict(zip(missing, found, strict=True))
        doubts = {k: self._doubt(k, spot, others) for k, (spot, _) in chosen.items()}
        if all(doubt == "ok" for doubt in doubts.values()):
            for k in missing:
                self._markers[k].belief.clear()
            return chosen, {}
        # One that is doubtful may not be a marker at all, and the others' names depend on it.
        return {}, {k: "ambiguous" if doubt == "ok" else doubt for k, doubt in doubts.items()}

    def _in_rows(
        self, missing: list[int], found: list[Candidate], others: list[tuple[float, float]]
    ) -> Found:
        """Name spots by the rows in which the markers are known to lie."""
        chosen: dict[int, Candidate] = {}
        reasons: dict[int, Reason] = dict.fromkeys(missing, "not_acquired")
        at = [marker.motion.u for marker in self._markers if marker.is_seen]
        left, right = beam_reach(at, self._parameters.max_bend_px)
        found = [candidate for candidate in found if left <= candidate[0].u <= right]
        others = [place for place in others if left <= place[0] <= right]
        for k in missing:
            near = [candidate for candidate in found if self._may_be(k, candidate[0])]
            beside = [(u, v) for u, v in others if self._is_in_row(k, v)]
            told = self._told(k, [spot for spot, _ in near], [u for u, _ in beside])
            if told is not None:
                # What moves as the beam does is the marker, whatever else is or was there.
                near, beside, self.clutter[k] = [near[told]], [], []
            if len(near) == 1 and (told is not None or not self._markers[k].belief.hypotheses):
                reasons[k] = self._doubt(k, near[0][0], beside)
                if reasons[k] == "ok":
                    chosen[k] = near[0]
            else:
                self._sightings[k] = None
                self._note_clutter(k, [u for u, _ in beside])
                if near:
                    reasons[k] = "ambiguous"
        return chosen, {k: reason for k, reason in reasons.items() if k not in chosen}

    def _is_in_row(self, k: int, v: float) -> bool:
        """True for a row in which a marker is looked for [px]."""
        row = self._markers[k].known_row
        return row is not None and abs(v - row) <= self._parameters.expected_row_tolerance_px

    def _may_be(self, k: int, spot: Spot) -> bool:
        """True for a spot in a marker's row on which no other one is followed."""
        near = self._parameters.marker_diameter_px / 2
        return self._is_in_row(k, spot.v) and not is_taken(self._markers, spot, k, near)

    def _told(self, k: int, spots: list[Spot], things: list[float]) -> int | None:
        """Which one of several spots in a marker's row it is, by their motions; None where that is not certain."""
        belief, now = self._markers[k].belief, self._now
        if not belief.hypotheses and len(spots) > 1:
            belief.begin([SpotPath(((self._frame, spot.u),), spot.v) for spot in spots])
            return None
        if not belief.hypotheses or now is None:
            return None
        possible = [Possible(spot.u, spot.v) for spot in spots]
        found = belief.update(None, self._recovery.view(k, things, possible, now))
        if belief.is_alone and found is None and not spots:
            belief.clear()
        return found

    def _note_clutter(self, k: int, columns: list[float]) -> None:
        """Note what was seen in a marker's row and is not known to be the marker."""
        kept = [thing for thing in self.clutter[k] if self._frame - thing.last < LONELY_FRAMES]
        for u in columns:
            old = next((thing for thing in kept if abs(thing.u - u) <= SAME_PLACE_PX), None)
            if old is None:
                kept.append(Thing(u, self._frame, self._frame))
            else:
                old.last = self._frame
        self.clutter[k] = kept

    def _doubt(self, k: int, spot: Spot, others: list[tuple[float, float]]) -> Reason:
        """Name what makes a spot doubtful that is alone of its kind in a marker's row; "ok" where nothing does."""
        shear = self._recovery.shear_of_speed * self._parameters.max_gate_px
        disc = one_disc(*self._bare[spot], self._parameters, self._narrower, shear)
        before, motion = self._sightings[k], self._markers[k].motion
        if before is not None and before.frame != self._frame - 1:
            before = None
        self._sightings[k] = Sighted(self._frame, spot.u, disc.excess, disc.covariance)
        motion.velocity = spot.u - before.u if before is not None else 0.0
        beside = [u for u, v in others if math.dist((u, v), spot[:2]) > SAME_PLACE_PX]
        things = beside if disc.reason == "ok" else [*beside, spot.u]
        self._note_clutter(k, things)
        if before is not None:
            self._note_aspect(motion, spot, disc, before.excess)
        if disc.reason != "ok":
            return disc.reason
        # Anything else may be the marker, smeared, joined with a twin or covered in part.
        if any(
            thing.is_new(self._frame)
            and (thing.last == self._frame or abs(thing.u - spot.u) > self._parameters.marker_diameter_px)
            for thing in self.clutter[k]
        ):
            return "ambiguous"
        if max(disc.excess, abs(disc.covariance)) <= disc.tolerance:
            return "ok"
        if before is None:
            return "smear"
        explained = self._explained(motion)
        lengths = math.sqrt(max(disc.excess, 0.0)), math.sqrt(max(before.excess, 0.0))
        slack = disc.tolerance + _SPEED_SLACK * explained + (lengths[0] - lengths[1]) ** 2 / 4
        if (disc.excess + before.excess) / 2 - explained > slack:
            return "smear"
        # The mean of both is sheared by the mean speed, at most.
        half = self._recovery.shear_of_speed * (spot.u - before.u) * self._bare[spot][2].variance_v / 2
        slack = (
            disc.tolerance + (1 + 2 * _SPEED_SLACK) * abs(half) + abs(disc.covariance - before.covariance) / 4
        )
        return "ok" if abs((disc.covariance + before.covariance) / 2 - half) <= slack else "shape"

    def _explained(self, motion: MarkerMotion) -> float:
        """Second moment along u that a marker's mean speed since the frame before explains [px^2]."""
        # The speed is that of the two exposures' middles; the exposure is a part of the time in between.
        share = min(1.0, self._exposure_s * 1e9 / self._elapsed_ns) if self._elapsed_ns > 0 else 1.0
        return (share * motion.velocity) ** 2 / 12

    def _note_aspect(self, motion: MarkerMotion, spot: Spot, disc: OneDisc, excess_before: float) -> None:
        """Take the aspect of a spot that is out of round by more than its motion explains.

        Notes
        -----
        A disc of area S and aspect q has second moments that differ by S (q - 1 / q) / (4 pi). What is beyond that of
        the expected aspect is the spot's excess.
        """
        explained = self._explained(motion)
        left = (disc.excess + excess_before) / 2 - explained
        if abs(left) <= disc.tolerance + _SPEED_SLACK * explained:
            return
        uniform, aspect = self._bare[spot][2].area / (4 * math.pi), self._parameters.aspect
        half = (left / uniform + aspect - 1 / aspect) / 2
        self._aspects.append(half + math.sqrt(half * half + 1.0))

    def _unequal(self, chosen: dict[int, Candidate]) -> list[int]:
        """Markers of another size than most of them: a twin that touches, or a part that is hidden."""
        areas = {k: marker.appearance.area for k, marker in enumerate(self._markers) if marker.appearance}
        areas |= {k: self._looks[spot].area for k, (spot, _) in chosen.items()}
        if len(areas) < _MAJORITY:
            return []
        usual = median(areas.values())
        return [
            k
            for k, (_, light) in chosen.items()
            if abs(areas[k] / usual - 1)
            > _EQUAL_SIZE + _SIGNIFICANT * light.noise / (light.contrast * math.sqrt(usual))
        ]
