"""What linear theory leaves out: quadratic air drag and the cubic terms of a bent beam.

A beam that bends without stretching also moves along its own axis, by s(z, t) = 1/2 int_0^z w_z^2. Its axial inertia,
its curvature w_zz^2 (1 + w_z^2) and the fall of its weight at fourth order add

    T4 = 1/2 int rho s_t^2,    V4 = 1/2 int EI w_zz^2 w_z^2 - (sign) 1/8 int N w_z^4

(Crespo da Silva and Glynn 1978, planar case), and air resists with 1/2 rho_a C_d b |u_t| u_t per length. With
H(z) = int_0^z phi' phi'^T the axial motion is s = 1/2 q^T H q and its inertia acts on q as
-int rho (q'^T H q' + q^T H q'') H q.

The terms are small, so that steps split: half the exact linear step, their effect on the rates, the other half
(Strang 1968), which errs by the square of the step times their own smallness.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from beam_model.arrays import FloatArray
from beam_model.galerkin.model import BeamModel
from beam_model.galerkin.stepping import MotionStepper
from beam_model.parameters import STANDARD_GRAVITY, check_number


@dataclass(frozen=True)
class AirDrag:
    """Quadratic drag on a strip that moves broadside.

    Parameters
    ----------
    width : float
        b, of the strip across its motion [m].
    coefficient : float
        C_d; 2 for a flat plate broadside.
    density : float
        rho_a of the air [kg/m^3].
    """

    width: float
    coefficient: float = 2.0
    density: float = 1.2

    def __post_init__(self) -> None:
        check_number("drag.width", self.width, "m", above=0.0)
        check_number("drag.coefficient", self.coefficient, "", at_least=0.0)
        check_number("drag.density", self.density, "kg/m^3", at_least=0.0)

    @classmethod
    def for_amplitude(cls, width: float, amplitude: float, density: float = 1.2) -> AirDrag:
        """Return the drag of a plate that swings with this amplitude [m]: C_d = 8 KC^(-1/3), KC = 2 pi a/b.

        Notes
        -----
        Bearman, Downie, Graham and Obasaju (1985): a plate that turns back before its wake has grown is
        resisted far more than in a steady stream, C_d = 2.
        """
        width = check_number("drag.width", width, "m", above=0.0)
        amplitude = check_number("amplitude", amplitude, "m", above=0.0)
        return cls(width, max(2.0, 8.0 * (2.0 * np.pi * amplitude / width) ** (-1.0 / 3.0)), density)

    @property
    def factor(self) -> float:
        """1/2 rho_a C_d b [kg/m^2]."""
        return 0.5 * self.density * self.coefficient * self.width


class NonlinearTerms:
    """Accelerations that drag and geometry add to the linear model's.

    Parameters
    ----------
    model : BeamModel
    drag : AirDrag, optional
        None for a beam in vacuum.
    is_geometric : bool
        Whether the cubic inertia, curvature and weight terms are in.
    """

    def __init__(self, model: BeamModel, drag: AirDrag | None = None, is_geometric: bool = True) -> None:
        parameters = model.parameters
        self._drag = 0.0 if drag is None else drag.factor
        self._is_geometric = is_geometric
        n, L = model.n_modes, parameters.length
        points, weights = np.polynomial.legendre.leggauss(4 * n + 8)
        # Fourth powers of n modes: enough Gauss points for products of four shapes.
        z, self._weights = 0.5 * L * (points + 1.0), 0.5 * L * weights
        self._shape, self._slope, self._curvature = (model.shape(z, k) for k in range(3))
        self._EI, self._sign = parameters.flexural_rigidity, parameters.gravity_sign
        tip_and_masses = [(L, parameters.tip_mass)]
        tip_and_masses += [(mass.height, mass.mass) for mass in parameters.point_masses if mass.mass > 0.0]
        bodies = [(height, mass) for height, mass in tip_and_masses if mass > 0.0]
        self._axial_load = parameters.mass_per_length * STANDARD_GRAVITY * (L - z)
        for height, mass in bodies:
            self._axial_load = self._axial_load + mass * STANDARD_GRAVITY * (z < height)
        # H at the Gauss points and at the bodies, one below the other so that H q is one product; masses beside
        # them, for one sum over both.
        places = np.concatenate([z, [height for height, _ in bodies]])
        H = np.concatenate([_slope_overlap(model, float(place)) for place in places])
        # One product gives all that the terms need of q, another all of q', a third the generalised forces: in a
        # simulator it is the number of NumPy's calls that costs.
        self._n_points = z.size
        self._of_q = np.concatenate([self._slope, self._curvature, H])
        self._of_rates = np.concatenate([self._shape, H])
        self._of_forces = np.concatenate([self._curvature, self._slope, self._shape])
        self._H = H
        self._EI_weights = self._EI * self._weights
        self._load_weights = 0.5 * self._sign * self._axial_load * self._weights
        self._masses = np.concatenate(
            [parameters.mass_per_length * self._weights, [mass for _, mass in bodies]]
        )
        self._M = model.matrices.M

    def accelerations(
        self, q: FloatArray, rates: FloatArray, hub_velocity: float, linear: FloatArray
    ) -> FloatArray:
        """Return what is added to q'' under prescribed hub motion, shape (n,).

        Parameters
        ----------
        q, rates : ndarray, shape (n,)
            Modal coordinates and their rates.
        hub_velocity : float
            alpha' [m/s].
        linear : ndarray, shape (n,)
            q'' of the linear model at this state.
        """
        force, axial_mass = self._forces(q, rates, hub_velocity)
        mass = self._M[1:, 1:]
        if axial_mass is None:
            return np.asarray(force[1:] / self._M[1, 1])
        # (M + M_a) q'' = f_lin + f, with M q''_lin = f_lin: the difference q'' - q''_lin solves (M + M_a) d =
        # f - M_a q''_lin.
        return np.asarray(np.linalg.solve(mass + axial_mass, force[1:] - axial_mass @ linear))

    def accelerations_free(
        self, q: FloatArray, rates: FloatArray, hub_velocity: float, linear: FloatArray
    ) -> FloatArray:
        """Return what is added to [alpha'', q''] with the hub free, shape (1 + n,); ``linear`` likewise."""
        force, axial_mass = self._forces(q, rates, hub_velocity)
        mass = self._M
        if axial_mass is not None:
            mass = mass.copy()
            mass[1:, 1:] += axial_mass
            force[1:] -= axial_mass @ linear[1:]
        return np.asarray(np.linalg.solve(mass, force))

    def potential_energy(self, q: FloatArray) -> float:
        """Return V4 [J]."""
        slope, curvature = self._slope @ q, self._curvature @ q
        bending = 0.5 * self._EI * curvature**2 * slope**2
        return float(self._weights @ (bending - 0.125 * self._sign * self._axial_load * slope**4))

    def kinetic_energy(self, q: FloatArray, rates: FloatArray) -> float:
        """Return T4 [J]."""
        axial = (self._H @ q).reshape(-1, q.size) @ rates
        return float(0.5 * self._masses @ axial**2)

    def _forces(
        self, q: FloatArray, rates: FloatArray, hub_velocity: float
    ) -> tuple[FloatArray, FloatArray | None]:
        """Return generalised forces on [alpha, q] and the mass that axial motion adds to q."""
        n, m = q.size, self._n_points
        force = np.zeros(n + 1)
        by_rates = self._of_rates @ rates
        velocity = hub_velocity + by_rates[:m]
        drag = -self._drag * self._weights * np.abs(velocity) * velocity
        force[0] = drag.sum()
        if not self._is_geometric:
            force[1:] = drag @ self._shape
            return force, None
        by_q = self._of_q @ q
        slope, curvature, axial = by_q[:m], by_q[m : 2 * m], by_q[2 * m :].reshape(-1, n)
        # Minus the derivative of V4 by q, through the curvature and through the slope.
        bending = -self._EI_weights * curvature * slope
        by_slope = bending * curvature + self._load_weights * slope * slope * slope
        force[1:] = np.concatenate([bending * slope, by_slope, drag]) @ self._of_forces
        # From T4 with s = q^T H q / 2: s_tt = q'^T H q' + q^T H q''. The first part is a force, the second
        # the mass M_a.
        weighed = self._masses[:, None] * axial
        force[1:] -= (by_rates[m:].reshape(-1, n) @ rates) @ weighed
        return force, axial.T @ weighed


def _slope_overlap(model: BeamModel, height: float) -> FloatArray:
    """Return int_0^z phi' phi'^T dz, shape (n, n)."""
    points, weights = np.polynomial.legendre.leggauss(4 * model.n_modes + 8)
    slope = model.shape(0.5 * height * (points + 1.0), 1)
    return np.asarray(slope.T @ (0.5 * height * weights[:, None] * slope))


class NonlinearMotionStepper:
    """The beam with drag and cubic terms under a prescribed hub acceleration; the interface of ``MotionStepper``.

    Parameters
    ----------
    model : BeamModel
    period : float
        From tick to tick [s].
    terms : NonlinearTerms
    substeps : int
        Splitting steps within a tick.
    """

    def __init__(self, model: BeamModel, period: float, terms: NonlinearTerms, substeps: int = 1) -> None:
        check_number("substeps", substeps, "", at_least=1)
        self.period = check_number("period", period, "s", above=0.0)
        self._substeps = int(substeps)
        self._half: MotionStepper = model.motion_stepper(0.5 * self.period / self._substeps)
        self._terms = terms
        self._n = model.n_modes
        mass = model.basis.modal_mass
        self._C, self._K = model.matrices.C / mass, model.basis.natural_frequencies**2
        self._gain = model.participation_factors
        self.hub_velocity = 0.0

    @property
    def state(self) -> FloatArray:
        """Coordinates q and rates q', shape (2 n,); a view."""
        return self._half.state

    @state.setter
    def state(self, value: FloatArray) -> None:
        self._half.state = value

    def reset(self) -> None:
        """Put the beam at rest, straight, on a still hub."""
        self._half.reset()
        self.hub_velocity = 0.0

    def step(self, acceleration: float) -> None:
        """Advance one tick under a hub acceleration held over it [m/s^2]."""
        h = self._half.period
        for _ in range(self._substeps):
            self._half.step(acceleration)
            self.hub_velocity += acceleration * h
            # Strang's splitting: half a linear step, the nonlinear terms over the whole, half a linear step.
            self._disturb(2.0 * h, acceleration)
            self._half.step(acceleration)
            self.hub_velocity += acceleration * h

    def kick(self, delta_velocity: float) -> None:
        """Change the hub's velocity at once [m/s]."""
        self._half.kick(delta_velocity)
        self.hub_velocity += delta_velocity

    def coordinates(self, tau: float | FloatArray, acceleration: float) -> FloatArray:
        """Return q at ``tau`` into the tick, shape (n,) or (n_tau, n).

        The linear motion is exact; what drag and geometry add is taken as constant over the tick.
        """
        taus = np.atleast_1d(np.asarray(tau, dtype=np.float64))
        q, rates = self.state[: self._n], self.state[self._n :]
        extra = self._extra(q, rates, acceleration)
        found = self._half.coordinates(taus, acceleration) + 0.5 * taus[:, None] ** 2 * extra
        return np.asarray(found[0] if np.ndim(tau) == 0 else found)

    def residual_acceleration(self, tau: float | FloatArray, acceleration: float) -> FloatArray:
        """Return what the left-out modes follow [m/s^2]; see ``MotionStepper``."""
        return self._half.residual_acceleration(tau, acceleration)

    def run(self, accelerations: FloatArray) -> FloatArray:
        """Return q and q' at every tick, shape (n_samples + 1, 2 n), the present state first."""
        values = np.asarray(accelerations, dtype=np.float64).ravel()
        result = np.empty((values.size + 1, 2 * self._n))
        result[0] = self.state
        for index, value in enumerate(values.tolist()):
            self.step(value)
            result[index + 1] = self.state
        return result

    def _extra(self, q: FloatArray, rates: FloatArray, acceleration: float) -> FloatArray:
        resisted = self._C[1:, 1:] @ rates + self._C[1:, 0] * self.hub_velocity
        linear = -self._K * q - resisted - self._gain * acceleration
        return self._terms.accelerations(q, rates, self.hub_velocity, linear)

    def _disturb(self, duration: float, acceleration: float) -> None:
        """Change the rates by the nonlinear terms over ``duration``, by the midpoint rule."""
        q, rates = self.state[: self._n], self.state[self._n :]
        middle = rates + 0.5 * duration * self._extra(q, rates, acceleration)
        rates += duration * self._extra(q, middle, acceleration)
