"""Where a delay may lie: the profile of an equation error over a wide range, at half-sample steps.

Behind a state-variable filter (:mod:`beam_ident.state_variable_filter`) the filtered input enters the
regression shifted by the delay, and everything that the normal equations need at *all* shifts
is a correlation, which the fast Fourier transform gives at once.  What remains is one
small system for every delay.  The minima of the profiles behind several filters are the candidates;
which of them is right is decided by the output error.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from beam_ident.linear_solution import LinearSolution
from beam_ident.output_error import OutputErrorProblem
from beam_ident.piecewise import FloatArray, Instants
from beam_ident.rational_response import RationalResponse, upper_roots
from beam_ident.state_variable_filter import filter_coefficients, filtered_output

_STEPS_PER_SAMPLE = 2
_LONGEST = 0.25  # of the record
_REACH = 4.0  # standard deviations of a prior
_SWEEPS = 2  # over the inputs, where several have unknown delays
_CANDIDATES = 4


def delay_candidates(problem: OutputErrorProblem, cutoffs: list[float]) -> list[FloatArray]:
    """Return sets of delays to start from, one entry for every free delay, the most promising first.

    Parameters
    ----------
    problem : OutputErrorProblem -- of one denominator, with at least one free delay
    cutoffs : list of float -- of the state-variable filters [rad/s]
    """
    ranges = [_range(problem, k) for k in problem.free_delays]
    present = np.array([float(np.clip(0.0, low, high)) for low, high in ranges])
    best: list[float] = [present[0]]
    for _ in range(_SWEEPS if len(ranges) > 1 else 1):
        for place, (low, high) in enumerate(ranges):
            best = _ranked_minima(problem, cutoffs, present, place, low, high)
            present[place] = best[0]
    last = len(ranges) - 1
    return [np.concatenate([present[:last], [delay]]) for delay in best]


def _range(problem: OutputErrorProblem, path: int) -> tuple[float, float]:
    prior = problem.paths[path].delay
    longest = _LONGEST * problem.length
    if math.isinf(prior.sd):
        return 0.0, longest
    low = max(prior.mean - _REACH * prior.sd, 0.0)
    return low, min(max(prior.mean + _REACH * prior.sd, low + problem.period), longest)


def _ranked_minima(
    problem: OutputErrorProblem,
    cutoffs: list[float],
    present: FloatArray,
    place: int,
    low: float,
    high: float,
) -> list[float]:
    """Return local minima of one delay's profiles [s], the deepest (relative to their filter's level) first."""
    found: list[tuple[float, float]] = []
    for cutoff in cutoffs:
        delays, cost = delay_profile(problem, cutoff, present, place, low, high)
        if not len(cost):
            continue
        level = float(np.median(cost))
        padded = np.concatenate([[math.inf], cost, [math.inf]])
        minima = np.flatnonzero((padded[1:-1] <= padded[:-2]) & (padded[1:-1] <= padded[2:]))
        minima = minima[np.argsort(cost[minima])][:2]
        found += [(float(cost[i]) - level, float(delays[i])) for i in minima]
    found.sort()
    chosen: list[float] = []
    for _, delay in found:
        if all(abs(delay - other) > 1.5 * problem.period for other in chosen):
            chosen.append(delay)
    return chosen[:_CANDIDATES] or [low]


def delay_profile(
    problem: OutputErrorProblem, cutoff: float, present: FloatArray, place: int, low: float, high: float
) -> tuple[FloatArray, FloatArray]:
    """Return delays and the cost of the filtered equation at each of them.

    Parameters
    ----------
    problem : OutputErrorProblem
    cutoff : float -- of the filter [rad/s]
    present : ndarray -- the free delays, of which all but one stay [s]
    place : int -- which free delay is varied
    low, high : float -- range [s]

    Returns
    -------
    delays, cost : ndarray, shape (n_steps,) -- [s], and half the log-likelihood's scale ``n/2 log rss``
    """
    problem.scale = cutoff
    varied = problem.free_delays[place]
    coefficients = filter_coefficients(problem.n_a)
    upper = upper_roots(np.concatenate([[1.0], coefficients]))
    step = problem.period / _STEPS_PER_SAMPLE
    n = int(problem.length / step) + 1
    grid = problem.times[0] + step * np.arange(n)
    outputs = filtered_output(problem, upper, Instants.on(problem.measured, grid, 0.0))
    at_grid = Instants.on(problem.measured, grid, 0.0)
    target = at_grid.mean(problem.measured, problem.measured_integral)[0] - outputs @ coefficients
    fixed = [outputs]
    every = problem.delays(np.concatenate([coefficients, present]))
    shift = round(low / step) * step
    moving = np.empty((n, 0))
    for k, path in enumerate(problem.paths):
        delay = shift if k == varied else every[k]
        response = path.response(upper, cutoff, grid, problem.exposure, delay, squares=False)
        columns = response.combined(np.eye(path.n_zeros + 1))
        if k == varied:
            moving = columns
        else:
            fixed.append(columns)
    if problem.nuisances.has_offset:
        fixed.append(np.ones((n, 1)))
    if problem.nuisances.has_ramp:
        fixed.append((grid[:, None] - problem.middle) / problem.length)
    if problem.nuisances.has_free_response:
        free = RationalResponse.to_impulse(upper, cutoff, grid - grid[0], 0.0, squares=False)
        fixed.append(free.combined(np.eye(problem.n_a)))
    basis = LinearSolution.of(np.concatenate(fixed, axis=1)).basis
    target = target - basis @ (basis.T @ target)
    n_steps = int((high - shift) / step) + 1
    explained = _explained(moving, basis, target, n_steps)
    rss = np.maximum(float(target @ target) - explained, problem.floor)
    return np.asarray(shift + step * np.arange(n_steps)), 0.5 * n / _STEPS_PER_SAMPLE * np.log(rss)


def _explained(moving: FloatArray, basis: FloatArray, target: FloatArray, n_steps: int) -> FloatArray:
    """Return by how much columns, shifted by 0, 1, .. rows, lower the squares left of a target."""
    n, width = moving.shape
    scales = np.linalg.norm(moving, axis=0)
    moving = moving / np.where(scales > 0.0, scales, 1.0)
    length = next_fast_len(n + n_steps, real=True)
    spectra = np.conj(rfft(moving, length, axis=0))
    against = rfft(np.column_stack([basis, target]), length, axis=0)
    # shifted[l, i, j] = sum_k moving[k, i] against[k + l, j]
    shifted = irfft(spectra[:, :, None] * against[:, None, :], length, axis=0)[:n_steps]
    of_basis, of_target = shifted[:, :, :-1], shifted[:, :, -1]
    products = np.einsum("ki,kj->kij", moving, moving)
    sums = np.concatenate([np.zeros((1, width, width)), np.cumsum(products, axis=0)])
    gram = sums[n - np.arange(n_steps)] - np.einsum("lia,lja->lij", of_basis, of_basis)
    size = np.sqrt(np.maximum(np.einsum("lii->li", gram), 1e-12))
    scaled = gram / (size[:, :, None] * size[:, None, :]) + 1e-9 * np.eye(width)
    right = of_target / size
    return np.asarray(np.einsum("li,li->l", right, np.linalg.solve(scaled, right[:, :, None])[:, :, 0]))
