"""What an excitation would do to a known model, and whether it resolves the model's modes.

A base that moves millimetres bends a resonant tip by centimetres: look before anything moves.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from beam_ident.data.records import InputSignal
from beam_ident.errors import ExcitationError, ExcitationLimitError
from beam_ident.excitation.recipe import Recipe
from beam_ident.excitation.sampled import HeldInput, Quantity, SampledExcitation

if TYPE_CHECKING:
    from beam_ident.modal.model import ModalModel

LINES_PER_BAND = 4.0
"""Fewer lines than this inside a half-power band, and a frequency response does not show the damping."""

_QUANTITIES: dict[str, Quantity] = {
    "base_motion": "position",
    "velocity": "velocity",
    "acceleration": "acceleration",
}


@dataclass(frozen=True)
class PredictedAmplitude:
    """Largest value that one output is predicted to reach.

    Attributes
    ----------
    output_name : str
    peak : float -- largest absolute value, in the output's unit
    peak_time_s : float -- when, from the start of the excitation [s]
    """

    output_name: str
    peak: float
    peak_time_s: float


def predict_amplitudes(
    excitation: SampledExcitation | HeldInput,
    model: ModalModel,
    limits: float | Mapping[str, float] | None = None,
) -> tuple[PredictedAmplitude, ...]:
    """Return the peak of every output of a model under an excitation, before it is used.

    Parameters
    ----------
    excitation : SampledExcitation or HeldInput
        A motion for a model whose input is a motion, a held input for a force or a receptance.
    model : ModalModel
    limits : float or mapping of str to float, optional
        Largest absolute value allowed, of every output or by name.

    Returns
    -------
    tuple of PredictedAmplitude -- in the order of the model's outputs

    Raises
    ------
    ExcitationError
        A motion for a model that takes a force, or the other way round; a limit for an unknown output.
    ExcitationLimitError
        An output would leave its limit; the message says by what to multiply the amplitude.

    Notes
    -----
    From rest, by linear theory, at the ticks of the excitation and two samples in every period of the
    highest mode where that is finer.
    """
    drive = _input_of(excitation, model)
    step = excitation.period_s
    if model.n_modes:
        step = min(step, 0.25 / float(np.max(model.frequencies_hz)))
    times = np.asarray(step * np.arange(1, math.floor(excitation.duration_s / step)), dtype=np.float64)
    outputs = np.abs(model.simulate(drive, times))
    where = np.argmax(outputs, axis=0)
    predicted = tuple(
        PredictedAmplitude(name, float(outputs[k, j]), float(times[k]))
        for j, (name, k) in enumerate(zip(model.output_names, where, strict=True))
    )
    _refuse(type(excitation.recipe).__name__, predicted, _limit_of_each(model, limits))
    return predicted


def _input_of(excitation: SampledExcitation | HeldInput, model: ModalModel) -> InputSignal:
    if model.further_inputs:
        raise ExcitationError(
            f"the model has the inputs {', '.join(model.input_names)}, and an excitation is one of them; give "
            f"path({model.input_name!r}) of the model, or of another input"
        )
    quantity = _QUANTITIES.get(model.structure)
    if isinstance(excitation, SampledExcitation):
        if quantity is None:
            raise ExcitationError(
                f"the model's structure is {model.structure!r}, which takes a held input, and the excitation is a "
                "motion; use recipe.sample_input(period_s, scale)"
            )
        return excitation.input_signal(quantity, model.input_name)
    if quantity is not None:
        raise ExcitationError(
            f"the model's structure is {model.structure!r}, which takes a motion, and the excitation is held in "
            f"{excitation.unit}; use recipe.sample(period_s)"
        )
    return excitation.input_signal()


def _limit_of_each(model: ModalModel, limits: float | Mapping[str, float] | None) -> dict[str, float]:
    if limits is None:
        return {}
    if not isinstance(limits, Mapping):
        limits = dict.fromkeys(model.output_names, limits)
    for name, limit in limits.items():
        if name not in model.output_names:
            raise ExcitationError(
                f"limits: {name!r} is not an output of the model; expected {', '.join(model.output_names)}"
            )
        if not limit > 0.0:
            raise ExcitationError(f"limits: {name} is {limit!r}; expected a number > 0")
    return dict(limits)


def _refuse(recipe: str, predicted: tuple[PredictedAmplitude, ...], limits: dict[str, float]) -> None:
    for amplitude in predicted:
        limit = limits.get(amplitude.output_name, math.inf)
        if not amplitude.peak <= limit:
            raise ExcitationLimitError(
                f"{recipe}: {amplitude.output_name} is predicted to reach {amplitude.peak:.4g} after "
                f"{amplitude.peak_time_s:.2f} s, above the limit of {limit:.4g}; lower the amplitude by a factor of "
                f"{limit / amplitude.peak:.3f} or sweep through the mode faster"
            )


@dataclass(frozen=True)
class HalfPowerBand:
    """How well an excitation resolves one mode.

    Attributes
    ----------
    frequency_hz : float -- natural frequency
    width_hz : float -- half-power band, ``2 zeta f``
    line_spacing_hz : float -- of the excitation, around the mode
    lines : float -- spacings inside the band
    is_resolved : bool -- whether there are at least four
    """

    frequency_hz: float
    width_hz: float
    line_spacing_hz: float

    @property
    def lines(self) -> float:
        """Spacings inside the half-power band."""
        return self.width_hz / self.line_spacing_hz if self.line_spacing_hz > 0.0 else math.inf

    @property
    def is_resolved(self) -> bool:
        """Whether a frequency response shows the damping of this mode."""
        return self.lines >= LINES_PER_BAND


def resolution_warning(bands: Sequence[HalfPowerBand]) -> str | None:
    """Return which modes the excitation does not resolve and what would mend it, or None.

    Parameters
    ----------
    bands : sequence of HalfPowerBand -- of the modes that it drives
    """
    poor = [band for band in bands if not band.is_resolved]
    if not poor:
        return None
    plural, their = ("s", "their") if len(poor) > 1 else ("", "its")
    need = min(band.width_hz for band in poor) / LINES_PER_BAND
    return (
        f"mode{plural} at {_listed([f'{band.frequency_hz:.4g}' for band in poor])} Hz: "
        f"{_listed([f'{band.lines:.2g}' for band in poor])} lines in {their} half-power band{plural} of "
        f"{_listed([f'{band.width_hz:.3g}' for band in poor])} Hz, where {LINES_PER_BAND:g} are needed; a frequency "
        f"response does not show {their} damping: lines every {need:.3g} Hz, from {1.0 / need:.3g} s of record or "
        "period, would; a parametric fit of the time data needs less"
    )


def _listed(words: Sequence[str]) -> str:
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)


def half_power_bands(
    recipe: Recipe, natural_frequencies: ArrayLike, damping_ratios: ArrayLike
) -> tuple[HalfPowerBand, ...]:
    """Compare the lines of an excitation with the half-power bands of known modes.

    Parameters
    ----------
    recipe : Recipe
    natural_frequencies : array_like, shape (n_modes,) -- [rad/s]
    damping_ratios : array_like, shape (n_modes,)

    Notes
    -----
    A record of length T resolves frequencies 1 / T apart; of a periodic signal, only its excited lines
    carry information, so that more periods do not resolve more.
    """
    frequencies = np.asarray(natural_frequencies, dtype=np.float64).ravel() / (2.0 * np.pi)
    ratios = np.asarray(damping_ratios, dtype=np.float64).ravel()
    if frequencies.shape != ratios.shape or not (
        np.all(np.isfinite(frequencies) & (frequencies > 0.0))
        and np.all(np.isfinite(ratios) & (ratios > 0.0))
    ):
        raise ExcitationError(
            f"modes: {frequencies.size} natural frequencies and {ratios.size} damping ratios; expected as many of "
            "each, all finite and > 0"
        )
    return tuple(
        HalfPowerBand(float(f), float(2.0 * zeta * f), float(recipe.line_spacing_hz(float(f))))
        for f, zeta in zip(frequencies, ratios, strict=True)
    )
