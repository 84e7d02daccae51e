"""Averages over the frames to come, for services that wait for them without keeping anything else waiting."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.task import Future

from beam_ros.shell.frame_sources import WAITING_FRAMES
from beam_ros.shell.node import RigNode
from beam_ros.vision.errors import CalibrationError
from beam_ros.vision.measurement.measuring_chain import Measurement

_PATIENCE_S = 5.0
_PATIENCE_PERIODS = 3.0
"""After so long without a frame no more is waited for; a busy computer loses some, and takes longer for the rest."""


@dataclass
class FrameAverage:
    """Frames that a service waits for.

    Attributes
    ----------
    patience_s, deadline : float -- longest wait for the next frame, and when it ends, on the steady clock [s]
    columns, sigmas, across : list of list of float -- a row per frame, a column per marker: position along the hub's
        travel without the lens's distortion, its standard deviation, and position across the travel; NaN where a
        marker was not seen [px]
    """

    patience_s: float
    deadline: float
    future: Future
    to_skip: int = WAITING_FRAMES
    columns: list[list[float]] = field(default_factory=list)
    sigmas: list[list[float]] = field(default_factory=list)
    across: list[list[float]] = field(default_factory=list)


class FrameAveraging:
    """Hands the frames from now on to those who wait for them.

    Parameters
    ----------
    node : RigNode -- whose executor runs the services

    Attributes
    ----------
    group : ReentrantCallbackGroup -- for the services that wait
    """

    def __init__(self, node: RigNode) -> None:
        self._node = node
        self._averages: list[FrameAverage] = []
        self.group = ReentrantCallbackGroup()
        node.create_timer(0.1, self._end_overdue)

    async def next_frames(self) -> FrameAverage:
        """Wait for the frames from now on, so that an average never reaches back to another position.

        As many frames as may have waited for this process when it was asked are left out first.

        Raises
        ------
        CalibrationError
            They do not come.
        """
        wanted = self._node.rig.tracker.averaged_frames
        patience_s = max(_PATIENCE_S, _PATIENCE_PERIODS / self._node.rig.camera.rate)
        average = FrameAverage(patience_s, time.monotonic() + patience_s, Future())
        self._averages.append(average)
        await average.future
        if len(average.columns) < wanted:
            raise CalibrationError(
                f"{len(average.columns)} frames came, then none for {patience_s:g} s; expected {wanted}: is there a "
                "camera? See /diagnostics"
            )
        return average

    def add(self, measurement: Measurement) -> None:
        """Hand a frame to those who wait."""
        wanted = self._node.rig.tracker.averaged_frames
        for average in list(self._averages):
            average.deadline = time.monotonic() + average.patience_s
            if average.to_skip > 0:
                average.to_skip -= 1
                continue
            average.columns.append(measurement.corrected_px.tolist())
            average.sigmas.append(measurement.sigma_px.tolist())
            average.across.append(measurement.across_px.tolist())
            if len(average.columns) >= wanted:
                self._end(average)

    def _end(self, average: FrameAverage) -> None:
        self._averages.remove(average)
        average.future.set_result(None)

    def _end_overdue(self) -> None:
        now = time.monotonic()
        for average in [average for average in self._averages if now > average.deadline]:
            self._end(average)
