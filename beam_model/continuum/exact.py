"""The exact frequency responses of a uniform beam on its hub, without modes.

At one frequency the beam's equation has constant coefficients and can be solved in closed form; the result is the
yardstick of every truncated model. With x = z/L and, in the Laplace domain,

    w'''' = B w - G alpha,
    B = -(rho s^2 + (xi + xi_a) s) L^4 / (EI (1 + eta s)),    G = (rho s^2 + xi_a s) L^4 / (EI (1 + eta s)),

the solution is a sum of four functions and a particular one. Where |B|^(1/4) is small they are Duncan's
functions as power series, S_k = x^k/k! + B x^(k+4)/(k+4)! + ..., which keep every digit down to zero frequency;
elsewhere exponentials that decay from the two ends, which never overflow.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from beam_model.arrays import ComplexArray, FloatArray
from beam_model.errors import BeamParameterError
from beam_model.frequency_response import FrequencyResponse
from beam_model.parameters import BeamParameters

_DERIVATIVES = {"displacement": 0, "deflection": 0, "slope": 1, "curvature": 2}
# Below this |B|^(1/4) the power series is used: 12 terms reach (2.5^4)^12/51!, below rounding.
_MAX_SERIES_ARGUMENT = 2.5
_SERIES_TERMS = 12


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
        What comes out: u, w, dw/dz, d^2w/dz^2 or alpha.

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
    is_low = _wave_number(parameters, s) < _MAX_SERIES_ARGUMENT
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


def _wave_number(parameters: BeamParameters, s: ComplexArray) -> FloatArray:
    """Return |B|^(1/4), shape (n_frequencies,)."""
    return np.asarray(np.abs(_coefficients(parameters, s)[0]) ** 0.25)


def _coefficients(
    parameters: BeamParameters, s: ComplexArray
) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Return B, G and rho s^2 L^4/(EI (1 + eta s)), each of shape (n_frequencies,)."""
    damping = parameters.damping
    rho = parameters.mass_per_length
    scale = parameters.length**4 / (parameters.flexural_rigidity * (1.0 + damping.internal * s))
    B = -(rho * s * s + (damping.viscous + damping.air) * s) * scale
    return B, (rho * s * s + damping.air * s) * scale, rho * s * s * scale


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
        self._B, self._G, inertia = _coefficients(parameters, s)
        clamp = [self._functions(np.zeros(1), k)[:, 0] for k in range(3)]
        tip = [self._functions(np.ones(1), k)[:, 0] for k in range(4)]
        forced_clamp = [self._particular(np.zeros(1), k)[:, 0] for k in range(3)]
        forced = [self._particular(np.ones(1), k)[:, 0] for k in range(4)]
        # The clamp's spring loses as the strip does: bending moment and spring moment share 1 + eta s.
        compliance = parameters.clamp_compliance
        shear = parameters.tip_mass_ratio * inertia
        moment = parameters.tip_inertia_ratio * inertia
        # Unknowns: four coefficients; equations: deflection and moment at the clamp, shear and moment at the tip.
        rows = np.stack(
            [
                clamp[0],
                clamp[1] - compliance * clamp[2],
                tip[3] - shear[:, None] * tip[0],
                tip[2] + moment[:, None] * tip[1],
            ],
            axis=1,
        )
        right = -np.stack(
            [
                forced_clamp[0],
                forced_clamp[1] - compliance * forced_clamp[2],
                forced[3] - shear * (1.0 + forced[0]),
                forced[2] + moment * forced[1],
            ],
            axis=1,
        )
        size = np.abs(rows).max(axis=2)
        solved = np.linalg.solve(rows / size[:, :, None], (right / size)[:, :, None])
        self._weights: ComplexArray = solved[:, :, 0]

    def _functions(self, x: FloatArray, derivative: int) -> ComplexArray:
        """Return the homogeneous solutions' k-th derivatives, shape (F, n, 4); k = -1 integrates from 0."""
        if self._use_series:
            return np.stack([_duncan(self._B, x, k, derivative) for k in range(4)], axis=2)
        columns = []
        p = self._B[:, None] ** 0.25
        for root in (p, 1j * p):
            root = np.where(root.real >= 0.0, root, -root)
            if derivative == -1:
                from_clamp = -np.expm1(-root * x) / root
                from_tip = (np.exp(-root * (1.0 - x)) - np.exp(-root)) / root
            else:
                from_clamp = (-root) ** derivative * np.exp(-root * x)
                from_tip = root**derivative * np.exp(-root * (1.0 - x))
            columns += [from_clamp, from_tip]
        return np.stack(columns, axis=2)

    def _particular(self, x: FloatArray, derivative: int) -> ComplexArray:
        if self._use_series:
            return -self._G[:, None] * _duncan(self._B, x, 4, derivative)
        constant = (self._G / self._B)[:, None]
        along = x if derivative == -1 else np.ones(x.size) if derivative == 0 else np.zeros(x.size)
        return np.asarray(constant * along)

    def deflection(self, x: FloatArray, derivative: int = 0) -> ComplexArray:
        """Return d^k w/dx^k per alpha, shape (n_frequencies, n)."""
        homogeneous = np.einsum("fxk,fk->fx", self._functions(x, derivative), self._weights)
        return np.asarray(homogeneous + self._particular(x, derivative))

    def impedance(self) -> ComplexArray:
        """Return f/alpha [N/m], what it takes to move the hub, shape (n_frequencies,)."""
        parameters, s = self._parameters, self._s
        mean = self.deflection(np.ones(1), -1)[:, 0]
        tip = self.deflection(np.ones(1))[:, 0]
        strip = (parameters.mass_per_length * s * s + parameters.damping.air * s) * parameters.length
        bodies = parameters.hub_mass * s * s + parameters.tip_mass * s * s * (1.0 + tip)
        return np.asarray(bodies + strip * (1.0 + mean))


def _duncan(B: ComplexArray, x: FloatArray, k: int, derivative: int) -> ComplexArray:
    """Return the derivative of S_k = sum_j B^j x^(k + 4j) / (k + 4j)!, shape (n_frequencies, n)."""
    result = np.zeros((B.size, x.size), dtype=np.complex128)
    for j in range(_SERIES_TERMS):
        power = k + 4 * j - derivative
        if power >= 0:
            result += (B**j)[:, None] * (x**power / float(math.factorial(power)))
    return result
