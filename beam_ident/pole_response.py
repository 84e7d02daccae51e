"""The exact response of one complex pole to a piecewise polynomial.

For ``x' = p x + a(t)`` with ``a`` a polynomial on every segment, the state at the
knots obeys ``x[k+1] = e^(p h) x[k] + sum_m m! h^(m+1) phi_(m+1)(p h) a[k, m]`` with
the phi functions of exponential integrators, and the same formula with a shorter
step gives the state at any instant in between.  Derivatives with respect to ``p``
follow by differentiating the recursion; averages over an exposure by integrating
the differential equation: ``mean(x) = (x(b) - x(a) - int a) / (p (b - a))``.
Nothing is interpolated and nothing depends on how the stamps of the outputs fall.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from math import factorial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from beam_ident.piecewise import FloatArray, Instants, PiecewisePolynomial

ComplexArray = NDArray[np.complex128]

_SERIES_RADIUS = 1.0
_SERIES_TERMS = 17  # 1 / 17! = 3e-15 of the leading term at the edge of the series' disc


def phi_functions(z: ComplexArray, highest: int) -> list[ComplexArray]:
    """Return ``phi_0 .. phi_highest`` of exponential integrators at ``z``.

    Notes
    -----
    ``phi_0 = e^z``, ``phi_(k+1)(z) = (phi_k(z) - 1/k!) / z``.  The recursion is run
    upwards where ``|z| > 1`` and downwards from a series where it would cancel
    (Hochbruck and Ostermann, Acta Numerica 2010, eq. 2.10).
    """
    z = np.asarray(z, dtype=np.complex128)
    large = np.abs(z) > _SERIES_RADIUS
    any_large = bool(np.any(large))
    small_z = np.where(large, 0.0, z) if any_large else z
    series = np.full(z.shape, 1.0 / factorial(highest + _SERIES_TERMS), dtype=np.complex128)
    for n in range(_SERIES_TERMS - 1, -1, -1):
        series = series * small_z + 1.0 / factorial(highest + n)
    results = [series]
    for k in range(highest - 1, -1, -1):
        results.append(small_z * results[-1] + 1.0 / factorial(k))
    results.reverse()
    if any_large:
        where = z[large]
        current = np.exp(where)
        results[0][large] = current
        for k in range(highest):
            current = (current - 1.0 / factorial(k)) / where
            results[k + 1][large] = current
    return results


def _weights(
    pole: complex, steps: FloatArray, degree: int, gradients: bool
) -> tuple[list[ComplexArray], list[ComplexArray]]:
    """Return ``[e^(p h), g_0 .. g_degree]`` and, when asked, their derivatives by ``p``."""
    phi = phi_functions(np.asarray(pole * steps, dtype=np.complex128), degree + (2 if gradients else 1))
    weights = [phi[0]]
    slopes = [steps * phi[0]] if gradients else []
    power = np.ones_like(steps)
    for m in range(degree + 1):
        power = power * steps
        scale = factorial(m) * power
        weights.append(scale * phi[m + 1])
        if gradients:
            slopes.append(scale * steps * (phi[m + 1] - (m + 1) * phi[m + 2]))
    return weights, slopes


def recursion(factor: ComplexArray, drive: ComplexArray, initial: complex) -> ComplexArray:
    """Return the states of ``x[k+1] = factor[k] x[k] + drive[k]`` from ``initial`` on."""
    n = len(drive)
    states = np.empty(n + 1, dtype=np.complex128)
    states[0] = initial
    if factor.size == 1:
        feedback = complex(factor.ravel()[0])
        filtered, _ = lfilter([1.0], [1.0, -feedback], drive, zi=np.array([feedback * initial]))
        states[1:] = filtered
    else:
        pairs = zip(factor.tolist(), drive.tolist(), strict=True)

        def advance(state: complex, pair: Any) -> complex:
            return complex(pair[0] * state + pair[1])

        states[1:] = list(itertools.accumulate(pairs, advance, initial=complex(initial)))[1:]
    return states


@dataclass(frozen=True, eq=False)
class SampledResponse:
    """A pole's response at output instants (box averages where there is an exposure).

    Attributes
    ----------
    values : ndarray, shape (n,) -- the state ``x``
    pole_slopes : ndarray or None, shape (n,) -- ``dx/dp``
    time_slopes : ndarray or None, shape (n,) -- ``dx/dt``
    """

    values: ComplexArray
    pole_slopes: ComplexArray | None
    time_slopes: ComplexArray | None


class PoleResponse:
    """States of ``x' = p x + a(t)`` at the knots of ``a``, ready to be sampled anywhere.

    Parameters
    ----------
    pole : complex
    drive : PiecewisePolynomial
    initial : complex
        State at the first knot.
    initial_slope : complex
        Its derivative with respect to the pole.
    gradients : bool
        Whether derivatives with respect to the pole are wanted.
    """

    def __init__(
        self,
        pole: complex,
        drive: PiecewisePolynomial,
        initial: complex = 0.0,
        initial_slope: complex = 0.0,
        gradients: bool = True,
    ) -> None:
        self.pole = pole
        self.drive = drive
        self._gradients = gradients
        steps = np.array([drive.period]) if drive.period is not None else np.diff(drive.knots)
        weights, slopes = _weights(pole, steps, drive.degree, gradients)
        forcing = sum(
            (weights[m + 1] * drive.coefficients[:, m] for m in range(drive.degree + 1)), np.complex128(0)
        )
        self.states = recursion(weights[0], np.asarray(forcing), initial)
        self.state_slopes: ComplexArray | None = None
        if gradients:
            forcing = slopes[0] * self.states[:-1]
            for m in range(drive.degree + 1):
                forcing = forcing + slopes[m + 1] * drive.coefficients[:, m]
            self.state_slopes = recursion(weights[0], forcing, initial_slope)

    def at(self, index: NDArray[np.intp], offset: FloatArray) -> tuple[ComplexArray, ComplexArray | None]:
        """Return the state and its derivative by the pole at places inside segments."""
        if not np.any(offset):  # every instant is a knot
            return self.states[index], None if self.state_slopes is None else self.state_slopes[index]
        weights, slopes = _weights(self.pole, offset, self.drive.degree, self._gradients)
        state = self.states[index]
        rows = self.drive.coefficients[index]
        value = weights[0] * state
        for m in range(self.drive.degree + 1):
            value = value + weights[m + 1] * rows[:, m]
        if self.state_slopes is None:
            return value, None
        slope = slopes[0] * state + weights[0] * self.state_slopes[index]
        for m in range(self.drive.degree + 1):
            slope = slope + slopes[m + 1] * rows[:, m]
        return value, slope

    def sample(self, instants: Instants, integral: PiecewisePolynomial) -> SampledResponse:
        """Return the response at output instants, averaged over their exposures.

        Parameters
        ----------
        instants : Instants -- located on the knots of the drive
        integral : PiecewisePolynomial -- antiderivative of the drive
        """
        index, offset = instants.index, instants.offset
        value, slope = self.at(index, offset)
        if instants.exposure_s <= 0.0:
            rate = self.pole * value + self.drive.evaluate(index, offset) if self._gradients else None
            return SampledResponse(value, slope, rate)
        area = integral.evaluate(index, offset)
        n = len(instants.times)
        scale = 1.0 / (self.pole * instants.exposure_s)
        difference = value[n:] - value[:n]
        mean = (difference - (area[n:] - area[:n])) * scale
        if slope is None:
            return SampledResponse(mean, None, None)
        mean_slope = (slope[n:] - slope[:n]) * scale - mean / self.pole
        return SampledResponse(mean, mean_slope, difference / instants.exposure_s)
