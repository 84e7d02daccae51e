"""The exact frequency responses of a uniform beam on its hub, without modes.

At one frequency the beam's equation has constant coefficients and can be solved in closed form; the result is the
yardstick of every truncated model. With x = z/L and, in the Laplace domain,

    a = (rho s^2 + (xi + xi_a) s) L^4 / (EI (1 + eta s)),    G = (rho s^2 + xi_a s) L^4 / (EI (1 + eta s)),
    j = (I/A) rho s^2 L^2 / (EI (1 + eta s)),                sigma = EI / (k G A L^2),

forces and moments balance where (Timoshenko 1921)

    w'' - psi' = sigma (a w + G alpha),        sigma psi'' + w' - psi = sigma j psi

with the angle psi of a section. Without psi this is

    w'''' = P w'' - Q w - (1 + sigma j) G alpha,    P = sigma a + j,    Q = (1 + sigma j) a,
    (1 + sigma j) psi = (1 - sigma^2 a) w' + sigma w'''

and Euler and Bernoulli's theory is sigma = j = 0. The solution is a sum of four functions and a particular one. Where
the roots of r^4 = P r^2 - Q are small the functions are power series, S_k = x^k/k! + .. (Duncan's for P = 0), which
keep every digit down to zero frequency; elsewhere exponentials that decay from the two ends, which never overflow.
Air of Sader's theory adds its mass to rho and its damping to xi_a, at each frequency its own.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from beam_model.arrays import ComplexArray, FloatArray
from beam_model.continuum.still_air import air_load
from beam_model.errors import BeamParameterError
from beam_model.frequency_response import FrequencyResponse
from beam_model.parameters import BeamParameters

_DERIVATIVES = {"displacement": 0, "deflection": 0, "slope": 1, "curvature": 2}
# Below this size of the roots the power series is used: powers to 51 reach 2.5^48/51!, below rounding.
_MAX_SERIES_ARGUMENT = 2.5
_SERIES_POWERS = 52

_Functions = Callable[[FloatArray, int], ComplexArray]


def exact_frequency_response(
    parameters: BeamParameters,
    omegas: ArrayLike,
    heights: ArrayLike,
    drive: str = "motion",
    quantity: str = "displacement",
) -> FrequencyResponse:
    """Return the response of the continuous beam, with all its modes.

    Parameters
    ----------
    parameters : BeamParameters
        A beam without gravity, markers and prescribed damping ratios: those have no closed form.
    omegas : array_like, shape (n_frequencies,)
        omega [rad/s], above 0.
    heights : array_like, shape (n_heights,)
        Above the clamp [m].
    drive : {"motion", "force"}
        What goes in: alpha [m] or f [N].
    quantity : {"displacement", "deflection", "slope", "curvature", "hub"}
        What comes out: u, w, dw/dz, the curvature of bending d psi/dz (d^2w/dz^2 without shear) or alpha.

    Raises
    ------
    BeamParameterError
        If the beam has gravity, markers or prescribed ratios, or an argument is out of range.
    """
    _require_closed_form(parameters)
    if drive not in ("motion", "force"):
        raise BeamParameterError("drive", drive, "", '"motion" or "force"')
    if quantity not in (*_DERIVATIVES, "hub"):
        raise BeamParameterError("quantity", quantity, "", f"one of {', '.join([*_DERIVATIVES, 'hub'])}")
    omega = np.atleast_1d(np.asarray(omegas, dtype=np.float64))
    if not np.all(omega > 0.0):
        raise BeamParameterError("omegas", float(np.min(omega)), "rad/s", "above 0")
    z = np.array(parameters.check_heights(np.atleast_1d(np.asarray(heights, dtype=np.float64))))
    values = np.empty((omega.size, z.size), dtype=np.complex128)
    s = np.asarray(1j * omega, dtype=np.complex128)
    equation = _Equation(parameters, s)
    is_low = np.maximum(np.abs(equation.P) ** 0.5, np.abs(equation.Q) ** 0.25) < _MAX_SERIES_ARGUMENT
    for rows in (np.flatnonzero(is_low), np.flatnonzero(~is_low)):
        if rows.size:
            solution = _BeamAtFrequencies(parameters, s[rows], use_series=bool(is_low[rows[0]]))
            if quantity == "hub":
                found = np.ones((rows.size, z.size), dtype=np.complex128)
            else:
                k = _DERIVATIVES[quantity]
                found = solution.deflection(z / parameters.length, k) / parameters.length**k
                if quantity == "displacement":
                    found = 1.0 + found
            values[rows] = found if drive == "motion" else found / solution.impedance()[:, None]
    return FrequencyResponse(omega, z, values, quantity, "m" if drive == "motion" else "N")


class _Equation:
    """The coefficients of the beam's equation at complex frequencies s, each of shape (n_frequencies,)."""

    def __init__(self, parameters: BeamParameters, s: ComplexArray) -> None:
        damping = parameters.damping
        air = air_load(parameters, np.abs(s))
        # What moves the hub along with the strip: inertia and air, per length and per absolute displacement.
        self.absolute = (parameters.mass_per_length + air.mass) * s * s + (damping.air + air.damping) * s
        scale = parameters.length**4 / (parameters.flexural_rigidity * (1.0 + damping.internal * s))
        self.inertia = parameters.mass_per_length * s * s * scale
        self.G = self.absolute * scale
        self.a = self.G + damping.viscous * s * scale
        self.sigma = parameters.shear_compliance
        self.j = parameters.rotary_inertia_ratio * self.inertia
        self.P = self.sigma * self.a + self.j
        self.Q = (1.0 + self.sigma * self.j) * self.a


def _require_closed_form(parameters: BeamParameters) -> None:
    remedy = "Compare against a beam without it, or against finite elements."
    if parameters.gravity_sign != 0:
        raise BeamParameterError("gravity", parameters.gravity, "", '"off" for the closed form', remedy)
    if any(mass.mass > 0.0 for mass in parameters.point_masses):
        raise BeamParameterError(
            "point_masses", parameters.point_masses, "", "none for the closed form", remedy
        )
    if any(ratio > 0.0 for ratio in parameters.damping.ratios):
        raise BeamParameterError(
            "damping.ratios",
            parameters.damping.ratios,
            "",
            "none for the closed form: a ratio belongs to a mode",
            "Use distributed damping: viscous = 2 rho omega_1 zeta_1.",
        )


class _BeamAtFrequencies:
    """w(x) for alpha = 1 at complex frequencies s, shape (n_frequencies,)."""

    def __init__(self, parameters: BeamParameters, s: ComplexArray, use_series: bool) -> None:
        self._parameters, self._s, self._use_series = parameters, s, use_series
        self._equation = equation = _Equation(parameters, s)
        clamp, tip = np.zeros(1), np.ones(1)
        # The clamp's spring loses as the strip does: bending moment and spring moment share 1 + eta s.
        compliance = parameters.clamp_compliance
        shear = parameters.tip_mass_ratio * equation.inertia
        moment = parameters.tip_inertia_ratio * equation.inertia

        def ends(of: _Functions) -> list[ComplexArray]:
            # Deflection and moment at the clamp; shear and moment at the tip. The shear force (w' - psi)/sigma is
            # j psi - psi'', which holds without shear, too.
            angle = self._angle(of, tip, 0)
            return [
                of(clamp, 0)[:, 0],
                (self._angle(of, clamp, 0) - compliance * self._angle(of, clamp, 1))[:, 0],
                (self._angle(of, tip, 2) - _times(equation.j, angle) - _times(shear, of(tip, 0)))[:, 0],
                (self._angle(of, tip, 1) + _times(moment, angle))[:, 0],
            ]

        rows = np.stack(ends(self._functions), axis=1)
        right = -np.stack(ends(self._particular), axis=1)
        right[:, 2] += shear  # of the tip mass that goes along with the hub
        size = np.abs(rows).max(axis=2)
        solved = np.linalg.solve(rows / size[:, :, None], (right / size)[:, :, None])
        self._weights: ComplexArray = solved[:, :, 0]

    def _angle(self, of: _Functions, x: FloatArray, derivative: int) -> ComplexArray:
        """Return the k-th derivative of psi, k = 0 to 2, of a function that gives those of w."""
        equation = self._equation
        sigma = equation.sigma
        if sigma == 0.0:
            return of(x, derivative + 1)
        if derivative == 0:
            angle = _times(1.0 - sigma**2 * equation.a, of(x, 1)) + sigma * of(x, 3)
            return _times(1.0 / (1.0 + sigma * equation.j), angle)
        # psi' = w'' - sigma (a w + G alpha); alpha = 1 belongs to the particular function.
        angle = of(x, derivative + 1) - _times(sigma * equation.a, of(x, derivative - 1))
        if derivative == 1 and of == self._particular:
            angle = angle - sigma * equation.G[:, None]
        return np.asarray(angle)

    def _functions(self, x: FloatArray, derivative: int) -> ComplexArray:
        """Return the homogeneous solutions' k-th derivatives, shape (F, n, 4); k = -1 integrates from 0."""
        if self._use_series:
            return np.stack([self._series(x, k, derivative) for k in range(4)], axis=2)
        columns = []
        P, Q = self._equation.P, self._equation.Q
        root = np.sqrt(P**2 - 4.0 * Q)
        # r^2 = (P +- root)/2: the larger as a sum without cancellation, the other from their product Q.
        larger = 0.5 * (P + np.where((np.conj(P) * root).real >= 0.0, root, -root))
        for square in (larger, Q / larger):
            r = np.sqrt(square)[:, None]
            r = np.where(r.real >= 0.0, r, -r)
            if derivative == -1:
                from_clamp = -np.expm1(-r * x) / r
                from_tip = (np.exp(-r * (1.0 - x)) - np.exp(-r)) / r
            else:
                from_clamp = (-r) ** derivative * np.exp(-r * x)
                from_tip = r**derivative * np.exp(-r * (1.0 - x))
            columns += [from_clamp, from_tip]
        return np.stack(columns, axis=2)

    def _particular(self, x: FloatArray, derivative: int) -> ComplexArray:
        equation = self._equation
        if self._use_series:
            forcing = (1.0 + equation.sigma * equation.j) * equation.G
            return np.asarray(-forcing[:, None] * self._series(x, 4, derivative))
        constant = -(equation.G / equation.a)[:, None]
        along = x if derivative == -1 else np.ones(x.size) if derivative == 0 else np.zeros(x.size)
        return np.asarray(constant * along)

    def _series(self, x: FloatArray, k: int, derivative: int) -> ComplexArray:
        """Return the derivative of S_k = sum of c_n x^n/n! with c_k = 1, shape (n_frequencies, n).

        From w'''' = P w'' - Q w the coefficients follow as c_(n+4) = P c_(n+2) - Q c_n.
        """
        P, Q = self._equation.P, self._equation.Q
        before, now = np.zeros_like(P), np.ones_like(P)
        result = np.zeros((P.size, x.size), dtype=np.complex128)
        for power in range(k, _SERIES_POWERS, 2):
            if power >= derivative:
                n = power - derivative
                result += now[:, None] * (x**n / float(math.factorial(n)))
            # Below x^4 the values at the clamp stand: c_0 to c_3 are those of S_k itself.
            before, now = now, P * now - Q * before if power >= 2 else np.zeros_like(P)
        return result

    def deflection(self, x: FloatArray, derivative: int = 0) -> ComplexArray:
        """Return d^k w/dx^k per alpha, shape (n_frequencies, n); for k = 2 that of bending, d psi/dx."""
        if derivative == 2:
            homogeneous, forced = (self._angle(of, x, 1) for of in (self._functions, self._particular))
        else:
            homogeneous, forced = self._functions(x, derivative), self._particular(x, derivative)
        return np.asarray(np.einsum("fxk,fk->fx", homogeneous, self._weights) + forced)

    def impedance(self) -> ComplexArray:
        """Return f/alpha [N/m], what it takes to move the hub, shape (n_frequencies,)."""
        parameters, s = self._parameters, self._s
        mean = self.deflection(np.ones(1), -1)[:, 0]
        tip = self.deflection(np.ones(1))[:, 0]
        strip = self._equation.absolute * parameters.length
        bodies = parameters.hub_mass * s * s + parameters.tip_mass * s * s * (1.0 + tip)
        return np.asarray(bodies + strip * (1.0 + mean))


def _times(factor: ComplexArray, values: ComplexArray) -> ComplexArray:
    """Return a factor per frequency times values of further axes."""
    return np.asarray(factor.reshape((-1,) + (1,) * (values.ndim - 1)) * values)
