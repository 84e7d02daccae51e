"""How well a record can tell the poles of a known model, before anything is fitted: the Cramer-Rao bound.

Gains, residues and drifts of every output are what the record itself says at these poles; poles, latency and the
clock's rate are the unknowns that remain. What is asked is the record's information, not the poles: they need only be
about right.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from beam_ident.arrays import FloatArray
from beam_ident.data.records import TimeRecord
from beam_ident.modal.regression import ClockState, ModalRegression
from beam_ident.modal.structure import ModalStructure, StructureKind

_STANDS_OUT = 3.0  # standard deviations of a residue: once in 370 by chance


@dataclass(frozen=True, eq=False)
class PredictedPrecision:
    """What a record can tell of poles.

    Attributes
    ----------
    omegas, zetas : ndarray, shape (n_modes,) -- natural frequencies [rad/s] and damping ratios that were assumed
    omega_sd, zeta_sd : ndarray, shape (n_modes,)
        Standard deviations that the best estimator would have; infinite where the record tells nothing.
    """

    omegas: FloatArray
    zetas: FloatArray
    omega_sd: FloatArray
    zeta_sd: FloatArray


def predicted_precision(
    records: Sequence[TimeRecord],
    structure: StructureKind,
    omegas: ArrayLike,
    zetas: ArrayLike,
    noise_sd: Mapping[str, float],
    clock_rate_sd: float = 0.0,
) -> PredictedPrecision:
    """Return how well records can tell poles that are about known.

    Parameters
    ----------
    records : sequence of TimeRecord -- of one system
    structure : str -- which model goes with the input, as in ``identify``
    omegas : array_like, shape (n_modes,) -- natural frequencies [rad/s]
    zetas : array_like, shape (n_modes,) -- damping ratios
    noise_sd : mapping -- standard deviation of the white noise of every output, by its name
    clock_rate_sd : float -- how well the rate of the outputs' clock against the input's is known beforehand

    Raises
    ------
    EstimationError
        Records that ``identify`` would refuse as well.
    """
    omegas, zetas = (np.asarray(values, dtype=np.float64) for values in (omegas, zetas))
    regression = ModalRegression(records, ModalStructure(structure))
    blocks = regression.blocks(omegas, zetas, ClockState(), gradients=True)
    n = len(omegas)
    has_rate = clock_rate_sd > 0.0
    information = np.zeros((2 * n + 1 + has_rate, 2 * n + 1 + has_rate))
    for j, name in enumerate(regression.output_names):
        block = blocks[regression.block_of[j]]
        size = np.linalg.norm(block.matrix, axis=0)
        size = np.where(size > 0.0, size, 1.0)
        basis, values, axes = np.linalg.svd(block.matrix / size, full_matrices=False)
        kept = values > 1e-10 * values[0]
        basis, axes = basis[:, kept], axes[kept] / values[kept, None]
        found = axes.T @ (basis.T @ regression.values[j])
        # A residue that does not stand out of the noise is none: it would tell of poles that nothing shows.
        sd = noise_sd[name] * np.sqrt(np.sum(np.square(axes), axis=0))
        of_modes = np.unique(block.mode_columns)
        found[of_modes] = np.where(np.abs(found) > _STANDS_OUT * sd, found, 0.0)[of_modes]
        slopes = block.slopes(found / size, True, has_rate)
        # What gains, residues and drifts can take over tells nothing of the poles.
        slopes = (slopes - basis @ (basis.T @ slopes)) / noise_sd[name]
        information += slopes.T @ slopes
    if has_rate:
        information[-1, -1] += 1.0 / clock_rate_sd**2
    scale = np.sqrt(np.diag(information))
    is_seen = scale > 0.0
    sd = np.full(len(information), np.inf)
    if np.any(is_seen):
        part = information[np.ix_(is_seen, is_seen)] / np.outer(scale[is_seen], scale[is_seen])
        bound = np.sqrt(np.maximum(np.diag(np.linalg.pinv(part, hermitian=True)), 0.0))
        sd[is_seen] = bound / scale[is_seen]
    return PredictedPrecision(omegas, zetas, sd[:n] * omegas, sd[n : 2 * n])
