"""What a fit of free decays says: modes without an input."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from beam_ident.arrays import ComplexArray, FloatArray
from beam_ident.data.stored_form import ADDED_LATER, read, require_shapes, written
from beam_ident.modal.identification_result import OrderEntry
from beam_ident.modal.mode_values import ModeValues
from beam_ident.noise.scores import Scores, Whiteness
from beam_ident.summary import SummarisedModes, SummaryPart, modes_table, result_parts

SCHEMA = 2


@dataclass(frozen=True)
class Harmonic:
    """What rings, and is no mode but a product of modes: something bends on the way to the samples.

    Attributes
    ----------
    makers : tuple of int -- the modes that make it, from 0
    times : tuple of int -- how often each is in its frequency and its phase
    factors : tuple of int -- how often each is in its decay rate
    frequency_hz : float
    amplitudes : tuple of float -- at every output, when the decay begins
    """

    makers: tuple[int, ...]
    times: tuple[int, ...]
    factors: tuple[int, ...]
    frequency_hz: float
    amplitudes: tuple[float, ...]

    @property
    def formula(self) -> str:
        """Its frequency and decay rate in words, as "2 f1, decays by 2 s1"."""
        of = list(zip(self.times, self.factors, self.makers, strict=True))
        frequency = " ".join(f"{times:+d} f{maker + 1}" for times, _, maker in of).removeprefix("+")
        return f"{frequency}, decays by " + " + ".join(f"{factors} s{maker + 1}" for _, factors, maker in of)


@dataclass(frozen=True, eq=False, repr=False)
class FreeDecay(SummarisedModes, ModeValues):
    """Modes of a free decay.

    Attributes
    ----------
    natural_frequencies, natural_frequency_sd : ndarray, shape (n_modes,) -- [rad/s]
    damping_ratios, damping_ratio_sd : ndarray, shape (n_modes,)
    covariance : ndarray, shape (2 n_modes, 2 n_modes) -- of frequencies and damping ratios
    amplitudes : complex ndarray, shape (n_outputs, n_modes)
        At ``start_s``; their real part is the displacement, their size the envelope. 0 where a mode does not show.
    offsets : ndarray, shape (n_outputs,) -- the drift's mean
    start_s : float -- instant of the first sample used [s]
    output_names : tuple of str
    times_s, measured, modelled, residuals : tuple of ndarray -- of every output, the samples used
    noise_sd : ndarray, shape (n_outputs,)
    scores : tuple of Scores
    whiteness : tuple of Whiteness
    orders : tuple of OrderEntry
    converged : bool
    reason : str
    iterations : int
    warnings : tuple of str -- what a reader must know before trusting the numbers
    harmonics : tuple of Harmonic -- what rings and is no mode, by frequency
    """

    natural_frequencies: FloatArray
    natural_frequency_sd: FloatArray
    damping_ratios: FloatArray
    damping_ratio_sd: FloatArray
    covariance: FloatArray
    amplitudes: ComplexArray
    offsets: FloatArray
    start_s: float
    output_names: tuple[str, ...]
    times_s: tuple[FloatArray, ...]
    measured: tuple[FloatArray, ...]
    modelled: tuple[FloatArray, ...]
    residuals: tuple[FloatArray, ...]
    noise_sd: FloatArray
    scores: tuple[Scores, ...]
    whiteness: tuple[Whiteness, ...]
    orders: tuple[OrderEntry, ...]
    converged: bool
    reason: str
    iterations: int
    warnings: tuple[str, ...]
    harmonics: tuple[Harmonic, ...] = field(default=(), metadata=ADDED_LATER)

    def summary_parts(self) -> list[SummaryPart]:
        """Return the summary's tables and sentences."""
        table = modes_table(*self.modes())
        return [table, *result_parts(self, (), self.output_names)]

    @property
    def logarithmic_decrements(self) -> FloatArray:
        """Logarithm of the ratio of two successive maxima, ``2 pi zeta / sqrt(1 - zeta^2)``."""
        zeta = self.damping_ratios
        return np.asarray(2.0 * np.pi * zeta / np.sqrt(1.0 - zeta**2))

    @property
    def logarithmic_decrement_sd(self) -> FloatArray:
        """Standard deviations of the logarithmic decrements."""
        return np.asarray(2.0 * np.pi * self.damping_ratio_sd / (1.0 - self.damping_ratios**2) ** 1.5)

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain lists and numbers, from which it is rebuilt exactly (also through JSON)."""
        return written(self, "free_decay", SCHEMA)

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> FreeDecay:
        """Rebuild what ``to_dict`` wrote.

        Raises
        ------
        ModelFormatError
            Another type or schema, a missing entry, or entries that do not agree.
        """
        found = read(FreeDecay, data, "free_decay", SCHEMA)
        n, m = len(found.natural_frequencies), len(found.output_names)
        modal = ("natural_frequency_sd", "damping_ratios", "damping_ratio_sd")
        shapes = {"covariance": (2 * n, 2 * n), "amplitudes": (m, n), "offsets": (m,), "noise_sd": (m,)}
        require_shapes("free decay", found, {**shapes, **dict.fromkeys(modal, (n,))})
        return found
