"""The markers of one beam, frame after frame: who is who, and when not to believe it.

Markers are *acquired* in the whole image (threshold, contours, gates on size and roundness) and named by
their order along the beam: marker 0 is the lowest in the image. From then on each is *followed* in a small
region about its prediction, where ``vision.tracking.spots`` measures it and compares it with itself.

A measurement that fails a gate is reported as not valid, with the reason, in the same frame. The marker is
then looked for in its own row, within a distance from where it was last seen that grows with every frame.
Other spots of its kind in that row (rivals) are watched while the marker is still seen. Where the two met,
or where the one spot in view may be the rival, the marker stays lost until the rival has left: nothing is
invented and identities are never exchanged. Markers that were lost together are looked for from edge to edge of
their rows at once (``vision.tracking.jumps``).
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from beam_ros.arrays import ImageArray
from beam_ros.vision.errors import ImageFormatError, VisionParameterError
from beam_ros.vision.parameters import TrackerParameters
from beam_ros.vision.timing import FrameTiming
from beam_ros.vision.tracking.appearance import Appearance, Light
from beam_ros.vision.tracking.jumps import TOGETHER_FRAMES, Move, is_common, moved_together
from beam_ros.vision.tracking.marker_state import MarkerState
from beam_ros.vision.tracking.rivals import FORGET_AFTER_FRAMES, Track, associated, continued, present
from beam_ros.vision.tracking.spot_search import alike_spots
from beam_ros.vision.tracking.spots import Reason, Spot, SpotMeter

_ACQUISITION_THRESHOLDS = (0.5, 0.3, 0.7)
"""Fractions of the image's strongest contrast at which spots are looked for."""
_LONELY_FRAMES = 25
"""A marker given up must be the only spot of its kind in its row for so many frames to be followed again."""
_CHORES_EVERY_FRAMES = 8
"""Noise and levels are measured anew, and rivals looked for, once in so many frames."""
_COMPANY_EVERY_FRAMES = 64
"""Whether a marker is alone in its whole row is looked at once in so many frames, a multiple of the above."""


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
        self._shape: tuple[int, int] | None = None
        self._frame = 0
        self._are_all_lost = False
        self.reset()

    # -- state ---------------------------------------------------------------------------------------------

    def reset(self) -> None:
        """Forget every marker; the next frame starts with acquisition."""
        rows = self.parameters.expected_rows_px
        self._markers = [MarkerState(None if rows is None else rows[k]) for k in range(self.n_markers)]
        self._shape = None
        self._frame = 0
        self._are_all_lost = False

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
        missing: dict[int, Reason] = {}
        if not self.is_acquired:
            missing = self._acquire(image)
        measurements = []
        for k, marker in enumerate(self._markers):
            if missing and k in missing:
                measurements.append(self._invalid(marker, missing[k], stamp_ns, math.nan))
            else:
                measurements.append(self._follow(image, marker, stamp_ns, k))
        lost = [k for k, measurement in enumerate(measurements) if not measurement.is_valid]
        if lost or self._are_all_lost:
            for k in self._rejoin(image, lost):
                measurements[k] = self._follow(image, self._markers[k], stamp_ns, k)
        return FrameResult(stamp_ns, tuple(measurements))

    def _stamp(self, stamp_ns: int, row: float) -> int:
        if self.timing is None or not math.isfinite(row):
            return stamp_ns
        return self.timing.row_middle(stamp_ns, row)

    def _invalid(self, marker: MarkerState, reason: Reason, stamp_ns: int, area: float) -> MarkerMeasurement:
        """Count a lost frame; after many, give the marker's place up."""
        if marker.lost_frames == 0:
            marker.note_loss(self._frame)
        marker.lost_frames += 1
        if marker.is_followed and marker.lost_frames > FORGET_AFTER_FRAMES:
            marker.is_followed = False
            marker.lonely_since = self._frame
        row = marker.v if math.isfinite(marker.v) or marker.known_row is None else marker.known_row
        contrast = math.nan if marker.light is None else marker.light.contrast
        return MarkerMeasurement(
            math.nan, math.nan, math.nan, False, reason, self._stamp(stamp_ns, row), contrast, area
        )

    def _follow(self, image: ImageArray, marker: MarkerState, stamp_ns: int, k: int) -> MarkerMeasurement:
        """Measure a marker where it should be, or look around for it."""
        light, appearance, gates = marker.light, marker.appearance, marker.gates
        meter, parameters = self._meter, self.parameters
        assert light is not None
        assert appearance is not None
        assert gates is not None
        is_fresh = marker.lost_frames > 0
        spot: Spot | None = None
        reason: Reason = "hidden"
        if not is_fresh:
            moved = marker.velocity if marker.linear_error < marker.hold_error else 0.0
            predicted = marker.u + moved
            is_crowded = bool(marker.rivals) and self._is_crowded(marker, predicted)
            spot, reason = meter.measure(image, predicted, marker.v, light, is_narrow=is_crowded)
            if spot is not None:
                reason = meter.judge(spot, gates)
                if reason == "ok" and not self._is_own(spot.u, predicted, marker):
                    reason = "ambiguous"
            if reason != "ok":
                marker.note_loss(self._frame)
                if spot is not None and self._may_have_met(spot, marker, appearance):
                    marker.is_mixed = True
                    marker.rivals.append(Track(marker.u, 0.0, self._frame - 1))
        if spot is None:
            spot, reason = self._search(image, marker, light, appearance)
            if reason == "ok" and spot is not None and self._is_taken(spot, k):
                reason = "ambiguous"
        if spot is None or reason != "ok":
            return self._invalid(marker, reason, stamp_ns, math.nan if spot is None else spot.area)
        if parameters.refinement == "none":
            centre = meter.centre(image, spot, light, appearance)
        else:
            centre = meter.refine(image, spot, light, appearance)
        if centre is None:
            return self._invalid(marker, "border", stamp_ns, spot.area)
        if is_fresh or marker.lost_at == self._frame:
            marker.moved = spot.u - marker.lost_u
        marker.remember(spot.u, spot.v)
        if not appearance.is_settled:
            meter.settle(spot, light, appearance)
            marker.gates = meter.gates(light, appearance)
        is_due = (self._frame + k) % _CHORES_EVERY_FRAMES == 0
        if is_due or is_fresh or marker.rivals:
            others = self._spots(image, marker, light, appearance, own=spot.u)[0]
            if others or marker.rivals:
                marker.rivals = continued(marker.rivals, others, self._frame, parameters.max_gate_px)
        if (self._frame + k) % _COMPANY_EVERY_FRAMES == 0:
            marker.is_accompanied = bool(self._in_whole_row(image, k, own=spot.u))
        if is_due and not marker.rivals:
            self._adapt(image, marker, light, appearance, spot)
        return MarkerMeasurement(
            *centre,
            True,
            "ok",
            self._stamp(stamp_ns, spot.v),
            light.contrast,
            spot.area,
        )

    def _is_own(self, u: float, predicted: float, marker: MarkerState) -> bool:
        """True when a spot at u is near the prediction, and nearer to it than to any rival's."""
        distance = abs(u - predicted)
        if distance > self.parameters.max_jump_px:
            return False
        if not marker.rivals:
            return True
        return all(2 * distance < abs(u - rival.predicted(self._frame)) for rival in marker.rivals)

    def _may_have_met(self, spot: Spot, marker: MarkerState, appearance: Appearance) -> bool:
        """True when a spot that failed its gates may be the marker and a rival in one."""
        near = 2 * self.parameters.marker_diameter_px
        return spot.area > 1.1 * appearance.area or any(
            abs(rival.predicted(self._frame) - marker.u) < near for rival in marker.rivals
        )

    def _is_crowded(self, marker: MarkerState, u: float) -> bool:
        """True when a rival may reach into the region about u."""
        near = self._meter.half + self._meter.radius + 4
        return any(abs(rival.predicted(self._frame) - u) < near for rival in marker.rivals)

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

    def _adapt(
        self, image: ImageArray, marker: MarkerState, light: Light, appearance: Appearance, spot: Spot
    ) -> None:
        """Measure what changes slowly: light, noise, and what follows from them."""
        meter = self._meter
        light.absorb(spot.plateau, *meter.sides(image, spot))
        marker.gates = meter.gates(light, appearance)

    # -- looking for a lost marker -------------------------------------------------------------------------

    def _spots(
        self,
        image: ImageArray,
        marker: MarkerState,
        light: Light,
        appearance: Appearance,
        own: float = math.nan,
    ) -> tuple[list[Spot], Reason, float, float]:
        """Spots with a marker's appearance in its row about where it was last seen, each in its own light.

        Parameters
        ----------
        own : float -- column of the spot that is the marker itself and is left out [px]; NaN for none

        Returns
        -------
        spots : list of Spot
        reason : Reason -- why the spot nearest to the marker is none of them; "hidden" where there is none
        left, right : float -- columns between which a whole spot would have been found [px]
        """
        parameters, meter = self.parameters, self._meter
        radius = meter.radius
        reach = parameters.max_gate_px + 6 * radius + meter.half
        height, width = image.shape
        left = max(0, math.floor(marker.u - reach))
        right = min(width, math.ceil(marker.u + reach) + 1)
        top = max(0, math.floor(appearance.row - parameters.row_gate_px) - meter.half)
        bottom = min(height, math.ceil(appearance.row + parameters.row_gate_px) + meter.half + 1)
        reason: Reason = "hidden"
        nearest = math.inf
        alike, others = alike_spots(meter, image, (left, top, right, bottom), light, appearance, own)
        for u, why in others:
            if why != "jump" and abs(u - marker.u) < nearest:
                nearest, reason = abs(u - marker.u), why
        return [spot for spot, _ in alike], reason, left + meter.half, right - meter.half

    def _search(
        self, image: ImageArray, marker: MarkerState, light: Light, appearance: Appearance
    ) -> tuple[Spot | None, Reason]:
        """Look for a marker that is not where it should be."""
        parameters = self.parameters
        gate = min(
            max(
                parameters.max_jump_px + marker.lost_frames * parameters.gate_growth_px,
                abs(marker.u - marker.centre) + marker.swing + parameters.marker_diameter_px,
            ),
            parameters.max_gate_px,
        )
        spots, reason, left, right = self._spots(image, marker, light, appearance)
        tracks, free = associated(
            marker.rivals, spots, self._frame, gate if marker.is_mixed else parameters.max_jump_px
        )
        near = [spot for spot in free if abs(spot.u - marker.u) <= gate]
        if not marker.is_mixed and len(near) == 1:
            free.remove(near[0])
        tracks += [Track(spot.u, 0.0, self._frame) for spot in free]
        marker.rivals = present(tracks, self._frame, left, right, parameters.max_jump_px)
        if not marker.is_mixed:
            if len(near) == 1:
                return near[0], "ok"
            marker.is_mixed = len(near) > 1
        elif (
            len(spots) == 1
            and len(marker.rivals) == 1
            and abs(spots[0].u - marker.u) <= parameters.max_gate_px
        ):
            # Whatever else was here has left by the edge: what remains is the marker.
            marker.rivals = []
            return spots[0], "ok"
        return None, "ambiguous" if spots else reason

    # -- markers that have jumped --------------------------------------------------------------------------

    def _in_whole_row(self, image: ImageArray, k: int, own: float = math.nan) -> list[tuple[Spot, Light]]:
        """Spots with a marker's appearance in its row from edge to edge, the row as wide as it may have moved."""
        marker, parameters, meter = self._markers[k], self.parameters, self._meter
        light, appearance = marker.light, marker.appearance
        assert light is not None
        assert appearance is not None
        row, expected = appearance.row, parameters.expected_rows_px
        reach = parameters.expected_row_tolerance_px
        centre = row if expected is None else expected[k]
        for j, other in enumerate(self._markers):
            if j != k and other.appearance is not None:
                reach = min(reach, abs(other.appearance.row - row) / 2)
        low = min(centre - reach, row - parameters.row_gate_px)
        high = max(centre + reach, row + parameters.row_gate_px)
        height, width = image.shape
        window = 0, max(0, math.floor(low) - meter.half), width, min(height, math.ceil(high) + meter.half + 1)
        return alike_spots(meter, image, window, light, appearance, own, (low, high))[0]

    def _rejoin(self, image: ImageArray, lost: list[int]) -> list[int]:
        """Follow markers that were lost together where they have jumped to, once two frames show them there."""
        markers = self._markers
        if len(lost) < self.n_markers:
            self._are_all_lost = False
        elif not self._are_all_lost:
            self._are_all_lost = True
            latest = max(marker.lost_at for marker in markers)
            for marker in markers:
                # What one marker met before the others were lost is no part of the jump.
                if marker.lost_at < latest - TOGETHER_FRAMES and (marker.is_mixed or marker.rivals):
                    marker.is_doubtful = True
        found: dict[int, tuple[Spot, Light]] = {}
        for k in lost:
            marker = markers[k]
            together = sum(abs(other.lost_at - marker.lost_at) <= TOGETHER_FRAMES for other in markers)
            if marker.appearance is None or not (
                is_common(together, self.n_markers) or (self._are_all_lost and self.n_markers > 1)
            ):
                continue
            spots = self._in_whole_row(image, k)
            if len(spots) > 1:
                marker.is_doubtful = True
            if len(spots) != 1 or marker.is_doubtful or self._is_taken(spots[0][0], k):
                continue
            spot, before = spots[0][0], marker.sighting
            marker.sighting = self._frame, spot.u
            if (
                before is not None
                and before[0] == self._frame - 1
                and abs(spot.u - before[1]) <= self.parameters.max_jump_px
            ):
                found[k] = spots[0]
        rejoined = moved_together(
            {k: self._move(markers[k], spot.u - markers[k].lost_u, spot.v) for k, (spot, _) in found.items()},
            {k: self._move(m, m.moved, m.v) for k, m in enumerate(markers) if m.lost_frames == 0},
            self.n_markers,
            max_difference=self.parameters.max_jump_px,
            max_row_difference=self.parameters.row_gate_px,
        )
        self._move_rows([self._move(markers[k], 0.0, found[k][0].v).across for k in rejoined])
        for k in rejoined:
            markers[k].moved = found[k][0].u - markers[k].lost_u
            self._introduce(image, markers[k], *found[k])
        return rejoined

    def _move(self, marker: MarkerState, along: float, v: float) -> Move:
        """Move of a marker by so much along u, to a row v."""
        return Move(marker.lost_at, along, 0.0 if marker.appearance is None else v - marker.appearance.row)

    def _move_rows(self, across: list[float]) -> None:
        """Follow a camera that was moved across the rows."""
        if not across or max(abs(move) for move in across) <= self.parameters.row_gate_px:
            return
        move = sum(across) / len(across)
        for marker in self._markers:
            if marker.appearance is not None and marker.light is not None:
                marker.appearance.row += move
                marker.known_row = marker.appearance.row
                marker.gates = self._meter.gates(marker.light, marker.appearance)

    # -- acquisition ---------------------------------------------------------------------------------------

    def _acquire(self, image: ImageArray) -> dict[int, Reason]:
        """Find the markers that are not followed; returns the reasons for those that still are not."""
        missing = [k for k, marker in enumerate(self._markers) if not marker.is_followed]
        background, extreme = self._meter.levels(image)
        contrast = abs(extreme - background)
        if contrast < self.parameters.min_contrast_grey:
            return dict.fromkeys(missing, "no_contrast")
        reasons: dict[int, Reason] = {}
        found: list[tuple[Spot, Light]] = []
        near = self._meter.radius / 2
        for fraction in _ACQUISITION_THRESHOLDS:
            for u, v, is_crowded in self._meter.centres(image, background, fraction * contrast):
                candidate = self._meter.candidate(image, u, v, background, is_narrow=is_crowded)
                if candidate is not None and all(
                    abs(candidate[0].u - spot.u) > near or abs(candidate[0].v - spot.v) > near
                    for spot, _ in found
                ):
                    found.append(candidate)
            reasons = self._name(image, missing, found)
            if not reasons:
                break
            missing = list(reasons)
        for k, reason in reasons.items():
            if reason == "not_acquired":
                self._markers[k].lonely_since = self._frame
        return reasons

    def _name(
        self, image: ImageArray, missing: list[int], found: list[tuple[Spot, Light]]
    ) -> dict[int, Reason]:
        """Name spots by their order along the beam, or by their rows where these are known."""
        if all(self._markers[k].known_row is None for k in missing):
            if len(found) != len(missing):
                return dict.fromkeys(missing, "ambiguous" if len(found) > len(missing) else "not_acquired")
            found = sorted(found, key=lambda candidate: -candidate[0].v)
            rows = [spot.v for spot, _ in found]
            if any(lower - upper < self.parameters.marker_diameter_px for lower, upper in pairwise(rows)):
                return dict.fromkeys(missing, "ambiguous")
            for k, (spot, light) in zip(missing, found, strict=True):
                self._introduce(image, self._markers[k], spot, light)
            return {}
        reasons: dict[int, Reason] = {}
        for k in missing:
            marker = self._markers[k]
            near = [
                (spot, light)
                for spot, light in found
                if self._is_expected(marker, spot, light) and not self._is_taken(spot, k)
            ]
            # A marker that was seen before has been lost for long: it must be alone for a while.
            if len(near) > 1:
                marker.lonely_since = self._frame
            wanted = 0 if marker.appearance is None else _LONELY_FRAMES
            if len(near) == 1 and self._frame - marker.lonely_since >= wanted:
                self._introduce(image, marker, *near[0])
            else:
                reasons[k] = "ambiguous" if near else "not_acquired"
        return reasons

    def _is_expected(self, marker: MarkerState, spot: Spot, light: Light) -> bool:
        """True when a spot lies in the marker's row and, if the marker was seen before, looks like it."""
        row = marker.known_row
        if row is None or abs(spot.v - row) > self.parameters.expected_row_tolerance_px:
            return False
        if marker.appearance is None:
            return True
        return self._meter.judge(spot, self._meter.gates(light, marker.appearance)) == "ok"

    def _introduce(self, image: ImageArray, marker: MarkerState, spot: Spot, light: Light) -> None:
        """Start to follow a spot as this marker."""
        marker.light = light
        if marker.appearance is None:
            marker.appearance = self._meter.appearance(spot, light)
        marker.gates = self._meter.gates(light, marker.appearance)
        marker.known_row = marker.appearance.row
        marker.place(spot.u, spot.v)
