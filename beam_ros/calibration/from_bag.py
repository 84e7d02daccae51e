"""Calibrations from recorded bags: the reference at rest beside the markers at rest.

Wherever the reference stands still for a while, the frames at the end of that while make one point: mean position of
the reference, mean column of every marker. The reference is the hub's own encoder, or a sensor that was recorded as
a JointState, such as a laser on the beam's foot.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from beam_ros import messages
from beam_ros.arrays import FloatArray, StampArray
from beam_ros.bags.errors import BagError
from beam_ros.bags.reading import Bag
from beam_ros.errors import UsageError
from beam_ros.interfaces import graph
from beam_ros.messages import BagTypes
from beam_ros.offline.loading.described_rig import described_rig
from beam_ros.rig.rig import Rig
from beam_ros.vision.calibration.lens import Lens, lens_to_dict
from beam_ros.vision.calibration.procedure import (
    SWING_NOISES,
    SWING_PX,
    CalibrationFit,
    CalibrationProcedure,
)
from beam_ros.vision.errors import CalibrationError

HUB_ENCODER = "hub/measured"

_MIN_REST_S = 0.8
"""A reference that stands still for less is passing by."""
_MIN_FRAMES = 10
_STEP_S = 0.05
"""Motion is looked for over this time."""
_STILL_RESOLUTIONS = 4.0
"""Within so many standard deviations of the reference it stands still, ..."""
_STILL_M = 2e-6
"""... or within this [m]."""


@dataclass(frozen=True)
class Rest:
    """A while in which the reference stood still.

    Attributes
    ----------
    start_ns, end_ns : int -- [ns, UNIX]
    position_m : float -- mean position of the reference [m]
    """

    start_ns: int
    end_ns: int
    position_m: float


@dataclass(frozen=True)
class _Reference:
    name: str
    stamps_ns: StampArray
    positions: FloatArray
    sd_m: float


@dataclass(frozen=True)
class _MarkerFrames:
    """Columns of every frame: stamps (n,), u and v (n, m), NaN where a marker was not valid."""

    stamps_ns: StampArray
    u_px: FloatArray
    v_px: FloatArray


def find_rests(stamps_ns: StampArray, positions: FloatArray, tolerance_m: float) -> tuple[Rest, ...]:
    """Find where a reference stands still.

    Parameters
    ----------
    stamps_ns : ndarray of int64, shape (n,) -- rising [ns, UNIX]
    positions : ndarray, shape (n,) -- [m]
    tolerance_m : float -- what still counts as no motion [m]

    Returns
    -------
    tuple of Rest -- in the order of time
    """
    if len(stamps_ns) < 2:
        return ()
    later = np.searchsorted(stamps_ns, stamps_ns + round(_STEP_S * 1e9))
    inside = later < len(stamps_ns)
    start = np.flatnonzero(inside)
    moves = np.abs(positions[later[inside]] - positions[start]) > tolerance_m
    moving = np.zeros(len(stamps_ns), dtype=bool)
    for first, last in zip(start[moves], later[inside][moves], strict=True):
        moving[first : last + 1] = True
    # A gap is not a rest: what happened in it is unknown.
    steps = np.diff(stamps_ns)
    gaps = steps > max(_STEP_S * 1e9, 3.0 * float(np.median(steps)))
    borders = np.flatnonzero(np.diff(moving.astype(np.int8)) != 0) + 1
    borders = np.unique(np.concatenate([[0], borders, np.flatnonzero(gaps) + 1, [len(stamps_ns)]]))
    rests = []
    for first, last in itertools.pairwise(borders.tolist()):
        duration_s = (int(stamps_ns[last - 1]) - int(stamps_ns[first])) * 1e-9
        if not moving[first] and duration_s >= _MIN_REST_S:
            rests.append(
                Rest(int(stamps_ns[first]), int(stamps_ns[last - 1]), float(np.mean(positions[first:last])))
            )
    return tuple(rests)


def calibrate_from_bags(
    paths: Sequence[Path],
    *,
    rig: Rig | None = None,
    reference: str = HUB_ENCODER,
    reference_sd_m: float | None = None,
    frames: int | None = None,
    circumstances: Mapping[str, Any] | None = None,
) -> tuple[CalibrationFit, Rig]:
    """Fit a calibration to what bags hold.

    Parameters
    ----------
    paths : sequence of Path -- bags with beam/markers and the reference, in the order in which they were recorded
    rig : Rig, optional -- None: as the first bag says
    reference : str -- "hub/measured", or TOPIC or TOPIC:NAME of a JointState
    reference_sd_m : float, optional -- standard deviation of the reference [m]; None: the encoder's resolution over
        sqrt(12), and to be given for any other reference
    frames : int, optional -- frames averaged at the end of each rest; None: ``tracker.averaged_frames`` of the rig
    circumstances : mapping, optional -- date, temperature: for the provenance

    Returns
    -------
    CalibrationFit, Rig -- the rig for whose camera it holds

    Raises
    ------
    BagError, UsageError, CalibrationError
    """
    if reference != HUB_ENCODER and reference_sd_m is None:
        raise UsageError(
            f"reference {reference} comes without a standard deviation: give the sensor's with --reference-sd, in m"
        )
    procedure: CalibrationProcedure | None = None
    lens: Lens | None = None
    used: list[str] = []
    warnings: list[str] = []
    for path in paths:
        with Bag(path) as bag:
            bag.require("beam/markers")
            rig = rig or described_rig(path, bag.excitation_info() or {})
            sensor = _reference(bag, rig, reference, reference_sd_m)
            seen = _marker_frames(bag, len(rig.markers.names))
            found_lens = _lens(bag, rig)
        if procedure is None:
            procedure = CalibrationProcedure(len(rig.markers.names), rig.camera_parameters())
            lens = found_lens
        elif lens_to_dict(found_lens) != lens_to_dict(lens):
            raise CalibrationError(
                f"{path}: its camera_info states another lens than {paths[0]}; calibrate with one"
            )
        tolerance = max(_STILL_M, _STILL_RESOLUTIONS * sensor.sd_m)
        rests = find_rests(sensor.stamps_ns, sensor.positions, tolerance)
        averaged = frames or rig.tracker.averaged_frames
        count, swings = _capture(procedure, rests, seen, sensor, lens, averaged)
        if swings:
            warnings.append(
                f"{path}: {len(swings)} of {len(swings) + count} positions are left out, for the beam still swung "
                f"by up to {max(swings):.2g} px (sd) there: move with less jerk, or rest longer"
            )
        if count == 0:
            raise CalibrationError(
                warnings[-1]
                if swings
                else f"{path}: {sensor.name} rests {len(rests)} times for {_MIN_REST_S:g} s or more, and in none "
                f"of them are there {_MIN_FRAMES} frames with every marker; expected the hub to stop at several "
                "positions for a second or more each"
            )
        used.append(str(path))
    if procedure is None or rig is None:
        raise UsageError("no bag to calibrate from: name at least one")
    fit = procedure.fit(
        {
            **(circumstances or {}),
            "bags": used,
            "reference": sensor.name,
            "reference_sd_m": sensor.sd_m,
            "markers": list(rig.markers.names),
            "heights_m": list(rig.markers.heights),
            "lens": lens_to_dict(lens),
        }
    )
    return replace(fit, warnings=(*warnings, *fit.warnings)), rig


def _reference(bag: Bag, rig: Rig, reference: str, sd_m: float | None) -> _Reference:
    if reference == HUB_ENCODER:
        samples = bag.hub_samples()
        if samples.positions is None:
            raise BagError(f"{bag.path}: {samples.topic} carries no positions to calibrate against")
        seen = np.isfinite(samples.positions)
        encoder_sd = rig.hub.encoder_resolution / math.sqrt(12.0)
        return _Reference(HUB_ENCODER, samples.stamps_ns[seen], samples.positions[seen], sd_m or encoder_sd)
    topic, _, name = reference.partition(":")
    table = bag.displacements(topic)
    if name and name not in table.names:
        raise UsageError(f"{bag.path}: {topic} has no {name!r}; expected one of {', '.join(table.names)}")
    if not name and len(table.names) > 1:
        raise UsageError(
            f"{bag.path}: {topic} has {', '.join(table.names)}; say which, as --reference {topic}:{table.names[0]}"
        )
    values = table.positions[:, table.names.index(name) if name else 0]
    seen = np.isfinite(values)
    assert sd_m is not None
    return _Reference(reference, table.stamps_ns[seen], values[seen], sd_m)


def _marker_frames(bag: Bag, n_markers: int) -> _MarkerFrames:
    types = BagTypes()
    type_name = graph.TOPICS["beam/markers"].type_name
    clouds = []
    for message in bag.raw_messages("beam/markers"):
        cloud = messages.read_marker_cloud(types.deserialize(message.data, type_name))
        if len(cloud.rows) != n_markers:
            raise CalibrationError(
                f"{bag.path}: beam/markers has {len(cloud.rows)} markers; expected {n_markers}, as markers.names of "
                "the rig file: give the rig that it was recorded with (--rig-file)"
            )
        clouds.append(cloud)
    clouds.sort(key=lambda cloud: cloud.stamp_ns)
    valid = np.array([cloud.rows["valid"] for cloud in clouds], dtype=bool)
    return _MarkerFrames(
        np.array([cloud.stamp_ns for cloud in clouds], dtype=np.int64),
        np.where(valid, np.array([cloud.rows["u"] for cloud in clouds]), np.nan),
        np.where(valid, np.array([cloud.rows["v"] for cloud in clouds]), np.nan),
    )


def _lens(bag: Bag, rig: Rig) -> Lens | None:
    """Lens of the bag's first camera_info."""
    row = graph.TOPICS["camera/camera_info"]
    first = next(bag.raw_messages(row.name), None) if bag.count(row.name) else None
    if first is None:
        return None
    info: Any = BagTypes().deserialize(first.data, row.type_name)
    camera = rig.camera_parameters()
    try:
        return Lens.from_camera_info(info, (camera.width, camera.height))
    except CalibrationError as err:
        raise CalibrationError(f"{bag.path}: {err}") from err


def _capture(
    procedure: CalibrationProcedure,
    rests: Sequence[Rest],
    seen: _MarkerFrames,
    sensor: _Reference,
    lens: Lens | None,
    frames: int,
) -> tuple[int, list[float]]:
    """Capture a point of every rest that has frames; returns their number, and how rests that swing do [px]."""
    count, swings = 0, []
    u, v = (seen.u_px, seen.v_px) if lens is None else lens.undistort(seen.u_px, seen.v_px)
    whole = np.all(np.isfinite(u), axis=1)
    for rest in rests:
        chosen = np.flatnonzero((seen.stamps_ns >= rest.start_ns) & (seen.stamps_ns <= rest.end_ns) & whole)[
            -frames:
        ]
        if len(chosen) < _MIN_FRAMES:
            continue
        # The noise of a frame shows in third differences, which leave next to nothing of a swing: their
        # coefficients 1, 3, 3, 1 square to 20.
        noise = np.sqrt(np.mean(np.diff(u[chosen], n=3, axis=0) ** 2, axis=0) / 20.0)
        scatter = np.std(u[chosen], axis=0, ddof=1)
        if np.any(scatter > np.maximum(SWING_NOISES * noise, SWING_PX)):
            swings.append(float(np.max(scatter)))
            continue
        window = (sensor.stamps_ns >= seen.stamps_ns[chosen[0]]) & (
            sensor.stamps_ns <= seen.stamps_ns[chosen[-1]]
        )
        position = float(np.mean(sensor.positions[window])) if np.any(window) else rest.position_m
        procedure.capture_point(
            u[chosen],
            np.broadcast_to(np.maximum(noise, 1e-4), u[chosen].shape),
            position,
            sensor.sd_m,
            v[chosen],
        )
        count += 1
    return count, swings
