"""The thread that reads a camera.

A camera blocks while it waits for a frame, so that it is read in a thread. ``CaptureLoop`` is that thread: it opens
what it is given, hands every frame on, and when the camera fails or vanishes it closes it and tries again, here and
nowhere else.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import cv2

from beam_ros.vision.camera.source import CameraSource, CapturedFrame
from beam_ros.vision.errors import CaptureError
from beam_ros.vision.parameters import StampMeaning

_HELD_FRAMES = 16


@dataclass(frozen=True)
class CaptureState:
    """How the capture is doing.

    Attributes
    ----------
    phase : str -- opening, running, failed or ended
    sentence : str -- why it failed, or what ended
    """

    phase: str
    sentence: str = ""


class CaptureLoop:
    """Reads a camera in a thread of its own, and opens it again when it fails.

    Parameters
    ----------
    camera : CameraSource
    retry_s : float -- between a failure and the next attempt [s]
    notify : callable -- called in the thread when frames wait to be taken, and when the state changes

    Attributes
    ----------
    state : CaptureState -- the newest one
    stamp_means : str or None -- the instant that the newest stamp is, where the camera knows
    """

    def __init__(self, camera: CameraSource, retry_s: float, notify: Callable[[], None]) -> None:
        self.state = CaptureState("opening")
        self.stamp_means: StampMeaning | None = None
        self._camera = camera
        self._retry_s = retry_s
        self._notify = notify
        self._overruns = self._overruns_before = 0
        self._waiting: deque[CapturedFrame] = deque(maxlen=_HELD_FRAMES)
        self._stop = threading.Event()
        # A device that hangs must not keep the process from ending.
        self._thread = threading.Thread(target=self._run, name=f"capture {camera.name}", daemon=True)

    def start(self) -> None:
        """Begin to read."""
        self._thread.start()

    def close(self, patience_s: float = 1.0) -> None:
        """Stop reading; a device that hangs is left to the end of the process."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(patience_s)

    def take(self) -> Iterator[CapturedFrame]:
        """Yield the frames that wait, oldest first."""
        while True:
            try:
                frame = self._waiting.popleft()
            except IndexError:
                return
            yield frame

    def take_overruns(self) -> int:
        """Return how many frames nobody took in time since the last call."""
        overruns = self._overruns  # the thread goes on counting
        fresh, self._overruns_before = overruns - self._overruns_before, overruns
        return fresh

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                self._film()
            except CaptureError as err:
                self._enter(CaptureState("failed", str(err)))
                self._stop.wait(self._retry_s)
            except Exception as err:  # noqa: BLE001 - a thread that ends on what a backend comes up with says nothing
                self._enter(
                    CaptureState(
                        "failed",
                        f"camera {self._camera.name} failed ({type(err).__name__}: {err}): expected frames; it is "
                        f"opened again every {self._retry_s:g} s, see whether another program can read it",
                    )
                )
                self._stop.wait(self._retry_s)
            else:
                return
            finally:
                with contextlib.suppress(cv2.error):
                    self._camera.close()

    def _film(self) -> None:
        """Open the camera and read it until it ends or fails."""
        self._camera.open()
        self._enter(CaptureState("running"))
        count = 0
        while not self._stop.is_set():
            frame = self._camera.read()
            if frame is None:
                self._enter(CaptureState("ended", f"{self._camera.name} has ended after {count} frames"))
                return
            if self._camera.is_paced:
                self._stop.wait(max(0, frame.stamp_ns - time.time_ns()) * 1e-9)
                while len(self._waiting) == _HELD_FRAMES and not self._stop.is_set():
                    self._stop.wait(0.002)  # a file can wait, where a camera cannot
            count += 1
            self.stamp_means = frame.stamp_means
            self._overruns += len(self._waiting) == _HELD_FRAMES
            self._waiting.append(frame)
            self._notify()

    def _enter(self, state: CaptureState) -> None:
        if state != self.state:
            self.state = state
            self._notify()
