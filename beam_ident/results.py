"""What every result promises, whatever estimated it: the contract that reports, figures and ``beam identify`` read.

Every result is a ``Result``. One from samples is also a ``TimeResult``, one from lines of a frequency response
also a ``LineResult``. No class has to inherit from these: whatever has the members keeps the promise
(``isinstance`` asks for their names, mypy for their types, and the tests for what they mean).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol, TypeVar, runtime_checkable

if TYPE_CHECKING:
    from typing import TypeAlias

    from beam_ident.arrays import ComplexArray, FloatArray
    from beam_ident.modal.free_decay_result import FreeDecay
    from beam_ident.modal.identification_result import FrequencyDomainResult, IdentificationResult
    from beam_ident.modal_analysis.refinement import ModalAnalysis
    from beam_ident.noise.line_misfit import LineMisfit
    from beam_ident.noise.scores import Scores, Whiteness
    from beam_ident.subspace.model import SubspaceModel
    from beam_ident.transfer_function_estimation.clsrivc import ClosedLoopResult
    from beam_ident.transfer_function_estimation.common_poles import (
        CommonPoleResult,
        MultiInputCommonPoleResult,
    )
    from beam_ident.transfer_function_estimation.estimation import (
        MultiInputResult,
        SeparateOutputsResult,
        TransferFunctionResult,
    )
    from beam_ident.transfer_function_estimation.frequency_domain import FrequencyTransferFunctionResult

Values = TypeVar("Values", covariant=True)
Agreement = TypeVar("Agreement", covariant=True)
Test = TypeVar("Test", covariant=True)


@runtime_checkable
class Result(Protocol):
    """How an estimation ended."""

    @property
    def converged(self) -> bool:
        """Whether the estimation came to its end."""

    @property
    def reason(self) -> str:
        """Why it ended."""

    @property
    def iterations(self) -> int:
        """How many iterations it took; 0 where there are none."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """What must be known before the numbers are trusted; empty where nothing is."""


@runtime_checkable
class TimeResult(Result, Protocol[Values, Agreement, Test]):
    """A result from samples: one array of each, or a tuple with one for every output of the record."""

    @property
    def times_s(self) -> Values:
        """Stamps of the samples that were used [s]."""

    @property
    def measured(self) -> Values:
        """The samples."""

    @property
    def modelled(self) -> Values:
        """What the model says there."""

    @property
    def residuals(self) -> Values:
        """Measured less modelled."""

    @property
    def scores(self) -> Agreement:
        """FIT and R_T^2."""

    @property
    def whiteness(self) -> Test:
        """The test of the residuals."""


@runtime_checkable
class LineResult(Result, Protocol[Values]):
    """A result from lines of a frequency response: one complex array, or a tuple with one for every record."""

    @property
    def modelled(self) -> Values:
        """What the model says at the lines."""

    @property
    def residuals(self) -> Values:
        """Measured response less that."""

    @property
    def misfit(self) -> LineMisfit:
        """Squared residuals against what the known noise alone would leave."""


if TYPE_CHECKING:
    OneOutputResult: TypeAlias = TimeResult[FloatArray, Scores, Whiteness]
    OutputsResult: TypeAlias = TimeResult[tuple[FloatArray, ...], tuple[Scores, ...], tuple[Whiteness, ...]]
    OneRecordResult: TypeAlias = LineResult[ComplexArray]
    RecordsResult: TypeAlias = LineResult[tuple[ComplexArray, ...]]
    # mypy holds every result class of the library against its contract here.
    _one_output: tuple[type[OneOutputResult], ...] = (
        TransferFunctionResult,
        MultiInputResult,
        ClosedLoopResult,
    )
    _outputs: tuple[type[OutputsResult], ...] = (
        IdentificationResult,
        CommonPoleResult,
        MultiInputCommonPoleResult,
        SeparateOutputsResult,
        SubspaceModel,
        FreeDecay,
    )
    _one_record: tuple[type[OneRecordResult], ...] = (FrequencyTransferFunctionResult, ModalAnalysis)
    _records: tuple[type[RecordsResult], ...] = (FrequencyDomainResult,)
