"""The tracker's judge: random scenes by class, with the truth beside them, and how often a tracker is wrong.

    python -m benchmarks.vision_scenes [--scenes N] [--only CLASS ...] [--seed K] [--driven] [--trackers NAME ...]
        [--json FILE]

Every scene has a class (twins, covers, light, shake, ...), a beam that swings or rests, and begins cold (the
disturbance is there in the first frame) or warm (forty plain frames come before). Frames are rendered by the suite's
own renderer without noise; light, texture, sensor noise, saturation and compression are put on afterwards, and the
measuring chain gets frames and stamps as from a camera. Printed for each class:

* valid: share of the marker's frames that are valid, of those in which nothing touches it ("in sight")
* wrong: valid measurements that are off by more than six stated standard deviations or 0.35 px, whichever is larger,
  and how many scenes have one; the largest error
* off: RMS of the error of what is not wrong [px]
* z: RMS of error over stated standard deviation; a constant offset of a marker over its scene is a part of it
* wait: frames in sight before a marker is valid, from its first frame, a loss, or the end of a cover: 95 % and most;
  those with a second disc of its kind in its row (then, or in the 25 frames before) are counted as *ambiguous*, apart

With `--driven` a hub moves the beam, by the Galerkin model's equations with a stiffness that the rig file does not
know, and its encoder is heard by the tracker `beam`, which is `suite` with `tracker.prediction: beam`.

`--trackers opencv trackpy` gives frames to detectors that know no time: a marker is the one spot within the tolerance
of its row. `pyidi` gets the whole film and the markers' places in its first frame. They state no standard deviation;
wrong is then what is off by more than 0.35 px. trackpy and pyidi belong in an environment of their own, as for
`benchmarks/vision.py`.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from scipy.interpolate import CubicSpline

from beam_model import BeamModel
from beam_ros.rig.rig import Rig
from beam_ros.vision.calibration.linear import LinearCalibration
from beam_ros.vision.measurement.measuring_chain import MeasuringChain
from beam_ros.vision.parameters import CameraParameters
from beam_ros.vision.rendering.disturbances import Disturbances, Glare, Occluder, SecondSpot
from beam_ros.vision.rendering.frames import SceneRenderer

IS_DRIVEN = False
"""The beam moves as a hub makes it, which is heard, instead of anyhow."""
RIG = Rig.from_file()
HEIGHTS = np.asarray(RIG.markers.heights)
N_MARKERS = len(HEIGHTS)
PERIOD_NS = 10_000_000
WARM_FRAMES = 40
FRAMES = 60
WRONG_PX = 0.35
WRONG_SIGMAS = 6.0
UNDISTURBED = 12
"""So many frames show a marker that is then hidden beside a twin: hidden from the first on, it is told by nobody."""
EDGE_PX = 20.0
"""A marker so near to the edge of the picture does not count as in sight [px]."""
MEMORY_FRAMES = 25
"""A twin that was in a marker's row so many frames ago may still be one of two that nobody can tell apart."""
ROW_PX = 15.0
"""A detector that knows no time may look so far from a marker's row [px]."""


@dataclass(frozen=True)
class Ghost:
    """A reflection of the whole picture that lies over it.

    Attributes
    ----------
    du, dv : float -- how far aside it lies [px]
    strength : float -- its light over the picture's own
    is_mirrored : bool -- left and right are exchanged about the middle column, before it is moved aside
    """

    du: float
    dv: float
    strength: float
    is_mirrored: bool


@dataclass(frozen=True)
class Shadow:
    """A strip of less light.

    Attributes
    ----------
    u : float -- its middle, in the middle row [px]
    lean : float -- how far it goes left from row to row [px/px]
    width, soft : float -- of the strip, and of its edges [px]
    light : float -- share of the light that is left
    """

    u: float
    lean: float
    width: float
    soft: float
    light: float

    def over(self, picture: np.ndarray) -> np.ndarray:
        """Return a picture with the shadow on it."""
        height, width = picture.shape
        y, x = np.ogrid[:height, :width]
        inside = self.width / 2 - np.abs(x - self.u + self.lean * (y - height / 2))
        shade = 0.5 * (1 + np.tanh(inside / self.soft))
        return np.asarray(picture * (1 - (1 - self.light) * shade), dtype=np.float32)


class SecondField(NamedTuple):
    """Another instant, which every second row shows.

    Attributes
    ----------
    x, middle : ndarray -- positions as of ``Frame.x`` at that instant, and half way to it [m]
    first_row : int -- first of these rows
    """

    x: np.ndarray
    middle: np.ndarray
    first_row: int


@dataclass
class Frame:
    """One frame before the sensor sees it.

    Attributes
    ----------
    x : ndarray, shape (6, n_markers) -- positions at six instants of the exposure [m]
    z : ndarray, shape (n_markers,) -- heights [m]
    hub : list of (int, float) -- what the encoder said until this frame came: stamps and positions [ns, m]
    older_share : float -- so much of the light is that of the frame before
    is_repeated : bool -- the camera shows the frame before again
    shadow : Shadow or None -- that lies on the picture
    second_field : SecondField or None -- another instant, which every second row shows
    in_sight : ndarray of bool, shape (n_markers,) -- nothing touches the marker
    """

    x: np.ndarray
    z: np.ndarray
    hub: list[tuple[int, float]] = field(default_factory=list)
    disturbances: Disturbances = field(default_factory=Disturbances)
    gain: float = 1.0
    is_dropped: bool = False
    tear_row: int = 0
    ghost: Ghost | None = None
    older_share: float = 0.0
    is_repeated: bool = False
    shadow: Shadow | None = None
    second_field: SecondField | None = None
    in_sight: np.ndarray = field(default_factory=lambda: np.ones(N_MARKERS, dtype=bool))
    specks: list[tuple[float, float, float, float]] = field(default_factory=list)
    threads: list[tuple[float, float, float, float, float]] = field(default_factory=list)


@dataclass
class Scene:
    """A scene: its camera, its sensor and its frames."""

    camera: CameraParameters
    frames: list[Frame]
    noise: float = 2.0
    shot: float = 0.0
    texture: float = 0.0
    slope: tuple[float, float] = (0.0, 0.0)
    quality: int = 0
    saturation: float = 1.0


def motion(rng: np.random.Generator, n: int, exposure: float, amplitude_px: float) -> np.ndarray:
    """Positions of the markers at six instants of every exposure [m], shape (n, 6, n_markers)."""
    pixel = 1.0 / RIG.camera.pixels_per_metre
    instants = np.arange(n)[:, None] + exposure * (np.polynomial.legendre.leggauss(6)[0] / 2)
    relative = HEIGHTS / RIG.beam.length
    total = np.zeros((n, 6, N_MARKERS))
    for shape, cycles, share in (
        (np.ones(N_MARKERS), rng.uniform(0.005, 0.03), 1.0),
        (relative**1.8, rng.uniform(0.03, 0.06), 1.0),
        (np.sin(4.5 * relative) * relative, rng.uniform(0.2, 0.3), 0.1),
    ):
        size = amplitude_px * share * rng.uniform(0.2, 1.0) * pixel
        phase = rng.uniform(0, 2 * math.pi)
        total += size * np.sin(2 * math.pi * cycles * instants + phase)[..., None] * shape
    return total


def driven_motion(
    rng: np.random.Generator, n: int, exposure: float, amplitude_px: float
) -> tuple[np.ndarray, list[list[tuple[int, float]]]]:
    """Positions as of ``motion``, of a beam that a hub drives, and what the hub's encoder says before every frame.

    The beam is up to 10 % stiffer or softer than the rig's model says, and the camera's stamps are up to 3 ms off.
    """
    tick, frame = 1e-3, PERIOD_NS * 1e-9
    before = 2.0
    t = np.arange(-before, n * frame + 0.1, tick)
    hub, acceleration = np.zeros_like(t), np.zeros_like(t)
    for _ in range(3):
        rate, phase = 2 * math.pi * rng.uniform(0.5, 5.0), rng.uniform(0, 2 * math.pi)
        size = rng.uniform(0.1, 0.6)
        wave = size * np.sin(rate * t + phase)
        hub, acceleration = hub + wave, acceleration - rate**2 * wave
    given = RIG.beam_parameters()
    stiffness = given.flexural_rigidity * rng.uniform(0.9, 1.1)
    model = BeamModel(replace(given, flexural_rigidity=stiffness), n_modes=2)
    stepper = model.motion_stepper(tick)
    coordinates = np.empty((len(t), 2))
    for k, value in enumerate(acceleration):
        coordinates[k] = stepper.state[:2]
        stepper.step(value)
    x = hub[:, None] + coordinates @ model.shape(HEIGHTS).T
    scale = amplitude_px / RIG.camera.pixels_per_metre * rng.uniform(0.3, 1.5) / np.abs(x).max()
    hub, x = scale * hub, scale * x
    instants = (np.arange(n)[:, None] + exposure * (np.polynomial.legendre.leggauss(6)[0] / 2)) * frame
    step, late_s = RIG.hub.encoder_resolution, rng.uniform(-0.003, 0.003)
    stamps = 10**18 + np.rint((t - late_s) * 1e9).astype(np.int64)
    said = list(zip(stamps.tolist(), (np.rint(hub / step) * step).tolist(), strict=True))
    first = np.searchsorted(t, np.arange(-1, n) * frame + 0.005)
    first[0] = 0
    return CubicSpline(t, x)(instants), [said[a:b] for a, b in pairwise(first)]


# -- classes -------------------------------------------------------------------------------------------------


def plain(rng: np.random.Generator, *, amplitude_px: float | None = None, **camera: Any) -> Scene:
    """A beam that swings, or rests, with nothing else in view."""
    seen = replace(RIG.camera_parameters(), noise_grey=0.0, **camera)
    if amplitude_px is None:
        amplitude_px = float(rng.choice([0.0, 5.0, 20.0]))
    n = WARM_FRAMES + FRAMES if rng.random() < 0.5 else FRAMES
    hub: list[list[tuple[int, float]]] = [[]] * n
    if IS_DRIVEN:
        x, hub = driven_motion(rng, n, seen.exposure_s * 100, amplitude_px)
    else:
        x = motion(rng, n, seen.exposure_s * 100, amplitude_px)
    frames = [Frame(x[k], HEIGHTS, hub[k]) for k in range(n)]
    return Scene(seen, frames, noise=float(rng.choice([1.0, 2.0, 5.0])))


def disturbed(scene: Scene) -> list[Frame]:
    """The frames of a scene that a disturbance touches: all of a cold one's, those after the warm ones' first."""
    return scene.frames[-FRAMES:]


def mean_columns(scene: Scene, frame: Frame) -> np.ndarray:
    """Mean positions of the markers over the exposure [px]."""
    weights = np.polynomial.legendre.leggauss(6)[1] / 2
    return np.asarray(scene.camera.columns(weights @ frame.x))


def add_twin(
    scene: Scene, rng: np.random.Generator, way: Callable[[int, float], float], k: int, dv: float
) -> None:
    """A second disc in a marker's row; way(number of the frame, marker's column) is its column."""
    radius = scene.camera.marker_diameter_px
    for i, frame in enumerate(disturbed(scene)):
        u = mean_columns(scene, frame)[k]
        v = float(scene.camera.rows(frame.z)[k])
        at = way(i, u)
        frame.disturbances = replace(
            frame.disturbances, spots=(*frame.disturbances.spots, SecondSpot(at, v + dv))
        )
        if abs(at - u) < radius + 14:
            frame.in_sight[k] = False


def twin_joined(rng: np.random.Generator) -> Scene:
    """A second disc that stays 1 to 4 px beside a marker and moves with it."""
    scene = plain(rng)
    aside = rng.uniform(1.0, 4.0) * rng.choice([-1, 1])
    add_twin(scene, rng, lambda i, u: u + aside, int(rng.integers(N_MARKERS)), rng.uniform(-1, 1))
    return scene


def twin_near(rng: np.random.Generator) -> Scene:
    """A second disc 5 to 40 px beside a marker, moving with it."""
    scene = plain(rng)
    aside = rng.uniform(5.0, 40.0) * rng.choice([-1, 1])
    add_twin(scene, rng, lambda i, u: u + aside, int(rng.integers(N_MARKERS)), rng.uniform(-4, 4))
    return scene


def twin_resting(rng: np.random.Generator) -> Scene:
    """A disc at rest within the swing of a marker."""
    scene = plain(rng, amplitude_px=rng.uniform(5, 30))
    at = 320 + rng.uniform(-30, 30)
    add_twin(scene, rng, lambda i, u: at, int(rng.integers(N_MARKERS)), rng.uniform(-4, 4))
    return scene


def twin_moving(rng: np.random.Generator) -> Scene:
    """A disc that crosses a marker's row."""
    scene = plain(rng)
    start, speed = rng.uniform(100, 540), rng.uniform(1, 8) * rng.choice([-1, 1])
    add_twin(scene, rng, lambda i, u: start + speed * i, int(rng.integers(N_MARKERS)), rng.uniform(-4, 4))
    return scene


def cover(rng: np.random.Generator, scene: Scene | None = None) -> Scene:
    """A bar that creeps over markers and goes; over a given scene, from its twelfth frame on."""
    first = 0 if scene is None else UNDISTURBED
    scene = plain(rng) if scene is None else scene
    width, speed = rng.uniform(4, 80), rng.uniform(0.3, 12)
    start, grey = 320 - rng.uniform(10, 60) - width, float(rng.choice([0, 20, 60, 120, 200]))
    top = rng.uniform(-50, 400)
    bottom = top + rng.uniform(30, 500)
    for i, frame in enumerate(disturbed(scene)[first:]):
        left = start + speed * i
        frame.disturbances = replace(
            frame.disturbances, occluders=(Occluder(left, top, left + width, bottom, grey),)
        )
        u, v = mean_columns(scene, frame), scene.camera.rows(frame.z)
        near = (u > left - 24) & (u < left + width + 24) & (v > top - 24) & (v < bottom + 24)
        frame.in_sight &= ~near
    return scene


def cover_and_twin(rng: np.random.Generator) -> Scene:
    """A cover over a marker that has a twin in its row."""
    return cover(rng, twin_resting(rng) if rng.random() < 0.5 else twin_near(rng))


def hidden(rng: np.random.Generator) -> Scene:
    """Markers that are hidden for a while, one or all, some beside a twin."""
    scene = twin_resting(rng) if rng.random() < 0.4 else plain(rng)
    chosen = rng.random(N_MARKERS) < 0.6
    first, count = int(rng.integers(UNDISTURBED, 35)), int(rng.integers(1, 25))
    for frame in disturbed(scene)[first : first + count]:
        if not frame.in_sight[chosen].all():
            break  # nobody can tell which of two that touch was hidden
        frame.x = frame.x.copy()
        frame.x[:, chosen] = np.nan
        frame.in_sight &= ~chosen
    return scene


def glare(rng: np.random.Generator) -> Scene:
    """A patch of light that wanders over the beam."""
    scene = plain(rng)
    radius, grey, speed = rng.uniform(3, 25), rng.uniform(20, 120), rng.uniform(-3, 3)
    v, start = rng.uniform(20, 460), 320 + rng.uniform(-60, 60)
    for i, frame in enumerate(disturbed(scene)):
        at = start + speed * i
        frame.disturbances = Disturbances(glares=(Glare(at, v, radius, grey),))
        u, rows = mean_columns(scene, frame), scene.camera.rows(frame.z)
        frame.in_sight &= np.hypot(u - at, rows - v) > 4 * radius + 15
    return scene


def specks(rng: np.random.Generator) -> Scene:
    """Small bright and dark specks, at rest or new in every frame."""
    scene = plain(rng)
    is_fixed, count = rng.random() < 0.5, int(rng.integers(5, 60))

    def scattered() -> list[tuple[float, float, float, float]]:
        return [
            (rng.uniform(200, 440), rng.uniform(20, 470), rng.uniform(0.5, 3.0), rng.uniform(-60, 180))
            for _ in range(count)
        ]

    same = scattered()
    for frame in disturbed(scene):
        frame.specks = same if is_fixed else scattered()
        u, v = mean_columns(scene, frame), scene.camera.rows(frame.z)
        for at, row, radius, _ in frame.specks:
            frame.in_sight &= np.hypot(u - at, v - row) > 24 + radius
    return scene


def threads(rng: np.random.Generator) -> Scene:
    """A thread, bright or dark, that drifts across the picture."""
    scene = plain(rng)
    angle, width, grey = rng.uniform(0, math.pi), rng.uniform(0.7, 3), rng.uniform(-150, 200)
    at, speed = rng.uniform(-40, 40), rng.uniform(-1.5, 1.5)
    row = rng.uniform(30, 460)
    for i, frame in enumerate(disturbed(scene)):
        frame.threads = [(320 + at + speed * i, row, angle, width, grey)]
        u, v = mean_columns(scene, frame), scene.camera.rows(frame.z)
        away = np.abs((u - 320 - at - speed * i) * math.sin(angle) - (v - row) * math.cos(angle))
        frame.in_sight &= away > 24 + width
    return scene


def torn(rng: np.random.Generator) -> Scene:
    """Frames whose lower part is that of the frame before."""
    scene = plain(rng, amplitude_px=30.0)
    for frame in disturbed(scene)[1:]:
        if rng.random() < 0.2:
            frame.tear_row = int(rng.integers(5, 475))
            frame.in_sight &= np.abs(scene.camera.rows(frame.z) - frame.tear_row) > 24
    return scene


def light_step(rng: np.random.Generator) -> Scene:
    """Light that changes at once by 0.3 to 2.5 times."""
    scene = plain(rng)
    at, gain = int(rng.integers(1, 30)), float(np.exp(rng.uniform(math.log(0.3), math.log(2.5))))
    scene.camera = replace(scene.camera, contrast=100.0 if gain > 1.3 else 180.0)
    for frame in disturbed(scene)[at:]:
        frame.gain = gain
    return scene


def exposure_following(rng: np.random.Generator) -> Scene:
    """A light step that the camera's exposure takes back within a second."""
    scene = light_step(rng)
    gains = [frame.gain for frame in disturbed(scene)]
    slow = 1.0
    for frame, gain in zip(disturbed(scene), gains, strict=True):
        slow += 0.1 * (gain - slow)
        frame.gain = gain / slow
    return scene


def flicker(rng: np.random.Generator) -> Scene:
    """Lamps that flicker at twice the mains frequency, or at random."""
    scene = plain(rng)
    scene.camera = replace(scene.camera, contrast=110.0)
    depth, cycles = rng.uniform(0.1, 0.7), rng.uniform(0.02, 0.5)
    is_random = rng.random() < 0.3
    for i, frame in enumerate(disturbed(scene)):
        wave = rng.uniform(-1, 1) if is_random else math.sin(2 * math.pi * cycles * i)
        frame.gain = 1.0 + depth * wave
    return scene


def drift(rng: np.random.Generator) -> Scene:
    """A camera that turns or sags by a tenth of a pixel a frame, for half a thousand frames."""
    scene = plain(rng, amplitude_px=float(rng.choice([0.0, 10.0])))
    du, dv = rng.uniform(-0.1, 0.1), rng.choice([-0.1, 0.1])
    pixel = 1.0 / scene.camera.pixels_per_metre
    more = motion(rng, 250, 0.5, 0.0)
    scene.frames.extend(Frame(scene.frames[k % len(scene.frames)].x + more[k], HEIGHTS) for k in range(250))
    for i, frame in enumerate(scene.frames):
        frame.x = frame.x + du * i * pixel
        frame.z = frame.z - dv * i * pixel * (0.4 if dv > 0 else 1.0)
    return scene


def shake(rng: np.random.Generator) -> Scene:
    """A camera shaken by 20 px."""
    scene = plain(rng, exposure_s=0.0005)
    pixel = 1.0 / scene.camera.pixels_per_metre
    cycles, size = rng.uniform(0.05, 0.5), rng.uniform(5, 20)
    for i, frame in enumerate(disturbed(scene)):
        wave = math.sin(2 * math.pi * cycles * i)
        frame.x = frame.x + size * wave * pixel
        frame.z = frame.z + 0.3 * size * math.cos(2 * math.pi * cycles * i) * pixel
    return scene


def swing(rng: np.random.Generator) -> Scene:
    """A hub or a beam that swings by up to 150 px a frame, shortly exposed."""
    scene = plain(rng, exposure_s=0.0002)
    pixel = 1.0 / scene.camera.pixels_per_metre
    fastest, cycles = rng.uniform(30, 150), rng.uniform(0.08, 0.2)
    size = min(fastest / (2 * math.pi * cycles), 250.0)
    shape = np.ones(N_MARKERS) if rng.random() < 0.5 else (HEIGHTS / RIG.beam.length) ** 1.8
    instants = np.polynomial.legendre.leggauss(6)[0] / 2 * 0.02
    for i, frame in enumerate(disturbed(scene)):
        wave = np.sin(2 * math.pi * cycles * (i + instants))
        frame.x = frame.x + size * pixel * wave[:, None] * shape
    return scene


def gradient(rng: np.random.Generator) -> Scene:
    """Light that falls off across the picture."""
    scene = plain(rng)
    scene.camera = replace(scene.camera, contrast=120.0, background=float(rng.uniform(20, 60)))
    scene.slope = rng.uniform(-1.5, 1.5), rng.uniform(-1.0, 1.0)
    return scene


def defocus(rng: np.random.Generator) -> Scene:
    """A lens out of focus."""
    return plain(rng, blur_px=rng.uniform(1.0, 3.0))


def compressed(rng: np.random.Generator) -> Scene:
    """Frames that were JPEG."""
    scene = plain(rng)
    scene.quality = int(rng.integers(60, 97))
    return scene


def saturated(rng: np.random.Generator) -> Scene:
    """Markers brighter than the sensor can say."""
    scene = plain(rng)
    scene.saturation = rng.uniform(1.2, 2.0)
    return scene


def textured(rng: np.random.Generator) -> Scene:
    """A background with a grain of its own, at rest."""
    scene = plain(rng)
    scene.texture = rng.uniform(2, 12)
    return scene


def shot_noise(rng: np.random.Generator) -> Scene:
    """A sensor with few electrons."""
    scene = plain(rng)
    scene.shot = rng.uniform(0.02, 0.3)
    return scene


def gaps(rng: np.random.Generator) -> Scene:
    """Frames that are missing, some of them where a twin touches."""
    scene = twin_joined(rng) if rng.random() < 0.4 else plain(rng)
    for _ in range(int(rng.integers(1, 5))):
        at = int(rng.integers(1, FRAMES - 12))
        for frame in disturbed(scene)[at : at + int(rng.integers(1, 9))]:
            frame.is_dropped = True
    return scene


def leaving(rng: np.random.Generator) -> Scene:
    """A beam that leaves the picture for a while, and a disc in a marker's row that comes in meanwhile."""
    scene = plain(rng)
    side, speed, far = rng.choice([-1, 1]), rng.uniform(8, 25), rng.uniform(300, 380)
    towards, twin_speed, first = side * rng.choice([-1, 1]), rng.uniform(3, 15), rng.uniform(0, 20)
    back = UNDISTURBED + int(far / speed) + int(rng.integers(2, 20))
    for i, frame in enumerate(disturbed(scene)):
        away = min(max(0, i - UNDISTURBED) * speed, far, max(0.0, far - (i - back) * speed))
        frame.x = frame.x + side * away / scene.camera.pixels_per_metre
    add_twin(
        scene,
        rng,
        lambda i, u: 320 + towards * (340 - twin_speed * max(0.0, i - first)),
        int(rng.integers(N_MARKERS)),
        rng.uniform(-1, 1),
    )
    return scene


def ghost(rng: np.random.Generator) -> Scene:
    """A reflection of the whole picture beside itself, or mirrored: it moves with the markers, or against them."""
    scene = plain(rng, contrast=120.0)
    du, strength = rng.uniform(2.0, 7.0) * rng.choice([-1, 1]), rng.uniform(0.2, 0.5)
    dv = float(rng.choice([0.0, rng.uniform(-1.0, 1.0) * du]))
    over = Ghost(du, dv, strength, is_mirrored=bool(rng.random() < 0.5))
    middle, near = scene.camera.width - 1, scene.camera.marker_diameter_px + 14
    for frame in disturbed(scene):
        frame.ghost = over
        u = mean_columns(scene, frame)
        aside = middle - 2 * u + du if over.is_mirrored else np.full_like(u, du)
        frame.in_sight &= np.abs(aside) > near
    return scene


def doubled(rng: np.random.Generator) -> Scene:
    """Frames into which a decoder blends the frame before."""
    scene = plain(rng, amplitude_px=rng.uniform(5, 40))
    share = rng.uniform(0.2, 0.5)
    frames = disturbed(scene)
    for before, frame in pairwise(frames):
        if rng.random() < 0.2:
            frame.older_share = share
            frame.in_sight &= np.abs(mean_columns(scene, frame) - mean_columns(scene, before)) < 0.3
    return scene


def appearing(rng: np.random.Generator) -> Scene:
    """A disc that comes into a marker's row while the marker is hidden, and rests, moves, or swings with it."""
    scene = plain(rng)
    k, diameter = int(rng.integers(N_MARKERS)), scene.camera.marker_diameter_px
    first, count = int(rng.integers(UNDISTURBED, 35)), int(rng.integers(2, 25))
    place = mean_columns(scene, disturbed(scene)[first])[k]
    side, gap = rng.choice([-1, 1]), rng.uniform(1.0, 5.0) * diameter
    start, speed, goes = place + side * gap, float(rng.choice([0.0, rng.uniform(-3, 3)])), rng.random() < 0.3
    at = first + int(rng.integers(0, count))

    def way(i: int, u: float) -> float:
        if i < at:
            return -1e3
        return u + side * gap if goes else start + speed * (i - at)

    add_twin(scene, rng, way, k, rng.uniform(-1, 1))
    for frame in disturbed(scene)[first : first + count]:
        if frame.in_sight[k]:
            frame.x = frame.x.copy()
            frame.x[:, k] = np.nan
            frame.in_sight[k] = False
    return scene


def shadow(rng: np.random.Generator) -> Scene:
    """A shadow with soft edges that creeps over the beam, or lies on a part of its way."""
    scene = plain(rng)
    over = Shadow(
        320 + rng.uniform(-60, 60),
        rng.uniform(-0.6, 0.6),
        rng.uniform(30, 300),
        rng.uniform(3, 40),
        rng.uniform(0.3, 0.85),
    )
    speed = float(rng.choice([0.0, rng.uniform(-8, 8)]))
    for i, frame in enumerate(disturbed(scene)):
        frame.shadow = replace(over, u=over.u + speed * i)
    return scene


def repeated(rng: np.random.Generator) -> Scene:
    """A camera that often has no new frame in time, and shows the one before again."""
    scene = plain(rng, amplitude_px=rng.uniform(5, 40))
    share = rng.uniform(0.05, 0.5)
    for frame in disturbed(scene)[UNDISTURBED:]:
        frame.is_repeated = bool(rng.random() < share)
        frame.in_sight &= not frame.is_repeated
    return scene


def interlaced(rng: np.random.Generator) -> Scene:
    """A camera that shows two instants, half a frame or a whole one apart, in even and odd rows."""
    scene = plain(rng, amplitude_px=rng.uniform(3, 30))
    apart, is_woven = (1.0, True) if rng.random() < 0.25 else (0.5, False)
    frames = scene.frames
    later = CubicSpline(np.arange(len(frames)), np.stack([frame.x for frame in frames]))
    first = int(rng.integers(2))
    for k, frame in enumerate(frames):
        frame.second_field = SecondField(later(k + apart), later(k + apart / 2), (first + k * is_woven) % 2)
    return scene


CLASSES: dict[str, Callable[[np.random.Generator], Scene]] = {
    kind.__name__: kind
    for kind in (
        plain,
        twin_joined,
        twin_near,
        twin_resting,
        twin_moving,
        cover,
        cover_and_twin,
        hidden,
        glare,
        specks,
        threads,
        torn,
        light_step,
        exposure_following,
        flicker,
        drift,
        shake,
        swing,
        gradient,
        defocus,
        compressed,
        saturated,
        textured,
        shot_noise,
        gaps,
        leaving,
        ghost,
        doubled,
        appearing,
        shadow,
        repeated,
        interlaced,
    )
}


# -- the sensor ----------------------------------------------------------------------------------------------


@cache
def _renderer(camera: CameraParameters) -> SceneRenderer:
    return SceneRenderer(camera, HEIGHTS, strip_heights=np.linspace(0.0, RIG.beam.length, 13))


def _soft(depth: np.ndarray) -> np.ndarray:
    """Coverage so deep inside of a blurred edge [px]."""
    return np.asarray(0.5 * (1 + np.tanh(depth / 0.9)), dtype=np.float32)


def _drawn(picture: np.ndarray, frame: Frame) -> None:
    """Draw specks and threads into a picture."""
    height, width = picture.shape
    for u, v, radius, grey in frame.specks:
        reach = math.ceil(radius + 3)
        left, top = max(0, round(u) - reach), max(0, round(v) - reach)
        part = picture[top : round(v) + reach + 1, left : round(u) + reach + 1]
        y, x = np.mgrid[top : top + part.shape[0], left : left + part.shape[1]]
        part += grey * _soft(radius - np.hypot(x - u, y - v))
    for u, v, angle, thick, grey in frame.threads:
        y, x = np.mgrid[:height, :width]
        away = np.abs((x - u) * math.sin(angle) - (y - v) * math.cos(angle))
        picture += grey * _soft(thick / 2 - away)


def _with_ghost(picture: np.ndarray, ghost: Ghost, background: float) -> np.ndarray:
    """Add a reflection of a picture to it."""
    light = picture[:, ::-1] if ghost.is_mirrored else picture
    aside = np.array([[1.0, 0.0, ghost.du], [0.0, 1.0, ghost.dv]])
    moved = cv2.warpAffine(light, aside, light.shape[::-1], borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(picture + np.float32(ghost.strength) * (moved - np.float32(background)))


def pictures(
    scene: Scene, rng: np.random.Generator
) -> Iterator[tuple[int, np.ndarray, np.ndarray, np.ndarray]]:
    """Stamp, picture, true columns (2, n_markers; two where it is torn or doubled), and what is in sight."""
    camera = scene.camera
    renderer = _renderer(camera)
    height, width = camera.height, camera.width
    across = (np.arange(width) - width / 2)[None, :] / width
    down = (np.arange(height) - height / 2)[:, None] / height
    even = (1 + scene.slope[0] * across / 2 + scene.slope[1] * down / 2).astype(np.float32)
    grain = cv2.GaussianBlur(
        rng.standard_normal((height, width)).astype(np.float32), (0, 0), rng.uniform(0.7, 3)
    )
    grain *= scene.texture / max(float(grain.std()), 1e-6)
    before: tuple[np.ndarray, np.ndarray] | None = None
    picture = np.empty(0, dtype=np.uint8)
    for k, frame in enumerate(scene.frames):
        strip = np.interp(renderer.strip_heights, HEIGHTS, np.nan_to_num(frame.x.mean(axis=0)))
        clean = renderer.render(
            frame.x, rng, strip, marker_z=frame.z, disturbances=frame.disturbances
        ).astype(np.float32)
        truth = mean_columns(scene, frame)
        if frame.second_field is not None:
            x, middle, first_row = frame.second_field
            strip = np.interp(renderer.strip_heights, HEIGHTS, x.mean(axis=0))
            clean[first_row::2] = renderer.render(x, rng, strip, marker_z=frame.z)[first_row::2]
            truth = mean_columns(scene, replace(frame, x=middle))
        _drawn(clean, frame)
        if scene.texture:
            clean += grain * (1 - np.clip((clean - camera.background) / camera.contrast, 0, 1))
        shown, older = clean, truth
        if before is not None and frame.tear_row:
            shown = clean.copy()
            shown[frame.tear_row :] = before[0][frame.tear_row :]
            older = before[1]
        if before is not None and frame.older_share:
            shown = clean + np.float32(frame.older_share) * (before[0] - clean)
            older = before[1]
        before = clean, truth
        if frame.ghost is not None:
            shown = _with_ghost(shown, frame.ghost, camera.background)
        if frame.shadow is not None:
            shown = frame.shadow.over(shown)
        light = shown * (even * np.float32(frame.gain * scene.saturation))
        noise = np.sqrt(np.float32(scene.noise**2) + np.float32(scene.shot) * np.clip(light, 0, 255))
        light = light + noise * rng.standard_normal(light.shape, dtype=np.float32)
        last, picture = picture, np.clip(np.rint(light), 0, 255).astype(np.uint8)
        if frame.is_repeated:
            picture = last.copy()
        if scene.quality:
            coded = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, scene.quality])[1]
            picture = np.asarray(cv2.imdecode(coded, cv2.IMREAD_GRAYSCALE), dtype=np.uint8)
        u, v = camera.columns(frame.x.mean(axis=0)), camera.rows(frame.z)
        inside = (u > EDGE_PX) & (u < width - EDGE_PX) & (v > EDGE_PX) & (v < height - EDGE_PX)
        if not frame.is_dropped:
            yield 10**18 + k * PERIOD_NS, picture, np.stack([truth, older]), frame.in_sight & inside


# -- trackers: from a scene's pictures to columns and standard deviations -----------------------------------

Answer = tuple[np.ndarray, np.ndarray, tuple[str, ...]]


Shown = list[tuple[int, np.ndarray, np.ndarray, np.ndarray]]
"""A scene's frames as they come from ``pictures``."""


def suite(scene: Scene, film: Shown, rig: Rig = RIG) -> Iterator[Answer]:
    """The suite's own measuring chain, with the packaged rig's settings."""
    camera = replace(RIG.camera_parameters(), exposure_s=scene.camera.exposure_s)
    chain = MeasuringChain(
        camera,
        rig.tracker_parameters(),
        HEIGHTS.tolist(),
        LinearCalibration.from_camera(camera, 3),
        rig.beam_motion(),
    )
    came = 0
    for stamp_ns, picture, _, _ in film:
        here = (stamp_ns - 10**18) // PERIOD_NS + 1
        for frame in scene.frames[came:here]:
            for sample in frame.hub:
                chain.hear_hub(*sample)
        came = here
        if chain.admit(stamp_ns):
            measured = chain.measure(stamp_ns, picture)
            yield measured.u_px, measured.sigma_px, measured.reasons
        else:
            yield np.full(N_MARKERS, np.nan), np.full(N_MARKERS, np.nan), ("not admitted",) * N_MARKERS


def beam(scene: Scene, film: Shown) -> Iterator[Answer]:
    """The same with tracker.prediction beam: what hub and model foretell."""
    return suite(scene, film, RIG.with_values({"tracker.prediction": "beam"}))


def _in_rows(scene: Scene, spots: list[tuple[float, float]]) -> Answer:
    rows = scene.camera.rows(HEIGHTS)
    found = [[u for u, v in spots if abs(v - row) < ROW_PX] for row in rows]
    columns = np.array([near[0] if len(near) == 1 else math.nan for near in found])
    return columns, np.zeros(N_MARKERS), tuple(f"{len(near)} spots" for near in found)


def opencv(scene: Scene, film: Shown) -> Iterator[Answer]:
    """OpenCV's SimpleBlobDetector at a threshold step of 2."""
    settings = cv2.SimpleBlobDetector_Params()
    settings.filterByColor, settings.blobColor = True, 255
    settings.minThreshold, settings.maxThreshold, settings.thresholdStep = 40, 200, 2
    area = math.pi / 4 * scene.camera.marker_diameter_px**2
    settings.filterByArea, settings.minArea, settings.maxArea = True, 0.4 * area, 2.5 * area
    settings.filterByConvexity = settings.filterByInertia = settings.filterByCircularity = False
    detector = cv2.SimpleBlobDetector_create(settings)
    for _, picture, _, _ in film:
        yield _in_rows(scene, [p.pt for p in detector.detect(picture)])


def trackpy(scene: Scene, film: Shown) -> Iterator[Answer]:
    """trackpy.locate without preprocessing."""
    import trackpy as package

    package.quiet()
    size = 2 * math.ceil(scene.camera.marker_diameter_px / 2 + 2) + 1
    for _, picture, _, _ in film:
        level = float(np.median(picture[::8, ::8])) + 15.0
        above = np.clip(picture.astype(np.float32) - level, 0, None)
        spots = package.locate(above, size, minmass=3000, preprocess=False)
        yield _in_rows(scene, list(zip(spots["x"], spots["y"], strict=True)))


def pyidi(scene: Scene, film: Shown) -> Iterator[Answer]:
    """Lucas-Kanade of pyidi from the true places in the first frame on, to a whole pixel."""
    import pyidi as package

    method = package.LucasKanade(
        package.VideoReader(np.stack([shown[1] for shown in film]), root=".", fps=100)
    )
    start = film[0][2][0]
    points = np.rint(np.stack([scene.camera.rows(scene.frames[0].z), start], axis=1)).astype(int)
    size = 2 * math.ceil(scene.camera.marker_diameter_px / 2 + 3) + 1
    method.set_points(points)
    method.configure(roi_size=(size, size), verbose=0, show_pbar=False)
    columns = start + method.get_displacements(autosave=False)[:, :, 1].T
    for row in columns:
        yield row, np.zeros(N_MARKERS), ("followed",) * N_MARKERS


TRACKERS = {"suite": suite, "beam": beam, "opencv": opencv, "trackpy": trackpy, "pyidi": pyidi}


# -- the verdict ---------------------------------------------------------------------------------------------


@dataclass
class Verdict:
    """What came of the scenes of one class."""

    scenes: int = 0
    valid: int = 0
    in_sight: int = 0
    valid_in_sight: int = 0
    wrong: int = 0
    wrong_scenes: list[int] = field(default_factory=list)
    largest_px: float = 0.0
    squares: float = 0.0
    squares_px: float = 0.0
    counted: int = 0
    waits: list[int] = field(default_factory=list)
    ambiguous: list[int] = field(default_factory=list)
    reasons: dict[str, int] = field(default_factory=dict)


def twins(scene: Scene) -> np.ndarray:
    """For which markers a second disc is in the row, or was of late, shape (n_frames, n_markers)."""
    camera = scene.camera
    shown = np.zeros((len(scene.frames), N_MARKERS), dtype=bool)
    for k, frame in enumerate(scene.frames):
        for spot in frame.disturbances.spots:
            if 0 <= spot.u_px < camera.width:
                shown[k : k + MEMORY_FRAMES + 1] |= np.abs(camera.rows(frame.z) - spot.v_px) < ROW_PX
    return shown


def judge(
    name: str, kind: str, seed: int, verdict: Verdict, *, is_driven: bool = False, is_verbose: bool = False
) -> None:
    """Run a tracker over one scene, of a beam that moves anyhow, or as a hub drives it."""
    global IS_DRIVEN
    IS_DRIVEN = is_driven
    rng = np.random.default_rng([list(CLASSES).index(kind), seed])
    scene = CLASSES[kind](rng)
    film = list(pictures(scene, rng))
    beside = twins(scene)
    wait, has_twin = np.zeros(N_MARKERS, dtype=int), np.zeros(N_MARKERS, dtype=bool)
    verdict.scenes += 1

    def end(m: int) -> None:
        (verdict.ambiguous if has_twin[m] else verdict.waits).append(int(wait[m]))
        wait[m], has_twin[m] = 0, False

    n_wrong = 0
    answers = TRACKERS[name](scene, film)
    for k, ((stamp_ns, _, truth, in_sight), (u, sigma, reasons)) in enumerate(
        zip(film, answers, strict=True)
    ):
        errors = u - truth
        error = np.where(np.abs(errors[0]) < np.abs(errors[1]), errors[0], errors[1])
        # A marker that is hidden has no place: whatever is valid there is wrong.
        error = np.where(np.isfinite(u) & ~np.isfinite(error), 1e3, error)
        is_valid = np.isfinite(u)
        is_wrong = is_valid & (np.abs(error) > np.maximum(WRONG_PX, WRONG_SIGMAS * sigma))
        verdict.valid += int(is_valid.sum())
        verdict.in_sight += int(in_sight.sum())
        verdict.valid_in_sight += int((is_valid & in_sight).sum())
        n_wrong += int(is_wrong.sum())
        if is_wrong.any():
            verdict.largest_px = max(verdict.largest_px, float(np.abs(error[is_wrong]).max()))
        good = is_valid & ~is_wrong
        verdict.squares_px += float(np.sum(error[good] ** 2))
        if (sigma[good] > 0).all():
            verdict.squares += float(np.sum((error[good] / sigma[good]) ** 2))
        verdict.counted += int(good.sum())
        for m in range(N_MARKERS):
            if in_sight[m] and not is_valid[m]:
                wait[m] += 1
                has_twin[m] |= beside[(stamp_ns - film[0][0]) // PERIOD_NS, m]
                verdict.reasons[reasons[m]] = verdict.reasons.get(reasons[m], 0) + 1
            elif wait[m]:
                end(m)
        if is_verbose:
            shown = " ".join(
                f"{'!' if is_wrong[m] else ''}{error[m]:+.2f}"
                if is_valid[m]
                else reasons[m] + ("*" if in_sight[m] else "")
                for m in range(N_MARKERS)
            )
            print(f"    {k:3d} {shown}")
    for m in range(N_MARKERS):
        if wait[m]:
            end(m)
    if n_wrong:
        verdict.wrong += n_wrong
        verdict.wrong_scenes.append(seed)


def main() -> int:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenes", type=int, default=40, help="scenes of each class (default 40)")
    parser.add_argument("--only", nargs="+", choices=list(CLASSES), help="classes (default: all)")
    parser.add_argument("--seed", type=int, default=0, help="number of the first scene")
    parser.add_argument("--trackers", nargs="+", choices=list(TRACKERS), default=["suite"])
    parser.add_argument("--driven", action="store_true", help="a hub drives the beam, and is heard")
    parser.add_argument("--verbose", action="store_true", help="print every frame")
    parser.add_argument("--json", type=Path, help="write the rows to this file")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    rows: list[dict[str, Any]] = []
    for name in arguments.trackers:
        print(
            f"{name:20s} in sight  valid of it   wrong (scenes)  largest     off      z   "
            "wait 95 %, most, ambiguous   lost by"
        )
        for kind in arguments.only or CLASSES:
            verdict = Verdict()
            for seed in range(arguments.seed, arguments.seed + arguments.scenes):
                judge(name, kind, seed, verdict, is_driven=arguments.driven, is_verbose=arguments.verbose)
            waits = np.array(verdict.waits or [0])
            row = {
                "tracker": name,
                "class": kind,
                "valid": verdict.valid_in_sight / max(verdict.in_sight, 1),
                "wrong": verdict.wrong,
                "wrong_scenes": verdict.wrong_scenes,
                "largest_px": verdict.largest_px,
                "z": math.sqrt(verdict.squares / max(verdict.counted, 1)),
                "off_px": math.sqrt(verdict.squares_px / max(verdict.counted, 1)),
                "wait_95": float(np.percentile(waits, 95)),
                "wait_most": int(waits.max()),
                "wait_ambiguous": max(verdict.ambiguous, default=0),
                "reasons": verdict.reasons,
            }
            rows.append(row)
            why = sorted(verdict.reasons.items(), key=lambda item: -item[1])[:3]
            print(
                f"  {kind:18s} {verdict.in_sight:8d} {100 * row['valid']:9.1f} %  {verdict.wrong:6d} "
                f"({len(verdict.wrong_scenes):3d})  {verdict.largest_px:8.2f}  {row['off_px']:.4f}  {row['z']:5.2f}  "
                f"{row['wait_95']:6.0f} {row['wait_most']:5d} {row['wait_ambiguous']:5d}    "
                f"{', '.join(f'{w} {n}' for w, n in why)}"
                + (f"   wrong in {verdict.wrong_scenes[:8]}" if verdict.wrong_scenes else ""),
                flush=True,
            )
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
