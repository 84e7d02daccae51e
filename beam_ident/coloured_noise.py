"""Transfer functions under coloured noise: the refined instrumental variable method (RIVC).

Young and Jakeman's refined method (1980; hybrid continuous-time form: Young, Garnier and
Gilson 2008) keeps the system in continuous time and gives the sampled noise a discrete-time model.
Here that is an autoregression, whose order BIC chooses from the residuals.  Residuals and
gradients alike pass through its inverse; the stationary point of the output error so
weighed is RIVC's fixed point, the maximum of the likelihood.  System and noise take
turns until neither moves: their estimates are uncorrelated, so that a few turns are enough.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.signal import lfilter

from beam_ident.errors import EstimationError
from beam_ident.levenberg_marquardt import minimise
from beam_ident.linear_solution import LinearSolution
from beam_ident.noise_correlation import autoregression
from beam_ident.output_error import OutputErrorProblem, OutputErrorState
from beam_ident.piecewise import FloatArray
from beam_ident.refined_instruments import Optimum

_TURNS = 6
_ITERATIONS = 30  # of a turn
_SETTLED = 0.02  # standard deviations that a turn may still move the system
_OFF_GRID = 1e-3  # of a period


class Whitening:
    """The inverse of an autoregression, exact from the first sample of every run on.

    Parameters
    ----------
    coefficients : ndarray, shape (order + 1,) -- 1, c_1 .. c_p
    times_s : ndarray, shape (n,)
        Stamps on a regular grid [s]; where some are missing a new run begins.

    Raises
    ------
    EstimationError
        Stamps off a regular grid: an autoregression knows neighbours only.

    Notes
    -----
    The first samples of a run are predicted by autoregressions of lower order, from the
    backward Levinson recursion, and weighed by the variances of those predictions; so the weighed sum
    of squares is that of the exact likelihood, without samples lost.
    """

    def __init__(self, coefficients: FloatArray, times_s: FloatArray) -> None:
        steps = np.diff(times_s)
        period = float(np.median(steps))
        off = float(np.max(np.abs(steps / period - np.round(steps / period))))
        if off > _OFF_GRID:
            raise EstimationError(
                f"the stamps leave a regular grid by {off:.2g} periods; expected a regular output, in which samples "
                'may be missing, for a model of its noise. Use method="auto", which takes stamps as they are'
            )
        self.coefficients = coefficients
        first = np.flatnonzero(steps > 1.5 * period) + 1
        self._runs = list(zip([0, *first], [*first, len(times_s)], strict=True))
        self._predictors = [coefficients]
        self._weights = [1.0]
        current = coefficients
        while len(current) > 1:
            reflection = current[-1]
            left = 1.0 - reflection**2
            current = ((current - reflection * current[::-1]) / left)[:-1]
            self._predictors.insert(0, current)
            self._weights.insert(0, self._weights[0] * math.sqrt(left))

    def apply(self, columns: FloatArray) -> FloatArray:
        """Return columns of shape (n, ...) as the noise's innovations see them."""
        order = len(self.coefficients) - 1
        if order == 0:
            return columns
        result = np.empty_like(columns)
        for start, end in self._runs:
            run = columns[start:end]
            result[start:end] = lfilter(self.coefficients, [1.0], run, axis=0)
            for k in range(min(order, end - start)):
                result[start + k] = self._weights[k] * (self._predictors[k] @ run[k::-1])
        return result


class PrewhitenedProblem(OutputErrorProblem):
    """An output-error problem whose misfit counts in the noise's innovations.

    A state's ``residuals`` are the innovations; its ``matrix`` stays as it is, so that
    ``values - matrix @ coefficients`` are the residuals in their colour.

    Parameters
    ----------
    plain : OutputErrorProblem -- the same problem under white noise
    noise : ndarray -- 1, c_1 .. c_p
    """

    def __init__(self, plain: OutputErrorProblem, noise: FloatArray) -> None:
        super().__init__(
            plain.paths, plain.orders, plain.times, plain.values, plain.exposure, plain.nuisances
        )
        self.noise = noise
        self.whitening = Whitening(noise, plain.times)
        self.scale = plain.scale
        self._innovations = self.whitening.apply(plain.values)

    def state(self, theta: FloatArray, slopes: bool = True) -> OutputErrorState:
        """Evaluate a point; without slopes it can be ranked but not improved."""
        plain = super().state(theta, slopes)
        if not math.isfinite(plain.cost):
            return plain
        matrix = self.whitening.apply(plain.matrix)
        solution = LinearSolution.of(matrix)
        coefficients = solution.coefficients(self._innovations)
        residuals = self._innovations - matrix @ coefficients
        half = 0.5 * len(self.values)
        rss, plain_rss = float(residuals @ residuals), float(plain.residuals @ plain.residuals)
        cost = plain.cost + half * (math.log(rss + self.floor) - math.log(plain_rss + self.floor))
        return replace(plain, cost=cost, coefficients=coefficients, residuals=residuals, solution=solution)

    def jacobian(self, state: OutputErrorState) -> FloatArray:
        """Return the gradient of the innovations' model by theta, in scaled units."""
        return self.whitening.apply(super().jacobian(state))


def coloured_residuals(problem: OutputErrorProblem, state: OutputErrorState) -> FloatArray:
    """Return what a state leaves of the output, whatever it is weighed by."""
    return np.asarray(problem.values - state.matrix @ state.coefficients)


def refine_with_noise_model(
    problem: OutputErrorProblem, start: Optimum
) -> tuple[OutputErrorProblem, Optimum]:
    """Estimate the system and its noise's autoregression in turns, from the optimum under white noise.

    Parameters
    ----------
    problem : OutputErrorProblem -- at regular stamps
    start : Optimum -- under white noise

    Returns
    -------
    problem, optimum
        The problem in innovations, and the optimum there.

    Raises
    ------
    EstimationError
        Irregular stamps.
    """
    state, iterations = start.state, start.iterations
    whitened = PrewhitenedProblem(problem, np.ones(1))
    for _ in range(_TURNS):
        noise = autoregression(coloured_residuals(problem, state))
        whitened = PrewhitenedProblem(problem, noise)
        whitened.scale = state.scale
        minimum = minimise(whitened, whitened.state(state.theta), _ITERATIONS)
        iterations += minimum.iterations
        if not math.isfinite(minimum.state.cost):
            return whitened, Optimum(state, False, minimum.reason, iterations)
        information, _ = whitened.slope(minimum.state)
        moved = minimum.state.theta - state.theta
        size = math.sqrt(max(float(moved @ information @ moved), 0.0) / len(moved))
        state = minimum.state
        if size < _SETTLED:
            return whitened, Optimum(state, minimum.converged, minimum.reason, iterations)
    reason = f"system and noise still moved after {_TURNS} turns"
    return whitened, Optimum(state, False, reason, iterations)
