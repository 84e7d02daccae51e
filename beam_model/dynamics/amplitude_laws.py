"""How one mode's frequency and damping change with its amplitude: cubic terms and drag, averaged over a cycle.

With w = A cos(omega t) phi(z)/phi(z_0) the mode's fourth-order energies, V4 = v A^4 cos^4 and T4 = 1/2 h A^4 omega^2
cos^2 sin^2, shift the frequency, and the drag 1/2 rho_a C_d b |u_t| u_t takes energy from every cycle (Nayfeh and
Mook 1979, section 2.3):

    d omega/omega = (3 v/(2 m omega^2) - h/(4 m)) A^2,      d zeta = 4/(3 pi) (1/2 rho_a C_d b) int |phi|^3 dz A/m

with m, the modal mass, and phi scaled to 1 at z_0. The ringing crosses zero at

    omega sqrt(1 - zeta_0^2 - (1 - 2 c) zeta_0 zeta_q - (k - 2 c) zeta_q^2)

with the drag's share zeta_q: to second order (Bogoliubov and Mitropolsky 1961) the harmonics s_n = 3/(n (4 - n^2)),
n = 3, 5 .., of the drag act back by k = 4 sum n^2 s_n^2/(n^2 - 1), and move the crossings by
c = 2 sum -(-1)^((n-1)/2) s_n/(n^2 - 1).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from beam_model.arrays import FloatArray
from beam_model.dynamics.nonlinear import AirDrag, NonlinearTerms
from beam_model.errors import BeamParameterError
from beam_model.galerkin.model import BeamModel

_OF_BOTH = 1.0959  # 1 - 2 c
_OF_DRAG = 0.2798  # k - 2 c


@dataclass(frozen=True)
class AmplitudeLaw:
    """Frequency and damping ratio of a clamped mode over its amplitude at one height.

    Attributes
    ----------
    natural_frequency : float
        omega of the smallest swings [rad/s].
    damping_ratio : float
        zeta of the smallest swings.
    hardening : float
        Relative change of the frequency per squared amplitude [1/m^2].
    drag : float
        What drag adds to the damping ratio per amplitude [1/m].
    """

    natural_frequency: float
    damping_ratio: float
    hardening: float
    drag: float

    def frequencies(self, amplitudes: ArrayLike) -> FloatArray:
        """Return the frequency at which the ringing crosses zero [rad/s], at amplitudes [m].

        Where the mode does not oscillate it is 0.
        """
        A = np.asarray(amplitudes, dtype=np.float64)
        linear, drag = self.damping_ratio, self.drag * A
        rings = np.sqrt(np.maximum(1.0 - linear**2 - _OF_BOTH * linear * drag - _OF_DRAG * drag**2, 0.0))
        return np.asarray(self.natural_frequency * (1.0 + self.hardening * A**2) * rings)

    def damping_ratios(self, amplitudes: ArrayLike) -> FloatArray:
        """Return zeta at amplitudes [m]."""
        return np.asarray(self.damping_ratio + self.drag * np.asarray(amplitudes, dtype=np.float64))


def amplitude_law(
    model: BeamModel,
    mode: int,
    height: float,
    drag: AirDrag | None = None,
    *,
    is_geometric: bool = True,
) -> AmplitudeLaw:
    """Return the law of one clamped mode.

    Parameters
    ----------
    model : BeamModel
    mode : int
        Index from 0.
    height : float
        Where the amplitude is meant, above the clamp [m].
    drag : AirDrag, optional
        None for a beam that meets none.
    is_geometric : bool
        Whether the cubic inertia, curvature and weight terms are in.

    Raises
    ------
    BeamParameterError
        The mode is not the model's, or it does not move at this height.
    """
    if not 0 <= mode < model.n_modes:
        raise BeamParameterError("mode", mode, "", f"an index from 0 to {model.n_modes - 1}")
    at = float(model.shape([height])[0, mode])
    if abs(at) < 1e-6:
        raise BeamParameterError(
            "height", height, "m", f"a height at which mode {mode + 1} moves", "Take the tip."
        )
    omega, mass = float(model.natural_frequencies[mode]), model.basis.modal_mass
    hardening = 0.0
    if is_geometric:
        terms = NonlinearTerms(model)
        unit = np.zeros(model.n_modes)
        unit[mode] = 1.0
        v, h = terms.potential_energy(unit), 2.0 * terms.kinetic_energy(unit, unit)
        hardening = (1.5 * v / omega**2 - 0.25 * h) / (mass * at**2)
    resisted = 0.0
    if drag is not None:
        points, weights = np.polynomial.legendre.leggauss(8 * (mode + 8))
        z = 0.5 * model.parameters.length * (points + 1.0)
        cubes = 0.5 * model.parameters.length * float(weights @ np.abs(model.shape(z)[:, mode]) ** 3)
        resisted = 4.0 / (3.0 * math.pi) * drag.factor * cubes / (mass * abs(at))
    return AmplitudeLaw(omega, float(model.damping_ratios[mode]), hardening, resisted)
