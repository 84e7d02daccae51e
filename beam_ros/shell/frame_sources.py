"""Where the tracker's frames come from: the camera's topics, or a camera that its process reads itself."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, Protocol

from beam_ros.arrays import ImageArray
from beam_ros.interfaces import graph
from beam_ros.rig.camera_sources import camera_kind
from beam_ros.shell.matched_subscription import MatchedSubscription
from beam_ros.shell.node import RigNode
from beam_ros.vision.calibration.lens import Lens
from beam_ros.vision.camera.capture import CaptureLoop
from beam_ros.vision.camera.image_messages import read_compressed_image, read_image
from beam_ros.vision.camera.source import CameraSource
from beam_ros.vision.errors import CalibrationError, ImageFormatError
from beam_ros.vision.measurement.diagnosis import Complaint

_LOOK_ROUND_S = 0.2
WAITING_FRAMES = 30
"""Frames that may wait while the process is held up: a third of a second at 100 a second."""


class FrameSink(Protocol):
    """Who takes the frames."""

    def take_frame(self, stamp_ns: int, image: ImageArray) -> None:
        """Take a frame: its stamp [ns] and its grey levels."""

    def refuse_frame(self, reason: str, stamp_ns: int | None) -> None:
        """Take note of a frame that cannot be read; None where not even its stamp can."""

    def begin_anew(self) -> None:
        """Take note that the next frame is another camera's first."""

    def set_lens(self, lens: Lens | None) -> None:
        """Take the lens whose distortion the frames have."""

    def is_heard(self) -> bool:
        """Return whether somebody listens to what becomes of the frames."""


class FrameSource(ABC):
    """Gives frames to a sink, on the node's executor."""

    silence: str
    """What to say when no frame comes and there are no complaints."""

    @abstractmethod
    def complaints(self) -> list[Complaint]:
        """Return what is wrong with the source."""

    def reset(self) -> None:  # noqa: B027 - a source may have nothing to read again
        """Read again what is read only once."""

    def close(self) -> None:  # noqa: B027 - a source may have nothing to end
        """End what the node itself does not."""


class CameraTopics(FrameSource):
    """Frames from a topic, as they are or compressed, read as bytes, and the lens from ``camera/camera_info``.

    The lens of a camera does not change from frame to frame: its topic is listened to until it has spoken, and
    again when a camera comes or ``reset`` asks for it.

    Parameters
    ----------
    node : RigNode
    sink : FrameSink
    image_size : (int, int) -- width and height that the frames should have [px]
    is_compressed : bool -- they come as JPEG or PNG
    """

    def __init__(
        self, node: RigNode, sink: FrameSink, image_size: tuple[int, int], *, is_compressed: bool
    ) -> None:
        self._log = node.get_logger()
        self._sink = sink
        self._image_size = image_size
        self._lens_trouble = ""
        self._is_lens_known = False
        self._read = read_compressed_image if is_compressed else read_image
        images = graph.TOPICS["camera/image_raw/compressed" if is_compressed else "camera/image_raw"]
        infos = graph.TOPICS["camera/camera_info"]
        self.silence = (
            f"no frames on {node.resolve_topic_name(images.name)}: start a camera, or set tracker.source"
        )
        self._images = MatchedSubscription(
            node, images, self._on_image, depth=WAITING_FRAMES, raw=True, takes_all=True
        )
        self._infos = MatchedSubscription(node, infos, self._on_info, depth=1)
        node.create_timer(_LOOK_ROUND_S, self._look_round)

    def _look_round(self) -> None:
        if self._images.follow():
            self._log.info("a camera is there")
            self._sink.begin_anew()
        if self._infos.follow(is_wanted=not self._is_lens_known):
            self._is_lens_known = False

    def _on_image(self, message: bytes) -> None:
        stamp_ns = None
        try:
            image = self._read(message)
            stamp_ns = image.stamp_ns
            grey = image.grey()
        except ImageFormatError as err:
            self._sink.refuse_frame(str(err), stamp_ns)
        else:
            self._sink.take_frame(image.stamp_ns, grey)

    def _on_info(self, info: Any) -> None:
        self._is_lens_known = True
        try:
            lens = Lens.from_camera_info(info, self._image_size)
        except CalibrationError as err:
            self._lens_trouble = f"{err}; positions are not corrected for distortion"
            self._log.error(self._lens_trouble)
            self._sink.set_lens(None)  # not the lens of the camera before
            return
        self._lens_trouble = ""
        self._sink.set_lens(lens)

    def complaints(self) -> list[Complaint]:
        """Return whether the lens cannot be used, and whether cameras disturb each other."""
        found = []
        if self._lens_trouble:
            found.append(Complaint("WARN", self._lens_trouble))
        if self._images.publishers > 1:
            found.append(
                Complaint(
                    "WARN",
                    f"{self._images.publishers} cameras publish on one topic: expected one; end the others, or move "
                    "them to a namespace",
                )
            )
        return found

    def reset(self) -> None:
        """Read the lens again, by a new subscription: what is latched comes once to each."""
        self._infos.close()
        self._is_lens_known = False


class CameraReader(FrameSource):
    """Frames from a camera that this process reads in a thread.

    Parameters
    ----------
    node : RigNode
    sink : FrameSink
    camera : CameraSource
    """

    def __init__(self, node: RigNode, sink: FrameSink, camera: CameraSource) -> None:
        self._log = node.get_logger()
        self._sink = sink
        self._camera = camera
        self._stamp = node.rig.camera.stamp
        self._said = ""
        self.silence = f"no frames from {camera.name}"
        wake = node.create_guard_condition(self._on_wake)
        self._loop = CaptureLoop(camera, node.rig.tracker.retry_period, wake.trigger)
        self._is_started = False
        self._start_timer = node.create_timer(_LOOK_ROUND_S, self._start)
        self._start()

    def _start(self) -> None:
        # A recording would be over before anybody has found this node.
        if not self._camera.is_paced or self._sink.is_heard():
            self._start_timer.cancel()
            self._is_started = True
            self._loop.start()

    def _on_wake(self) -> None:
        state = self._loop.state
        if state.sentence != self._said:
            self._said = state.sentence
            if state.phase == "failed":
                self._log.error(state.sentence)
                self._sink.begin_anew()
            else:
                self._log.info(state.sentence or "the camera gives frames")
        for frame in self._loop.take():
            self._sink.take_frame(frame.stamp_ns, frame.image)

    def complaints(self) -> list[Complaint]:
        """Return how the capture is doing."""
        if not self._is_started:
            return [
                Complaint("OK", "the video waits until somebody listens to beam/displacement or beam/markers")
            ]
        state, means = self._loop.state, self._loop.stamp_means
        found = []
        if state.phase == "failed":
            found.append(Complaint("ERROR", state.sentence))
        elif state.phase == "ended":
            found.append(Complaint("OK", state.sentence))
        else:
            found.extend(Complaint("WARN", remark) for remark in self._camera.remarks)
        if means not in (None, self._stamp):
            found.append(
                Complaint(
                    "WARN",
                    f"the stamps of {self._camera.name} mean {means}, and camera.stamp is {self._stamp}: set it to "
                    f"{means}",
                )
            )
        overruns = self._loop.take_overruns()
        if overruns:
            found.append(
                Complaint("WARN", f"{overruns} frames were not taken in time: give the computer less to do")
            )
        return found

    def close(self) -> None:
        """Stop the thread and release the camera."""
        self._loop.close()


def frame_source(node: RigNode, sink: FrameSink) -> FrameSource:
    """Begin the source that ``tracker.source`` names.

    Raises
    ------
    ParameterFileError
        There is no such kind of source.
    """
    kind = node.rig.tracker.source
    make_camera = camera_kind(kind)
    if make_camera is None:
        camera = node.rig.camera_parameters()
        return CameraTopics(node, sink, (camera.width, camera.height), is_compressed=kind == "compressed")
    return CameraReader(node, sink, make_camera(node.rig))
