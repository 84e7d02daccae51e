"""A move as somebody shaped it: accelerations at the device's ticks, there, a rest, and the same way home.

``beam_ident.shaping`` finds such rows of numbers; here they are played exactly, and nothing is sampled anew.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.errors import ExcitationError
from beam_ident.excitation.recipe import Recipe

_SAME = 1e-9  # relative: a period that is stored in seconds, and one that is counted in nanoseconds
_CLOSED = 1e-6  # of the way: what a file's decimals may leave open


@dataclass(frozen=True)
class ShapedMove(Recipe):
    """One move from a place to another, with quiet ways from home and back.

    Parameters
    ----------
    move_from, move_to : float -- where the move begins and ends, from home [m]
    move_aim : float -- swing that the command was shaped to stay below [m]; it changes nothing
    command_period : float -- tick for which the command was made [s]
    command : tuple of float -- accelerations of the move, each held over a tick [m/s^2]
    dwell : float -- rest before and after the move [s]
    still : float -- rest at home afterwards [s]

    Notes
    -----
    The ways from home and back are the same command, scaled down, as often as it takes: what leaves no swing over
    the whole distance leaves less over a part of it.
    """

    kind: ClassVar[str] = "shaped_move"

    move_from: float = 0.0
    move_to: float = 0.02
    move_aim: float = 2e-5
    command_period: float = 1e-3
    command: tuple[float, ...] = ()
    dwell: float = 2.0
    still: float = 10.0

    def _check(self) -> None:
        self._positive("move_aim", "command_period")
        self._not_negative("dwell", "still")
        way = self.move_to - self.move_from
        self._require(way != 0.0, "move_to", self.move_to, "another place than move_from")
        self._require(
            len(self.command) >= 2,
            "command",
            self.command,
            "the accelerations of a shaped move; `beam shape` writes them, with all that goes with them, into a file",
        )
        a, n = np.array(self.command), len(self.command)
        end_speed = float(np.sum(a)) * self.command_period
        reached = float((n - 0.5 - np.arange(n)) @ a) * self.command_period**2
        is_closed = abs(end_speed) * n * self.command_period <= _CLOSED * abs(way)
        self._require(
            is_closed and abs(reached - way) <= _CLOSED * abs(way),
            "command",
            f"{n} accelerations that end {reached:.6g} m away with {end_speed:.3g} m/s",
            f"ones that end at rest {way:.6g} m away; shape the move anew with `beam shape`",
        )

    @property
    def move_start_s(self) -> float:
        """When the move itself begins [s]."""
        approach = self._hops(self.move_from)
        return len(approach) * self.command_period + (
            self._rest * self.command_period if len(approach) else 0.0
        )

    @property
    def move_end_s(self) -> float:
        """When its command has ended [s]."""
        return self.move_start_s + len(self.command) * self.command_period

    @property
    def _rest(self) -> int:
        return round(self.dwell / self.command_period)

    @property
    def total_s(self) -> float:
        """Length [s], all rests included."""
        ticks = len(self._hops(self.move_to)) + self._rest + round(self.still / self.command_period)
        return self.move_end_s + ticks * self.command_period

    def displacement(self, times_s: FloatArray) -> FloatArray:
        """Return the displacement [m] at any times [s]."""
        period, a = self.command_period, self._accelerations(self.command_period)
        v = np.concatenate([[0.0], np.cumsum(a) * period])
        x = np.concatenate([[0.0], np.cumsum(0.5 * (v[:-1] + v[1:])) * period])
        times = np.clip(np.asarray(times_s, dtype=np.float64), 0.0, len(a) * period)
        k = np.minimum((times / period).astype(int), len(a) - 1)
        into = times - k * period
        return np.asarray(x[k] + v[k] * into + 0.5 * a[k] * into**2)

    def _accelerations(self, period_s: float) -> FloatArray:
        if not math.isclose(period_s, self.command_period, rel_tol=_SAME):
            raise ExcitationError(
                f"ShapedMove: command_period is {self.command_period:g} s, and the axis's tick is {period_s:g} s; "
                "expected the same: shape the move for this axis with `beam shape`"
            )
        approach, rest = self._hops(self.move_from), np.zeros(self._rest)
        return np.concatenate(
            [
                approach,
                rest if len(approach) else rest[:0],
                self.command,
                rest,
                -self._hops(self.move_to),
                np.zeros(round(self.still / self.command_period)),
            ]
        )

    def _hops(self, distance: float) -> FloatArray:
        """Return the command's scaled copies that go from home to a place."""
        way = self.move_to - self.move_from
        count = math.ceil(abs(distance / way) - _CLOSED)
        if count <= 0:
            return np.zeros(0)
        return np.tile(np.array(self.command) * (distance / way / count), count)
