"""Rendered films of the strip alone, with the truth and the Cramer-Rao bound of every point."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr

from beam_ros.rig.rig import Rig
from beam_ros.vision.parameters import CameraParameters
from beam_ros.vision.rendering.frames import SceneRenderer
from beam_ros.vision.strip.following import StripParameters

RIG = Rig.from_file()
MODEL = RIG.beam_model()
_NODES = np.polynomial.legendre.leggauss(6)[0] / 2
_HEIGHTS = np.linspace(0.0, RIG.beam.length, 151)


@dataclass(frozen=True)
class Strip:
    """A film: light of every frame, and where the strip was on average over each exposure."""

    camera: CameraParameters
    light: np.ndarray
    truth: np.ndarray
    parameters: StripParameters

    def frames(self, rng: np.random.Generator) -> np.ndarray:
        """Frames with fresh noise, rounded and clipped."""
        noise = self.camera.noise_grey * rng.standard_normal(self.light.shape, dtype=np.float32)
        return np.clip(np.rint(self.light + noise), 0, 255).astype(np.uint8)


def film(
    n_frames: int,
    rows: np.ndarray,
    parameters: StripParameters,
    camera: CameraParameters,
    *,
    swing_m: float = 0.004,
    hub_m: float = 0.002,
    taper: float = 0.0,
) -> Strip:
    """Film a beam that swings in two modes on a hub that moves, and may be narrower at the tip by a share."""
    renderer = SceneRenderer(camera, [0.01], strip_heights=_HEIGHTS)
    tip = MODEL.shape([RIG.beam.length])[0, :2]
    above = (camera.origin_px[1] - rows) / camera.pixels_per_metre
    every_row = np.clip(_heights_of_rows(camera), 0.0, RIG.beam.length)

    def displacement(at: float, heights: np.ndarray) -> np.ndarray:
        q = np.array([swing_m * math.cos(27.5 * at), 0.06 * swing_m * math.cos(177.0 * at)]) / tip
        return hub_m * math.sin(9.0 * at) + MODEL.shape(heights)[:, :2] @ q

    light, truth = [], []
    for k in range(n_frames):
        times = k * camera.period_s + _NODES * camera.exposure_s
        if taper:
            light.append(
                _tapered(
                    camera, [displacement(at, every_row) for at in times], renderer.exposure_weights, taper
                )
            )
        else:
            light.append(renderer.light([np.nan], np.array([displacement(at, _HEIGHTS) for at in times])))
        mean = renderer.exposure_weights @ np.array([displacement(at, above) for at in times])
        truth.append(camera.columns(mean))
    return Strip(camera, np.array(light), np.array(truth), parameters)


def _heights_of_rows(camera: CameraParameters) -> np.ndarray:
    return (camera.origin_px[1] - np.arange(camera.height)) / camera.pixels_per_metre


def _tapered(
    camera: CameraParameters, moved: list[np.ndarray], weights: np.ndarray, taper: float
) -> np.ndarray:
    """Light of a strip with straight edges that lean, each a blurred step integrated over the pixels."""
    above = _heights_of_rows(camera)
    half = 0.5 * camera.strip_width_m * camera.pixels_per_metre * (1 - taper * above / RIG.beam.length)
    pixels = np.arange(camera.width)[None, :]

    def ramp(x: np.ndarray) -> np.ndarray:
        t = x / camera.blur_px
        return x * ndtr(t) + camera.blur_px * np.exp(-t * t / 2) / math.sqrt(2 * math.pi)

    share = np.zeros((camera.height, camera.width))
    for displacement, weight in zip(moved, weights, strict=True):
        x = pixels - np.asarray(camera.columns(displacement))[:, None]
        for sign in (1, -1):
            edge = x + sign * half[:, None]
            share += sign * weight * (ramp(edge + 0.5) - ramp(edge - 0.5))
    is_strip = (above >= 0) & (above <= RIG.beam.length)
    return camera.background + camera.strip_contrast * share * is_strip[:, None]


def camera_of(contrast: float, noise: float, width_px: float, **changes: object) -> CameraParameters:
    """Return the packaged camera, narrowed, with a strip of its own."""
    camera = RIG.camera_parameters()
    return replace(
        camera,
        width=160,
        origin_px=(80.3, camera.origin_px[1]),
        strip_contrast=contrast,
        noise_grey=noise,
        strip_width_m=width_px / camera.pixels_per_metre,
        **changes,
    )


def bound_px(camera: CameraParameters, rows: int, smear_px: np.ndarray) -> np.ndarray:
    """Cramer-Rao bound of a point of so many rows, for each smear, by brute force from the renderer's own pixels.

    Only the position is unknown here: ground and height, which the estimator does not know either, are symmetric.
    """
    step = 1e-2
    bounds = []
    for smear in np.atleast_1d(smear_px):
        information = 0.0
        for phase in np.arange(8) / 8:
            left, right = (_row(camera, phase + sign * step, float(smear)) for sign in (-0.5, 0.5))
            information += float(np.sum(((right - left) / step) ** 2)) / 8
        bounds.append(math.sqrt((camera.noise_grey**2 + 1 / 12) / (information * rows)))
    return np.array(bounds)


def _row(camera: CameraParameters, u: float, smear_px: float) -> np.ndarray:
    """Grey levels of a row, summed from a thousand fine samples a pixel."""
    fine = np.arange(-24.0, 24.0, 0.01) + 0.005
    half = camera.strip_width_m * camera.pixels_per_metre / 2
    bar = np.clip((half - np.abs(fine)) / 0.01 + 0.5, 0, 1)
    kernel = np.exp(-0.5 * (fine / camera.blur_px) ** 2)
    blurred = np.convolve(bar, kernel / kernel.sum(), mode="same")
    window = round(smear_px / 0.01)
    if window > 1:
        blurred = np.convolve(blurred, np.ones(window) / window, mode="same")
    pixels = np.arange(-20, 21)
    edges = np.interp(np.concatenate([pixels - 0.5, [20.5]]) - u, fine, np.cumsum(blurred) * 0.01, left=0.0)
    return camera.strip_contrast * np.diff(edges)
