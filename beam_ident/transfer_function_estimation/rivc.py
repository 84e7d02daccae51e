"""Transfer functions under noise as it is: the refined instrumental variable method (RIVC), and several records.

Young and Jakeman's refined method (1980; hybrid continuous-time form: Young, Garnier and
Gilson 2008) keeps the system in continuous time and gives the sampled noise a discrete-time model.
Here that is an autoregression, whose order BIC chooses from the residuals, and for every record a
level of its own (``noise.noise_model``).  Residuals and gradients alike pass through its inverse;
the stationary point of the output error so weighed is RIVC's fixed point, the maximum of the
likelihood.  System and noise take turns until neither moves: their estimates are uncorrelated, so
that a few turns are enough.

Equation numbers are those of docs/transfer-functions.md.
"""

from __future__ import annotations

import math

from beam_ident.numerics.levenberg_marquardt import minimise
from beam_ident.transfer_function_estimation.output_error import OutputErrorProblem
from beam_ident.transfer_function_estimation.srivc import Method, Optimum, srivc

_TURNS = 6
_ITERATIONS = 30  # of a turn
_SETTLED = 0.02  # standard deviations that a turn may still move the system


def refine_with_noise_model(
    problem: OutputErrorProblem, start: Optimum, method: Method
) -> tuple[OutputErrorProblem, Optimum]:
    """Estimate the system and its noise in turns, from an optimum under noise taken for simpler than it is.

    Parameters
    ----------
    problem : OutputErrorProblem -- at regular stamps where the noise is to have a colour
    start : Optimum
    method : str
        "rivc" gives the noise of every record a colour, all others a level; "srivc" takes its turns by
        instrumental variables, all others by Levenberg-Marquardt.

    Returns
    -------
    problem, optimum
        The problem in innovations, and the optimum there.

    Raises
    ------
    EstimationError
        Irregular stamps and a colour.
    """
    state, iterations = start.state, start.iterations
    weighed = problem
    for _ in range(_TURNS):
        # W of (T.9) from the residuals at the present model, then the model under W.
        weighed = problem.reweighed(state, is_coloured=method == "rivc")
        first = weighed.state(state.theta)
        if method == "srivc":
            found = srivc(weighed, first)
        else:
            minimum = minimise(weighed, first, _ITERATIONS)
            found = Optimum(minimum.state, minimum.converged, minimum.reason, minimum.iterations)
        iterations += found.iterations
        if not math.isfinite(found.state.cost):
            return weighed, Optimum(state, False, found.reason, iterations)
        # How far this turn has moved the system, in standard deviations of one parameter.
        information, _ = weighed.slope(found.state)
        moved = found.state.theta - state.theta
        size = math.sqrt(max(float(moved @ information @ moved), 0.0) / len(moved))
        state = found.state
        if size < _SETTLED:
            return weighed, Optimum(state, found.converged, found.reason, iterations)
    reason = f"system and noise still moved after {_TURNS} turns"
    return weighed, Optimum(state, False, reason, iterations)
