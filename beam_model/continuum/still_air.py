"""What still air does to a swinging strip: the mass that moves along, and viscous damping (Sader 1998).

A thin blade of width b that swings broadside at omega meets, per length, the force

    -(m_a w'' + c_a w'),    m_a = pi/4 rho_a b^2 Re Gamma,    c_a = pi/4 rho_a b^2 omega Im Gamma      eq. (12)

with the hydrodynamic function Gamma of the Reynolds number Re = rho_a omega b^2/(4 mu): that of a circular cylinder
(unsteady Stokes flow) times a correction for the blade. The theory holds for b far above the thickness, b far below
the wavelength along the strip, Re up to 1e4, and amplitudes so small that no vortex leaves an edge.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import kve

from beam_model.arrays import ComplexArray, FloatArray
from beam_model.parameters import BeamParameters

MAX_REYNOLDS = 1e4
_MIN_REYNOLDS = 1e-6
# Sader (1998), eq. (21): real and imaginary part of the correction, over powers of log10 Re.
_REAL = (
    (0.91324, -0.48274, 0.46842, -0.12886, 0.044055, -0.0035117, 0.00069085),
    (1.0, -0.56964, 0.48690, -0.13444, 0.045155, -0.0035862, 0.00069085),
)
_IMAGINARY = (
    (-0.024134, -0.029256, 0.016294, -0.00010961, 0.000064577, -0.000044510),
    (1.0, -0.59702, 0.55182, -0.18357, 0.079156, -0.014369, 0.0028361),
)


@dataclass(frozen=True)
class AirLoad:
    """What moves along and what resists, at some frequencies.

    Attributes
    ----------
    mass : ndarray, shape (n_frequencies,)
        m_a [kg/m].
    damping : ndarray, shape (n_frequencies,)
        c_a [N s/m^2], on the absolute motion.
    reynolds : ndarray, shape (n_frequencies,)
        Re; above ``MAX_REYNOLDS`` the blade's correction is that of ``MAX_REYNOLDS``.
    """

    mass: FloatArray
    damping: FloatArray
    reynolds: FloatArray


def hydrodynamic_function(reynolds: ArrayLike) -> ComplexArray:
    """Return Gamma of a thin blade that swings broadside, shape (n,); time runs as exp(-i omega t).

    Parameters
    ----------
    reynolds : array_like, shape (n,)
        Re = rho_a omega b^2/(4 mu).

    Notes
    -----
    Sader (1998), eqs. (19) to (21); within 0.1 % for 1e-6 <= Re <= 1e4, and held at these ends.
    """
    Re = np.clip(np.atleast_1d(np.asarray(reynolds, dtype=np.float64)), _MIN_REYNOLDS, None)
    root = np.sqrt(1j * Re)
    # K_1/K_0 of -i sqrt(i Re), both scaled by the same exponential.
    circular = 1.0 + 4j * kve(1, -1j * root) / (root * kve(0, -1j * root))
    tau = np.log10(np.minimum(Re, MAX_REYNOLDS))
    polyval = np.polynomial.polynomial.polyval
    real, imaginary = (polyval(tau, over) / polyval(tau, under) for over, under in (_REAL, _IMAGINARY))
    return np.asarray((real + 1j * imaginary) * circular, dtype=np.complex128)


def air_load(parameters: BeamParameters, omegas: ArrayLike) -> AirLoad:
    """Return the air's mass and damping per length at omega [rad/s]; zeros for a beam without ``air``."""
    omega = np.atleast_1d(np.asarray(omegas, dtype=np.float64))
    air, section = parameters.air, parameters.section
    if air is None or section is None:
        return AirLoad(*(np.zeros(omega.size) for _ in range(3)))
    reynolds = air.density * omega * section.width**2 / (4.0 * air.viscosity)
    gamma = hydrodynamic_function(reynolds)
    along = 0.25 * math.pi * air.density * section.width**2
    return AirLoad(along * gamma.real, along * omega * gamma.imag, reynolds)
