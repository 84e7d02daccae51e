"""Exact responses of ``s^j / A(s)`` and ``s^j / A(s)^2`` to a piecewise polynomial, or to an impulse.

Where the poles keep apart, partial fractions turn both into responses of single poles
and their derivatives by the pole (``1/(s-p)^2`` is the derivative of ``1/(s-p)`` by p),
which ``numerics.pole_response`` gives at any instant.  Where poles meet, the fractions
would cancel: then the poles stay together in a chain (``numerics.chain_response``),
which is exact for double poles too, and slower.

Equation numbers are those of docs/transfer-function-equations.md.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from beam_ident.arrays import ComplexArray, FloatArray, IndexArray
from beam_ident.numerics.chain_response import chain_impulse_response, chain_response
from beam_ident.numerics.piecewise import Instants, PiecewisePolynomial
from beam_ident.numerics.pole_response import PoleResponses

_REAL = 1e-14  # of a root's size: an imaginary part below this is rounding
_SEPARATION = 1e-3  # product of relative distances to the other poles: below it fractions lose digits


def upper_roots(polynomial: FloatArray) -> ComplexArray:
    """Return the roots with imaginary part >= 0 of a real polynomial, real ones first.

    Parameters
    ----------
    polynomial : ndarray, shape (n + 1,) -- descending powers, monic
    """
    if len(polynomial) == 3:  # the usual case, without an eigenvalue problem
        half = -0.5 * polynomial[1]
        inside = half * half - polynomial[2]
        if inside < 0.0:
            return np.array([complex(half, np.sqrt(-inside))])
        # The root without cancellation first; the other from their product.
        larger = half + np.copysign(np.sqrt(inside), half)
        roots = np.array([larger, polynomial[2] / larger if larger else 0.0], dtype=np.complex128)
        return np.sort_complex(roots)
    roots = np.roots(polynomial).astype(np.complex128)
    is_real = np.abs(roots.imag) <= _REAL * np.abs(roots)
    pairs = roots[~is_real & (roots.imag > 0.0)]
    return np.concatenate([np.sort(roots[is_real].real) + 0j, pairs[np.argsort(pairs.imag)]])


def full_roots(upper: ComplexArray) -> ComplexArray:
    """Return all roots from those with imaginary part >= 0."""
    return np.concatenate([upper, np.conj(upper[upper.imag > 0.0])])


class PartialFractions:
    """Partial fractions of a denominator whose poles keep apart.

    Responses are rows of real numbers: ``rows`` holds the real and (negative) imaginary
    parts of the poles' responses, then of their derivatives by the pole.

    Parameters
    ----------
    upper, full : ndarray -- poles with imaginary part >= 0, and all of them in the order of ``full_roots``
    """

    def __init__(self, upper: ComplexArray, full: ComplexArray) -> None:
        self.upper, self.full = upper, full
        gaps = upper[:, None] - full[None, :]
        gaps[np.arange(len(upper)), np.arange(len(upper))] = 1.0
        self.slope = np.prod(gaps, axis=1)  # Q(p) with A = (s - p) Q
        self.bend = np.sum(1.0 / gaps, axis=1) - 1.0  # Q'(p) / Q(p)
        self.weight = np.where(upper.imag > 0.0, 2.0, 1.0)

    @staticmethod
    def rows(parts: Sequence[ComplexArray]) -> FloatArray:
        """Return complex responses as rows that real weights combine."""
        return np.concatenate([part for z in parts for part in (z.real, -z.imag)])

    @staticmethod
    def _weights(parts: Sequence[ComplexArray]) -> FloatArray:
        return np.concatenate([part for z in parts for part in (z.real, z.imag)], axis=1)

    def single(self, powers: IndexArray) -> FloatArray:
        """Return the weights of ``s^power / A``, shape (n_powers, 2 n_upper)."""
        # (T.2); a conjugate pair is twice the real part of one of them.
        return self._weights([self.upper ** powers[:, None] * (self.weight / self.slope)])

    def square(self, powers: IndexArray) -> FloatArray:
        """Return the weights of ``s^power / A^2``, shape (n_powers, 4 n_upper)."""
        # (T.3): the weights of 1/(s - p) and of 1/(s - p)^2.
        front = self.weight / self.slope**2
        shape = self.upper ** powers[:, None] * front
        leading = powers[:, None] * self.upper ** np.maximum(powers[:, None] - 1, 0) * front
        return self._weights([leading - 2.0 * shape * self.bend, shape])


class _Chain:
    """Poles in a chain, each twice where responses of the square are wanted."""

    def __init__(self, full: ComplexArray, squares: bool) -> None:
        self.n = len(full)
        order = np.argsort(-np.abs(full), kind="stable")
        self.chain = np.tile(full[order], 2 if squares else 1)

    def _weights(self, powers: IndexArray, poles: ComplexArray) -> FloatArray:
        """Divide ``s^power`` by the chain's factors from its end: the remainders weigh its states."""
        weights = np.zeros((len(powers), len(poles)), dtype=np.complex128)
        for row, power in enumerate(powers):
            quotient = np.zeros(int(power) + 1, dtype=np.complex128)
            quotient[0] = 1.0
            # Synthetic division of (T.4): what is left of each division weighs that section's state.
            for place in range(len(poles) - 1, -1, -1):
                if not len(quotient):
                    break
                for k in range(1, len(quotient)):
                    quotient[k] += poles[place] * quotient[k - 1]
                weights[row, place] = quotient[-1]
                quotient = quotient[:-1]
        return np.concatenate([weights.real, weights.imag], axis=1)

    def single(self, powers: IndexArray) -> FloatArray:
        weights = self._weights(powers, self.chain[: self.n])
        padded = np.zeros((len(powers), 2, len(self.chain)))
        padded[:, :, : self.n] = weights.reshape(len(powers), 2, self.n)
        return padded.reshape(len(powers), -1)

    def square(self, powers: IndexArray) -> FloatArray:
        return self._weights(powers, self.chain)


def poles_keep_apart(full: ComplexArray) -> bool:
    """Return whether partial fractions of these poles keep their digits."""
    size = np.abs(full)
    relative = np.abs(full[:, None] - full[None, :]) / np.maximum(size[:, None] + size[None, :], 1e-300)
    relative[np.diag_indices_from(relative)] = 1.0
    return bool(np.all(np.prod(relative, axis=1) > _SEPARATION))  # integrators alone leave no poles here


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
        self._prepare(upper, scale, squares)
        self._signals: tuple[PiecewisePolynomial, PiecewisePolynomial, Instants] | None
        self._signals = (drive, integral, instants)
        if isinstance(self._form, _Chain):
            states = chain_response(self._form.chain, scale, drive, integral, instants)
            self._rows = PartialFractions.rows([states])
            return
        sampled = PoleResponses(upper * scale, drive, gradients=squares).sample(instants)
        # s is in units of the scale: 1/(s/w - p) = w/(s - w p), and its derivative by p takes w once more.
        parts = [scale * sampled.values]
        if sampled.pole_slopes is not None:
            parts.append(scale**2 * sampled.pole_slopes)
        self._rows = PartialFractions.rows(parts)

    @classmethod
    def to_impulse(
        cls, upper: ComplexArray, scale: float, elapsed: FloatArray, exposure_s: float, squares: bool
    ) -> RationalResponse:
        """Return the responses to an impulse of area ``1 / scale``: the free motions of the system.

        Parameters
        ----------
        upper, scale, squares : as for a signal
        elapsed : ndarray, shape (n,) -- times since the impulse, exposures not reaching before it [s]
        exposure_s : float -- box average centred on each instant [s]
        """
        response = cls.__new__(cls)
        response._prepare(upper, scale, squares)
        response._signals = None
        half = 0.5 * exposure_s
        if isinstance(response._form, _Chain):
            chain = response._form.chain
            if half > 0.0:  # the average is the difference of the responses to a step
                stepped = np.concatenate([np.zeros(1), chain])
                ends = np.concatenate([elapsed - half, elapsed + half])
                states = chain_impulse_response(stepped, scale, ends)[1:] / (scale * exposure_s)
                states = states[:, len(elapsed) :] - states[:, : len(elapsed)]
            else:
                states = chain_impulse_response(chain, scale, elapsed)
            response._rows = PartialFractions.rows([states])
            return response
        values: ComplexArray = np.exp(upper[:, None] * (scale * elapsed))
        slopes: ComplexArray = scale * elapsed * values
        if half > 0.0:
            z = (half * scale * upper)[:, None]
            near = np.abs(z) < 1e-3
            safe = np.where(near, 1.0, z)
            # Mean of e^(p t) over the exposure, sinh(z)/z with z = p E/2, and its derivative by p; by series
            # near zero.
            # A pole on trial that grows beyond all numbers makes its response infinite, and so its cost.
            with np.errstate(over="ignore", invalid="ignore"):
                box = np.where(near, 1.0 + z**2 / 6.0, np.sinh(safe) / safe)
                bend = np.where(near, z / 3.0 + z**3 / 30.0, (np.cosh(safe) - np.sinh(safe) / safe) / safe)
                slopes = slopes * box + half * scale * bend * values
                values = values * box
        response._rows = PartialFractions.rows([values, slopes] if squares else [values])
        return response

    def _prepare(self, upper: ComplexArray, scale: float, squares: bool) -> None:
        self.poles, self.scale, self.has_squares = upper, scale, squares
        full = full_roots(upper)
        self.order = len(full)
        self._denominator = np.atleast_1d(np.real(np.poly(full)))
        apart = poles_keep_apart(full)
        self._form: PartialFractions | _Chain = (
            PartialFractions(upper, full) if apart else _Chain(full, squares)
        )
        self._direct: list[FloatArray] = []

    @property
    def direct(self) -> FloatArray:
        """The signal itself at the instants, averaged over the exposures."""
        return self._derivative(0)

    def _derivative(self, order: int) -> FloatArray:
        """Return a derivative of the signal (in units of the scale) at the instants."""
        assert self._signals is not None, "an impulse has no finite values"
        drive, integral, instants = self._signals
        while len(self._direct) <= order:
            k = len(self._direct)
            if instants.exposure_s > 0.0:
                source, derivative = (integral, 0) if k == 0 else (drive, k - 1)
                ends = source.evaluate(instants.index, instants.offset, derivative)
                n = len(instants.times)
                values = (ends[n:] - ends[:n]) / instants.exposure_s
            else:
                values = drive.evaluate(instants.index, instants.offset, k)
            self._direct.append(values / self.scale**k)
        return self._direct[order]

    def combined(self, numerators: FloatArray, squared: bool = False) -> FloatArray:
        """Return the responses of several numerators over A, or over A^2, shape (n_instants, n_numerators).

        Parameters
        ----------
        numerators : ndarray, shape (n_numerators, n_powers) -- ascending powers of s
        squared : bool
        """
        powers = np.arange(numerators.shape[1])
        weights = self._form.square(powers) if squared else self._form.single(powers)
        result = (numerators @ weights) @ self._rows[: weights.shape[1]]
        bottom = np.polymul(self._denominator, self._denominator) if squared else self._denominator
        if numerators.shape[1] >= len(bottom):
            for row, ascending in enumerate(numerators):
                top = np.trim_zeros(ascending[::-1], "f")
                quotient, _ = np.polydiv(top if len(top) else np.zeros(1), bottom)
                # The improper part acts on the signal and its derivatives at once.
                for k, factor in enumerate(quotient[::-1]):
                    if factor != 0.0:
                        result[row] += factor * self._derivative(k)
        return np.asarray(result.T)

    def over(self, power: int) -> FloatArray:
        """Return the response of ``s^power / A``."""
        return self.combined(np.eye(1, power + 1, power))[:, 0]

    def over_square(self, power: int) -> FloatArray:
        """Return the response of ``s^power / A^2``."""
        return self.combined(np.eye(1, power + 1, power), squared=True)[:, 0]
