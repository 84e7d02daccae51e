"""Position error and time per frame of marker trackers, side by side on the same rendered frames.

    python benchmarks/vision.py [--frames N] [--json FILE] [--only METHOD ...] [--speed | --bound]

Four markers move along u by a few pixels; the error is the RMS per marker after its constant offset is taken away,
in pixels and in units of the Cramer-Rao bound of a disc,

    sigma_x >= (sigma_n / A) sqrt(2 sigma_b / (sqrt(pi) R))

with noise sigma_n (rounding to grey levels included), contrast A, edge blur sigma_b (lens and pixel) and radius R.
trackpy and pyidi are optional: a method that is not installed is said to be absent. pyidi brings an OpenCV of its own
and belongs in an environment of its own: `--only pyidi` there. Times are processor time of one thread; set
OPENBLAS_NUM_THREADS=1.

`--bound` compares the tracker's default with the whole Cramer-Rao bound, of place, height and background of a smeared
disc in noise that grows with the light, for diameters, smears, noises, shot noise and bits of its own.

`--speed` measures the tracker alone at two image sizes, the search for markers, the renderer, the reading of
images, and the tracking of whole files, as `beam track` does it, beside the decoder alone in the same rounds. The
tracker as machine code: `make compiled`, then the same in `build/compiled`.
"""

from __future__ import annotations

import argparse
import importlib
import itertools
import json
import math
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from beam_ros.rig.rig import Rig
from beam_ros.vision.calibration.linear import LinearCalibration
from beam_ros.vision.camera.images import grey_image
from beam_ros.vision.camera.video import VideoFile
from beam_ros.vision.measurement.measuring_chain import MeasuringChain
from beam_ros.vision.parameters import PERFECT_DISC_SIGMA_PX, CameraParameters, TrackerParameters
from beam_ros.vision.rendering.frames import SceneRenderer
from beam_ros.vision.timing import FrameTiming
from beam_ros.vision.tracking import tracker as tracking
from beam_ros.vision.tracking.moments import compiled_spot_numbers
from beam_ros.vision.tracking.tracker import MarkerTracker

HEIGHTS = (0.010, 0.100, 0.225, 0.285)
WARM_UP = 20
RIG = Rig.from_file()
CAMERA = replace(RIG.camera_parameters(), background=30.0)
"""The packaged camera, over the ground on which the page's figures were measured."""


@dataclass(frozen=True)
class Scene:
    """Frames of one kind, with the truth they were made from."""

    name: str
    camera: CameraParameters
    frames: np.ndarray
    u: np.ndarray
    v: np.ndarray
    bound: float


class AbsentError(Exception):
    """A method's package is not installed."""


def expectations(camera: CameraParameters, refinement: str) -> TrackerParameters:
    """Return what the tracker expects of four perfect discs."""
    return TrackerParameters.for_camera(
        camera,
        HEIGHTS,
        refinement=refinement,
        sigma_floor_px=PERFECT_DISC_SIGMA_PX,
        min_contrast_grey=RIG.tracker.min_contrast,
    )


def make_scene(name: str, diameter_px: float, noise: float, smear_px: float, n_frames: int) -> Scene:
    """Render the frames of one scene."""
    camera = replace(CAMERA, marker_diameter_m=diameter_px / 1500, noise_grey=noise)
    renderer = SceneRenderer(camera, HEIGHTS)
    rng = np.random.default_rng(1)
    k = np.arange(n_frames)[:, None]
    swing = 3.3 if smear_px == 0 else 12.0
    centre = swing * np.sin(0.37 * k + np.arange(len(HEIGHTS))) / 1500
    frames, truth = [], []
    for row, phase in zip(centre, np.cos(0.37 * k + np.arange(len(HEIGHTS))), strict=True):
        travel = np.linspace(-0.5, 0.5, renderer.sub_instants)[:, None] * smear_px / 1500 * phase
        positions = row + travel
        frames.append(renderer.render(positions, rng))
        truth.append(renderer.exposure_weights @ camera.columns(positions))
    blur = math.hypot(camera.blur_px, math.sqrt(1 / 12))
    noise_total = math.hypot(noise, math.sqrt(1 / 12))
    bound = noise_total / camera.contrast * math.sqrt(2 * blur / (math.sqrt(math.pi) * diameter_px / 2))
    v = np.broadcast_to(camera.rows(HEIGHTS), (n_frames, len(HEIGHTS)))
    return Scene(name, camera, np.array(frames), np.array(truth), v, bound)


# -- methods: from a scene to columns (n_frames, n_markers) --------------------------------------------------


def tracked(refinement: str) -> Callable[[Scene], np.ndarray]:
    """Return the suite's tracker with one of its refinements."""

    def run(scene: Scene) -> np.ndarray:
        parameters = expectations(scene.camera, refinement)
        tracker = MarkerTracker(parameters, len(HEIGHTS))
        return np.array(
            [[m.u_px for m in tracker.process(frame, k).markers] for k, frame in enumerate(scene.frames)]
        )

    return run


def lowest_first(found: Sequence[tuple[float, float]], scene: Scene) -> list[float]:
    """Columns of the spots nearest to the markers' rows; NaN where there is none within 4 px."""
    columns = []
    for row in scene.v[0]:
        near = [u for u, v in found if abs(v - row) < 4]
        columns.append(near[0] if len(near) == 1 else math.nan)
    return columns


def simple_blob_detector(scene: Scene) -> np.ndarray:
    """OpenCV's SimpleBlobDetector, with steps so fine that finer ones change nothing."""
    parameters = cv2.SimpleBlobDetector_Params()
    parameters.filterByColor, parameters.blobColor = True, 255
    parameters.minThreshold, parameters.maxThreshold, parameters.thresholdStep = 60, 200, 2
    parameters.minArea, parameters.maxArea, parameters.filterByArea = 20, 1500, True
    parameters.filterByConvexity = parameters.filterByInertia = parameters.filterByCircularity = False
    detector = cv2.SimpleBlobDetector_create(parameters)
    return np.array([lowest_first([p.pt for p in detector.detect(frame)], scene) for frame in scene.frames])


def pyramidal_lucas_kanade(scene: Scene) -> np.ndarray:
    """OpenCV's calcOpticalFlowPyrLK, always from the first frame."""
    start = np.stack([scene.u[0], scene.v[0]], axis=1).astype(np.float32).reshape(-1, 1, 2)
    size = 2 * math.ceil(scene.camera.marker_diameter_px / 2 + 4) + 1
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 40, 1e-4)
    guess = start.copy()
    columns = []
    for frame in scene.frames:
        guess, _, _ = cv2.calcOpticalFlowPyrLK(
            scene.frames[0],
            frame,
            start,
            guess,
            winSize=(size, size),
            maxLevel=2,
            criteria=criteria,
            flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        )
        columns.append(guess.reshape(-1, 2)[:, 0].astype(float))
    return np.array(columns)


def binary_moments(scene: Scene) -> np.ndarray:
    """Threshold at half height, contours, moments of the mask."""
    columns = []
    for frame in scene.frames:
        _, mask = cv2.threshold(frame, 120, 255, cv2.THRESH_BINARY)
        contours = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[-2]
        found = []
        for contour in contours:
            x, y, w, h = cv2.boundingRect(contour)
            m = cv2.moments(mask[y : y + h, x : x + w], True)
            found.append((x + m["m10"] / m["m00"], y + m["m01"] / m["m00"]))
        columns.append(lowest_first(found, scene))
    return np.array(columns)


def trackpy_locate(scene: Scene) -> np.ndarray:
    """Run trackpy.locate for this diameter over an even ground taken off, which is better than its own band-pass."""
    trackpy = required("trackpy")
    trackpy.quiet()
    size = 2 * math.ceil(scene.camera.marker_diameter_px / 2 + 2) + 1
    dark = scene.camera.background + 2.5 * scene.camera.noise_grey
    columns = []
    for frame in scene.frames:
        spots = trackpy.locate(cv2.subtract(frame, dark), size, minmass=1500, preprocess=False)
        columns.append(lowest_first(list(zip(spots["x"], spots["y"], strict=True)), scene))
    return np.array(columns)


def pyidi_lucas_kanade(scene: Scene) -> np.ndarray:
    """Run pyidi's Lucas-Kanade over the whole video."""
    pyidi = required("pyidi")
    video = pyidi.VideoReader(np.ascontiguousarray(scene.frames), root=".", fps=100)
    method = pyidi.LucasKanade(video)
    points = np.rint(np.stack([scene.v[0], scene.u[0]], axis=1)).astype(int)
    method.set_points(points)
    size = 2 * math.ceil(scene.camera.marker_diameter_px / 2 + 3) + 1
    method.configure(roi_size=(size, size), verbose=0, show_pbar=False)
    displacements = method.get_displacements(autosave=False)
    return np.asarray(points[:, 1] + displacements[:, :, 1].T)


def required(package: str) -> Any:
    """Import an optional package."""
    try:
        return importlib.import_module(package)
    except ImportError as err:
        raise AbsentError(package) from err


METHODS: dict[str, Callable[[Scene], np.ndarray]] = {
    "centroid": tracked("none"),
    "radial_symmetry": tracked("radial_symmetry"),
    "disc_model": tracked("disc_model"),
    "pyrlk": pyramidal_lucas_kanade,
    "blob_detector": simple_blob_detector,
    "binary_moments": binary_moments,
    "trackpy": trackpy_locate,
    "pyidi": pyidi_lucas_kanade,
}


def compare(n_frames: int, names: Sequence[str]) -> list[dict[str, Any]]:
    """Run the methods on all scenes and print the table."""
    scenes = [
        make_scene("D8 noise 2", 8, 2, 0, n_frames),
        make_scene("D12 noise 2", 12, 2, 0, n_frames),
        make_scene("D16 noise 2", 16, 2, 0, n_frames),
        make_scene("D12 noise 5", 12, 5, 0, n_frames),
        make_scene("D12 noise 10", 12, 10, 0, n_frames),
        make_scene("D12 6 px smear", 12, 2, 6, n_frames),
    ]
    rows: list[dict[str, Any]] = []
    for scene in scenes:
        print(
            f"{scene.name}: Cramer-Rao bound {scene.bound:.4f} px{' without smear' if 'smear' in scene.name else ''}"
        )
        for name in names:
            try:
                # What is loaded or compiled at the first call is no part of the time.
                METHODS[name](replace(scene, frames=scene.frames[:WARM_UP]))
                started = time.process_time()
                columns = METHODS[name](scene)
                seconds = (time.process_time() - started) / n_frames
            except AbsentError as absent:
                print(f"  {name:16s} not installed: pip install {absent}")
                continue
            error = (columns - scene.u)[WARM_UP:]
            found = np.isfinite(error)
            error = error - np.nanmean(error, axis=0)
            rms = float(np.sqrt(np.nanmean(error**2))) if found.any() else math.nan
            rows.append(
                {
                    "scene": scene.name,
                    "method": name,
                    "rms_px": rms,
                    "bounds": rms / scene.bound,
                    "found": float(found.mean()),
                    "ms_per_frame": 1e3 * seconds,
                }
            )
            print(
                f"  {name:16s} {rms:8.4f} px  {rms / scene.bound:6.2f} bounds  {100 * found.mean():5.1f} % found  "
                f"{1e3 * seconds:8.3f} ms a frame"
            )
    return rows


def information_bound(renderer: SceneRenderer, way: np.ndarray, alpha: float, beta: float) -> np.ndarray:
    """Bound of every marker's column [px] where row, contrast and background are unknown, too."""
    camera, step = renderer.camera, 1.0 / 16 / renderer.camera.pixels_per_metre
    heights = np.broadcast_to(HEIGHTS, (renderer.sub_instants, len(HEIGHTS)))
    positions = np.repeat(way[:, None], len(HEIGHTS), axis=1) / camera.pixels_per_metre

    def light(aside: float, above: float) -> np.ndarray:
        return renderer.light(positions + aside, marker_z=heights + above).astype(float)

    disc = light(0.0, 0.0)
    columns = [light(step, 0.0) - light(-step, 0.0), light(0.0, step) - light(0.0, -step)]
    reach = math.ceil(camera.marker_diameter_px / 2 + np.ptp(way) / 2 + 8)
    bounds = []
    for row in np.rint(camera.rows(HEIGHTS)).astype(int):
        part = slice(row - reach, row + reach + 1), slice(320 - reach, 320 + reach + 1)
        changes = [8 * column[part].ravel() for column in columns]  # over an eighth of a pixel
        own = np.stack([*changes, disc[part].ravel() - camera.background, np.ones(changes[0].size)])
        variance = alpha + 1 / 12 + beta * disc[part].ravel()
        bounds.append(math.sqrt(np.linalg.inv((own / variance) @ own.T)[0, 0]))
    return np.array(bounds)


def at_the_bound(n_frames: int) -> list[dict[str, Any]]:
    """Run the tracker's default over discs of all sizes, and print error over bound and over stated deviation."""
    rows: list[dict[str, Any]] = []
    kinds = ((1.0, 0.0, 8), (10.0, 0.0, 8), (2.0, 0.1, 8), (2.0, 0.1, 16))
    print("error over bound / over stated deviation (found); columns: noise, variance per grey level, bits")
    print(
        "  D smear " + "".join(f"{f'{noise:g}, {beta:g}, {bits} bits':>26s}" for noise, beta, bits in kinds)
    )
    for diameter in (6, 8, 12, 20, 30):
        for smear in (0.0, 3.0, 9.0):
            shown = []
            for noise, beta, bits in kinds:
                row = {"D": diameter, "smear": smear, "noise": noise, "per_grey": beta, "bits": bits}
                row |= _at_the_bound(diameter, smear, noise, beta, bits, n_frames)
                rows.append(row)
                shown.append(f"{row['bounds']:13.3f} /{row['z']:5.2f} ({100 * row['found']:3.0f} %)")
            print(f"{diameter:3d} {smear:5g} " + "".join(shown), flush=True)
    return rows


def _to_and_fro(times: np.ndarray) -> np.ndarray:
    """Place of what moves to and fro at a speed of one, turning within 24 of 96 periods; at first it rests."""
    knots = np.linspace(0.0, 96.0, 1537)
    speed = np.interp(knots, (0, 12, 36, 60, 84, 96), (0, 1, 1, -1, -1, 0))
    place = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2)]) * (knots[1] - knots[0])
    return np.interp(np.maximum(times, 0.0) % 96, knots, place - place.max() / 2)


def _at_the_bound(
    diameter: int, smear: float, noise: float, beta: float, bits: int, n_frames: int
) -> dict[str, float]:
    """One cell: markers that rest, or nearly so, then go to and fro at the speed of their smear."""
    exposed = 1 / 1.01 if smear else 0.05
    camera = replace(CAMERA, marker_diameter_m=diameter / 1500, noise_grey=0.0, readout_s=0.0)
    camera = replace(camera, exposure_s=exposed * camera.period_s)
    renderer = SceneRenderer(camera, HEIGHTS, sub_instants=12)
    tracker = MarkerTracker(expectations(camera, "disc_model"), len(HEIGHTS), FrameTiming(camera))
    rng, scale = np.random.default_rng([diameter, int(smear), int(noise), bits]), 256 if bits == 16 else 1
    nodes = np.polynomial.legendre.leggauss(renderer.sub_instants)[0] / 2 * exposed
    phases, alpha = rng.uniform(0.0, 2 * np.pi, len(HEIGHTS)), noise**2
    errors, stated = [], []
    for k in itertools.count():
        times = (k + nodes - WARM_UP)[:, None]
        positions = smear / exposed * _to_and_fro(times) + 0.4 * np.sin(
            phases + 0.13 * times * (smear == 0.0)
        )
        light = renderer.light(positions / 1500)
        sd = np.sqrt(alpha + beta * light, dtype=np.float32)
        noisy = light + sd * rng.standard_normal(light.shape, dtype=np.float32)
        picture = np.clip(np.rint(scale * noisy), 0, 256 * scale - 1)
        picture = picture.astype(np.uint16 if bits == 16 else np.uint8)
        found = tracker.process(picture, round(1e9 * k * camera.period_s)).markers
        if k > WARM_UP + 24 and (smear == 0.0 or 14 <= (k - WARM_UP) % 48 <= 35):  # at an even speed
            errors.append(
                [m.u_px for m in found] - (renderer.exposure_weights @ camera.columns(positions / 1500))
            )
            stated.append([m.sigma_px for m in found])
            if len(errors) == n_frames:
                break
    error, sigma = np.array(errors), np.array(stated)
    if not np.isfinite(error).any():
        return {"bounds": math.nan, "z": math.nan, "found": 0.0}
    bound = information_bound(renderer, smear / exposed * nodes, alpha if bits == 8 else alpha - 1 / 12, beta)
    return {
        "bounds": float(np.sqrt(np.nanmean((error / bound) ** 2))),
        "z": float(np.sqrt(np.nanmean((error / sigma) ** 2))),
        "found": float(np.isfinite(error).mean()),
    }


def best_ms(action: Callable[[], object], repeats: int) -> float:
    """Shortest time of an action [ms]."""
    best = math.inf
    for _ in range(repeats):
        started = time.process_time()
        action()
        best = min(best, time.process_time() - started)
    return 1e3 * best


def speed() -> list[dict[str, Any]]:
    """Measure tracker, acquisition, renderer and image reading at two sizes."""
    rows: list[dict[str, Any]] = []
    numba = "with" if compiled_spot_numbers() else "without"
    print(f"  tracker: {Path(tracking.__file__).suffix} files, {numba} Numba")

    def note(what: str, size: str, milliseconds: float) -> None:
        rows.append({"what": what, "size": size, "ms": milliseconds})
        print(f"  {what:44s} {size:10s} {milliseconds:8.3f} ms")

    for width, height, origin in ((640, 480, (320.0, 465.0)), (1920, 1080, (960.0, 1000.0))):
        camera = replace(CAMERA, width=width, height=height, origin_px=origin)
        size = f"{width}x{height}"
        strip = np.linspace(0.0, 0.3, 25)
        renderer = SceneRenderer(camera, HEIGHTS, strip_heights=strip)
        rng = np.random.default_rng(1)
        frames = [renderer.render(rng.random(4) / 1500, rng, strip=0 * strip) for _ in range(8)]
        for refinement in ("none", "radial_symmetry", "disc_model"):
            tracker = MarkerTracker(expectations(camera, refinement), 4)
            for frame in frames * 2:
                tracker.process(frame, 0)

            def track(tracker: MarkerTracker = tracker, frames: list[np.ndarray] = frames) -> None:
                for frame in frames:
                    tracker.process(frame, 0)

            note(f"track four markers, refinement {refinement}", size, best_ms(track, 150) / len(frames))

        def acquire(tracker: MarkerTracker = tracker, frame: np.ndarray = frames[0]) -> None:
            tracker.reset()
            tracker.process(frame, 0)

        note("find four markers anew", size, best_ms(acquire, 50))
        positions = np.zeros((renderer.sub_instants, 4))

        def render(
            renderer: SceneRenderer = renderer,
            positions: np.ndarray = positions,
            strip: np.ndarray = 0 * strip,
            rng: np.random.Generator = rng,
        ) -> None:
            renderer.render(positions, rng, strip=strip)

        note("render", size, best_ms(render, 100))
        data = frames[0].tobytes()
        note(
            "read a mono8 message",
            size,
            best_ms(lambda w=width, h=height, d=data: grey_image("mono8", h, w, w, d), 500),
        )
    return rows


def file_speed() -> list[dict[str, Any]]:
    """Measure tracking at 640x480: frames in memory, and files beside OpenCV's decoder alone (elapsed time)."""
    rng = np.random.default_rng(1)
    renderer = SceneRenderer(CAMERA, HEIGHTS)
    x = 0.01 * np.sin(2 * np.pi * 6 / 200 * np.arange(200)[:, None] + np.arange(4.0))
    frames = [renderer.render(row, rng) for row in x] * 5
    rows: list[dict[str, Any]] = []

    def note(what: str, milliseconds: float, remark: str = "") -> None:
        rows.append({"what": what, "size": "640x480", "ms": milliseconds})
        print(f"  {what:44s} 640x480    {milliseconds:8.3f} ms  {1e3 / milliseconds:6.0f} frames/s  {remark}")

    def track(source: Iterable[tuple[int, np.ndarray]]) -> None:
        scale = LinearCalibration.from_camera(CAMERA, len(HEIGHTS))
        chain = MeasuringChain(CAMERA, expectations(CAMERA, "disc_model"), HEIGHTS, scale)
        for frame in source:
            chain.measure(*frame)

    def decode(path: Path) -> None:
        capture = cv2.VideoCapture(str(path))
        while capture.grab():
            pass

    note("track frames in memory", best_ms(lambda: track(enumerate(frames)), 3) / len(frames))
    with tempfile.TemporaryDirectory() as folder:
        for code in ("MJPG", "FFV1"):
            path = Path(folder) / f"{code}.avi"
            writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*code), 100.0, (640, 480), False)
            for frame in frames:
                writer.write(frame)
            writer.release()
            alone, both = (
                np.array(times) * 1e3 / len(frames)
                for times in paired_times(
                    lambda path=path: decode(path),
                    lambda path=path: track(VideoFile(path, heeds_decoder=True).frames()),
                    rounds=5,
                )
            )
            note(f"decode a grey {code} file", float(np.median(alone)))
            ratio = f"{np.median(alone / both):.2f} of the decoder's rate"
            note(f"read and track a grey {code} file", float(np.median(both)), ratio)
    return rows


def paired_times(*actions: Callable[[], None], rounds: int = 9) -> list[list[float]]:
    """Elapsed times of some actions, in turns [s]."""
    times: list[list[float]] = [[] for _ in actions]
    for _ in range(rounds):
        for own, action in zip(times, actions, strict=True):
            started = time.perf_counter()
            action()
            own.append(time.perf_counter() - started)
    return times


def main() -> int:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--frames", type=int, default=300, help="frames a scene (default 300)")
    parser.add_argument("--only", nargs="+", choices=sorted(METHODS), help="methods to run (default: all)")
    parser.add_argument("--speed", action="store_true", help="measure times only")
    parser.add_argument("--bound", action="store_true", help="the default against the whole bound only")
    parser.add_argument("--json", type=Path, help="write the rows to this file")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    print(f"OpenCV {cv2.__version__}, NumPy {np.__version__}, Python {sys.version.split()[0]}")
    if arguments.speed:
        rows = speed() + file_speed()
    elif arguments.bound:
        rows = at_the_bound(arguments.frames)
    else:
        rows = compare(arguments.frames, arguments.only or list(METHODS))
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
