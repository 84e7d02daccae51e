"""Small bags of known content for the tests of the bags' room."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from beam_ros import messages
from beam_ros.bags.writing import BagWriter
from beam_ros.hub.contract import ClockSync, SampleBatch
from beam_ros.messages import BagTypes

START = 1_700_000_000_000_000_000
PERIOD = 1_000_000
BATCH = 20
FRAME = 10_000_000
NAMES = ("z010", "z225", "z285")
TYPES = BagTypes()


def batch(k: int, *, epoch: int = 1, **columns: np.ndarray) -> SampleBatch:
    """Batch number k of a hub that moves as position = tick * 1e-6 m."""
    ticks = np.arange(k * BATCH, (k + 1) * BATCH)
    columns = columns or {"positions": ticks * 1e-6, "velocities": np.full(BATCH, 1e-3)}
    return SampleBatch(START + k * BATCH * PERIOD, PERIOD, epoch, **columns)


def displacement_row(k: int) -> np.ndarray:
    """Displacements in frame k; the last marker is not seen in every tenth."""
    row = np.array([1e-4, 2e-4, 3e-4]) * k
    return np.where([False, False, k % 10 == 0], np.nan, row)


def write_experiment(path: Path, *, batches: int = 50, namespace: str = "", **options: object) -> Path:
    """Write a bag with everything that a simulated experiment has; a second by default."""
    with BagWriter(path, namespace=namespace, **options) as bag:
        bag.write_message("excitation/info", START, messages.json_text(TYPES, {"kind": "chirp", "seed": 1}))
        for state in ("loading", "running", "done"):
            content = {"id": "chirp-1", "state": state, "points": 1000, "reason": ""}
            bag.write_message("hub/sequence_state", START, messages.json_text(TYPES, content))
        for k in range(batches):
            now = START + (k + 1) * BATCH * PERIOD
            accelerations = np.full(BATCH, 0.1 * k)
            bag.write_batch("hub/measured", now, batch(k))
            bag.write_batch("hub/applied", now, batch(k, accelerations=accelerations))
            for frame in (2 * k, 2 * k + 1):
                stamp = START + frame * FRAME
                message = messages.displacement(TYPES, stamp, NAMES, displacement_row(frame))
                bag.write_message("beam/displacement", now, message)
            if k % 10 == 0:
                device_ns = 5_000_000_000 + round((now - START) * (1 + 35e-6))
                sync = ClockSync(now, device_ns, 1, 800_000)
                bag.write_message("hub/clock_sync", now, messages.clock_sync(TYPES, sync))
    return path
