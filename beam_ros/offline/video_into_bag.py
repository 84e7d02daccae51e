"""A video that a camera left behind becomes displacements in the bag of its experiment.

The markers are tracked through the file; the low marker, which moves as the hub does, gives the camera's time in the
hub's; displacements and markers are then written where a camera on the graph would have put them, so that the bag
identifies like any other. The bag is written anew beside the old one and takes its name only when it is whole; the
old one stays under another name.
"""

from __future__ import annotations

import math
import shutil
import tempfile
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from beam_ros import messages
from beam_ros.arrays import StampArray
from beam_ros.bags.errors import BagError, BagExistsError
from beam_ros.bags.reading import Bag
from beam_ros.bags.signals import HubSamples
from beam_ros.bags.writing import BagWriter
from beam_ros.errors import UsageError
from beam_ros.interfaces import graph
from beam_ros.messages import BagTypes
from beam_ros.offline.loading.described_rig import described_rig
from beam_ros.offline.loading.experiment import VIDEO_TOPIC
from beam_ros.offline.tracked_film import TrackedVideo, Watch, track_video
from beam_ros.rig.rig import Rig
from beam_ros.vision.calibration.linear import LinearCalibration
from beam_ros.vision.camera.video import VideoFile, read_frame_times
from beam_ros.vision.errors import SynchronisationError
from beam_ros.vision.measurement.frame_losses import FilmTimes, time_film

Progress = Callable[[str, float], None]

_MADE_ANEW = ("beam/displacement", "beam/markers", VIDEO_TOPIC)
_GAIN_TOLERANCE = 0.03
_RATE_TOLERANCE = 0.01
"""Rates of 29.97 and 30 frames a second are one."""
_LARGE_SD_S = 0.2e-3
"""A time known no better than this is reported: it turns the phase of a mode at 28 Hz by 2 degrees."""


def synchronise_with_hub(
    tracked: TrackedVideo, hub: HubSamples, *, has_exact_rate: bool = False
) -> FilmTimes:
    """Find when every frame was taken, by the hub's motion that the film shows.

    Parameters
    ----------
    tracked : TrackedVideo
    hub : HubSamples -- ``hub/measured`` with positions
    has_exact_rate : bool -- the frame times run as the hub's do: only the offset is fitted

    Returns
    -------
    FilmTimes -- between the camera's times, lost frames counted in, and seconds since the first sample of the hub

    Raises
    ------
    SynchronisationError
        The records do not resemble each other, or nobody can tell when the frames were taken.
    BagError
        The hub has no positions.
    """
    if hub.positions is None:
        raise BagError(
            f"{hub.topic} carries no positions: expected them to synchronise the video by; record the hub's encoder"
        )
    # Nobody knows what the hub did in a gap: its longest stretch without one decides.
    borders = [int(np.searchsorted(hub.stamps_ns, gap.end_ns)) for gap in hub.gaps]
    first, last = max(pairwise([0, *borders, len(hub.stamps_ns)]), key=lambda piece: piece[1] - piece[0])
    seen = np.isfinite(hub.positions)
    seen[:first] = seen[last:] = False
    n_high = len(tracked.names)
    return time_film(
        (hub.stamps_ns[seen] - hub.stamps_ns[0]) * 1e-9,
        hub.positions[seen],
        (tracked.times_ns[:, 0] - tracked.times_ns[0, 0]) * 1e-9,
        tracked.hub_m,
        period_s=tracked.period_s,
        high_markers_m=tracked.x_m[:, [(2 * n_high) // 3, n_high - 1]] if n_high > 1 else None,
        fits_drift=not has_exact_rate,
        fits_lag=tracked.is_predicted,
    )


def bag_rig(path: Path) -> Rig:
    """Build the rig that a bag describes.

    Raises
    ------
    BagError, UsageError
        There is no bag, or it describes no rig.
    """
    with Bag(path) as bag:
        return described_rig(path, bag.excitation_info() or {})


def track_into_bag(
    video_path: Path,
    bag_path: Path,
    *,
    target: Path | None = None,
    rig: Rig | None = None,
    rate_hz: float | None = None,
    times_path: Path | None = None,
    calibration: LinearCalibration | None = None,
    has_exact_rate: bool = False,
    replaces: bool = False,
    is_whole: bool = False,
    row_step: int = 10,
    watch: Watch | None = None,
    progress: Progress = lambda phrase, share: None,
) -> dict[str, Any]:
    """Track a video and put its displacements into a bag.

    Parameters
    ----------
    video_path, bag_path : Path -- the video, and the bag with ``hub/measured`` of the same experiment
    target : Path, optional -- a new bag to write; None: the bag itself, whose old form is kept beside it
    rig : Rig, optional -- None: as the bag says
    rate_hz : float, optional -- frames per second; None: as the file says
    times_path : Path, optional -- file with the time of every frame; comes before any rate
    calibration : LinearCalibration, optional -- None: the one that the rig names (``tracker.calibration``), else its
        nominal scale
    has_exact_rate : bool -- do not fit the rate of the camera's clock
    replaces : bool -- leave out displacements that the bag has already, instead of refusing it
    is_whole : bool -- follow the strip at every ``row_step`` rows, not the markers
    watch : callable, optional -- given every frame of the markers, measured
    progress : callable -- called with a phrase and the share done

    Returns
    -------
    dict -- what ``beam track --json`` prints

    Raises
    ------
    BagError, UsageError, VisionError
        Nothing is written and the bag is as it was.
    """
    times_ns = None if times_path is None else read_frame_times(times_path)
    video = VideoFile(video_path, rate_hz=rate_hz, frame_times_ns=times_ns, heeds_decoder=True)
    if target is None and not bag_path.is_dir() and bag_path.exists():
        raise UsageError(f"{bag_path} is a single file: expected a bag's folder; give a new bag with --out")
    if target is not None and target.exists():
        raise BagExistsError(f"{target} exists already: expected a new path; give another --out")
    with Bag(bag_path) as bag:
        bag.require("hub/measured")
        if not replaces and bag.count("beam/displacement"):
            raise UsageError(
                f"{bag_path} has {bag.count('beam/displacement')} messages on beam/displacement already: expected a "
                "bag without; --replace leaves these out"
            )
        rig = rig or described_rig(bag_path, bag.excitation_info() or {})
        hub = bag.hub_samples()
    tracked = track_video(
        video,
        rig,
        calibration,
        lambda share: progress("tracking", share),
        is_whole=is_whole,
        row_step=row_step,
        watch=watch,
    )
    try:
        found = synchronise_with_hub(tracked, hub, has_exact_rate=has_exact_rate)
    except SynchronisationError as err:
        said = [str(err), *_other_rate(video, rig.camera_parameters().rate_hz), *tracked.notes]
        raise SynchronisationError("; ".join(said)) from err
    tracked = _by_the_hubs_clock(tracked, found, int(hub.stamps_ns[0]))
    summary = _summary(video, tracked, found)
    progress("writing the bag", 1.0)
    written, original = _write(bag_path, target, tracked, summary)
    return {"bag": str(written), "original": str(original), **summary}


def _by_the_hubs_clock(tracked: TrackedVideo, found: FilmTimes, hub_start_ns: int) -> TrackedVideo:
    """Return the record with the times [ns, UNIX] that the hub's stamps have, without frames that have none."""
    first_ns = int(tracked.times_ns[0, 0])
    late_ns = np.rint(found.lost * (tracked.period_s or 0.0) * 1e9).astype(np.int64)

    def mapped(times_ns: StampArray) -> StampArray:
        seconds = found.synchronisation.hub_times((times_ns - first_ns) * 1e-9)
        return np.asarray(hub_start_ns + np.rint(seconds * 1e9).astype(np.int64))

    return replace(
        tracked.without(~found.is_timed, "untimed"),
        frame_times_ns=mapped(tracked.frame_times_ns + late_ns),
        times_ns=mapped(tracked.times_ns + late_ns[:, None]),
    )


def _other_rate(video: VideoFile, rate_hz: float) -> Iterator[str]:
    """Say that a film's rate is not the camera's, as where it is stored for replay in slow motion."""
    if abs(video.rate_hz / rate_hz - 1) > _RATE_TOLERANCE:
        yield (
            f"the film was taken to run at {video.rate_hz:.6g} frames/s, and camera.rate is {rate_hz:g} Hz: give the "
            "rate at which it was filmed with --rate, where the file states that of a replay"
        )


def _film_notes(tracked: TrackedVideo, times: FilmTimes) -> Iterator[str]:
    found = times.synchronisation
    n_frames = len(times.lost)
    if times.n_lost:
        yield (
            f"the camera dropped {times.n_lost} frames that the file does not tell of; the hub's motion told where, "
            "and the frames behind were given their right times"
        )
    untimed = n_frames - int(np.count_nonzero(times.is_timed))
    if untimed:
        is_told = float(np.max(np.diff(tracked.frame_times_ns))) * 1e-9 > 1.5 * (tracked.period_s or math.inf)
        remedy = "--times" if is_told else "a container with frame times (Matroska, MP4) or --times"
        yield (
            f"nobody can tell when {untimed} of {n_frames} frames were taken, for the hub and the beam hardly moved "
            f"beside a lost frame: they are marked as not seen; {remedy} would keep them"
        )
    if abs(found.gain - 1) > _GAIN_TOLERANCE:
        yield (
            f"the low marker moves {found.gain:.3f} times as far as the hub: the scale is not right; calibrate, or "
            "correct camera.pixels_per_metre"
        )
    if times.time_sd_s > _LARGE_SD_S:
        where = "beginning" if found.offset_sd_s >= times.time_sd_s else "end"
        remedy = "let the hub move more, or film it longer"
        if tracked.is_predicted:
            remedy += ", with less compression"
        if found.drift_sd > 0:
            remedy += "; --exact-rate where the frame times are exact"
        yield (
            f"the video's time in the hub's is known to +- {times.time_sd_s * 1e3:.2g} ms at its {where}; expected "
            f"{_LARGE_SD_S * 1e3:g} ms or less: {remedy}"
        )


def _summary(video: VideoFile, tracked: TrackedVideo, times: FilmTimes) -> dict[str, Any]:
    found = times.synchronisation
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        sigma = np.sqrt(np.nanmean(tracked.sigma_m**2, axis=0))
    points = (
        {"points": {"names": list(tracked.names), "heights_m": np.round(tracked.heights, 6).tolist()}}
        if tracked.is_whole
        else {}
    )
    return {
        "video": str(video.path),
        "frames": len(tracked.times_ns),
        "rate_hz": video.rate_hz if math.isfinite(video.rate_hz) else None,
        "turned": video.is_turned,
        "lost": times.n_lost,
        "untimed": len(times.lost) - int(np.count_nonzero(times.is_timed)),
        "damaged": int(np.count_nonzero(video.damaged_frames(len(tracked.times_ns)))),
        **points,
        "markers": {
            name: {"seen": counts.get("ok", 0), "sigma_m": float(s), "reasons": counts}
            for name, counts, s in zip(tracked.names, tracked.reasons, sigma, strict=True)
        },
        "synchronisation": {
            "offset_s": found.offset_s,
            "offset_sd_s": found.offset_sd_s,
            "drift": found.drift,
            "drift_sd": found.drift_sd,
            "time_sd_s": times.time_sd_s,
            "lag_m": found.lag_m,
            "lag_sd_m": found.lag_sd_m,
            "gain": found.gain,
            "zero_m": found.zero_m,
            "correlation": found.correlation,
            "residual_rms_m": found.residual_rms_m,
            "frames": found.n_frames,
            "jitter_s": times.jitter_s,
        },
        "notes": [*tracked.notes, *_film_notes(tracked, times)],
    }


# --- the bag ---------------------------------------------------------------------------------------------


def _write(
    source: Path,
    target: Path | None,
    tracked: TrackedVideo,
    summary: dict[str, Any],
) -> tuple[Path, Path]:
    """Write the bag beside its place, then put it there; returns where it and the old one are."""
    source = source.resolve()
    place = source if target is None else target
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        folder = Path(tempfile.mkdtemp(prefix=f".{place.name}-", dir=place.parent))
    except OSError as err:
        raise BagError(f"cannot write beside {place}: {err.strerror or err}; give another --out") from err
    try:
        draft = folder / place.name
        with Bag(source) as bag, BagWriter(draft, namespace=bag.namespace) as writer:
            _copy_with_video(bag, writer, tracked, summary)
        kept = source
        if target is None:
            kept = _free_name(source)
            source.rename(kept)
            try:
                draft.rename(source)
            except OSError:
                kept.rename(source)
                raise
        else:
            draft.rename(place)
    except OSError as err:
        if isinstance(err, BagError):
            raise
        raise BagError(f"cannot write {place}: {err.strerror or err}; the old bag is whole") from err
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return place, kept


def _free_name(path: Path) -> Path:
    """First free name for the bag as it was: ``<bag>_untracked``, then with a number."""
    resolved = path.resolve()
    for number in range(1, 1000):
        name = f"{resolved.name}_untracked{'' if number == 1 else number}"
        if not resolved.with_name(name).exists():
            return resolved.with_name(name)
    raise UsageError(f"{path} has been kept a thousand times as {resolved.name}_untracked..; remove some")


def _copy_with_video(
    bag: Bag,
    writer: BagWriter,
    tracked: TrackedVideo,
    summary: dict[str, Any],
) -> None:
    """Copy what the bag holds and put the video's messages between, each at its own time."""
    made_anew = {bag.full_name(topic) for topic in _MADE_ANEW}
    of_table = {bag.full_name(name): name for name in graph.TOPICS}
    for row in bag.topics:
        if row.name not in made_anew:
            writer.add_topic(of_table.get(row.name, row.name), row.type_name)
    types = BagTypes()
    pending = _video_messages(types, tracked)
    upcoming = next(pending, None)
    writer.add_topic(VIDEO_TOPIC, graph.STRING, (graph.QualityOfService(depth=1, is_latched=True),))
    writer.write_message(VIDEO_TOPIC, bag.start_ns, messages.json_text(types, summary))
    for message in bag.raw_messages():
        while upcoming is not None and upcoming[1] <= message.receive_ns:
            writer.write_message(*upcoming)
            upcoming = next(pending, None)
        if message.topic not in made_anew:
            writer.write(of_table.get(message.topic, message.topic), message.receive_ns, message.data)
    while upcoming is not None:
        writer.write_message(*upcoming)
        upcoming = next(pending, None)


def _video_messages(types: BagTypes, tracked: TrackedVideo) -> Iterator[tuple[str, int, Any]]:
    """Yield topic, time and message of every frame, in the order of time."""
    for k, (frame_ns, stamps) in enumerate(
        zip(tracked.frame_times_ns.tolist(), tracked.times_ns.tolist(), strict=True)
    ):
        for stamp_ns, message in messages.displacement_messages(types, tracked.names, stamps, tracked.x_m[k]):
            yield "beam/displacement", stamp_ns, message
        message = messages.marker_cloud_from_columns(
            types,
            frame_ns,
            tracked.heights,
            tracked.x_m[k],
            tracked.sigma_m[k],
            tracked.u_px[k],
            tracked.v_px[k],
        )
        yield "beam/markers", max(stamps), message
