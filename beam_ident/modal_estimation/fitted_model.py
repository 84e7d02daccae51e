"""From a fit to the modal model that it estimated."""

from __future__ import annotations

import numpy as np

from beam_ident.modal.model import ModalModel, parameter_names
from beam_ident.modal.regression import ModalRegression
from beam_ident.modal_estimation.variable_projection import ModalFit


def fitted_model(
    fit: ModalFit, regression: ModalRegression, latency_is_free: bool, rate_is_free: bool
) -> ModalModel:
    """Collect the parameters of a fit, leaving out offsets, ramps and free responses."""
    structure = regression.structure
    n, m = len(fit.omegas), regression.n_outputs
    names = parameter_names(n, regression.output_names)
    source: list[int] = list(range(2 * n))
    place = 2 * n
    for is_free in (latency_is_free, rate_is_free):
        source.append(place if is_free else -1)
        place += int(is_free)
    gains, residuals, residues = np.zeros(m), np.zeros(m), np.zeros((m, n))
    for j, found in enumerate(fit.coefficients):
        column = 0
        if structure.has_direct:
            gains[j] = found[0]
            source.append(place)
            column = 1
        else:
            source.append(-1)
        if structure.has_residual:
            residuals[j] = found[column]
            source.append(place + column)
            column += 1
        else:
            source.append(-1)
        residues[j] = found[column : column + n]
        source.extend(range(place + column, place + column + n))
        place += len(found)
    index = np.array(source)
    covariance = fit.covariance[np.ix_(index, index)]
    absent = index < 0
    covariance[absent, :] = 0.0
    covariance[:, absent] = 0.0
    scale = np.ones(len(names))
    scale[:n] = fit.omegas
    return ModalModel(
        structure=structure.kind,
        input_name=regression.drives[0].name,
        output_names=regression.output_names,
        natural_frequencies=fit.omegas,
        damping_ratios=fit.zetas,
        residues=residues,
        residual_terms=residuals,
        gains=gains,
        latency=fit.clock.latency,
        clock_rate=fit.clock.rate,
        covariance=covariance * np.outer(scale, scale),
        noise_sd=fit.sigmas,
    )
