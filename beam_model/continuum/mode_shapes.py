"""Clamped modes of a uniform beam in closed form, stable at any order.

The textbook shape cosh - cos - sigma (sinh - sin) (thesis eq. (2.35)) subtracts numbers of size e^b from each
other and has lost every digit by mode 12. Here a shape is written with exponentials that decay from the two
ends only,

    phi(x) = A sin bx + B cos bx + C exp(-bx) + D exp(-b (1 - x)),      x = z / L in [0, 1],

so that no term exceeds the shape itself. Tip mass, tip inertia and a compliant clamp enter the boundary
conditions; with mu = M_t/(rho L), iota = J_t/(rho L^3), gamma = EI/(k_theta L):

    phi(0) = 0,            phi'(0) = gamma phi''(0),
    phi''(1) = iota b^4 phi'(1),       phi'''(1) = -mu b^4 phi(1).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import brentq

from beam_model.arrays import FloatArray

# Roots of a beam's characteristic equations lie about pi apart; where a tip inertia makes two of them
# approach each other they still stay farther apart than this.
_SCAN_STEP = 0.01
_MIN_ROOT = 1e-3


def characteristic_function(
    b: FloatArray | float,
    tip_mass_ratio: float = 0.0,
    tip_inertia_ratio: float = 0.0,
    clamp_compliance: float = 0.0,
) -> FloatArray:
    """Return the clamped beam's characteristic function times exp(-b); its zeros are the roots.

    Parameters
    ----------
    b : array_like
        Trial roots, lambda L of the thesis.
    tip_mass_ratio, tip_inertia_ratio, clamp_compliance : float
        mu = M_t/(rho L), iota = J_t/(rho L^3), gamma = EI/(k_theta L).

    Notes
    -----
    With mu = iota = gamma = 0 it is exp(-b) (1 + cosh b cos b), thesis eq. (2.34). The further terms follow
    from the determinant of the boundary conditions at the head of this module.
    """
    b = np.asarray(b, dtype=np.float64)
    mu, iota, gamma = tip_mass_ratio, tip_inertia_ratio, clamp_compliance
    s, c, e = np.sin(b), np.cos(b), np.exp(-b)
    ch, sh = 0.5 * (1.0 + e * e), 0.5 * -np.expm1(-2.0 * b)
    value = (e + c * ch) + mu * b * (c * sh - s * ch)
    value = value - iota * b**3 * (c * sh + s * ch) + mu * iota * b**4 * (e - c * ch)
    clamp = (s * ch - c * sh) * (1.0 - mu * iota * b**4) + 2.0 * iota * b**3 * c * ch + 2.0 * mu * b * s * sh
    result: FloatArray = value - gamma * b * clamp
    return result


def free_hub_characteristic_function(b: FloatArray | float, hub_mass_ratio: float) -> FloatArray:
    """Return the characteristic function of a bare beam on a free hub, times exp(-b).

    Parameters
    ----------
    b : array_like
        Trial roots.
    hub_mass_ratio : float
        mu = m/(rho L), the hub's mass in masses of the beam.

    Notes
    -----
    cos b sinh b + sin b cosh b + mu b (1 + cos b cosh b) = 0, beside the rigid-body root b = 0. The slope at
    the hub is fixed and the hub's inertia balances the shear force. These are the poles under force; the
    clamped roots are then zeros of the transfer function from force to hub position.
    """
    b = np.asarray(b, dtype=np.float64)
    s, c, e = np.sin(b), np.cos(b), np.exp(-b)
    ch, sh = 0.5 * (1.0 + e * e), 0.5 * -np.expm1(-2.0 * b)
    result: FloatArray = c * sh + s * ch + hub_mass_ratio * b * (e + c * ch)
    return result


def _find_roots(function: Callable[[FloatArray | float], FloatArray], n_roots: int) -> FloatArray:
    """Return the first ``n_roots`` positive zeros, each refined to rounding."""
    roots: list[float] = []
    start = _MIN_ROOT
    while len(roots) < n_roots:
        grid = np.arange(start, start + 4.0 * np.pi * (n_roots - len(roots) + 1), _SCAN_STEP)
        values = function(grid)
        for index in np.flatnonzero(np.signbit(values[:-1]) != np.signbit(values[1:])):
            root = brentq(
                lambda b: float(function(b)),
                grid[index],
                grid[index + 1],
                xtol=1e-300,
                rtol=4.0 * np.finfo(float).eps,
            )
            roots.append(float(root))
        start = float(grid[-1])
    return np.array(roots[:n_roots])


def clamped_roots(
    n_modes: int, tip_mass_ratio: float = 0.0, tip_inertia_ratio: float = 0.0, clamp_compliance: float = 0.0
) -> FloatArray:
    """Return the first roots b of the clamped beam, shape (n_modes,); omega = b^2 sqrt(EI/(rho L^4)).

    Notes
    -----
    Thesis eq. (2.34) for the bare beam: 1.875104, 4.694091, 7.854757, 10.995541, ...
    """
    return _find_roots(
        lambda b: characteristic_function(b, tip_mass_ratio, tip_inertia_ratio, clamp_compliance), n_modes
    )


def free_hub_roots(n_modes: int, hub_mass_ratio: float) -> FloatArray:
    """Return the first elastic roots of a bare beam on a free hub, shape (n_modes,)."""
    return _find_roots(lambda b: free_hub_characteristic_function(b, hub_mass_ratio), n_modes)


class UniformBeamShapes:
    """Clamped mode shapes of a uniform beam with a tip mass, in x = z/L.

    Parameters
    ----------
    n_modes : int
        How many.
    tip_mass_ratio, tip_inertia_ratio, clamp_compliance : float
        mu, iota and gamma, see the head of this module.

    Attributes
    ----------
    roots : ndarray, shape (n_modes,)
        b_i.

    Notes
    -----
    Shapes are scaled to int phi^2 dx + mu phi(1)^2 + iota phi'(1)^2 = 1 + mu and rise from the clamp towards
    +x. For the bare beam this is the scale and the sign of thesis eq. (2.35): int phi^2 = 1, |phi(1)| = 2.
    """

    def __init__(
        self,
        n_modes: int,
        tip_mass_ratio: float = 0.0,
        tip_inertia_ratio: float = 0.0,
        clamp_compliance: float = 0.0,
    ) -> None:
        self._mu, self._iota, self._gamma = tip_mass_ratio, tip_inertia_ratio, clamp_compliance
        self.roots = clamped_roots(n_modes, tip_mass_ratio, tip_inertia_ratio, clamp_compliance)
        self._coefficients = self._solve_boundary_conditions()
        norm = self.squared_integral() + self._mu * self.evaluate(1.0)[0] ** 2
        norm = norm + self._iota * self.evaluate(1.0, 1)[0] ** 2
        self._coefficients = self._coefficients * np.sqrt((1.0 + self._mu) / norm)

    def _solve_boundary_conditions(self) -> FloatArray:
        """Return A, B, C, D, shape (4, n_modes), up to scale, with phi''(0) > 0."""
        b, mu, gamma = self.roots, self._mu, self._gamma
        s, c, e = np.sin(b), np.cos(b), np.exp(-b)
        iota_b3 = self._iota * b**3
        stretch_c, stretch_d = 1.0 + 2.0 * gamma * b, 1.0 - 2.0 * gamma * b
        # Shear and moment at the tip as rows over (C, D), after A and B are eliminated at the clamp.
        shear_c = -stretch_c * c - s - e + mu * b * (stretch_c * s - c + e)
        shear_d = stretch_d * e * c - e * s + 1.0 + mu * b * (-stretch_d * e * s - e * c + 1.0)
        moment_c = -stretch_c * s + c + e - iota_b3 * (stretch_c * c + s - e)
        moment_d = stretch_d * e * s + e * c + 1.0 - iota_b3 * (-stretch_d * e * c + e * s + 1.0)
        # At a root both rows say the same; the longer one says it with more digits.
        use_shear = np.hypot(shear_c, shear_d) >= np.hypot(moment_c, moment_d)
        C = np.where(use_shear, shear_d, moment_d)
        D = -np.where(use_shear, shear_c, moment_c)
        A = stretch_c * C - stretch_d * e * D
        B = -C - e * D
        curvature = -B + C + e * D
        return np.stack([A, B, C, D]) * np.where(curvature < 0.0, -1.0, 1.0)

    def evaluate(self, x: FloatArray | float, derivative: int = 0) -> FloatArray:
        """Return d^k phi / dx^k, shape (n_points, n_modes), for k = 0 to 3.

        Parameters
        ----------
        x : array_like, shape (n_points,)
            Heights in lengths of the beam, 0 to 1.
        derivative : int
            k.
        """
        x = np.atleast_1d(np.asarray(x, dtype=np.float64))[:, None]
        A, B, C, D = self._coefficients
        b = self.roots
        sine, cosine = np.sin(b * x), np.cos(b * x)
        trigonometric = (
            A * sine + B * cosine,
            A * cosine - B * sine,
            -A * sine - B * cosine,
            -A * cosine + B * sine,
        )[derivative]
        sign = -1.0 if derivative % 2 else 1.0
        exponential = sign * C * np.exp(-b * x) + D * np.exp(-b * (1.0 - x))
        result: FloatArray = b**derivative * (trigonometric + exponential)
        return result

    def integral(self) -> FloatArray:
        """Return int_0^1 phi dx, shape (n_modes,)."""
        A, B, C, D = self._coefficients
        b = self.roots
        result: FloatArray = (A * (1.0 - np.cos(b)) + B * np.sin(b) - (C + D) * np.expm1(-b)) / b
        return result

    def squared_integral(self) -> FloatArray:
        """Return int_0^1 phi^2 dx, shape (n_modes,)."""
        A, B, C, D = self._coefficients
        b = self.roots
        s, c, e = np.sin(b), np.cos(b), np.exp(-b)
        sine_cosine = A * A * (0.5 - s * c / (2 * b)) + B * B * (0.5 + s * c / (2 * b)) + A * B * s * s / b
        decays = -(C * C + D * D) * np.expm1(-2.0 * b) / (2.0 * b) + 2.0 * C * D * e
        with_clamp = C * (A * (1.0 - e * (s + c)) + B * (1.0 + e * (s - c))) / b
        with_tip = D * (A * (s - c + e) + B * (s + c - e)) / b
        result: FloatArray = sine_cosine + decays + with_clamp + with_tip
        return result

    def overlap(self) -> FloatArray:
        """Return int_0^1 phi_i phi_j dx, shape (n_modes, n_modes).

        Notes
        -----
        From orthogonality, int phi_i phi_j + mu phi_i(1) phi_j(1) + iota phi_i'(1) phi_j'(1) = (1 + mu) if
        i = j, else 0.
        """
        tip, slope = self.evaluate(1.0)[0], self.evaluate(1.0, 1)[0]
        unit = (1.0 + self._mu) * np.eye(self.roots.size)
        result: FloatArray = unit - self._mu * np.outer(tip, tip) - self._iota * np.outer(slope, slope)
        return result

    def curvature_overlap(self) -> FloatArray:
        """Return int_0^1 phi_i'' phi_j'' dx, shape (n_modes, n_modes).

        Notes
        -----
        From orthogonality, int phi_i'' phi_j'' + phi_i'(0) phi_j'(0) / gamma = (1 + mu) b_i^4 delta_ij; with
        phi'(0) = gamma phi''(0) the clamp's part also holds for gamma = 0.
        """
        bend = self.evaluate(0.0, 2)[0]
        result: FloatArray = np.diag((1.0 + self._mu) * self.roots**4) - self._gamma * np.outer(bend, bend)
        return result

    def static_shape(self, x: FloatArray | float, derivative: int = 0) -> FloatArray:
        """Return the deflection under a unit load on the strip and mu on the tip mass, shape (n_points,).

        Notes
        -----
        Solves phi'''' = 1 with phi'''(1) = -mu, phi''(1) = 0: the beam carried at a constant acceleration.
        """
        x = np.atleast_1d(np.asarray(x, dtype=np.float64))
        mu, gamma = self._mu, self._gamma
        strip = np.polynomial.Polynomial([0.0, 0.5 * gamma, 0.25, -1.0 / 6.0, 1.0 / 24.0])
        tip = np.polynomial.Polynomial([0.0, gamma, 0.5, -1.0 / 6.0])
        shape = strip + mu * tip
        if derivative:
            shape = shape.deriv(derivative)
        return np.asarray(shape(x), dtype=np.float64)
