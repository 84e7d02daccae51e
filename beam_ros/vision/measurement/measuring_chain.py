"""The measuring chain of one camera: a frame goes in, displacements in metres come out, or nothing where unsure.

Frames that were seen before or come from the past are left out; markers are tracked; their positions are freed from
the lens's distortion and turned into metres. Whatever stands in the way (images of another size, a calibration of
another camera) is a sentence here and NaN in the result: a measurement is never made up.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from beam_ros.arrays import FloatArray, ImageArray
from beam_ros.vision.calibration.lens import Lens
from beam_ros.vision.calibration.linear import LinearCalibration, MarkerDisplacements
from beam_ros.vision.errors import CalibrationError, ImageFormatError
from beam_ros.vision.fields import DEINTERLACE
from beam_ros.vision.measurement.continuity import FrameContinuity
from beam_ros.vision.measurement.motion_prediction import BeamMotion, MotionPrediction
from beam_ros.vision.mosaic import UNDO
from beam_ros.vision.parameters import CameraParameters, TrackerParameters
from beam_ros.vision.timing import FrameTiming
from beam_ros.vision.tracking.acquisition import FULL_DISCS
from beam_ros.vision.tracking.marker_state import Foretold
from beam_ros.vision.tracking.tracker import FrameResult, MarkerTracker

_BELIEVED_AFTER_FRAMES = 20
"""So many frames in a row that all come from the past mean that the camera's clock was set back."""
_LOST_SIGHT_FRAMES = 3
"""With so many frames missing in a row a marker may be farther from its prediction than the tracker looks."""
_LENS_SHIFT_PX = 0.25
"""Largest difference between two lenses' distortion, anywhere in the image, that still counts as the same [px]."""


@dataclass(frozen=True)
class Measurement:
    """One frame, measured.

    Attributes
    ----------
    stamp_ns : int -- stamp of the frame [ns]
    stamps_ns : tuple of int -- middle of the exposure of each marker's row [ns]
    u_px, v_px : ndarray, shape (n_markers,) -- where the markers are in the image; NaN where not seen [px]
    corrected_px, sigma_px : ndarray, shape (n_markers,) -- place along the hub's travel, without the lens's
        distortion, and its standard deviation, which is what calibrations are made from [px]
    across_px : ndarray, shape (n_markers,) -- place across the travel, likewise [px]
    displacement : MarkerDisplacements -- in metres; NaN where not seen, and where there is no valid calibration
    reasons : tuple of str -- "ok", or why a marker is not valid
    frame : FrameResult or None -- the tracker's own result; None for a frame that could not be read
    """

    stamp_ns: int
    stamps_ns: tuple[int, ...]
    u_px: FloatArray
    v_px: FloatArray
    corrected_px: FloatArray
    sigma_px: FloatArray
    across_px: FloatArray
    displacement: MarkerDisplacements
    reasons: tuple[str, ...]
    frame: FrameResult | None


class MeasuringChain:
    """From frames to displacements.

    Parameters
    ----------
    camera : CameraParameters -- size, rate, the meaning of the stamps, names
    tracker : TrackerParameters
    marker_heights : sequence of float -- heights above the clamp, rising [m]
    calibration : LinearCalibration
    motion : BeamMotion, optional -- foretells the markers' places; None: only their own motion does

    Attributes
    ----------
    tracker : MarkerTracker
    prediction : MotionPrediction or None -- where the markers will be, by hub and beam
    foretold_frames : ndarray of int, shape (n_markers,) -- frames in which that told a marker from other spots
    continuity : FrameContinuity
    clock_steps : int -- how often the camera's clock was set back
    """

    def __init__(
        self,
        camera: CameraParameters,
        tracker: TrackerParameters,
        marker_heights: Sequence[float],
        calibration: LinearCalibration,
        motion: BeamMotion | None = None,
    ) -> None:
        timing = FrameTiming(camera)
        self.tracker = MarkerTracker(tracker, len(marker_heights), timing)
        self.continuity = FrameContinuity(round(camera.period_s * 1e9))
        self.clock_steps = 0
        self.foretold_frames = np.zeros(len(marker_heights), dtype=np.intp)
        self._past_frames = 0
        self._grey_type: np.dtype[Any] | None = None
        self._camera = camera
        self._timing = timing
        self._rows = camera.rows(marker_heights)
        self._lens: Lens | None = None
        self.prediction = (
            None if motion is None else MotionPrediction(motion, calibration.scales, camera.period_s)
        )
        self.calibration = calibration

    # -- calibration and lens ------------------------------------------------------------------------------

    @property
    def calibration(self) -> LinearCalibration:
        """The calibration in use, or the one that is refused while ``calibration_fault`` says why."""
        return self._calibration

    @calibration.setter
    def calibration(self, calibration: LinearCalibration) -> None:
        self._calibration = calibration
        self._examine_calibration()

    @property
    def lens(self) -> Lens | None:
        """The lens whose distortion is undone; None for one without."""
        return self._lens

    @lens.setter
    def lens(self, lens: Lens | None) -> None:
        self._lens = lens
        self._examine_calibration()

    @property
    def calibration_fault(self) -> str:
        """Why there are no displacements in metres, or ""."""
        return self._calibration_fault

    @property
    def calibration_doubt(self) -> str:
        """What the calibration does not say about the camera in use, or ""."""
        return self._calibration.doubt(self._camera)

    @property
    def exposure_doubt(self) -> str:
        """What the markers' smears say against the stated exposure, or ""."""
        stated, seen = self._camera.exposure_s, self.tracker.exposure_s
        if seen <= stated or self.tracker.fields_apart > 0:
            return ""
        return (
            f"markers that move are smeared {seen / stated:.2g} times as long as camera.exposure, {stated:.4g} s, "
            f"allows, and are not believed (smear): expected the camera's own exposure, likely some {seen:.2g} s; "
            "set camera.exposure to it"
        )

    @property
    def fields_doubt(self) -> str:
        """What is to be said of two instants in each image, or ""."""
        apart = self.tracker.fields_apart
        if apart == 0.0:
            return ""
        return (
            f"even and odd rows of the images show two instants, {apart:.2g} of a frame apart (interlaced): expected "
            "one. Positions are the mean of both, so that vibrations at a quarter of the frame rate come out "
            f"{100 * (1 - math.cos(math.pi * apart / 4)):.0f} % too small, and fast ones are not believed (smear); "
            f"set the camera to progressive, or deinterlace the film ({DEINTERLACE})"
        )

    @property
    def reduction_doubt(self) -> str:
        """What is to be said of a camera that averages its frames with those before, or ""."""
        lag = self.tracker.lag_frames
        if lag == 0.0:
            return ""
        return (
            "the images' noise comes again from frame to frame, as of a camera that averages them: expected noise of "
            f"its own in each. What moves may be shown up to {lag:.2g} frames late, which is stated as its standard "
            "deviation; switch the camera's temporal noise reduction (3DNR) off, and give it more light"
        )

    @property
    def mosaic_doubt(self) -> str:
        """What is to be said of a raw mosaic of colours, or ""."""
        if not self.tracker.shows_mosaic:
            return ""
        return (
            "the images are the raw mosaic of a colour sensor: the markers' light differs from pixel to pixel, and "
            f"none is measured (mosaic): expected grey or colour; {UNDO}"
        )

    @property
    def rings_doubt(self) -> str:
        """What is to be said of markers that are rings, or ""."""
        if not self.tracker.shows_rings:
            return ""
        return f"what is like the markers has another brightness in its middle (ring): expected {FULL_DISCS}"

    @property
    def aspect_doubt(self) -> str:
        """What is to be said of markers that are not as wide as high, or ""."""
        aspect = self.tracker.aspect
        if aspect is None or self.tracker.is_acquired:
            return ""
        return (
            f"what is like the markers is {aspect:.3f} times as wide as high (out_of_round): expected "
            f"{self.tracker.parameters.aspect:g}, as tracker.aspect says; look at the beam at a right angle, or set "
            f"tracker.aspect to {aspect:.3f} if the dots look like that in a still picture"
        )

    @property
    def doubts(self) -> list[str]:
        """What is to be said of the camera, in node and film alike."""
        said = (
            self.calibration_doubt,
            self.exposure_doubt,
            self.fields_doubt,
            self.reduction_doubt,
            self.mosaic_doubt,
            self.rings_doubt,
            self.aspect_doubt,
        )
        return [doubt for doubt in said if doubt]

    @property
    def lens_fault(self) -> str:
        """What is wrong between lens and calibration, or ""."""
        return self._lens_fault

    def _examine_calibration(self) -> None:
        self._calibration_fault = self._lens_fault = ""
        try:
            self._calibration.require_camera(self._camera)
            if self._calibration.n_markers != self.tracker.n_markers:
                raise CalibrationError(
                    f"calibration holds for {self._calibration.n_markers} markers; expected "
                    f"{self.tracker.n_markers}, as many as markers.names has: calibrate this beam"
                )
            if self.prediction is not None:
                self.prediction.scales = self._calibration.scales
            provenance = self._calibration.provenance
            if "lens" in provenance and not self._is_same_lens(Lens.from_dict(provenance["lens"])):
                self._lens_fault = (
                    "the calibration was made with another lens correction than camera_info states now: calibrate "
                    "again, or give the camera the camera_info that it had then"
                )
        except CalibrationError as err:
            self._calibration_fault = str(err)

    def _is_same_lens(self, other: Lens | None) -> bool:
        columns, rows = np.meshgrid(
            np.linspace(0, self._camera.width - 1, 5), np.linspace(0, self._camera.height - 1, 5)
        )
        first, second = (
            columns if lens is None else lens.undistort(columns, rows)[0] for lens in (self._lens, other)
        )
        return bool(np.nanmax(np.abs(first - second), initial=0.0) <= _LENS_SHIFT_PX)

    # -- frames --------------------------------------------------------------------------------------------

    def reset(self) -> None:
        """Forget the markers and the last stamp; calibration and lens stay."""
        self.tracker.reset()
        self.continuity.restart()
        if self.prediction is not None:
            self.prediction.reset()

    def admit(self, stamp_ns: int) -> bool:
        """Judge a frame by its stamp; False for one that was seen before or comes from the past.

        A clock that was set back is believed after some frames, so that the chain does not wait for the old time
        to come again. After a long gap the markers may be elsewhere, and are still what they were.
        """
        step = self.continuity.observe(stamp_ns)
        if step.step == "backwards":
            self._past_frames += 1
            if self._past_frames >= _BELIEVED_AFTER_FRAMES:
                self.clock_steps += 1
                self.continuity.restart()
                step = self.continuity.observe(stamp_ns)
        if step.missing >= _LOST_SIGHT_FRAMES:
            self.tracker.pass_over(step.missing)
        if step.is_usable:
            self._past_frames = 0
        return step.is_usable

    def hear_hub(self, stamp_ns: int, position_m: float) -> None:
        """Take note of where the hub was, for what foretells the markers' places."""
        if self.prediction is not None:
            self.prediction.add_hub(stamp_ns, position_m)

    def measure(self, stamp_ns: int, image: ImageArray) -> Measurement:
        """Measure a frame that was admitted.

        Parameters
        ----------
        stamp_ns : int -- its stamp [ns]
        image : ndarray, shape (height, width), uint8 or uint16

        Raises
        ------
        ImageFormatError
            The image has another size than the rig's camera.
        """
        height, width = image.shape
        if (width, height) != (self._camera.width, self._camera.height):
            raise ImageFormatError(
                f"images are {width} x {height}; expected {self._camera.width} x {self._camera.height}: set "
                "camera.width and camera.height to the camera's size, and calibrate it"
            )
        if image.dtype != self._grey_type:
            # 8 and 16 bits are other grey levels of the same markers.
            self.tracker.reset()
            self._grey_type = image.dtype
        foretold: Sequence[Foretold] = ()
        if self.prediction is not None:
            foretold = self.prediction.foretell(self._row_middles(stamp_ns))
        result = self.tracker.process(image, stamp_ns, foretold)
        markers = result.markers
        u = np.array([marker.u_px for marker in markers])
        v = np.array([marker.v_px for marker in markers])
        sigma = np.array([marker.sigma_px for marker in markers])
        if self.prediction is not None:
            self.prediction.correct(u, sigma)
            self.foretold_frames[list(result.foretold)] += 1
        perfect_u, perfect_v = u, v
        if self._lens is not None:
            # The lens also stretches: its slope along u carries the standard deviation over.
            columns, rows = self._lens.undistort(u + np.array([[-0.5], [0.0], [0.5]]), np.tile(v, (3, 1)))
            (left, perfect_u, right), perfect_v = columns, rows[1]
            sigma = sigma * np.abs(right - left)
        corrected, across = self._calibration.travel_axes(perfect_u, perfect_v)
        return Measurement(
            stamp_ns,
            tuple(marker.stamp_ns for marker in markers),
            u,
            v,
            corrected,
            sigma,
            across,
            self._nowhere() if self._calibration_fault else self._calibration.displacement(corrected, sigma),
            tuple(marker.reason for marker in markers),
            result,
        )

    def unread(self, stamp_ns: int) -> Measurement:
        """Measurement of a frame whose pixels could not be read: nothing was seen."""
        nowhere = self._nowhere()
        return Measurement(
            stamp_ns,
            self._row_middles(stamp_ns),
            nowhere.x_m,
            nowhere.x_m,
            nowhere.x_m,
            nowhere.x_m,
            nowhere.x_m,
            nowhere,
            ("unreadable",) * self.tracker.n_markers,
            None,
        )

    def _row_middles(self, stamp_ns: int) -> tuple[int, ...]:
        return tuple(self._timing.row_middle(stamp_ns, float(row)) for row in self._rows)

    def _nowhere(self) -> MarkerDisplacements:
        nothing = np.full(self.tracker.n_markers, np.nan)
        return MarkerDisplacements(nothing, nothing)
