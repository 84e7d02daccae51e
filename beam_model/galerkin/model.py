"""The model of a beam on a moving hub: its modes, residues, frequency responses and steppers.

Displacements are u(z, t) = alpha(t) + w(z, t) (thesis eq. (2.1)): alpha is the hub's position, w the elastic
deflection, both positive along +x of the rig. Two drives:

- motion: alpha is prescribed; the poles are those of the clamped beam.
- force: f acts on the hub, which is free; a rigid-body mode and shifted frequencies, and the clamped modes
  are zeros of f -> alpha.
"""

from __future__ import annotations

from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from beam_model.arrays import ComplexArray, FloatArray
from beam_model.errors import BeamParameterError
from beam_model.frequency_response import FrequencyResponse
from beam_model.galerkin.matrices import GalerkinMatrices, ModalBasis, assemble
from beam_model.galerkin.stepping import ForceStepper, MotionStepper
from beam_model.parameters import BeamParameters

Drive = Literal["motion", "force"]
Quantity = Literal["displacement", "deflection", "slope", "curvature", "hub"]

MAX_MODES = 100
_DERIVATIVES = {"displacement": 0, "deflection": 0, "slope": 1, "curvature": 2}


class BeamModel:
    """A beam on a moving hub with its first clamped modes; the modes above follow statically.

    Parameters
    ----------
    parameters : BeamParameters
        The rig.
    n_modes : int
        How many modes move dynamically, 1 to 100.

    Attributes
    ----------
    parameters : BeamParameters
    n_modes : int
    basis : ModalBasis
        The undamped clamped modes, scaled to the modal mass m_b.
    matrices : GalerkinMatrices
        M, C, K, F of thesis eq. (2.40).

    Raises
    ------
    BeamParameterError
        If ``n_modes`` is out of range or an upright beam buckles.

    Examples
    --------
    >>> rig = BeamParameters.from_section(0.30, 0.025, 0.0005, 7850.0, 200e9, hub_mass=0.8, gravity="upright")
    >>> (BeamModel(rig, n_modes=2).natural_frequencies / (2 * np.pi)).round(3)
    array([ 4.384, 28.262])
    """

    def __init__(self, parameters: BeamParameters, n_modes: int = 5) -> None:
        is_integer = isinstance(n_modes, (int, np.integer)) and not isinstance(n_modes, bool)
        if not is_integer or not 1 <= n_modes <= MAX_MODES:
            raise BeamParameterError(
                "n_modes",
                n_modes,
                "",
                f"a whole number from 1 to {MAX_MODES}",
                "Five modes reach 257 Hz on the default rig.",
            )
        self.parameters = parameters
        self.n_modes = int(n_modes)
        self.basis = ModalBasis(parameters, self.n_modes)
        self.matrices: GalerkinMatrices = assemble(parameters, self.basis)

    @cached_property
    def is_proportional(self) -> bool:
        """Whether damping leaves the clamped modes uncoupled, so that residues are real."""
        C = self.matrices.C[1:, 1:]
        diagonal = np.sqrt(np.maximum(np.diag(C), 0.0))
        return bool(np.all(np.abs(C - np.diag(np.diag(C))) <= 1e-9 * np.outer(diagonal, diagonal)))

    @cached_property
    def poles(self) -> ComplexArray:
        """Poles of the clamped beam with positive imaginary part, lowest first, shape (n_modes,) [rad/s]."""
        C = self.matrices.C[1:, 1:] / self.basis.modal_mass
        omega = self.basis.natural_frequencies
        ratio = np.diag(C) / (2.0 * omega)
        uncoupled = omega * (-ratio + 1j * np.sqrt(np.asarray(1.0 - ratio**2, dtype=np.complex128)))
        if self.is_proportional:
            return np.asarray(uncoupled, dtype=np.complex128)
        eigenvalues = np.linalg.eigvals(_companion(omega, C))
        oscillating = eigenvalues[eigenvalues.imag > 0.0]
        if oscillating.size != omega.size:
            # Modes damped beyond oscillation have no frequency of their own; the diagonal stands for them.
            return np.asarray(uncoupled, dtype=np.complex128)
        return np.asarray(oscillating[np.argsort(np.abs(oscillating))], dtype=np.complex128)

    @cached_property
    def natural_frequencies(self) -> FloatArray:
        """Natural frequencies of the clamped beam, |pole|, shape (n_modes,) [rad/s]."""
        return self.basis.natural_frequencies if self.is_proportional else np.abs(self.poles)

    @cached_property
    def damping_ratios(self) -> FloatArray:
        """Damping ratios of the clamped beam, shape (n_modes,)."""
        if self.is_proportional:
            diagonal = np.diag(self.matrices.C)[1:] / self.basis.modal_mass
            return np.asarray(diagonal / (2.0 * self.basis.natural_frequencies), dtype=np.float64)
        return np.asarray(-self.poles.real / np.abs(self.poles), dtype=np.float64)

    @cached_property
    def free_hub_poles(self) -> ComplexArray:
        """Elastic poles of the free hub, positive imaginary part, lowest first, shape (n_modes,) [rad/s]."""
        A, _ = self.matrices.state_space()
        scale = self._force_scale()
        eigenvalues = np.linalg.eigvals(A * scale[:, None] / scale[None, :])
        eigenvalues = eigenvalues[np.argsort(np.abs(eigenvalues))][2:]
        oscillating = eigenvalues[eigenvalues.imag > 0.0]
        return np.asarray(oscillating, dtype=np.complex128)

    @cached_property
    def free_hub_natural_frequencies(self) -> FloatArray:
        """Natural frequencies of the elastic modes with the hub free [rad/s]."""
        return np.abs(self.free_hub_poles)

    @cached_property
    def free_hub_damping_ratios(self) -> FloatArray:
        """Damping ratios of the elastic modes with the hub free; they follow from the clamped ones."""
        return np.asarray(-self.free_hub_poles.real / np.abs(self.free_hub_poles), dtype=np.float64)

    @cached_property
    def participation_factors(self) -> FloatArray:
        """Gamma_i = E_i / m_b: how strongly the hub's acceleration drives each mode, shape (n_modes,)."""
        return self.basis.participation / self.basis.modal_mass

    @cached_property
    def effective_mass_fractions(self) -> FloatArray:
        """Share of the beam's mass that each clamped mode carries along x; all modes together sum to 1."""
        return np.asarray(self.participation_factors**2, dtype=np.float64)

    def shape(self, heights: ArrayLike, derivative: int = 0) -> FloatArray:
        """Return the mode shapes, shape (n_heights, n_modes): w = shape @ q and its derivatives along z.

        Parameters
        ----------
        heights : array_like, shape (n_heights,)
            Above the clamp [m].
        derivative : int
            0: deflection, 1: slope, 2: curvature [1/m^2], 3: its derivative.
        """
        return self.basis.shape(self._check(heights), derivative)

    def motion_residues(self, heights: ArrayLike, derivative: int = 0) -> FloatArray:
        """Return r, shape (n_heights, n_modes), of the response to hub motion.

        Notes
        -----
        w_j = -s^2 [sum_i r_ij/(s^2 + 2 zeta_i omega_i s + omega_i^2) + R_j] alpha with
        r_ij = phi_i(z_j) E_i/m_b and R_j from ``residual_terms``. Exact where ``is_proportional``. Air damping
        turns s^2 into s^2 + (xi_a/rho) s, and coupled damping makes the residues complex;
        ``frequency_response`` has both.
        """
        return self.shape(heights, derivative) * self.participation_factors

    def residual_terms(self, heights: ArrayLike, derivative: int = 0) -> FloatArray:
        """Return R, shape (n_heights,) [s^2]: what the left-out modes add, statically, per hub acceleration.

        Notes
        -----
        R = S - sum_i r_i/omega_i^2 with the static shape S under a lasting acceleration. With internal
        damping eta the term is R/(1 + eta s).
        """
        heights = self._check(heights)
        compliance = self.participation_factors / self.basis.natural_frequencies**2
        kept = self.basis.shape(heights, derivative) @ compliance
        return np.asarray(self.basis.static_shape(heights, derivative) - kept, dtype=np.float64)

    def frequency_response(
        self,
        omegas: ArrayLike,
        heights: ArrayLike,
        drive: Drive = "motion",
        quantity: Quantity = "displacement",
        *,
        with_residuals: bool = True,
    ) -> FrequencyResponse:
        """Return the response at ``heights`` to the hub's position (motion) or to a force on the hub.

        Parameters
        ----------
        omegas : array_like, shape (n_frequencies,)
            omega [rad/s].
        heights : array_like, shape (n_heights,)
            Above the clamp [m].
        drive : {"motion", "force"}
            What goes in: alpha [m] or f [N].
        quantity : {"displacement", "deflection", "slope", "curvature", "hub"}
            What comes out: u, w, dw/dz, d^2w/dz^2 (bending strain is half the thickness times it) or alpha.
        with_residuals : bool
            Whether the left-out modes are added statically.
        """
        if drive not in ("motion", "force"):
            raise BeamParameterError("drive", drive, "", '"motion" or "force"')
        if quantity not in (*_DERIVATIVES, "hub"):
            raise BeamParameterError("quantity", quantity, "", f"one of {', '.join([*_DERIVATIVES, 'hub'])}")
        omega = np.atleast_1d(np.asarray(omegas, dtype=np.float64))
        heights = self._check(heights)
        s = 1j * omega
        M, C, K = self.matrices.M, self.matrices.C, self.matrices.K
        dynamic = s[:, None, None] ** 2 * M[1:, 1:] + s[:, None, None] * C[1:, 1:] + K[1:, 1:]
        coupling = s[:, None] ** 2 * M[1:, 0] + s[:, None] * C[1:, 0]
        q = -np.linalg.solve(dynamic, coupling[:, :, None])[:, :, 0]
        lag = 1.0 + self.parameters.damping.internal * s
        if quantity == "hub":
            per_hub = np.ones((omega.size, heights.size), dtype=np.complex128)
        else:
            derivative = _DERIVATIVES[quantity]
            per_hub = q @ self.basis.shape(heights, derivative).T
            if with_residuals:
                per_hub = per_hub - (s**2 / lag)[:, None] * self.residual_terms(heights, derivative)[None, :]
            if quantity == "displacement":
                per_hub = 1.0 + per_hub
        if drive == "force":
            reaction = np.einsum("ki,ki->k", coupling, q)
            impedance = s**2 * M[0, 0] + s * C[0, 0] + reaction
            if with_residuals:
                E = self.basis.participation
                kept = float(np.sum(E**2 / self.basis.natural_frequencies**2)) / self.basis.modal_mass
                impedance = impedance - s**4 / lag * (self.basis.static_reaction() - kept)
            per_hub = per_hub / impedance[:, None]
        unit = "m" if drive == "motion" else "N"
        return FrequencyResponse(omega, heights, np.asarray(per_hub, dtype=np.complex128), quantity, unit)

    def motion_stepper(self, period: float) -> MotionStepper:
        """Return an exact stepper for a hub acceleration held over each ``period`` [s]."""
        n = self.n_modes
        damping = self.parameters.damping
        has_velocity, has_lag = damping.air > 0.0, damping.internal > 0.0
        mass = self.basis.modal_mass
        size = 2 * n + has_velocity + has_lag
        A, B = np.zeros((size, size)), np.zeros(size)
        A[: 2 * n, : 2 * n] = _companion(self.basis.natural_frequencies, self.matrices.C[1:, 1:] / mass)
        B[n : 2 * n] = -self.participation_factors
        scale = np.concatenate([self.basis.natural_frequencies, np.ones(size - n)])
        if has_velocity:
            A[n : 2 * n, 2 * n] = -self.matrices.C[1:, 0] / mass
            B[2 * n] = 1.0
        if has_lag:
            A[-1, -1] = -1.0 / damping.internal
            B[-1] = 1.0 / damping.internal
        return MotionStepper(
            A,
            B,
            period,
            scale,
            n_modes=n,
            gain=self.participation_factors,
            has_velocity=has_velocity,
            has_lag=has_lag,
        )

    def force_stepper(self, period: float) -> ForceStepper:
        """Return an exact stepper for a force on the free hub held over each ``period`` [s]."""
        A, B = self.matrices.state_space()
        return ForceStepper(A, B, period, self._force_scale())

    def _force_scale(self) -> FloatArray:
        # The hub's position against its velocity: as a mode of the lowest frequency would compare them.
        lowest = self.basis.natural_frequencies[0]
        return np.concatenate([[lowest], self.basis.natural_frequencies, np.ones(self.n_modes + 1)])

    def _check(self, heights: ArrayLike) -> FloatArray:
        return np.array(self.parameters.check_heights(np.atleast_1d(np.asarray(heights, dtype=np.float64))))


def _companion(omega: FloatArray, C: FloatArray) -> FloatArray:
    """Return the state matrix over [q, q'] of q'' + C q' + omega^2 q = 0."""
    n = omega.size
    A = np.zeros((2 * n, 2 * n))
    A[:n, n:] = np.eye(n)
    A[n:, :n] = -np.diag(omega**2)
    A[n:, n:] = -C
    return A
