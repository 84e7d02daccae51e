"""The hub as a real axis: friction, end stops, a servo loop, and the beam that pulls on it.

Between events the coupled system is linear, so that it is propagated exactly; what is nonlinear, the hub
coming to rest, breaking loose or meeting a stop, is an event whose instant is found within the step. Steps
therefore carry no integration error, and halving the tick changes nothing but the controller's own sampling.

States of the hub: *moving* in one direction against Coulomb friction, or *held*, by friction or a stop, while
the beam goes on vibrating on it.

Equation numbers are those of docs/beam-model.md.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq

from beam_model.arrays import FloatArray
from beam_model.errors import BeamModelError, BeamParameterError
from beam_model.galerkin.model import BeamModel
from beam_model.galerkin.stepping import HubAndBeam, LinearStepper
from beam_model.parameters import check_number

_MAX_EVENTS = 200
# Slower than this the hub counts as at rest [m/s]: a picometre per millisecond.
_STILL = 1e-9


@dataclass(frozen=True)
class HubFriction:
    """What resists the hub on its guide.

    Parameters
    ----------
    coulomb : float
        Dry friction [N], against any motion, and up to which the hub stays where it is.
    viscous : float
        [N s/m].
    """

    coulomb: float = 0.0
    viscous: float = 0.0

    def __post_init__(self) -> None:
        check_number("friction.coulomb", self.coulomb, "N", at_least=0.0)
        check_number("friction.viscous", self.viscous, "N s/m", at_least=0.0)


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
    """

    proportional: float
    derivative: float
    integral: float = 0.0
    max_force: float = float("inf")

    def __post_init__(self) -> None:
        check_number("servo.proportional", self.proportional, "N/m", above=0.0)
        check_number("servo.derivative", self.derivative, "N s/m", at_least=0.0)
        check_number("servo.integral", self.integral, "N/(m s)", at_least=0.0)
        check_number("servo.max_force", self.max_force, "N", above=0.0, allow_infinite=True)


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

    Attributes
    ----------
    state : ndarray, shape (2 + 2 n,)
        alpha, q, alpha', q'; may be written to between steps while the hub moves.
    is_held : bool
        Whether friction or a stop holds the hub.
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
    ) -> None:
        self.period = check_number("period", period, "s", above=0.0)
        self._friction = HubFriction() if friction is None else friction
        self._stops, self._servo = stops, servo
        self._n = n = model.n_modes
        matrices = model.matrices
        C = matrices.C.copy()
        C[0, 0] += self._friction.viscous
        matrices = replace(matrices, C=C)
        self._M, self._C = matrices.M, C
        self._modal_K = np.diag(matrices.K)[1:]
        frequencies = model.basis.natural_frequencies
        A, B = matrices.state_space()
        scale = np.concatenate([[frequencies[0]], frequencies, np.ones(n + 1)])
        self._moving = LinearStepper(A, B, self.period, scale)
        self._rows = A[n + 1], float(B[n + 1])
        # The beam on a still hub: its clamped modes, coupled by damping at most.
        held = np.zeros((2 * n, 2 * n))
        held[:n, n:] = np.eye(n)
        held[n:, :n] = -np.diag(frequencies**2)
        held[n:, n:] = -C[1:, 1:] / model.basis.modal_mass
        self._held = LinearStepper(
            held, np.zeros(2 * n), self.period, np.concatenate([frequencies, np.ones(n)])
        )
        # A blow on the hub changes all rates: M (x'+ - x'-) = F p.
        self._blow = np.linalg.solve(matrices.M, matrices.F)
        self.state: FloatArray = np.zeros(2 * n + 2)
        self.is_held = self._friction.coulomb > 0.0
        self._direction = 1.0
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

    def step(self, force: float) -> None:
        """Advance one tick under a force on the hub held over it [N]."""
        self.state, self.is_held, self._direction = self._advance(self.period, force)

    def step_servo(self, position: float, velocity: float = 0.0) -> float:
        """Let the servo see the hub, advance one tick under its force and return that force [N].

        Parameters
        ----------
        position, velocity : float
            Reference of the hub at this tick [m], [m/s].

        Raises
        ------
        BeamModelError
            If the stepper was made without a servo.
        """
        servo = self._servo
        if servo is None:
            raise BeamModelError("this axis has no servo: make the AxisStepper with servo=PositionServo(...)")
        error = position - self.position
        wanted = servo.proportional * error + servo.derivative * (velocity - self.velocity) + self._integral
        self.force = float(np.clip(wanted, -servo.max_force, servo.max_force))
        # Anti-windup: what a saturated force cannot do is not added up.
        if self.force == wanted:
            self._integral += servo.integral * error * self.period
        self.step(self.force)
        return self.force

    def motion(self, tau: float, force: float) -> HubAndBeam:
        """Return hub and beam ``tau`` seconds into the tick, without a change of state."""
        state, is_held, direction = self._advance(check_number("tau", tau, "s", at_least=0.0), force)
        acceleration = 0.0
        if not is_held:
            row, gain = self._rows
            acceleration = float(row @ state + gain * (force - direction * self._friction.coulomb))
        n = self._n
        return HubAndBeam(state[0], state[n + 1], np.asarray(acceleration), state[1 : n + 1])

    def _advance(self, duration: float, force: float) -> tuple[FloatArray, bool, float]:
        """Return state, whether it is held and its direction after ``duration``, event by event."""
        state, is_held, direction, left = self.state.copy(), self.is_held, self._direction, duration
        for _ in range(_MAX_EVENTS):
            if is_held:
                state, spent = self._until_release(state, force, left)
                if spent == left and not self._is_released(state, force):
                    return state, True, direction
                is_held = False
                direction = self._push(state, force)
            else:
                state, spent, event = self._until_event(state, force, direction, left)
                if event == "none":
                    return state, False, direction
                if event == "stop":
                    state = self._after_blow(state)
                velocity = state[self._n + 1]
                if abs(velocity) > _STILL:
                    direction = float(np.sign(velocity))
                else:
                    state[self._n + 1] = 0.0
                    is_held = not self._is_released(state, force)
                    direction = direction if is_held else self._push(state, force)
            left -= spent
        # A hub that rattles without end within one tick has come to rest for every purpose.
        state[self._n + 1] = 0.0
        return self._held_flow(state)(left), True, direction

    def _until_release(self, state: FloatArray, force: float, left: float) -> tuple[FloatArray, float]:
        """Return the state at the hub's release, or after ``left``, and the time that it took."""
        if self._is_released(state, force):
            return state, 0.0
        flow = self._held_flow(state)
        end = flow(left)
        if not self._is_released(end, force):
            return end, left
        # Exact in time: the flow is closed, only its root is found numerically.
        instant = _first_zero(lambda t: self._release_margin(flow(t), force), left)
        return flow(instant), instant

    def _until_event(
        self, state: FloatArray, force: float, direction: float, left: float
    ) -> tuple[FloatArray, float, str]:
        """Return the state at the next "rest" or "stop", or after ``left`` ("none"), and the time that it took."""
        n = self._n
        flow = self._moving_flow(state, force - direction * self._friction.coulomb)
        instant, event, end = left, "none", flow(left)
        # Without dry friction the velocity changes its sign freely, and coming to rest is no event.
        if self._friction.coulomb > 0.0 and direction * end[n + 1] < 0.0:
            instant, event = _first_zero(lambda t: direction * flow(t)[n + 1], left), "rest"
            end = flow(instant)
            end[n + 1] = 0.0
        if self._stops is not None:
            for limit, side in ((self._stops.upper, 1.0), (self._stops.lower, -1.0)):
                if side * (end[0] - limit) > 0.0 and side * end[n + 1] >= 0.0:
                    instant, event = self._first_contact(flow, limit, side, instant), "stop"
                    end = flow(instant)
        return end, instant, event

    @staticmethod
    def _first_contact(flow: Callable[[float], FloatArray], limit: float, side: float, end: float) -> float:
        return _first_zero(lambda t: side * (limit - flow(t)[0]), end)

    def _push(self, state: FloatArray, force: float) -> float:
        """Return which way the hub moves from rest."""
        return -1.0 if force < self._holding_force(state) else 1.0

    def _held_flow(self, state: FloatArray) -> Callable[[float], FloatArray]:
        n = self._n

        def flow(t: float) -> FloatArray:
            result = np.zeros_like(state)
            result[0] = state[0]
            modal = self._held.propagate(np.concatenate([state[1 : n + 1], state[n + 2 :]]), t, 0.0)
            result[1 : n + 1], result[n + 2 :] = modal[:n], modal[n:]
            return result

        return flow

    def _moving_flow(self, state: FloatArray, force: float) -> Callable[[float], FloatArray]:
        return lambda t: self._moving.propagate(state, t, force)

    def _holding_force(self, state: FloatArray) -> float:
        """Return the force that keeps a resting hub at rest against the beam's pull [N]."""
        q, rates = state[1 : self._n + 1], state[self._n + 2 :]
        # (B.6).
        accelerations = -(self._C[1:, 1:] @ rates + self._modal_K * q) / self._M[1, 1]
        return float(self._M[0, 1:] @ accelerations + self._C[0, 1:] @ rates)

    def _release_margin(self, state: FloatArray, force: float) -> float:
        """Return by how much friction and stops still hold the hub [N]; negative: released."""
        net = force - self._holding_force(state)
        # A stop holds against any push into it, friction against |f - f_h| up to Coulomb's.
        margin = self._friction.coulomb - abs(net)
        if self._stops is not None:
            at_upper = state[0] >= self._stops.upper - 1e-12
            at_lower = state[0] <= self._stops.lower + 1e-12
            if at_upper:
                margin = max(margin, net + self._friction.coulomb)
            if at_lower:
                margin = max(margin, -net + self._friction.coulomb)
        return margin

    def _is_released(self, state: FloatArray, force: float) -> bool:
        return self._release_margin(state, force) < 0.0

    def _after_blow(self, state: FloatArray) -> FloatArray:
        """Return the state after the hub has struck a stop: its velocity turns, the beam's rates take the jolt."""
        assert self._stops is not None
        n = self._n
        state = state.copy()
        state[0] = np.clip(state[0], self._stops.lower, self._stops.upper)
        # (B.7): the impulse that turns the hub's velocity, shared out by M^-1 F.
        change = -(1.0 + self._stops.restitution) * state[n + 1]
        rates = state[n + 1 :] + self._blow / self._blow[0] * change
        state[n + 1 :] = rates
        return state


def _first_zero(margin: Callable[[float], float], end: float) -> float:
    """Return the instant at which a margin, positive at 0 and negative at ``end``, passes zero."""
    if margin(0.0) <= 0.0 or margin(end) >= 0.0:
        return 0.0
    return float(brentq(margin, 0.0, end, xtol=1e-15, rtol=1e-14))
