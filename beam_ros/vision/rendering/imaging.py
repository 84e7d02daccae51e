"""From the light of a scene to the picture that a camera stores: everything that goes wrong on that way.

In the order in which it happens: what lies behind the beam and how it is lit, the light's steps and flicker, shot
noise of counted electrons, noise of reading, saturation, rounding, compression. The camera's own motion moves the
scene before it is drawn. A frame's disturbances depend on the seed and its number alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import cv2
import numpy as np

from beam_ros.arrays import ByteArray, Float32Array
from beam_ros.vision.errors import VisionParameterError
from beam_ros.vision.parameters import CameraParameters
from beam_ros.vision.rendering.disturbances import Disturbances, Occluder, SecondSpot

_COVER_FRAMES = 12
_TEXTURE_PX = 4.0
_FLICKER_HZ = 100.3
"""Twice that of the mains, which keep 50 Hz to 0.2: a camera of 50 or 100 frames a second sees a slow beat."""


@dataclass(frozen=True)
class CameraFaults:
    """What disturbs a film, all of it absent by default.

    Attributes
    ----------
    gain : float -- of the camera: above 1 the brightest saturate
    jpeg : int -- quality of compression, 1 to 100; 0: none
    light_step : float -- factor of the light from the middle of the film on
    flicker : float -- amplitude of the light's flicker, as a share
    gradient : float -- rise of the light from the left edge to the right, as a share of the middle
    texture : float -- of the ground behind the beam, standard deviation [grey levels of 255]
    strip_texture : float -- of the strip along its length, standard deviation as a share of its contrast
    drift : float -- of the camera along u [px a frame]
    shake : float -- of the camera in both directions, standard deviation [px]
    twins : int -- resting spots like markers beside the beam
    cover : float -- share of the frames in which something hides a part of the beam
    """

    gain: float = 1.0
    jpeg: int = 0
    light_step: float = 1.0
    flicker: float = 0.0
    gradient: float = 0.0
    texture: float = 0.0
    strip_texture: float = 0.0
    drift: float = 0.0
    shake: float = 0.0
    twins: int = 0
    cover: float = 0.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            low, high = _RANGES.get(field.name, (0.0, math.inf))
            if not (math.isfinite(value) and low <= value <= high):
                raise VisionParameterError(
                    f"{field.name.replace('_', '-')} is {value!r}; expected a number from {low:g} to {high:g}: "
                    f"correct "
                    f"--{field.name.replace('_', '-')}"
                )


_RANGES = {
    "gain": (0.01, 100.0),
    "jpeg": (0, 100),
    "light_step": (0.0, 100.0),
    "flicker": (0.0, 1.0),
    "gradient": (-2.0, 2.0),
    "texture": (0.0, 128.0),
    "strip_texture": (0.0, 1.0),
    "drift": (-100.0, 100.0),
    "shake": (0.0, 200.0),
    "twins": (0, 100),
    "cover": (0.0, 0.9),
}


class FaultyCamera:
    """Takes pictures of scenes.

    Parameters
    ----------
    camera : CameraParameters -- its own noise, size and ground
    faults : CameraFaults
    n_frames : int -- of the film, which has its step of light in the middle
    full_well : float -- electrons at grey level 255; 0: no shot noise
    seed : int
    """

    def __init__(
        self, camera: CameraParameters, faults: CameraFaults, n_frames: int, full_well: float, seed: int
    ) -> None:
        self._camera, self._faults = camera, faults
        self._n_frames, self._full_well, self._seed = n_frames, full_well, seed
        rng = np.random.default_rng([seed, 0])
        shape = (camera.height, camera.width)
        ground = cv2.GaussianBlur(rng.standard_normal(shape).astype(np.float32), (0, 0), _TEXTURE_PX)
        self._ground = np.asarray(ground / ground.std() * faults.texture, dtype=np.float32)
        across = np.linspace(-0.5, 0.5, camera.width, dtype=np.float32)
        self._lit = 1.0 + faults.gradient * across[None, :]
        # Texture of the strip belongs to its rows: it rides along.
        along = np.convolve(rng.standard_normal(camera.height + 8), np.ones(9) / 3.0, mode="valid")
        self._rows = (1.0 + faults.strip_texture * along).clip(0.0).astype(np.float32)
        side = rng.choice([-1.0, 1.0], faults.twins) * rng.uniform(12, 40, faults.twins)
        rows = rng.uniform(0.05, 0.95, faults.twins) * camera.height
        self._twins = tuple(
            SecondSpot(camera.origin_px[0] + float(u), float(v)) for u, v in zip(side, rows, strict=True)
        )
        starts = rng.random(max(n_frames, 1)) < faults.cover / _COVER_FRAMES
        self._covers = {int(k): float(rng.uniform(0.1, 0.8)) for k in np.flatnonzero(starts)}

    def shift(self, k: int) -> tuple[float, float]:
        """Where frame k's scene lies against the first one's, along u and v [px]."""
        u, v = self._faults.shake * np.random.default_rng([self._seed, 1, k]).standard_normal(2)
        return float(u) + self._faults.drift * k, float(v)

    def disturbances(self, k: int) -> Disturbances:
        """What stands beside and before the beam in frame k."""
        camera = self._camera
        top = next((self._covers[j] for j in range(k, k - _COVER_FRAMES, -1) if j in self._covers), None)
        covers: tuple[Occluder, ...] = ()
        if top is not None:
            row, reach = top * camera.height, 0.15 * camera.height
            covers = (Occluder(0.2 * camera.width, row, 0.9 * camera.width, row + reach, camera.background),)
        du, dv = self.shift(k)
        return Disturbances(
            tuple(SecondSpot(spot.u_px + du, spot.v_px + dv) for spot in self._twins), (), covers
        )

    def picture(self, k: int, stamp_ns: int, light: Float32Array, rng: np.random.Generator) -> ByteArray:
        """Take the picture of a scene.

        Parameters
        ----------
        k : int -- number of the frame
        stamp_ns : int -- when it was taken [ns]
        light : ndarray, shape (height, width) -- light of the scene [grey levels of 255]
        rng : numpy.random.Generator -- source of this frame's noise

        Returns
        -------
        ndarray, shape (height, width), uint8
        """
        faults, camera = self._faults, self._camera
        seen = light
        if faults.strip_texture:
            seen = camera.background + (seen - camera.background) * self._rows[:, None]
        brightness = faults.light_step if k >= self._n_frames // 2 else 1.0
        brightness *= 1.0 + faults.flicker * math.sin(2.0 * math.pi * _FLICKER_HZ * stamp_ns * 1e-9)
        seen = np.maximum((seen + self._ground) * self._lit * np.float32(brightness * faults.gain), 0.0)
        variance = np.float32(camera.noise_grey**2) + (
            seen * (255.0 / self._full_well) if self._full_well else 0.0
        )
        noisy = seen + np.sqrt(variance) * rng.standard_normal(seen.shape, dtype=np.float32)
        picture = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
        if faults.jpeg:
            _, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, int(faults.jpeg)])
            return np.asarray(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE), dtype=np.uint8)
        return np.asarray(picture)
