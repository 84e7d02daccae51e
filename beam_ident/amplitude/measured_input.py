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
from beam_ident.modal_estimation.input_disturbance import (
    NEGLIGIBLE_SHARE,
    InputDisturbance,
    Observations,
    disturbances_by_record,
    noise_shares,
)
from beam_ident.noise.input_noise import Smoothing


def noisy_band_hz(regression: ModalRegression, model: ModalModel) -> float | None:
    """Return the end of the band that the inputs excite where noise on the only input matters, else None."""
    drives = regression.drives
    if len(model.input_names) > 1:
        return None
    if not max(float(np.max(noise_shares(model, drive))) for drive in drives) > NEGLIGIBLE_SHARE:
        return None
    power = regression.structure.driving_power
    return max(
        excited_band(drive, power, regression.duration_s, regression.rate_hz).high_hz for drive in drives
    )


def disturbances_of(
    regression: ModalRegression, records: Sequence[TimeRecord], model: ModalModel, smoothing: Smoothing
) -> list[tuple[InputDisturbance, Observations]]:
    """Return the noise of every record's input as the model passes it, and where it is seen."""
    return disturbances_by_record(
        regression,
        records,
        model.natural_frequencies,
        model.damping_ratios,
        model.column_parameters(),
        model.latency,
        smoothing,
    )
