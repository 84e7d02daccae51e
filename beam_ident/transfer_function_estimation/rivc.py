"""Transfer functions under noise as it is: the refined instrumental variable method (RIVC), and several records.

Young and Jakeman's refined method (1980; hybrid continuous-time form: Young, Garnier and
Gilson 2008) keeps the system in continuous time and gives the sampled noise a model of its own.
Here that is an autoregression or, at stamps of any spacing, a process in continuous time, as BIC chooses
from the residuals; outliers weigh by Student's t; and every record has a level of its own
(``noise.noise_model``).  Residuals and gradients alike pass through its inverse;
the stationary point of the output error so weighed is RIVC's fixed point, the maximum of the
likelihood.  System and noise take turns until neither moves: their estimates are uncorrelated, so
that a few turns are enough.

Equation numbers are those of docs/transfer-function-equations.md.
"""

from __future__ import annotations

import math

import numpy as np

from beam_ident.numerics.levenberg_marquardt import minimise
from beam_ident.transfer_function_estimation.output_error import OutputErrorProblem
from beam_ident.transfer_function_estimation.srivc import Method, Optimum, srivc

_TURNS = 25  # a few for a colour; weights by the tails settle more slowly
_ITERATIONS = 30  # of a turn
_FORM = 2  # turns in which the form of the noise is chosen: with and without what the model is not known by
LOOKS = 5  # turns in which colour and outliers are found anew
_SETTLED = 0.02  # standard deviations that a turn may still move the system
MAX_TRAVEL = 6.0  # standard deviations by which weights alone may move a coefficient


def under_noise_as_it_is(
    problem: OutputErrorProblem, start: Optimum, method: Method
) -> tuple[OutputErrorProblem, Optimum]:
    """Return an optimum weighed by its noise where that is other than white, else as it was.

    Parameters
    ----------
    problem : OutputErrorProblem
    start : Optimum -- of it
    method : str

    Notes
    -----
    Residuals that hold unmodelled dynamics have a colour too, but weighing by it moves
    the estimate further than noise can (Hausman 1978): then the weights stay equal, and the covariance counts the
    colour.
    """
    shown = problem.reweighed(start.state, as_it_is=True).noise
    if shown is None or shown.is_plain:
        if len(problem.rows) == 1:
            return problem, start
        return refine_with_noise_model(problem, start, method, as_it_is=False)
    plain, equal = problem, start
    if len(problem.rows) > 1:
        plain, equal = refine_with_noise_model(problem, start, method, as_it_is=False)
    plain.scale = equal.state.scale
    reach = np.sqrt(
        np.maximum(np.diag(plain.covariance(equal.state).values)[: len(equal.state.theta)], 1e-300)
    )
    weighed, found = refine_with_noise_model(plain, equal, method, as_it_is=True)
    moved = weighed.converted(found.state, equal.state.scale) - equal.state.theta
    if not found.converged or not np.max(np.abs(moved) / reach) < MAX_TRAVEL:
        plain.reweighed(equal.state, as_it_is=True)  # for its deviance
        return plain, equal
    return weighed, found


def refine_with_noise_model(
    problem: OutputErrorProblem, start: Optimum, method: Method, as_it_is: bool
) -> tuple[OutputErrorProblem, Optimum]:
    """Estimate the system and its noise in turns, from an optimum under noise taken for simpler than it is.

    Parameters
    ----------
    problem : OutputErrorProblem
    start : Optimum
    method : str -- "srivc" takes its turns by instrumental variables, all others by Levenberg-Marquardt
    as_it_is : bool
        Whether the noise of every record has a colour and outliers; a level of every record alone.

    Returns
    -------
    problem, optimum
        The problem in innovations, and the optimum there.
    """
    state, iterations = start.state, start.iterations
    weighed, stays = problem, False
    for turn in range(_TURNS):
        # W of (T.9) from the residuals at the present model, then the model under W. Samples at the brink of the
        # rule for outliers could come and go for ever: what the noise is taken for stays after a few turns.
        stays = stays or turn >= LOOKS
        doubt = weighed.doubt(state) if as_it_is and not stays else None
        near = weighed.noise if turn >= _FORM else None
        weighed = problem.reweighed(state, as_it_is, weighed.noise if stays else None, doubt, near)
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
        noise = weighed.noise
        assert noise is not None
        if size < _SETTLED and noise.is_cautious:
            stays = True
        elif size < _SETTLED and (turn or noise.is_plain):  # what is in doubt counts from the second turn on
            return weighed, Optimum(state, found.converged, found.reason, iterations)
    reason = f"system and noise still moved after {_TURNS} turns"
    return weighed, Optimum(state, False, reason, iterations)
