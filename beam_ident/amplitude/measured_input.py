"""What noise on a measured input does to the outputs of a model, for tests and curves over amplitude.

It rings in the modes as long as they ring, so that it is neither white nor coloured by what a few lines show.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from beam_ident.data.bandwidth import excited_band
from beam_ident.data.records import TimeRecord
from beam_ident.modal.model import ModalModel
from beam_ident.modal.regression import ModalRegression
from beam_ident.modal_estimation.input_disturbance import InputDisturbance, Observations
from beam_ident.noise.input_noise import Smoothing, input_noise_share, noise_grid

_NEGLIGIBLE_SHARE = 3e-4  # of an output's noise variance: what noise on the input adds beyond is known of


def noisy_band_hz(regression: ModalRegression, model: ModalModel) -> float | None:
    """Return the end of the band that the inputs excite where noise on the only input matters, else None."""
    drives = regression.drives
    if len(model.input_names) > 1 or not any(drive.sigma > 0.0 for drive in drives):
        return None
    shares = []
    for drive in drives:
        omegas = noise_grid(model.frequencies_hz, model.damping_ratios, drive)
        response = model.frequency_response(omegas).response
        shares.append(float(np.max(input_noise_share(response, omegas, drive, model.noise_sd))))
    if not max(shares) > _NEGLIGIBLE_SHARE:
        return None
    structure = regression.structure
    power = structure.differentiations if structure.is_motion else 0
    return max(
        excited_band(drive, power, regression.duration_s, regression.rate_hz).high_hz for drive in drives
    )


def disturbances_of(
    regression: ModalRegression, records: Sequence[TimeRecord], model: ModalModel, smoothing: Smoothing
) -> list[tuple[InputDisturbance, Observations]]:
    """Return the noise of every record's input as the model passes it, and where it is seen."""
    result = []
    for index, (record, drive) in enumerate(zip(records, regression.drives, strict=True)):
        exposures = np.array(
            [
                record.output(name).exposure_s if name in record.output_names else 0.0
                for name in regression.output_names
            ]
        )
        disturbance = InputDisturbance(
            drive,
            regression.structure,
            model.natural_frequencies,
            model.damping_ratios,
            model.column_parameters(),
            exposures,
            smoothing,
        )
        result.append((disturbance, Observations.of_record(regression, index, model.latency)))
    return result
