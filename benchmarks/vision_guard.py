"""The tracker's guard: films that a student makes, by a renderer of its own, and what the tracker answers to them.

    python -m benchmarks.vision_guard [--films N] [--only CLASS ...] [--seed K] [--compare] [--store] [--peer]

Every class is a kind of target, ground, camera or disturbance. The renderer shares nothing with the project's: a
shape is its chords, whose overlap with the pixels is exact along u and summed over 1/4 px of the rows, averaged over
the exposure, blurred there and integrated over the pixels. Printed for each class, of the markers that a person sees:

* valid: share of the frames after the first five in which a marker that nothing touches is valid
* z: RMS of error over stated standard deviation, of what is not wrong, the marker's constant offset included
* wrong: valid points beyond six stated standard deviations and 0.35 px, and the largest error of these [px]
* peer (``--peer``): share found by OpenCV's blob detector within 0.35 px of the truth, in the marker's rows
* why: what most of the others were refused for

``--store`` writes the table to ``vision_guard.json`` beside this file, ``--compare`` prints the stored figures
beside the new ones and ends with status 1 where a class has more wrong points, or loses more than 1 % of its frames.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

from beam_ros.rig.rig import Rig
from beam_ros.vision.calibration.linear import LinearCalibration
from beam_ros.vision.measurement.measuring_chain import MeasuringChain
from beam_ros.vision.parameters import TrackerParameters

STORED = Path(__file__).with_suffix(".json")
RIG = Rig.from_file()
HEIGHTS = (0.05, 0.18, 0.31)
SCALE = 800.0
SIZE = 320, 340
FRAMES = 60
START_FRAMES = 5
PERIOD_NS = 10_000_000
FINE = 4
"""Rows of the fine grid per pixel; its columns are as fine, and their coverage is exact."""
EDGE_PX = 16.0
"""A marker whose centre is nearer to the edge of the picture is cut, or as good as cut."""
WRONG_PX, WRONG_SIGMAS = 0.35, 6.0

Chords = Callable[[np.ndarray], list[tuple[np.ndarray, np.ndarray]]]
"""Left and right ends, about the centre, of what a shape covers at some distances below the centre [px]."""


# -- shapes --------------------------------------------------------------------------------------------------


def ellipse(half_u: float, half_v: float, lean: float = 0.0) -> Chords:
    """An ellipse, sheared along u by ``lean`` px per px of v."""

    def chords(y: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        half = half_u * np.sqrt(np.clip(1.0 - (y / half_v) ** 2, 0.0, None))
        return [(lean * y - half, lean * y + half)]

    return chords


def polygon(corners: Sequence[tuple[float, float]]) -> Chords:
    """A convex polygon."""
    points = np.array(corners, dtype=float)

    def chords(y: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        left, right = np.full(y.shape, np.inf), np.full(y.shape, -np.inf)
        for (u0, v0), (u1, v1) in zip(points, np.roll(points, -1, axis=0), strict=True):
            if v0 == v1:
                continue
            inside = (y >= min(v0, v1)) & (y < max(v0, v1))
            at = u0 + (u1 - u0) * (y - v0) / (v1 - v0)
            left = np.where(inside, np.minimum(left, at), left)
            right = np.where(inside, np.maximum(right, at), right)
        is_there = right > left
        return [(np.where(is_there, left, 0.0), np.where(is_there, right, 0.0))]

    return chords


def rectangle(half_u: float, half_v: float, angle: float = 0.0) -> Chords:
    """A rectangle, turned by an angle [rad]."""
    c, s = math.cos(angle), math.sin(angle)
    corners = [(-half_u, -half_v), (half_u, -half_v), (half_u, half_v), (-half_u, half_v)]
    return polygon([(c * u - s * v, s * u + c * v) for u, v in corners])


def triangle(size: float) -> Chords:
    """An isosceles triangle about its centre of gravity."""
    return polygon([(0.0, -2 * size / 3), (size / 2, size / 3), (-size / 2, size / 3)])


def cross(half: float, arm: float) -> Chords:
    """An upright cross."""

    def chords(y: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        width = np.where(np.abs(y) < arm, half, np.where(np.abs(y) < half, arm, 0.0))
        return [(-width, width)]

    return chords


def cut(chords: Chords, angle: float, depth: float) -> Chords:
    """A shape without what lies farther than ``depth`` from its centre in one direction [rad, px]."""
    c, s = math.cos(angle), math.sin(angle)

    def left(y: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        limit = (depth - s * y) / c if abs(c) > 1e-9 else np.where(s * y < depth, np.inf, -np.inf)
        kept = []
        for a, b in chords(y):
            a, b = (a, np.minimum(b, limit)) if c > 0 else (np.maximum(a, limit), b)
            kept.append((a, np.maximum(a, b)))
        return kept

    return left


def coverage(
    chords: Chords, u: np.ndarray, v: np.ndarray, reach: int, blur: float
) -> tuple[np.ndarray, int, int]:
    """Share of every pixel that a blurred shape covers, whose centre goes through (u, v) in the exposure.

    Returns
    -------
    picture : ndarray, shape (2 reach + 1, 2 reach + 1)
    left, top : int -- first column and row [px]
    """
    left, top = round(float(u.mean())) - reach, round(float(v.mean())) - reach
    count = (2 * reach + 1) * FINE
    edges = left - 0.5 + np.arange(count + 1) / FINE
    rows = top - 0.5 + (np.arange(count) + 0.5) / FINE
    fine = np.zeros((count, count))
    for at_u, at_v in zip(u, v, strict=True):
        for a, b in chords(rows - at_v):
            inside = np.clip(edges[None, :], (at_u + a)[:, None], (at_u + b)[:, None])
            fine += np.diff(inside, axis=1) * FINE
    fine = cv2.GaussianBlur(fine / len(u), (0, 0), blur * FINE)
    return fine.reshape(2 * reach + 1, FINE, -1, FINE).mean(axis=(1, 3)), left, top


# -- films ---------------------------------------------------------------------------------------------------


class Thing(NamedTuple):
    """Something that is drawn over the ground.

    Attributes
    ----------
    chords : Chords
    reach : int -- half the size of its picture [px]
    grey : float -- its level
    way : ndarray, shape (n_frames, n_instants, 2) -- its centre [px]
    grain : float -- relative scatter of its own light from pixel to pixel
    """

    chords: Chords
    reach: int
    grey: float
    way: np.ndarray
    grain: float = 0.0


@dataclass
class Film:
    """A film before it is drawn.

    Attributes
    ----------
    way : ndarray, shape (n_frames, n_instants, n_markers, 2) -- the markers' centres [px]
    shape, reach : Chords, int -- of the markers
    below, above : list of Thing -- drawn before and after the markers
    ground : ndarray -- grey levels
    seen : ndarray of bool, shape (n_frames, n_markers) -- a person sees the marker without doubt
    shown : list of int -- the frame whose light each image shows; noise is always fresh
    gain : ndarray, shape (n_frames,) -- light
    settings : dict -- parameters of the tracker that a user would have set
    has_own_centre : bool -- which point of the shape is its centre is a convention: errors are about their median
    """

    rng: np.random.Generator
    way: np.ndarray
    shape: Chords = field(default_factory=lambda: ellipse(6.0, 6.0))
    reach: int = 14
    diameter: float = 12.0
    grey: float = 200.0
    grain: float = 0.0
    blur: float = 0.8
    noise: float = 2.0
    ground: np.ndarray = field(default_factory=lambda: np.full(SIZE[::-1], 20.0))
    below: list[Thing] = field(default_factory=list)
    above: list[Thing] = field(default_factory=list)
    seen: np.ndarray = field(default_factory=lambda: np.ones((FRAMES, len(HEIGHTS)), dtype=bool))
    shown: list[int] = field(default_factory=lambda: list(range(FRAMES)))
    gain: np.ndarray = field(default_factory=lambda: np.ones(FRAMES))
    is_dark: bool = False
    has_own_centre: bool = False
    quality: int = 0
    exposure: float = 0.2
    settings: dict[str, Any] = field(default_factory=dict)

    @property
    def truth(self) -> np.ndarray:
        """Mean columns in the exposure, shape (n_frames, n_markers) [px]."""
        return np.asarray(self.way[..., 0].mean(axis=1))


def swing(rng: np.random.Generator, amplitude: float, exposure: float = 0.2, instants: int = 8) -> np.ndarray:
    """Ways of the markers of a beam that swings on a hub that moves."""
    t = np.arange(FRAMES)[:, None] + exposure * ((np.arange(instants) + 0.5) / instants - 0.5)
    way = np.empty((*t.shape, len(HEIGHTS), 2))
    hub = (
        amplitude
        * rng.uniform(0.3, 1.0)
        * np.sin(2 * math.pi * rng.uniform(0.005, 0.02) * t + rng.uniform(0, 6.3))
    )
    bend = (
        amplitude
        * rng.uniform(0.3, 1.0)
        * np.sin(2 * math.pi * rng.uniform(0.03, 0.07) * t + rng.uniform(0, 6.3))
    )
    offset = rng.uniform(-0.5, 0.5, size=(len(HEIGHTS), 2))
    for k, height in enumerate(HEIGHTS):
        way[..., k, 0] = 160.0 + offset[k, 0] + hub + bend * (height / 0.33) ** 1.8
        way[..., k, 1] = SIZE[1] - 10 - SCALE * height + offset[k, 1]
    return way


def plain(rng: np.random.Generator, **changed: Any) -> Film:
    """Bright dots on dark ground."""
    amplitude = float(changed.pop("amplitude", rng.choice([0.0, 4.0, 12.0])))
    return Film(rng, swing(rng, amplitude, changed.get("exposure", 0.2)), **changed)


def small(rng: np.random.Generator) -> Film:
    """Dots of 6 px."""
    return plain(rng, shape=ellipse(3.0, 3.0), diameter=6.0)


def noisy(rng: np.random.Generator) -> Film:
    """Noise of 10 grey levels."""
    return plain(rng, noise=10.0)


def still(rng: np.random.Generator, u: float, v: float) -> np.ndarray:
    """Way of what rests."""
    return np.broadcast_to(np.array([u, v]), (FRAMES, 1, 2))


def label(rng: np.random.Generator) -> Film:
    """Dark dots on white labels of 20 to 95 px, on a dark or a grey ground, which move with the dots."""
    film = plain(rng, is_dark=True, grey=30.0)
    size, level = rng.uniform(20, 95), rng.uniform(10, 110)
    film.ground = np.full(SIZE[::-1], level)
    round_one = rng.random() < 0.3
    half_v = min(size / 2, 46.0)
    for k in range(len(HEIGHTS)):
        shape = (
            ellipse(size / 2, half_v) if round_one else rectangle(size / 2, half_v, rng.uniform(-0.05, 0.05))
        )
        film.below.append(Thing(shape, math.ceil(size / 2) + 6, 200.0, film.way[:, :, k]))
    return film


def pitched(rng: np.random.Generator) -> Film:
    """A camera pitched by 13 to 18 degrees, rolled by up to 15: dots lower than wide."""
    flat = math.cos(math.radians(rng.uniform(13, 18)))
    return plain(rng, shape=ellipse(6.0, 6.0 * flat, (1 - flat) * rng.uniform(-0.3, 0.3)))


def turned(rng: np.random.Generator) -> Film:
    """A camera that looks 13 to 18 degrees aside: dots narrower than high."""
    return plain(rng, shape=ellipse(6.0 * math.cos(math.radians(rng.uniform(13, 18))), 6.0))


def cut_dots(rng: np.random.Generator) -> Film:
    """Dots of which 3 to 12 % are cut off on one side, as by scissors."""
    share, angle = rng.uniform(0.03, 0.12), rng.uniform(0, 2 * math.pi)
    depths = np.linspace(0.0, 1.0, 2001)
    areas = (np.arccos(depths) - depths * np.sqrt(1 - depths**2)) / math.pi
    depth = 6.0 * float(np.interp(-share, -areas, depths))
    return plain(rng, shape=cut(ellipse(6.0, 6.0), angle, depth), has_own_centre=True)


def square(rng: np.random.Generator) -> Film:
    """Squares, turned a little."""
    return plain(rng, shape=rectangle(5.5, 5.5, rng.uniform(-0.2, 0.2)), has_own_centre=True)


def crosses(rng: np.random.Generator) -> Film:
    """Upright crosses."""
    return plain(rng, shape=cross(7.0, 3.0), has_own_centre=True)


def triangles(rng: np.random.Generator) -> Film:
    """Triangles."""
    return plain(rng, shape=triangle(16.0), diameter=13.0, has_own_centre=True)


def tape(rng: np.random.Generator) -> Film:
    """Pieces of grainy retro-reflective tape."""
    return plain(rng, shape=rectangle(5.5, 5.5, rng.uniform(-0.3, 0.3)), grain=0.15, has_own_centre=True)


def grainy(rng: np.random.Generator) -> Film:
    """Dots of grainy tape."""
    return plain(rng, grain=0.15, has_own_centre=True)


def noisy_repeats(rng: np.random.Generator) -> Film:
    """A camera that shows some frames twice, each with a grey level of noise of its own."""
    film = plain(rng, amplitude=float(rng.uniform(6, 20)), noise=float(rng.uniform(0.5, 1.5)))
    share = rng.uniform(0.1, 0.4)
    for k in range(12, FRAMES):
        if rng.random() < share:
            film.shown[k] = film.shown[k - 1]
            film.seen[k] = False
    return film


def bright_wall(rng: np.random.Generator) -> Film:
    """Dots on a black ground with a bright wall beside it."""
    film = plain(rng)
    at = rng.uniform(200, 240)
    film.ground[:, int(at) :] = 120.0
    return film


def two_rigs(rng: np.random.Generator) -> Film:
    """A second beam with dots of its own beside the first, kept out by ``tracker.region``."""
    film = plain(rng, amplitude=4.0, settings={"region_px": (80.0, 240.0, 0.0, float(SIZE[1]))})
    other = swing(rng, 4.0)
    for k in range(len(HEIGHTS)):
        film.below.append(Thing(film.shape, film.reach, film.grey, other[:, :, k] + [110.0, 0.0]))
    return film


def clutter(rng: np.random.Generator) -> Film:
    """Twenty-five spots of the markers' kind at rest, kept out by ``tracker.region``."""
    film = plain(rng, amplitude=4.0, settings={"region_px": (110.0, 210.0, 0.0, float(SIZE[1]))})
    for _ in range(25):
        u = rng.uniform(20, 95) if rng.random() < 0.5 else rng.uniform(225, 300)
        place = still(rng, u, rng.uniform(20, SIZE[1] - 20))
        film.below.append(Thing(ellipse(6.0, 6.0), 14, 200.0, place))
    return film


def vertical_vibration(rng: np.random.Generator) -> Film:
    """A camera that shakes up and down by 2 px for a whole period within the exposure."""
    film = plain(rng, exposure=0.5)
    phase = np.arange(8) / 8 * 2 * math.pi
    film.way[..., 1] += (rng.uniform(0.5, 2.0) * np.sin(phase))[None, :, None]
    return film


def smeared(rng: np.random.Generator) -> Film:
    """Fast motion in a long exposure: smears of up to 8 px."""
    return plain(rng, amplitude=float(rng.uniform(15, 25)), exposure=0.6)


def dust(rng: np.random.Generator) -> Film:
    """A dozen specks that drift."""
    film = plain(rng)
    for _ in range(12):
        start = np.array([rng.uniform(60, 260), rng.uniform(10, SIZE[1] - 10)])
        speed = rng.uniform(-2, 2, size=2)
        size = rng.uniform(0.7, 2.5)
        way = start + speed * np.arange(FRAMES)[:, None]
        film.above.append(Thing(ellipse(size, size), 9, float(rng.uniform(60, 220)), way[:, None, :]))
        away = np.hypot(*(film.way.mean(axis=1) - way[:, None, :]).transpose(2, 0, 1))
        film.seen &= away > 6.0 + size + 4.0
    return film


def leaving(rng: np.random.Generator) -> Film:
    """A beam that leaves the picture and comes back."""
    film = plain(rng, amplitude=4.0)
    away = rng.choice([-1, 1]) * 190.0 * np.clip(np.sin(math.pi * (np.arange(FRAMES) - 15) / 25), 0.0, None)
    away[40:] = 0.0
    film.way[..., 0] += away[:, None, None]
    return film


def covered(rng: np.random.Generator) -> Film:
    """A grey bar that passes over the beam."""
    film = plain(rng)
    width, speed, v = rng.uniform(6, 40), rng.uniform(1, 10), rng.uniform(40, 300)
    place = np.stack([rng.uniform(60, 110) + speed * np.arange(FRAMES), np.full(FRAMES, v)], axis=1)
    film.above.append(
        Thing(rectangle(width / 2, 60.0), 66, float(rng.choice([20.0, 90.0, 200.0])), place[:, None, :])
    )
    u = film.way.mean(axis=1)
    beside = np.abs(u[..., 0] - place[:, :1]) > width / 2 + 12
    film.seen &= beside | (np.abs(u[..., 1] - v) > 74)
    return film


def twin(rng: np.random.Generator, way: np.ndarray, film: Film, k: int) -> Film:
    """Add a second disc of the markers' kind, which touches the marker where it is near."""
    film.below.append(Thing(film.shape, film.reach, film.grey, way))
    near = np.hypot(*(film.way.mean(axis=1)[:, k] - way.mean(axis=1)).T) < 28
    # A person, too, waits until two that touched have parted.
    film.seen[np.convolve(near, np.ones(10))[:FRAMES] > 0, k] = False
    return film


def resting_twin(rng: np.random.Generator) -> Film:
    """A disc at rest in a marker's row."""
    film, k = plain(rng, amplitude=float(rng.uniform(4, 15))), int(rng.integers(len(HEIGHTS)))
    place = still(
        rng, 160 + rng.choice([-1, 1]) * rng.uniform(10, 60), film.way[0, 0, k, 1] + rng.uniform(-2, 2)
    )
    return twin(rng, place, film, k)


def passing_twin(rng: np.random.Generator) -> Film:
    """A disc that crosses a marker's row."""
    film, k = plain(rng), int(rng.integers(len(HEIGHTS)))
    speed = rng.uniform(2, 8) * rng.choice([-1, 1])
    u = 160 + speed * (np.arange(FRAMES) - 30)
    v = np.full(FRAMES, film.way[0, 0, k, 1] + rng.uniform(-2, 2))
    return twin(rng, np.stack([u, v], axis=1)[:, None, :], film, k)


def hidden(rng: np.random.Generator) -> Film:
    """Markers that are hidden for a while, by something of the ground's light."""
    film = plain(rng)
    first, count = int(rng.integers(15, 30)), int(rng.integers(1, 20))
    for k in range(len(HEIGHTS)):
        if rng.random() < 0.6:
            way = film.way[:, :, k].copy()
            way[:first] = way[first + count :] = -200.0
            film.above.append(Thing(rectangle(14.0, 14.0), 18, 20.0, way))
            film.seen[first : first + count, k] = False
    return film


def hidden_beside_twin(rng: np.random.Generator) -> Film:
    """A marker that is hidden while a disc at rest is in its row."""
    film = resting_twin(rng)
    k = int(np.argmin(np.abs(film.way[0, 0, :, 1] - film.below[0].way[0, 0, 1])))
    first, count = int(rng.integers(15, 30)), int(rng.integers(1, 20))
    way = film.way[:, :, k].copy()
    way[:first] = way[first + count :] = -200.0
    film.above.append(Thing(rectangle(14.0, 14.0), 18, 20.0, way))
    film.seen[first : first + count, k] = False
    return film


def kicked(rng: np.random.Generator) -> Film:
    """A camera that is kicked aside by up to 60 px between two frames."""
    film = plain(rng, amplitude=4.0)
    film.way[int(rng.integers(15, 40)) :, ..., 0] += rng.uniform(10, 60) * rng.choice([-1, 1])
    return film


def relit(rng: np.random.Generator) -> Film:
    """Light that changes at once."""
    film = plain(rng, grey=120.0)
    film.gain[int(rng.integers(12, 40)) :] = math.exp(rng.uniform(math.log(0.4), math.log(2.0)))
    return film


def ghost(rng: np.random.Generator) -> Film:
    """A weak second image 3 to 6 px beside every marker from some frame on: nobody sees the disc alone."""
    film = plain(rng, grey=140.0)
    first, aside = int(rng.integers(12, 30)), rng.uniform(3, 6) * rng.choice([-1, 1])
    for k in range(len(HEIGHTS)):
        way = film.way[:, :, k] + [aside, 0.0]
        way[:first] = -200.0
        film.above.append(Thing(film.shape, film.reach, -60.0, way))
    film.seen[first:] = False
    return film


def textured(rng: np.random.Generator) -> Film:
    """A ground with a grain of its own."""
    film = plain(rng)
    grain = cv2.GaussianBlur(rng.standard_normal(SIZE[::-1]), (0, 0), float(rng.uniform(0.7, 2.5)))
    film.ground = film.ground + 20 + grain * rng.uniform(2, 8) / grain.std()
    return film


def saturated(rng: np.random.Generator) -> Film:
    """Dots that are brighter than the sensor can say."""
    return plain(rng, grey=float(rng.uniform(300, 450)))


def coded(rng: np.random.Generator) -> Film:
    """Motion-JPEG."""
    return plain(rng, quality=int(rng.integers(60, 95)))


def uneven(rng: np.random.Generator) -> Film:
    """Light that falls off across the picture."""
    film = plain(rng, grey=130.0)
    across = np.linspace(-1, 1, SIZE[0])[None, :] * rng.uniform(-25, 25)
    film.ground = film.ground + 30 + across + np.linspace(-1, 1, SIZE[1])[:, None] * rng.uniform(-15, 15)
    return film


CLASSES: dict[str, Callable[[np.random.Generator], Film]] = {
    kind.__name__: kind
    for kind in (
        plain, small, noisy, label, pitched, turned, cut_dots, square, crosses, triangles, tape, grainy,
        noisy_repeats, bright_wall, two_rigs, clutter, vertical_vibration, smeared, dust, leaving, covered,
        resting_twin, passing_twin, hidden, hidden_beside_twin, kicked, relit, ghost, textured, saturated, coded,
        uneven,
    )
}  # fmt: skip


def _draw(picture: np.ndarray, thing: Thing, k: int, blur: float, grains: dict[int, np.ndarray]) -> None:
    """Draw a thing as it lies in a frame; one of a negative level adds its light."""
    way = thing.way[k]
    if not (-60 < way[:, 0].mean() < SIZE[0] + 60 and -60 < way[:, 1].mean() < SIZE[1] + 60):
        return
    share, left, top = coverage(thing.chords, way[:, 0], way[:, 1], thing.reach, blur)
    level = np.full_like(share, thing.grey)
    if thing.grain:
        # The grain is fixed to the thing: whole pixels of it move along.
        grain = grains[id(thing.way)]
        moved = way.mean(axis=0) - np.rint(way.mean(axis=0))
        shift = np.array([[1.0, 0.0, moved[0]], [0.0, 1.0, moved[1]]])
        level = level * (1 + cv2.warpAffine(grain, shift, grain.shape[::-1], borderMode=cv2.BORDER_REPLICATE))
    x0, y0 = max(left, 0), max(top, 0)
    x1, y1 = min(left + share.shape[1], SIZE[0]), min(top + share.shape[0], SIZE[1])
    if x0 >= x1 or y0 >= y1:
        return
    part = (slice(y0 - top, y1 - top), slice(x0 - left, x1 - left))
    under = picture[y0:y1, x0:x1]
    if thing.grey < 0:
        under -= share[part] * thing.grey
    else:
        under += share[part] * (level[part] - under)


def pictures(film: Film) -> Iterator[np.ndarray]:
    """Draw a film."""
    rng = film.rng
    markers = [
        Thing(film.shape, film.reach, film.grey, film.way[:, :, k], film.grain) for k in range(len(HEIGHTS))
    ]
    grains = {
        id(m.way): cv2.GaussianBlur(rng.standard_normal((2 * film.reach + 1,) * 2), (0, 0), 0.8)
        for m in markers
    }
    grains = {key: grain * film.grain / grain.std() for key, grain in grains.items()}
    for k in range(FRAMES):
        picture = film.ground.copy()
        for thing in (*film.below, *markers, *film.above):
            _draw(picture, thing, film.shown[k], film.blur, grains)
        picture = picture * film.gain[k] + film.noise * rng.standard_normal(picture.shape)
        grey = np.clip(np.rint(picture), 0, 255).astype(np.uint8)
        if film.quality:
            coded = cv2.imencode(".jpg", grey, [cv2.IMWRITE_JPEG_QUALITY, film.quality])[1]
            grey = np.asarray(cv2.imdecode(coded, cv2.IMREAD_GRAYSCALE), dtype=np.uint8)
        yield grey


# -- the verdict ---------------------------------------------------------------------------------------------


def chain(film: Film) -> MeasuringChain:
    """Return the suite's measuring chain as a user of the packaged rig file would run it."""
    camera = replace(
        RIG.camera_parameters(),
        width=SIZE[0],
        height=SIZE[1],
        pixels_per_metre=SCALE,
        origin_px=(160.0, SIZE[1] - 10.0),
        marker_diameter_m=film.diameter / SCALE,
        exposure_s=film.exposure * PERIOD_NS * 1e-9,
        contrast=-150.0 if film.is_dark else 180.0,
        background=200.0 if film.is_dark else 30.0,
    )
    usual = RIG.tracker_parameters()
    known = {field: value for field, value in film.settings.items() if hasattr(usual, field)}
    tracker = TrackerParameters.for_camera(
        camera,
        HEIGHTS,
        refinement=usual.refinement,
        sigma_floor_px=usual.sigma_floor_px,
        min_contrast_grey=usual.min_contrast_grey,
        **known,
    )
    return MeasuringChain(camera, tracker, HEIGHTS, LinearCalibration.from_camera(camera, len(HEIGHTS)))


def blobs(film: Film, picture: np.ndarray) -> np.ndarray:
    """Columns by OpenCV's blob detector: of the one blob in each marker's rows."""
    settings = cv2.SimpleBlobDetector_Params()
    settings.minThreshold, settings.maxThreshold, settings.thresholdStep = 10, 250, 5
    settings.filterByColor, settings.blobColor = True, 0 if film.is_dark else 255
    area = math.pi / 4 * film.diameter**2
    settings.filterByArea, settings.minArea, settings.maxArea = True, 0.4 * area, 2.5 * area
    settings.filterByConvexity = settings.filterByInertia = settings.filterByCircularity = False
    found = [blob.pt for blob in cv2.SimpleBlobDetector_create(settings).detect(picture)]
    columns = []
    for row in SIZE[1] - 10 - SCALE * np.array(HEIGHTS):
        near = [u for u, v in found if abs(v - row) < 8]
        columns.append(near[0] if len(near) == 1 else math.nan)
    return np.array(columns)


def _errors(u: np.ndarray, truth: np.ndarray, film: Film) -> np.ndarray:
    """Errors of columns, shape (n_frames, n_markers), about their medians where the centre is a convention [px]."""
    errors = u - truth
    if film.has_own_centre:
        errors -= [np.median(own[np.isfinite(own)]) if np.isfinite(own).any() else 0.0 for own in errors.T]
    return errors


def judge(kind: str, seed: int, *, with_peer: bool) -> tuple[dict[str, float], Counter[str]]:
    """Run the tracker over one film; returns sums and reasons."""
    film = CLASSES[kind](np.random.default_rng([sorted(CLASSES).index(kind), seed]))
    truth = film.truth
    inside = (truth > EDGE_PX) & (truth < SIZE[0] - EDGE_PX)
    cut_off = (truth < -20) | (truth > SIZE[0] + 20)
    seen = film.seen & inside
    seen[:START_FRAMES] = False
    measuring, why = chain(film), Counter[str]()
    sums = dict.fromkeys(("seen", "valid", "wrong", "largest", "squares", "counted", "peer"), 0.0)
    sums["seen"] = float(seen.sum())
    u, sigma, of_peer = (np.full(truth.shape, np.nan) for _ in range(3))
    for k, picture in enumerate(pictures(film)):
        stamp = 10**18 + k * PERIOD_NS
        measuring.admit(stamp)
        found = measuring.measure(stamp, picture)
        u[k], sigma[k] = found.u_px, found.sigma_px
        lost = seen[k] & ~np.isfinite(found.u_px)
        why.update(reason for reason, is_lost in zip(found.reasons, lost, strict=True) if is_lost)
        if with_peer:
            of_peer[k] = blobs(film, picture)
    is_valid = np.isfinite(u)
    error = np.abs(_errors(u, truth, film))
    error[is_valid & cut_off] = 1e3
    is_wrong = is_valid & (error > np.maximum(WRONG_PX, WRONG_SIGMAS * sigma))
    good = is_valid & ~is_wrong
    sums["valid"] = float((is_valid & seen).sum())
    sums["wrong"] = float(is_wrong.sum())
    sums["largest"] = float(error[is_wrong].max(initial=0.0))
    sums["squares"] = float(np.sum((error[good] / sigma[good]) ** 2))
    sums["counted"] = float(good.sum())
    sums["peer"] = float((seen & (np.abs(_errors(of_peer, truth, film)) < WRONG_PX)).sum())
    return sums, why


def row(kind: str, seeds: Sequence[int], *, with_peer: bool) -> dict[str, Any]:
    """What came of the films of one class."""
    total, why = Counter[str](), Counter[str]()
    largest = 0.0
    for seed in seeds:
        sums, reasons = judge(kind, seed, with_peer=with_peer)
        largest = max(largest, sums.pop("largest"))
        total.update(sums)  # type: ignore[arg-type]
        why += reasons
    found = {
        "valid": total["valid"] / max(total["seen"], 1),
        "z": math.sqrt(total["squares"] / max(total["counted"], 1)),
        "wrong": int(total["wrong"]),
        "largest_px": round(largest, 2),
        "why": dict(why.most_common(3)),
    }
    return {**found, "peer": total["peer"] / max(total["seen"], 1)} if with_peer else found


def main() -> int:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--films", type=int, default=5, help="films of each class (default 5)")
    parser.add_argument("--only", nargs="+", choices=list(CLASSES), help="classes (default: all)")
    parser.add_argument("--seed", type=int, default=0, help="number of the first film")
    parser.add_argument("--peer", action="store_true", help="run OpenCV's blob detector, too")
    parser.add_argument("--store", action="store_true", help=f"write the table to {STORED.name}")
    parser.add_argument("--compare", action="store_true", help=f"beside the table of {STORED.name}")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    before = json.loads(STORED.read_text(encoding="utf-8")) if STORED.exists() else {}
    table, is_worse = {}, False
    print(f"{'class':20s} {'valid':>7s} {'z':>6s} {'wrong':>6s} {'px':>7s}  {'peer':>6s}  before / why")
    for kind in arguments.only or CLASSES:
        found = row(kind, range(arguments.seed, arguments.seed + arguments.films), with_peer=arguments.peer)
        table[kind] = found
        said = ", ".join(f"{reason} {count}" for reason, count in found["why"].items())
        if arguments.compare and kind in before:
            old = before[kind]
            worse = found["wrong"] > old["wrong"] or found["valid"] < old["valid"] - 0.01
            is_worse |= worse
            said = f"{100 * old['valid']:5.1f} {old['z']:5.2f} {old['wrong']:4d} {'WORSE' if worse else '':5s} {said}"
        peer = f"{100 * found['peer']:6.1f}" if arguments.peer else " " * 6
        print(
            f"{kind:20s} {100 * found['valid']:7.1f} {found['z']:6.2f} {found['wrong']:6d} "
            f"{found['largest_px']:7.2f}  {peer}  {said}",
            flush=True,
        )
    if arguments.store:
        STORED.write_text(json.dumps({**before, **table}, indent=1) + "\n", encoding="utf-8")
    return int(is_worse)


if __name__ == "__main__":
    sys.exit(main())
