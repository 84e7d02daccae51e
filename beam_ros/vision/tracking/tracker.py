"""The markers of one beam, frame after frame: who is who, and when not to believe it.

Markers are *acquired* in the whole image (``vision.tracking.acquisition``); a marker of a few frames beside which
something appears is acquired anew, and so are markers that the light begins or ceases to saturate. From then on each
is *followed* in a small region about its prediction, where ``vision.tracking.spots`` measures it and compares it with
itself.

A measurement that fails a gate is reported as not valid, with the reason, unless the marker is found in the same
frame (``vision.tracking.recovery``). Other spots of its kind in its row (rivals) are watched while it is seen.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import repeat, zip_longest
from typing import NamedTuple

import numpy as np

from beam_ros.arrays import ImageArray
from beam_ros.vision.ailments import Ailments
from beam_ros.vision.errors import ImageFormatError, VisionParameterError
from beam_ros.vision.noise_reduction import STILL_PX
from beam_ros.vision.parameters import TrackerParameters
from beam_ros.vision.timing import FrameTiming
from beam_ros.vision.tracking.acquisition import Acquisition
from beam_ros.vision.tracking.appearance import Appearance, Light
from beam_ros.vision.tracking.association import SpotPath
from beam_ros.vision.tracking.disc_model import DiscFit
from beam_ros.vision.tracking.marker_state import SAME_PLACE_PX, Foretold, MarkerState
from beam_ros.vision.tracking.moments import beyond
from beam_ros.vision.tracking.recovery import Frame, Recovery
from beam_ros.vision.tracking.second_image import (
    NO_PULL,
    TELLING_PX,
    Pull,
    SecondImages,
    Sighting,
    is_explained,
)
from beam_ros.vision.tracking.spots import APART_PX, Gates, Reason, Spot, SpotMeter, Way, upright_spot

_PROBATION_FRAMES = 10
"""A marker acquired for the first time is doubted anew where something appears in its row within so many frames."""
_KNOWN_FRAMES = 3
"""A marker that is lost before it was seen in so many frames is acquired anew: something may have touched it then."""
_NOWHERE = (math.nan,) * 3
"""Place and standard deviation of what is not valid."""
_TWO_IN_ONE, _JOINED = 1.1, 0.05
"""What is so many times as large as the marker, and compact, is with this probability the marker and another spot
where none was seen beside it: light that changes, and things that touch it, are likelier."""
_CHORES_EVERY_FRAMES = 8
"""Noise and levels are measured anew, and rivals looked for, once in so many frames."""


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
    foretold : tuple of int -- numbers of those that were told from other spots by where they were foretold
    """

    stamp_ns: int
    markers: tuple[MarkerMeasurement, ...]
    foretold: tuple[int, ...] = ()

    @property
    def is_complete(self) -> bool:
        """True when every marker is valid."""
        return all(marker.is_valid for marker in self.markers)


class SeenSpot(NamedTuple):
    """Something in a frame that stands out of its neighbourhood by about a marker's size.

    Attributes
    ----------
    u_px, v_px : float -- where it is [px]
    marker : int or None -- number of the marker in whose row it lies; None where no rows are known
    word : str -- "like it", "a disc" where the marker is not known yet, or why it is not taken for the marker
    """

    u_px: float
    v_px: float
    marker: int | None
    word: str


class Sight(NamedTuple):
    """A marker that was found in a frame, before the frame as a whole is judged.

    Attributes
    ----------
    marker, light, appearance, gates : MarkerState, Light, Appearance, Gates -- as they were before
    spot, found : Spot, DiscFit -- what is seen of it
    is_fresh : bool -- it was not seen in the frame before
    is_lit, is_due : bool -- its light, and its gates, are to be measured anew
    """

    marker: MarkerState
    light: Light
    appearance: Appearance
    gates: Gates
    spot: Spot
    found: DiscFit
    is_fresh: bool
    is_lit: bool
    is_due: bool


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
        self._is_refined = parameters.refinement != "none"
        self._markers: list[MarkerState] = []
        self._shape: tuple[int, int] | None = None
        # Without a camera's times a marker may move during the whole of a period.
        self._period_s, self._row_delay_s = 1.0, 0.0
        self._exposed_s = 1.0
        if timing is not None:
            camera = timing.camera
            self._period_s, self._exposed_s = camera.period_s, camera.exposure_s
            self._row_delay_s = camera.readout_s / (camera.height - 1)
        self._frame = self._stamp_ns = 0
        self._since_s = self._period_s
        self.reset()

    # -- state ---------------------------------------------------------------------------------------------

    def reset(self) -> None:
        """Forget every marker; the next frame starts with acquisition."""
        rows = self.parameters.expected_rows_px
        region = self.parameters.region_px or (0.0, math.inf, 0.0, math.inf)
        self._left, self._top = math.ceil(region[0]), math.ceil(region[2])
        self._size = region[1] - self._left, region[3] - self._top
        self._markers = [
            MarkerState(None if rows is None else rows[k] - self._top) for k in range(self.n_markers)
        ]
        self._recovery = Recovery(self._meter, self._markers)
        exposure_s = math.inf if self.timing is None else self._exposed_s
        self._acquisition = Acquisition(self._meter, self._markers, self._recovery, exposure_s)
        self._seconds = SecondImages(self._exposed_s, self._row_delay_s)
        self._ailments = Ailments()
        self._shape, self._frame = None, 0

    def pass_over(self, n_frames: int) -> None:
        """Take note that so many frames are missing: the markers may be elsewhere, and are what they were."""
        self._frame += n_frames
        self._recovery.note_losses(self._frame)
        for marker in self._markers:
            if marker.is_followed:
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

    @property
    def exposure_s(self) -> float:
        """Exposure that the markers' smears show [s]; the stated one where they do not contradict it."""
        return self._seconds.exposure_s

    @property
    def fields_apart(self) -> float:
        """Time between the instants that even and odd rows show [frames]; 0 where nothing shows that they are two."""
        return self._ailments.fields.apart

    @property
    def lag_frames(self) -> float:
        """How far a temporal noise reduction shows what moves behind its time [frames]; 0 where nothing shows one."""
        return self._ailments.reduction.lag_frames

    @property
    def shows_mosaic(self) -> bool:
        """True where what last was like a marker lies in a mosaic of colours, and was not acquired."""
        return self._acquisition.shows_mosaic

    @property
    def aspect(self) -> float | None:
        """Width over height of what was not acquired for it; None where that was as expected."""
        return self._acquisition.aspect

    @property
    def shows_rings(self) -> bool:
        """True where most of what last was like a marker has a hole, and was not acquired."""
        return self._acquisition.shows_rings

    # -- frames --------------------------------------------------------------------------------------------

    def process(self, image: ImageArray, stamp_ns: int, foretold: Sequence[Foretold] = ()) -> FrameResult:
        """Measure every marker in a frame.

        Parameters
        ----------
        image : ndarray, shape (height, width), uint8 or uint16 -- grey image
        stamp_ns : int -- stamp of the frame [ns]
        foretold : sequence of Foretold, one per marker -- where the markers should be; empty where nobody foretells

        Returns
        -------
        FrameResult

        Raises
        ------
        ImageFormatError -- the image is not a two-dimensional uint8 or uint16 array, or has no room for the region
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
        whole = image
        image, foretold = self._within(image, foretold)
        result = self._process(image, stamp_ns, foretold)
        if image is whole:
            return result
        # Inside, all places count from the corner of the region.
        markers = [m._replace(u_px=m.u_px + self._left, v_px=m.v_px + self._top) for m in result.markers]
        return result._replace(markers=tuple(markers))

    def _within(
        self, image: ImageArray, foretold: Sequence[Foretold]
    ) -> tuple[ImageArray, Sequence[Foretold]]:
        """Cut an image to the region in which markers are looked for, with places counted from there."""
        (height, width), (columns, rows) = image.shape, self._size
        if self._left == self._top == 0 and columns >= width - 1 and rows >= height - 1:
            return image, foretold
        right, bottom = (
            math.floor(min(last, size))
            for last, size in ((self._left + columns + 1, width), (self._top + rows + 1, height))
        )
        part = image[self._top : bottom, self._left : right]
        if min(part.shape) < 2 * self.parameters.marker_diameter_px:
            raise ImageFormatError(
                f"image is {width} x {height}, of which tracker.region {self.parameters.region_px} leaves "
                f"{part.shape[1]} x {part.shape[0]}; expected room for the markers: correct tracker.region"
            )
        return part, [place._replace(u_px=place.u_px - self._left) for place in foretold]

    def _process(self, image: ImageArray, stamp_ns: int, foretold: Sequence[Foretold]) -> FrameResult:
        """Measure every marker in the region of a frame."""
        self._frame += 1
        if self._ailments.is_repeated(image) and any(
            marker.is_followed and marker.motion.is_going for marker in self._markers
        ):
            self._recovery.note_losses(self._frame)
            nothing = [self._invalid(marker, "repeated", stamp_ns, math.nan) for marker in self._markers]
            return FrameResult(stamp_ns, tuple(nothing))
        elapsed_ns = self._begin(stamp_ns, foretold)
        image = self._ailments.mended(image, self._frame, lambda: self._contrast(image))
        frame = Frame(image, self._frame, {}, {})
        self._measure(frame)
        if not self.is_acquired:
            self._ailments.watch(self._frame)
            frame.reasons.update(self._acquisition.acquire(frame, elapsed_ns))
            self._measure(frame)
        lost, checked = self._doubtful(frame)
        if lost:
            self._ailments.watch(self._frame)
        elif self._is_shown_again(frame):
            # The markers are where they are, which this image does not tell: the next one does.
            nothing = [self._nothing(marker, "repeated", stamp_ns, math.nan) for marker in self._markers]
            return FrameResult(stamp_ns, tuple(nothing))
        self._recovery.find(frame, lost, checked)
        found = [self._found(frame, k, stamp_ns) for k in range(self.n_markers)]
        results = self._results(frame, found, stamp_ns)
        self._look_for_ailments(image, found)
        self._recovery.before = image
        told = [k for k, marker in enumerate(self._markers) if marker.is_foretold]
        return FrameResult(stamp_ns, results, tuple(told))

    def _begin(self, stamp_ns: int, foretold: Sequence[Foretold]) -> int:
        """Take the time and the foretold places of a frame; returns the time since the one before [ns]."""
        elapsed_ns, self._stamp_ns = stamp_ns - self._stamp_ns, stamp_ns
        # Stamps may come late, and frames be missing: of period and elapsed time it is the less.
        self._since_s = max(min(elapsed_ns * 1e-9, self._period_s), self._exposed_s, 1e-9)
        self._recovery.shear_of_speed = self._row_delay_s / self._since_s
        for marker, place in zip_longest(self._markers, foretold):
            marker.foretold, marker.is_foretold = place, False
        return elapsed_ns

    def _is_shown_again(self, frame: Frame) -> bool:
        """True where the markers' steps say that an image is the one before, with noise of its own."""
        motions = ((self._markers[k].motion, spot.u) for k, spot in frame.spots.items())
        seen = ((motion.way, u, motion.sigma) for motion, u in motions)
        return self._ailments.is_shown_again(seen, self._frame)

    def _results(
        self, frame: Frame, found: list[Sight | MarkerMeasurement], stamp_ns: int
    ) -> tuple[MarkerMeasurement, ...]:
        """State where the markers are, by all of which a second image would show."""
        pulls = self._pulls([sight for sight in found if isinstance(sight, Sight)], frame)
        return tuple(
            self._result(frame.image, sight, next(pulls), stamp_ns) if isinstance(sight, Sight) else sight
            for sight in found
        )

    def _pulls(self, sights: list[Sight], frame: Frame) -> Iterator[Pull]:
        """How far second images pull the markers: none where the motion explains all of them, as it does mostly."""
        seconds = self._seconds
        if seconds.is_usual or not all(map(self._is_plain, sights)):
            is_seen = not {"smear", "out_of_round"}.isdisjoint(frame.reasons.values())
            return iter(seconds.pulls(list(map(self._sighting, sights)), self._since_s, is_seen=is_seen))
        for sight in sights:
            if abs(step := self._step(sight)) > TELLING_PX:
                seconds.note_explained(sight.found.sigma_excess, step, self._since_s)
        return repeat(NO_PULL)

    def _look_for_ailments(self, image: ImageArray, found: list[Sight | MarkerMeasurement]) -> None:
        """Look for two instants in the rows of the markers, and for a noise reduction about those at rest."""
        fields, reduction = self._ailments.fields, self._ailments.reduction
        if self._frame < min(fields.next_frame, reduction.next_frame):
            return
        sights = [(k, sight) for k, sight in enumerate(found) if isinstance(sight, Sight)]
        moved = [(k, sight) for k, sight in sights if sight.marker.motion.steps > 0]
        is_dark = self.parameters.polarity == "dark"
        for k, (marker, light, _, _, spot, disc, *_) in moved if self._frame >= fields.next_frame else ():
            left, top, right, bottom = spot.region
            level, motion = (light.level,), marker.motion
            lit = partial(beyond, image[top:bottom, left:right], level, is_dark=is_dark)
            fields.look(self._frame, k, lit, top, motion.u, motion.velocity, disc.sigma_u)
        is_still = any(abs(sight.marker.motion.velocity) <= STILL_PX for _, sight in moved)
        if is_still and self._frame >= reduction.next_frame:
            reduction.look(self._frame, image, [sight.spot.region for _, sight in sights])

    def explained(self, image: ImageArray) -> list[SeenSpot]:
        """Say what stands out in the markers' rows of the frame that was processed last, and as what it counts.

        Parameters
        ----------
        image : ndarray, shape (height, width), uint8 or uint16 -- that frame
        """
        image, _ = self._within(image, ())
        spots = [
            SeenSpot(u, v, None, word)
            for u, v, word in ([] if self.is_acquired else self._acquisition.seen(image))
        ]
        for k, marker in enumerate(self._markers):
            if marker.is_followed:
                row = self._recovery.in_row(image, k, is_wide=True)
                spots += [SeenSpot(spot.u, spot.v, k, "like it") for spot, _ in row.alike]
                spots += [SeenSpot(u, marker.motion.v, k, why) for u, why in row.others]
        return [spot._replace(u_px=spot.u_px + self._left, v_px=spot.v_px + self._top) for spot in spots]

    def _contrast(self, image: ImageArray) -> float:
        """Contrast of what stands out most in a picture; 0 where that is less than a marker has [grey levels]."""
        contrast = self._meter.relief(image).most
        return contrast if contrast >= self.parameters.min_contrast_grey else 0.0

    def _stamp(self, stamp_ns: int, row: float) -> int:
        if self.timing is None or not math.isfinite(row):
            return stamp_ns
        return self.timing.row_middle(stamp_ns, row + self._top)

    def _invalid(self, marker: MarkerState, reason: Reason, stamp_ns: int, area: float) -> MarkerMeasurement:
        """Count a lost frame."""
        marker.lost_frames += 1
        marker.shown = math.nan
        return self._nothing(marker, reason, stamp_ns, area)

    def _nothing(self, marker: MarkerState, reason: Reason, stamp_ns: int, area: float) -> MarkerMeasurement:
        """Measurement of a marker that is not valid."""
        row = (
            marker.motion.v
            if math.isfinite(marker.motion.v) or marker.known_row is None
            else marker.known_row
        )
        contrast = math.nan if marker.light is None else marker.light.contrast
        return MarkerMeasurement(*_NOWHERE, False, reason, self._stamp(stamp_ns, row), contrast, area)

    def _measure(self, frame: Frame) -> None:
        """Measure the markers that are seen, and that were not measured yet, where they should be."""
        numbers = [k for k, marker in enumerate(self._markers) if marker.is_seen and k not in frame.reasons]
        places = [self._expected(self._markers[k]) for k in numbers]
        measured = self._meter.measure_all(frame.image, places)
        for k, place, (spot, reason) in zip(numbers, places, measured, strict=True):
            if spot is not None:
                frame.spots[k] = spot
                reason = self._compare(frame.image, self._markers[k], spot, place[0])
            frame.reasons[k] = reason

    def _is_due(self, k: int) -> bool:
        """True in the frames in which the chores of a marker are done."""
        return (self._frame + k) % _CHORES_EVERY_FRAMES == 0

    def _doubtful(self, frame: Frame) -> tuple[list[int], list[int]]:
        """Markers that are not where they should be; and those that are new, not certain, or due to be checked."""
        lost, checked = [], []
        for k, marker in enumerate(self._markers):
            if frame.reasons.get(k) != "ok":
                if marker.is_followed:
                    lost.append(k)
            elif (
                self._frame - marker.acquired_at < _PROBATION_FRAMES
                or self._is_due(k)
                or marker.belief.is_watched(self._frame, _PROBATION_FRAMES)
            ):
                checked.append(k)
        return lost, checked

    def _beside(self, marker: MarkerState) -> list[float]:
        """Columns in which other spots of a marker's kind should be [px]."""
        others = marker.belief.others
        return [
            path.predicted(self._frame)[0] for path in others if self._frame - path.frame <= _PROBATION_FRAMES
        ]

    def _expected(self, marker: MarkerState) -> tuple[float, float, Light, bool]:
        """Where and in which light a marker should be, and whether another spot is near."""
        assert marker.light is not None
        assert marker.appearance is not None
        predicted, is_crowded = marker.predicted, marker.appearance.is_bounded
        if not marker.belief.is_alone:
            near = self._meter.half + self._meter.radius + APART_PX
            is_crowded |= any(abs(at - predicted) < near for at in self._beside(marker))
        return predicted, marker.motion.v, marker.light, is_crowded

    def _compare(self, image: ImageArray, marker: MarkerState, spot: Spot, predicted: float) -> Reason:
        """Compare a spot with the marker that should be there, in a predicted column [px]."""
        light, appearance, gates = marker.light, marker.appearance, marker.gates
        assert light is not None
        assert appearance is not None
        assert gates is not None
        upright = spot
        if self._recovery.shear_of_speed > 0.0:
            speed, doubt = marker.motion.speed(spot.u, marker.lost_frames)
            upright = upright_spot(
                spot, self._recovery.shear_of_speed * speed, self._recovery.shear_of_speed * doubt
            )
        reason = self._meter.judge(upright, gates)
        if reason == "ok" and abs(spot.u - predicted) > self.parameters.max_jump_px:
            reason = "ambiguous"
        if (
            reason != "ok"
            and marker.belief.is_alone
            and spot.area > _TWO_IN_ONE * appearance.area
            and self._meter.is_compact(image, spot, light)
        ):
            marker.belief.join(marker.path, _JOINED)
        return reason

    def _found(self, frame: Frame, k: int, stamp_ns: int) -> Sight | MarkerMeasurement:
        """Find where a marker's spot is centred; what is not valid is a measurement already."""
        marker, spot, reason = self._markers[k], frame.spots.get(k), frame.reasons[k]
        light, appearance, gates = marker.light, marker.appearance, marker.gates
        if spot is None or reason != "ok" or light is None or appearance is None or gates is None:
            invalid = self._invalid(marker, reason, stamp_ns, math.nan if spot is None else spot.area)
            if appearance is not None and appearance.frames < _KNOWN_FRAMES:
                if not marker.belief.is_alone and (path := marker.path) is not None:
                    marker.belief.begin([path, *marker.belief.others])  # one of these is the marker
                marker.forget()
            return invalid
        is_fresh = (
            marker.acquired_at == self._frame or marker.lost_at == self._frame or marker.lost_frames > 0
        )
        if is_fresh or (k in self._recovery.rows and not appearance.is_settled):
            appearance.is_bounded = self._meter.is_bounded(frame.image, spot, light.contrast)
        if self._is_doubted(k, spot):
            return self._invalid(marker, "ambiguous", stamp_ns, spot.area)
        way = self._within_exposure(marker, spot.u, is_fresh=is_fresh) if self._is_refined else None
        found = self._meter.located(frame.image, spot, light, appearance, way)
        if not isinstance(found, DiscFit):
            self._recovery.note_loss(k, self._frame)
            return self._invalid(marker, found, stamp_ns, spot.area)
        is_due = self._is_due(k)
        is_lit = is_due and not marker.belief.is_watched(self._frame, _PROBATION_FRAMES)
        return Sight(marker, light, appearance, gates, spot, found, is_fresh, is_lit, is_due)

    def _within_exposure(self, marker: MarkerState, u: float, *, is_fresh: bool) -> Way:
        """What a marker's motion during the exposure makes of its image."""
        shear: float | None = None
        bend = math.inf
        if self._row_delay_s > 0.0:
            speed, doubt = (
                (0.0, self.parameters.max_gate_px) if is_fresh else marker.motion.speed(u, marker.lost_frames)
            )
            shear = self._recovery.shear_of_speed * (abs(speed) + doubt)
        if not is_fresh and marker.motion.steps > 1:
            bend = marker.motion.turn(u) * (self._exposed_s / self._since_s) ** 2 / 2
        return shear, bend

    def _is_plain(self, sight: Sight) -> bool:
        """True where a marker's mean speed explains what is seen of it."""
        marker, appearance = sight.marker, sight.appearance
        if marker.motion.is_pulled or not appearance.is_settled:
            return False
        return is_explained(sight.found, appearance, self._step(sight), self._exposed_s / self._since_s)

    @staticmethod
    def _step(sight: Sight) -> float:
        """How far a marker came since the frame before [px]; 0 where that did not show it."""
        return sight.spot.u - sight.marker.motion.u if sight.marker.lost_frames == 0 else 0.0

    def _sighting(self, sight: Sight) -> Sighting:
        """What a marker shows of a second image."""
        marker, appearance, spot, found = sight.marker, sight.appearance, sight.spot, sight.found
        is_known = marker.lost_frames == 0 and marker.acquired_at < self._frame
        motion = marker.motion
        step = spot.u - motion.u - motion.behind if is_known else math.nan
        if abs(step) > self.parameters.marker_diameter_px:
            step = 0.0  # an image of the marker so far away does not touch it
        speed, doubt = motion.speed(spot.u, marker.lost_frames)
        flatness = self._meter.flatness(appearance)
        return Sighting(found, appearance, flatness, step, abs(speed), doubt, motion.is_pulled)

    def _result(self, image: ImageArray, sight: Sight, pull: Pull, stamp_ns: int) -> MarkerMeasurement:
        """State where a marker is, and carry it into what is known of it."""
        marker, light, appearance, gates, spot, found, is_fresh, is_lit, is_due = sight
        meter, own = self._meter, marker.motion
        smear, pull_px, own.is_pulled, own.behind = pull
        v, is_believed = spot.v, pull_px < math.inf
        ground = light.background
        plateau = ground + (spot.plateau - ground) / meter.lit_share(spot, gates)
        own.remember(spot.u, v, self._frame, is_fresh=is_fresh)
        if is_fresh:
            marker.lost_frames = 0
        appearance.row = v
        uneven_px = 0.0
        if appearance.frames >= _KNOWN_FRAMES:
            uneven_px = meter.uneven_pull(spot, gates, appearance, found.sigma_u)
        if is_believed and not appearance.is_settled:
            meter.settle(spot, light, appearance, found, smear)
        if is_lit:
            light.absorb(plateau, *meter.sides(image, spot))
        if is_due or is_fresh or not appearance.is_settled:
            marker.gates = meter.gates(light, appearance)
        marker.shown = abs(plateau - light.background)
        stamp_ns = self._stamp(stamp_ns, v)
        if not is_believed:
            # It is followed all the same: what lies over it has not taken its place.
            return MarkerMeasurement(*_NOWHERE, False, "smear", stamp_ns, light.contrast, spot.area)
        spread_px = self._ailments.spread_px(
            (spot.u, v),
            (appearance.radius, appearance.edge),
            (light.contrast, light.noise),
            (max(abs(own.velocity), own.hold_error), own.linear_error),
            max(found.excess - appearance.excess, 0.0) + found.sigma_excess,
        )
        sigma = own.sigma = math.hypot(
            max(found.sigma_u, pull_px), uneven_px, spread_px, self.parameters.sigma_floor_px
        )
        return MarkerMeasurement(found.u, found.v, sigma, True, "ok", stamp_ns, light.contrast, spot.area)

    def _is_doubted(self, k: int, spot: Spot) -> bool:
        """Take back a marker that was just acquired, where something is new beside it: it may be the marker, too."""
        marker, row, reach = self._markers[k], self._recovery.rows.get(k), self.parameters.max_gate_px
        if row is None or self._frame - marker.acquired_at >= _PROBATION_FRAMES:
            return False
        known = [thing.u for thing in self._acquisition.clutter[k]]
        known += [path.predicted(self._frame)[0] for path in marker.belief.others if len(path.places) > 1]
        alike = [other for other, _ in row.alike if abs(other.u - spot.u) > self._meter.radius]
        is_new = any(
            abs(u - spot.u) <= reach and all(abs(u - thing) > SAME_PLACE_PX for thing in known)
            for u in [*(other.u for other in alike), *(u for u, _ in row.others)]
        )
        if is_new:
            marker.forget()
            seen = [spot, *alike] if alike else []
            marker.belief.begin([SpotPath(((self._frame, other.u),), other.v) for other in seen])
        return is_new
