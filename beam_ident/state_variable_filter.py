"""The linear regressions behind a state-variable filter.

Behind a filter 1/F(s) the equation ``A y = B u`` holds for the filtered derivatives, and is linear
in the coefficients: ``s^n/F y = -sum_i a_i s^(n-i)/F y + sum_j b_j s^j/F u``.  With F = A and exact
responses as instruments the same regression is a step of SRIVC.
"""

from __future__ import annotations

import numpy as np

from beam_ident.linear_solution import LinearSolution
from beam_ident.output_error import OutputErrorProblem, OutputErrorState
from beam_ident.piecewise import FloatArray, Instants
from beam_ident.rational_response import ComplexArray, RationalResponse


def filter_coefficients(order: int) -> FloatArray:
    """Return a_1 .. a_n of a Butterworth filter of cut-off one: well damped, and its poles keep apart."""
    angles = np.pi * (2.0 * np.arange(order) + order + 1.0) / (2.0 * order)
    return np.asarray(np.real(np.poly(np.exp(1j * angles)))[1:])


def filtered_output(
    problem: OutputErrorProblem, upper: ComplexArray, instants: Instants | None = None
) -> FloatArray:
    """Return the responses of ``s^(n-1)/F .. 1/F`` to the measured output, shape (n_instants, n)."""
    response = RationalResponse(
        upper,
        problem.scale,
        problem.measured,
        problem.measured_integral,
        problem.at_stamps if instants is None else instants,
        squares=False,
    )
    return response.combined(np.eye(response.order)[::-1])


def least_squares_step(problem: OutputErrorProblem, state: OutputErrorState) -> FloatArray:
    """Return the denominator that least squares finds behind the filter of a state (LSSVF)."""
    outputs = filtered_output(problem, state.uppers[0])
    regressors = np.concatenate([-outputs, state.matrix], axis=1)
    target = problem.values - outputs @ state.theta[: problem.n_a]
    return _with_delays(problem, state, LinearSolution.of(regressors).coefficients(target))


def instrumental_step(
    problem: OutputErrorProblem, state: OutputErrorState, instruments: FloatArray
) -> FloatArray:
    """Return the denominator that instrumental variables find behind the filter of a state."""
    outputs = filtered_output(problem, state.uppers[0])
    regressors = np.concatenate([-outputs, state.matrix], axis=1)
    target = problem.values - outputs @ state.theta[: problem.n_a]
    basis = LinearSolution.of(np.concatenate([instruments, state.matrix], axis=1)).basis
    scale = np.linalg.norm(regressors, axis=0)
    scale[scale == 0.0] = 1.0
    found = np.linalg.lstsq(basis.T @ (regressors / scale), basis.T @ target, rcond=1e-13)[0] / scale
    return _with_delays(problem, state, found)


def _with_delays(problem: OutputErrorProblem, state: OutputErrorState, found: FloatArray) -> FloatArray:
    theta = np.concatenate([found[: problem.n_a], state.theta[problem.n_a :]])
    theta[: problem.n_a] = stable_coefficients(theta[: problem.n_a])
    return theta


def stable_coefficients(coefficients: FloatArray) -> FloatArray:
    """Return a_1 .. a_n with unstable roots mirrored into the left half-plane."""
    if not np.all(np.isfinite(coefficients)):
        return coefficients
    roots = np.roots(np.concatenate([[1.0], coefficients]))
    if np.all(roots.real < 0.0) and len(roots) == len(coefficients):
        return coefficients
    roots = np.concatenate([roots, np.zeros(len(coefficients) - len(roots))])
    margin = 1e-3 * np.maximum(np.abs(roots), 1e-6)
    mirrored = np.where(roots.real < 0.0, roots, -np.maximum(np.abs(roots.real), margin) + 1j * roots.imag)
    return np.asarray(np.real(np.poly(mirrored)))[1:]
