"""Where a delay may lie: the profile of an equation error over a wide range, at half-sample steps.

Behind a state-variable filter (``transfer_function_estimation.state_variable_filter``) the filtered input enters the
regression shifted by the delay, and everything that the normal equations need at *all* shifts
is a correlation, which the fast Fourier transform gives at once.  What remains is one
small system for every delay.  The minima of the profiles behind several filters are the candidates;
which of them is right is decided by the output error.

Equation numbers are those of docs/transfer-function-equations.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from beam_ident.arrays import ComplexArray, FloatArray
from beam_ident.numerics.linear_least_squares import LinearSolution
from beam_ident.numerics.piecewise import Instants
from beam_ident.numerics.rational_response import RationalResponse, upper_roots
from beam_ident.transfer_function_estimation.output_error import OutputErrorProblem
from beam_ident.transfer_function_estimation.state_variable_filter import (
    filter_coefficients,
    filtered_derivatives,
    filtered_output,
)

_STEPS_PER_SAMPLE = 2
_MAX_DELAY = 0.25  # of the shortest record
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
    # Several unknown delays take turns, each searched at the best values of the others.
    for _ in range(_SWEEPS if len(ranges) > 1 else 1):
        for place, (low, high) in enumerate(ranges):
            best = _ranked_minima(problem, cutoffs, present, place, low, high)
            present[place] = best[0]
    last = len(ranges) - 1
    return [np.concatenate([present[:last], [delay]]) for delay in best]


def _range(problem: OutputErrorProblem, path: int) -> tuple[float, float]:
    prior = problem.paths[path].delay
    longest = _MAX_DELAY * problem.shortest
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
        # Filters pass different amounts of noise: minima are compared by their depth below their own profile.
        level = float(np.median(cost))
        padded = np.concatenate([[math.inf], cost, [math.inf]])
        minima = np.flatnonzero((padded[1:-1] <= padded[:-2]) & (padded[1:-1] <= padded[2:]))
        minima = minima[np.argsort(cost[minima])][:2]
        found += [(float(cost[i]) - level, float(delays[i])) for i in minima]
    found.sort()
    chosen: list[float] = []
    for _, delay in found:
        # Profiles of several filters show the same minimum at neighbouring steps.
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
    every = problem.delays(np.concatenate([coefficients, present]))
    step = problem.period / _STEPS_PER_SAMPLE
    shift = round(low / step) * step
    shares = _shares(problem, coefficients, every, varied, step, shift)
    n_nuisances = problem.n_nuisances * len(shares)
    fixed = []
    for record, share in enumerate(shares):
        own = np.zeros((len(share.target), n_nuisances))
        first = record * problem.n_nuisances
        own[:, first : first + problem.n_nuisances] = share.nuisances
        fixed.append(np.concatenate([share.shared, own], axis=1))
    # Q of (T.11), of everything that does not move with this delay.
    unmoved = LinearSolution.of(np.concatenate(fixed))
    target = unmoved.left_of(np.concatenate([share.target for share in shares]))
    ends = np.cumsum([len(share.target) for share in shares])[:-1]
    parts = list(
        zip(
            [share.moving for share in shares],
            np.split(unmoved.basis, ends),
            np.split(target, ends),
            strict=True,
        )
    )
    n_steps = int((high - shift) / step) + 1
    # (T.11) for all delays at once; rows at half samples are twice as many as independent samples.
    rss = np.maximum(float(target @ target) - _explained(parts, n_steps), problem.floor)
    return (
        np.asarray(shift + step * np.arange(n_steps)),
        0.5 * len(target) / _STEPS_PER_SAMPLE * np.log(rss),
    )


@dataclass(frozen=True, eq=False)
class _Share:
    """One record's rows of the filtered equation, on a grid of half samples, in units of its noise.

    Attributes
    ----------
    target : ndarray, shape (n,)
    moving : ndarray, shape (n, n_moving) -- the columns of the input whose delay is varied
    shared : ndarray, shape (n, n_shared) -- those of the output and of the other inputs
    nuisances : ndarray, shape (n, n_nuisances)
    """

    target: FloatArray
    moving: FloatArray
    shared: FloatArray
    nuisances: FloatArray


def _shares(
    problem: OutputErrorProblem,
    coefficients: FloatArray,
    delays: FloatArray,
    varied: int,
    step: float,
    shift: float,
) -> list[_Share]:
    """Return the rows of every record, with the varied path at its least delay."""
    upper: ComplexArray = upper_roots(np.concatenate([[1.0], coefficients]))
    levels = np.ones(len(problem.experiments)) if problem.noise is None else problem.noise.levels
    shares = []
    for own, level in zip(problem.experiments, levels, strict=True):
        grid = np.asarray(own.times[0] + step * np.arange(int(own.length / step) + 1), dtype=np.float64)
        at_grid = Instants.on(own.measured, grid, 0.0)
        outputs = filtered_derivatives(filtered_output(own, upper, problem.scale, at_grid))
        values = at_grid.mean(own.measured)[0]
        moving, shared = np.empty((len(grid), 0)), [outputs]
        for k, path in enumerate(own.paths):
            delay = shift if k == varied else delays[k]
            response = path.response(upper, problem.scale, grid, own.exposure, delay, squares=False)
            columns = response.combined(np.eye(path.n_zeros + 1))
            if k == varied:
                moving = columns
            else:
                shared.append(columns)
        nuisances = [column[:, None] for column in own.drifts(problem.nuisances, grid)]
        if problem.nuisances.has_free_response:
            free = RationalResponse.to_impulse(upper, problem.scale, grid - grid[0], 0.0, squares=False)
            nuisances.append(free.combined(np.eye(problem.n_a)))
        shares.append(
            _Share(
                # The target of (T.6); the outputs' own columns stand with the shared ones.
                (values - outputs @ coefficients) / level,
                moving / level,
                np.concatenate(shared, axis=1) / level,
                np.concatenate([np.empty((len(grid), 0)), *nuisances], axis=1) / level,
            )
        )
    return shares


def _explained(parts: list[tuple[FloatArray, FloatArray, FloatArray]], n_steps: int) -> FloatArray:
    """Return by how much columns, shifted by 0, 1, .. rows in every record, lower the squares left of a target.

    Parameters
    ----------
    parts : list of (moving, basis, target) -- of every record, shapes (n, n_moving), (n, n_basis) and (n,)
    n_steps : int
    """
    width = parts[0][0].shape[1]
    squares = np.sum([np.sum(moving**2, axis=0) for moving, _, _ in parts], axis=0)
    scales = np.where(squares > 0.0, np.sqrt(squares), 1.0)
    gram = np.zeros((n_steps, width, width))
    of_basis = np.zeros((n_steps, width, parts[0][1].shape[1]))
    of_target = np.zeros((n_steps, width))
    for moving, basis, target in parts:
        n = len(moving)
        scaled = moving / scales
        length = next_fast_len(n + n_steps, real=True)
        # Correlations over all shifts at once; padded so that none wraps around.
        spectra = np.conj(rfft(scaled, length, axis=0))
        against = rfft(np.column_stack([basis, target]), length, axis=0)
        # shifted[l, i, j] = sum_k moving[k, i] against[k + l, j]
        shifted = irfft(spectra[:, :, None] * against[:, None, :], length, axis=0)[:n_steps]
        of_basis += shifted[:, :, :-1]
        of_target += shifted[:, :, -1]
        # U_l^T U_l loses, with every shift, the rows that leave the record at its end.
        products = np.einsum("ki,kj->kij", scaled, scaled)
        sums = np.concatenate([np.zeros((1, width, width)), np.cumsum(products, axis=0)])
        gram += sums[np.maximum(n - np.arange(n_steps), 0)]
    # G_l of (T.11), made of unit diagonal and faintly regularised where a shifted column is nearly one of Q.
    gram -= np.einsum("lia,lja->lij", of_basis, of_basis)
    size = np.sqrt(np.maximum(np.einsum("lii->li", gram), 1e-12))
    unit = gram / (size[:, :, None] * size[:, None, :]) + 1e-9 * np.eye(width)
    right = of_target / size
    return np.asarray(np.einsum("li,li->l", right, np.linalg.solve(unit, right[:, :, None])[:, :, 0]))
