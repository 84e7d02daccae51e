"""The markers of one beam, frame after frame: who is who, and when not to believe it.

Markers are *acquired* in the whole image (threshold, contours, gates on size and roundness) and named by
their order along the beam: marker 0 is the lowest in the image. A spot is a marker only if one disc explains it,
smeared by no more than it moves; while anything else that is new lies in its row, nothing is acquired, and a marker
of a few frames beside which something appears is acquired anew. From then on each is *followed* in a small region
about its prediction, where ``vision.tracking.spots`` measures it and compares it with itself.

A measurement that fails a gate is reported as not valid, with the reason, unless the marker is found in the same
frame: it is looked for from edge to edge of the row in which it was last seen, in whatever light all markers have
now, and is believed within a distance that grows with every frame, as its own and the other markers' motion allow.
Other spots of its kind in that row (rivals) are watched while the marker is still seen. Where the two met, or where
the one spot in view may be the rival, the marker stays lost until the rival has left: nothing is invented and
identities are never exchanged. Markers that were lost together are believed wherever they are
(``vision.tracking.jumps``).
"""

from __future__ import annotations

import math
from itertools import pairwise
from statistics import median
from typing import NamedTuple

import numpy as np

from beam_ros.arrays import ImageArray
from beam_ros.vision.errors import ImageFormatError, VisionParameterError
from beam_ros.vision.parameters import TrackerParameters
from beam_ros.vision.timing import FrameTiming
from beam_ros.vision.tracking.appearance import Appearance, Light
from beam_ros.vision.tracking.jumps import TOGETHER_FRAMES, is_common, moved_together
from beam_ros.vision.tracking.marker_state import LONELY_FRAMES, SAME_PLACE_PX, MarkerState
from beam_ros.vision.tracking.rivals import (
    FORGET_AFTER_FRAMES,
    Track,
    associated,
    continued,
    may_be,
    present,
    recent,
    recognised,
    unseen,
)
from beam_ros.vision.tracking.spot_search import RowSpots, one_disc, spots_in_row
from beam_ros.vision.tracking.spots import Reason, Spot, SpotMeter

_ACQUISITION_THRESHOLDS = (0.5, 0.3, 0.7)
"""Fractions of the image's strongest contrast at which spots are looked for."""
_PROBATION_FRAMES = 10
"""A marker acquired for the first time is doubted anew where something appears in its row within so many frames."""
_CHORES_EVERY_FRAMES = 8
"""Noise and levels are measured anew, and rivals looked for, once in so many frames."""
_ROW_GROWTH_PX = 0.1
"""A lost marker's row is looked for in a band that grows so much a frame [px]."""
_GAINS = 0.25, 4.0
"""Least and largest change of the light while a marker is lost."""
_STEPS = 3.0
"""A marker may have moved by so many of its usual steps with every frame since it was lost."""
_LEVERAGE = 2.5
"""A marker may have moved by so many times as much as the others."""
_LASTING_FRAMES = 2
"""The only marker of a beam has changed its brightness with the light where that lasts for so many frames."""
_MAJORITY = 3
"""So many sizes have one that most of them agree on."""
_SPEED_SLACK = 0.15
"""Relative uncertainty of a smear that follows from two frames."""
_SIGNIFICANT = 3.0
_EQUAL_SIZE = 0.1
"""Relative tolerance of the area of a marker against that of the others when it is acquired."""
_EQUAL_LIGHT = 0.15
"""Relative tolerance of a marker's change of brightness against that of the others."""
_PLATEAU_NOISE = 2.0
"""Three standard deviations of the difference of two plateaus, each the mean of five pixels, over that of a pixel."""


class MarkerMeasurement(NamedTuple):
    """One marker in one frame (a named tuple because four are made in every 100 microseconds).

    Attributes
    ----------
    u_px, v_px : float -- centre, integer coordinates at pixel centres [px]; NaN when not valid
    sigma_px : float -- standard deviation of u_px [px]; NaN when not valid
    is_valid : bool -- False: not seen, or seen and not believed
    reason : Reason -- "ok", or why not
    stamp_ns : int -- middle of the exposure of the marker's row [ns]
    contrast_grey : float -- slow average of the marker above its background [grey levels]
    area_px : float -- effective area of what was seen [px^2]; NaN when nothing was
    """

    u_px: float
    v_px: float
    sigma_px: float
    is_valid: bool
    reason: Reason
    stamp_ns: int
    contrast_grey: float
    area_px: float


class FrameResult(NamedTuple):
    """What the tracker saw in one frame.

    Attributes
    ----------
    stamp_ns : int -- stamp of the frame [ns]
    markers : tuple of MarkerMeasurement -- lowest marker first
    """

    stamp_ns: int
    markers: tuple[MarkerMeasurement, ...]

    @property
    def is_complete(self) -> bool:
        """True when every marker is valid."""
        return all(marker.is_valid for marker in self.markers)


class MarkerTracker:
    """Follows the markers of one beam.

    Parameters
    ----------
    parameters : TrackerParameters -- expectations and gates
    n_markers : int -- number of markers on the beam
    timing : FrameTiming or None -- gives every measurement the middle of its own row's exposure; None
        gives it the stamp of the frame
    """

    def __init__(
        self, parameters: TrackerParameters, n_markers: int, timing: FrameTiming | None = None
    ) -> None:
        if n_markers < 1:
            raise VisionParameterError(f"n_markers is {n_markers}; expected at least one marker")
        rows = parameters.expected_rows_px
        if rows is not None and len(rows) != n_markers:
            raise VisionParameterError(
                f"TrackerParameters.expected_rows_px has {len(rows)} rows; expected {n_markers}, one per "
                "marker: correct the rig file"
            )
        self.parameters = parameters
        self.n_markers = n_markers
        self.timing = timing
        self._meter = SpotMeter(parameters)
        self._markers: list[MarkerState] = []
        self._exposure_s = math.inf if timing is None else timing.camera.exposure_s
        self._before: ImageArray | None = None
        self._shape: tuple[int, int] | None = None
        self._frame = self._stamp_ns = self._elapsed_ns = 0
        self.reset()

    # -- state ---------------------------------------------------------------------------------------------

    def reset(self) -> None:
        """Forget every marker; the next frame starts with acquisition."""
        rows = self.parameters.expected_rows_px
        self._markers = [MarkerState(None if rows is None else rows[k]) for k in range(self.n_markers)]
        self._before = self._shape = None
        self._frame = 0

    def pass_over(self, n_frames: int) -> None:
        """Take note that so many frames are missing: the markers may be elsewhere, and are what they were."""
        self._frame += n_frames
        for k, marker in enumerate(self._markers):
            if marker.is_followed:
                self._note_loss(k)
                marker.lost_frames += n_frames

    @property
    def is_acquired(self) -> bool:
        """True when every marker is followed: found since the last reset, and not given up since."""
        return all(marker.is_followed for marker in self._markers)

    @property
    def noise_grey(self) -> tuple[float, ...]:
        """Measured noise of a pixel about each marker [grey levels]; NaN before acquisition."""
        return tuple(math.nan if marker.light is None else marker.light.noise for marker in self._markers)

    @property
    def lost_frames(self) -> tuple[int, ...]:
        """Frames in a row in which each marker was not valid."""
        return tuple(marker.lost_frames for marker in self._markers)

    # -- frames --------------------------------------------------------------------------------------------

    def process(self, image: ImageArray, stamp_ns: int) -> FrameResult:
        """Measure every marker in a frame.

        Parameters
        ----------
        image : ndarray, shape (height, width), uint8 or uint16 -- grey image
        stamp_ns : int -- stamp of the frame [ns]

        Returns
        -------
        FrameResult

        Raises
        ------
        ImageFormatError -- the image is not a two-dimensional uint8 or uint16 array
        """
        if image.ndim != 2 or (image.dtype != np.uint8 and image.dtype != np.uint16):
            raise ImageFormatError(
                f"image is {image.dtype} of shape {image.shape}; expected (height, width) of uint8 or "
                "uint16: convert it with grey_image()"
            )
        if self._shape != image.shape:
            if self._shape is not None:
                self.reset()
            self._shape = (int(image.shape[0]), int(image.shape[1]))
        self._frame += 1
        self._elapsed_ns, self._stamp_ns = stamp_ns - self._stamp_ns, stamp_ns
        reasons: dict[int, Reason] = {}
        if not self.is_acquired:
            reasons = self._acquire(image)
        spots: dict[int, Spot] = {}
        for k, marker in enumerate(self._markers):
            if k not in reasons and marker.lost_frames == 0:
                spot, reasons[k] = self._measure(image, marker)
                if spot is not None:
                    spots[k] = spot
        lost = [k for k, marker in enumerate(self._markers) if marker.is_followed and reasons.get(k) != "ok"]
        if lost:
            self._find(image, lost, spots, reasons)
        results = [self._result(image, k, spots.get(k), reasons[k], stamp_ns) for k in range(self.n_markers)]
        for k, (marker, result) in enumerate(zip(self._markers, results, strict=True)):
            marker.shown = math.nan
            if result.is_valid and marker.light is not None:
                marker.shown = abs(spots[k].plateau - marker.light.background)
        self._before = image
        return FrameResult(stamp_ns, tuple(results))

    def _stamp(self, stamp_ns: int, row: float) -> int:
        if self.timing is None or not math.isfinite(row):
            return stamp_ns
        return self.timing.row_middle(stamp_ns, row)

    def _invalid(self, marker: MarkerState, reason: Reason, stamp_ns: int, area: float) -> MarkerMeasurement:
        """Count a lost frame."""
        marker.lost_frames += 1
        row = marker.v if math.isfinite(marker.v) or marker.known_row is None else marker.known_row
        contrast = math.nan if marker.light is None else marker.light.contrast
        return MarkerMeasurement(
            math.nan, math.nan, math.nan, False, reason, self._stamp(stamp_ns, row), contrast, area
        )

    def _measure(self, image: ImageArray, marker: MarkerState) -> tuple[Spot | None, Reason]:
        """Measure a marker where it should be."""
        light, appearance, gates = marker.light, marker.appearance, marker.gates
        assert light is not None
        assert appearance is not None
        assert gates is not None
        moved = marker.velocity if marker.linear_error < marker.hold_error else 0.0
        predicted = marker.u + moved
        is_crowded = bool(marker.rivals) and self._is_crowded(marker, predicted)
        spot, reason = self._meter.measure(image, predicted, marker.v, light, is_narrow=is_crowded)
        if spot is not None:
            reason = self._meter.judge(spot, gates)
            if reason == "ok" and not self._is_own(spot.u, predicted, marker):
                reason = "ambiguous"
        if reason != "ok" and spot is not None and self._may_have_met(image, spot, marker, light, appearance):
            marker.is_mixed, marker.is_joined, marker.is_blind = True, not marker.rivals, False
            marker.rivals.append(Track(marker.u, 0.0, self._frame - 1))
        return spot, reason

    def _result(
        self, image: ImageArray, k: int, spot: Spot | None, reason: Reason, stamp_ns: int
    ) -> MarkerMeasurement:
        """State where a marker's spot is centred, and carry it into what is known of the marker."""
        marker, meter = self._markers[k], self._meter
        light, appearance = marker.light, marker.appearance
        if spot is None or reason != "ok" or light is None or appearance is None:
            return self._invalid(marker, reason, stamp_ns, math.nan if spot is None else spot.area)
        is_fresh = marker.lost_frames > 0 or marker.lost_at == self._frame
        is_new = self._frame - marker.acquired_at < _PROBATION_FRAMES
        is_due = (self._frame + k) % _CHORES_EVERY_FRAMES == 0
        is_accompanied = bool(recent(marker.rivals, self._frame))
        if is_due or is_fresh or is_new or is_accompanied:
            row = self._in_row(image, k, own=spot.u)
            if is_new and self._has_company(marker, row):
                marker.forget()
                marker.rivals = [
                    Track(u, 0.0, self._frame) for u in (spot.u, *(other.u for other, _ in row.alike))
                ]
                return self._invalid(marker, "ambiguous", stamp_ns, spot.area)
            others = [other for other, _ in row.alike]
            marker.rivals = continued(marker.rivals, others, self._frame, self.parameters.max_gate_px)
        refined = meter.centre if self.parameters.refinement == "none" else meter.refine
        centre = refined(image, spot, light, appearance)
        if isinstance(centre, str):
            self._note_loss(k)
            return self._invalid(marker, centre, stamp_ns, spot.area)
        marker.remember(spot.u, spot.v, is_fresh=is_fresh)
        appearance.row = spot.v
        if not appearance.is_settled:
            meter.settle(spot, light, appearance)
        if is_due and not is_accompanied:
            light.absorb(spot.plateau, *meter.sides(image, spot))
        if is_due or is_fresh or not appearance.is_settled:
            marker.gates = meter.gates(light, appearance)
        return MarkerMeasurement(
            *centre, True, "ok", self._stamp(stamp_ns, spot.v), light.contrast, spot.area
        )

    def _is_own(self, u: float, predicted: float, marker: MarkerState) -> bool:
        """True when a spot at u is near the prediction, and nearer to it than to any rival's."""
        distance = abs(u - predicted)
        if distance > self.parameters.max_jump_px:
            return False
        rivals = recent(marker.rivals, self._frame)
        return all(2 * distance < abs(u - rival.predicted(self._frame)) for rival in rivals)

    def _may_have_met(
        self, image: ImageArray, spot: Spot, marker: MarkerState, light: Light, appearance: Appearance
    ) -> bool:
        """True when a spot that failed its gates may be the marker and a rival in one."""
        near = 2 * self.parameters.marker_diameter_px
        rivals = recent(marker.rivals, self._frame)
        return (spot.area > 1.1 * appearance.area and self._meter.is_compact(image, spot, light)) or any(
            abs(rival.predicted(self._frame) - marker.u) < near for rival in rivals
        )

    def _is_crowded(self, marker: MarkerState, u: float) -> bool:
        """True when a rival may reach into the region about u."""
        near = self._meter.half + self._meter.radius + 4
        rivals = recent(marker.rivals, self._frame)
        return any(abs(rival.predicted(self._frame) - u) < near for rival in rivals)

    def _is_taken(self, spot: Spot, k: int) -> bool:
        """True when another marker is followed on this very spot."""
        near = self.parameters.marker_diameter_px / 2
        return any(
            j != k
            and other.is_followed
            and other.lost_frames == 0
            and abs(other.u - spot.u) < near
            and abs(other.v - spot.v) < near
            for j, other in enumerate(self._markers)
        )

    # -- looking for lost markers --------------------------------------------------------------------------

    def _in_row(self, image: ImageArray, k: int, *, own: float = math.nan, is_wide: bool = False) -> RowSpots:
        """Spots with a marker's appearance in its row from edge to edge, each in its own light.

        A wide row is one to which the camera may have moved, though not one where another marker belongs.
        """
        marker, reach = self._markers[k], self.parameters.row_gate_px
        assert marker.light is not None
        assert marker.appearance is not None
        if is_wide:
            reach = max(reach, self.parameters.expected_row_tolerance_px)
            for j, other in enumerate(self._markers):
                if j != k and math.isfinite(other.v):
                    reach = min(reach, abs(other.v - marker.v) / 2)
        return spots_in_row(self._meter, image, marker.v, reach, marker.light, marker.appearance, own)

    def _note_loss(self, k: int) -> None:
        """Note where a marker was last seen, and what was beside it in that frame."""
        marker = self._markers[k]
        if marker.lost_frames > 0:
            return
        marker.lost_at, marker.lost_u = self._frame, marker.u
        marker.company_u = tuple(other.u for other in self._markers)
        marker.company_contrast = tuple(other.shown for other in self._markers)
        if self._before is not None:
            beside = [spot for spot, _ in self._in_row(self._before, k, own=marker.u).alike]
            marker.rivals = continued(marker.rivals, beside, self._frame - 1, self.parameters.max_gate_px)
        # Where it met one there are two tracks of it, and that is no company.
        marker.is_doubtful = len(marker.rivals) > marker.is_mixed

    def _find(
        self, image: ImageArray, lost: list[int], spots: dict[int, Spot], reasons: dict[int, Reason]
    ) -> None:
        """Look for markers that are not where they should be; fills in what is found."""
        markers, parameters = self._markers, self.parameters
        for k in lost:
            self._note_loss(k)
        rows = {k: self._in_row(image, k, is_wide=True) for k in lost}
        contrasts = self._contrasts(image, rows, spots, reasons)
        elsewhere: dict[int, tuple[Spot, Light]] = {}
        for k, row in rows.items():
            marker = markers[k]
            failed, expected = reasons.get(k, "hidden"), self._expected_contrast(k, contrasts)
            lit = [
                (spot, light)
                for spot, light in row.alike
                if abs(light.contrast / expected - 1) <= parameters.brightness_tolerance
                and not self._is_taken(spot, k)
            ]
            spots.pop(k, None)
            marker.alone_frames = marker.alone_frames + 1 if len(lit) == 1 else 0
            marker.is_doubtful |= len(lit) > 1
            farthest = self._farthest(marker, spots, reasons)
            # What lies nearer to where it was may be the marker, covered in part or beside a twin.
            unlike = [u for u, _ in row.others] + [spot.u for spot, _ in row.alike if spot not in dict(lit)]
            nearest_unlike = min((abs(u - marker.u) for u in unlike), default=math.inf)
            farthest = min(farthest, nearest_unlike + SAME_PLACE_PX)
            if marker.is_joined and self._meter.is_dim(image, marker.u, marker.v, expected):
                marker.is_blind = True
            chosen = self._choose(marker, lit, farthest, nearest_unlike)
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
        moved = moved_together(
            {k: (spot.u - markers[k].lost_u, spot.v - markers[k].v) for k, (spot, _) in elsewhere.items()},
            {
                k: (spot.u - (markers[k].lost_u if k in lost else markers[k].u), spot.v - markers[k].v)
                for k, spot in spots.items()
            },
            self.n_markers,
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
                markers[k].v += across if k not in spots else 0.0

    def _farthest(self, marker: MarkerState, spots: dict[int, Spot], reasons: dict[int, Reason]) -> float:
        """How far a lost marker may be by the motion of those that are seen and its own of late [px]."""
        moves = [
            abs(spot.u - marker.company_u[k])
            for k, spot in spots.items()
            if reasons[k] == "ok" and math.isfinite(marker.company_u[k])
        ]
        if not moves:
            return math.inf
        own = _STEPS * marker.hold_error * (marker.lost_frames + 1)
        return self.parameters.marker_diameter_px + own + _LEVERAGE * max(moves)

    def _choose(
        self, marker: MarkerState, lit: list[tuple[Spot, Light]], farthest: float, nearest_unlike: float
    ) -> tuple[Spot, Light] | None:
        """Choose the spot that is a lost marker, within a distance that grows with every frame.

        One that met a rival is what remains once all else has left that might be either, covered in part or touched.
        """
        parameters = self.parameters
        gate = min(
            max(
                parameters.max_jump_px + marker.lost_frames * parameters.gate_growth_px,
                abs(marker.u - marker.centre) + marker.swing + parameters.marker_diameter_px,
            ),
            parameters.max_gate_px,
            farthest,
        )
        reach = parameters.max_gate_px + 3 * parameters.marker_diameter_px
        across = parameters.row_gate_px + _ROW_GROWTH_PX * marker.lost_frames
        if marker.lost_frames > FORGET_AFTER_FRAMES and marker.alone_frames >= LONELY_FRAMES:
            gate = reach = across = math.inf
        light_of = {
            spot: light
            for spot, light in lit
            if abs(spot.u - marker.u) <= reach and abs(spot.v - marker.v) <= across
        }
        spots = list(light_of)
        hidden = [] if marker.is_mixed else unseen(marker.rivals, self._frame)
        tracks, free = associated(
            [track for track in marker.rivals if track not in hidden],
            spots,
            self._frame,
            gate if marker.is_mixed else parameters.max_jump_px,
        )
        near = [spot for spot in free if abs(spot.u - marker.u) <= gate]
        returned, free = recognised(hidden, free, near, self._frame, gate)
        tracks += returned
        near = [spot for spot in near if spot in free]
        doubtful = [spot for spot in near if may_be(returned, spot, self._frame, gate)]
        chosen = near[0] if len(near) == 1 and not doubtful and not marker.is_mixed else None
        tracks += [
            Track(spot.u, 0.0, self._frame) for spot in free if spot is not chosen and spot not in doubtful
        ]
        marker.rivals = present(
            tracks, self._frame, marker.u - reach, marker.u + reach, parameters.max_jump_px
        )
        if marker.is_mixed:
            if (
                len(spots) == len(marker.rivals) == 1
                and abs(spots[0].u - marker.u) <= parameters.max_gate_px < nearest_unlike
                and not marker.is_blind
            ):
                marker.rivals, chosen = [], spots[0]
            # Two that vanish as one may come back one by one.
            if len(marker.rivals) > 1:
                marker.is_joined = marker.is_blind = False
        else:
            marker.is_mixed = len(near) > 1
            marker.is_joined = marker.is_blind = False
        return None if chosen is None else (chosen, light_of[chosen])

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
            elif k in spots and reasons[k] == "ok":
                sides = self._meter.sides(image, spots[k])
                contrasts[k] = abs(spots[k].plateau - 0.5 * (sides.left + sides.right))
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
            if is_common(len(equal), self.n_markers):
                return own * median(equal)
        if self.n_markers == 1 and gains and marker.lost_frames >= _LASTING_FRAMES:
            return own * gains[0]
        return own

    def _is_common_loss(self, k: int) -> bool:
        """True when most of the markers were lost at about the same time as this one."""
        at = self._markers[k].lost_at
        return is_common(
            sum(abs(other.lost_at - at) <= TOGETHER_FRAMES for other in self._markers), self.n_markers
        )

    # -- acquisition ---------------------------------------------------------------------------------------

    def _acquire(self, image: ImageArray) -> dict[int, Reason]:
        """Find the markers that are not followed; returns the reasons for those that still are not."""
        missing = [k for k, marker in enumerate(self._markers) if not marker.is_followed]
        background, extreme = self._meter.levels(image)
        contrast = abs(extreme - background)
        if contrast < self.parameters.min_contrast_grey:
            return dict.fromkeys(missing, "no_contrast")
        found: list[tuple[Spot, Light]] = []
        others: list[tuple[float, float]] = []
        for fraction in _ACQUISITION_THRESHOLDS:
            for u, v, is_crowded in self._meter.centres(image, background, fraction * contrast):
                candidate = self._meter.candidate(image, u, v, background, is_narrow=is_crowded)
                if candidate is None:
                    others.append((u, v))
                elif all(math.dist(candidate[0][:2], spot[:2]) > self._meter.radius / 2 for spot, _ in found):
                    found.append(candidate)
        if all(self._markers[k].known_row is None for k in missing):
            chosen, reasons = self._in_order(missing, found, others)
        else:
            chosen, reasons = self._in_rows(missing, found, others)
        for k, reason in self._unequal(chosen).items():
            del chosen[k]
            reasons[k] = reason
        for k, candidate in chosen.items():
            self._introduce(self._markers[k], *candidate)
        return reasons

    def _in_order(
        self, missing: list[int], found: list[tuple[Spot, Light]], others: list[tuple[float, float]]
    ) -> tuple[dict[int, tuple[Spot, Light]], dict[int, Reason]]:
        """Name spots by their order along the beam, where no rows are known."""
        found = sorted(found, key=lambda candidate: -candidate[0].v)
        if len(found) < len(missing):
            return {}, dict.fromkeys(missing, "not_acquired")
        gaps = [lower[0].v - upper[0].v for lower, upper in pairwise(found)]
        if len(found) > len(missing) or any(gap < self.parameters.marker_diameter_px for gap in gaps):
            return {}, dict.fromkeys(missing, "ambiguous")
        chosen: dict[int, tuple[Spot, Light]] = {}
        reasons: dict[int, Reason] = {}
        for k, candidate in zip(missing, found, strict=True):
            reason = self._doubt(self._markers[k], *candidate, others)
            if reason == "ok":
                chosen[k] = candidate
            else:
                reasons[k] = reason
        # One that is doubtful may not be a marker at all, and the others' names depend on it.
        return (chosen, reasons) if not reasons else ({}, {**dict.fromkeys(missing, "ambiguous"), **reasons})

    def _in_rows(
        self, missing: list[int], found: list[tuple[Spot, Light]], others: list[tuple[float, float]]
    ) -> tuple[dict[int, tuple[Spot, Light]], dict[int, Reason]]:
        """Name spots by the rows in which the markers are known to lie."""
        chosen: dict[int, tuple[Spot, Light]] = {}
        reasons: dict[int, Reason] = {}
        tolerance = self.parameters.expected_row_tolerance_px
        at = [marker.u for marker in self._markers if marker.is_followed and marker.lost_frames == 0]

        def is_near(u: float, v: float, row: float) -> bool:
            reach = self.parameters.max_bend_px
            return abs(v - row) <= tolerance and all(abs(u - other) <= reach for other in at)

        for k in missing:
            marker = self._markers[k]
            row = marker.known_row
            if row is None:
                reasons[k] = "not_acquired"
                continue
            near = [
                candidate
                for candidate in found
                if is_near(candidate[0].u, candidate[0].v, row) and not self._is_taken(candidate[0], k)
            ]
            self._follow_company(marker, [spot for spot, _ in near], at)
            if len(near) == 1 and not marker.rivals:
                beside = [other for other in others if is_near(*other, row)]
                reasons[k] = self._doubt(marker, *near[0], beside)
                if reasons[k] == "ok":
                    chosen[k] = near[0]
                    del reasons[k]
            else:
                reasons[k] = "ambiguous" if near else "not_acquired"
                marker.sighting = None
        return chosen, reasons

    def _follow_company(self, marker: MarkerState, spots: list[Spot], at: list[float]) -> None:
        """Follow all spots of a marker's kind in its row, until one is left because the others have gone out of it.

        One that disappears within the row may be the marker, covered.
        """
        parameters, frame = self.parameters, self._frame
        if len(spots) < 2 and not marker.rivals:
            return
        tracks, free = associated(marker.rivals, spots, frame, parameters.max_jump_px)
        assert self._shape is not None
        left = max([0.0, *(u - parameters.max_bend_px for u in at)])
        right = min([float(self._shape[1]), *(u + parameters.max_bend_px for u in at)])
        tracks += [Track(spot.u, 0.0, frame) for spot in free]
        marker.rivals = present(tracks, frame, left, right, parameters.max_jump_px)
        if len(marker.rivals) == 1:
            marker.rivals = []

    def _doubt(
        self, marker: MarkerState, spot: Spot, light: Light, others: list[tuple[float, float]]
    ) -> Reason:
        """Name what makes a spot doubtful that is alone of its kind in a marker's row; "ok" where nothing does."""
        disc, before = one_disc(spot, light, self.parameters), marker.sighting
        marker.sighting = self._frame, spot.u, disc.excess
        beside = [u for u, v in others if math.dist((u, v), spot[:2]) > SAME_PLACE_PX]
        things = beside if disc.reason == "ok" else [*beside, spot.u]
        marker.note_clutter(things, self._frame)
        if disc.reason != "ok":
            return disc.reason
        # Anything else may be the marker, smeared, joined with a twin or covered in part.
        if any(
            thing.is_new(self._frame)
            and (thing.last == self._frame or abs(thing.u - spot.u) > self.parameters.marker_diameter_px)
            for thing in marker.clutter
        ):
            return "ambiguous"
        if disc.excess <= disc.tolerance:
            return "ok"
        if before is None or before[0] != self._frame - 1:
            return "smear"
        # Mean speed over the two exposures' middles; the exposure is a part of the time in between.
        share = min(1.0, self._exposure_s * 1e9 / self._elapsed_ns) if self._elapsed_ns > 0 else 1.0
        explained = (share * (spot.u - before[1])) ** 2 / 12
        lengths = math.sqrt(max(disc.excess, 0.0)), math.sqrt(max(before[2], 0.0))
        slack = disc.tolerance + _SPEED_SLACK * explained + (lengths[0] - lengths[1]) ** 2 / 4
        return "ok" if (disc.excess + before[2]) / 2 - explained <= slack else "smear"

    def _unequal(self, chosen: dict[int, tuple[Spot, Light]]) -> dict[int, Reason]:
        """Markers of another size than most of them: a twin that touches, or a part that is hidden."""
        areas = {
            k: marker.appearance.area
            for k, marker in enumerate(self._markers)
            if marker.appearance is not None
        }
        areas |= {k: self._meter.appearance(*candidate).area for k, candidate in chosen.items()}
        if len(areas) < _MAJORITY:
            return {}
        usual = median(areas.values())
        reasons: dict[int, Reason] = {}
        for k, (_, light) in chosen.items():
            noise = _SIGNIFICANT * light.noise / (light.contrast * math.sqrt(usual))
            if abs(areas[k] / usual - 1) > _EQUAL_SIZE + noise:
                reasons[k] = "area"
        return reasons

    def _has_company(self, marker: MarkerState, row: RowSpots) -> bool:
        """True when a row shows something that was not there when its marker was acquired."""
        return any(
            abs(u - marker.u) <= self.parameters.max_gate_px
            and all(abs(u - thing.u) > SAME_PLACE_PX for thing in marker.clutter)
            for u in [*(spot.u for spot, _ in row.alike), *(u for u, _ in row.others)]
        )

    def _introduce(self, marker: MarkerState, spot: Spot, light: Light) -> None:
        """Start to follow a spot as this marker."""
        marker.light = light
        marker.appearance = self._meter.appearance(spot, light)
        marker.gates = self._meter.gates(light, marker.appearance)
        marker.acquired_at, marker.shown = self._frame, light.contrast
        marker.place(spot.u, spot.v)
