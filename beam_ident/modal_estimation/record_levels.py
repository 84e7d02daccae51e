"""Modes from several records that are not equally noisy: every output weighs in each by its noise there.

The levels are those of the residuals of a fit; levels and fit take turns until neither moves.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.data.prior import Prior
from beam_ident.modal.fit import ModalFit
from beam_ident.modal.regression import ModalRegression
from beam_ident.modal_estimation.variable_projection import fit_modes

_TURNS = 6
_SETTLED = 0.02  # standard deviations that a turn may still move a pole


def weigh_records(
    regression: ModalRegression, fit: ModalFit, latency: Prior, clock_rate: Prior
) -> tuple[ModalRegression, ModalFit]:
    """Return the regression and the fit in which every record weighs by its noise; of one record as they are.

    Parameters
    ----------
    regression : ModalRegression -- with all records alike
    fit : ModalFit -- of it
    latency, clock_rate : Prior
    """
    if len(regression.drives) == 1:
        return regression, fit
    weighed = regression
    for _ in range(_TURNS):
        weighed = regression.weighed(record_levels(weighed, fit))
        following = fit_modes(weighed, fit.omegas, fit.zetas, fit.clock, latency, clock_rate)
        n = 2 * len(fit.omegas)
        moved = np.concatenate([np.log(following.omegas / fit.omegas), following.zetas - fit.zetas])
        reach = np.sqrt(np.maximum(np.diag(following.covariance)[:n], 1e-300))
        fit = following
        if not np.any(np.abs(moved) > _SETTLED * reach):
            break
    return weighed, fit


def unweighed(regression: ModalRegression, fit: ModalFit) -> ModalFit:
    """Return a fit of a weighed regression with residuals and noise in the units of the outputs."""
    levels = [regression.row_levels(j) for j in range(regression.n_outputs)]
    return dataclasses.replace(
        fit,
        residuals=tuple(left * own for left, own in zip(fit.residuals, levels, strict=True)),
        sigmas=fit.sigmas * np.array([math.sqrt(float(np.mean(np.square(own)))) for own in levels]),
    )


def record_levels(regression: ModalRegression, fit: ModalFit) -> list[FloatArray]:
    """Return the level of every output's noise in each of its records, their weighted geometric mean one.

    Parameters
    ----------
    regression : ModalRegression -- weighed or not
    fit : ModalFit -- of it

    Notes
    -----
    The parameters are paid by the records that have them; those that all share, in proportion to samples.
    """
    n_own = regression.n_nuisance(len(fit.omegas))
    n_common = regression.n_shared_fixed + len(fit.omegas) + 2.0 * len(fit.omegas) / regression.n_outputs
    result = []
    for j, residuals in enumerate(fit.residuals):
        left = residuals * regression.row_levels(j)
        floor = 1e-12 * float(np.max(np.abs(regression.values[j] * regression.row_levels(j)))) + 1e-300
        logs, sizes = [], []
        for _, part in regression.segments[j]:
            size = part.stop - part.start
            n_free = max(size - n_own - n_common * size / len(left), 1.0)
            logs.append(math.log(max(float(np.linalg.norm(left[part])) / math.sqrt(n_free), floor)))
            sizes.append(size)
        mean = float(np.average(logs, weights=sizes)) if len(logs) > 1 else logs[0]
        result.append(np.exp(np.array(logs) - mean))
    return result
