"""One sine, and one sine after another.

A stepped sine spends all its power on one frequency at a time: the cleanest response there is,
line by line, and the slowest.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.excitation.recipe import Recipe
from beam_ident.excitation.windows import displacement_amplitude, smooth_rise, smooth_rise_integral, window


@dataclass(frozen=True)
class Sine(Recipe):
    """One sine with smooth ramps.

    Parameters
    ----------
    start_frequency : float -- the frequency, from start to end [Hz]
    acceleration : float -- amplitude of the acceleration [m/s^2]
    duration : float -- length of the sine, ramps included [s]
    fade_cycles : float -- length of each ramp in cycles
    still : float -- stretch at rest afterwards [s]
    max_displacement : float -- largest amplitude of the displacement [m]
    """

    kind: ClassVar[str] = "sine"

    start_frequency: float = 4.0
    acceleration: float = 0.2
    duration: float = 10.0
    fade_cycles: float = 4.0
    still: float = 10.0
    max_displacement: float = 0.005

    def _check(self) -> None:
        self._positive("start_frequency", "acceleration", "duration", "fade_cycles", "max_displacement")
        self._not_negative("still")
        self._require(
            self.fade_cycles <= self.duration * self.start_frequency / 2,
            "fade_cycles",
            self.fade_cycles,
            "at most half of duration * start_frequency",
        )

    @property
    def total_s(self) -> float:
        """Length [s], the still stretch included."""
        return self.duration + self.still

    def displacement(self, times_s: FloatArray) -> FloatArray:
        """Return the displacement [m] at any times [s]."""
        omega = 2.0 * np.pi * self.start_frequency
        amplitude = displacement_amplitude(np.array([omega]), self.acceleration, 0.0, self.max_displacement)
        fade = self.fade_cycles / self.start_frequency
        times = np.clip(times_s, 0.0, self.duration)
        return np.asarray(window(times, self.duration, fade, fade) * amplitude[0] * np.sin(omega * times))


@dataclass(frozen=True)
class SteppedSine(Recipe):
    """Sines of chosen frequencies one after another, with smooth passages.

    Parameters
    ----------
    frequencies : tuple of float -- in the order in which they are visited [Hz]
    acceleration : float -- amplitude of the acceleration [m/s^2]
    max_displacement : float -- largest amplitude of the displacement [m]
    settle_cycles : float -- cycles at each frequency before those that are measured
    measure_cycles : int -- whole cycles to be measured at each frequency
    glide_cycles : float
        Length of each passage, and of the ramps at both ends, in cycles of the lower frequency.
    still : float -- stretch at rest afterwards [s]

    Notes
    -----
    The frequency glides along the smooth rise of ``excitation.windows``, and the amplitude
    follows it; the phase is its exact integral, so that the displacement is smooth throughout.
    """

    kind: ClassVar[str] = "stepped_sine"

    frequencies: tuple[float, ...] = (2.0, 4.0, 8.0, 16.0)
    acceleration: float = 0.2
    max_displacement: float = 0.005
    settle_cycles: float = 10.0
    measure_cycles: int = 10
    glide_cycles: float = 2.0
    still: float = 5.0

    def _check(self) -> None:
        frequencies = self.frequencies
        is_list = len(frequencies) >= 1 and all(f > 0.0 for f in frequencies)
        self._require(is_list, "frequencies", frequencies, "at least one frequency, all > 0")
        self._positive("acceleration", "max_displacement", "measure_cycles", "glide_cycles")
        self._not_negative("settle_cycles", "still")

    @property
    def measure_windows_s(self) -> tuple[tuple[float, float], ...]:
        """Start and end of the measured stretch of each frequency [s]."""
        starts, lengths = self._plan()
        return tuple(
            (start + glide + self.settle_cycles / f, start + glide + dwell)
            for start, (glide, dwell), f in zip(starts, lengths, self.frequencies, strict=True)
        )

    @property
    def active_s(self) -> float:
        """Length of all sines and passages [s]."""
        starts, lengths = self._plan()
        return starts[-1] + sum(lengths[-1]) + self.glide_cycles / self.frequencies[-1]

    @property
    def total_s(self) -> float:
        """Length [s], the still stretch included."""
        return self.active_s + self.still

    def line_spacing_hz(self, near_hz: float) -> float:
        """Return the gap between the visited frequencies around a frequency [Hz]."""
        visited = np.unique(self.frequencies)
        place = int(np.searchsorted(visited, near_hz))
        if len(visited) < 2 or place in (0, len(visited)):
            return float(np.min(np.abs(visited - near_hz)))
        return float(visited[place] - visited[place - 1])

    def _plan(self) -> tuple[list[float], list[tuple[float, float]]]:
        """Return when each passage starts, and its length and that of the stay after it [s]."""
        lengths = []
        for before, now in itertools.pairwise((self.frequencies[0], *self.frequencies)):
            stay = (self.settle_cycles + self.measure_cycles) / now
            lengths.append((self.glide_cycles / min(before, now), stay))
        starts = [0.0, *np.cumsum([glide + stay for glide, stay in lengths]).tolist()]
        return starts[:-1], lengths

    def displacement(self, times_s: FloatArray) -> FloatArray:
        """Return the displacement [m] at any times [s]."""
        times = np.clip(times_s, 0.0, self.active_s)
        frequencies = self.frequencies
        cycles, now = frequencies[0] * times, np.full(np.shape(times), frequencies[0])
        starts, lengths = self._plan()
        for k, (before, after) in enumerate(itertools.pairwise(frequencies), 1):
            glide = lengths[k][0]
            since = (times - starts[k]) / glide
            cycles = cycles + (after - before) * glide * smooth_rise_integral(since)
            now = now + (after - before) * smooth_rise(since)
        amplitude = displacement_amplitude(2.0 * np.pi * now, self.acceleration, 0.0, self.max_displacement)
        shape = window(times, self.active_s, lengths[0][0], self.glide_cycles / frequencies[-1])
        return np.asarray(shape * amplitude * np.sin(2.0 * np.pi * cycles))
