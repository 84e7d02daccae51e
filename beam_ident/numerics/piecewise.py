"""Signals known between their samples: piecewise polynomials.

An input that is held (ZOH), joined by straight lines or by a cubic spline is a
polynomial between its knots.  Everything the estimators need from an input
follows exactly from its coefficients: values, derivatives, antiderivatives, box
averages and (in ``numerics.pole_response``) the response of a pole to it.

Equation numbers are those of docs/likelihood.md.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from math import factorial
from typing import Literal

import numpy as np

from beam_ident.arrays import FloatArray, IndexArray

Hold = Literal["zoh", "linear", "cubic", "band_limited"]
HOLDS: tuple[Hold, ...] = ("zoh", "linear", "cubic", "band_limited")
BAND_LIMITED_DEGREE = 9


_REGULAR_TOLERANCE = 1e-9  # knots closer than this [s] to k * period count as a regular grid
_SNAP = 1e-6  # of a period: closer to a knot than this counts as after it
_WHOLE_BLOCKS = (
    96  # knots of a regular grid come in multiples of it: no block of them has to be filled up later
)
_LONG_SPLINE = 16  # samples from which on a regular grid's cubic spline is made here
_AT_ONCE = 1 << 16  # samples whose working arrays stay in the cache
_ROUNDING = 16.0 * float(np.finfo(np.float64).eps)  # of an instant: what adding up periods may lose


@dataclass(frozen=True, eq=False)
class PiecewisePolynomial:
    """A scalar signal that is a polynomial between its knots.

    Attributes
    ----------
    knots : ndarray, shape (n_segments + 1,) -- strictly increasing times [s]
    coefficients : ndarray, shape (n_segments, degree + 1)
        Ascending powers of ``t - knots[k]``.
    period : float or None
        Spacing of the knots where they form a regular grid, else None.

    Notes
    -----
    Outside its knots the first and the last polynomial are continued.
    """

    knots: FloatArray
    coefficients: FloatArray
    period: float | None = field(default=None)

    @staticmethod
    def from_samples(
        times_s: FloatArray,
        values: FloatArray,
        hold: Hold,
        margin_s: float = 0.0,
        lead: Literal["constant", "zero"] = "constant",
        known_period: float | None = None,
    ) -> PiecewisePolynomial:
        """Build the signal from samples and the hold between them.

        Parameters
        ----------
        times_s : ndarray, shape (n,) -- strictly increasing sample times [s]
        values : ndarray, shape (n,)
        hold : {"zoh", "linear", "cubic", "band_limited"}
            With "zoh" the last sample holds for one more (last) interval.  "band_limited" is
            a spline of degree 9.
        margin_s : float
            The signal is continued by at least this much on both sides [s].
        lead : {"constant", "zero"}
            What stands before the first sample: its value, or zero.  After the
            last sample its value is held.
        known_period : float or None
            Spacing of the samples [s] where they are known to form a regular grid; None looks.

        Notes
        -----
        Between the samples of a signal without content above half its rate stands its sinc
        interpolation, the limit of interpolating splines as their degree grows (Schoenberg
        1974; Aldroubi, Unser and Eden 1992).  At the fraction ``x = f T`` of the rate a spline
        of odd degree d misses it by less than ``3 (x / (1 - x))^(d + 1)`` of the amplitude and its
        second derivative by ``3 (x / (1 - x))^(d - 1)``: with d = 9 that is 1e-9 and 7e-8 at a
        tenth, 5e-5 and 5e-4 at a quarter of the rate, against 0.04 and 0.3 of a cubic spline.
        The first and last ten samples, where it has neighbours on one side only, are less exact.
        """
        period = regular_period(times_s) if known_period is None else known_period
        if hold == "zoh":
            coefficients = values[:, None]
            knots = np.append(times_s, times_s[-1] + (times_s[-1] - times_s[-2]))
        elif hold == "linear":
            slopes = np.diff(values) / np.diff(times_s)
            coefficients = np.stack([values[:-1], slopes], axis=1)
            knots = times_s
        elif hold == "cubic" and period is not None and len(values) >= _LONG_SPLINE:
            return _regular_cubic(float(times_s[0]), period, values, margin_s, lead == "zero")
        elif hold == "cubic" or len(values) <= BAND_LIMITED_DEGREE:
            from scipy.interpolate import CubicSpline  # here: records are made where nothing is fitted

            spline = CubicSpline(times_s, values, bc_type="not-a-knot" if len(values) > 3 else "natural")
            coefficients = np.ascontiguousarray(spline.c[::-1].T)
            knots = times_s
        else:
            coefficients = _high_spline(times_s, values, period)
            knots = times_s
        step = period if period is not None else float(np.median(np.diff(knots)))
        n_extra, n_after = _margins(len(coefficients), step, margin_s, period is not None)
        if n_extra:
            width = coefficients.shape[1]
            before = np.zeros((n_extra, width))
            before[:, 0] = values[0] if lead == "constant" else 0.0
            after = np.zeros((n_after, width))
            after[:, 0] = values[-1]
            counts = np.arange(1, n_after + 1) * step
            knots = np.concatenate([knots[0] - counts[:n_extra][::-1], knots, knots[-1] + counts])
            coefficients = np.concatenate([before, coefficients, after])
        if period is not None:
            knots = knots[0] + period * np.arange(len(knots))
        return PiecewisePolynomial(knots, np.ascontiguousarray(coefficients), period)

    @property
    def degree(self) -> int:
        """Degree of the polynomials."""
        return int(self.coefficients.shape[1]) - 1

    def locate(self, times: FloatArray) -> tuple[IndexArray, FloatArray]:
        """Return the segment of every instant and the time since its knot [s].

        An instant that misses a knot by rounding alone belongs to the segment that begins
        there: a held input has changed by then.  How far it misses is kept, for a likelihood
        must stay smooth while a clock moves its instants over the knots.
        """
        last = len(self.coefficients) - 1
        slack = _SNAP * (self.period if self.period is not None else float(np.min(np.diff(self.knots))))
        if self.period is not None:
            index = np.floor((times - self.knots[0] + slack) / self.period).astype(np.intp)
        else:
            index = np.searchsorted(self.knots, times + slack, side="right") - 1
        index = np.clip(index, 0, last)
        offset = times - self.knots[index]
        rounding = _ROUNDING * float(np.max(np.abs(times), initial=0.0))
        return index, np.where(np.abs(offset) <= rounding, 0.0, offset)

    def __call__(self, times: FloatArray, derivative: int = 0) -> FloatArray:
        """Return the signal, or one of its derivatives, at any instants."""
        index, offset = self.locate(times)
        return self.evaluate(index, offset, derivative)

    def columns(self, index: IndexArray) -> FloatArray:
        """Return the coefficients of some segments, shape (degree + 1, n)."""
        return np.ascontiguousarray(np.take(self.coefficients, index, axis=0).T)

    def evaluate(
        self, index: IndexArray, offset: FloatArray, derivative: int = 0, columns: FloatArray | None = None
    ) -> FloatArray:
        """Return the signal where ``locate`` has found places; derivative -1 is the integral from the first knot.

        ``columns`` are those of the index where they are known.
        """
        if derivative > self.degree:
            return np.zeros_like(offset)
        columns = self.columns(index) if columns is None else columns
        result = np.zeros_like(offset)
        if derivative == -1:
            for power in range(self.degree, -1, -1):
                # int a_m h^m = a_m h^(m+1)/(m+1).
                result = result * offset + columns[power] / (power + 1)
            return np.asarray(result * offset + self._areas[index])
        for power in range(self.degree, derivative - 1, -1):
            factor = 1.0
            for k in range(derivative):
                factor *= power - k
            # Horner's rule on the derivative's coefficients, power!/(power - derivative)! of each.
            result = result * offset + factor * columns[power]
        return result

    @cached_property
    def _areas(self) -> FloatArray:
        """The integral from the first knot to every segment's, shape (n_segments,)."""
        steps = np.diff(self.knots)
        gains = np.zeros(len(steps))
        for power in range(self.degree, -1, -1):
            gains = (gains + self.coefficients[:, power] / (power + 1)) * steps
        result = np.empty(len(steps))
        result[0] = 0.0
        np.cumsum(gains[:-1], out=result[1:])
        return result

    def antiderivative(self) -> PiecewisePolynomial:
        """Return the integral from the first knot."""
        powers = np.arange(1, self.degree + 2)
        # int a_m h^m = a_m h^(m+1)/(m+1); the constant of a segment is the area of all before it.
        raised = self.coefficients / powers
        return PiecewisePolynomial(self.knots, np.column_stack([self._areas, raised]), self.period)

    def derivative(self) -> PiecewisePolynomial:
        """Return the derivative inside the segments (jumps at the knots are left out)."""
        powers = np.arange(1, self.degree + 1)
        return PiecewisePolynomial(self.knots, self.coefficients[:, 1:] * powers, self.period)

    def shifted(self, offset: float) -> PiecewisePolynomial:
        """Return the signal plus a constant."""
        coefficients = self.coefficients.copy()
        coefficients[:, 0] += offset
        return PiecewisePolynomial(self.knots, coefficients, self.period)


@dataclass(frozen=True, eq=False)
class Instants:
    """Output instants, with their exposures, located on the knots of an input.

    Attributes
    ----------
    times : ndarray, shape (n,) -- centres of the exposures [s]
    exposure_s : float -- length of the box average, 0 for none [s]
    index, offset : ndarray
        Segments and times since their knots: shape (n,), or (2 n,) with all starts of
        the exposures followed by all ends.
    """

    times: FloatArray
    exposure_s: float
    index: IndexArray
    offset: FloatArray
    _latest: list[tuple[PiecewisePolynomial, FloatArray]] = field(default_factory=list, repr=False)

    @staticmethod
    def on(signal: PiecewisePolynomial, times: FloatArray, exposure_s: float) -> Instants:
        """Locate instants on the knots of a signal."""
        if exposure_s > 0.0:
            half = 0.5 * exposure_s
            # Both ends of every exposure: a mean is the difference of an antiderivative there.
            index, offset = signal.locate(np.concatenate([times - half, times + half]))
        else:
            index, offset = signal.locate(times)
        return Instants(times, exposure_s, index, offset)

    def mean(self, signal: PiecewisePolynomial, derivative: int = 0) -> tuple[FloatArray, FloatArray]:
        """Return the signal, or one of its derivatives, averaged over the exposures, and how fast that changes.

        The signal must have the knots on which the instants were located.
        """
        if self.exposure_s > 0.0:
            return self._difference(signal, derivative - 1), self._difference(signal, derivative)
        return self.evaluate(signal, derivative), self.evaluate(signal, derivative + 1)

    def columns_of(self, signal: PiecewisePolynomial) -> FloatArray:
        """Return a signal's coefficients at the instants, shape (degree + 1, n); the latest ones are kept."""
        if not self._latest or self._latest[0][0] is not signal:
            self._latest[:] = [(signal, signal.columns(self.index))]
        return self._latest[0][1]

    def evaluate(self, signal: PiecewisePolynomial, derivative: int = 0) -> FloatArray:
        """Return a signal, one of its derivatives or its integral (-1) at the instants, or at the exposures' ends."""
        return signal.evaluate(self.index, self.offset, derivative, self.columns_of(signal))

    def _difference(self, signal: PiecewisePolynomial, derivative: int) -> FloatArray:
        values = self.evaluate(signal, derivative)
        n = len(self.times)
        return np.asarray((values[n:] - values[:n]) / self.exposure_s)


def _margins(n_segments: int, step: float, margin_s: float, is_regular: bool) -> tuple[int, int]:
    """Return by how many segments a signal is continued before its first and after its last."""
    n_extra = int(np.ceil(margin_s / step)) if margin_s > 0.0 else 0
    filled = -(n_segments + 2 * n_extra) % _WHOLE_BLOCKS if n_extra and is_regular else 0
    return n_extra, n_extra + filled


def _regular_cubic(
    first: float, period: float, values: FloatArray, margin_s: float, leads_from_zero: bool
) -> PiecewisePolynomial:
    """Return the cubic spline (not a knot) of samples on a regular grid.

    Notes
    -----
    Slopes s that make the second derivative continuous, ``s_(k-1) + 4 s_k + s_(k+1) = 3 (m_(k-1) + m_k)`` with
    the differences m over the period h.  Without a knot at the second sample ``s_0 + 2 s_1 = (5 m_0 + m_1) / 2``,
    and so at the other end; what is left for s_1 .. s_(n-2) is positive definite (de Boor, A Practical Guide to
    Splines, 2001).  Long inputs are where memory goes: nothing is made here twice.
    """
    n = len(values)
    slopes = np.empty(n)
    inner = slopes[1:-1]
    np.subtract(values[2:], values[:-2], out=inner)
    inner *= 3.0 / period
    begin, end = np.diff(values[:3]) / period, np.diff(values[-3:])[::-1] / period
    inner[0] = 0.5 * (begin[0] + 5.0 * begin[1])
    inner[-1] = 0.5 * (end[0] + 5.0 * end[1])
    diagonal = np.full(n - 2, 4.0)
    diagonal[0] = diagonal[-1] = 2.0
    from scipy.linalg import lapack  # here: records are made without it

    solved = lapack.dptsv(
        diagonal, np.ones(n - 3), inner, overwrite_d=True, overwrite_e=True, overwrite_b=True
    )
    del diagonal
    inner[:] = solved[2].ravel()
    slopes[0] = 0.5 * (5.0 * begin[0] + begin[1]) - 2.0 * slopes[1]
    slopes[-1] = 0.5 * (5.0 * end[0] + end[1]) - 2.0 * slopes[-2]
    n_before, n_after = _margins(n - 1, period, margin_s, is_regular=True)
    coefficients = np.zeros((n_before + n - 1 + n_after, 4))
    coefficients[:n_before, 0] = 0.0 if leads_from_zero else values[0]
    coefficients[n_before + n - 1 :, 0] = values[-1]
    for start in range(0, n - 1, _AT_ONCE):
        stop = min(start + _AT_ONCE, n - 1)
        own = coefficients[n_before + start : n_before + stop]
        left, right = slopes[start:stop], slopes[start + 1 : stop + 1]
        rise = np.diff(values[start : stop + 1]) / period
        # The cubic of both values and both slopes.
        bend = left + right - 2.0 * rise
        own[:, 0], own[:, 1] = values[start:stop], left
        own[:, 2] = (rise - left - bend) / period
        own[:, 3] = bend / period**2
    knots = np.arange(len(coefficients) + 1, dtype=np.float64)
    knots *= period
    knots += first - period * n_before
    return PiecewisePolynomial(knots, coefficients, period)


def _high_spline(times_s: FloatArray, values: FloatArray, period: float | None) -> FloatArray:
    """Return the interpolating spline of high degree, ascending powers on every interval."""
    from scipy.interpolate import make_interp_spline

    step = period if period is not None else float(np.median(np.diff(times_s)))
    places = (times_s - times_s[0]) / step  # unit intervals keep high powers in range
    spline = make_interp_spline(places, values, BAND_LIMITED_DEGREE)
    columns = [
        # a_m of (I.1): the m-th derivative at the knot over m!.
        spline(places[:-1], power) / (factorial(power) * step**power)
        for power in range(BAND_LIMITED_DEGREE + 1)
    ]
    return np.column_stack(columns)


def regular_period(times_s: FloatArray) -> float | None:
    """Return the period of a regular grid, or None when the stamps are irregular."""
    n = len(times_s)
    if n < 2:
        return None
    period = float(times_s[-1] - times_s[0]) / (n - 1)
    # Seconds since 1970 have steps of 0.24 us.
    rounding = 2.0 * float(np.spacing(max(abs(times_s[0]), abs(times_s[-1]))))
    allowed = min(max(_REGULAR_TOLERANCE, rounding), 1e-3 * period)
    for first in range(0, n, _AT_ONCE):
        some = times_s[first : first + _AT_ONCE]
        if not np.max(np.abs(some - times_s[0] - period * np.arange(first, first + len(some)))) <= allowed:
            return None
    return period
