"""Poles mode by mode, also of modes that are damped beyond oscillation."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linear_sum_assignment

from beam_model.arrays import ComplexArray, FloatArray


def pole_pairs(natural_frequencies: FloatArray, ratios: FloatArray) -> ComplexArray:
    """Return the two poles of each uncoupled mode, shape (n_modes, 2).

    Parameters
    ----------
    natural_frequencies : ndarray, shape (n_modes,)
        omega [rad/s].
    ratios : ndarray, shape (n_modes,)
        zeta; 1 and more do not oscillate.

    Returns
    -------
    ndarray of complex, shape (n_modes, 2)
        omega (-zeta +- sqrt(zeta^2 - 1)): the upper pole before its conjugate, or the slower before the faster.
    """
    root = np.sqrt(np.asarray(ratios**2 - 1.0, dtype=np.complex128))
    # The slower pole as omega / faster: their difference would lose its digits.
    faster = -ratios - np.where(ratios > 1.0, root, 0.0)
    is_real = ratios > 1.0
    first = np.where(is_real, 1.0 / np.where(is_real, faster, 1.0), -ratios + root)
    second = np.where(is_real, faster, -ratios - root)
    return np.asarray(natural_frequencies[:, None] * np.column_stack([first, second]), dtype=np.complex128)


def eigenvalues_of(A: FloatArray, inverse: FloatArray) -> ComplexArray:
    """Return the eigenvalues of a regular matrix, the small ones from its inverse, shape (n,).

    Parameters
    ----------
    A, inverse : ndarray, shape (n, n)
        The inverse written down, not computed from A.

    Notes
    -----
    A solver errs by rounding times the largest eigenvalue. Heavy damping parts each mode's poles by factors of a
    million and more; below a gap near their geometric mean the inverse has the better ones.
    """
    found = np.linalg.eigvals(A).astype(np.complex128)
    found = found[np.argsort(np.abs(found))]
    size = np.abs(found)
    # What rounding would be multiplied by with a cut before each eigenvalue; no pair of conjugates is cut.
    worse = np.maximum(size[:-1] / size[0], size[-1] / size[1:])
    cut = 1 + int(np.argmin(np.where(size[1:] > 1.001 * size[:-1], worse, np.inf)))
    if size[-1] <= worse[cut - 1] * size[0]:
        return np.asarray(found)
    others = 1.0 / np.linalg.eigvals(inverse).astype(np.complex128)
    others = others[np.argsort(np.abs(others))]
    return np.concatenate([others[:cut], found[cut:]])


def sorted_by_mode(
    eigenvalues: ComplexArray, expected: ComplexArray, others: tuple[float, ...] = ()
) -> ComplexArray:
    """Return the eigenvalues of coupled modes in pairs, mode by mode.

    Parameters
    ----------
    eigenvalues : ndarray of complex, shape (2 n_modes + n_others,)
        Of a real matrix.
    expected : ndarray of complex, shape (n_modes, 2)
        Roughly where they are: those of the modes without their coupling.
    others : tuple of float
        Real poles that belong to no mode, roughly.

    Returns
    -------
    ndarray of complex, shape (n_modes, 2)
        As ``pole_pairs`` returns them.

    Notes
    -----
    Every eigenvalue goes to the nearest expected pole, by the distance of their logarithms, so that all distances
    together are smallest. Where that tears a pair apart, because a damped mode oscillates with what was a real
    pole of the hub, the torn modes share what is left: oscillating pairs first, then real poles by their size.
    """
    wanted = np.concatenate([expected.ravel(), np.asarray(others, dtype=np.complex128)])
    _, taken = linear_sum_assignment(np.abs(np.log(wanted[:, None] / eigenvalues[None, :])))
    found = eigenvalues[taken]
    pairs = found[: expected.size].reshape(expected.shape)
    is_torn = np.abs(pairs.sum(axis=1).imag) > 0.0
    left = np.concatenate([pairs[is_torn].ravel(), found[expected.size :]])
    upper, real = left[left.imag > 0.0], left[left.imag == 0.0]
    real = real[np.argsort(np.abs(real))][: 2 * (int(is_torn.sum()) - upper.size)]
    pairs[is_torn] = np.concatenate([np.column_stack([upper, upper.conj()]), real.reshape(-1, 2)])
    # The upper pole before its conjugate, the slower before the faster; the lowest mode first.
    keys = np.where(pairs.imag == 0.0, np.abs(pairs), -np.sign(pairs.imag))
    pairs = np.take_along_axis(pairs, np.argsort(keys, axis=1), axis=1)
    return np.asarray(pairs[np.argsort(natural_frequencies_of(pairs))], dtype=np.complex128)


def natural_frequencies_of(pairs: ComplexArray) -> FloatArray:
    """Return sqrt of the product of each mode's two poles, shape (n_modes,) [rad/s]."""
    return np.asarray(np.sqrt(np.abs(pairs[:, 0]) * np.abs(pairs[:, 1])), dtype=np.float64)


def damping_ratios_of(pairs: ComplexArray) -> FloatArray:
    """Return each mode's damping ratio, shape (n_modes,); 1 and more do not oscillate."""
    return np.asarray(-pairs.sum(axis=1).real / (2.0 * natural_frequencies_of(pairs)), dtype=np.float64)
