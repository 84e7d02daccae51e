"""The bounded, monotone Levenberg-Marquardt iteration that all estimators share."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.numerics.linear_least_squares import scaled_solve

_STEP_TOLERANCE = 1e-3  # of a standard deviation: below this nothing visible changes
_COST_TOLERANCE = 1e-7  # in log-likelihood
_TRIALS = 12
_HOPE = 5.0
_IDLE = 1e-4  # in log-likelihood: short steps that lower the cost by less, one after the other, lead nowhere
_IDLE_TURNS = 3
_AT_A_JUMP = 0.5  # in log-likelihood: what a standard deviation from the optimum costs

HOPELESS = "what it can still gain is not worth its parameters"


class Likelihood(Protocol):
    """What the iteration needs to know at one point."""

    @property
    def theta(self) -> FloatArray:
        """The parameters."""

    @property
    def cost(self) -> float:
        """Negative log-likelihood, infinite where the point is not allowed."""


StateT = TypeVar("StateT", bound=Likelihood)


class Problem(Protocol[StateT]):
    """A likelihood with its Gauss-Newton approximation."""

    def state(self, theta: FloatArray) -> StateT:
        """Evaluate a point."""

    def slope(self, state: StateT) -> tuple[FloatArray, FloatArray]:
        """Return the information matrix and the descent direction (minus the gradient)."""

    def limited(self, theta: FloatArray, step: FloatArray) -> FloatArray:
        """Return where a step may lead."""


@dataclass(frozen=True, eq=False)
class Minimum(Generic[StateT]):
    """Where the iteration ended, and why."""

    state: StateT
    converged: bool
    reason: str
    iterations: int


def minimise(
    problem: Problem[StateT], start: StateT, max_iterations: int, target: float = math.inf
) -> Minimum[StateT]:
    """Lower the cost until a step is invisible; never return a worse point than the start.

    Parameters
    ----------
    problem : Problem
    start : state of the problem -- where to begin
    max_iterations : int -- bound on the iterations, each of at most twelve trials
    target : float
        A cost that must be reached to be of use: the iteration gives up once five times what the last
        step has brought, and five times what the quadratic approximation promises, do not reach it.
    """
    state, damping = start, 1e-3
    if not len(start.theta):
        return Minimum(state, True, "nothing nonlinear to estimate", 0)
    if not math.isfinite(start.cost):
        return Minimum(state, False, "the starting point is not allowed", 0)
    fallen, idle = math.inf, 0
    for iteration in range(1, max_iterations + 1):
        information, direction = problem.slope(state)
        if state.cost - _HOPE * fallen > target and (
            state.cost - _HOPE * _promised(information, direction) > target
        ):
            return Minimum(state, False, HOPELESS, iteration)
        fallen, hindrance = -1.0, 0.0
        for _ in range(_TRIALS):
            # H + damping on unit diagonal (Marquardt): short steps along the gradient where the model is not
            # to be trusted.
            candidate = _led_to(problem, state.theta, information, direction, damping)
            taken = candidate - state.theta
            # The step in units of its standard deviation.
            size = math.sqrt(max(float(taken @ information @ taken), 0.0))
            if size < _STEP_TOLERANCE and damping < 1.0:
                return Minimum(state, True, f"step below {_STEP_TOLERANCE} standard deviations", iteration)
            trial = problem.state(candidate)
            if math.isfinite(trial.cost) and trial.cost <= state.cost:
                fallen = state.cost - trial.cost
                state = trial
                hindrance = damping
                damping = max(damping * 0.1, 1e-12)
                break
            damping = max(damping * 10.0, 1e-6)
        if fallen < 0.0:
            # No step helps: at an optimum the promise is nothing, elsewhere the iteration is stuck.
            gain = float(direction @ np.linalg.lstsq(information, direction, rcond=1e-14)[0])
            is_flat = gain < 1e-4 * len(state.theta)
            reason = "no step lowers the cost further" if is_flat else "stalled: no step lowers the cost"
            return Minimum(state, is_flat, reason, iteration)
        if fallen < _COST_TOLERANCE and damping < 1.0:
            return Minimum(state, True, "the cost falls no further", iteration)
        # Where an instant stands at a jump of a held input, the cost jumps as well: only shorter and shorter steps
        # towards it are possible, while all else has settled.
        idle = idle + 1 if fallen < _IDLE and hindrance >= 1.0 else 0
        if idle == _IDLE_TURNS and _promised(*problem.slope(state)) < _AT_A_JUMP:
            reason = "the cost jumps here, less than a standard deviation from its optimum"
            return Minimum(state, True, reason, iteration)
    return Minimum(state, False, f"stopped after {max_iterations} iterations", max_iterations)


def _promised(information: FloatArray, direction: FloatArray) -> float:
    """Return what the quadratic approximation can still lower the cost by: g^T H^-1 g / 2."""
    return 0.5 * float(direction @ scaled_solve(information, direction, 0.0))


def _led_to(
    problem: Problem[StateT],
    theta: FloatArray,
    information: FloatArray,
    direction: FloatArray,
    damping: float,
) -> FloatArray:
    """Return where a damped step leads, the best beside those parameters that stand at their bounds.

    A step that a bound merely cuts short is the best one no more: what goes with the parameter that is cut moves as
    if it were not, and the iteration creeps. So it is held, and the step of the others is found anew.
    """
    free, step = np.ones(len(theta), dtype=bool), scaled_solve(information, direction, damping)
    candidate = problem.limited(theta, step)
    while np.any(stuck := free & (candidate == theta)):
        # What the slope itself drives outwards stays; the others may only follow it there.
        outwards = stuck & (step * direction > 0.0)
        free &= ~(outwards if np.any(outwards) else stuck)
        step = np.zeros(len(theta))
        step[free] = scaled_solve(information[np.ix_(free, free)], direction[free], damping)
        candidate = problem.limited(theta, step)
    return candidate
