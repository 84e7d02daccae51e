"""The linear regressions behind a state-variable filter.

Behind a filter 1/F(s) the equation ``A y = B u`` holds for the filtered derivatives, and is linear
in the coefficients: ``s^n/F y = -sum_i a_i s^(n-i)/F y + sum_j b_j s^j/F u``.  With F = A and exact
responses as instruments the same regression is a step of SRIVC.

Equation numbers are those of docs/transfer-function-equations.md.
"""

from __future__ import annotations

import numpy as np

from beam_ident.arrays import ComplexArray, FloatArray
from beam_ident.numerics.linear_least_squares import LinearSolution
from beam_ident.numerics.piecewise import Instants, PiecewisePolynomial
from beam_ident.numerics.rational_response import RationalResponse
from beam_ident.transfer_function_estimation.output_error import OutputErrorProblem, OutputErrorState
from beam_ident.transfer_function_estimation.record_share import RecordShare, Response, joined


def filter_coefficients(order: int) -> FloatArray:
    """Return a_1 .. a_n of a Butterworth filter of cut-off one: well damped, and its poles keep apart."""
    # Butterworth poles stand on the left half of the unit circle at equal angles.
    angles = np.pi * (2.0 * np.arange(order) + order + 1.0) / (2.0 * order)
    return np.asarray(np.real(np.poly(np.exp(1j * angles)))[1:])


def filtered_output(
    experiment: RecordShare, upper: ComplexArray, scale: float, instants: Instants
) -> RationalResponse:
    """Return the responses of a filter 1/F to what one record measured, at instants of it."""
    return RationalResponse(
        upper, scale, experiment.measured, experiment.measured_integral, instants, squares=False
    )


def filtered_derivatives(response: Response) -> FloatArray:
    """Return the responses of ``s^(n-1)/F .. 1/F``, shape (n_instants, n)."""
    return response.combined(np.eye(response.order)[::-1])


def filtered_outputs(problem: OutputErrorProblem, upper: ComplexArray) -> FloatArray:
    """Return the responses of ``s^(n-1)/F .. 1/F`` to the measured output at all stamps, shape (n_samples, n)."""
    parts = [filtered_output(own, upper, problem.scale, own.at_stamps) for own in problem.experiments]
    return filtered_derivatives(joined(parts))


def filtered_simulation(
    problem: OutputErrorProblem, upper: ComplexArray, simulated: FloatArray
) -> FloatArray:
    """Return the responses of ``s^(n-1)/F .. 1/F`` to a simulated output, shape (n_samples, n)."""
    parts = []
    for own, part in zip(problem.experiments, problem.rows, strict=True):
        signal: PiecewisePolynomial = own.joined(simulated[part])
        integral = signal.antiderivative()
        parts.append(RationalResponse(upper, problem.scale, signal, integral, own.at_stamps, squares=False))
    return filtered_derivatives(joined(parts))


def least_squares_step(problem: OutputErrorProblem, state: OutputErrorState) -> FloatArray:
    """Return the denominator that least squares finds behind the filter of a state (LSSVF)."""
    regressors, target = _equations(problem, state)
    # Least squares on (T.5). The regressors hold the noise of y, hence the bias.
    return _with_delays(problem, state, LinearSolution.of(regressors).coefficients(target))


def instrumental_step(
    problem: OutputErrorProblem, state: OutputErrorState, instruments: FloatArray
) -> FloatArray:
    """Return the denominator that instrumental variables find behind the filter of a state.

    Parameters
    ----------
    problem : OutputErrorProblem
    state : OutputErrorState
    instruments : ndarray, shape (n_samples, n) -- as the noise model sees them
    """
    regressors, target = _equations(problem, state)
    others = regressors[:, problem.n_a :]
    # (T.7) in an orthonormal basis of Z: the columns without noise (inputs, nuisances) are their own
    # instruments.
    basis = LinearSolution.of(np.concatenate([instruments, others], axis=1)).basis
    scale = np.linalg.norm(regressors, axis=0)
    scale[scale == 0.0] = 1.0
    found = np.linalg.lstsq(basis.T @ (regressors / scale), basis.T @ target, rcond=1e-13)[0] / scale
    return _with_delays(problem, state, found)


def _equations(problem: OutputErrorProblem, state: OutputErrorState) -> tuple[FloatArray, FloatArray]:
    """Return regressors and target behind the filter of a state, as the noise model sees them."""
    outputs = filtered_outputs(problem, state.uppers[0])
    # (T.6): the highest derivative is the output less the lower ones, weighed by the filter's coefficients.
    target = problem.values - outputs @ state.theta[: problem.n_a]
    return problem.weighed(np.concatenate([-outputs, state.matrix], axis=1)), problem.weighed(target)


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
