"""Looking for lost markers: which spot of a row is the marker that was there.

A lost marker is looked for from edge to edge of the row in which it was last seen, in whatever light all markers have
now, and is believed within a distance that grows with every frame, as its own and the other markers' motion allow.
Where it met another spot of its kind (a rival), or where the one spot in view may be the rival, it stays lost until
the rival has left, or has been seen where it was bound for: nothing is invented and identities are never exchanged.
Markers that were lost together are believed wherever they are (``vision.tracking.marker_state``).
"""

from __future__ import annotations

import math
from statistics import median
from typing import NamedTuple

from beam_ros.arrays import ImageArray
from beam_ros.vision.tracking.appearance import Light
from beam_ros.vision.tracking.marker_state import (
    CONFIRMED_FRAMES,
    SAME_PLACE_PX,
    TOGETHER_FRAMES,
    Foretold,
    MarkerState,
    beam_reach,
    is_common,
    is_taken,
    moved_together,
    shared,
)
from beam_ros.vision.tracking.rivals import (
    APART,
    LEVERAGE,
    REST_PX,
    Course,
    Track,
    associated,
    carried,
    continued,
    is_bound_for,
    left_over,
    may_be,
    on_course,
    present,
    recent,
    recognised,
    swinging,
    unseen,
)
from beam_ros.vision.tracking.spot_search import RowSpots, spots_in_row
from beam_ros.vision.tracking.spots import Reason, Spot, SpotMeter

_ROW_PX = 0.3
"""A marker's row is known to this [px], ..."""
_ROW_CREEP_PX = 0.01, 0.1
"""... and so much less with every frame in which it is lost, of several markers and of one alone [px]."""
_LOWERING = 0.6
"""A cantilever whose tip moves aside by w sinks by this times w^2 over its length."""
_GAINS = 0.25, 4.0
"""Least and largest change of the light while a marker is lost."""
_STEPS = 3.0
"""A marker may have moved by so many of its usual steps with every frame since it was lost."""
_LASTING_FRAMES = 2
"""The only marker of a beam has changed its brightness with the light where that lasts for so many frames."""
_EQUAL_LIGHT = 0.15
"""Relative tolerance of a marker's change of brightness against that of the others."""
_PLATEAU_NOISE = 2.0
"""Three standard deviations of the difference of two plateaus, each the mean of five pixels, over that of a pixel."""


class Witness(NamedTuple):
    """What the rest of a picture says of a lost marker.

    Attributes
    ----------
    left, right : float -- columns between which the beam reaches beside the markers that are seen [px]
    farthest : float -- how far from where it was seen last it may be [px]
    nearest_unlike : float -- how far from there the nearest thing of another look is [px]
    moved : float -- how far the camera moved across the rows [px]
    is_at_rest : bool -- the markers that are seen are where they were
    expected : Foretold or None -- where it must be by those
    """

    left: float
    right: float
    farthest: float
    nearest_unlike: float
    moved: float
    is_at_rest: bool
    expected: Foretold | None


class Recovery:
    """Finds markers that are not where they should be.

    Parameters
    ----------
    meter : SpotMeter
    markers : list of MarkerState -- lowest first

    Attributes
    ----------
    before : ndarray or None -- the frame before, shape (height, width)
    shear_of_speed : float -- what a rolling shutter makes of a speed [px/px over px per frame]
    """

    def __init__(self, meter: SpotMeter, markers: list[MarkerState]) -> None:
        self._meter = meter
        self._parameters = meter.parameters
        self._markers = markers
        self._frame = 0
        rows = [marker.known_row for marker in markers if marker.known_row is not None]
        self._span = max(rows) - min(rows) if len(rows) > 1 else meter.half
        self.before: ImageArray | None = None
        self.shear_of_speed = 0.0

    def in_row(self, image: ImageArray, k: int, *, own: float = math.nan, is_wide: bool = False) -> RowSpots:
        """Spots with a marker's appearance in its row from edge to edge, each in its own light.

        A wide row is one to which the camera may have moved, though not one where another marker belongs.
        """
        marker, reach = self._markers[k], self._parameters.row_gate_px
        assert marker.light is not None
        assert marker.appearance is not None
        if is_wide:
            reach = max(reach, self._parameters.expected_row_tolerance_px)
            for j, other in enumerate(self._markers):
                if j != k and math.isfinite(other.v):
                    reach = min(reach, abs(other.v - marker.v) / 2)
        # What is there is no faster than the other markers allow; without those, than one that is believed by itself.
        others = [abs(other.velocity) for other in self._markers if other is not marker and other.is_seen]
        fastest = LEVERAGE * max(others) if others else self._parameters.max_jump_px

        def shear(u: float) -> float:
            known = sum(map(abs, marker.speed(u, self._frame))) if math.isnan(own) else 0.0
            return self.shear_of_speed * (known or fastest)

        return spots_in_row(self._meter, image, marker.v, reach, marker.light, marker.appearance, own, shear)

    def note_losses(self, frame: int) -> None:
        """Note the loss of every marker that is followed, in a frame that shows none of them."""
        for k, marker in enumerate(self._markers):
            if marker.is_followed:
                self.note_loss(k, frame)

    def note_loss(self, k: int, frame: int) -> None:
        """Note where a marker was last seen, and what was beside it in that frame."""
        marker = self._markers[k]
        if marker.lost_frames > 0:
            return
        marker.lost_at = frame
        marker.company_u = tuple(other.u for other in self._markers)
        marker.company_v = tuple(other.v for other in self._markers)
        marker.company_ways = [list(other.way) for other in self._markers]
        marker.company_contrast = tuple(other.shown for other in self._markers)
        if self.before is not None:
            beside = [spot for spot, _ in self.in_row(self.before, k, own=marker.u).alike]
            marker.rivals = continued(marker.rivals, beside, frame - 1, self._parameters.max_gate_px)
        # Where it met one there are two tracks of it, and that is no company.
        marker.is_doubtful = len(marker.rivals) > marker.is_mixed
        courses = [Course.of(track) for track in marker.rivals]
        marker.courses = [course for course in courses if course is not None]
        marker.told_frames = 0
        marker.relit_way.clear()

    def find(
        self,
        image: ImageArray,
        frame: int,
        lost: list[int],
        spots: dict[int, Spot],
        reasons: dict[int, Reason],
    ) -> None:
        """Look for lost markers in a frame, by its number; fills in what is found."""
        self._frame = frame
        markers, parameters = self._markers, self._parameters
        for k in lost:
            self.note_loss(k, frame)
        rows = {k: self.in_row(image, k, is_wide=True) for k in lost}
        if self._adapt(rows, spots, reasons):
            rows = {k: self.in_row(image, k, is_wide=True) for k in lost}
        contrasts = self._contrasts(image, rows, spots, reasons)
        seen = {k: spots[k].u for k in range(len(self._markers)) if reasons.get(k) == "ok"}
        elsewhere: dict[int, tuple[Spot, Light]] = {}
        for k, row in rows.items():
            marker = markers[k]
            failed, expected = reasons.get(k, "hidden"), self._expected_contrast(k, contrasts)
            shift = self._moved_across(marker, spots, reasons)
            spots.pop(k, None)
            alike = [found for found in row.alike if self._is_in_row(marker, found[0], shift)]
            lit = [
                (spot, light)
                for spot, light in alike
                if abs(light.contrast / expected - 1) <= parameters.brightness_tolerance
                and not is_taken(markers, spot, k, parameters.marker_diameter_px / 2)
            ]
            if not lit and self._is_relit(k, [spot for spot, _ in alike], seen):
                lit = alike
            marker.alone_frames = marker.alone_frames + 1 if len(lit) == 1 else 0
            marker.is_doubtful |= len(lit) > 1
            if marker.is_joined and self._meter.is_dim(image, marker.u, marker.v, expected):
                marker.is_blind = True
            moves = self._moves(marker, spots, reasons)
            # What lies nearer to where it was may be the marker, covered in part or beside a twin.
            unlike = [u for u, _ in row.others] + [spot.u for spot, _ in alike if spot not in dict(lit)]
            nearest_unlike = min((abs(u - marker.u) for u in unlike), default=math.inf)
            witness = Witness(
                *self._beside(marker, seen),
                min(self._farthest(marker, moves), nearest_unlike + SAME_PLACE_PX),
                nearest_unlike,
                shift or 0.0,
                max(moves, default=math.inf) <= REST_PX,
                self._carried(k, seen) if lit else None,
            )
            # What lies in another row is no marker, and is followed for the frames in which that does not show.
            strangers = [
                track for track in marker.rivals if not self._is_in_row(marker, track, witness.moved)
            ]
            marker.rivals = [track for track in marker.rivals if track not in strangers]
            chosen = self._choose(marker, lit, witness)
            self._follow_strangers(marker, strangers, [spot for spot, _ in row.alike], witness.moved)
            if chosen is not None:
                spots[k], marker.light = chosen
                reasons[k] = "ok"
                continue
            if lit:
                reasons[k] = "ambiguous"
            elif row.alike:
                reasons[k] = "brightness"
            else:
                reasons[k] = row.nearest(marker.u) if failed == "hidden" else failed
            if len(lit) == 1 and not marker.is_doubtful and self._is_common_loss(k):
                elsewhere[k] = lit[0]
        self._take_back_what_is_apart(lost, spots, reasons)
        moved = moved_together(
            {k: (spot.u - markers[k].u, spot.v - markers[k].v) for k, (spot, _) in elsewhere.items()},
            {k: (spot.u - markers[k].u, spot.v - markers[k].v) for k, spot in spots.items()},
            len(self._markers),
            slack_px=parameters.max_jump_px,
            row_slack_px=parameters.row_gate_px,
        )
        for k in moved:
            spots[k], markers[k].light = elsewhere[k]
            markers[k].rivals, markers[k].is_mixed, reasons[k] = [], False, "ok"
        if moved:
            across = median(spots[k].v - markers[k].v for k in moved)
            for k in lost:
                # The camera was moved across the rows: those still hidden are elsewhere, too.
                if k not in spots:
                    markers[k].v += across
        anew = [k for k, row in rows.items() if reasons[k] != "ok" and self._is_clipped_anew(image, k, row)]
        if is_common(len(anew), len(self._markers)):
            for k in anew:
                marker = markers[k]
                others = [track for track in marker.rivals if abs(track.u - marker.u) > SAME_PLACE_PX]
                marker.rivals = [*others, Track(marker.u, 0.0, self._frame)] if others else []
                marker.forget()

    def _adapt(self, rows: dict[int, RowSpots], spots: dict[int, Spot], reasons: dict[int, Reason]) -> bool:
        """Take a change that most markers share, as of the camera's focus, into what they look like.

        Returns
        -------
        bool -- False: there is none that lost markers show
        """
        changed = {k: row.changed[0] for k, row in rows.items() if len(row.changed) == 1 and not row.alike}
        if not changed:
            return False
        shown = {**{k: spot for k, spot in spots.items() if reasons[k] == "ok"}, **changed}
        gates = {k: own for k in shown if (own := self._markers[k].gates) is not None}
        changes = [self._meter.change(shown[k], own) for k, own in gates.items()]
        area = shared([change[0] for change in changes], len(self._markers))
        variance = shared([change[1] for change in changes], len(self._markers))
        if area == variance == 0.0:
            return False
        for marker in self._markers:
            if marker.appearance is not None and marker.light is not None:
                marker.appearance.change(area, variance)
                marker.gates = self._meter.gates(marker.light, marker.appearance)
        return True

    def _take_back_what_is_apart(
        self, lost: list[int], spots: dict[int, Spot], reasons: dict[int, Reason]
    ) -> None:
        """Take back what was found farther from the other markers than a beam bends, from most of them first."""
        while True:
            apart = {
                k: sum(abs(spots[k].u - other.u) > self._parameters.max_bend_px for other in spots.values())
                for k in lost
                if k in spots
            }
            most = max(apart.values(), default=0)
            if most == 0:
                return
            for k in (k for k, count in apart.items() if count == most):
                self._markers[k].rivals.append(Track.of(spots.pop(k), self._frame))
                reasons[k] = "ambiguous"

    def _is_clipped_anew(self, image: ImageArray, k: int, row: RowSpots) -> bool:
        """True when the sensor cuts off a marker's light which it did not in the frame before, or the reverse.

        What is cut off is a disc of another area and rim, which its appearance in the old light says nothing about.
        """
        marker = self._markers[k]
        things = [*(u for u, _ in row.others), *(spot.u for spot, _ in row.alike)]
        if self.before is None or marker.lost_frames or not things:
            return False
        u = min(things, key=lambda thing: abs(thing - marker.u))
        before = self._meter.is_clipped(self.before, marker.u, marker.v)
        return before != self._meter.is_clipped(image, u, marker.v)

    def _beside(self, marker: MarkerState, seen: dict[int, float]) -> tuple[float, float]:
        """First and last column where a lost marker may be beside those that are seen in these columns [px]."""
        parameters = self._parameters
        moves = [u - marker.company_u[k] for k, u in seen.items() if math.isfinite(marker.company_u[k])]
        if math.isfinite(parameters.max_bend_px) or not moves or marker.is_anywhere:
            return beam_reach(seen.values(), parameters.max_bend_px)
        # Nobody says how far the beam bends: no farther than a lost marker is believed, from where the others went.
        middle, reach = marker.u + median(moves), parameters.max_gate_px + 3 * parameters.marker_diameter_px
        return middle - reach, middle + reach

    def _carried(self, k: int, seen: dict[int, float]) -> Foretold | None:
        """Where a lost marker must be by the model, or by those that are seen in these columns [px]."""
        marker = self._markers[k]
        told = carried(
            marker.company_ways[k], [(marker.company_ways[j], u) for j, u in seen.items() if j != k]
        )
        places = [] if told is None else [Foretold(*told)]
        if marker.foretold is not None:
            places.append(marker.foretold)
        return min(places, key=lambda place: place.doubt_px, default=None)

    def _is_relit(self, k: int, spots: list[Spot], seen: dict[int, float]) -> bool:
        """True when what is alone in a marker's row, in another light, swings where it must be beside the others.

        Those are seen in the columns given [px].
        """
        way = self._markers[k].relit_way
        expected = self._carried(k, seen) if len(spots) == 1 else None
        if expected is None or expected.doubt_px > SAME_PLACE_PX or not expected.admits(spots[0].u):
            way.clear()
            return False
        way.append(spots[0].u)
        return len(way) >= CONFIRMED_FRAMES and max(way) - min(way) > SAME_PLACE_PX

    def _row_reach(self, marker: MarkerState, u: float) -> float:
        """How far from its row a marker is in a column, at most [px].

        A beam that bends lowers it with the square of its way, by what theory says or by what was seen.
        """
        swing = max(marker.swing, 1.0)
        lowering = min(_LOWERING / self._span, (marker.row_swing + _ROW_PX / 5) / swing**2)
        reach = _ROW_PX + marker.row_swing + _ROW_CREEP_PX[len(self._markers) == 1] * marker.lost_frames
        return min(reach + lowering * (u - marker.centre) ** 2, self._parameters.row_gate_px)

    def _moved_across(
        self, marker: MarkerState, spots: dict[int, Spot], reasons: dict[int, Reason]
    ) -> float | None:
        """How far the camera moved across the rows since a marker was lost [px]; None where no other one tells."""
        moves = [
            spot.v - marker.company_v[k]
            for k, spot in spots.items()
            if reasons[k] == "ok" and math.isfinite(marker.company_v[k])
        ]
        return median(moves) if moves else None

    def _is_in_row(self, marker: MarkerState, seen: Spot | Track, moved: float | None) -> bool:
        """True when a spot may be a marker by its row, or nobody knows how far the camera moved across."""
        return moved is None or not abs(seen.v - marker.v - moved) > self._row_reach(marker, seen.u)

    def _farthest(self, marker: MarkerState, moves: list[float]) -> float:
        """How far a lost marker may be by the moves of those that are seen and its own of late [px]."""
        if not moves:
            return math.inf
        own = _STEPS * marker.hold_error * (marker.lost_frames + 1)
        return self._parameters.marker_diameter_px + own + LEVERAGE * max(moves)

    @staticmethod
    def _moves(marker: MarkerState, spots: dict[int, Spot], reasons: dict[int, Reason]) -> list[float]:
        """How far those that are seen are from where they were when a marker was lost [px]."""
        return [
            abs(spot.u - marker.company_u[k])
            for k, spot in spots.items()
            if reasons[k] == "ok" and math.isfinite(marker.company_u[k])
        ]

    def _follow_strangers(
        self, marker: MarkerState, strangers: list[Track], spots: list[Spot], moved: float
    ) -> None:
        """Follow what lies in another row beside a marker's rivals."""
        others = [spot for spot in spots if not self._is_in_row(marker, spot, moved)]
        # What was seen as one with a stranger is not hidden where the stranger is seen now.
        marker.rivals = [
            track
            for track in marker.rivals
            if track.frame == self._frame
            or all(abs(track.u - spot.u) > self._parameters.marker_diameter_px for spot in others)
        ]
        marker.rivals += continued(strangers, others, self._frame, self._parameters.max_jump_px)

    def _choose(
        self, marker: MarkerState, lit: list[tuple[Spot, Light]], witness: Witness
    ) -> tuple[Spot, Light] | None:
        """Choose the spot that is a lost marker, within a distance that grows with every frame.

        One that met a rival is what remains once all else has left that might be either, covered in part or touched,
        or has gone on its way. What the beam does not reach beside the markers that are seen has left.
        """
        parameters = self._parameters
        gate = min(
            max(
                parameters.max_jump_px + marker.lost_frames * parameters.gate_growth_px,
                abs(marker.u - marker.centre) + marker.swing + parameters.marker_diameter_px,
            ),
            parameters.max_gate_px,
            witness.farthest,
        )
        if marker.is_anywhere:
            gate = math.inf
        light_of = {
            spot: light
            for spot, light in lit
            if witness.left <= spot.u <= witness.right
            and (marker.is_anywhere or self._is_in_row(marker, spot, witness.moved))
        }
        spots = list(light_of)
        if marker.lost_frames == 0 and (same := self._goes_on(marker, spots, gate)) is not None:
            return same, light_of[same]
        hidden = [] if marker.is_mixed else unseen(marker.rivals, self._frame)
        tracks, free = associated(
            [track for track in marker.rivals if track not in hidden],
            spots,
            self._frame,
            gate if marker.is_mixed else parameters.max_jump_px,
            math.nan if marker.is_mixed or marker.lost_frames else marker.predicted,
        )
        expected = None if marker.is_anywhere else witness.expected
        near = [
            spot
            for spot in free
            if abs(spot.u - marker.u) <= gate and (expected is None or expected.admits(spot.u))
        ]
        returned, free = recognised(hidden, free, near, self._frame, gate)
        tracks += returned
        near = [spot for spot in near if spot in free]
        strangers = [
            spot
            for spot in spots
            if is_bound_for(marker.courses, spot, self._frame, parameters.marker_diameter_px)
        ]
        doubtful = (
            []
            if marker.is_mixed
            else [spot for spot in near if spot in strangers or may_be(tracks, spot, self._frame, gate)]
        )
        chosen = near[0] if len(near) == 1 and not doubtful and not marker.is_mixed else None
        # Where two are near, each may be either, and both are followed, in place of those that were hidden.
        if len(near) > 1:
            out = [track for track in tracks if may_be([track], near[0], self._frame, gate)]
            tracks = [track for track in tracks if track not in out or len(near) <= len(out)]
        tracks += [
            Track.of(spot, self._frame)
            for spot in free
            if spot is not chosen and (spot not in doubtful or len(near) > 1)
        ]
        marker.rivals = present(tracks, self._frame, witness.left, witness.right, parameters.max_jump_px)
        if marker.is_mixed:
            if (
                len(spots) == len(marker.rivals) == 1
                and abs(spots[0].u - marker.u) <= parameters.max_gate_px < witness.nearest_unlike
                and not marker.is_blind
                and not strangers
            ):
                marker.rivals, chosen = [], spots[0]
            # Two that vanish as one may come back one by one.
            if len(marker.rivals) > 1:
                marker.is_joined = marker.is_blind = False
        else:
            marker.is_mixed = len(near) > 1
        if chosen is None:
            told = self._told(marker, spots, is_at_rest=witness.is_at_rest)
            if told is not None and (
                marker.is_foretold or abs(told.u - marker.u) <= min(witness.farthest, parameters.max_gate_px)
            ):
                chosen = told
                marker.rivals = [track for track in marker.rivals if track.u != told.u]
        return None if chosen is None else (chosen, light_of[chosen])

    def _goes_on(self, marker: MarkerState, spots: list[Spot], gate: float) -> Spot | None:
        """Choose the spot that goes on as the marker went until now, where no rival was bound for there."""
        doubt = REST_PX + _STEPS * marker.usual_error
        spot = on_course(spots, marker.predicted, doubt)
        others = [track for track in marker.rivals if track.u != marker.u]
        if (
            spot is None
            or abs(spot.u - marker.u) > gate
            or any(
                abs(track.predicted(self._frame) - marker.predicted) <= APART * doubt
                for track in recent(others, self._frame)
            )
        ):
            return None
        marker.rivals = continued(
            others, [other for other in spots if other is not spot], self._frame, self._parameters.max_gate_px
        )
        return spot

    def _told(self, marker: MarkerState, spots: list[Spot], *, is_at_rest: bool) -> Spot | None:
        """Choose what swings with the beam, rests where it did with a beam at rest, or remains of known ways.

        Or what is where it was foretold, where nothing else of its kind may be.
        """
        if marker.is_mixed and marker is not self._markers[0]:
            ways = [other.way for other in self._markers if other is not marker]
            track = swinging(marker.rivals, ways, self._frame)
            if track is not None:
                return next((spot for spot in spots if spot.u == track.u), None)
        told = left_over(marker.courses, spots, self._frame) if marker.courses else None
        if told is None and is_at_rest and marker.swing <= REST_PX:
            told = on_course(spots, marker.u, REST_PX)
        foretold = marker.foretold_among(spots, self._frame, self._parameters) if told is None else None
        told = told or foretold
        marker.told_frames = 0 if told is None else marker.told_frames + 1
        if marker.told_frames < CONFIRMED_FRAMES:
            return None
        marker.is_foretold = told is foretold
        return told

    def _contrasts(
        self,
        image: ImageArray,
        rows: dict[int, RowSpots],
        spots: dict[int, Spot],
        reasons: dict[int, Reason],
    ) -> dict[int, float]:
        """Contrast that each marker shows in this frame; of one that is lost, what its nearest like shows."""
        contrasts: dict[int, float] = {}
        for k, marker in enumerate(self._markers):
            if k in rows:
                nearest = min(rows[k].alike, key=lambda seen: abs(seen[0].u - marker.u), default=None)
                if nearest is not None:
                    contrasts[k] = nearest[1].contrast
            elif k in spots and reasons[k] == "ok" and marker.gates is not None:
                sides = self._meter.sides(image, spots[k])
                shown = abs(spots[k].plateau - 0.5 * (sides.left + sides.right))
                contrasts[k] = shown / self._meter.lit_share(spots[k], marker.gates)
        return contrasts

    def _expected_contrast(self, k: int, contrasts: dict[int, float]) -> float:
        """Contrast of a lost marker in the light that most markers have now, by what they had when it was last seen.

        One marker alone has changed with the light once that has lasted.
        """
        marker = self._markers[k]
        assert marker.light is not None
        own = marker.company_contrast[k]
        gains = [contrast / marker.company_contrast[other] for other, contrast in contrasts.items()]
        gains = [gain for gain in gains if _GAINS[0] <= gain <= _GAINS[1]]
        for gain in gains:
            tolerance = _EQUAL_LIGHT + _PLATEAU_NOISE * marker.light.noise / (gain * own)
            equal = [other for other in gains if abs(other / gain - 1) <= tolerance]
            if is_common(len(equal), len(self._markers)):
                return own * median(equal)
        if len(self._markers) == 1 and gains and marker.lost_frames >= _LASTING_FRAMES:
            return own * gains[0]
        return own

    def _is_common_loss(self, k: int) -> bool:
        """True when most of the markers were lost at about the same time as this one."""
        at = self._markers[k].lost_at
        return is_common(
            sum(abs(other.lost_at - at) <= TOGETHER_FRAMES for other in self._markers), len(self._markers)
        )
