"""Looking for lost markers: what the row of each shows, in the light and focus that all markers have now.

A lost marker is looked for from edge to edge of the row in which it was last seen. The association tells which of the
spots there it is (``vision.tracking.association``), by the marker's own motion, by the others' and by its row. What
most markers have in common is no change of one: light, focus, a step of the whole beam or of the camera.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import median

from beam_ros.arrays import ImageArray
from beam_ros.vision.tracking.appearance import Light
from beam_ros.vision.tracking.association import (
    LEVERAGE,
    Leap,
    Place,
    Possible,
    Room,
    View,
    carried,
    moved_together,
)
from beam_ros.vision.tracking.marker_state import (
    Company,
    MarkerMotion,
    MarkerState,
    beam_reach,
    is_common,
    is_taken,
    shared,
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
_TAKES_PART = 0.1
"""A marker above the lowest does not rest while others move: it is foreseen to this share of their steps."""
_LASTING_FRAMES = 2
"""The only marker of a beam has changed its brightness with the light where that lasts for so many frames."""
_EQUAL_LIGHT = 0.15
"""Relative tolerance of a marker's change of brightness against that of the others."""
_PLATEAU_NOISE = 2.0
"""Three standard deviations of the difference of two plateaus, each the mean of five pixels, over that of a pixel."""


class Frame:
    """One frame in which markers are looked for.

    Attributes
    ----------
    image : ndarray, shape (height, width)
    number : int -- of the frame
    spots, reasons : dict -- what is seen of the markers, and whether it is "ok"
    """

    def __init__(
        self, image: ImageArray, number: int, spots: dict[int, Spot], reasons: dict[int, Reason]
    ) -> None:
        self.image, self.number = image, number
        self.spots, self.reasons = spots, reasons

    @property
    def seen(self) -> dict[int, Spot]:
        """Markers that are seen where they may be."""
        return {k: spot for k, spot in self.spots.items() if self.reasons.get(k) == "ok"}


class Recovery:
    """Finds markers that are not where they should be, or not alone there.

    Parameters
    ----------
    meter : SpotMeter
    markers : list of MarkerState -- lowest first

    Attributes
    ----------
    before : ndarray or None -- the frame before, shape (height, width)
    shear_of_speed : float -- what a rolling shutter makes of a speed [px/px over px per frame]
    rows : dict of int to RowSpots -- what was seen in the rows of markers in this frame
    """

    def __init__(self, meter: SpotMeter, markers: list[MarkerState]) -> None:
        self._meter = meter
        self._parameters = meter.parameters
        self._markers = markers
        rows = [marker.known_row for marker in markers if marker.known_row is not None]
        self._span = max(rows) - min(rows) if len(rows) > 1 else meter.half
        self.before: ImageArray | None = None
        self.shear_of_speed = 0.0
        self.rows: dict[int, RowSpots] = {}

    def in_row(self, image: ImageArray, k: int, *, own: float = math.nan, is_wide: bool = False) -> RowSpots:
        """Spots with a marker's appearance in its row from edge to edge, each in its own light.

        A wide row is one to which the camera may have moved, though not one where another marker belongs.
        """
        marker, reach = self._markers[k], self._parameters.row_gate_px
        assert marker.light is not None
        assert marker.appearance is not None
        if is_wide:
            reach = self._wide_reach(k)
        # What is there is no faster than the other markers allow; without those, than one that is believed by itself.
        others = [
            abs(other.motion.velocity) for other in self._markers if other is not marker and other.is_seen
        ]
        fastest = LEVERAGE * max(others) if others else self._parameters.max_jump_px

        def shear(u: float) -> float:
            known = sum(map(abs, marker.motion.speed(u, marker.lost_frames))) if math.isnan(own) else 0.0
            return self.shear_of_speed * (known or fastest)

        row = marker.motion.v
        return spots_in_row(self._meter, image, row, reach, marker.light, marker.appearance, own, shear)

    def _wide_reach(self, k: int) -> float:
        """How far from its row a marker may be in any frame, and no other belongs [px]."""
        reach = max(self._parameters.row_gate_px, self._parameters.expected_row_tolerance_px)
        row = self._markers[k].motion.v
        halves = [abs(other.motion.v - row) / 2 for j, other in enumerate(self._markers) if j != k]
        return min([reach, *filter(math.isfinite, halves)])

    def note_losses(self, number: int) -> None:
        """Note the loss of every marker that is followed, in a frame that shows none of them."""
        for k, marker in enumerate(self._markers):
            if marker.is_followed:
                self.note_loss(k, number)

    def note_loss(self, k: int, number: int) -> None:
        """Note where all markers were when one was last seen, and what was beside it in that frame."""
        marker = self._markers[k]
        if marker.lost_frames > 0:
            return
        marker.lost_at = number
        motions = [other.motion for other in self._markers]
        marker.company = Company(
            tuple(motion.u for motion in motions),
            tuple(motion.v for motion in motions),
            tuple(other.shown for other in self._markers),
            tuple(tuple(motion.way) for motion in motions),
        )
        if self.before is not None and not marker.belief.is_watched(number, 1):
            beside = self.in_row(self.before, k, own=marker.motion.u).alike
            path = marker.path
            if beside and path is not None and path.frame == number - 1:
                candidates = [Possible(spot.u, spot.v) for spot, _ in beside]
                marker.belief.update(
                    path, self.view(k, [], candidates, Frame(self.before, number - 1, {}, {}))
                )

    def find(self, frame: Frame, lost: list[int], checked: list[int]) -> None:
        """Look for lost markers, and for others of their kind beside some that are seen; fills in what is found."""
        for k in lost:
            self.note_loss(k, frame.number)
        self.rows = {k: self.in_row(frame.image, k, own=frame.spots[k].u) for k in checked}
        for k, row in self.rows.items():
            marker, belief = self._markers[k], self._markers[k].belief
            if marker.motion.way and (row.alike or not belief.is_alone):
                self._tell(k, row, [(frame.spots[k], None), *row.alike], math.nan, frame)
                if frame.reasons[k] != "ok":
                    self.note_loss(k, frame.number)
        if not lost:
            return
        rows = {k: self.in_row(frame.image, k, is_wide=True) for k in lost}
        if self._adapt(rows, frame):
            rows = {k: self.in_row(frame.image, k, is_wide=True) for k in lost}
        contrasts = self._contrasts(rows, frame)
        elsewhere = self._tell_all(rows, contrasts, frame)
        self._follow_a_leap(elsewhere, lost, frame)
        anew = [
            k for k, row in rows.items() if frame.reasons[k] != "ok" and self._is_clipped_anew(frame, k, row)
        ]
        if is_common(len(anew), len(self._markers)):
            for k in anew:
                self._markers[k].forget()
        self.rows.update(rows)

    def _tell_all(
        self, rows: dict[int, RowSpots], contrasts: dict[int, float], frame: Frame
    ) -> dict[int, tuple[Spot, Light]]:
        """Tell where lost markers are, and once more those that others may tell which were found meanwhile.

        Returns
        -------
        dict of int to (Spot, Light) -- of those that are not found, what may show that they went elsewhere together
        """
        failed = {k: frame.reasons.pop(k, "hidden") for k in rows}
        before = {k: self._markers[k].belief.hypotheses for k in rows}
        elsewhere: dict[int, tuple[Spot, Light]] = {}
        pending, n_seen = list(rows), -1
        for k in rows:
            frame.spots.pop(k, None)
        while pending and len(frame.seen) > n_seen:
            n_seen = len(frame.seen)
            for k in pending:
                self._markers[k].belief.hypotheses = before[k]
                new = self._tell(k, rows[k], rows[k].alike, self._expected_contrast(k, contrasts), frame)
                elsewhere.pop(k, None)
                if new is not None:
                    elsewhere[k] = new
            pending = [k for k in pending if frame.reasons[k] != "ok"]
        for k in pending:
            if frame.reasons[k] == "hidden":
                nearest = rows[k].nearest(self._markers[k].motion.u)
                frame.reasons[k] = nearest if failed[k] == "hidden" else failed[k]
        return elsewhere

    def _tell(
        self,
        k: int,
        row: RowSpots,
        spots: Sequence[tuple[Spot, Light | None]],
        contrast: float,
        frame: Frame,
    ) -> tuple[Spot, Light] | None:
        """Tell which of some spots a marker of this contrast is.

        Returns
        -------
        (Spot, Light) or None -- where none is, the only one that is new in this frame
        """
        marker, parameters = self._markers[k], self._parameters
        spots = [
            (spot, light)
            for spot, light in spots
            if light is None or not is_taken(self._markers, spot, k, parameters.marker_diameter_px / 2)
        ]
        candidates = [
            Possible(
                spot.u,
                spot.v,
                light is None or not abs(light.contrast / contrast - 1) > parameters.brightness_tolerance,
            )
            for spot, light in spots
        ]
        index = marker.belief.update(marker.path, self.view(k, [u for u, _ in row.others], candidates, frame))
        lit = [pair for pair, candidate in zip(spots, candidates, strict=True) if candidate.is_lit]
        if index is not None:
            frame.spots[k], light = spots[index]
            marker.light = light or marker.light
            frame.reasons[k] = "ok"
            return None
        marker.is_foretold = False
        frame.spots.pop(k, None)
        frame.reasons[k] = "ambiguous" if lit else "brightness" if spots else "hidden"
        new = [
            (spot, light)
            for spot, light in lit
            if light is not None and marker.belief.is_new(spot.u, frame.number)
        ]
        return new[0] if len(new) == 1 else None

    def view(self, k: int, things: list[float], candidates: list[Possible], frame: Frame) -> View:
        """What a frame says of a marker."""
        marker, parameters, seen = self._markers[k], self._parameters, frame.seen
        is_lost = marker.is_followed and k not in seen and frame.number >= marker.lost_at
        across = 0.0 if marker.is_followed else None
        if is_lost:
            moves = [move for j, spot in seen.items() if math.isfinite(move := spot.v - marker.company.v[j])]
            across = median(moves) if moves else None
        left, right = beam_reach((spot.u for j, spot in seen.items() if j != k), parameters.max_bend_px)
        return View(
            frame.number,
            candidates,
            things,
            left,
            right,
            float(frame.image.shape[1]),
            marker.motion.v + (across or 0.0),
            (lambda u: math.inf) if across is None else (lambda u: self._row_reach(marker, u) / 3.0),
            parameters.row_gate_px,
            lambda n: self._jump(marker.motion, n),
            parameters.marker_diameter_px,
            self._stir(k, frame),
            lambda places: self._told(k, places, frame),
        )

    def _stir(self, k: int, frame: Frame) -> float:
        """How well a marker is foreseen at best where the others move [px]: none above the lowest rests meanwhile."""
        steps = [abs(spot.u - self._markers[j].motion.u) for j, spot in frame.seen.items() if j != k]
        return _TAKES_PART * max(steps, default=0.0) if k > 0 else 0.0

    def _told(self, k: int, places: tuple[Place, ...], frame: Frame) -> tuple[float, float] | None:
        """Where a marker that was at some places is now, by the model or by the others that are seen."""
        marker = self._markers[k]
        ways = [
            ((*(marker.company.ways[j] if marker.company.ways else ()), *self._markers[j].motion.way), spot.u)
            for j, spot in frame.seen.items()
            if j != k
        ]
        told = carried(places, ways, frame.number)
        if marker.foretold is not None and not (told and told[1] <= marker.foretold.doubt_px / 3.0):
            marker.is_foretold = True
            return marker.foretold.u_px, marker.foretold.doubt_px / 3.0
        return told

    def _jump(self, motion: MarkerMotion, n: int) -> float:
        """How far a marker comes in so many frames by itself, as it swung of late: five standard deviations [px]."""
        parameters = self._parameters
        swing = abs(motion.u - motion.centre) + motion.swing + parameters.marker_diameter_px
        grown = parameters.max_jump_px + (n - 1) * parameters.gate_growth_px
        return min(max(grown, swing), parameters.max_gate_px)

    def _follow_a_leap(self, found: dict[int, tuple[Spot, Light]], lost: list[int], frame: Frame) -> None:
        """Believe markers that were lost together where most of them went elsewhere together."""
        parameters = self._parameters
        width = frame.image.shape[1]
        room = Room(
            len(self._markers),
            width / 3.0,
            min(parameters.max_bend_px, width) / 3.0,
            parameters.max_jump_px / 3.0,
            max(parameters.row_gate_px, parameters.expected_row_tolerance_px) / 2.0,
            parameters.row_gate_px / 3.0,
        )

        def move(k: int, spot: Spot) -> Leap:
            return Leap(spot.u - self._markers[k].motion.u, spot.v - self._markers[k].motion.v)

        if not moved_together(
            {k: move(k, spot) for k, (spot, _) in found.items()},
            {k: move(k, spot) for k, spot in frame.seen.items()},
            room,
        ):
            return
        across = median(spot.v - self._markers[k].motion.v for k, (spot, _) in found.items())
        for k, (spot, light) in found.items():
            frame.spots[k], self._markers[k].light, frame.reasons[k] = spot, light, "ok"
            self._markers[k].belief.take(spot.u)
        for k in lost:
            # The camera was moved across the rows: those still hidden are elsewhere, too.
            if k not in frame.spots:
                self._markers[k].motion.v += across

    def _adapt(self, rows: dict[int, RowSpots], frame: Frame) -> bool:
        """Take a change that most markers share, as of the camera's focus, into what they look like.

        Returns
        -------
        bool -- False: there is none that lost markers show
        """
        changed = {k: row.changed[0] for k, row in rows.items() if len(row.changed) == 1 and not row.alike}
        if not changed:
            return False
        shown = {**frame.seen, **changed}
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

    def _is_clipped_anew(self, frame: Frame, k: int, row: RowSpots) -> bool:
        """True when the sensor cuts off a marker's light which it did not in the frame before, or the reverse.

        What is cut off is a disc of another area and rim, which its appearance in the old light says nothing about.
        """
        marker = self._markers[k]
        things = [*(u for u, _ in row.others), *(spot.u for spot, _ in row.alike)]
        if self.before is None or marker.lost_frames or not things:
            return False
        u = min(things, key=lambda thing: abs(thing - marker.motion.u))
        before = self._meter.is_clipped(self.before, marker.motion.u, marker.motion.v)
        return before != self._meter.is_clipped(frame.image, u, marker.motion.v)

    def _row_reach(self, marker: MarkerState, u: float) -> float:
        """How far from its row a marker is in a column, at most [px].

        A beam that bends lowers it with the square of its way, by what theory says or by what was seen.
        """
        swing = max(marker.motion.swing, 1.0)
        lowering = min(_LOWERING / self._span, (marker.motion.row_swing + _ROW_PX / 5) / swing**2)
        reach = (
            _ROW_PX + marker.motion.row_swing + _ROW_CREEP_PX[len(self._markers) == 1] * marker.lost_frames
        )
        return min(reach + lowering * (u - marker.motion.centre) ** 2, self._parameters.row_gate_px)

    def _contrasts(self, rows: dict[int, RowSpots], frame: Frame) -> dict[int, float]:
        """Contrast that each marker shows in this frame; of one that is lost, what its nearest like shows."""
        contrasts: dict[int, float] = {}
        for k, marker in enumerate(self._markers):
            if k in rows:
                nearest = min(rows[k].alike, key=lambda seen: abs(seen[0].u - marker.motion.u), default=None)
                if nearest is not None:
                    contrasts[k] = nearest[1].contrast
            elif k in frame.seen and marker.gates is not None:
                sides = self._meter.sides(frame.image, frame.spots[k])
                shown = abs(frame.spots[k].plateau - 0.5 * (sides.left + sides.right))
                contrasts[k] = shown / self._meter.lit_share(frame.spots[k], marker.gates)
        return contrasts

    def _expected_contrast(self, k: int, contrasts: dict[int, float]) -> float:
        """Contrast of a lost marker in the light that most markers have now, by what they had when it was last seen.

        One marker alone has changed with the light once that has lasted.
        """
        marker = self._markers[k]
        assert marker.light is not None
        own = marker.company.contrasts[k]
        gains = [contrast / marker.company.contrasts[other] for other, contrast in contrasts.items()]
        gains = [gain for gain in gains if _GAINS[0] <= gain <= _GAINS[1]]
        for gain in gains:
            tolerance = _EQUAL_LIGHT + _PLATEAU_NOISE * marker.light.noise / (gain * own)
            equal = [other for other in gains if abs(other / gain - 1) <= tolerance]
            if is_common(len(equal), len(self._markers)):
                return own * median(equal)
        if len(self._markers) == 1 and gains and marker.lost_frames >= _LASTING_FRAMES:
            return own * gains[0]
        return own
