"""Columns of the modal model at the lines of a frequency record.

Holds, exposures and folded lines enter through the record's ``Folding``: a line's column is the sum over all
frequencies that fall into its bin, equation (F.4) of ``docs/frequency-equations.md``, so that a response measured
through a zero-order hold, or above half the camera's rate, is compared with what the model would show there.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from beam_ident.arrays import ComplexArray, FloatArray, IndexArray
from beam_ident.data.frequency_record import FrequencyRecord
from beam_ident.errors import EstimationError
from beam_ident.modal.stacked_regression import ColumnBasis, Columns
from beam_ident.modal.structure import ModalStructure

_SCAN_IMAGE = 0.05  # of a line's own weight: what an image must have to move a maximum of the scan


class LineBasis(ColumnBasis):
    """Columns of a modal structure at the lines of one record, real parts above imaginary ones.

    Parameters
    ----------
    record : FrequencyRecord
    structure : ModalStructure
    is_late : bool -- whether derivatives by the instant are wanted, for a latency to be estimated
    """

    def __init__(self, record: FrequencyRecord, structure: ModalStructure, is_late: bool = True) -> None:
        self.structure, self.is_late = structure, is_late
        self.folding = record.folding
        s = record.s[:, None]
        weights = np.ones(s.shape, dtype=np.complex128)
        self.tails: ComplexArray | None = None
        if self.folding is not None:
            s = np.concatenate([s, 1j * self.folding.omegas], axis=1)
            weights = np.concatenate([weights, self.folding.weights], axis=1)
            self.tails = self.folding.tails
            lowest = 2 - (structure.differentiations if structure.has_residual else 0)
            if not np.all(np.isfinite(self.tails[:, lowest:])):
                raise EstimationError(
                    f"frequency record {record.name!r} comes from a held input, which jumps; the structure "
                    f"{structure.kind} differentiates it. Give the input hold='cubic', or has_residual=False"
                )
        self.s, self.weights = s, weights
        self._squares = s.imag**2 if record.decay_rate == 0.0 else -(s**2)
        # What every mode is multiplied by, and that once more times s: a fit asks for it many hundred times.
        self._front = weights * structure.sign * s**structure.differentiations
        self._rising = self._front * s
        self._last_fixed: tuple[float, Columns] | None = None
        # A mode falls as 1/omega^2 beyond the band: far images do not move a maximum of the scan.
        reach = np.minimum(1.0, record.omegas[-1] / np.abs(s)) ** 2
        self._scanned = np.flatnonzero(np.max(np.abs(weights) * reach, axis=0) > _SCAN_IMAGE)

    @property
    def seen_images(self) -> IndexArray:
        """Places of the images, among those of the folding, that a scan counts."""
        return np.asarray(self._scanned[self._scanned > 0] - 1)

    def _with_tails(self, lines: ComplexArray, expansion: Sequence[tuple[int, float]]) -> FloatArray:
        """Return a real column: the sum over all images, with the tails of (F.5) for those that are not listed."""
        if self.tails is not None:
            for power, factor in expansion:
                lines = lines + factor * self.tails[:, power + 2]
        return np.concatenate([lines.real, lines.imag])

    def _fixed_pair(self, exponent: int, factor: float, latency: float) -> list[FloatArray]:
        """Return the column ``factor s^exponent`` and its derivative by the instant, both real."""
        values = self.weights * (factor * self.s**exponent)
        if latency:
            values = values * np.exp(-self.s * latency)
        column = self._with_tails(np.sum(values, axis=1), [(-exponent, factor)])
        return [column, self._with_tails(np.sum(self.s * values, axis=1), ())]

    def fixed(self, latency: float) -> Columns:
        """Return direct gain and residual term, where the structure has them."""
        if self._last_fixed is None or self._last_fixed[0] != latency:
            self._last_fixed = latency, self._fixed_columns(latency)
        return self._last_fixed[1]

    def _fixed_columns(self, latency: float) -> Columns:
        structure, pairs = self.structure, []
        power = structure.differentiations
        if structure.has_direct:
            pairs.append(self._fixed_pair(power - 2, 1.0, latency))
        if structure.has_residual:
            pairs.append(self._fixed_pair(power, structure.sign, latency))
        if not pairs:
            empty = np.zeros((2 * len(self.s), 0))
            return Columns(empty, empty, empty, empty)
        value, by_time = (np.column_stack([pair[k] for pair in pairs]) for k in range(2))
        return Columns(value, value, value, by_time)

    def modal(self, omega: float, zeta: float, latency: float) -> Columns:
        """Return the column of one mode with its derivatives."""
        sign, power = self.structure.sign, self.structure.differentiations
        front, rising = self._front, self._rising
        if latency:
            late = np.exp(-self.s * latency)
            front, rising = front * late, rising * late
        inverse = 1.0 / ((omega**2 - self._squares) + (2.0 * zeta * omega) * self.s)
        squared = inverse * inverse
        lines = np.einsum("li,li->l", front, inverse)
        level, slope = -np.einsum("li,li->l", front, squared), -np.einsum("li,li->l", rising, squared)
        # Powers of 1/s in front / d(s) = sign s^p (s^-2 - 2 zeta omega s^-3 + (4 zeta^2 - 1) omega^2 s^-4 ..).
        third = (4.0 * zeta**2 - 1.0) * omega**2
        terms = [(2 - power, 1.0, 0.0, 0.0)]
        if power >= 1:
            terms.append((3 - power, -2.0 * zeta * omega, -2.0 * zeta * omega, -2.0 * omega))
        if power == 2:
            terms.append((4 - power, third, 2.0 * third, 8.0 * zeta * omega**2))
        expansions = [[(term[0], sign * term[k]) for term in terms] for k in (1, 2, 3)]
        column = self._with_tails(lines, expansions[0])
        by_omega = self._with_tails(2.0 * zeta * omega * slope + 2.0 * omega**2 * level, expansions[1])
        by_zeta = self._with_tails(2.0 * omega * slope, expansions[2])
        by_time = None
        if self.is_late:
            by_time = self._with_tails(np.einsum("li,li->l", rising, inverse), ())[:, None]
        return Columns(column[:, None], by_omega[:, None], by_zeta[:, None], by_time)

    def scanned(self, omegas: FloatArray, zetas: FloatArray, latency: float) -> FloatArray:
        """Return the columns of candidate modes, the weakest images left out."""
        total = np.zeros((len(omegas), 2, len(self.s)))
        for column in self._scanned:
            # In real numbers: 1 / (a + jb) = (a - jb) / (a^2 + b^2).
            w = self.s[:, column].imag
            factor = self._front[:, column] * np.exp(-self.s[:, column] * latency)
            stiff, lossy = omegas[:, None] ** 2 - w**2, (2.0 * zetas * omegas)[:, None] * w
            size = 1.0 / (stiff * stiff + lossy * lossy)
            stiff *= size
            lossy *= size
            total[:, 0] += factor.real * stiff + factor.imag * lossy
            total[:, 1] += factor.imag * stiff - factor.real * lossy
        return total.reshape(len(omegas), 1, -1)
