"""What a fit of modes to frequency data says."""

from __future__ import annotations

from dataclasses import dataclass

from beam_ident.arrays import ComplexArray
from beam_ident.data.frequency_record import FrequencyRecord
from beam_ident.modal.identification_result import OrderEntry
from beam_ident.modal.model import ModalModel
from beam_ident.noise.line_misfit import LineMisfit


@dataclass(frozen=True, eq=False)
class FrequencyDomainResult:
    """A modal model from frequency data.

    Attributes
    ----------
    model : ModalModel
    records : tuple of FrequencyRecord
    modelled : tuple of complex ndarray, each (n_lines, n_outputs, 1)
        What the model says at the lines, foldings included.
    orders : tuple of OrderEntry -- scores are those of the weighed lines
    misfit : LineMisfit
    converged, reason, iterations
        How the last fit ended.
    warnings : tuple of str
    """

    model: ModalModel
    records: tuple[FrequencyRecord, ...]
    modelled: tuple[ComplexArray, ...]
    orders: tuple[OrderEntry, ...]
    misfit: LineMisfit
    converged: bool
    reason: str
    iterations: int
    warnings: tuple[str, ...]

    @property
    def residuals(self) -> tuple[ComplexArray, ...]:
        """Responses less what the model says, each (n_lines, n_outputs, 1); NaN where none was measured."""
        return tuple(own.response - said for own, said in zip(self.records, self.modelled, strict=True))
