"""Where the markers will be in the next frame, by the hub's motion and the beam's model: a Kalman filter.

The hub moves with an acceleration that forgets itself, at most as strong as the rig allows, and its encoder says
where it is; every mode of the beam answers to that acceleration; and a marker's image is

    u_k = s_k [alpha + sum_i phi_i(z_k) q_i](t_k) + b_k

with its scale s_k [px/m] and a zero b_k [px] that creeps, as cameras do. A model is never quite the beam, and a clock
never quite another: what is foretold is doubted by as much as the markers that were seen of late departed from it.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm

from beam_ros.arrays import FloatArray
from beam_ros.vision.tracking.marker_state import Foretold

_MEMORY_S = 1.0
"""So much of the hub's motion is remembered."""
_MAX_STEP = 20.0
"""After so many periods without a frame nothing is known."""
_MODEL_ERROR = 0.05
"""A mode's frequency is known to this share."""
_IMAGE_SD_PX = 0.05
"""What lens, print and model leave of a marker's place [px]."""
_CREEP_PX = 0.1
"""A marker's zero may creep so far from one frame to the next [px]: a camera that sags."""
_FAR_PX = 1000.0
_LATENESS_SD_S = 0.005
"""How far the camera's stamps may be off while nobody has measured that."""
_SHARE = 1.0 / 16.0
"""Each frame's part in how far the markers depart from what was foretold."""
_PROVEN_FRAMES = 10
_SIGNIFICANT = 3.0


class BeamMotion(NamedTuple):
    """What a beam does on a hub that moves.

    Attributes
    ----------
    frequencies : ndarray, shape (n_modes,) -- natural, of the clamped beam [rad/s]
    damping_ratios, participation : ndarray, shape (n_modes,)
    shapes : ndarray, shape (n_markers, n_modes) -- phi_i at the markers' heights
    max_acceleration : float -- the hub's [m/s^2]
    encoder_sd_m : float -- standard deviation of the hub's position [m]
    """

    frequencies: FloatArray
    damping_ratios: FloatArray
    participation: FloatArray
    shapes: FloatArray
    max_acceleration: float
    encoder_sd_m: float


class MotionPrediction:
    """Foretells the markers' columns.

    Parameters
    ----------
    motion : BeamMotion -- modes that are faster than the frames can show are left out
    scales : ndarray, shape (n_markers,) -- of the image, negative where +x points to the left [px/m]
    period_s : float -- between frames [s]

    Attributes
    ----------
    scales -- as given
    late_s, late_sd_s : float -- how late the frames' stamps are by the hub's clock, and its standard deviation [s];
        NaN while that is not known
    """

    def __init__(self, motion: BeamMotion, scales: FloatArray, period_s: float) -> None:
        shown = max(1, int(np.count_nonzero(motion.frequencies < 0.8 * math.pi / period_s)))
        self._omega, damping = motion.frequencies[:shown], motion.damping_ratios[:shown]
        self._shapes = motion.shapes[:, :shown]
        self._longest_s = _MAX_STEP * period_s
        self._encoder_sd_m = motion.encoder_sd_m
        self.scales = scales
        n, rate = shown, float(self._omega[0])
        self._moving = moving = 3 + 2 * n
        system = np.zeros((moving, moving))
        system[0, 1] = system[1, 2] = 1.0
        system[2, 2] = -rate
        system[3 : 3 + n, 3 + n :] = np.eye(n)
        system[3 + n :, 3 : 3 + n] = -np.diag(self._omega**2)
        system[3 + n :, 3 + n :] = -np.diag(2.0 * damping * self._omega)
        system[3 + n :, 2] = -motion.participation[:shown]
        self._system = system
        self._sources = np.hstack([np.eye(moving)[:, 2:3], np.eye(moving)[:, 3 + n :]])
        self._hub_power = 2.0 * rate * motion.max_acceleration**2
        self._first = np.diag([1.0, 1.0, motion.max_acceleration, *[0.1] * n, *0.1 * self._omega]) ** 2
        self._transition = lru_cache(maxsize=64)(self._transition_of)
        self._spread = lru_cache(maxsize=64)(self._spread_of)
        self._hub: deque[tuple[int, float]] = deque()
        self.late_s = self.late_sd_s = math.nan
        self.reset()

    def reset(self) -> None:
        """Forget what the markers did; the hub's motion is remembered."""
        n_markers, size = len(self.scales), self._moving + len(self.scales)
        self._state, self._covariance = np.zeros(size), np.zeros((size, size))
        self._covariance[: self._moving, : self._moving] = self._first
        self._covariance[self._moving :, self._moving :] = _FAR_PX**2 * np.eye(n_markers)
        self._departure = np.ones(n_markers)
        self._swing = np.zeros(len(self._omega))
        self._frames = 0
        self._time_ns: int | None = None

    def add_hub(self, stamp_ns: int, position_m: float) -> None:
        """Take note of where the hub was."""
        if not math.isfinite(position_m):
            return
        if self._hub and stamp_ns <= self._hub[-1][0]:
            self._hub.clear()
        self._hub.append((stamp_ns, position_m))
        while stamp_ns - self._hub[0][0] > _MEMORY_S * 1e9:
            self._hub.popleft()

    def foretell(self, stamps_ns: Sequence[int]) -> tuple[Foretold, ...]:
        """Foretell the markers' columns in a frame.

        Parameters
        ----------
        stamps_ns : sequence of int -- middle of the exposure of every marker's row [ns]

        Returns
        -------
        tuple of Foretold, one per marker -- empty while what was foretold has not been tried
        """
        now_ns = sum(stamps_ns) // len(stamps_ns)
        step_s = math.inf if self._time_ns is None else (now_ns - self._time_ns) * 1e-9
        if 0.0 < step_s <= self._longest_s:
            self._step(step_s)
        else:
            self.reset()
        self._time_ns = now_ns
        self._observe_hub(now_ns)
        offsets = np.array([(stamp - now_ns) * 1e-9 for stamp in stamps_ns])
        self._design = self._seen_by_markers(offsets)
        if self._frames < _PROVEN_FRAMES:
            return ()
        columns = self._design @ self._state
        variances = np.einsum("ij,jk,ik->i", self._design, self._covariance, self._design) + _IMAGE_SD_PX**2
        doubts = _SIGNIFICANT * np.sqrt(variances * max(1.0, float(self._departure.max())))
        return tuple(map(Foretold, columns.tolist(), doubts.tolist()))

    def correct(self, u_px: FloatArray, sigma_px: FloatArray) -> None:
        """Take note of where the markers were in the frame that was foretold last.

        Parameters
        ----------
        u_px, sigma_px : ndarray, shape (n_markers,) -- columns and standard deviations; NaN where not seen [px]
        """
        seen = np.isfinite(u_px) & np.isfinite(sigma_px)
        if not seen.any():
            return
        design = self._design[seen]
        departure = u_px[seen] - design @ self._state
        expected = self._update(design, departure, sigma_px[seen] ** 2 + _IMAGE_SD_PX**2)
        ratio, before = departure**2 / expected, self._departure[seen]
        # One departure that noise does not make counts at once, and is forgotten slowly.
        self._departure[seen] = np.where(
            ratio > _SIGNIFICANT**2, np.maximum(ratio, before), before + _SHARE * (ratio - before)
        )
        n = len(self._omega)
        swing = np.hypot(self._state[3 : 3 + n], self._state[3 + n : 3 + 2 * n] / self._omega)
        self._swing = np.maximum(swing, (1.0 - _SHARE) * self._swing)
        self._frames += 1

    # -- the filter ----------------------------------------------------------------------------------------

    def _step(self, step_s: float) -> None:
        transition, moving = self._transition(step_s), self._moving
        # Another grid than the steps': what the powers add need not be exact.
        spread = self._spread(float(f"{step_s:.2g}"))
        power = np.array([self._hub_power, *4.0 * _MODEL_ERROR**2 * self._omega**3 * self._swing**2])
        self._state[:moving] = transition @ self._state[:moving]
        covariance = self._covariance
        covariance[:moving] = transition @ covariance[:moving]
        covariance[:, :moving] = covariance[:, :moving] @ transition.T
        covariance[:moving, :moving] += np.tensordot(power, spread, 1)
        zeros = np.arange(moving, len(covariance))
        covariance[zeros, zeros] += _CREEP_PX**2

    def _transition_of(self, step_s: float) -> FloatArray:
        return np.asarray(expm(step_s * self._system))

    def _spread_of(self, step_s: float) -> FloatArray:
        """Covariance that white noise of unit power in a source adds, shape (n_sources, moving, moving)."""
        nodes, weights = np.polynomial.legendre.leggauss(8)
        total = np.zeros((self._sources.shape[1], self._moving, self._moving))
        for node, weight in zip(nodes, weights, strict=True):
            answers = expm(0.5 * (1.0 + node) * step_s * self._system) @ self._sources
            total += 0.5 * step_s * weight * np.einsum("is,js->sij", answers, answers)
        return total

    def _observe_hub(self, now_ns: int) -> None:
        is_known = math.isfinite(self.late_s)
        at_ns = now_ns - round(self.late_s * 1e9) if is_known else now_ns
        if not self._hub or not self._hub[0][0] <= at_ns <= self._hub[-1][0]:
            return
        later_ns, later = self._hub[-1]
        earlier_ns, earlier = later_ns, later
        for earlier_ns, earlier in reversed(self._hub):
            if earlier_ns <= at_ns:
                break
            later_ns, later = earlier_ns, earlier
        share = (at_ns - earlier_ns) / max(later_ns - earlier_ns, 1)
        position = earlier + share * (later - earlier)
        late_sd_s = self.late_sd_s if is_known else _LATENESS_SD_S
        design = np.zeros((1, len(self._state)))
        design[0, 0] = 1.0
        variance = self._encoder_sd_m**2 + (late_sd_s * self._state[1]) ** 2
        self._update(design, np.array([position - self._state[0]]), np.array([variance]))

    def _seen_by_markers(self, offsets_s: FloatArray) -> FloatArray:
        n, n_markers = len(self._omega), len(self.scales)
        design = np.zeros((n_markers, len(self._state)))
        design[:, 0], design[:, 1] = 1.0, offsets_s
        design[:, 3 : 3 + n], design[:, 3 + n : 3 + 2 * n] = self._shapes, self._shapes * offsets_s[:, None]
        design *= self.scales[:, None]
        design[:, self._moving :] = np.eye(n_markers)
        return design

    def _update(self, design: FloatArray, departure: FloatArray, variances: FloatArray) -> FloatArray:
        """Take measurements into the state; returns how large their squared departures should be."""
        covariance = self._covariance
        shared = covariance @ design.T
        expected = design @ shared + np.diag(variances)
        gain = np.linalg.solve(expected, shared.T).T
        self._state = self._state + gain @ departure
        covariance = covariance - gain @ shared.T
        self._covariance = (covariance + covariance.T) / 2.0
        return np.asarray(np.diag(expected))
