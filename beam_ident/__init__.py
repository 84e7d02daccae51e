"""Continuous-time identification of vibrating structures from sampled records."""

from beam_ident.closed_loop import ClosedLoopResult, SampledController, estimate_in_closed_loop
from beam_ident.comparison import ModelComparison, compare_models
from beam_ident.cross_validation import OutputValidation, ValidationResult, validate
from beam_ident.errors import (
    EstimationError,
    ExcitationError,
    ExcitationLimitError,
    IdentificationError,
    ModelFormatError,
    RecordError,
)
from beam_ident.excitation import AxisLimits, LogChirp, Multisine, Recipe, SampledExcitation, Step
from beam_ident.identification import IdentificationResult, OrderEntry, OutputFit, identify
from beam_ident.modal_fit import Prior
from beam_ident.modal_model import ModalFrequencyResponse, ModalModel
from beam_ident.modal_structure import ModalStructure
from beam_ident.records import InputSignal, OutputSignal, TimeRecord
from beam_ident.subspace import SubspaceModel, subspace_model
from beam_ident.transfer_function import TransferFunctionModel
from beam_ident.transfer_function_fit import TransferFunctionResult, estimate_transfer_function
from beam_ident.validation import InputCorrelation, Scores, Whiteness

__all__ = [
    "AxisLimits",
    "ClosedLoopResult",
    "EstimationError",
    "ExcitationError",
    "ExcitationLimitError",
    "IdentificationError",
    "IdentificationResult",
    "InputCorrelation",
    "InputSignal",
    "LogChirp",
    "ModalFrequencyResponse",
    "ModalModel",
    "ModalStructure",
    "ModelComparison",
    "ModelFormatError",
    "Multisine",
    "OrderEntry",
    "OutputFit",
    "OutputSignal",
    "OutputValidation",
    "Prior",
    "Recipe",
    "RecordError",
    "SampledController",
    "SampledExcitation",
    "Scores",
    "Step",
    "SubspaceModel",
    "TimeRecord",
    "TransferFunctionModel",
    "TransferFunctionResult",
    "ValidationResult",
    "Whiteness",
    "compare_models",
    "estimate_in_closed_loop",
    "estimate_transfer_function",
    "identify",
    "subspace_model",
    "validate",
]
