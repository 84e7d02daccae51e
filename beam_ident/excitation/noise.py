"""Band-limited Gaussian noise, as a recipe.

What nature does, on a seed: useful for checking a model on a signal unlike the one it was
estimated from.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from beam_ident.arrays import FloatArray, IndexArray
from beam_ident.excitation import seeds
from beam_ident.excitation.periodic_sum import sum_of_lines
from beam_ident.excitation.recipe import Recipe
from beam_ident.excitation.windows import displacement_amplitude, window


@dataclass(frozen=True)
class BandLimitedNoise(Recipe):
    """Gaussian noise, flat in acceleration between two frequencies.

    Parameters
    ----------
    start_frequency, end_frequency : float -- band [Hz]
    duration : float -- length of the noise [s]
    acceleration : float -- expected root mean square of the acceleration [m/s^2]
    max_displacement : float
        Expected root mean square of the displacement that the lines of a whole octave may have [m]: holds
        low frequencies down.
    seed : int
    still : float -- stretch at rest afterwards [s]
    fade : float -- smooth ramps at both ends [s]

    Notes
    -----
    A sum of sines on the lines of its own length with normally distributed sine and cosine parts (Rice,
    Bell Syst. Tech. J. 23, 1944).
    """

    kind: ClassVar[str] = "noise"

    start_frequency: float = 1.0
    end_frequency: float = 95.0
    duration: float = 20.0
    acceleration: float = 0.3
    max_displacement: float = 0.001
    seed: int = 0
    still: float = 10.0
    fade: float = 0.5

    def _check(self) -> None:
        self._positive(
            "start_frequency", "end_frequency", "duration", "acceleration", "max_displacement", "fade"
        )
        self._not_negative("still")
        self._require(0 <= self.seed < 1 << 32, "seed", self.seed, "a whole number from 0 below 2^32")
        self._require(self.fade <= self.duration / 2, "fade", self.fade, "at most half of duration")
        self._require(
            len(self._line_numbers()) > 0,
            "end_frequency",
            self.end_frequency,
            "a band of at least 1 / duration",
        )

    @property
    def total_s(self) -> float:
        """Length [s], the still stretch included."""
        return self.duration + self.still

    def _line_numbers(self) -> IndexArray:
        first = max(math.ceil(self.start_frequency * self.duration - 1e-9), 1)
        last = math.floor(self.end_frequency * self.duration + 1e-9)
        return np.arange(first, last + 1)

    def displacement(self, times_s: FloatArray) -> FloatArray:
        """Return the displacement [m] at any times [s]."""
        numbers = self._line_numbers()
        lines = numbers / self.duration
        omega = 2.0 * np.pi * lines
        # An octave around f holds f / sqrt(2) hertz of lines, which share the ceiling.
        ceiling = self.max_displacement * np.sqrt(2.0 * math.sqrt(2.0) / (lines * self.duration))
        per_line = self.acceleration * math.sqrt(2.0 / len(lines))
        amplitudes = displacement_amplitude(omega, per_line, 0.0, ceiling)
        drawn = seeds.uniform(self.seed, 2 * len(lines))
        # Box and Muller: a Rayleigh radius and a uniform phase make two normal parts.
        radii = np.sqrt(-np.log1p(-drawn[0::2])) * amplitudes
        phases = 2.0 * np.pi * drawn[1::2]
        shape = window(times_s, self.duration, self.fade, self.fade)
        return shape * sum_of_lines(times_s, numbers, radii, phases, self.duration)
