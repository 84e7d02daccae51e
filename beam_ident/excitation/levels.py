"""Excitations made of levels: steps, pulses, doublets and binary sequences.

A level is held until the next one, with sharp or smooth edges.  Such a signal may be
designed in any quantity, ``drive``:

* ``position``: the displacement takes the levels [m];
* ``velocity``, ``acceleration``: the levels are speeds [m/s] or accelerations [m/s^2], and the
  smallest change (in the least-squares sense, a constant or a straight line over the
  active stretch) brings the axis to rest at home;
* ``force``: the levels are held as they are; ``Recipe.sample_input`` gives them.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.errors import ExcitationError
from beam_ident.excitation.recipe import Recipe
from beam_ident.excitation.windows import smooth_rise, window

DRIVES = ("position", "velocity", "acceleration", "force")

_EDGE = 1e-9  # of a switching interval: an instant this close before an edge is on it


@dataclass(frozen=True)
class LevelRecipe(Recipe):
    """Base of recipes that hold levels in a quantity of their own.

    Parameters
    ----------
    drive : {"position", "velocity", "acceleration", "force"}
    amplitude : float -- level [m], [m/s], [m/s^2] or, for a force, in the unit of the input
    edge_time : float -- length of each smooth edge [s]; 0 for sharp ones
    still : float -- stretch at rest afterwards [s]
    """

    drive: str = "position"
    amplitude: float = 0.0005
    edge_time: float = 0.05
    still: float = 10.0

    def _check(self) -> None:
        self._one_of("drive", DRIVES)
        self._not_zero("amplitude")
        self._not_negative("edge_time", "still")

    @property
    @abstractmethod
    def active_s(self) -> float:
        """Length until the last level has gone [s]."""

    @abstractmethod
    def waveform(self, times_s: FloatArray) -> FloatArray:
        """Return the signal in its own quantity at any times [s], zero outside."""

    @property
    def total_s(self) -> float:
        """Length [s], the still stretch included."""
        return self.active_s + self.still

    def displacement(self, times_s: FloatArray) -> FloatArray:
        """Return the displacement [m], where that is what the levels are.

        Raises
        ------
        ExcitationError
            The levels are another quantity: the displacement is that of ``sample``.
        """
        if self.drive != "position":
            raise ExcitationError(
                f"{type(self).__name__}: drive is {self.drive!r}, so that its displacement depends on the period; "
                "use sample(period_s).positions"
            )
        return self.waveform(times_s)

    def _accelerations(self, period_s: float) -> FloatArray:
        if self.drive == "position":
            return super()._accelerations(period_s)
        if self.drive == "force":
            raise ExcitationError(
                f"{type(self).__name__}: drive is 'force', which is not a motion; use sample_input(period_s)"
            )
        ticks = self._ticks(period_s)[1:]
        if self.drive == "velocity":
            times = ticks - 0.5 * period_s  # an edge at 0 s has come by tick 1; tick 0 is at rest
            velocities = self.waveform(times)
            inside = slice(1, self._active(times).stop)
            velocities = self._high_passed(velocities, inside, period_s)
            fade = max(self.edge_time, period_s)
            shape = window(times, self.active_s, fade, fade)
            velocities -= shape * (np.sum(velocities) / np.sum(shape))
            return np.asarray(np.diff(velocities) / period_s)
        middles = ticks[:-1] + 0.5 * period_s
        inside = self._active(middles)
        return _brought_home(self._high_passed(self.waveform(middles), inside, period_s), inside)

    def _held_values(self, period_s: float) -> FloatArray:
        if self.drive != "force":
            return self._accelerations(period_s)
        return self.waveform(self._ticks(period_s)[1:-1] + 0.5 * period_s)

    def _active(self, times: FloatArray) -> slice:
        return slice(0, int(np.searchsorted(times, self.active_s)))

    def _high_passed(self, values: FloatArray, inside: slice, period_s: float) -> FloatArray:
        del inside, period_s  # only long sequences wander far enough to need it
        return values


def levels_at(
    times_s: FloatArray, switches_s: Sequence[float] | FloatArray, levels: FloatArray, edge_time: float
) -> FloatArray:
    """Return a signal that goes to ``levels[k]`` at ``switches_s[k]``, from 0 before the first.

    Parameters
    ----------
    times_s : ndarray -- [s]
    switches_s : sequence of float, shape (n,) -- increasing [s]
    levels : ndarray, shape (n,)
    edge_time : float -- length of the smooth way to the next level [s]; 0 for a jump
    """
    switches = np.asarray(switches_s, dtype=np.float64)
    slack = _EDGE * float(np.min(np.diff(switches)))
    place = np.searchsorted(switches - slack, times_s, side="right")
    padded = np.concatenate([[0.0, 0.0], levels])
    now, before = padded[place + 1], padded[place]
    if edge_time == 0.0:
        return np.asarray(now)
    since = times_s - switches[np.maximum(place - 1, 0)]
    return np.asarray(before + (now - before) * smooth_rise(since / edge_time))


def _brought_home(accelerations: FloatArray, inside: slice) -> FloatArray:
    """Return the nearest accelerations that end with zero velocity and displacement.

    Notes
    -----
    The least-squares change that meets ``sum a = 0`` and ``sum k a = 0`` is a straight line.
    """
    values = np.array(accelerations)
    part = values[inside]
    n = len(part)
    for _ in range(2):  # the second pass takes away the rounding of the first
        lever = np.arange(n) - 0.5 * (n - 1)
        part -= np.mean(part)
        part -= lever * (np.dot(lever, part) / np.dot(lever, lever))
    return values


@dataclass(frozen=True)
class PulseRecipe(LevelRecipe):
    """A recipe of pulses of one width, with pauses.

    Parameters
    ----------
    drive, amplitude, edge_time, still : see ``LevelRecipe``
    width : float -- of each pulse, no shorter than its edges [s]
    gap : float -- rest between pulses [s]
    """

    width: float = 0.1
    gap: float = 0.1

    def _check(self) -> None:
        super()._check()
        self._positive("width")
        self._not_negative("gap")
        self._require(
            self.edge_time <= self.width, "edge_time", self.edge_time, f"at most width = {self.width}"
        )


@dataclass(frozen=True)
class Pulse(PulseRecipe):
    """Pulse to a level and back; in velocity or acceleration, with what undoes it.

    Parameters
    ----------
    drive, amplitude, edge_time, still : see ``LevelRecipe``
    width : float -- from edge to edge [s]
    gap : float -- between the pulses of one train [s]

    Notes
    -----
    Position and force: one pulse.  Velocity: ``+ -``.  Acceleration: ``+ - - +``, whose sum and first
    moment are zero, so that velocity and displacement return by themselves.  A force of long width is
    a step of force.
    """

    kind: ClassVar[str] = "pulse"

    @property
    def _signs(self) -> tuple[float, ...]:
        trains = {"velocity": (1.0, -1.0), "acceleration": (1.0, -1.0, -1.0, 1.0)}
        return trains.get(self.drive, (1.0,))

    @property
    def active_s(self) -> float:
        """Length of the train [s]."""
        n = len(self._signs)
        return n * self.width + (n - 1) * self.gap + self.edge_time

    def waveform(self, times_s: FloatArray) -> FloatArray:
        """Return the signal in its own quantity at any times [s]."""
        total = np.zeros(np.shape(times_s))
        for k, sign in enumerate(self._signs):
            start = k * (self.width + self.gap)
            level = np.array([sign * self.amplitude, 0.0])
            total += levels_at(times_s, (start, start + self.width), level, self.edge_time)
        return total


@dataclass(frozen=True)
class Doublet(PulseRecipe):
    """Two pulses of opposite sign, one right after the other.

    Parameters
    ----------
    drive, amplitude, edge_time, still : see ``LevelRecipe``
    width : float -- of each half [s]
    gap : float -- rest before the mirrored doublet of an acceleration [s]

    Notes
    -----
    Its spectrum is zero at 0 Hz and peaks near 0.37 / ``width``.  An acceleration doublet is a move; it
    is followed by its mirror image, which brings the axis home.
    """

    kind: ClassVar[str] = "doublet"

    gap: float = 1.0

    @property
    def active_s(self) -> float:
        """Length of the doublet, with its mirror image where there is one [s]."""
        once = 2.0 * self.width + self.edge_time
        return 2.0 * once + self.gap if self.drive == "acceleration" else once

    def waveform(self, times_s: FloatArray) -> FloatArray:
        """Return the signal in its own quantity at any times [s]."""
        levels = self.amplitude * np.array([1.0, -1.0, 0.0])
        switches = np.array([0.0, self.width, 2.0 * self.width])
        values = levels_at(times_s, switches, levels, self.edge_time)
        if self.drive == "acceleration":
            later = 2.0 * self.width + self.edge_time + self.gap
            values = values + levels_at(times_s, switches + later, -levels, self.edge_time)
        return values


_TAPS: dict[int, tuple[int, ...]] = {
    3: (3, 2),
    4: (4, 3),
    5: (5, 3),
    6: (6, 5),
    7: (7, 6),
    8: (8, 6, 5, 4),
    9: (9, 5),
    10: (10, 7),
    11: (11, 9),
    12: (12, 6, 4, 1),
    13: (13, 4, 3, 1),
    14: (14, 5, 3, 1),
    15: (15, 14),
    16: (16, 15, 13, 4),
    17: (17, 14),
    18: (18, 11),
}
"""Feedback taps of shift registers of maximal length: exponents of primitive polynomials over GF(2)."""


def maximal_length_sequence(order: int) -> FloatArray:
    """Return the binary sequence of +1 and -1 of a shift register, shape (2^order - 1,).

    Notes
    -----
    Golomb, *Shift Register Sequences* (1967); starts from a register full of ones.
    """
    taps = [tap - 1 for tap in _TAPS[order]]
    register = [1] * order
    bits = np.empty(2**order - 1)
    for k in range(len(bits)):
        bits[k] = register[-1]
        feedback = 0
        for tap in taps:
            feedback ^= register[tap]
        register = [feedback, *register[:-1]]
    return 2.0 * bits - 1.0


@dataclass(frozen=True)
class Prbs(LevelRecipe):
    """Pseudo-random binary sequence of maximal length.

    Parameters
    ----------
    drive, amplitude, edge_time, still : see ``LevelRecipe``
    order : int -- of the shift register, 3 to 18; a period has ``2^order - 1`` clocks
    clock_period : float -- time between two possible switches [s]
    n_periods : int -- how often it repeats
    inverse_repeat : bool
        Every period is followed by its negative: only odd lines are excited, and even
        distortion shows on the others.
    high_pass : float
        For velocity and acceleration: content below this frequency is taken out [Hz], because the integral of
        a binary sequence wanders far; 0 takes out no more than what brings the axis home.

    Notes
    -----
    The power density of the levels is flat within 3 dB up to ``0.44 / clock_period``.
    """

    kind: ClassVar[str] = "prbs"

    drive: str = "acceleration"
    amplitude: float = 0.3
    edge_time: float = 0.0
    order: int = 11
    clock_period: float = 0.005
    n_periods: int = 1
    inverse_repeat: bool = False
    high_pass: float = 1.0

    def _check(self) -> None:
        super()._check()
        self._require(self.order in _TAPS, "order", self.order, f"from {min(_TAPS)} to {max(_TAPS)}")
        self._positive("clock_period")
        self._require(self.n_periods >= 1, "n_periods", self.n_periods, "at least 1")
        self._not_negative("high_pass")
        self._require(
            self.edge_time <= self.clock_period,
            "edge_time",
            self.edge_time,
            f"at most clock_period = {self.clock_period}",
        )
        highest = 0.1 / self.clock_period
        self._require(
            self.high_pass <= highest,
            "high_pass",
            self.high_pass,
            f"at most {highest:g}, a tenth of the clock's rate",
        )

    @property
    def line_period(self) -> float:
        """Length of one period, with its negative where that follows [s]."""
        n_clocks = (1 << self.order) - 1
        return (2.0 if self.inverse_repeat else 1.0) * n_clocks * self.clock_period

    @property
    def active_s(self) -> float:
        """Length of all periods and the last edge [s]."""
        return self.n_periods * self.line_period + self.edge_time

    def line_spacing_hz(self, near_hz: float) -> float:
        """Return the spacing of the excited lines [Hz]."""
        del near_hz
        return (2.0 if self.inverse_repeat else 1.0) / self.line_period

    def waveform(self, times_s: FloatArray) -> FloatArray:
        """Return the signal in its own quantity at any times [s], before anything is taken out."""
        sequence = maximal_length_sequence(self.order)
        period = np.concatenate([sequence, -sequence]) if self.inverse_repeat else sequence
        levels = self.amplitude * np.append(np.tile(period, self.n_periods), 0.0)
        switches = np.asarray(self.clock_period * np.arange(len(levels)), dtype=np.float64)
        return levels_at(times_s, switches, levels, self.edge_time)

    def _accelerations(self, period_s: float) -> FloatArray:
        self._check_clock(period_s)
        return super()._accelerations(period_s)

    def _held_values(self, period_s: float) -> FloatArray:
        self._check_clock(period_s)
        return super()._held_values(period_s)

    def _check_clock(self, period_s: float) -> None:
        ticks = self.clock_period / period_s if period_s > 0.0 else 0.0
        self._require(
            ticks > 0.5 and abs(ticks - round(ticks)) < 1e-6,
            "clock_period",
            self.clock_period,
            f"a whole number of periods of {period_s} s",
        )

    def _high_passed(self, values: FloatArray, inside: slice, period_s: float) -> FloatArray:
        """Take out the cosines below ``high_pass`` over the active stretch."""
        if self.high_pass == 0.0:
            return values
        from scipy.fft import dct, idct  # here: recipes are read where none is high-passed, and fast

        part = values[inside]
        content = dct(part, norm="ortho")
        content[: int(np.ceil(2.0 * len(part) * period_s * self.high_pass))] = 0.0
        result = np.array(values)
        result[inside] = idct(content, norm="ortho")
        return result
