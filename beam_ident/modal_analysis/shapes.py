"""What mode shapes say about each other and about themselves."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from beam_ident.arrays import ComplexArray, FloatArray
from beam_ident.errors import EstimationError


def modal_assurance(first: ArrayLike, second: ArrayLike | None = None) -> FloatArray:
    """Return the modal assurance criterion between every two shapes.

    Parameters
    ----------
    first, second : complex ndarray, shape (n_points, n_modes)
        None compares the first set with itself.

    Returns
    -------
    ndarray, shape (n_first, n_second)
        1 for shapes that differ by a factor alone, 0 for orthogonal ones.

    Notes
    -----
    ``|a^H b|^2 / (a^H a  b^H b)`` (Allemang and Brown 1982).  With few points different modes may
    look alike: a MAC over three markers proves little.
    """
    a = _shapes(first)
    b = a if second is None else _shapes(second)
    if len(a) != len(b):
        raise EstimationError(f"shapes of {len(a)} and {len(b)} points; expected the same points in both")
    product = np.abs(np.conj(a).T @ b) ** 2
    size = np.outer(np.sum(np.abs(a) ** 2, axis=0), np.sum(np.abs(b) ** 2, axis=0))
    return np.asarray(product / np.where(size > 0.0, size, 1.0))


def phase_collinearity(shapes: ArrayLike) -> FloatArray:
    """Return the modal phase collinearity of every shape, shape (n_modes,).

    Notes
    -----
    1 for a shape whose points move in phase or in antiphase, 0 where real and imaginary part
    are of equal size and unrelated: ``((S_xx - S_yy)^2 + 4 S_xy^2) / (S_xx + S_yy)^2`` with x and y real
    and imaginary part (Pappa, Elliott and Schenk 1993, without the removal of a mean, which a
    shape of one sign would suffer from).
    """
    values = _shapes(shapes)
    x, y = values.real, values.imag
    xx, yy, xy = np.sum(x * x, axis=0), np.sum(y * y, axis=0), np.sum(x * y, axis=0)
    whole = (xx + yy) ** 2
    return np.asarray(((xx - yy) ** 2 + 4.0 * xy**2) / np.where(whole > 0.0, whole, 1.0))


def normalised(shapes: ArrayLike) -> ComplexArray:
    """Return shapes turned and scaled so that their largest point is 1."""
    values = _shapes(shapes)
    largest = values[np.argmax(np.abs(values), axis=0), np.arange(values.shape[1])]
    return np.asarray(values / np.where(np.abs(largest) > 0.0, largest, 1.0))


def _shapes(values: ArrayLike) -> ComplexArray:
    shapes = np.asarray(values, dtype=np.complex128)
    if shapes.ndim == 1:
        shapes = shapes[:, None]
    if shapes.ndim != 2 or not np.all(np.isfinite(shapes)):
        raise EstimationError(f"shapes have shape {shapes.shape}; expected finite (n_points, n_modes)")
    return shapes
