"""A film becomes a record: displacements in metres by the camera's clock, of its markers or of the whole strip.

Frames that the decoder complained about, frames in which the picture broke for one frame only, and frames that show
the image of another one, are marked: what the tracker found there is no measurement.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from beam_ros.arrays import FloatArray, ImageArray, StampArray
from beam_ros.offline.whole_beam import FollowedPoints, follow_strip
from beam_ros.rig.beam_line import marker_shape_fitter
from beam_ros.rig.rig import Rig
from beam_ros.vision.calibration.lens import Lens
from beam_ros.vision.calibration.linear import LinearCalibration
from beam_ros.vision.calibration.storage import load_calibration
from beam_ros.vision.camera.video import VideoFile
from beam_ros.vision.errors import CalibrationError, VideoError, VisionParameterError
from beam_ros.vision.fields import DEINTERLACE
from beam_ros.vision.measurement.measuring_chain import Measurement, MeasuringChain
from beam_ros.vision.measurement.repeated_frames import find_repeated_frames
from beam_ros.vision.mosaic import UNDO
from beam_ros.vision.parameters import CameraParameters
from beam_ros.vision.tracking.acquisition import FULL_DISCS

Watch = Callable[[MeasuringChain, ImageArray, Measurement], None]
"""Called with every frame of the markers when it is measured."""

_MIN_SEEN = _MAX_DAMAGED = 0.5


@dataclass(frozen=True)
class TrackedVideo(FollowedPoints):
    """The markers of a whole video, or points of its strip, in metres, by the camera's clock.

    Attributes
    ----------
    names, heights, frame_times_ns, times_ns, u_px, v_px, x_m, sigma_m, reasons, is_repeated -- as of
        ``FollowedPoints``
    notes : tuple of str -- what a reader should know
    hub_m : ndarray, shape (n,) -- the hub's position, as all markers of a frame show it [m]; NaN where too few do
    period_s : float or None -- time between frames, of which some may be missing; None where every frame has a
        time of its own
    is_whole : bool -- points of the strip, not markers
    is_predicted : bool -- a codec kept what changes from frame to frame
    """

    notes: tuple[str, ...]
    hub_m: FloatArray
    period_s: float | None
    is_whole: bool = False
    is_predicted: bool = False

    def without(self, frames: np.ndarray, reason: str) -> TrackedVideo:
        """Return the record with some frames not seen.

        Parameters
        ----------
        frames : ndarray of bool, shape (n,)
        reason : str -- why
        """
        if not np.any(frames):
            return self
        blank = np.where(frames, np.nan, 0.0)
        lost = np.count_nonzero(np.isfinite(self.x_m) & frames[:, None], axis=0)
        reasons = tuple(
            {**counts, "ok": counts.get("ok", 0) - int(n), reason: counts.get(reason, 0) + int(n)}
            for counts, n in zip(self.reasons, lost, strict=True)
        )
        columns = blank[:, None]
        return replace(
            self,
            u_px=self.u_px + columns,
            x_m=self.x_m + columns,
            sigma_m=self.sigma_m + columns,
            hub_m=self.hub_m + blank,
            reasons=reasons,
        )


def track_video(
    video: VideoFile,
    rig: Rig,
    calibration: LinearCalibration | None = None,
    progress: Callable[[float], None] = lambda share: None,
    *,
    is_whole: bool = False,
    row_step: int = 10,
    watch: Watch | None = None,
) -> TrackedVideo:
    """Track the rig's markers, or the whole strip, through a video.

    Parameters
    ----------
    video : VideoFile
    rig : Rig -- its camera and markers
    calibration : LinearCalibration, optional -- None: the one that the rig names, else its nominal scale
    progress : callable -- told the share done
    is_whole : bool -- follow the strip at every ``row_step`` rows, not the markers
    watch : callable, optional -- given every frame of the markers, measured

    Returns
    -------
    TrackedVideo

    Raises
    ------
    VideoError
        The video has another size than the rig's camera, or shows none of the low marker or the strip.
    CalibrationError
        The calibration was made for another camera, image size or number of markers; or the one that the rig names
        cannot be read.
    VisionParameterError
        The exposure is longer than a frame.
    """
    camera = rig.camera_parameters()
    if (video.width, video.height) != (camera.width, camera.height):
        remedy = "give its rig file with --rig-file, or -p camera.width:=.. -p camera.height:=.."
        if (video.height, video.width) == (camera.width, camera.height):
            remedy = (
                f"turn a film that lies on its side (`ffmpeg -i FILE -vf transpose=1 ..`, or 2), or {remedy}"
            )
        raise VideoError(
            f"{video.path}: is {video.width} x {video.height}; expected {camera.width} x {camera.height}, the rig's "
            f"camera: {remedy}"
        )
    if math.isfinite(video.rate_hz):
        try:
            camera = replace(camera, rate_hz=video.rate_hz)
        except VisionParameterError as err:
            raise VisionParameterError(
                f"{video.path}: at {video.rate_hz:g} frames/s, {err} (-p camera.exposure:=..)"
            ) from err
    if calibration is None and rig.tracker.calibration:
        calibration = load_calibration(Path(rig.tracker.calibration))
    if is_whole:
        tracked = follow_strip(video, camera, rig.beam.length, rig.markers, calibration, row_step, progress)
        notes = [f"the strip was followed at {len(tracked.names)} heights, every {row_step} rows"]
    else:
        tracked, notes = _track_markers(video, camera, rig, calibration, progress, watch)
    damaged = video.damaged_frames(len(tracked.times_ns))
    if np.mean(damaged) > _MAX_DAMAGED:
        raise VideoError(
            f"{video.path}: {np.count_nonzero(damaged)} of {damaged.size} frames are damaged, as the decoder says "
            f"(first: {video.first_complaint}); expected fewer than half: copy the file again from the camera, or "
            f"deinterlace it where it is interlaced ({DEINTERLACE})"
        )
    if not is_whole and not tracked.reasons[0].get("ok"):
        remedies = {
            "mosaic": f"grey or colour images, no raw mosaic of a colour sensor: {UNDO}",
            "ring": FULL_DISCS,
            "out_of_round": "; ".join(note for note in notes if "tracker.aspect" in note),
        }
        elsewhere = (
            "it where the rig file puts it: check markers.heights, markers.diameter, camera.origin_u and "
            "origin_v, camera.pixels_per_metre and tracker.polarity"
        )
        remedy = next((remedies[reason] for reason in remedies if reason in tracked.reasons[0]), elsewhere)
        raise VideoError(
            f"{video.path}: the low marker {tracked.names[0]} is in none of {len(tracked.times_ns)} frames "
            f"({_in_words(tracked.reasons[0])}); expected {remedy}"
        )
    times, period_s, said = video.settled_times(tracked.frame_times_ns)
    notes += said
    tracked, is_wrong, said = _with_repeated_images(tracked, times)
    # A file counts frames by its duration, those that are missing among them.
    n_spanned = 0 if period_s is None else round(float(times[-1] - times[0]) * 1e-9 / period_s) + 1
    notes += [*_remarks(video, tracked.names, tracked.reasons, len(times), n_spanned), *said]
    record = TrackedVideo(
        tracked.names,
        tracked.heights,
        times,
        tracked.times_ns + (times - tracked.frame_times_ns)[:, None],
        tracked.u_px,
        tracked.v_px,
        tracked.x_m,
        tracked.sigma_m,
        tracked.reasons,
        tracked.is_repeated,
        tuple(notes),
        seen_hub(rig, tracked.heights, tracked.x_m, tracked.sigma_m),
        period_s,
        is_whole,
        bool(video.predicting_codec),
    ).without(is_wrong, "repeated")
    if np.any(damaged):
        word = f"{np.count_nonzero(damaged)} of {len(times)} frames are damaged in the file and marked as not seen"
        record = replace(record.without(damaged, "damaged"), notes=(*record.notes, word))
    return record


def _track_markers(
    video: VideoFile,
    camera: CameraParameters,
    rig: Rig,
    calibration: LinearCalibration | None,
    progress: Callable[[float], None],
    watch: Watch | None,
) -> tuple[FollowedPoints, list[str]]:
    """Track the markers; returns their record, and what calibration or exposure do not say of the camera."""
    names, heights = rig.markers.names, rig.markers.heights
    chosen = calibration or LinearCalibration.from_camera(camera, len(names))
    chain = MeasuringChain(camera, rig.tracker_parameters(), heights, chosen, rig.beam_motion())
    if "lens" in chosen.provenance:
        chain.lens = Lens.from_dict(chosen.provenance["lens"])
    if chain.calibration_fault:
        raise CalibrationError(chain.calibration_fault)
    measured = []
    with contextlib.closing(video.frames()) as frames:
        for time_ns, image in frames:
            measured.append(chain.measure(time_ns, image))
            if watch is not None:
                watch(chain, image, measured[-1])
            progress(len(measured) / max(video.n_frames, len(measured)))
    reasons: tuple[dict[str, int], ...] = tuple({} for _ in names)
    for frame in measured:
        for counts, reason in zip(reasons, frame.reasons, strict=True):
            counts[reason] = counts.get(reason, 0) + 1
    return (
        FollowedPoints(
            names,
            np.asarray(heights),
            np.array([frame.stamp_ns for frame in measured], dtype=np.int64),
            np.array([frame.stamps_ns for frame in measured], dtype=np.int64),
            np.array([frame.u_px for frame in measured]),
            np.array([frame.v_px for frame in measured]),
            np.array([frame.displacement.x_m for frame in measured]),
            np.array([frame.displacement.sigma_m for frame in measured]),
            reasons,
            np.array([set(frame.reasons) == {"repeated"} for frame in measured]),
        ),
        chain.doubts
        + [
            f"{name} was told apart from other spots by the beam's model in {n} frames (tracker.prediction beam)"
            for name, n in zip(names, chain.foretold_frames, strict=True)
            if n
        ],
    )


def seen_hub(rig: Rig, heights: FloatArray, x_m: FloatArray, sigma_m: FloatArray) -> FloatArray:
    """Hub's position in every frame, as the beam's shape through all that was seen shows it.

    Parameters
    ----------
    rig : Rig -- its theory gives the shapes
    heights : ndarray, shape (m,) -- of the markers [m]
    x_m, sigma_m : ndarray, shape (n, m) -- displacements and standard deviations; NaN where not seen [m]

    Returns
    -------
    ndarray, shape (n,) -- [m]; NaN where the lowest marker of all, or more than half of them, are not seen

    Notes
    -----
    The low marker bends with the beam by some hundredths of a millimetre, in step with the hub's speed near a
    resonance: left in, that is taken for a shift of time by some tenths of a millisecond.
    """
    fitter = marker_shape_fitter(rig, heights)
    low = np.isfinite(x_m[:, : max(1, len(heights) // 4)]).any(axis=1)
    hub = np.full(len(x_m), np.nan)
    for k in np.flatnonzero(low):
        hub[k] = fitter.fit(x_m[k], sigma_m[k]).hub_m
    return hub


def _remarks(
    video: VideoFile,
    names: tuple[str, ...],
    reasons: tuple[dict[str, int], ...],
    n_frames: int,
    n_spanned: int,
) -> Iterator[str]:
    if video.n_undecodable:
        yield f"{video.n_undecodable} frames cannot be decoded and are missing: the file is damaged"
    if max(n_frames + video.n_undecodable, n_spanned) < video.n_frames:
        yield f"the video states {video.n_frames} frames, of which {n_frames} can be read: it is cut short"
    if video.n_times is not None and video.n_times > n_frames:
        yield (
            f"{video.n_times} frame times are given for {n_frames} frames: where frames are missing but at the end, "
            "the times are not theirs"
        )
    if video.predicting_codec:
        yield (
            f"the codec {video.predicting_codec} keeps what changes from frame to frame: places scatter several "
            "times as much as in the camera's own pictures. Film in Motion JPEG or FFV1, or with key frames only"
        )
    for name, counts in zip(names, reasons, strict=True):
        if counts.get("ok", 0) < _MIN_SEEN * n_frames:
            yield f"{name} was seen in {counts.get('ok', 0)} of {n_frames} frames ({_in_words(counts)})"


def _with_repeated_images(
    tracked: FollowedPoints, times_ns: StampArray
) -> tuple[FollowedPoints, np.ndarray, list[str]]:
    """Give frames that are the one before its places; find more that share an image, and which were not taken then.

    Returns
    -------
    tracked : FollowedPoints
    is_wrong : ndarray of bool, shape (n,) -- frames that show what was there at another time, or may do so
    notes : list of str
    """
    # Every frame takes the places of the last one that was measured.
    known = tracked.is_repeated
    source = np.maximum.accumulate(np.where(known, 0, np.arange(len(known))))
    x_m, sigma_m = tracked.x_m[source], tracked.sigma_m[source]
    found = find_repeated_frames((times_ns - times_ns[0]).astype(np.float64) * 1e-9, x_m, sigma_m, known)
    if not np.any(found.is_copy):
        return tracked, found.is_wrong, []
    given = np.count_nonzero(np.isfinite(x_m) & known[:, None], axis=0)
    reasons = tuple(
        {**counts, "ok": counts.get("ok", 0) + int(n), "repeated": counts.get("repeated", 0) - int(n)}
        for counts, n in zip(tracked.reasons, given, strict=True)
    )
    filled = replace(
        tracked,
        u_px=tracked.u_px[source],
        v_px=tracked.v_px[source],
        x_m=x_m,
        sigma_m=sigma_m,
        reasons=reasons,
    )
    n_known, n_more, n_frames = np.count_nonzero(known), np.count_nonzero(found.is_copy & ~known), len(known)
    said = [f"{n_known} of {n_frames} frames are the one before, noise aside"] if n_known else []
    said += (
        [f"{n_more} of {n_frames} frames are nearly the one before, as a codec gives it back"]
        if n_more
        else []
    )
    note = (
        f"{', and '.join(said)}, though what they show moves: {np.count_nonzero(found.is_wrong)} that do not, or may "
        "not, show what was there at their time are left out. Where a converter filled a film up, give it the "
        "camera's own file"
    )
    return filled, found.is_wrong, [note]


def _in_words(counts: dict[str, int]) -> str:
    return ", ".join(f"{reason} {count}" for reason, count in sorted(counts.items()) if reason != "ok")
