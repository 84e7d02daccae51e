"""Modes whose natural frequency changes while they are recorded: with time (glue that cures), or with their swing.

A mode with the natural frequency ``omega s(t)`` is one that does not change in a time of its own, ``u' = s(t)``.
With ``q' = s q_u`` its equation of motion becomes

    q_uu + 2 zeta_u omega q_u + omega^2 q = f / s^2,    zeta_u = zeta + s' / (2 omega s^2)

so that the exact response of a pole serves here, too, with knots and instants in the mode's own time.  The
acceleration of a moved base takes part in this: a position that is known over t is known over u.  Where s follows the
square of the amplitude (Duffing's oscillator, averaged over a cycle: Nayfeh and Mook, Nonlinear Oscillations, 1979,
2.3.1), the swing does not fall as the frequency rises, and s' is left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.numerics.piecewise import PiecewisePolynomial


@dataclass(frozen=True, eq=False)
class ModeChange:
    """A change of one mode's natural frequency, ``omega (1 + share course(t))``.

    Attributes
    ----------
    over : {"time", "swing"}
    omega : float -- where the course is zero [rad/s]; the mode nearest to it is meant
    share : float -- from the beginning of the course to its end
    course : PiecewisePolynomial
        Over time from the first stamp to the last, and zero in the middle; over the swing the square of the
        amplitude, as a share of its largest, and zero where the energy is in the mean.
    begins : float -- the course at the first stamp, or at rest; it ends one above
    swing : float -- the largest amplitude, at the output where it is largest; 0 over time
    """

    over: Literal["time", "swing"]
    omega: float
    share: float
    course: PiecewisePolynomial
    begins: float = -0.5
    swing: float = 0.0

    @property
    def ends_hz(self) -> tuple[float, float]:
        """Natural frequency at the first stamp, or at rest, and at the other end [Hz]."""
        hertz = self.omega / (2.0 * np.pi)
        first = hertz * (1.0 + self.share * self.begins)
        return first, first + hertz * self.share

    @property
    def runs_forward(self) -> bool:
        """Whether the frequency stays above zero all along; else this is no mode that changes."""
        return min(self.ends_hz) > 0.0

    def mode_of(self, omegas: FloatArray) -> int:
        """Return which of some modes is meant, by its number."""
        return int(np.argmin(np.abs(np.log(omegas / self.omega))))

    def pace(self, times: FloatArray) -> FloatArray:
        """Return how fast the mode's own time runs at instants of the record."""
        return np.asarray(1.0 + self.share * self.course(times))

    def own_time(self, times: FloatArray) -> FloatArray:
        """Return the mode's own time at instants of the record [s]."""
        return np.asarray(times + self.share * self._area(times))

    def signal(self, drive: PiecewisePolynomial, order: int) -> PiecewisePolynomial:
        """Return an input over the mode's own time, times the pace to a power.

        Notes
        -----
        Within a segment the pace is taken as that of its middle, which is wrong by less than what it changes there.
        """
        paces = self.pace(0.5 * (drive.knots[:-1] + drive.knots[1:]))[:, None]
        coefficients = drive.coefficients * paces ** (order - np.arange(drive.degree + 1))
        return PiecewisePolynomial(self.own_time(drive.knots), coefficients)

    def damping_ratio(self, omega: float, zeta: float) -> float:
        """Return the damping ratio of the mode in its own time."""
        if self.over == "swing":
            return zeta
        return zeta + 0.5 * self.share * float(self.course.coefficients[0, 1]) / omega

    @cached_property
    def _area(self) -> PiecewisePolynomial:
        return self.course.antiderivative()


def over_time(first_s: float, last_s: float) -> PiecewisePolynomial:
    """Return the course of an even change between two instants [s]."""
    line = np.array([[-0.5, 1.0 / (last_s - first_s)]])
    return PiecewisePolynomial(np.array([first_s, last_s]), line)


def over_swing(
    times: FloatArray, squares: FloatArray, period_s: float, margin_s: float
) -> tuple[PiecewisePolynomial, float, float]:
    """Return the course of a change with the square of an amplitude, where it begins, and the largest amplitude.

    Parameters
    ----------
    times, squares : ndarray, shape (n,)
    period_s : float -- over which squares are averaged
    margin_s : float -- for which it stays as it is, at both ends
    """
    width = max(round(period_s * (len(times) - 1) / float(np.ptp(times))), 1)
    sums = np.concatenate([[0.0], np.cumsum(squares)])
    first = np.clip(np.arange(len(times)) - width // 2, 0, len(times))
    last = np.clip(first + width, 1, len(times))
    first = np.maximum(last - width, 0)
    means = (sums[last] - sums[first]) / (last - first)
    course = means / np.max(means)
    begins = -float(np.sum(np.square(course)) / np.sum(course))
    return (
        PiecewisePolynomial.from_samples(times, course + begins, "linear", margin_s),
        begins,
        float(np.sqrt(np.max(means))),
    )


def changes_of(changes: Sequence[ModeChange], omegas: FloatArray) -> dict[int, ModeChange]:
    """Return which of some modes change, by their number; the first of several changes of one counts."""
    if not len(omegas):
        return {}
    return {own.mode_of(omegas): own for own in reversed(changes) if own.share}
