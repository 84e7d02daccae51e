"""Whether two identified models describe the same structure.

Modes are paired by frequency; the differences of natural frequency and damping ratio
are then weighed with both covariances, which gives a chi-squared statistic.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.special import chdtrc as chi_squared_sf

from beam_ident.arrays import FloatArray
from beam_ident.errors import EstimationError
from beam_ident.modal.model import ModalModel

_MAX_RATIO = 1.25  # modes farther apart than this are different modes


@dataclass(frozen=True, eq=False)
class ModelComparison:
    """Differences between the matched modes of two models.

    Attributes
    ----------
    pairs : tuple of (int, int) -- matched modes, counted from 0
    unmatched_first, unmatched_second : tuple of int -- modes left over
    frequency_difference, damping_difference : ndarray, shape (n_pairs,)
        Second less first: [rad/s] and [-].
    frequency_z, damping_z : ndarray -- the same over their combined standard deviations
    chi_squared : float
    degrees_of_freedom : int
    p_value : float -- probability of a larger value if the two are the same
    """

    pairs: tuple[tuple[int, int], ...]
    unmatched_first: tuple[int, ...]
    unmatched_second: tuple[int, ...]
    frequency_difference: FloatArray
    damping_difference: FloatArray
    frequency_z: FloatArray
    damping_z: FloatArray
    chi_squared: float
    degrees_of_freedom: int
    p_value: float


def compare_models(first: ModalModel, second: ModalModel) -> ModelComparison:
    """Compare natural frequencies and damping ratios of two models.

    Parameters
    ----------
    first, second : ModalModel
        From different records, so that their errors are independent.

    Raises
    ------
    EstimationError
        Anything but two modal models.
    """
    for model in (first, second):
        if not isinstance(model, ModalModel):
            raise EstimationError(
                f"a {type(model).__name__} is to be compared; expected two ModalModels (assess_repeatability() takes "
                "transfer functions)"
            )
    distance = np.abs(np.log(first.natural_frequencies[:, None] / second.natural_frequencies[None, :]))
    rows, columns = linear_sum_assignment(distance)
    pairs = tuple(
        (int(i), int(j)) for i, j in zip(rows, columns, strict=True) if distance[i, j] < np.log(_MAX_RATIO)
    )
    left = [i for i, _ in pairs]
    right = [j for _, j in pairs]
    d_omega = second.natural_frequencies[right] - first.natural_frequencies[left]
    d_zeta = second.damping_ratios[right] - first.damping_ratios[left]
    of_first = left + [first.n_modes + i for i in left]
    of_second = right + [second.n_modes + j for j in right]
    covariance = (
        first.covariance[np.ix_(of_first, of_first)] + second.covariance[np.ix_(of_second, of_second)]
    )
    difference = np.concatenate([d_omega, d_zeta])
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    z = difference / scale
    correlation = covariance / np.outer(scale, scale)
    statistic = float(z @ np.linalg.lstsq(correlation, z, rcond=1e-12)[0]) if pairs else 0.0
    n = len(pairs)
    return ModelComparison(
        pairs=pairs,
        unmatched_first=tuple(i for i in range(first.n_modes) if i not in left),
        unmatched_second=tuple(j for j in range(second.n_modes) if j not in right),
        frequency_difference=d_omega,
        damping_difference=d_zeta,
        frequency_z=z[:n],
        damping_z=z[n:],
        chi_squared=statistic,
        degrees_of_freedom=2 * n,
        p_value=float(chi_squared_sf(2 * n, statistic)) if n else 1.0,
    )
