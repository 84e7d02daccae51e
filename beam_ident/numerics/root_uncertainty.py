"""How far the roots of a polynomial scatter when its coefficients do.

To first order d root / d c_k = -root^k / P'(root) for the coefficient c_k of s^k.  Near a
double root P' vanishes and the linear scatter loses its meaning: it grows beyond all bounds,
which is the right warning.
"""

from __future__ import annotations

import numpy as np

from beam_ident.arrays import ComplexArray, FloatArray


def root_covariances(polynomial: FloatArray, covariance: FloatArray) -> tuple[ComplexArray, FloatArray]:
    """Return the roots of a polynomial and the covariance of each one's real and imaginary part.

    Parameters
    ----------
    polynomial : ndarray, shape (n + 1,) -- descending powers
    covariance : ndarray, shape (n + 1, n + 1) or (n, n)
        Of all coefficients, or of all but the leading one where that is known exactly.

    Returns
    -------
    roots : complex ndarray, shape (n,)
    covariances : ndarray, shape (n, 2, 2) -- of (real, imaginary) part
    """
    polynomial = np.asarray(polynomial, dtype=np.float64)
    roots = np.asarray(np.roots(polynomial), dtype=np.complex128)
    powers = np.arange(len(covariance) - 1, -1, -1)
    with np.errstate(divide="ignore", invalid="ignore"):
        slopes = -(roots[:, None] ** powers) / np.polyval(np.polyder(polynomial), roots)[:, None]
    parts = np.stack([slopes.real, slopes.imag], axis=1)
    return roots, np.asarray(parts @ covariance @ np.swapaxes(parts, 1, 2))
