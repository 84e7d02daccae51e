"""Poles of a frequency response by relaxed vector fitting.

A response is written as a quotient of two sums of partial fractions over the same poles,

    H(s) ~ p(s) / sigma(s),    p = sum_k r_k / (s - q_k) + e,    sigma = sum_k c_k / (s - q_k) + d

so that ``sigma H - p = 0`` is linear in all coefficients (Gustavsen and Semlyen 1999), and the zeros of sigma are
better poles than the q_k.  Once they stand still sigma is constant, and the linear problem weighs every line as it
should.  Instead of ``d = 1``, which biases a noisy fit, the mean of sigma's real part over the lines is held at
one (Gustavsen 2006).  Partial fractions stay well conditioned at any order, where powers of s do not.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from beam_ident.arrays import ComplexArray, FloatArray
from beam_ident.numerics.linear_least_squares import LinearSolution

_START_DAMPING = 0.01
_REAL = 1e-9  # imaginary part over modulus: below, a pole is real but for rounding
_NEAREST = 1e-6  # of its modulus: how close to the imaginary axis a pole is put back


def spread_poles(omegas: FloatArray, n_poles: int, is_geometric: bool) -> ComplexArray:
    """Return lightly damped poles over the band of some lines, those with imaginary part >= 0.

    Parameters
    ----------
    omegas : ndarray, shape (n_lines,) -- increasing [rad/s]
    n_poles : int -- an odd number has a real pole in the middle
    is_geometric : bool -- evenly in log frequency, for plants of several decades, or in frequency
    """
    spread = np.geomspace if is_geometric else np.linspace
    # Half a step inside the band on both sides.
    places = spread(omegas[0], omegas[-1], n_poles // 2 * 2 + 1)[1::2]
    pairs = places * (-_START_DAMPING + 1j)
    middle = -np.sqrt(omegas[0] * omegas[-1]) * np.ones(n_poles % 2)
    return np.concatenate([middle.astype(np.complex128), pairs])


def full_poles(uppers: ComplexArray) -> ComplexArray:
    """Return all poles, from those with imaginary part >= 0."""
    return np.concatenate([uppers, np.conj(uppers[uppers.imag > 0.0])])


def relocated_poles(
    s: ComplexArray, response: ComplexArray, weights: FloatArray, uppers: ComplexArray, has_constant: bool
) -> Iterator[ComplexArray]:
    """Yield better and better poles, without end or until a step has no solution.

    Parameters
    ----------
    s, response : complex ndarray, shape (n_lines,)
    weights : ndarray, shape (n_lines,) -- over the noise's standard deviation
    uppers : complex ndarray -- where to begin, of every pair the pole with imaginary part >= 0
    has_constant : bool -- whether the response has a direct term e

    Notes
    -----
    The zeros of sigma are the eigenvalues of ``A - b c^T / d`` with A, b the realisation of the partial fractions.
    Those on the right of the imaginary axis are mirrored.
    """
    lines = len(s)
    ones = np.ones((lines, 1))
    while True:
        basis = _partial_fractions(s, uppers)
        n = basis.shape[1]
        top = np.concatenate([basis, ones], axis=1) if has_constant else basis
        rows = weights[:, None] * np.concatenate(
            [top, -response[:, None] * np.concatenate([basis, ones], axis=1)], axis=1
        )
        # The mean of Re sigma is one; its weight is the size of what the lines say.
        level = float(np.linalg.norm(weights * response)) / lines
        mean = level * np.concatenate([np.zeros(top.shape[1]), np.sum(basis.real, axis=0), [lines]])
        matrix = np.concatenate([rows.real, rows.imag, mean[None]])
        right = np.zeros(len(matrix))
        right[-1] = level * lines
        found = LinearSolution.of(matrix).coefficients(right)[-(n + 1) :]
        if not found[-1]:
            return
        transition, drive = np.zeros((n, n)), np.zeros(n)
        place = 0
        for pole in uppers:
            if pole.imag > 0.0:
                pair = slice(place, place + 2)
                transition[pair, pair] = [[pole.real, pole.imag], [-pole.imag, pole.real]]
                drive[place] = 2.0
                place += 2
            else:
                transition[place, place], drive[place] = pole.real, 1.0
                place += 1
        moved = np.linalg.eigvals(transition - np.outer(drive, found[:n] / found[-1]))
        moved = np.where(np.abs(moved.imag) < _REAL * np.abs(moved), moved.real, moved)
        moved = moved[moved.imag >= 0.0]
        uppers = np.minimum(-np.abs(moved.real), -_NEAREST * np.abs(moved)) + 1j * moved.imag
        yield uppers


def _partial_fractions(s: ComplexArray, uppers: ComplexArray) -> ComplexArray:
    """Return 1/(s - q) of real poles, and of pairs its sum and difference, which have real coefficients."""
    columns = []
    for pole in uppers:
        one = 1.0 / (s - pole)
        if pole.imag > 0.0:
            other = 1.0 / (s - np.conj(pole))
            columns += [one + other, 1j * (one - other)]
        else:
            columns.append(one)
    return np.stack(columns, axis=1)
