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
    low_hz, high_hz : float -- band [Hz]
    length_s : float -- length of the noise [s]
    rms_acceleration : float -- expected root mean square of the acceleration [m/s^2]
    displacement_ceiling : float
        Expected root mean square of the displacement that the lines of a whole octave may have [m]: holds
        low frequencies down.
    seed : int
    still_s : float -- stretch at rest afterwards [s]
    fade_s : float -- smooth ramps at both ends [s]

    Notes
    -----
    A sum of sines on the lines of its own length with normally distributed sine and cosine parts (Rice,
    Bell Syst. Tech. J. 23, 1944).
    """

    kind: ClassVar[str] = "band_limited_noise"

    low_hz: float = 1.0
    high_hz: float = 95.0
    length_s: float = 20.0
    rms_acceleration: float = 0.3
    displacement_ceiling: float = 0.001
    seed: int = 0
    still_s: float = 10.0
    fade_s: float = 0.5

    def _check(self) -> None:
        self._positive("low_hz", "high_hz", "length_s", "rms_acceleration", "displacement_ceiling", "fade_s")
        self._not_negative("still_s")
        self._require(0 <= self.seed < 1 << 32, "seed", self.seed, "a whole number from 0 below 2^32")
        self._require(self.fade_s <= self.length_s / 2, "fade_s", self.fade_s, "at most half of length_s")
        self._require(
            len(self._line_numbers()) > 0, "high_hz", self.high_hz, "a band of at least 1 / length_s"
        )

    @property
    def duration_s(self) -> float:
        """Length [s], the still stretch included."""
        return self.length_s + self.still_s

    def _line_numbers(self) -> IndexArray:
        first = max(math.ceil(self.low_hz * self.length_s - 1e-9), 1)
        last = math.floor(self.high_hz * self.length_s + 1e-9)
        return np.arange(first, last + 1)

    def displacement(self, times_s: FloatArray) -> FloatArray:
        """Return the displacement [m] at any times [s]."""
        numbers = self._line_numbers()
        lines = numbers / self.length_s
        omega = 2.0 * np.pi * lines
        # An octave around f holds f / sqrt(2) hertz of lines, which share the ceiling.
        ceiling = self.displacement_ceiling * np.sqrt(2.0 * math.sqrt(2.0) / (lines * self.length_s))
        per_line = self.rms_acceleration * math.sqrt(2.0 / len(lines))
        amplitudes = displacement_amplitude(omega, per_line, None, ceiling)
        drawn = seeds.uniform(self.seed, 2 * len(lines))
        # Box and Muller: a Rayleigh radius and a uniform phase make two normal parts.
        radii = np.sqrt(-np.log1p(-drawn[0::2])) * amplitudes
        phases = 2.0 * np.pi * drawn[1::2]
        shape = window(times_s, self.length_s, self.fade_s, self.fade_s)
        return shape * sum_of_lines(times_s, numbers, radii, phases, self.length_s)
