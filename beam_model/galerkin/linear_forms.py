"""The model as a state space, and from there as poles and residues, zeros-poles-gain or polynomials.

Four inputs: the hub's acceleration, velocity or position (prescribed motion), or a force on the free hub. With
q'' + C q' + K q = -Gamma alpha'' - c alpha' the states are chosen so that no input is differentiated:

- acceleration: q, q' and, where absolute displacements are asked for, alpha' and alpha.
- velocity v: q and y = q' + Gamma v.
- position: g = q + Gamma alpha and y = g' - (C Gamma - c) alpha; the response is biproper.
- force: thesis eq. (2.41).

What the left-out modes add, -R(z) alpha'', can be written down for acceleration and force alone: a state space
driven by position or velocity would have to differentiate its input.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg

from beam_model.arrays import AnyArray, ComplexArray, FloatArray
from beam_model.errors import BeamModelError, BeamParameterError

if TYPE_CHECKING:
    from beam_model.galerkin.model import BeamModel

HubInput = Literal["acceleration", "velocity", "position", "force"]

_UNITS = {"acceleration": "m/s^2", "velocity": "m/s", "position": "m", "force": "N"}
_DERIVATIVES = {"displacement": 0, "deflection": 0, "slope": 1, "curvature": 2}


@dataclass(frozen=True)
class PoleResidueForm:
    """H_j(s) = sum_k residues[k, j]/(s - poles[k]) + integrator[j]/s + double_integrator[j]/s^2 + direct[j].

    Attributes
    ----------
    poles : ndarray of complex, shape (n_poles,)
        All of them, conjugates included, but for those at the origin [rad/s].
    residues : ndarray of complex, shape (n_poles, n_outputs)
    integrator, double_integrator, direct : ndarray, shape (n_outputs,)
    """

    poles: ComplexArray
    residues: ComplexArray
    integrator: FloatArray
    double_integrator: FloatArray
    direct: FloatArray

    def frequency_response(self, omegas: ArrayLike) -> ComplexArray:
        """Return H at omega [rad/s], shape (n_frequencies, n_outputs)."""
        s = 1j * np.atleast_1d(np.asarray(omegas, dtype=np.float64))[:, None]
        elastic = (1.0 / (s - self.poles[None, :])) @ self.residues
        return np.asarray(elastic + self.integrator / s + self.double_integrator / s**2 + self.direct)


@dataclass(frozen=True)
class ZerosPolesGain:
    """H(s) = gain prod(s - zeros) / prod(s - poles), one input and one output."""

    zeros: ComplexArray
    poles: ComplexArray
    gain: float

    def polynomials(self) -> tuple[FloatArray, FloatArray]:
        """Return numerator and denominator, highest power first.

        Notes
        -----
        Coefficients of ten modes span more orders of magnitude than a float has digits; poles and zeros, or
        residues, keep their accuracy at any order.
        """
        return np.real(self.gain * np.poly(self.zeros)), np.real(np.poly(self.poles))

    def to_scipy(self) -> Any:
        """Return a ``scipy.signal.ZerosPolesGain``."""
        from scipy import signal

        return signal.ZerosPolesGain(self.zeros, self.poles, self.gain)


@dataclass(frozen=True)
class StateSpace:
    """X' = A X + B u, y = C X + D u with one input.

    Attributes
    ----------
    A : ndarray, shape (n, n)
    B : ndarray, shape (n,)
    C : ndarray, shape (n_outputs, n)
    D : ndarray, shape (n_outputs,)
    input_name, input_unit : str
        What u is.
    output_names : tuple of str
        What the outputs are.
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    input_name: str
    input_unit: str
    output_names: tuple[str, ...]

    def frequency_response(self, omegas: ArrayLike) -> ComplexArray:
        """Return H at omega [rad/s], shape (n_frequencies, n_outputs)."""
        s = 1j * np.atleast_1d(np.asarray(omegas, dtype=np.float64))
        states = np.linalg.solve(s[:, None, None] * np.eye(self.B.size) - self.A, self.B[None, :, None])
        return np.asarray(states[:, :, 0] @ self.C.T + self.D)

    def pole_residue_form(self) -> PoleResidueForm:
        """Return poles and residues of every output."""
        # Positions and rates differ by the frequencies' size: scaled alike, the solver keeps more digits.
        balanced, scale = linalg.matrix_balance(self.A, permute=False, separate=False)
        values, left, right = linalg.eig(balanced, left=True, right=True)
        right, left = scale @ right, left / np.diag(scale)[:, None]
        is_elastic = np.abs(values) > _origin_radius(values)
        values, left, right = values[is_elastic], left[:, is_elastic], right[:, is_elastic]
        left = left / np.conj(np.einsum("ik,ik->k", left.conj(), right))
        residues = (self.C @ right).T * (left.conj().T @ self.B)[:, None]
        order = np.lexsort((values.imag < 0.0, np.abs(values.imag), np.abs(values).round(9)))
        # What the elastic poles leave over is the chain of integrators at the origin.
        at_origin = np.zeros(self.B.size)
        if not np.all(is_elastic):
            at_origin = self.B - (right @ (left.conj().T @ self.B)).real
        return PoleResidueForm(
            np.asarray(values[order]),
            np.asarray(residues[order]),
            self.C @ at_origin,
            self.C @ (self.A @ at_origin),
            self.D.copy(),
        )

    def zeros_poles_gain(self, output: int = 0) -> ZerosPolesGain:
        """Return the transfer function to one output; zeros from the pencil [[A, B], [C, D]]."""
        c, d = self.C[output], float(self.D[output])
        values = np.linalg.eigvals(self.A)
        poles = np.where(np.abs(values) > _origin_radius(values), values, 0.0)
        size = self.B.size
        # Rows and columns are scaled so that the pencil's infinite zeros stay apart from its finite ones.
        scale = max(1.0, float(np.median(np.abs(values))))
        pencil = np.zeros((size + 1, size + 1))
        pencil[:size, :size] = self.A / scale
        pencil[:size, size] = self.B / max(np.abs(self.B).max(), 1e-300)
        pencil[size, :size] = c / max(np.abs(c).max(), 1e-300)
        pencil[size, size] = d * scale / (max(np.abs(self.B).max(), 1e-300) * max(np.abs(c).max(), 1e-300))
        alpha, beta = linalg.eigvals(pencil, np.diag([1.0] * size + [0.0]), homogeneous_eigvals=True)
        is_finite = np.abs(beta) * 1e6 * max(1.0, float(np.abs(values).max()) / scale) > np.abs(alpha)
        zeros = scale * alpha[is_finite] / beta[is_finite]
        zeros = np.where(np.abs(zeros) > _origin_radius(values), zeros, 0.0)
        # The gain from one point away from all poles and zeros.
        probe = 1.7 * float(np.max(np.abs(poles)))
        at_probe = c @ np.linalg.solve(probe * np.eye(size) - self.A, self.B) + d
        log_ratio = np.sum(np.log(probe - poles.astype(complex))) - np.sum(
            np.log(probe - zeros.astype(complex))
        )
        gain = float((at_probe * np.exp(log_ratio)).real)
        return ZerosPolesGain(np.asarray(zeros), np.asarray(poles, dtype=np.complex128), gain)

    def to_scipy(self) -> Any:
        """Return a ``scipy.signal.StateSpace``."""
        from scipy import signal

        return signal.StateSpace(self.A, self.B[:, None], self.C, self.D[:, None])

    def to_control(self) -> Any:
        """Return a python-control ``StateSpace`` with named input and outputs.

        Raises
        ------
        BeamModelError
            If python-control is not installed.
        """
        try:
            import control  # type: ignore[import-not-found,import-untyped,unused-ignore]
        except ImportError as err:
            raise BeamModelError("python-control is not installed: `pip install control` brings it") from err
        return control.ss(
            self.A,
            self.B[:, None],
            self.C,
            self.D[:, None],
            inputs=[self.input_name],
            outputs=list(self.output_names),
        )


def _origin_radius(values: AnyArray) -> float:
    # A double pole at the origin splits by the square root of rounding; elastic poles are far outside.
    return 1e-5 * float(np.max(np.abs(values), initial=0.0))


def state_space(
    model: BeamModel,
    heights: ArrayLike,
    hub_input: HubInput = "acceleration",
    quantity: str = "displacement",
    with_residuals: bool | None = None,
) -> StateSpace:
    """Return the model from one input to outputs at ``heights``.

    Parameters
    ----------
    model : BeamModel
    heights : array_like, shape (n_heights,)
        Above the clamp [m].
    hub_input : {"acceleration", "velocity", "position", "force"}
    quantity : {"displacement", "deflection", "slope", "curvature", "hub"}
        As in ``BeamModel.frequency_response``.
    with_residuals : bool, optional
        Whether the left-out modes are added statically; by default where that is possible.

    Raises
    ------
    BeamParameterError
        If an argument is out of range or residuals are asked for under position or velocity.
    """
    if hub_input not in _UNITS:
        raise BeamParameterError("hub_input", hub_input, "", f"one of {', '.join(_UNITS)}")
    if quantity not in (*_DERIVATIVES, "hub"):
        raise BeamParameterError("quantity", quantity, "", f"one of {', '.join([*_DERIVATIVES, 'hub'])}")
    is_proper = hub_input in ("acceleration", "force")
    if with_residuals and not is_proper:
        raise BeamParameterError(
            "with_residuals",
            with_residuals,
            "",
            f"False for the hub's {hub_input} as input: -R alpha'' would differentiate it",
            "Drive the model by acceleration.",
        )
    add_residuals = is_proper if with_residuals is None else bool(with_residuals)
    z = model.parameters.check_heights(np.atleast_1d(np.asarray(heights, dtype=np.float64)))
    n, eta = model.n_modes, model.parameters.damping.internal
    if quantity == "hub":
        shape, R = np.zeros((len(z), n)), np.zeros(len(z))
    else:
        shape = model.shape(z, _DERIVATIVES[quantity])
        R = model.residual_terms(z, _DERIVATIVES[quantity]) if add_residuals else np.zeros(len(z))
    hub = 1.0 if quantity in ("displacement", "hub") else 0.0
    names = tuple(f"{quantity}_{round(1000.0 * height):03d}" for height in z)
    build = {
        "acceleration": _from_acceleration,
        "velocity": _from_velocity,
        "position": _from_position,
        "force": _from_force,
    }[hub_input]
    A, B, C, D, acceleration_row, acceleration_gain = build(model, shape, hub)
    # The acceleration that the left-out modes follow, as a row over the states, behind a lag for eta > 0.
    if add_residuals and eta > 0.0 and np.any(R != 0.0):
        size = B.size
        A = np.block([[A, np.zeros((size, 1))], [acceleration_row[None, :] / eta, np.array([[-1.0 / eta]])]])
        B = np.append(B, acceleration_gain / eta)
        C = np.column_stack([C, -R])
    else:
        C = C - np.outer(R, acceleration_row)
        D = D - R * acceleration_gain
    return StateSpace(A, B, C, D, f"hub_{hub_input}", _UNITS[hub_input], names)


_Parts = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, float]


def _modal(model: BeamModel) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return C, K, Gamma and c of q'' + C q' + K q = -Gamma alpha'' - c alpha'."""
    mass = model.basis.modal_mass
    matrices = model.matrices
    K = np.diag(model.basis.natural_frequencies**2)
    return matrices.C[1:, 1:] / mass, K, model.participation_factors, matrices.C[1:, 0] / mass


def _from_acceleration(model: BeamModel, shape: FloatArray, hub: float) -> _Parts:
    C, K, gamma, c = _modal(model)
    n = gamma.size
    needs_hub = hub != 0.0
    needs_velocity = needs_hub or bool(np.any(c != 0.0))
    size = 2 * n + needs_velocity + needs_hub
    A, B = np.zeros((size, size)), np.zeros(size)
    A[:n, n : 2 * n] = np.eye(n)
    A[n : 2 * n, :n], A[n : 2 * n, n : 2 * n] = -K, -C
    B[n : 2 * n] = -gamma
    output = np.zeros((shape.shape[0], size))
    output[:, :n] = shape
    if needs_velocity:
        A[n : 2 * n, 2 * n] = -c
        B[2 * n] = 1.0
    if needs_hub:
        A[2 * n + 1, 2 * n] = 1.0
        output[:, 2 * n + 1] = hub
    return A, B, output, np.zeros(shape.shape[0]), np.zeros(size), 1.0


def _from_velocity(model: BeamModel, shape: FloatArray, hub: float) -> _Parts:
    C, K, gamma, c = _modal(model)
    n = gamma.size
    needs_hub = hub != 0.0
    size = 2 * n + needs_hub
    A, B = np.zeros((size, size)), np.zeros(size)
    A[:n, n : 2 * n] = np.eye(n)
    A[n : 2 * n, :n], A[n : 2 * n, n : 2 * n] = -K, -C
    B[:n], B[n : 2 * n] = -gamma, C @ gamma - c
    output = np.zeros((shape.shape[0], size))
    output[:, :n] = shape
    if needs_hub:
        B[2 * n] = 1.0
        output[:, 2 * n] = hub
    return A, B, output, np.zeros(shape.shape[0]), np.zeros(size), 0.0


def _from_position(model: BeamModel, shape: FloatArray, hub: float) -> _Parts:
    C, K, gamma, c = _modal(model)
    n = gamma.size
    A, B = np.zeros((2 * n, 2 * n)), np.zeros(2 * n)
    A[:n, n:] = np.eye(n)
    A[n:, :n], A[n:, n:] = -K, -C
    B[:n] = C @ gamma - c
    B[n:] = K @ gamma - C @ B[:n]
    output = np.column_stack([shape, np.zeros_like(shape)])
    return A, B, output, hub - shape @ gamma, np.zeros(2 * n), 0.0


def _from_force(model: BeamModel, shape: FloatArray, hub: float) -> _Parts:
    A, B = model.matrices.state_space()
    n = model.n_modes
    output = np.zeros((shape.shape[0], B.size))
    output[:, 0] = hub
    output[:, 1 : n + 1] = shape
    return A, B, output, np.zeros(shape.shape[0]), A[n + 1].copy(), float(B[n + 1])
