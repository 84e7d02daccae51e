"""Several inputs whose denominators are their own: sums of transfer functions.

    y = sum_k B_k(s)/A_k(s) e^(-s T_k) u_k + nuisances + noise

Every input is estimated on what the others leave of the output, in turn (block coordinate
descent as in González et al., arXiv 2401.01263), and Levenberg-Marquardt with the exact joint
gradients goes from there to the joint optimum.  Where its residuals still look like
anything but noise, the inputs have another round.

Equation numbers are those of docs/transfer-function-equations.md.
"""

from __future__ import annotations

import math

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.errors import EstimationError
from beam_ident.noise.scores import Whiteness
from beam_ident.numerics.levenberg_marquardt import minimise
from beam_ident.transfer_function_estimation.output_error import OutputErrorProblem, OutputErrorState
from beam_ident.transfer_function_estimation.srivc import WHITE, Method, Optimum, estimate_denominator

_ROUNDS = 3
_ITERATIONS = 60


def estimate_additive(
    problem: OutputErrorProblem, method: Method, cutoff: float | None = None
) -> tuple[OutputErrorProblem, Optimum]:
    """Estimate a problem in which every input has a denominator of its own.

    Parameters
    ----------
    problem : OutputErrorProblem
    method : str -- of each round; all that go to the optimum have a joint form
    cutoff : float or None -- of the state-variable filters [rad/s]

    Raises
    ------
    EstimationError
        No start is found, or a method that has no joint form.
    """
    if method not in ("auto", "rivc", "white", "output_error"):
        raise EstimationError(
            f"method is {method!r} for denominators of their own; expected 'auto', 'rivc', 'white' or 'output_error'"
        )
    parts = [np.zeros_like(problem.values) for _ in problem.paths]
    orders = [problem.orders[path.block] for path in problem.paths]
    best: tuple[OutputErrorProblem, Optimum] | None = None
    iterations = 0
    for _ in range(_ROUNDS):
        starts_s, found = [float(own.times[0]) for own in problem.experiments], []
        for k in range(len(problem.paths)):
            # Block coordinate descent: input k is estimated on y less what the other inputs explain at
            # present.
            others = np.sum([part for j, part in enumerate(parts) if j != k], axis=0)
            alone = problem.of_values(problem.values - others, (k,))
            solved, optimum = estimate_denominator(alone, method, cutoff, n_finalists=1)
            # A path with an unknown past and a delay drops the first samples; the joint problem drops them
            # for all.
            starts_s = [max(s, float(e.times[0])) for s, e in zip(starts_s, solved.experiments, strict=True)]
            iterations += optimum.iterations
            parts[k] = _share(alone, optimum.state, 0)
            found.append(alone.converted(optimum.state, problem.scale))
        joint = problem.from_stamps(starts_s)
        joint.scale = problem.scale
        start = joint.state(
            np.concatenate(
                # theta of the joint problem: all denominators first, then all free delays.
                [theta[:n] for theta, n in zip(found, orders, strict=True)]
                + [theta[n:] for theta, n in zip(found, orders, strict=True)]
            )
        )
        if not math.isfinite(start.cost):
            continue
        if len(joint.experiments) > 1:
            joint = joint.reweighed(start, as_it_is=False)
            start = joint.state(start.theta)
        # Descent by blocks crawls where inputs are correlated; the joint gradients (T.8) do not.
        minimum = minimise(joint, start, _ITERATIONS)
        iterations += minimum.iterations
        if best is None or minimum.state.cost < best[1].state.cost:
            best = joint, Optimum(minimum.state, minimum.converged, minimum.reason, iterations)
        noise = joint.standardised(minimum.state.residuals)
        if minimum.converged and Whiteness.of(noise).p_value > WHITE:
            break
        # Another round begins at the joint optimum, each input with the residuals that the joint model
        # leaves.
        parts = [_share(problem, minimum.state, k) for k in range(len(problem.paths))]
    if best is None:
        raise EstimationError(
            "the inputs' parts do not join to a stable start; give other degrees, or a longer record"
        )
    return best


def _share(problem: OutputErrorProblem, state: OutputErrorState, path: int) -> FloatArray:
    """Return what one input causes at all stamps of a problem."""
    problem.scale = state.scale
    place = sum(p.n_zeros + 1 for p in problem.paths[:path])
    columns = slice(place, place + problem.paths[path].n_zeros + 1)
    return np.asarray(
        problem.point(state.theta, slopes=False).matrix[:, columns] @ state.coefficients[columns]
    )
