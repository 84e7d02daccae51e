"""Bands of variances that were estimated from few samples, and of the difference of two of them.

A variance s of nu real degrees of freedom is nu s / sigma^2 ~ chi2(nu).  The difference of two independent ones
(total less noise: what distortion leaves) has the band of Ting et al.: exact where either of the two vanishes beside
the other, and its lower end is above zero just where an F test says that the first is larger.

Source: N. Ting, R. K. Burdick, F. A. Graybill, S. Jeyaratnam, T.-F. C. Lu, Confidence intervals on linear
combinations of variance components that are unrestricted in sign, J. Statist. Comput. Simul. 35 (1990) 135-143.
"""

from __future__ import annotations

import numpy as np
from scipy.special import chdtri as chi_squared_isf
from scipy.special import fdtri as f_ppf

from beam_ident.arrays import FloatArray


def variance_band(variance: FloatArray, freedom: FloatArray, level: float = 0.95) -> FloatArray:
    """Return the lower and the upper end of the band of variances.

    Parameters
    ----------
    variance : ndarray, shape (...) -- estimates
    freedom : ndarray -- real degrees of freedom of each, of a shape that goes with it
    level : float -- chance that the band holds the variance

    Returns
    -------
    ndarray, shape (2, ...) -- 0 to infinity where there is no freedom
    """
    nu = np.maximum(np.asarray(freedom, dtype=np.float64), 1.0)
    tail = 0.5 * (1.0 - level)
    scaled = nu * variance
    ends = np.stack([scaled / chi_squared_isf(nu, tail), scaled / chi_squared_isf(nu, 1.0 - tail)])
    is_known = np.broadcast_to(np.asarray(freedom) > 0.0, ends.shape)
    return np.where(is_known, ends, np.stack([np.zeros_like(scaled), np.full_like(scaled, np.inf)]))


def difference_band(
    larger: FloatArray,
    freedom: FloatArray,
    smaller: FloatArray,
    freedom_of_smaller: FloatArray,
    level: float = 0.95,
) -> FloatArray:
    """Return the band of a variance less another one, both ends at least 0.

    Parameters
    ----------
    larger, smaller : ndarray, shape (...) -- independent estimates, of a variance and of a part of it
    freedom, freedom_of_smaller : ndarray -- their real degrees of freedom
    level : float -- chance that the band holds the difference

    Returns
    -------
    ndarray, shape (2, ...)
    """
    n, m = (np.maximum(np.asarray(own, dtype=np.float64), 1.0) for own in (freedom, freedom_of_smaller))
    tail = 0.5 * (1.0 - level)
    # F quantiles of the source: F(tail: n, m) is exceeded with the chance of the tail.
    above, below = f_ppf(n, m, 1.0 - tail), f_ppf(n, m, tail)
    g_1, h_1 = 1.0 - n / chi_squared_isf(n, tail), n / chi_squared_isf(n, 1.0 - tail) - 1.0
    g_2, h_2 = 1.0 - m / chi_squared_isf(m, tail), m / chi_squared_isf(m, 1.0 - tail) - 1.0
    g_12 = ((above - 1.0) ** 2 - (g_1 * above) ** 2 - h_2**2) / above
    h_12 = ((1.0 - below) ** 2 - (h_1 * below) ** 2 - g_2**2) / below
    product = larger * smaller
    down = (g_1 * larger) ** 2 + (h_2 * smaller) ** 2 + g_12 * product
    up = (h_1 * larger) ** 2 + (g_2 * smaller) ** 2 + h_12 * product
    middle = larger - smaller
    ends = np.stack([middle - np.sqrt(np.maximum(down, 0.0)), middle + np.sqrt(np.maximum(up, 0.0))])
    return np.asarray(np.maximum(ends, 0.0))
