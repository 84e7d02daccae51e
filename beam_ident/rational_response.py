"""Exact responses of ``s^j / A(s)`` and ``s^j / A(s)^2`` to a piecewise polynomial.

Partial fractions turn both into responses of single poles and their derivatives by
the pole (``1/(s-p)^2`` is the derivative of ``1/(s-p)`` by p), which
:mod:`beam_ident.pole_response` gives at any instant.  Poles that coincide are moved apart
by 1e-4 of their size: the response errs by the square of that, and the loss of
digits in the cancelling fractions stays harmless.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beam_ident.piecewise import FloatArray, Instants, PiecewisePolynomial
from beam_ident.pole_response import PoleResponse

ComplexArray = NDArray[np.complex128]

_SEPARATION = 1e-4


def upper_roots(polynomial: FloatArray) -> ComplexArray:
    """Return the roots with imaginary part >= 0 of a real polynomial, moved apart.

    Parameters
    ----------
    polynomial : ndarray, shape (n + 1,) -- descending powers, monic
    """
    roots = np.roots(polynomial).astype(np.complex128)
    size = np.maximum(np.abs(roots), 1e-12)
    nearly_real = np.abs(roots.imag) < 0.5 * _SEPARATION * size
    real = np.sort(roots[nearly_real].real)
    complex_ones = roots[~nearly_real & (roots.imag > 0.0)]
    complex_ones = complex_ones[np.argsort(complex_ones.imag)]
    for k in range(1, len(real)):
        gap = _SEPARATION * max(abs(real[k - 1]), 1e-12)
        if real[k] - real[k - 1] < gap:
            middle = 0.5 * (real[k] + real[k - 1])
            real[k - 1], real[k] = middle - 0.5 * gap, middle + 0.5 * gap
    for k in range(1, len(complex_ones)):
        gap = _SEPARATION * abs(complex_ones[k - 1])
        if abs(complex_ones[k] - complex_ones[k - 1]) < gap:
            middle = 0.5 * (complex_ones[k] + complex_ones[k - 1])
            complex_ones[k - 1], complex_ones[k] = middle - 0.5j * gap, middle + 0.5j * gap
    return np.concatenate([real.astype(np.complex128), complex_ones])


def full_roots(upper: ComplexArray) -> ComplexArray:
    """Return all roots from those with imaginary part >= 0."""
    return np.concatenate([upper, np.conj(upper[upper.imag > 0.0])])


class RationalResponse:
    """Responses of one denominator to one signal at given instants.

    Parameters
    ----------
    upper : ndarray -- poles with imaginary part >= 0 in units of ``scale``
    scale : float -- unit of frequency [rad/s]; ``s`` below means s / scale
    drive, integral : PiecewisePolynomial -- the signal and its antiderivative
    instants : Instants -- located on the drive's knots
    squares : bool -- whether responses of 1/A^2 are wanted too
    """

    def __init__(
        self,
        upper: ComplexArray,
        scale: float,
        drive: PiecewisePolynomial,
        integral: PiecewisePolynomial,
        instants: Instants,
        squares: bool,
    ) -> None:
        self.poles = upper
        self._weight = np.where(upper.imag > 0.0, 2.0, 1.0)
        everything = full_roots(upper)
        first, second = [], []
        for pole in upper:
            others = everything[np.arange(len(everything)) != int(np.argmin(np.abs(everything - pole)))]
            slope = np.prod(pole - others)
            first.append(slope)
            second.append(slope * np.sum(1.0 / (pole - others)))
        self._slope = np.array(first)  # A'(p) = Q(p) with A = (s - p) Q
        self._curvature = np.array(second)  # Q'(p)
        values, slopes = [], []
        for pole in upper:
            sampled = PoleResponse(pole * scale, drive, gradients=squares).sample(instants, integral)
            values.append(scale * sampled.values)
            if sampled.pole_slopes is not None:
                slopes.append(scale**2 * sampled.pole_slopes)
        self._values = np.array(values)
        self._slopes = np.array(slopes)
        self.direct = instants.mean(drive, integral)[0]
        self._tail = -np.real(np.poly(everything))[1:][::-1]  # s^n = 1/(..) A + sum tail[i] s^i

    @property
    def order(self) -> int:
        """Degree of A."""
        return len(self._tail)

    def over(self, power: int) -> FloatArray:
        """Return the response of ``s^power / A`` for powers up to the degree of A."""
        if power == self.order:
            return np.asarray(self.direct + sum(self._tail[i] * self.over(i) for i in range(self.order)))
        weights = self._weight * self.poles**power / self._slope
        return np.asarray(np.real(weights @ self._values))

    def over_square(self, power: int) -> FloatArray:
        """Return the response of ``s^power / A^2`` for powers below twice the degree of A."""
        shape = self.poles**power / self._slope**2
        leading = power * self.poles ** max(power - 1, 0) / self._slope**2
        single = self._weight * (leading - 2.0 * shape * self._curvature / self._slope)
        return np.asarray(np.real(single @ self._values + (self._weight * shape) @ self._slopes))
