"""What a device did and measured tick by tick, and how its ticks become the batches on the topics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beam_ros.arrays import Float32Array, FloatArray, StampArray
from beam_ros.hub.contract import SampleBatch
from beam_ros.hub.parameters import AxisParameters


@dataclass(frozen=True)
class TickBatch:
    """What the axis did and measured at consecutive ticks.

    Parameters
    ----------
    first_tick : int
        Number of the first tick; tick k begins at device time ``k * period_ns``.
    applied : ndarray, shape (n_ticks,)
        Reference really applied from each tick on, in the command mode's unit.
    position_counts : ndarray of int64, shape (n_ticks,)
        Encoder at each tick [encoder_resolution].
    velocity_counts : ndarray of int64, shape (n_ticks,)
        Speed at each tick [encoder_resolution / period].
    efforts : ndarray of float32, shape (n_ticks,)
        Force on the hub from each tick on [N].
    """

    first_tick: int
    applied: FloatArray
    position_counts: StampArray
    velocity_counts: StampArray
    efforts: Float32Array

    def __len__(self) -> int:
        """Return the number of ticks."""
        return len(self.applied)

    @property
    def end_tick(self) -> int:
        """Number of the tick after the last."""
        return self.first_tick + len(self)

    @classmethod
    def join(cls, parts: Sequence[TickBatch]) -> TickBatch:
        """Return batches that follow each other as one."""
        return cls(
            parts[0].first_tick,
            np.concatenate([part.applied for part in parts]),
            np.concatenate([part.position_counts for part in parts]),
            np.concatenate([part.velocity_counts for part in parts]),
            np.concatenate([part.efforts for part in parts]),
        )

    def measured(self, period: float, resolution: float) -> tuple[FloatArray, FloatArray]:
        """Return when the ticks began [s of device time] and where the hub was then [m].

        Parameters
        ----------
        period, resolution : float
            Of a tick [s], and of the encoder [m].
        """
        numbers = np.arange(self.first_tick, self.end_tick, dtype=np.float64)
        return period * numbers, np.multiply(self.position_counts, resolution, dtype=np.float64)

    def finite_parts(self) -> list[TickBatch]:
        """Return the runs of ticks of which the device says a number that it applied."""
        is_finite = np.isfinite(self.applied)
        if np.all(is_finite):
            return [self]
        edges = np.flatnonzero(np.diff(np.concatenate([[False], is_finite, [False]])))
        return [self[start:end] for start, end in edges.reshape(-1, 2)]

    def __getitem__(self, part: slice) -> TickBatch:
        """Return some of the ticks, which must follow each other."""
        return TickBatch(
            self.first_tick + part.indices(len(self))[0],
            self.applied[part],
            self.position_counts[part],
            self.velocity_counts[part],
            self.efforts[part],
        )


def sample_batches(
    ticks: TickBatch, stamp_ns: int, epoch: int, parameters: AxisParameters
) -> tuple[SampleBatch, SampleBatch]:
    """Return a device's ticks as the batches for ``hub/applied`` and ``hub/measured``.

    Parameters
    ----------
    ticks : TickBatch
        Consecutive ticks.
    stamp_ns : int
        Host time of the first [ns, UNIX].
    epoch : int
        The device's clock epoch.
    parameters : AxisParameters
        Command mode, resolution and period.
    """
    mode = parameters.command_mode
    resolution = parameters.encoder_resolution
    applied = SampleBatch(
        stamp_ns,
        parameters.period_ns,
        epoch,
        positions=ticks.applied if mode == "position" else None,
        velocities=ticks.applied if mode == "velocity" else None,
        accelerations=ticks.applied if mode == "acceleration" else None,
        efforts=ticks.applied if mode == "effort" else None,
    )
    measured = SampleBatch(
        stamp_ns,
        parameters.period_ns,
        epoch,
        positions=np.multiply(ticks.position_counts, resolution, dtype=np.float64),
        velocities=np.multiply(ticks.velocity_counts, resolution / parameters.period, dtype=np.float64),
        efforts=ticks.efforts.astype(np.float64),
    )
    return applied, measured


class TickQueue:
    """Gathers ticks until they fill batches.

    Parameters
    ----------
    batch_ticks : int
        Ticks in a batch.
    """

    def __init__(self, batch_ticks: int) -> None:
        self._batch_ticks = batch_ticks
        self._parts: list[TickBatch] = []
        self._n_ticks = 0

    def add(self, ticks: TickBatch) -> None:
        """Take the ticks that follow those taken before."""
        if len(ticks):
            self._parts.append(ticks)
            self._n_ticks += len(ticks)

    def take_full(self) -> list[TickBatch]:
        """Return the full batches, and keep the rest."""
        size = self._batch_ticks
        n_full = self._n_ticks // size
        if not n_full:
            return []
        whole = TickBatch.join(self._parts)
        self.clear()
        self.add(whole[n_full * size :])
        return [whole[k * size : (k + 1) * size] for k in range(n_full)]

    def clear(self) -> None:
        """Forget what waits."""
        self._parts.clear()
        self._n_ticks = 0
