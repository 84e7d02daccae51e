"""What a best linear approximation is: a response, and what scatters about it line by line."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from beam_ident.arrays import ComplexArray, FloatArray, IndexArray
from beam_ident.best_linear.variance_bands import difference_band, variance_band
from beam_ident.data.frequency_record import Folding, FrequencyRecord
from beam_ident.data.stored_form import read, require_shapes, written
from beam_ident.errors import EstimationError
from beam_ident.responses.detection_lines import NonlinearDistortion
from beam_ident.responses.periods import ENOUGH_FREEDOM, moving_mean

SCHEMA = 1


@dataclass(frozen=True, eq=False)
class LineVariances:
    """What scatters at lines about what is linear, as variances of the response that one realisation shows.

    Attributes
    ----------
    omegas : ndarray, shape (n_lines,) -- [rad/s]
    total : ndarray, shape (n_lines, n_outputs) -- ``E |error|^2`` from realisation to realisation
    noise : ndarray, shape (n_lines, n_outputs) -- of a realisation's mean period, from the scatter between periods
    total_freedom, noise_freedom : ndarray, shape (n_lines,) -- real degrees of freedom of both
    """

    omegas: FloatArray
    total: FloatArray
    noise: FloatArray
    total_freedom: FloatArray
    noise_freedom: FloatArray

    @property
    def frequencies_hz(self) -> FloatArray:
        """Frequencies of the lines [Hz]."""
        return np.asarray(self.omegas / (2.0 * np.pi))

    @property
    def distortion(self) -> FloatArray:
        """Variance that the noise does not explain, at least 0, shape (n_lines, n_outputs)."""
        return np.asarray(np.maximum(self.total - self.noise, 0.0))

    def total_band(self, level: float = 0.95) -> FloatArray:
        """Return the band of the total variance, shape (2, n_lines, n_outputs)."""
        return variance_band(self.total, self.total_freedom[:, None], level)

    def noise_band(self, level: float = 0.95) -> FloatArray:
        """Return the band of the noise's variance, shape (2, n_lines, n_outputs)."""
        return variance_band(self.noise, self.noise_freedom[:, None], level)

    def distortion_band(self, level: float = 0.95) -> FloatArray:
        """Return the band of the distortion's variance, shape (2, n_lines, n_outputs)."""
        return difference_band(
            self.total, self.total_freedom[:, None], self.noise, self.noise_freedom[:, None], level
        )


@dataclass(frozen=True, eq=False)
class BestLinearApproximation:
    """A best linear approximation, its noise and its distortion.

    Attributes
    ----------
    omegas : ndarray, shape (n_lines,) -- of the excited lines [rad/s]
    response : complex ndarray, shape (n_lines, n_outputs)
    total_covariance, noise_covariance : complex ndarray, shape (n_lines, n_outputs, n_outputs)
        ``E error error^H`` of the response: of everything that realisations differ by, and of the noise alone. Line
        by line, not smoothed.
    n_realisations : ndarray of int, shape (n_lines,) -- in how many each line was excited
    n_periods : tuple of int -- of each realisation, that were used
    skipped_periods : int -- left out at the beginning of each
    excited, even, odd : LineVariances or None
        At the excited lines, and at the even and the odd detection lines; None where there are none.
    input_power : ndarray, shape (n_lines,) -- ``|U|^2`` behind the response, of two-sided Fourier coefficients
    distortion : NonlinearDistortion or None -- the test on all detection lines together; None without such lines
    p_value : float -- of the F test whether noise explains what realisations differ by, over all excited lines
    verdict : str
    input_name : str
    reference_name : str -- empty where none was given
    input_unit : str
    output_names, output_units : tuple of str
    line_period_s : float
    folding : Folding or None
    name : str
    warnings : tuple of str
    """

    omegas: FloatArray
    response: ComplexArray
    total_covariance: ComplexArray
    noise_covariance: ComplexArray
    n_realisations: IndexArray
    n_periods: tuple[int, ...]
    skipped_periods: int
    excited: LineVariances
    even: LineVariances | None
    odd: LineVariances | None
    input_power: FloatArray
    distortion: NonlinearDistortion | None
    p_value: float
    verdict: str
    input_name: str
    reference_name: str
    input_unit: str
    output_names: tuple[str, ...]
    output_units: tuple[str, ...]
    line_period_s: float
    folding: Folding | None
    name: str
    warnings: tuple[str, ...]

    @property
    def frequencies_hz(self) -> FloatArray:
        """Frequencies of the excited lines [Hz]."""
        return np.asarray(self.omegas / (2.0 * np.pi))

    def record(self, variance: Literal["total", "noise"] = "total") -> FrequencyRecord:
        """Return the response for a fit.

        Parameters
        ----------
        variance : {"total", "noise"}
            Which covariance goes along. With the total one, intervals of a model hold for another realisation of the
            excitation, too; with the noise alone, only for these.

        Raises
        ------
        EstimationError
            Another word.

        Notes
        -----
        Weights need more freedom than a few realisations give at one line. The noise's covariance is averaged over
        neighbouring lines, and so is the distortion's, in proportion to the response: it passes the same resonances.
        """
        if variance not in ("total", "noise"):
            raise EstimationError(f"variance is {variance!r}; expected 'total' or 'noise'")
        size = 1.0 / self.n_realisations / self.input_power
        by_output = self.noise_covariance / size[:, None, None]
        of_noise = float(np.min(self.excited.noise_freedom)) / 2.0
        width = _width(of_noise, len(self.omegas))
        covariance: ComplexArray = np.asarray(
            moving_mean(by_output, width) * size[:, None, None], dtype=np.complex128
        )
        freedom = width * of_noise
        if variance == "total":
            of_total = float(np.min(self.excited.total_freedom)) / 2.0
            width = _width(of_total, len(self.omegas))
            covariance = covariance + self._smooth_distortion(width)
            freedom = width * of_total
        return FrequencyRecord(
            omegas=self.omegas,
            response=self.response,
            covariance=covariance,
            output_names=self.output_names,
            input_names=(self.input_name,),
            output_units=self.output_units,
            input_units=(self.input_unit,),
            degrees_of_freedom=freedom,
            method=f"best linear approximation of {len(self.n_periods)} realisations, {variance} variance",
            folding=self.folding,
            name=self.name,
            warnings=self.warnings,
        )

    def _smooth_distortion(self, width: int) -> ComplexArray:
        """Return the response's covariance by distortion, from neighbouring lines in proportion to the response."""
        left = (self.total_covariance - self.noise_covariance) * self.n_realisations[:, None, None]
        size = np.abs(self.response)
        turn = self.response / np.maximum(size, 1e-300)
        pairs = size[:, :, None] * size[:, None, :]
        turns = turn[:, :, None] * np.conj(turn[:, None, :])
        share = moving_mean(left * np.conj(turns), width) / np.maximum(moving_mean(pairs, width), 1e-300)
        # What is left after a subtraction may be negative; nothing less than nothing scatters.
        values, vectors = np.linalg.eigh(share)
        positive = (vectors * np.maximum(values, 0.0)[:, None, :]) @ np.conj(np.swapaxes(vectors, 1, 2))
        return np.asarray(positive * pairs * turns / self.n_realisations[:, None, None])

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain lists and numbers, from which it is rebuilt exactly (also through JSON)."""
        return written(self, "best_linear_approximation", SCHEMA)

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> BestLinearApproximation:
        """Rebuild what ``to_dict`` wrote.

        Raises
        ------
        ModelFormatError
            Another type or schema, a missing entry, or entries that do not agree.
        """
        found = read(BestLinearApproximation, data, "best_linear_approximation", SCHEMA)
        n, outputs = len(found.omegas), len(found.output_names)
        shapes = {
            "response": (n, outputs),
            "total_covariance": (n, outputs, outputs),
            "noise_covariance": (n, outputs, outputs),
            "n_realisations": (n,),
            "input_power": (n,),
        }
        require_shapes("best linear approximation", found, shapes)
        return found


def _width(freedom: float, n_lines: int) -> int:
    """Return over how many lines a variance is averaged."""
    return int(min(np.ceil(ENOUGH_FREEDOM / freedom), n_lines))
