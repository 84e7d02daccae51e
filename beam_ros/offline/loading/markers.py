"""The displacements of a bag's markers as outputs of a record, and the frames that it lacks."""

from __future__ import annotations

import numpy as np

from beam_ident import OutputSignal
from beam_ros.arrays import FloatArray
from beam_ros.bags.signals import Displacements
from beam_ros.rig.rig import Rig


def marker_outputs(
    displacements: Displacements, origin_ns: int, rig: Rig | None, notes: list[str]
) -> tuple[OutputSignal, ...]:
    """Return an output for every marker that was seen.

    Parameters
    ----------
    displacements : Displacements -- of all markers
    origin_ns : int -- from which instants are counted [ns]
    rig : Rig or None -- whose exposure and readout the frames have
    notes : list of str -- gets what the bag lacks
    """
    readout, exposure = (rig.camera.readout, rig.camera.exposure) if rig else (0.0, 0.0)
    times: FloatArray = np.asarray((displacements.stamps_ns - origin_ns) * 1e-9, dtype=np.float64)
    # With a rolling shutter every marker has stamps of its own: those of the first one count the frames.
    is_frame = np.isfinite(displacements.positions[:, 0]) if readout else np.ones(len(times), dtype=bool)
    lost, longest_s = _lost_frames(times[is_frame])
    if lost:
        notes.append(
            f"beam/displacement lacks {lost} of {lost + np.count_nonzero(is_frame)} frames, at the longest "
            f"{longest_s * 1e3:.3g} ms; all others were used at their own stamps"
        )
    outputs = []
    for k, name in enumerate(displacements.names):
        values = displacements.positions[:, k]
        seen = np.isfinite(values)
        if not np.any(seen):
            notes.append(f"{name} was never seen and is left out")
            continue
        missing = int(np.count_nonzero(~seen))
        # With a rolling shutter every marker has stamps of its own, and NaN at the others'.
        if missing and readout == 0.0:
            notes.append(f"{name} was not seen in {missing} of {len(values)} frames")
        outputs.append(OutputSignal(name, "m", times[seen], values[seen], exposure_s=exposure))
    return tuple(outputs)


def _lost_frames(times: FloatArray) -> tuple[int, float]:
    """Return how many frames are missing between the first and the last, and the longest time without one [s]."""
    steps = np.diff(times)
    if len(steps) < 2:
        return 0, 0.0
    # A hole longer than all that was seen is none of frames.
    steps = steps[steps <= len(steps) * np.median(steps)]
    counts = np.rint(steps / np.median(steps))
    return int(np.sum(np.maximum(counts - 1.0, 0.0))), float(np.max(steps))
