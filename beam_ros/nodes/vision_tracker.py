"""The node ``tracker``: frames in, sub-pixel displacements of the markers out."""

from __future__ import annotations

import math
import os
import time
import traceback
from collections.abc import Awaitable, Callable
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np

from beam_ros import messages
from beam_ros.arrays import ImageArray
from beam_ros.messages import MessageContentError
from beam_ros.rig.beam_line import BeamLineFitter
from beam_ros.shell.frame_averaging import FrameAveraging
from beam_ros.shell.frame_sources import frame_source
from beam_ros.shell.large_messages import keep_freed_memory, widen_shared_memory
from beam_ros.shell.node import RigNode, run_node
from beam_ros.vision.calibration.lens import Lens, lens_to_dict
from beam_ros.vision.calibration.procedure import CalibrationProcedure
from beam_ros.vision.calibration.storage import calibration_or_nominal, save_calibration
from beam_ros.vision.errors import CalibrationError, ImageFormatError
from beam_ros.vision.measurement.diagnosis import Diagnosis
from beam_ros.vision.measurement.lateness import LatenessWatch
from beam_ros.vision.measurement.measuring_chain import Measurement, MeasuringChain
from beam_ros.vision.measurement.overlay import draw_overlay

_HUB_IS_SILENT_S = 1.0
_LOG_AGAIN_S = 5.0


class VisionTracker(RigNode):
    """Follows the markers in a camera's frames and publishes where they are."""

    def __init__(self, **options: Any) -> None:
        super().__init__("vision_tracker", **options)
        rig, camera = self.rig, self.rig.camera_parameters()
        self._names = rig.markers.names
        self._encoder_sd_m = rig.hub.encoder_resolution / math.sqrt(12.0)
        self._heights = np.asarray(rig.markers.heights)
        self._rows = camera.rows(self._heights)
        first = calibration_or_nominal(rig.tracker.calibration, camera, len(self._names))
        self._chain = MeasuringChain(
            camera, rig.tracker_parameters(), self._heights.tolist(), first, rig.beam_motion()
        )
        if self._chain.calibration_fault:
            self.get_logger().error(self._chain.calibration_fault)
        self._procedure = CalibrationProcedure(len(self._names), camera)
        self._lateness = LatenessWatch(camera.rate_hz)
        self._diagnosis = Diagnosis(self._names, self._chain, self._lateness)
        self._reported = time.monotonic()
        self._drawn = -math.inf
        self._line = BeamLineFitter(rig)
        self._hub_position, self._hub_heard = math.nan, -math.inf
        self._displacement = self.offer("beam/displacement")
        self._markers = self.offer("beam/markers")
        self._shape = self.offer("beam/shape")
        self._debug_image = self.offer("tracker/debug_image")
        self.listen("hub/state", self._on_hub_state)
        self._averaging = FrameAveraging(self)
        self.serve("tracker/reset", _answering(self._reset))
        self.serve("tracker/tare", _answering(self._tare), callback_group=self._averaging.group)
        self.serve(
            "tracker/capture_point", _answering(self._capture_point), callback_group=self._averaging.group
        )
        self.serve("tracker/fit_calibration", _answering(self._fit_calibration))
        self._source = frame_source(self, self)

    def _on_hub_state(self, message: Any) -> None:
        try:
            sample = messages.read_hub_state(message)
        except MessageContentError as err:
            self.get_logger().error(f"hub/state is left out: {err}", throttle_duration_sec=_LOG_AGAIN_S)
            return
        self._hub_position, self._hub_heard = sample.position, time.monotonic()
        self._lateness.add_hub(sample.stamp_ns, sample.position)
        self._chain.hear_hub(sample.stamp_ns, sample.position)

    # -- frames, from whichever source ---------------------------------------------------------------------

    def take_frame(self, stamp_ns: int, image: ImageArray) -> None:
        """Measure a frame and publish what was found."""
        self._diagnosis.frame_arrived()
        if not self._chain.admit(stamp_ns):
            return
        try:
            measurement = self._chain.measure(stamp_ns, image)
        except ImageFormatError as err:
            self._refuse(str(err), stamp_ns)
            return
        except Exception as err:  # noqa: BLE001 - whatever a frame leads to, the next one is measured
            self._chain.reset()
            place = traceback.extract_tb(err.__traceback__)[-1]
            self._refuse(
                f"a frame was left out, and the markers are acquired anew, after {type(err).__name__}: {err} in line "
                f"{place.lineno} of {Path(place.filename).name}; expected no such error; report it with the frame",
                stamp_ns,
            )
            return
        self._publish(measurement)
        self._averaging.add(measurement)
        self._draw(measurement, image)

    def refuse_frame(self, reason: str, stamp_ns: int | None) -> None:
        """Say that a frame cannot be read and, where its time is known, that nothing was seen then."""
        self._diagnosis.frame_arrived()
        if stamp_ns is None or self._chain.admit(stamp_ns):
            self._refuse(reason, stamp_ns)

    def begin_anew(self) -> None:
        """Take the next frame as the first of another camera."""
        self._chain.continuity.restart()
        self._lateness.restart()

    def set_lens(self, lens: Lens | None) -> None:
        """Undo this lens's distortion from now on."""
        self._chain.lens = lens

    def is_heard(self) -> bool:
        """Return whether somebody listens to the displacements or the markers."""
        return bool(self._displacement.get_subscription_count() or self._markers.get_subscription_count())

    def _refuse(self, reason: str, stamp_ns: int | None) -> None:
        self._diagnosis.frame_unusable(reason)
        self.get_logger().error(reason, throttle_duration_sec=_LOG_AGAIN_S)
        if stamp_ns is not None:
            self._publish(self._chain.unread(stamp_ns))

    def _publish(self, measurement: Measurement) -> None:
        found, stamps = measurement.displacement, measurement.stamps_ns
        self._lateness.add_frame(stamps[0], float(found.x_m[0]))
        for _, message in messages.displacement_messages(self.types, self._names, stamps, found.x_m):
            self._displacement.publish(message)
        self._diagnosis.frame_measured(measurement, self.now_ns() - measurement.stamp_ns)
        self._markers.publish(
            messages.marker_cloud_from_columns(
                self.types,
                measurement.stamp_ns,
                self._heights,
                found.x_m,
                found.sigma_m,
                measurement.u_px,
                measurement.v_px,
            )
        )

    def _draw(self, measurement: Measurement, image: ImageArray) -> None:
        """Publish what people look at, not more often than they see, and only while they do."""
        now = time.monotonic()
        if now - self._drawn < 1.0 / self.rig.tracker.drawing_rate:
            return
        self._drawn = now
        if self._shape.get_subscription_count():
            line = self._line.fit(measurement.displacement.x_m, measurement.displacement.sigma_m)
            self._shape.publish(
                messages.beam_shape(
                    self.types, measurement.stamp_ns, line.heights_m, line.x_m, is_complete=line.is_complete
                )
            )
        if self._debug_image.get_subscription_count() and measurement.frame is not None:
            drawing = draw_overlay(
                image,
                measurement.frame,
                self._names,
                marker_diameter_px=self._chain.tracker.parameters.marker_diameter_px,
                rows_px=self._rows.tolist(),
            )
            self._debug_image.publish(messages.image(self.types, measurement.stamp_ns, drawing))

    # -- services ------------------------------------------------------------------------------------------

    async def _reset(self) -> str:
        self._chain.reset()
        self._source.reset()
        points = len(self._procedure.points)
        self._procedure.clear()
        forgotten = f"; {points} calibration points are forgotten" if points else ""
        return f"markers are acquired anew{forgotten}"

    async def _tare(self) -> str:
        if self._chain.calibration_fault:
            raise CalibrationError(self._chain.calibration_fault)
        frames = await self._averaging.next_frames()
        # u is absolute: where the hub stands away from home, the markers' zero is that much further back.
        away_m = self._hub_position_now()
        calibration = self._chain.calibration
        columns = np.asarray(frames.columns) - calibration.scales * away_m
        self._chain.calibration = calibration.tare(columns, frames.sigmas)
        return f"zero from {len(frames.columns)} frames, the hub at {away_m * 1e3:+.3f} mm"

    async def _capture_point(self) -> str:
        frames = await self._averaging.next_frames()
        position_m = self._hub_position_now()
        self._procedure.capture_point(
            frames.columns, frames.sigmas, position_m, self._encoder_sd_m, frames.across
        )
        return f"point {len(self._procedure.points)} at {position_m:.6f} m"

    def _hub_position_now(self) -> float:
        """Return the hub's position, which calibrations refer to [m].

        Raises
        ------
        CalibrationError
            The hub does not say where it is: an old position may be any other.
        """
        silent_s = time.monotonic() - self._hub_heard
        if silent_s > _HUB_IS_SILENT_S:
            since = f"for {silent_s:.1f} s" if math.isfinite(silent_s) else "yet"
            raise CalibrationError(
                f"the hub has sent nothing {since}, and its position is the reference: expected hub/state within the "
                f"last {_HUB_IS_SILENT_S:g} s; start the hub"
            )
        if not math.isfinite(self._hub_position):
            raise CalibrationError(
                f"the hub's position is {self._hub_position!r} on hub/state, and is the reference: expected metres "
                "from home; home the hub"
            )
        return self._hub_position

    async def _fit_calibration(self) -> str:
        provenance = {
            "date": datetime.fromtimestamp(self.now_ns() * 1e-9, timezone.utc).isoformat(timespec="seconds"),
            "reference": "hub/state",
            "reference_sd_m": self._encoder_sd_m,
            "markers": list(self._names),
            "heights_m": self._heights.tolist(),
            "lens": lens_to_dict(self._chain.lens),
        }
        fit = self._procedure.fit(provenance, self._chain.calibration.angle)
        path = self.rig.tracker.save_calibration
        if path:
            save_calibration(fit.calibration, Path(path))
        self._chain.calibration = fit.calibration
        self._procedure.clear()
        scales = ", ".join(
            f"{scale:.2f} +- {math.sqrt(covariance[0][0]):.2g}"
            for scale, covariance in zip(
                fit.calibration.pixels_per_metre, fit.calibration.covariance, strict=True
            )
        )
        found = fit.calibration
        angle = f"travel at {found.angle * 1e3:+.2f} +- {found.angle_sd * 1e3:.2g} mrad to the image's rows"
        return "; ".join([f"{scales} px/m", angle, *fit.warnings])

    # -- health --------------------------------------------------------------------------------------------

    def health(self) -> tuple[str, str, dict[str, object]]:
        """Report rate, latency, noise and losses, and what is wrong with frames, calibration and source."""
        now = time.monotonic()
        elapsed_s, self._reported = now - self._reported, now
        report = self._diagnosis.report(elapsed_s, self._source.complaints(), self._source.silence)
        if self._chain.prediction is not None:
            self._chain.prediction.late_s = self._lateness.late_s
            self._chain.prediction.late_sd_s = self._lateness.late_sd_s
        return report.level, report.sentence, {"driver": self.rig.camera.driver, **report.values}

    def close(self) -> None:
        """End the source."""
        self._source.close()


def _answering(work: Callable[[], Awaitable[str]]) -> Callable[[Any, Any], Awaitable[Any]]:
    """Make the callback of a Trigger from work that returns its message, or raises CalibrationError with it."""

    async def answer(_request: Any, response: Any) -> Any:
        try:
            response.message, response.success = await work(), True
        except CalibrationError as err:
            response.message, response.success = str(err), False
        return response

    return answer


def main(argv: list[str] | None = None) -> int:
    """Run the node."""
    keep_freed_memory()
    widen_shared_memory(os.environ)
    return run_node(VisionTracker, argv)
