"""The frequency response of an identified modal model, with bands."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from beam_ident.arrays import ComplexArray, FloatArray


@dataclass(frozen=True, eq=False)
class ModalFrequencyResponse:
    """Frequency response of a model, with the uncertainty of the model's parameters.

    Attributes
    ----------
    omegas : ndarray, shape (n_frequencies,) -- [rad/s]
    output_names : tuple of str
    response : complex ndarray, shape (n_frequencies, n_outputs)
    covariance : ndarray, shape (n_frequencies, n_outputs, 2, 2)
        Covariance of real and imaginary part.
    """

    omegas: FloatArray
    output_names: tuple[str, ...]
    response: ComplexArray
    covariance: FloatArray

    @property
    def magnitude_sd(self) -> FloatArray:
        """Standard deviation of the magnitude, shape (n_frequencies, n_outputs)."""
        unit = self._unit
        variance = np.einsum("foa,foab,fob->fo", unit, self.covariance, unit)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))

    @property
    def phase_sd(self) -> FloatArray:
        """Standard deviation of the phase [rad], shape (n_frequencies, n_outputs)."""
        unit = self._unit
        across = np.stack([-unit[..., 1], unit[..., 0]], axis=-1)
        variance = np.einsum("foa,foab,fob->fo", across, self.covariance, across)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)) / np.maximum(np.abs(self.response), 1e-300))

    @property
    def _unit(self) -> FloatArray:
        size = np.maximum(np.abs(self.response), 1e-300)
        return np.stack([self.response.real / size, self.response.imag / size], axis=-1)
