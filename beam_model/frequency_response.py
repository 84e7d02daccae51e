"""Frequency responses as objects: frequencies, outputs and values together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from beam_model.arrays import ComplexArray, FloatArray


@dataclass(frozen=True)
class FrequencyResponse:
    """A response from one input to several heights of the beam.

    Attributes
    ----------
    omegas : ndarray, shape (n_frequencies,)
        [rad/s]
    heights : ndarray, shape (n_heights,)
        Above the clamp [m].
    values : ndarray of complex, shape (n_frequencies, n_heights)
        Output per input; time dependence exp(+j omega t).
    quantity : str
        displacement (u), deflection (w), slope, curvature or hub.
    input_unit : str
        "m" for a hub position, "N" for a force on the hub.
    """

    omegas: FloatArray
    heights: FloatArray
    values: ComplexArray
    quantity: str
    input_unit: str

    @property
    def magnitude(self) -> FloatArray:
        """Absolute values, shape (n_frequencies, n_heights)."""
        return np.abs(self.values)

    @property
    def phase(self) -> FloatArray:
        """Unwrapped phases [rad], shape (n_frequencies, n_heights)."""
        return np.unwrap(np.angle(self.values), axis=0)
