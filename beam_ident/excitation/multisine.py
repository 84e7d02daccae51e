"""Multisines: chosen lines of a period, all at once.

Averaging over periods separates noise from response, and lines that are left out show
nonlinear distortion: even lines the even one, left-out odd lines the odd one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from beam_ident.arrays import FloatArray, IndexArray
from beam_ident.excitation import seeds
from beam_ident.excitation.crest_optimisation import crest_factor, optimised_phases, schroeder_phases
from beam_ident.excitation.periodic_sum import sum_of_lines
from beam_ident.excitation.recipe import Recipe
from beam_ident.excitation.windows import displacement_amplitude, window

PHASES = ("random", "schroeder", "crest")

_DETECTION_STREAM = 1 << 32  # seeds of the left-out lines lie apart from those of the phases


@dataclass(frozen=True)
class Multisine(Recipe):
    """Multisine on the lines of a period, flat in acceleration.

    Parameters
    ----------
    low_hz, high_hz : float -- band [Hz]; the lines are multiples of 1 / ``line_period_s``
    line_period_s : float -- period of the signal [s]
    n_periods : int -- how often it repeats
    rms_acceleration : float -- root mean square of the acceleration [m/s^2]
    displacement_ceiling : float
        Largest amplitude of one line's displacement [m], for the low ones.
    odd_only : bool -- keep odd lines only, so that even distortion shows on the others
    seed : int -- seed of random phases and of the lines left out
    still_s : float -- stretch of a still hub afterwards [s]
    fade_s : float -- smooth ramps at both ends [s]
    detection_group : int
        With ``odd_only``: of every so many odd lines in turn one, drawn by the seed, is left out,
        so that odd distortion shows there (a random-odd multisine); 0 leaves none out.
    phases : {"random", "schroeder", "crest"}
        Random ones make the signal near Gaussian; Schroeder's and the crest-optimised ones keep
        its acceleration low between ramps.
    velocity_ceiling : float or None -- largest amplitude of one line's velocity [m/s]
    phases_rad : tuple of float
        The phases, where they are optimised: found once, when the recipe is made, and stored with it, so
        that they are the same wherever it is read.  Leave it empty.
    """

    kind: ClassVar[str] = "multisine"

    low_hz: float = 1.0
    high_hz: float = 95.0
    line_period_s: float = 10.0
    n_periods: int = 2
    rms_acceleration: float = 0.5
    displacement_ceiling: float = 0.001
    odd_only: bool = False
    seed: int = 0
    still_s: float = 10.0
    fade_s: float = 0.5
    detection_group: int = 0
    phases: str = "random"
    velocity_ceiling: float | None = None
    phases_rad: tuple[float, ...] = ()

    def _check(self) -> None:
        self._positive(
            "low_hz",
            "high_hz",
            "line_period_s",
            "rms_acceleration",
            "displacement_ceiling",
            "fade_s",
            "velocity_ceiling",
        )
        self._require(self.n_periods >= 1, "n_periods", self.n_periods, "at least 1")
        self._require(0 <= self.seed < 1 << 32, "seed", self.seed, "a whole number from 0 below 2^32")
        self._not_negative("still_s")
        self._require(
            self.fade_s <= self.active_s / 2, "fade_s", self.fade_s, "at most half of all periods together"
        )
        group = self.detection_group
        self._require(group == 0 or group >= 2, "detection_group", group, "0 or at least 2")
        self._require(
            group == 0 or self.odd_only,
            "detection_group",
            group,
            "0, or odd_only=True: lines are left out among odd ones only",
        )
        self._one_of("phases", PHASES)
        n_lines = len(self.lines_hz)
        self._require(n_lines > 0, "high_hz", self.high_hz, "a band with at least one line in it")
        if self.phases == "crest" and not self.phases_rad:
            optimised = optimised_phases(self._line_numbers()[0], self._acceleration_amplitudes())
            object.__setattr__(self, "phases_rad", tuple(optimised.tolist()))
        expected = n_lines if self.phases == "crest" else 0
        self._require(
            len(self.phases_rad) == expected,
            "phases_rad",
            f"{len(self.phases_rad)} numbers",
            f"{expected} for phases = {self.phases!r} and {n_lines} lines; leave it empty to have them made",
        )

    @property
    def active_s(self) -> float:
        """Length of all periods together [s]."""
        return self.n_periods * self.line_period_s

    @property
    def steady_window_s(self) -> tuple[float, float]:
        """From when to when the signal repeats: between its ramps [s].

        What it moves repeats only once it has settled: leave that time out too, at the start.
        """
        return self.fade_s, self.active_s - self.fade_s

    @property
    def duration_s(self) -> float:
        """Length [s], the still stretch included."""
        return self.active_s + self.still_s

    def line_spacing_hz(self, near_hz: float) -> float:
        """Return the spacing of the excited lines [Hz]."""
        del near_hz
        return (2.0 if self.odd_only else 1.0) / self.line_period_s

    @property
    def lines_hz(self) -> FloatArray:
        """Frequencies of the excited lines [Hz]."""
        return np.asarray(self._line_numbers()[0] / self.line_period_s)

    @property
    def even_detection_lines_hz(self) -> FloatArray:
        """Even lines inside the band, free for even distortion [Hz]; none for a full multisine."""
        excited = self._line_numbers()[0]
        inside = np.arange(excited[0], excited[-1] + 1)
        return np.asarray(inside[(inside % 2 == 0) & self.odd_only] / self.line_period_s)

    @property
    def odd_detection_lines_hz(self) -> FloatArray:
        """Odd lines left out, free for odd distortion [Hz]."""
        return np.asarray(self._line_numbers()[1] / self.line_period_s)

    def crest_factor(self) -> float:
        """Return the crest factor of the acceleration between the ramps, on a grid of 16 points a cycle."""
        numbers = self._line_numbers()[0]
        n = 1 << int(np.ceil(np.log2(16 * int(numbers[-1]) + 1)))
        spectrum = np.zeros(n // 2 + 1, dtype=np.complex128)
        spectrum[numbers] = self._acceleration_amplitudes() * np.exp(1j * (self._phases() - 0.5 * np.pi))
        return crest_factor(np.fft.irfft(spectrum, n))

    def displacement(self, times_s: FloatArray) -> FloatArray:
        """Return the displacement [m] at any times [s]."""
        numbers = self._line_numbers()[0]
        total = sum_of_lines(times_s, numbers, self._amplitudes(), self._phases(), self.line_period_s)
        return np.asarray(window(times_s, self.active_s, self.fade_s, self.fade_s) * total)

    def _line_numbers(self) -> tuple[IndexArray, IndexArray]:
        """Return the numbers of the excited lines and of the odd ones left out."""
        first = max(math.ceil(self.low_hz * self.line_period_s - 1e-9), 1)
        last = math.floor(self.high_hz * self.line_period_s + 1e-9)
        numbers = np.arange(first, last + 1)
        if self.odd_only:
            numbers = numbers[numbers % 2 == 1]
        n_groups = len(numbers) // self.detection_group if self.detection_group else 0
        places = seeds.choices(_DETECTION_STREAM + self.seed, n_groups, max(self.detection_group, 1))
        left_out = np.arange(n_groups) * self.detection_group + places
        return np.delete(numbers, left_out), numbers[left_out]

    def _amplitudes(self) -> FloatArray:
        """Return the lines' amplitudes of displacement [m]."""
        omega = 2.0 * np.pi * self.lines_hz
        per_line = self.rms_acceleration * math.sqrt(2.0 / len(omega))
        return displacement_amplitude(omega, per_line, self.velocity_ceiling, self.displacement_ceiling)

    def _acceleration_amplitudes(self) -> FloatArray:
        return np.asarray(self._amplitudes() * (2.0 * np.pi * self.lines_hz) ** 2)

    def _phases(self) -> FloatArray:
        if self.phases == "crest":
            return np.array(self.phases_rad)
        if self.phases == "schroeder":
            return schroeder_phases(self._acceleration_amplitudes())
        return seeds.phases(self.seed, len(self.lines_hz))
