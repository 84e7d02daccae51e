"""What noise on a measured input does to the outputs.

White noise of standard deviation sigma on the samples of an input of period T passes
through the model like the input itself: it adds ``sigma^2 T int |H|^2 df`` over the
sampled band to the variance of an output.  Where that is no longer small against
the output's own noise, residuals may still look white while the intervals are wrong.
"""

from __future__ import annotations

import numpy as np
import scipy.integrate

from beam_ident.modal_model import ModalModel
from beam_ident.records import InputSignal


def input_noise_share(model: ModalModel, drive: InputSignal) -> float:
    """Return the largest share of an output's noise variance that the input's noise makes up.

    Parameters
    ----------
    model : ModalModel
    drive : InputSignal
        With its ``sigma``.
    """
    if drive.sigma == 0.0:
        return 0.0
    period = float(np.median(np.diff(drive.times_s)))
    nyquist = 0.5 / period
    coarse = np.linspace(0.0, nyquist, 400)[1:]
    near = [
        frequency * (1.0 + max(zeta, 1e-4) * np.sinh(np.linspace(-6.0, 6.0, 161)))
        for frequency, zeta in zip(model.frequencies_hz, model.damping_ratios, strict=True)
    ]
    grid = np.unique(np.concatenate([coarse, *near]))
    grid = grid[(grid > coarse[0] * 0.01) & (grid <= nyquist)]
    response = np.abs(model.frequency_response(2.0 * np.pi * grid).response) ** 2
    passed = 2.0 * period * drive.sigma**2 * scipy.integrate.trapezoid(response, grid, axis=0)
    return float(np.max(passed / np.maximum(passed + model.noise_sd**2, 1e-300)))
