"""Several inputs whose denominators are their own: sums of transfer functions.

    y = sum_k B_k(s)/A_k(s) e^(-s T_k) u_k + nuisances + noise

Every input is estimated on what the others leave of the output, in turn, until the
denominators are in the basin of the joint optimum, to which Levenberg-Marquardt with the exact joint
gradients then goes (block coordinate descent as in González et al., arXiv 2401.01263).
"""

from __future__ import annotations

import math

import numpy as np

from beam_ident.errors import EstimationError
from beam_ident.levenberg_marquardt import minimise
from beam_ident.output_error import OutputErrorProblem
from beam_ident.piecewise import FloatArray
from beam_ident.refined_instruments import Method, Optimum, estimate_denominator

_ROUNDS = 4
_SETTLED = 1.0  # of log-likelihood between two rounds
_ITERATIONS = 60


def estimate_additive(
    problem: OutputErrorProblem, method: Method, cutoff: float | None = None
) -> tuple[OutputErrorProblem, Optimum]:
    """Estimate a problem in which every input has a denominator of its own.

    Parameters
    ----------
    problem : OutputErrorProblem
    method : str -- of each round; the joint optimum is sought with "auto" and "output_error"
    cutoff : float or None -- of the state-variable filters [rad/s]

    Raises
    ------
    EstimationError
        No start is found, or a method that has no joint form.
    """
    if method not in ("auto", "output_error"):
        raise EstimationError(
            f"method is {method!r} for denominators of their own; expected 'auto' or 'output_error'"
        )
    parts: list[FloatArray] = [np.zeros_like(problem.values) for _ in problem.paths]
    thetas: list[FloatArray] = [np.empty(0)] * len(problem.paths)
    cost, iterations = math.inf, 0
    for _ in range(_ROUNDS):
        for k, path in enumerate(problem.paths):
            others = np.sum([part for j, part in enumerate(parts) if j != k], axis=0)
            alone = problem.of_values(problem.values - others, (path,))
            solved, optimum = estimate_denominator(alone, method, cutoff)
            state = optimum.state
            if len(solved.times) < len(alone.times):  # a delay cost samples: explain all of them
                alone.scale = state.scale
                state = alone.state(state.theta)
            iterations += optimum.iterations
            parts[k] = state.matrix[:, : path.n_zeros + 1] @ state.coefficients[: path.n_zeros + 1]
            thetas[k] = alone.converted(state, problem.scale)
        left = problem.values - np.sum(parts, axis=0)
        fallen, cost = cost, 0.5 * len(left) * math.log(max(float(left @ left), problem.floor))
        if fallen - cost < _SETTLED:
            break
    n_alone = [problem.orders[path.block] for path in problem.paths]
    theta = np.concatenate(
        [t[:n] for t, n in zip(thetas, n_alone, strict=True)]
        + [t[n:] for t, n in zip(thetas, n_alone, strict=True)]
    )
    start = problem.state(theta)
    if not math.isfinite(start.cost):
        raise EstimationError(
            "the inputs' parts do not join to a stable start; give other degrees, or more data"
        )
    minimum = minimise(problem, start, _ITERATIONS)
    return problem, Optimum(minimum.state, minimum.converged, minimum.reason, iterations + minimum.iterations)
