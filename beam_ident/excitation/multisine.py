"""Multisines: chosen lines all at once, of a period or wherever a design wants them.

Averaging over periods separates noise from response, and lines that are left out show
nonlinear distortion: even lines the even one, left-out odd lines the odd one. Where only poles are wanted, each line
has an amplitude of its own (``design.experiment`` finds them).
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

LINES = ("full", "odd", "random_odd")
PHASES = ("random", "schroeder", "crest")

_DETECTION_STREAM = 1 << 32  # seeds of the left-out lines lie apart from those of the phases


@dataclass(frozen=True)
class Multisine(Recipe):
    """Multisine on the lines of a period, flat in acceleration.

    Parameters
    ----------
    start_frequency, end_frequency : float -- band [Hz]; the lines are multiples of 1 / ``line_period``
    line_period : float -- period of the signal [s]
    n_periods : int -- how often it repeats
    acceleration : float -- root mean square of the acceleration [m/s^2]
    max_displacement : float
        Largest amplitude of one line's displacement [m], for the low ones.
    lines : {"full", "odd", "random_odd"}
        With odd lines only, even distortion shows on the others; where some odd lines are left out too, odd
        distortion shows there.
    seed : int -- seed of random phases and of the lines left out
    still : float -- stretch of a still hub afterwards [s]
    fade : float -- smooth ramps at both ends [s]
    detection_group : int
        Of a random-odd multisine: of every so many odd lines in turn one, drawn by the seed, is left out.
    phases : {"random", "schroeder", "crest"}
        Random ones make the signal near Gaussian; Schroeder's and the crest-optimised ones keep
        its acceleration low between ramps.
    max_velocity : float -- largest amplitude of one line's velocity [m/s]; 0: no ceiling
    phases_rad : tuple of float
        The phases, where they are optimised: found once, when the recipe is made, and stored with it, so
        that they are the same wherever it is read.  Leave it empty.
    """

    kind: ClassVar[str] = "multisine"

    start_frequency: float = 1.0
    end_frequency: float = 95.0
    line_period: float = 10.0
    n_periods: int = 2
    acceleration: float = 0.5
    max_displacement: float = 0.001
    lines: str = "full"
    seed: int = 0
    still: float = 10.0
    fade: float = 0.5
    detection_group: int = 4
    phases: str = "random"
    max_velocity: float = 0.0
    phases_rad: tuple[float, ...] = ()

    def _check(self) -> None:
        self._positive(
            "start_frequency",
            "end_frequency",
            "line_period",
            "acceleration",
            "max_displacement",
            "fade",
        )
        self._require(self.n_periods >= 1, "n_periods", self.n_periods, "at least 1")
        self._require(0 <= self.seed < 1 << 32, "seed", self.seed, "a whole number from 0 below 2^32")
        self._not_negative("still", "max_velocity")
        self._require(
            self.fade <= self.active_s / 2, "fade", self.fade, "at most half of all periods together"
        )
        group = self.detection_group
        self._require(group >= 2, "detection_group", group, "at least 2")
        self._one_of("lines", LINES)
        self._one_of("phases", PHASES)
        n_lines = len(self.lines_hz)
        self._require(n_lines > 0, "end_frequency", self.end_frequency, "a band with at least one line in it")
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
        return self.n_periods * self.line_period

    @property
    def steady_window_s(self) -> tuple[float, float]:
        """From when to when the signal repeats: between its ramps [s].

        What it moves repeats only once it has settled: leave that time out too, at the start.
        """
        return self.fade, self.active_s - self.fade

    @property
    def total_s(self) -> float:
        """Length [s], the still stretch included."""
        return self.active_s + self.still

    def line_spacing_hz(self, near_hz: float) -> float:
        """Return the spacing of the excited lines [Hz]."""
        del near_hz
        return (1.0 if self.lines == "full" else 2.0) / self.line_period

    @property
    def lines_hz(self) -> FloatArray:
        """Frequencies of the excited lines [Hz]."""
        return np.asarray(self._line_numbers()[0] / self.line_period)

    @property
    def even_detection_lines_hz(self) -> FloatArray:
        """Even lines inside the band, free for even distortion [Hz]; none for a full multisine."""
        excited = self._line_numbers()[0]
        inside = np.arange(excited[0], excited[-1] + 1)
        return np.asarray(inside[(inside % 2 == 0) & (self.lines != "full")] / self.line_period)

    @property
    def odd_detection_lines_hz(self) -> FloatArray:
        """Odd lines left out, free for odd distortion [Hz]."""
        return np.asarray(self._line_numbers()[1] / self.line_period)

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
        total = sum_of_lines(times_s, numbers, self._amplitudes(), self._phases(), self.line_period)
        return np.asarray(window(times_s, self.active_s, self.fade, self.fade) * total)

    def _line_numbers(self) -> tuple[IndexArray, IndexArray]:
        """Return the numbers of the excited lines and of the odd ones left out."""
        first = max(math.ceil(self.start_frequency * self.line_period - 1e-9), 1)
        last = math.floor(self.end_frequency * self.line_period + 1e-9)
        numbers = np.arange(first, last + 1)
        if self.lines != "full":
            numbers = numbers[numbers % 2 == 1]
        n_groups = len(numbers) // self.detection_group if self.lines == "random_odd" else 0
        places = seeds.choices(_DETECTION_STREAM + self.seed, n_groups, self.detection_group)
        left_out = np.arange(n_groups) * self.detection_group + places
        return np.delete(numbers, left_out), numbers[left_out]

    def _amplitudes(self) -> FloatArray:
        """Return the lines' amplitudes of displacement [m]."""
        omega = 2.0 * np.pi * self.lines_hz
        per_line = self.acceleration * math.sqrt(2.0 / len(omega))
        return displacement_amplitude(omega, per_line, self.max_velocity, self.max_displacement)

    def _acceleration_amplitudes(self) -> FloatArray:
        return np.asarray(self._amplitudes() * (2.0 * np.pi * self.lines_hz) ** 2)

    def _phases(self) -> FloatArray:
        if self.phases == "crest":
            return np.array(self.phases_rad)
        if self.phases == "schroeder":
            return schroeder_phases(self._acceleration_amplitudes())
        return seeds.phases(self.seed, len(self.lines_hz))


@dataclass(frozen=True)
class ShapedMultisine(Recipe):
    """Sines of any frequencies, amplitudes and phases, all at once.

    Parameters
    ----------
    frequencies : tuple of float -- increasing [Hz]
    amplitudes : tuple of float
        Of the acceleration of each line, against each other; ``acceleration`` gives the level.
    line_phases : tuple of float -- of the displacement's sines [rad]
    acceleration : float -- root mean square of the acceleration [m/s^2]
    duration : float -- length of the sines, ramps included [s]
    fade : float -- smooth ramps at both ends [s]
    still : float -- stretch at rest afterwards [s]

    Notes
    -----
    The displacement is ``w(t) sum_k A_k / (2 pi f_k)^2 sin(2 pi f_k t + phi_k)`` with
    ``A_k = acceleration a_k sqrt(2 / sum_l a_l^2)`` and the window w of the two ramps.
    """

    kind: ClassVar[str] = "shaped_multisine"

    frequencies: tuple[float, ...] = (2.0, 4.0, 8.0, 16.0)
    amplitudes: tuple[float, ...] = (1.0, 1.0, 1.0, 1.0)
    line_phases: tuple[float, ...] = (0.0, 1.0, 3.0, 6.0)
    acceleration: float = 0.2
    duration: float = 20.0
    fade: float = 0.5
    still: float = 10.0

    def _check(self) -> None:
        lines = np.asarray(self.frequencies)
        is_row = len(lines) >= 1 and lines[0] > 0.0 and bool(np.all(np.diff(lines) > 0.0))
        self._require(is_row, "frequencies", self.frequencies, "at least one, all > 0 and increasing")
        for name in ("amplitudes", "line_phases"):
            own = getattr(self, name)
            self._require(
                len(own) == len(lines), name, f"{len(own)} numbers", f"{len(lines)}, one for each frequency"
            )
        self._require(min(self.amplitudes) > 0.0, "amplitudes", self.amplitudes, "numbers > 0")
        self._positive("acceleration", "duration", "fade")
        self._not_negative("still")
        self._require(self.fade <= self.duration / 2, "fade", self.fade, "at most half of duration")

    @property
    def total_s(self) -> float:
        """Length [s], the still stretch included."""
        return self.duration + self.still

    def line_spacing_hz(self, near_hz: float) -> float:
        """Return the gap between the lines around a frequency [Hz]; outside of them the way to the nearest."""
        lines = np.asarray(self.frequencies)
        place = int(np.searchsorted(lines, near_hz))
        if place in (0, len(lines)):
            return float(np.min(np.abs(lines - near_hz)))
        return float(lines[place] - lines[place - 1])

    def displacement(self, times_s: FloatArray) -> FloatArray:
        """Return the displacement [m] at any times [s]."""
        share = np.asarray(self.amplitudes)
        level = self.acceleration * math.sqrt(2.0 / float(np.sum(np.square(share))))
        total = np.zeros(np.shape(times_s))
        for frequency, own, phase in zip(self.frequencies, share, self.line_phases, strict=True):
            omega = 2.0 * np.pi * frequency
            total += level * own / omega**2 * np.sin(omega * times_s + phase)
        return np.asarray(window(times_s, self.duration, self.fade, self.fade) * total)
