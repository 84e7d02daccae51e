"""The hub as a real axis: friction, end stops, a servo loop, and the beam that pulls on it.

Between events the coupled system is linear, so that it is propagated exactly; what is nonlinear, the hub
coming to rest, breaking loose or meeting a stop, is an event whose instant is found within the step, also where
several fall into one. Steps therefore carry no integration error, and halving the tick changes nothing but the
controller's own sampling. Air drag and large deflections, where they are wanted, split each step (``nonlinear.py``).

States of the hub: *moving* in one direction against friction, or *held*, at rest by friction or a stop, while
the beam goes on vibrating on it. The state vector says which: a held hub's velocity is 0 exactly.

Equation numbers are those of docs/beam-equations.md.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from beam_model.arrays import FloatArray
from beam_model.dynamics.nonlinear import NonlinearTerms
from beam_model.dynamics.polynomial_flow import PolynomialFlow, are_positive, first_zero, value_at
from beam_model.errors import BeamModelError, BeamParameterError
from beam_model.galerkin.model import BeamModel
from beam_model.galerkin.stepping import HubAndBeam
from beam_model.parameters import check_number

_MAX_EVENTS = 200
# Slower than this after a blow the hub has come to rest [m/s]: a picometre per millisecond.
_STILL = 1e-9
# So near to a stop the hub touches it [m].
_TOUCH = 1e-12
# A rest of a tick shorter than this share of a piece is rounding.
_NO_TIME = 1e-12


@dataclass(frozen=True)
class HubFriction:
    """What resists the hub on its guide.

    Parameters
    ----------
    coulomb : float
        Dry friction against any motion [N].
    viscous : float
        [N s/m].
    static : float
        Force that breaks the hub loose from rest [N]; 0: Coulomb's. Above it the hub moves by stick and slip.
    coulomb_difference, viscous_difference : float
        By how much more resists motion along +x than motion against it [N], [N s/m]: ``coulomb`` and ``viscous`` are
        the means.
    """

    coulomb: float = 0.0
    viscous: float = 0.0
    static: float = 0.0
    coulomb_difference: float = 0.0
    viscous_difference: float = 0.0

    def __post_init__(self) -> None:
        coulomb = check_number("friction.coulomb", self.coulomb, "N", at_least=0.0)
        viscous = check_number("friction.viscous", self.viscous, "N s/m", at_least=0.0)
        for name, unit, most in (("coulomb", "N", 2.0 * coulomb), ("viscous", "N s/m", 2.0 * viscous)):
            value = getattr(self, f"{name}_difference")
            check_number(f"friction.{name}_difference", value, unit, at_least=-most, at_most=most)
        if check_number("friction.static", self.static, "N", at_least=0.0) != 0.0:
            check_number("friction.static", self.static, "N", at_least=coulomb)

    def dry(self, direction: float) -> float:
        """Return the dry friction against motion along +x (1) or -x (-1) [N]."""
        return self.coulomb + 0.5 * direction * self.coulomb_difference

    def breakaway(self, direction: float) -> float:
        """Return the force in this direction up to which the hub stays where it is [N]."""
        return max(self.static, self.dry(direction))

    @property
    def can_hold(self) -> bool:
        """Whether the hub stays at rest under small forces, at least in one direction."""
        return max(self.static, self.coulomb) > 0.0


@dataclass(frozen=True)
class EndStops:
    """Where the travel ends.

    Parameters
    ----------
    lower, upper : float
        Hub positions [m].
    restitution : float
        Share of the speed that a blow gives back, 0 to 1.
    """

    lower: float
    upper: float
    restitution: float = 0.0

    def __post_init__(self) -> None:
        lower = check_number("stops.lower", self.lower, "m")
        check_number("stops.upper", self.upper, "m", above=lower)
        check_number("stops.restitution", self.restitution, "", at_least=0.0, at_most=1.0)


@dataclass(frozen=True)
class PositionServo:
    """A position controller, run once per tick, whose force is held until the next.

    Parameters
    ----------
    proportional : float
        [N/m].
    derivative : float
        [N s/m], on the velocity error.
    integral : float
        [N/(m s)].
    max_force : float
        Saturation [N]; the integral stops while the force is saturated.
    backlash : float
        Play between drive and hub [m]: within it nothing acts, and either flank can only push.
    """

    proportional: float
    derivative: float
    integral: float = 0.0
    max_force: float = float("inf")
    backlash: float = 0.0

    def __post_init__(self) -> None:
        check_number("servo.proportional", self.proportional, "N/m", above=0.0)
        check_number("servo.derivative", self.derivative, "N s/m", at_least=0.0)
        check_number("servo.integral", self.integral, "N/(m s)", at_least=0.0)
        check_number("servo.max_force", self.max_force, "N", above=0.0, allow_infinite=True)
        check_number("servo.backlash", self.backlash, "m", at_least=0.0)

    def force(self, error: float, velocity_error: float, other: float = 0.0) -> float:
        """Return the force on the hub [N], before saturation.

        Parameters
        ----------
        error, velocity_error : float
            Reference less hub [m], [m/s].
        other : float
            Integral and feed-forward [N].
        """
        play = 0.5 * self.backlash
        if abs(error) < play:
            return 0.0
        side = 1.0 if error > 0.0 else -1.0
        force = self.proportional * (error - side * play) + self.derivative * velocity_error + other
        return force if play == 0.0 or force * side > 0.0 else 0.0


class AxisStepper:
    """Hub and beam under a force or behind a servo, with friction and end stops.

    Parameters
    ----------
    model : BeamModel
    period : float
        From tick to tick [s].
    friction : HubFriction, optional
    stops : EndStops, optional
    servo : PositionServo, optional
        For ``step_servo``.
    terms : NonlinearTerms, optional
        Air drag and large deflections.

    Attributes
    ----------
    state : ndarray, shape (2 + 2 n,)
        alpha, q, alpha', q'; may be written to between steps.
    force : float
        What the servo last asked for [N].
    """

    def __init__(
        self,
        model: BeamModel,
        period: float,
        friction: HubFriction | None = None,
        stops: EndStops | None = None,
        servo: PositionServo | None = None,
        terms: NonlinearTerms | None = None,
    ) -> None:
        self.period = check_number("period", period, "s", above=0.0)
        self._friction = HubFriction() if friction is None else friction
        self._stops, self._servo, self._terms = stops, servo, terms
        self._n = n = model.n_modes
        matrices = model.matrices
        frequencies = model.basis.natural_frequencies
        scale = np.concatenate([[frequencies[0]], frequencies, np.ones(n + 1)])
        self._moving: dict[float, PolynomialFlow] = {}
        self._A: dict[float, FloatArray] = {}
        for direction in (1.0, -1.0):
            C = matrices.C.copy()
            C[0, 0] += self._friction.viscous + 0.5 * direction * self._friction.viscous_difference
            A, B = replace(matrices, C=C).state_space()
            self._moving[direction] = PolynomialFlow(A, B, self.period, scale)
            self._A[direction], self._B = A[n + 1 :], B[n + 1 :]
        self._piece = min(flow.piece for flow in self._moving.values())
        # The beam on a still hub: its clamped modes, coupled by damping at most.
        held = np.zeros((2 * n, 2 * n))
        held[:n, n:] = np.eye(n)
        held[n:, :n] = -np.diag(frequencies**2)
        held[n:, n:] = -C[1:, 1:] / model.basis.modal_mass
        self._held_A = held[n:]
        self._held = PolynomialFlow(
            held, np.zeros(2 * n), self._piece, np.concatenate([frequencies, np.ones(n)])
        )
        self._piece = min(self._piece, self._held.piece)
        # (B.6): the beam's pull on a still hub, from q and q'.
        self._pull = matrices.M[0, 1:] @ held[n:]
        self._pull[n:] += C[0, 1:]
        # A blow on the hub changes all rates: M (x'+ - x'-) = F p.
        blow = np.linalg.solve(matrices.M, matrices.F)
        self._blow = blow / blow[0]
        self.state: FloatArray = np.zeros(2 * n + 2)
        self.force = 0.0
        self._integral = 0.0
        if stops is not None and not stops.lower <= 0.0 <= stops.upper:
            raise BeamParameterError(
                "stops", (stops.lower, stops.upper), "m", "limits on both sides of home, 0 m"
            )

    @property
    def position(self) -> float:
        """Of the hub [m]."""
        return float(self.state[0])

    @property
    def velocity(self) -> float:
        """Of the hub [m/s]."""
        return float(self.state[self._n + 1])

    @property
    def is_held(self) -> bool:
        """Whether friction or a stop holds the hub."""
        return self._rests(self.state)

    def step(self, force: float) -> None:
        """Advance one tick under a force on the hub held over it [N]."""
        self.state = self._after(self.period, force)

    def step_servo(self, position: float, velocity: float = 0.0, feedforward: float = 0.0) -> float:
        """Let the servo see the hub, advance one tick under its force and return that force [N].

        Parameters
        ----------
        position, velocity : float
            Reference of the hub at this tick [m], [m/s].
        feedforward : float
            Force that the reference's acceleration asks for [N].

        Raises
        ------
        BeamModelError
            If the stepper was made without a servo.
        """
        self.force = self.servo_force(position, velocity, feedforward)
        self.step(self.force)
        return self.force

    def servo_force(self, position: float, velocity: float, feedforward: float = 0.0) -> float:
        """Let the servo see the hub, once per tick, and return the force that it holds over it [N].

        Parameters and errors are those of ``step_servo``.
        """
        servo = self._servo
        if servo is None:
            raise BeamModelError("this axis has no servo: make the AxisStepper with servo=PositionServo(...)")
        error = position - self.position
        wanted = servo.force(error, velocity - self.velocity, self._integral + feedforward)
        force = min(max(wanted, -servo.max_force), servo.max_force)
        # Anti-windup: what a saturated force cannot do is not added up.
        if force == wanted:
            self._integral += servo.integral * error * self.period
        return force

    def motion(self, tau: float, force: float) -> HubAndBeam:
        """Return hub and beam ``tau`` seconds into the tick, without a change of state."""
        state = self._after(check_number("tau", tau, "s", at_least=0.0), force)
        n = self._n
        acceleration = float(self._accelerations(state, force)[0])
        return HubAndBeam(state[0], state[n + 1], np.asarray(acceleration), state[1 : n + 1])

    def _after(self, duration: float, force: float) -> FloatArray:
        """Return the state after ``duration``."""
        if self._terms is None:
            return self._advance(self.state.copy(), duration, force)
        # Strang's splitting: half a linear step, the nonlinear terms over the whole, half a linear step.
        state = self._advance(self.state.copy(), 0.5 * duration, force)
        self._disturb(self._terms, state, duration, force)
        return self._advance(state, 0.5 * duration, force)

    def _advance(self, state: FloatArray, duration: float, force: float) -> FloatArray:
        """Return the state after ``duration`` of linear motion, event by event; the given one may be changed."""
        left, n_events, is_loose = duration, 0, False
        while left > _NO_TIME * self._piece:
            span = min(left, self._piece)
            if n_events == _MAX_EVENTS:
                # A hub that rattles without end within one tick has come to rest for every purpose.
                state[self._n + 1] = 0.0
                state, spent = self._on_a_still_hub(state, span), span
            elif not is_loose and self._rests(state) and not self._is_released(state, force):
                state, spent = self._until_release(state, force, span)
                is_loose = spent < span
                n_events += is_loose
            else:
                state, spent = self._until_event(state, force, span, is_loose)
                is_loose = False
                n_events += spent < span
            left -= spent
        return state

    def _rests(self, state: FloatArray) -> bool:
        """Return whether the hub is at rest where something can hold it."""
        if state[self._n + 1] != 0.0:
            return False
        return self._friction.can_hold or any(self._touched(state))

    def _touched(self, state: FloatArray) -> tuple[bool, bool]:
        """Return whether the hub touches the lower and the upper stop."""
        stops = self._stops
        if stops is None:
            return False, False
        return bool(state[0] <= stops.lower + _TOUCH), bool(state[0] >= stops.upper - _TOUCH)

    def _until_release(self, state: FloatArray, force: float, span: float) -> tuple[FloatArray, float]:
        """Return the state at the hub's release, or after ``span``, and the time that it took."""
        coefficients = self._held.coefficients(self._elastic(state), 0.0)
        end = span / self._held.piece
        # By how much friction and stops still hold the hub against a push up and down [N].
        net = -coefficients @ self._pull
        net[0] += force
        lower, upper = self._touched(state)
        instants = []
        for side, is_stopped in ((-1.0, upper), (1.0, lower)):
            if not is_stopped:
                margin = side * net
                margin[0] += self._friction.breakaway(-side)
                instants.append(first_zero(margin, end))
        released = min((s for s in instants if s is not None), default=end)
        return self._with_elastic(state, value_at(coefficients, released)), released * self._held.piece

    def _on_a_still_hub(self, state: FloatArray, span: float) -> FloatArray:
        coefficients = self._held.coefficients(self._elastic(state), 0.0)
        return self._with_elastic(state, value_at(coefficients, span / self._held.piece))

    def _until_event(
        self, state: FloatArray, force: float, span: float, is_loose: bool
    ) -> tuple[FloatArray, float]:
        """Return the state after the hub has come to rest or struck a stop, or after ``span``; and the time.

        A hub that has just broken loose (``is_loose``) cannot be decelerated at that instant: a sign that says so is
        rounding.
        """
        n, direction = self._n, self._direction(state, force)
        moving = self._moving[direction]
        piece = moving.piece
        coefficients = moving.coefficients(state, force - direction * self._friction.dry(direction))
        end = span / piece
        first, side = end, 0.0
        for gap, its_side in self._gaps(coefficients, direction):
            if is_loose and its_side == 0.0:
                gap[1] = max(gap[1], 0.0)
            instant = first_zero(gap, end)
            if instant is not None and instant < first:
                first, side = instant, its_side
        if first == end:
            return value_at(coefficients, end), span
        state = value_at(coefficients, first)
        if side == 0.0:
            state[n + 1] = 0.0
        else:
            self._strike(state, side)
        return state, first * piece

    def _gaps(self, coefficients: FloatArray, direction: float) -> list[tuple[FloatArray, float]]:
        """Return what an event ends when it passes zero: way to a stop, whose side is +-1, or speed, side 0."""
        gaps = []
        if self._friction.can_hold or self._friction.viscous_difference != 0.0:
            # Where friction is the same in both directions, the velocity changes its sign freely: no event.
            gaps.append((direction * coefficients[:, self._n + 1], 0.0))
        if self._stops is not None:
            for limit, side in ((self._stops.upper, 1.0), (self._stops.lower, -1.0)):
                gap = -side * coefficients[:, 0]
                gap[0] += side * limit
                gap[0] = 0.0 if abs(gap[0]) < _TOUCH else gap[0]
                gaps.append((gap, side))
        if gaps and are_positive(np.array([gap for gap, _ in gaps]).T):
            return []
        return gaps

    def _elastic(self, state: FloatArray) -> FloatArray:
        return np.concatenate([state[1 : self._n + 1], state[self._n + 2 :]])

    def _with_elastic(self, state: FloatArray, elastic: FloatArray) -> FloatArray:
        state = state.copy()
        state[1 : self._n + 1], state[self._n + 2 :] = elastic[: self._n], elastic[self._n :]
        return state

    def _net_force(self, state: FloatArray, force: float) -> float:
        """Return what pushes a resting hub: the force less what keeps it at rest against the beam's pull [N]."""
        return force - float(self._pull @ self._elastic(state))

    def _direction(self, state: FloatArray, force: float) -> float:
        """Return which way the hub moves, or will from rest."""
        velocity = state[self._n + 1]
        return float(np.copysign(1.0, velocity if velocity != 0.0 else self._net_force(state, force)))

    def _is_released(self, state: FloatArray, force: float) -> bool:
        """Return whether neither friction nor a stop holds a resting hub; a stop holds against any push into it."""
        net, friction = self._net_force(state, force), self._friction
        lower, upper = self._touched(state)
        return (net > friction.breakaway(1.0) and not upper) or (
            -net > friction.breakaway(-1.0) and not lower
        )

    def _strike(self, state: FloatArray, side: float) -> None:
        """Change the state as a blow on a stop does: the hub's velocity turns, the beam's rates take the jolt."""
        assert self._stops is not None
        n = self._n
        state[0] = self._stops.upper if side > 0.0 else self._stops.lower
        # (B.7): the impulse that turns the hub's velocity, shared out by M^-1 F.
        before = state[n + 1]
        after = -self._stops.restitution * before
        after = 0.0 if abs(after) <= _STILL else after
        state[n + 1 :] += self._blow * (after - before)
        state[n + 1] = after

    def _accelerations(self, state: FloatArray, force: float) -> FloatArray:
        """Return alpha'' and q'' of the linear model, shape (1 + n,)."""
        if self._rests(state) and not self._is_released(state, force):
            return np.concatenate([[0.0], self._held_A @ self._elastic(state)])
        direction = self._direction(state, force)
        driven = force - direction * self._friction.dry(direction)
        return np.asarray(self._A[direction] @ state + self._B * driven)

    def _disturb(self, terms: NonlinearTerms, state: FloatArray, duration: float, force: float) -> None:
        """Change the rates by the nonlinear terms over ``duration``, by the midpoint rule."""
        n = self._n
        linear = self._accelerations(state, force)
        is_still = self._rests(state) and linear[0] == 0.0
        middle = state.copy()
        for at, share in ((state, 0.5), (middle, 1.0)):
            q, rates, velocity = at[1 : n + 1], at[n + 2 :], float(at[n + 1])
            if is_still:
                change = np.concatenate([[0.0], terms.accelerations(q, rates, 0.0, linear[1:])])
            else:
                change = terms.accelerations_free(q, rates, velocity, linear)
            middle[n + 1 :] = state[n + 1 :] + share * duration * change
        state[:] = middle
