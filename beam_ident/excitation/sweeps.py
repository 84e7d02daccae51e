"""Chirps: one sine whose frequency sweeps over the band.

A sweep has the lowest crest factor of all broadband signals, shows to the eye what happens when,
and drives one mode after the other.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.excitation.recipe import Recipe
from beam_ident.excitation.windows import displacement_amplitude, window


@dataclass(frozen=True)
class _Sweep(Recipe):
    """What all sweeps share: their numbers, and amplitudes under the ceilings; see ``LogChirp``."""

    start_frequency: float = 1.0
    end_frequency: float = 95.0
    duration: float = 20.0
    acceleration: float = 0.7
    max_displacement: float = 0.005
    still: float = 10.0
    fade_in: float = 1.0
    fade_out: float = 0.25
    max_velocity: float = 0.0

    def _check(self) -> None:
        self._positive("start_frequency", "end_frequency", "duration", "acceleration", "max_displacement")
        self._not_negative("still", "max_velocity")
        for name in ("fade_in", "fade_out"):
            value = getattr(self, name)
            self._require(0.0 < value <= self.duration / 2, name, value, "between 0 and half of duration")

    @property
    def total_s(self) -> float:
        """Length [s], the still stretch included."""
        return self.duration + self.still

    def _swept(self, times: FloatArray, frequency: FloatArray, phase: FloatArray) -> FloatArray:
        amplitude = displacement_amplitude(
            2.0 * np.pi * frequency, self.acceleration, self.max_velocity, self.max_displacement
        )
        shape = window(times, self.duration, self.fade_in, self.fade_out)
        return np.asarray(shape * amplitude * np.sin(phase))


@dataclass(frozen=True)
class LogChirp(_Sweep):
    """Logarithmic chirp of constant acceleration under a ceiling of displacement.

    Parameters
    ----------
    start_frequency, end_frequency : float -- first and last frequency [Hz]
    duration : float -- length of the sweep [s]
    acceleration : float -- amplitude of the acceleration [m/s^2]
    max_displacement : float -- largest amplitude of the displacement [m]
    still : float -- stretch of a still hub after the sweep [s]
    fade_in, fade_out : float -- smooth ramps at both ends of the sweep [s]
    max_velocity : float -- largest amplitude of the velocity [m/s]; 0: no ceiling

    Notes
    -----
    ``alpha0(f) = min(ceiling, acceleration / (2 pi f)^2)``, the corner rounded; phase
    ``2 pi f0 L (e^(t/L) - 1)`` with ``L = sweep / ln(f1/f0)``.
    """

    kind: ClassVar[str] = "chirp"

    def _check(self) -> None:
        super()._check()
        self._require(
            self.end_frequency > self.start_frequency,
            "end_frequency",
            self.end_frequency,
            f"above start_frequency = {self.start_frequency}",
        )

    def displacement(self, times_s: FloatArray) -> FloatArray:
        """Return the displacement [m] at any times [s]."""
        times = np.clip(times_s, 0.0, self.duration)
        growth = self.duration / math.log(self.end_frequency / self.start_frequency)
        frequency = self.start_frequency * np.exp(times / growth)
        phase = 2.0 * np.pi * growth * (frequency - self.start_frequency)
        return self._swept(times, frequency, phase)


@dataclass(frozen=True)
class LinearChirp(_Sweep):
    """Linear chirp of constant acceleration under a ceiling of displacement.

    Parameters
    ----------
    start_frequency, end_frequency : float -- first and last frequency [Hz]; downwards too
    duration, acceleration, max_displacement, still, fade_in, fade_out, max_velocity
        As in ``LogChirp``.

    Notes
    -----
    Phase ``2 pi (f0 t + (f1 - f0) t^2 / (2 sweep))``: equal time for every hertz, where the
    logarithmic chirp gives equal time to every octave.
    """

    kind: ClassVar[str] = "linear_chirp"

    def _check(self) -> None:
        super()._check()
        self._require(
            self.end_frequency != self.start_frequency,
            "end_frequency",
            self.end_frequency,
            f"other than start_frequency = {self.start_frequency}",
        )

    def displacement(self, times_s: FloatArray) -> FloatArray:
        """Return the displacement [m] at any times [s]."""
        times = np.clip(times_s, 0.0, self.duration)
        slope = (self.end_frequency - self.start_frequency) / self.duration
        phase = 2.0 * np.pi * times * (self.start_frequency + 0.5 * slope * times)
        return self._swept(times, self.start_frequency + slope * times, phase)
