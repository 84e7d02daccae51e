"""The figures of a sampled excitation in one object: levels, crest factors, spectrum, modes.

Nothing is drawn here; figures are made from the object elsewhere.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.design.prediction import (
    HalfPowerBand,
    PredictedAmplitude,
    half_power_bands,
    predict_amplitudes,
    resolution_warning,
)
from beam_ident.excitation.crest_optimisation import crest_factor
from beam_ident.excitation.recipe import Recipe
from beam_ident.excitation.sampled import UNITS, HeldInput, SampledExcitation

if TYPE_CHECKING:
    from beam_ident.modal.model import ModalModel

_BAND_FLOOR = 0.01  # of the highest density: the band reaches 20 dB down
_SMOOTHING = 9  # spectral lines averaged to find the band: one line of a chirp or of noise says little


@dataclass(frozen=True)
class SignalLevel:
    """Level of one quantity while the excitation is active.

    Attributes
    ----------
    quantity, unit : str
    peak, rms : float -- in ``unit``, over the active stretch
    crest_factor : float -- peak over rms
    """

    quantity: str
    unit: str
    peak: float
    rms: float
    crest_factor: float


@dataclass(frozen=True, eq=False)
class ExcitationReport:
    """What a sampled excitation is, before it is used.

    Attributes
    ----------
    recipe : Recipe
    period_s, duration_s, active_s : float
        Hold, whole length, and length until nothing moves any more [s].
    levels : tuple of SignalLevel
        Acceleration, velocity and position; or the held quantity alone.
    frequencies_hz : ndarray, shape (n_frequencies,) -- from 0 to half the rate
    energy_density : ndarray, shape (n_frequencies,)
        One-sided energy density of the acceleration [(m/s^2)^2 s/Hz], or of the held quantity [unit^2 s/Hz]; its
        integral is the integral of the squared signal over time.
    band_hz : tuple of float -- where the smoothed density is within 20 dB of its highest value
    modes : tuple of HalfPowerBand -- of the given model, else empty
    amplitudes : tuple of PredictedAmplitude -- of the given model, else empty
    warnings : tuple of str
    """

    recipe: Recipe
    period_s: float
    duration_s: float
    active_s: float
    levels: tuple[SignalLevel, ...]
    frequencies_hz: FloatArray
    energy_density: FloatArray
    band_hz: tuple[float, float]
    modes: tuple[HalfPowerBand, ...]
    amplitudes: tuple[PredictedAmplitude, ...]
    warnings: tuple[str, ...]

    def __str__(self) -> str:
        """Return the figures as lines of text."""
        low, high = self.band_hz
        lines = [
            f"{self.recipe.kind}: {self.duration_s:.3f} s, active for {self.active_s:.3f} s, held over "
            f"{self.period_s * 1e3:g} ms, {low:.3g} to {high:.3g} Hz",
        ]
        lines += [
            f"  {level.quantity:<13} peak {level.peak:.4g}, rms {level.rms:.4g} {level.unit}, "
            f"crest factor {level.crest_factor:.2f}"
            for level in self.levels
        ]
        lines += [
            f"  mode at {mode.frequency_hz:.4g} Hz: half-power band {mode.width_hz:.3g} Hz, "
            f"{mode.lines:.2g} lines in it"
            for mode in self.modes
        ]
        lines += [f"  {a.output_name}: predicted to reach {a.peak:.4g}" for a in self.amplitudes]
        lines += [f"  warning: {warning}" for warning in self.warnings]
        return "\n".join(lines)


def excitation_report(
    excitation: SampledExcitation | HeldInput,
    model: ModalModel | None = None,
    amplitude_limits: float | Mapping[str, float] | None = None,
) -> ExcitationReport:
    """Collect levels, crest factors and spectrum, and what a known model makes of the excitation.

    Parameters
    ----------
    excitation : SampledExcitation or HeldInput
    model : ModalModel, optional
        Gives the half-power bands and the predicted amplitudes.
    amplitude_limits : float or mapping, optional -- as in ``predict_amplitudes``

    Raises
    ------
    ExcitationError, ExcitationLimitError
        As ``predict_amplitudes``.
    """
    held = excitation.accelerations if isinstance(excitation, SampledExcitation) else excitation.values
    n_active = int(np.flatnonzero(held)[-1]) + 1 if np.any(held) else len(held)
    if isinstance(excitation, SampledExcitation):
        levels = tuple(
            _level(quantity, UNITS[quantity], values[: n_active + extra])
            for quantity, values, extra in (
                ("acceleration", excitation.accelerations, 0),
                ("velocity", excitation.velocities, 1),
                ("position", excitation.positions, 1),
            )
        )
    else:
        levels = (_level(excitation.name, excitation.unit, held[:n_active]),)
    period = excitation.period_s
    frequencies = np.asarray(np.fft.rfftfreq(len(held), period), dtype=np.float64)
    density = 2.0 * np.abs(period * np.fft.rfft(held)) ** 2
    density[0] *= 0.5
    if len(held) % 2 == 0:
        density[-1] *= 0.5
    band = _band(frequencies, density)
    modes: tuple[HalfPowerBand, ...] = ()
    amplitudes: tuple[PredictedAmplitude, ...] = ()
    warnings: list[str] = []
    if model is not None:
        modes = half_power_bands(excitation.recipe, model.natural_frequencies, model.damping_ratios)
        amplitudes = predict_amplitudes(excitation, model, amplitude_limits)
        warnings += [said] if (said := resolution_warning(modes)) else []
        warnings += [
            f"mode at {mode.frequency_hz:.4g} Hz: outside the excited band of {band[0]:.3g} to {band[1]:.3g} Hz"
            for mode in modes
            if not band[0] <= mode.frequency_hz <= band[1]
        ]
    return ExcitationReport(
        excitation.recipe,
        period,
        excitation.duration_s,
        n_active * period,
        levels,
        frequencies,
        density,
        band,
        modes,
        amplitudes,
        tuple(warnings),
    )


def _level(quantity: str, unit: str, values: FloatArray) -> SignalLevel:
    rms = float(np.sqrt(np.mean(values**2)))
    return SignalLevel(quantity, unit, float(np.max(np.abs(values))), rms, crest_factor(values))


def _band(frequencies_hz: FloatArray, density: FloatArray) -> tuple[float, float]:
    width = min(_SMOOTHING, len(density))
    smoothed = np.convolve(density, np.full(width, 1.0 / width), mode="same")
    inside = np.flatnonzero(smoothed >= _BAND_FLOOR * np.max(smoothed))
    return float(frequencies_hz[inside[0]]), float(frequencies_hz[inside[-1]])
