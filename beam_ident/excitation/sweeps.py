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

    start_hz: float = 1.0
    end_hz: float = 95.0
    sweep_s: float = 20.0
    acceleration: float = 0.7
    displacement_ceiling: float = 0.005
    still_s: float = 10.0
    fade_in_s: float = 1.0
    fade_out_s: float = 0.25
    velocity_ceiling: float | None = None

    def _check(self) -> None:
        self._positive(
            "start_hz", "end_hz", "sweep_s", "acceleration", "displacement_ceiling", "velocity_ceiling"
        )
        self._not_negative("still_s")
        for name in ("fade_in_s", "fade_out_s"):
            value = getattr(self, name)
            self._require(0.0 < value <= self.sweep_s / 2, name, value, "between 0 and half of sweep_s")

    @property
    def duration_s(self) -> float:
        """Length [s], the still stretch included."""
        return self.sweep_s + self.still_s

    def _swept(self, times: FloatArray, frequency: FloatArray, phase: FloatArray) -> FloatArray:
        amplitude = displacement_amplitude(
            2.0 * np.pi * frequency, self.acceleration, self.velocity_ceiling, self.displacement_ceiling
        )
        shape = window(times, self.sweep_s, self.fade_in_s, self.fade_out_s)
        return np.asarray(shape * amplitude * np.sin(phase))


@dataclass(frozen=True)
class LogChirp(_Sweep):
    """Logarithmic chirp of constant acceleration under a ceiling of displacement.

    Parameters
    ----------
    start_hz, end_hz : float -- first and last frequency [Hz]
    sweep_s : float -- length of the sweep [s]
    acceleration : float -- amplitude of the acceleration [m/s^2]
    displacement_ceiling : float -- largest amplitude of the displacement [m]
    still_s : float -- stretch of a still hub after the sweep [s]
    fade_in_s, fade_out_s : float -- smooth ramps at both ends of the sweep [s]
    velocity_ceiling : float or None -- largest amplitude of the velocity [m/s]

    Notes
    -----
    ``alpha0(f) = min(ceiling, acceleration / (2 pi f)^2)``, the corner rounded; phase
    ``2 pi f0 L (e^(t/L) - 1)`` with ``L = sweep / ln(f1/f0)``.
    """

    kind: ClassVar[str] = "log_chirp"

    def _check(self) -> None:
        super()._check()
        self._require(self.end_hz > self.start_hz, "end_hz", self.end_hz, f"above start_hz = {self.start_hz}")

    def displacement(self, times_s: FloatArray) -> FloatArray:
        """Return the displacement [m] at any times [s]."""
        times = np.clip(times_s, 0.0, self.sweep_s)
        growth = self.sweep_s / math.log(self.end_hz / self.start_hz)
        frequency = self.start_hz * np.exp(times / growth)
        phase = 2.0 * np.pi * growth * (frequency - self.start_hz)
        return self._swept(times, frequency, phase)


@dataclass(frozen=True)
class LinearChirp(_Sweep):
    """Linear chirp of constant acceleration under a ceiling of displacement.

    Parameters
    ----------
    start_hz, end_hz : float -- first and last frequency [Hz]; downwards too
    sweep_s, acceleration, displacement_ceiling, still_s, fade_in_s, fade_out_s, velocity_ceiling
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
            self.end_hz != self.start_hz, "end_hz", self.end_hz, f"other than start_hz = {self.start_hz}"
        )

    def displacement(self, times_s: FloatArray) -> FloatArray:
        """Return the displacement [m] at any times [s]."""
        times = np.clip(times_s, 0.0, self.sweep_s)
        slope = (self.end_hz - self.start_hz) / self.sweep_s
        phase = 2.0 * np.pi * times * (self.start_hz + 0.5 * slope * times)
        return self._swept(times, self.start_hz + slope * times, phase)
