"""Galerkin's method with the beam's own clamped modes as the basis: M, C, K, F (thesis eqs. (2.36)-(2.41)).

With w(z, t) = sum q_i(t) phi_i(z) and x = [alpha, q_1 .. q_n] the beam on its hub obeys
M x'' + C x' + K x = F f:

    M = [[J, E^T], [E, m_b I]],   K = diag(0, m_b omega_i^2),   F = [1, 0 ..],
    J = m + m_b,   E_i = int rho phi_i dz + sum of m_k phi_i(z_k) + M_t phi_i(L)

The phi_i are the clamped modes of the beam with everything that it carries, so that M and K are diagonal
but for the coupling E to the hub. They are scaled to the modal mass m_b = rho L + M_t + marker masses;
for a bare beam that is the scale of thesis eq. (2.35). Still air adds to the strip's inertia, not to its weight, what
moves along at the first mode's frequency; every mode's frequency and damping are then those of the air at its own.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from beam_model.arrays import FloatArray
from beam_model.continuum.mode_shapes import UniformBeamShapes
from beam_model.continuum.spectral_elements import SpectralElements
from beam_model.continuum.still_air import air_load
from beam_model.parameters import BeamParameters


class ModalBasis:
    """The first clamped, undamped modes of a beam, in SI units.

    Parameters
    ----------
    parameters : BeamParameters
        The beam.
    n_modes : int
        How many modes.

    Attributes
    ----------
    natural_frequencies : ndarray, shape (n_modes,)
        omega_i [rad/s].
    modal_mass : float
        m_b [kg], the same for every mode; with the air that moves along.
    air_damping : ndarray, shape (n_modes,)
        c_a of still air at each mode's frequency, as it acts on ``modal_mass`` [N s/m^2].
    participation : ndarray, shape (n_modes,)
        E_i [kg], thesis eq. (2.36) with the tip mass and the markers.
    strip_integral : ndarray, shape (n_modes,)
        int phi_i dz [m].
    strip_overlap : ndarray, shape (n_modes, n_modes)
        int phi_i phi_j dz [m].
    bending_stiffness : ndarray, shape (n_modes, n_modes)
        int EI phi_i'' phi_j'' dz + k_theta phi_i'(0) phi_j'(0) [N/m]: what bends in the strip and in its clamp, and
        what shears.

    Notes
    -----
    A uniform beam without gravity, markers, shear and air has its modes in closed form (``mode_shapes``); every other
    one is solved to rounding in piecewise polynomials (``spectral_elements``).
    """

    def __init__(self, parameters: BeamParameters, n_modes: int) -> None:
        self._parameters = parameters
        L, rho = parameters.length, parameters.mass_per_length
        strip = rho * L
        is_plain = parameters.theory == "euler-bernoulli" and parameters.air is None
        self._uniform: UniformBeamShapes | None = None
        if (
            is_plain
            and parameters.gravity_sign == 0
            and not any(mass.mass > 0.0 for mass in parameters.point_masses)
        ):
            self.modal_mass = parameters.beam_mass
            # omega_i = (lambda_i L)^2 sqrt(EI/(rho L^4)), thesis eq. (2.34), with tip and clamp in the roots.
            shapes = UniformBeamShapes(
                n_modes, parameters.tip_mass_ratio, parameters.tip_inertia_ratio, parameters.clamp_compliance
            )
            self._uniform = shapes
            self.natural_frequencies: FloatArray = shapes.roots**2 / parameters.time_scale
            self.air_damping: FloatArray = np.zeros(n_modes)
            self.strip_integral: FloatArray = L * shapes.integral()
            self.strip_overlap: FloatArray = L * shapes.overlap()
            curvature_overlap = shapes.curvature_overlap() / L**3
            tip = shapes.evaluate(1.0)[0]
            self.participation: FloatArray = rho * self.strip_integral + parameters.tip_mass * tip
        else:
            added = _added_mass(parameters)
            self.modal_mass = parameters.beam_mass + added * L
            elements = SpectralElements(parameters, n_modes, added / rho)
            squared, vectors = elements.modes(n_modes)
            # Sign and scale of thesis eq. (2.35): positive curvature at the clamp, modal mass m_b.
            rise = elements.basis(np.zeros(1), 2)[0] @ vectors
            vectors = vectors * np.where(rise < 0.0, -1.0, 1.0) * np.sqrt(self.modal_mass / strip)
            self._elements, self._vectors = elements, vectors
            self._static_vector = elements.solve(elements.load)
            self.natural_frequencies = np.sqrt(squared) / parameters.time_scale
            self.strip_integral = L * (elements.strip_load @ vectors)
            self.strip_overlap = L * (vectors.T @ elements.strip_mass @ vectors)
            curvature_overlap = (vectors.T @ elements.elastic @ vectors) / L**3
            self.participation = strip * (elements.load @ vectors)
            # Less air goes along with the higher modes: they are faster, and slowed down as fast as if it did.
            air = air_load(parameters, self.natural_frequencies)
            share = 1.0 + (air.mass - added) * np.diag(self.strip_overlap) / self.modal_mass
            self.natural_frequencies /= np.sqrt(share)
            self.air_damping = air_load(parameters, self.natural_frequencies).damping / share
        self.bending_stiffness: FloatArray = parameters.flexural_rigidity * curvature_overlap
        if math.isfinite(parameters.clamp_stiffness):
            slopes = self._clamp_angles()
            self.bending_stiffness += parameters.clamp_stiffness * np.outer(slopes, slopes)

    def shape(self, heights: FloatArray, derivative: int = 0) -> FloatArray:
        """Return d^k phi_i / dz^k at ``heights`` [m], shape (n_heights, n_modes), for k = 0 to 3.

        Curvature and its derivative are those of bending: shear bends no section.
        """
        x = np.asarray(heights, dtype=np.float64) / self._parameters.length
        if self._uniform is not None:
            values = self._uniform.evaluate(x, derivative)
        else:
            values = self._elements.basis(x, derivative) @ self._vectors
        result: FloatArray = values / self._parameters.length**derivative
        return result

    def _clamp_angles(self) -> FloatArray:
        """Return by how much the section in the clamp turns, shape (n_modes,) [1/m]."""
        if self._uniform is not None:
            return np.asarray(self._uniform.evaluate(0.0, 1)[0] / self._parameters.length)
        return np.asarray(self._elements.angle(np.zeros(1))[0] @ self._vectors / self._parameters.length)

    def static_shape(self, heights: FloatArray, derivative: int = 0) -> FloatArray:
        """Return d^k S/dz^k, shape (n_heights,): w = -S(z) [s^2] alpha'' under a lasting hub acceleration."""
        x = np.asarray(heights, dtype=np.float64) / self._parameters.length
        if self._uniform is not None:
            values = self._uniform.static_shape(x, derivative)
        else:
            values = self._elements.basis(x, derivative) @ self._static_vector
        result: FloatArray = values * self._parameters.time_scale**2 / self._parameters.length**derivative
        return result

    def static_reaction(self) -> float:
        """Return the integral of S over the inertia load [kg s^2]; the hub feels -alpha'''' times it."""
        parameters = self._parameters
        strip = parameters.mass_per_length * parameters.length
        if self._uniform is not None:
            mu, gamma = parameters.tip_mass_ratio, parameters.clamp_compliance
            # int S_strip + 2 mu S_strip(1) + mu^2 S_tip(1), by reciprocity.
            strip_tip, tip_tip = 1.0 / 8.0 + gamma / 2.0, 1.0 / 3.0 + gamma
            # Static deflections at unit EI, L: the strip's weight bends itself by 1/20 (mean), its tip by
            # 1/8; a unit tip load bends the tip by 1/3; the clamp turns by gamma times the moment, 1/2 or 1.
            value = 1.0 / 20.0 + gamma / 4.0 + 2.0 * mu * strip_tip + mu**2 * tip_tip
        else:
            value = float(self._elements.load @ self._static_vector)
        return value * strip * parameters.time_scale**2


def _added_mass(parameters: BeamParameters) -> float:
    """Return the mass of still air that moves along at the first mode's frequency [kg/m]."""
    if parameters.air is None:
        return 0.0
    squared, _ = SpectralElements(parameters, 1).modes(1)
    return float(air_load(parameters, np.sqrt(squared) / parameters.time_scale).mass[0])


@dataclass(frozen=True)
class ModalParameters:
    """Undamped modes of the beam on its free hub, thesis eqs. (2.42) and (2.43).

    Attributes
    ----------
    natural_frequencies : ndarray, shape (1 + n,)
        omega_r [rad/s]; the first, 0, is the rigid body.
    vectors : ndarray, shape (1 + n, 1 + n)
        phi_r over [alpha, q_1 .. q_n], one mode a column, scaled to M_r = 1.
    masses, stiffnesses : ndarray, shape (1 + n,)
        M_r = phi_r^T M phi_r and K_r = phi_r^T K phi_r = omega_r^2 M_r.
    dampings : ndarray, shape (1 + n, 1 + n)
        phi^T C phi. Its diagonal is C_r = 2 zeta_r omega_r M_r where damping is proportional; off it lies what
        couples the modes. (The thesis's line for C_r prints K in place of C.)
    """

    natural_frequencies: FloatArray
    vectors: FloatArray
    masses: FloatArray
    stiffnesses: FloatArray
    dampings: FloatArray


@dataclass(frozen=True)
class GalerkinMatrices:
    """The matrices of thesis eq. (2.40) over x = [alpha, q_1 .. q_n].

    Attributes
    ----------
    M, C, K : ndarray, shape (1 + n, 1 + n)
        Mass, damping and stiffness.
    F : ndarray, shape (1 + n,)
        Where the force acts.
    """

    M: FloatArray
    C: FloatArray
    K: FloatArray
    F: FloatArray

    @property
    def resists_hub(self) -> bool:
        """Whether the air resists the hub's own motion."""
        return bool(self.C[0, 0] > 0.0)

    def modal_parameters(self) -> ModalParameters:
        """Return the eigenvectors of K - omega^2 M and M, C, K between them, thesis eqs. (2.42) and (2.43)."""
        squared, V = linalg.eigh(self.K, self.M)
        # The rigid body: rounding leaves a small number of either sign.
        squared[0] = 0.0
        return ModalParameters(
            natural_frequencies=np.sqrt(squared),
            vectors=V,
            masses=np.einsum("ir,ij,jr->r", V, self.M, V),
            stiffnesses=np.einsum("ir,ij,jr->r", V, self.K, V),
            dampings=V.T @ self.C @ V,
        )

    def state_space(self) -> tuple[FloatArray, FloatArray]:
        """Return A (2N, 2N) and B (2N,) of X' = A X + B f with X = [x, x'], thesis eq. (2.41)."""
        size = self.F.size
        # x'' = M^-1 (F f - C x' - K x).
        right = np.linalg.solve(self.M, np.column_stack([self.K, self.C, self.F]))
        A = np.zeros((2 * size, 2 * size))
        A[:size, size:] = np.eye(size)
        A[size:, :size] = -right[:, :size]
        A[size:, size:] = -right[:, size : 2 * size]
        return A, np.concatenate([np.zeros(size), right[:, -1]])

    def elastic_states(self) -> tuple[FloatArray, FloatArray]:
        """Return A and its inverse over [q, q'] of the beam on its free hub, and alpha', too, where air resists it.

        Notes
        -----
        The inverse solves both rows of eq. (2.40) without a force for [q, alpha'], given their derivatives.
        """
        n = self.F.size - 1
        kept = np.r_[1 : n + 1, n + 2 : 2 * n + 2]
        if self.resists_hub:
            kept = np.append(kept, n + 1)
        A = self.state_space()[0][np.ix_(kept, kept)]
        M, C, stiffness = self.M, self.C, np.diag(self.K)[1:]
        inverse = np.zeros_like(A)
        inverse[n : 2 * n, :n] = np.eye(n)
        by_rates, by_accelerations = C[1:, 1:], M[1:, 1:] - np.outer(M[1:, 0], M[0, 1:]) / M[0, 0]
        if self.resists_hub:
            # v = -(C_0q q' + E q'' + J v')/C_00, which then enters the rows of q.
            hub = -np.concatenate([C[0, 1:], M[0, 1:], M[0, :1]]) / C[0, 0]
            inverse[2 * n] = hub
            row = np.hstack([C[1:, 1:], M[1:, 1:], M[1:, :1]]) + np.outer(C[1:, 0], hub)
            inverse[:n] = -row / stiffness[:, None]
        else:
            inverse[:n] = -np.hstack([by_rates, by_accelerations]) / stiffness[:, None]
        return A, inverse


def assemble(parameters: BeamParameters, basis: ModalBasis) -> GalerkinMatrices:
    """Return M, C, K and F of the beam on its hub in the basis of its clamped modes.

    Notes
    -----
    C adds up what ``Damping`` holds: prescribed ratios give 2 zeta_i omega_i m_b on the diagonal; xi gives
    int xi phi_i phi_j (thesis eq. (2.39)); xi_a the same and, because air resists the absolute motion, the
    hub's row xi_a [L, int phi_i]; still air acts as xi_a does, with c_a of each mode's frequency; eta gives eta
    times the elastic stiffness, the clamp's with it: a clamp yields because metal bends in it, which loses as the
    strip does.
    """
    n = basis.natural_frequencies.size
    damping = parameters.damping
    mass, E = basis.modal_mass, basis.participation
    M = np.zeros((n + 1, n + 1))
    M[0, 0] = parameters.hub_mass + mass
    # Inertia couples hub and beam, stiffness does not: it acts on w alone.
    M[0, 1:] = M[1:, 0] = E
    M[1:, 1:] = mass * np.eye(n)
    K = np.zeros((n + 1, n + 1))
    K[1:, 1:] = np.diag(mass * basis.natural_frequencies**2)
    ratios = np.array([damping.modal_ratio(mode) for mode in range(n)])
    C = np.zeros((n + 1, n + 1))
    C[1:, 1:] = np.diag(2.0 * ratios * basis.natural_frequencies * mass)
    C[1:, 1:] += (damping.viscous + damping.air) * basis.strip_overlap
    C[1:, 1:] += damping.internal * basis.bending_stiffness
    C[0, 0] = damping.air * parameters.length
    C[0, 1:] = C[1:, 0] = damping.air * basis.strip_integral
    # The rigid motion has no frequency of its own: it meets the air as the first mode does.
    root = np.sqrt(basis.air_damping)
    C[1:, 1:] += np.outer(root, root) * basis.strip_overlap
    C[0, 0] += basis.air_damping[0] * parameters.length
    C[0, 1:] += root[0] * root * basis.strip_integral
    C[1:, 0] = C[0, 1:]
    F = np.zeros(n + 1)
    F[0] = 1.0
    return GalerkinMatrices(M, C, K, F)
