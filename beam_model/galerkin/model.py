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
from scipy.optimize import newton

from beam_model.arrays import ComplexArray, FloatArray
from beam_model.errors import BeamParameterError
from beam_model.frequency_response import FrequencyResponse
from beam_model.galerkin.matrices import GalerkinMatrices, ModalBasis, assemble
from beam_model.galerkin.poles import (
    damping_ratios_of,
    eigenvalues_of,
    natural_frequencies_of,
    pole_pairs,
    sorted_by_mode,
)
from beam_model.galerkin.stepping import ForceStepper, MotionStepper
from beam_model.parameters import BeamParameters

Drive = Literal["motion", "force"]
Quantity = Literal["displacement", "deflection", "slope", "curvature", "hub"]

MAX_MODES = 100
_FIRST, _MOST_SUFFICIENT, _TOLERANCE = 5, 20, 1e-4
_DERIVATIVES = {"displacement": 0, "deflection": 0, "slope": 1, "curvature": 2}


class BeamModel:
    """A beam on a moving hub with its first clamped modes; the modes above follow statically.

    Parameters
    ----------
    parameters : BeamParameters
        The rig.
    n_modes : int, optional
        How many modes move dynamically, 1 to 100; by default what the first five need (``sufficient_modes``).

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

    def __init__(self, parameters: BeamParameters, n_modes: int | None = None) -> None:
        if n_modes is None:
            n_modes = sufficient_modes(parameters)
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
    def pole_pairs(self) -> ComplexArray:
        """Both poles of each mode of the clamped beam, lowest mode first, shape (n_modes, 2) [rad/s].

        Notes
        -----
        The pole with positive imaginary part before its conjugate; of a mode that is damped beyond oscillation
        the slower of two real ones before the faster.
        """
        C = self.matrices.C[1:, 1:] / self.basis.modal_mass
        omega = self.basis.natural_frequencies
        uncoupled = pole_pairs(omega, np.diag(C) / (2.0 * omega))
        if self.is_proportional:
            return uncoupled
        inverse = np.block([[-C / omega[:, None] ** 2, -np.diag(omega**-2)], [np.eye(omega.size), 0.0 * C]])
        return sorted_by_mode(eigenvalues_of(_companion(omega, C), inverse), uncoupled)

    @property
    def poles(self) -> ComplexArray:
        """The first of each mode's ``pole_pairs``, shape (n_modes,) [rad/s]."""
        return self.pole_pairs[:, 0]

    @cached_property
    def natural_frequencies(self) -> FloatArray:
        """Natural frequencies of the clamped beam: sqrt of each mode's product of poles, (n_modes,) [rad/s]."""
        return (
            self.basis.natural_frequencies
            if self.is_proportional
            else natural_frequencies_of(self.pole_pairs)
        )

    @cached_property
    def damping_ratios(self) -> FloatArray:
        """Damping ratios of the clamped beam, shape (n_modes,); modes with 1 and more do not oscillate."""
        if self.is_proportional:
            diagonal = np.diag(self.matrices.C)[1:] / self.basis.modal_mass
            return np.asarray(diagonal / (2.0 * self.basis.natural_frequencies), dtype=np.float64)
        return damping_ratios_of(self.pole_pairs)

    @cached_property
    def free_hub_pole_pairs(self) -> ComplexArray:
        """Both poles of each elastic mode with the hub free, shape (n_modes, 2) [rad/s]; as ``pole_pairs``.

        Notes
        -----
        Eigenvalues of thesis eq. (2.41), each then led to the zero of the hub's impedance with the left-out modes
        in it, where ``frequency_response`` has its poles. That mends the highest modes on a light hub.
        """
        eigenvalues = eigenvalues_of(*self.matrices.elastic_states())
        modal = self.matrices.modal_parameters()
        omega, rates = modal.natural_frequencies[1:], np.diag(modal.dampings)
        is_resisted = self.matrices.resists_hub
        # The hub's own, beside 0, where nothing holds it: what the air does to it.
        hub = (-float(rates[0]),) if is_resisted else ()
        pairs = sorted_by_mode(eigenvalues, pole_pairs(omega, rates[1:] / (2.0 * omega)), hub)
        return np.array(
            [
                (
                    zero := self._led_to_zero(first, eigenvalues),
                    zero.conjugate() if first.imag else self._led_to_zero(second, eigenvalues),
                )
                for first, second in pairs
            ]
        )

    def _led_to_zero(self, pole: complex, eigenvalues: ComplexArray) -> complex:
        """Return the zero of the hub's impedance next to an eigenvalue."""

        def residual(s: complex) -> complex:
            return complex(self._hub_impedance(np.array([s]), with_residuals=True)[0] / s**2)

        apart = np.abs(eigenvalues - pole)
        reach = 0.5 * float(np.min(apart[apart > 0.0], initial=abs(pole)))
        found, report = newton(residual, pole, tol=1e-13 * abs(pole), full_output=True, disp=False)
        # Where poles lie together the way may lead to another one's: the eigenvalue then stands.
        is_own = bool(report.converged) and abs(found - pole) < reach
        return complex(found) if is_own else complex(pole)

    @property
    def free_hub_poles(self) -> ComplexArray:
        """The first of each mode's ``free_hub_pole_pairs``, shape (n_modes,) [rad/s]."""
        return self.free_hub_pole_pairs[:, 0]

    @cached_property
    def free_hub_natural_frequencies(self) -> FloatArray:
        """Natural frequencies of the elastic modes with the hub free, shape (n_modes,) [rad/s]."""
        return natural_frequencies_of(self.free_hub_pole_pairs)

    @cached_property
    def free_hub_damping_ratios(self) -> FloatArray:
        """Damping ratios of the elastic modes with the hub free; they follow from the clamped ones."""
        return damping_ratios_of(self.free_hub_pole_pairs)

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
        s = np.asarray(1j * omega, dtype=np.complex128)
        if quantity == "hub":
            per_hub = np.ones((omega.size, heights.size), dtype=np.complex128)
        else:
            derivative = _DERIVATIVES[quantity]
            per_hub = self._coordinates(s)[0] @ self.basis.shape(heights, derivative).T
            if with_residuals:
                lag = 1.0 + self.parameters.damping.internal * s
                per_hub = per_hub - (s**2 / lag)[:, None] * self.residual_terms(heights, derivative)[None, :]
            if quantity == "displacement":
                per_hub = 1.0 + per_hub
        if drive == "force":
            per_hub = per_hub / self._hub_impedance(s, with_residuals=with_residuals)[:, None]
        unit = "m" if drive == "motion" else "N"
        return FrequencyResponse(omega, heights, np.asarray(per_hub, dtype=np.complex128), quantity, unit)

    def _coordinates(self, s: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        """Return q per hub position and what couples them, each of shape (n_points, n_modes)."""
        M, C, K = self.matrices.M, self.matrices.C, self.matrices.K
        dynamic = s[:, None, None] ** 2 * M[1:, 1:] + s[:, None, None] * C[1:, 1:] + K[1:, 1:]
        coupling = s[:, None] ** 2 * M[1:, 0] + s[:, None] * C[1:, 0]
        q = -np.linalg.solve(dynamic, coupling[:, :, None])[:, :, 0]
        return np.asarray(q, dtype=np.complex128), np.asarray(coupling, dtype=np.complex128)

    def _hub_impedance(self, s: ComplexArray, *, with_residuals: bool) -> ComplexArray:
        """Return the force that it takes per hub position [N/m], shape (n_points,)."""
        M, C = self.matrices.M, self.matrices.C
        q, coupling = self._coordinates(s)
        impedance = s**2 * M[0, 0] + s * C[0, 0] + np.einsum("ki,ki->k", coupling, q)
        if with_residuals:
            E = self.basis.participation
            kept = float(np.sum(E**2 / self.basis.natural_frequencies**2)) / self.basis.modal_mass
            lag = 1.0 + self.parameters.damping.internal * s
            impedance = impedance - s**4 / lag * (self.basis.static_reaction() - kept)
        return np.asarray(impedance, dtype=np.complex128)

    def motion_stepper(self, period: float) -> MotionStepper:
        """Return an exact stepper for a hub acceleration held over each ``period`` [s]."""
        n = self.n_modes
        damping = self.parameters.damping
        has_velocity, has_lag = self.matrices.resists_hub, damping.internal > 0.0
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


def sufficient_modes(parameters: BeamParameters) -> int:
    """Return how many modes put the first five poles of the free hub within a ten-thousandth of their frequency.

    Parameters
    ----------
    parameters : BeamParameters

    Returns
    -------
    int
        5, 10 or 20: the smallest of them that differs from twice as many modes by less; on a hub so light that
        20 do not reach it, 20.

    Notes
    -----
    Modes of the clamped beam describe one on a light hub badly: at a sixth of the strip's mass, five of them err by
    0.1 % in the fifth frequency. Twice as many err about a hundred times less, so that the difference is the error.
    """
    model = BeamModel(parameters, _FIRST)
    while model.n_modes < _MOST_SUFFICIENT:
        finer = BeamModel(parameters, 2 * model.n_modes)
        error = np.abs(model.free_hub_pole_pairs[:_FIRST] - finer.free_hub_pole_pairs[:_FIRST])
        if np.all(error <= _TOLERANCE * np.abs(finer.free_hub_pole_pairs[:_FIRST])):
            break
        model = finer
    return model.n_modes


def _companion(omega: FloatArray, C: FloatArray) -> FloatArray:
    """Return the state matrix over [q, q'] of q'' + C q' + omega^2 q = 0."""
    n = omega.size
    A = np.zeros((2 * n, 2 * n))
    A[:n, n:] = np.eye(n)
    A[n:, :n] = -np.diag(omega**2)
    A[n:, n:] = -C
    return A
