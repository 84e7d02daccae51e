"""The node `tracker`: frames in, sub-pixel displacements of the markers out."""

from __future__ import annotations

import math
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.task import Future

from beam_ros import interfaces, messages
from beam_ros.nodes.shell import RigNode, qos_profile, run_node
from beam_ros.vision.calibration import CalibrationProcedure, LinearCalibration
from beam_ros.vision.errors import CalibrationError, ImageFormatError
from beam_ros.vision.images import grey_image
from beam_ros.vision.storage import load_calibration, save_calibration
from beam_ros.vision.timing import FrameTiming
from beam_ros.vision.tracking import FrameResult, MarkerTracker

_AVERAGED_FRAMES = 100
_PATIENCE_S = 5.0
_LOOK_FOR_CAMERA_S = 0.2


@dataclass
class _Average:
    """Frames that a service waits for."""

    deadline: float
    future: Future
    columns: list[list[float]] = field(default_factory=list)
    sigmas: list[list[float]] = field(default_factory=list)


class VisionTracker(RigNode):
    """Follows the markers in `camera/image_raw` and publishes where they are."""

    def __init__(self) -> None:
        super().__init__("vision_tracker")
        rig, camera = self.rig, self.rig.camera_parameters()
        self._names = rig.marker_names
        self._heights = np.asarray(rig.numbers("markers.heights"))
        self._tracker = MarkerTracker(rig.tracker_parameters(), len(self._names), FrameTiming(camera))
        self._image_size = (camera.width, camera.height)
        self._calibration = self._first_calibration()
        self._procedure = CalibrationProcedure(len(self._names), self._image_size)
        self._averages: list[_Average] = []
        self._hub_position = math.nan
        self._counts: Counter[str] = Counter()
        self._frames_before = 0
        self._trouble = ""
        self._displacement = self.offer("beam/displacement")
        self._markers = self.offer("beam/markers")
        self.listen("hub/state", self._on_hub_state)
        self.serve("tracker/reset", self._on_reset)
        # These wait for the frames that they average; in a group of their own they keep nothing else waiting.
        group = ReentrantCallbackGroup()
        self.serve("tracker/tare", self._on_tare, callback_group=group)
        self.serve("tracker/capture_point", self._on_capture_point, callback_group=group)
        self.create_timer(0.1, self._end_overdue_averages)
        self.serve("tracker/fit_calibration", self._on_fit_calibration)
        self._camera_search = self.create_timer(_LOOK_FOR_CAMERA_S, self._look_for_camera)

    def _first_calibration(self) -> LinearCalibration:
        path = self.rig.text("tracker.calibration")
        if not path:
            return LinearCalibration.from_camera(self.rig.camera_parameters(), len(self._names))
        calibration = load_calibration(Path(path))
        calibration.require_camera(*self._image_size)
        return calibration

    def _look_for_camera(self) -> None:
        """Subscribe as soon as a camera is there, with the reliability that it offers."""
        row = interfaces.TOPICS["camera/image_raw"]
        offers = self.get_publishers_info_by_topic(self.resolve_topic_name(row.name))
        if not offers:
            return
        profile: QoSProfile = qos_profile(row.qos)
        if any(offer.qos_profile.reliability != ReliabilityPolicy.RELIABLE for offer in offers):
            profile.reliability = ReliabilityPolicy.BEST_EFFORT
        self.create_subscription(self.types.message_class(row.type_name), row.name, self._on_image, profile)
        self._camera_search.cancel()
        self.get_logger().info(f"camera found on {row.name}")

    def _on_hub_state(self, message: Any) -> None:
        self._hub_position = messages.read_hub_state(message).position

    def _on_image(self, message: Any) -> None:
        stamp_ns = messages.stamp_ns(message)
        self._counts["frames"] += 1
        try:
            grey = grey_image(
                message.encoding,
                message.height,
                message.width,
                message.step,
                message.data,
                is_bigendian=bool(message.is_bigendian),
            )
            self._calibration.require_camera(message.width, message.height)
            result = self._tracker.process(grey, stamp_ns)
        except (ImageFormatError, CalibrationError) as err:
            self._counts["unusable frames"] += 1
            self._trouble = str(err)
            self.get_logger().error(self._trouble, throttle_duration_sec=5.0)
            nothing = np.full(len(self._names), math.nan)
            self._displacement.publish(messages.displacement(self.types, stamp_ns, self._names, nothing))
            return
        self._trouble = ""
        self._publish(result)

    def _publish(self, result: FrameResult) -> None:
        columns = [marker.u_px for marker in result.markers]
        sigmas = [marker.sigma_px for marker in result.markers]
        for average in list(self._averages):
            average.columns.append(columns)
            average.sigmas.append(sigmas)
            if len(average.columns) >= _AVERAGED_FRAMES:
                self._end_average(average)
        found = self._calibration.displacement(columns, sigmas)
        stamps = [marker.stamp_ns for marker in result.markers]
        for stamp_ns in sorted(set(stamps)):
            chosen = [k for k, stamp in enumerate(stamps) if stamp == stamp_ns]
            names = [self._names[k] for k in chosen]
            self._displacement.publish(messages.displacement(self.types, stamp_ns, names, found.x_m[chosen]))
        rows = np.zeros(len(self._names), dtype=messages.MARKER_DTYPE)
        rows["x"], rows["z"] = found.x_m, self._heights
        rows["x_m"], rows["sigma_m"] = found.x_m, found.sigma_m
        rows["u"], rows["v"] = columns, [marker.v_px for marker in result.markers]
        rows["id"] = np.arange(len(self._names))
        rows["valid"] = [marker.is_valid for marker in result.markers]
        self._markers.publish(messages.marker_cloud(self.types, messages.MarkerCloud(result.stamp_ns, rows)))
        for name, marker in zip(self._names, result.markers, strict=True):
            if not marker.is_valid:
                self._counts[f"{name} {marker.reason}"] += 1

    def _on_reset(self, _request: Any, response: Any) -> Any:
        self._tracker.reset()
        response.success, response.message = True, "markers are acquired anew"
        return response

    async def _next_frames(self) -> _Average:
        """Wait for the frames from now on, so that an average never reaches back to another position."""
        average = _Average(time.monotonic() + _PATIENCE_S, Future())
        self._averages.append(average)
        await average.future
        if len(average.columns) < _AVERAGED_FRAMES:
            raise CalibrationError(
                f"{len(average.columns)} frames in {_PATIENCE_S:g} s; expected {_AVERAGED_FRAMES}: is a camera "
                "publishing on camera/image_raw?"
            )
        return average

    def _end_average(self, average: _Average) -> None:
        self._averages.remove(average)
        average.future.set_result(None)

    def _end_overdue_averages(self) -> None:
        now = time.monotonic()
        for average in [average for average in self._averages if now > average.deadline]:
            self._end_average(average)

    async def _on_tare(self, _request: Any, response: Any) -> Any:
        try:
            frames = await self._next_frames()
            # u is absolute: where the hub stands away from home, the markers' zero is that much further back.
            away_m = 0.0 if math.isnan(self._hub_position) else self._hub_position
            scales = np.asarray(self._calibration.pixels_per_metre) * self._calibration.direction
            columns = np.asarray(frames.columns) - scales * away_m
            self._calibration = self._calibration.tare(columns, frames.sigmas)
            response.success = True
            response.message = f"zero from {len(frames.columns)} frames, the hub at {away_m * 1e3:+.3f} mm"
        except CalibrationError as err:
            response.success, response.message = False, str(err)
        return response

    async def _on_capture_point(self, _request: Any, response: Any) -> Any:
        encoder_sd = self.rig.number("hub.encoder_resolution") / math.sqrt(12.0)
        try:
            frames = await self._next_frames()
            self._procedure.capture_point(frames.columns, frames.sigmas, self._hub_position, encoder_sd)
            response.success = True
            response.message = f"point {len(self._procedure.points)} at {self._hub_position:.6f} m"
        except CalibrationError as err:
            response.success, response.message = False, str(err)
        return response

    def _on_fit_calibration(self, _request: Any, response: Any) -> Any:
        try:
            fit = self._procedure.fit({"reference": "hub/state", "markers": list(self._names)})
            path = self.rig.text("tracker.save_calibration")
            if path:
                save_calibration(fit.calibration, Path(path))
        except CalibrationError as err:
            response.success, response.message = False, str(err)
            return response
        self._calibration = fit.calibration
        scales = ", ".join(f"{scale:.2f}" for scale in fit.calibration.pixels_per_metre)
        warnings = "; ".join(fit.warnings)
        response.success = True
        response.message = f"{scales} px/m{f'; {warnings}' if warnings else ''}"
        self._procedure.clear()
        return response

    def health(self) -> tuple[str, str, dict[str, object]]:
        """Report the frame rate, lost markers, and what is wrong with the frames."""
        frames = self._counts["frames"]
        rate, self._frames_before = frames - self._frames_before, frames
        counters: dict[str, object] = {**self._counts, "frames in the last second": rate}
        if self._trouble:
            return "ERROR", self._trouble, counters
        if rate == 0:
            return "WARN", "no frames on camera/image_raw", counters
        if not self._tracker.is_acquired:
            return "WARN", "not every marker is in sight", counters
        return "OK", f"{len(self._names)} markers in sight", counters


def main(argv: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(VisionTracker, argv)
