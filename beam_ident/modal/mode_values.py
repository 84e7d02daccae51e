"""What frequencies and damping ratios of modes say in other units, the same for all that find them."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from beam_ident.arrays import ComplexArray, FloatArray


class _OfModes(Protocol):
    """Natural frequencies [rad/s] and damping ratios, with their standard deviations, shape (n_modes,) each."""

    @property
    def natural_frequencies(self) -> FloatArray: ...
    @property
    def natural_frequency_sd(self) -> FloatArray: ...
    @property
    def damping_ratios(self) -> FloatArray: ...
    @property
    def damping_ratio_sd(self) -> FloatArray: ...


class ModeValues:
    """Modes in Hz and as poles."""

    @property
    def frequencies_hz(self: _OfModes) -> FloatArray:
        """Natural frequencies [Hz]."""
        return np.asarray(self.natural_frequencies / (2.0 * np.pi))

    @property
    def frequency_sd_hz(self: _OfModes) -> FloatArray:
        """Standard deviations of the natural frequencies [Hz]."""
        return np.asarray(self.natural_frequency_sd / (2.0 * np.pi))

    @property
    def poles(self: _OfModes) -> ComplexArray:
        """Upper poles [rad/s], shape (n_modes,)."""
        omega, zeta = self.natural_frequencies, self.damping_ratios
        return np.asarray(omega * (-zeta + 1j * np.sqrt(1.0 - zeta**2)))

    def modes(self: _OfModes) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return natural frequencies [rad/s], damping ratios and the standard deviations of both."""
        return self.natural_frequencies, self.damping_ratios, self.natural_frequency_sd, self.damping_ratio_sd
