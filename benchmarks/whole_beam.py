"""A strip without dots, followed at sixty heights: error and time per frame, side by side on the same frames.

    python -m benchmarks.whole_beam [--frames N] [--only METHOD ...]

The frames are rendered: 612 x 72 pixels, a strip of 1 px that swings in two modes by up to 8 px, noise of 2 grey
levels, and a texture along the strip, without which a method for two directions has nothing to hold on to. The error
is the RMS per point after its constant offset is taken away, in pixels and in units of the Cramer-Rao bound of a
strip at rest. Times are processor time; set OPENBLAS_NUM_THREADS=1. `correlation` is what programs for digital image
correlation do with OpenCV: the zero-mean normalised correlation with the first frame's subset, and a parabola through
its best columns. pyidi is optional, brings an OpenCV of its own and belongs in an environment of its own:

    python -m venv peers && peers/bin/pip install pyidi scipy ruamel.yaml rosbags
    PYTHONPATH=. peers/bin/python -m benchmarks.whole_beam
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np

from beam_ros.rig.rig import Rig
from beam_ros.vision.rendering.frames import SceneRenderer
from beam_ros.vision.rendering.imaging import CameraFaults, FaultyCamera
from beam_ros.vision.strip.following import StripParameters
from beam_ros.vision.strip.moving_line import StripFollower
from beam_ros.vision.strip.profile import profile

RIG = Rig.from_file()
WARM_UP = 12
SUBSET = (11, 13)
"""Rows and columns that the other methods look at about each point."""


@dataclass(frozen=True)
class Film:
    """Frames with the truth that they were made from."""

    frames: np.ndarray
    u: np.ndarray
    rows: np.ndarray
    bound: float
    parameters: StripParameters


def make_film(n_frames: int) -> Film:
    """Render the frames."""
    camera = replace(
        RIG.camera_parameters(),
        width=72,
        height=612,
        pixels_per_metre=2005.0,
        origin_px=(36.3, 605.0),
        exposure_s=0.001,
        strip_contrast=120.0,
        strip_width_m=1.0 / 2005.0,
    )
    parameters = StripParameters(
        605.0 - RIG.beam.length * 2005.0, 605.0, 36.3, 1.0, exposure_frames=camera.exposure_s * camera.rate_hz
    )
    rows = StripFollower(parameters, (camera.height, camera.width)).rows_px
    model, heights = RIG.beam_model(), np.linspace(0.0, RIG.beam.length, 151)
    renderer = SceneRenderer(camera, [0.01], strip_heights=heights)
    faulty = FaultyCamera(camera, CameraFaults(strip_texture=0.3), n_frames, 0.0, 1)
    tip, above = model.shape([RIG.beam.length])[0, :2], (605.0 - rows) / camera.pixels_per_metre
    rng = np.random.default_rng(1)
    frames, truth = [], []
    for k in range(n_frames):
        at = k * camera.period_s
        q = np.array([0.004 * math.sin(27.5 * at), 0.0003 * math.sin(177.0 * at)]) / tip
        light = renderer.light([np.nan], model.shape(heights)[:, :2] @ q)
        frames.append(faulty.picture(k, 0, light, rng))
        truth.append(camera.columns(model.shape(above)[:, :2] @ q))
    places = np.arange(-16, 16)[None, :] + (np.arange(32)[:, None] + 0.5) / 32
    slopes = profile(places, 1.0, camera.blur_px, 0.0)[1]
    noise = math.hypot(camera.noise_grey, math.sqrt(1 / 12))
    bound = noise / camera.strip_contrast / math.sqrt(10 * float(np.mean(np.sum(slopes**2, axis=1))))
    return Film(np.array(frames), np.array(truth), rows, bound, parameters)


def follower(film: Film) -> np.ndarray:
    """The suite's own."""
    own = StripFollower(film.parameters, film.frames.shape[1:])
    return np.array([own.process(frame).u_px for frame in film.frames])


def correlation(film: Film) -> np.ndarray:
    """Correlate each point's subset with its row of every frame, within the reach of its motion."""
    rows, columns = np.rint(film.rows).astype(int), np.rint(film.u[0]).astype(int)
    reach = math.ceil(float(np.ptp(film.u))) + 2
    height, width = SUBSET[0] // 2, SUBSET[1] // 2
    u = np.full((len(film.frames), len(rows)), np.nan)
    for j, (row, column) in enumerate(zip(rows, columns, strict=True)):
        band = slice(row - height, row + height + 1)
        subset = film.frames[0][band, column - width : column + width + 1]
        left = max(0, column - width - reach)
        for k, frame in enumerate(film.frames):
            window = frame[band, left : column + width + reach + 1]
            score = cv2.matchTemplate(window, subset, cv2.TM_CCOEFF_NORMED)[0]
            best = int(np.clip(np.argmax(score), 1, len(score) - 2))
            before, at, after = score[best - 1 : best + 2]
            u[k, j] = left + width + best + 0.5 * (before - after) / (before - 2 * at + after)
    return u


def _pyidi(film: Film, method: str, **settings: object) -> np.ndarray:
    import pyidi

    video = pyidi.VideoReader(film.frames, root=".", fps=100)
    found = getattr(pyidi, method)(video)
    points = np.rint(np.stack([film.rows, film.u[0]], axis=1)).astype(int)
    found.set_points(points)
    found.configure(roi_size=SUBSET, verbose=0, show_pbar=False, **settings)
    return np.asarray(points[:, 1] + found.get_displacements(autosave=False)[:, :, 1].T)


METHODS: dict[str, Callable[[Film], np.ndarray]] = {
    "follower": follower,
    "correlation": correlation,
    "pyidi": lambda film: _pyidi(film, "LucasKanade"),
    "pyidi_1d": lambda film: _pyidi(film, "DirectionalLucasKanade", dij=(0, 1)),
}


def main() -> None:
    """Print a row for each method."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--frames", type=int, default=600)
    parser.add_argument("--only", nargs="+", choices=METHODS, default=list(METHODS))
    arguments = parser.parse_args()
    film = make_film(arguments.frames)
    times: dict[str, float] = {}
    print(f"{len(film.rows)} points, {arguments.frames} frames, bound at rest {film.bound:.4f} px")
    for name in arguments.only:
        try:
            # What is compiled or tabulated at the first call is no part of the time.
            METHODS[name](replace(film, frames=film.frames[:WARM_UP]))
        except ImportError as err:
            print(f"{name:<11} absent ({err})")
            continue
        begun = time.process_time()
        u = METHODS[name](film)
        times[name] = (time.process_time() - begun) / arguments.frames
        error = (u - film.u)[WARM_UP:]
        error = error - np.nanmean(error, axis=0)
        good = np.abs(error) < 1.0
        rms = float(np.sqrt(np.mean(error[good] ** 2)))
        print(
            f"{name:<11} error {rms:.4f} px, {rms / film.bound:.2f} of the bound, {good.mean():.1%} within 1 px, "
            f"{times[name] * 1e3:.2f} ms a frame"
        )
    for name in times.keys() - {"follower"}:
        if "follower" in times:
            print(f"{name} takes {times[name] / times['follower']:.1f} times as long")


if __name__ == "__main__":
    main()
