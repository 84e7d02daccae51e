"""Damping from the width of a resonance peak: quick, and biased where lines are coarse.

Between the frequencies at which a receptance has fallen to ``1/sqrt(2)`` of its peak,

    zeta = (omega_2^2 - omega_1^2) / (4 omega_0^2)

for light damping of a mode that stands alone.  What the lines cannot show is stated beside
it: a peak that falls between two lines is read too low, and the band around it too wide.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.data.argument_checks import require_frequency_record
from beam_ident.data.frequency_record import FrequencyRecord
from beam_ident.errors import EstimationError

_SEEN = 3.0  # standard deviations


@dataclass(frozen=True)
class HalfPowerDamping:
    """A resonance by its half-power points.

    Attributes
    ----------
    natural_frequency : float -- of the highest line [rad/s]
    damping_ratio : float
    low, high : float -- half-power frequencies [rad/s], straight lines between the measured ones
    lines_in_band : float -- half-power band over the spacing of the lines
    largest_bias : float
        By how much, relative, the damping may be read too high because the peak falls
        between lines: ``sqrt(1 + 2 x^2) - 1`` with x half a line's spacing over ``zeta omega``.
    """

    natural_frequency: float
    damping_ratio: float
    low: float
    high: float
    lines_in_band: float
    largest_bias: float

    @property
    def is_resolved(self) -> bool:
        """Whether the bias stays below 5 %, which takes about five lines in the band."""
        return self.largest_bias < 0.05


def half_power_damping(
    record: FrequencyRecord,
    near_hz: float | None = None,
    output_name: str | None = None,
    input_name: str | None = None,
) -> HalfPowerDamping:
    """Read the damping of a resonance from its half-power band.

    Parameters
    ----------
    record : FrequencyRecord
        A receptance, or any response that one mode dominates around its peak.
    near_hz : float or None
        The peak to read is the next one [Hz]; None takes the highest, by what it surely has where variances
        are known.
    output_name, input_name : str or None -- None takes the first

    Raises
    ------
    EstimationError
        No peak, a peak that noise may be, or one whose flanks do not fall to half power inside the record.

    Notes
    -----
    A window widens every peak by its own bandwidth: take a response without one (periods, a
    stepped sine, a local polynomial).  For a damping with its uncertainty fit a model.
    """
    require_frequency_record(record)
    if near_hz is not None and not (math.isfinite(near_hz) and near_hz > 0.0):
        raise EstimationError(
            f"near_hz is {near_hz}; expected a frequency > 0 in Hz, or None for the highest peak"
        )
    chosen = record.select(
        None if output_name is None else [output_name], None if input_name is None else [input_name]
    )
    seen = np.isfinite(chosen.response[:, 0, 0])
    size, omegas = np.abs(chosen.response[seen, 0, 0]), record.omegas[seen]
    noise = 0.0 if chosen.variance is None else np.sqrt(np.nan_to_num(chosen.variance[seen, 0, 0]))
    surely = size - _SEEN * noise
    inner = np.arange(1, len(size) - 1)
    peaks = inner[(size[1:-1] >= size[:-2]) & (size[1:-1] > size[2:])]
    if not len(peaks):
        raise EstimationError(f"frequency record {record.name!r} has no peak between its first and last line")
    if near_hz is None:
        peak = int(peaks[np.argmax(surely[peaks])])
    else:
        peak = int(peaks[np.argmin(np.abs(omegas[peaks] - 2.0 * np.pi * near_hz))])
    if not surely[peak] > 0.0:
        raise EstimationError(
            f"the peak at {omegas[peak] / (2.0 * np.pi):.5g} Hz is less than {_SEEN:g} standard deviations high; "
            "measure for longer, or drive that band more"
        )
    level = size[peak] / math.sqrt(2.0)
    low, high = _crossing(omegas, size, level, peak, -1), _crossing(omegas, size, level, peak, 1)
    if low is None or high is None:
        raise EstimationError(
            f"the peak at {omegas[peak] / (2.0 * np.pi):.5g} Hz does not fall to half power on both sides; measure "
            "a wider band, or fit a model"
        )
    omega = float(omegas[peak])
    zeta = (high**2 - low**2) / (4.0 * omega**2)
    spacing = float(omegas[peak + 1] - omegas[peak - 1]) / 2.0
    offset = 0.5 * spacing / max(zeta * omega, 1e-300)
    # The width that is read is already too wide: solve for the true one behind the worst case.
    true = math.sqrt(max(1.0 - 2.0 * offset**2, 0.0))
    bias = 1.0 / true - 1.0 if true > 0.0 else math.inf
    zeta -= record.decay_rate / omega  # what an exponential window adds
    return HalfPowerDamping(omega, zeta, low, high, (high - low) / spacing, bias)


def _crossing(omegas: FloatArray, size: FloatArray, level: float, peak: int, step: int) -> float | None:
    place = peak
    while 0 <= place + step < len(size):
        if size[place + step] <= level:
            share = (size[place] - level) / (size[place] - size[place + step])
            return float(omegas[place] + share * (omegas[place + step] - omegas[place]))
        place += step
    return None
