"""Continuous-time identification of vibrating structures from sampled records."""

from beam_ident.batches import map_records
from beam_ident.closed_loop import ClosedLoopResult, SampledController, estimate_in_closed_loop
from beam_ident.common_pole_fit import CommonPoleResult, estimate_common_poles
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
from beam_ident.excitation import (
    AxisLimits,
    BandLimitedNoise,
    Doublet,
    ExcitationReport,
    HeldInput,
    LinearChirp,
    LogChirp,
    Multisine,
    PointToPoint,
    Prbs,
    Pulse,
    Recipe,
    SampledExcitation,
    Sine,
    Step,
    SteppedSine,
    excitation_report,
    predict_amplitudes,
)
from beam_ident.free_decay import FreeDecay, fit_free_decay
from beam_ident.frequency_domain_fit import FrequencyDomainResult, fit_frequency_modes
from beam_ident.frequency_domain_transfer_function import (
    FrequencyTransferFunctionResult,
    fit_frequency_transfer_function,
)
from beam_ident.frequency_record import FrequencyRecord
from beam_ident.identification import identify
from beam_ident.identification_result import IdentificationResult, OrderEntry, OutputFit
from beam_ident.modal_analysis import ModalAnalysis, StabilisationChart, analyse_modes, stabilisation_chart
from beam_ident.modal_fit import Prior
from beam_ident.modal_model import ModalFrequencyResponse, ModalModel
from beam_ident.modal_structure import ModalStructure
from beam_ident.multi_input_model import MultiInputModel
from beam_ident.order_selection import OrderSelection, StructureEntry, select_transfer_function
from beam_ident.records import InputSignal, OutputSignal, TimeRecord
from beam_ident.repeatability import Repeatability, assess_repeatability
from beam_ident.step_comparison import StepComparison, compare_step_responses
from beam_ident.subspace import SubspaceModel, subspace_model
from beam_ident.transfer_function import TransferFunctionModel
from beam_ident.transfer_function_fit import (
    MultiInputResult,
    TransferFunctionResult,
    estimate_transfer_function,
)
from beam_ident.validation import InputCorrelation, Scores, Whiteness

__all__ = [
    "AxisLimits",
    "BandLimitedNoise",
    "ClosedLoopResult",
    "CommonPoleResult",
    "Doublet",
    "EstimationError",
    "ExcitationError",
    "ExcitationLimitError",
    "ExcitationReport",
    "FreeDecay",
    "FrequencyDomainResult",
    "FrequencyRecord",
    "FrequencyTransferFunctionResult",
    "HeldInput",
    "IdentificationError",
    "IdentificationResult",
    "InputCorrelation",
    "InputSignal",
    "LinearChirp",
    "LogChirp",
    "ModalAnalysis",
    "ModalFrequencyResponse",
    "ModalModel",
    "ModalStructure",
    "ModelComparison",
    "ModelFormatError",
    "MultiInputModel",
    "MultiInputResult",
    "Multisine",
    "OrderEntry",
    "OrderSelection",
    "OutputFit",
    "OutputSignal",
    "OutputValidation",
    "PointToPoint",
    "Prbs",
    "Prior",
    "Pulse",
    "Recipe",
    "RecordError",
    "Repeatability",
    "SampledController",
    "SampledExcitation",
    "Scores",
    "Sine",
    "StabilisationChart",
    "Step",
    "StepComparison",
    "SteppedSine",
    "StructureEntry",
    "SubspaceModel",
    "TimeRecord",
    "TransferFunctionModel",
    "TransferFunctionResult",
    "ValidationResult",
    "Whiteness",
    "analyse_modes",
    "assess_repeatability",
    "compare_models",
    "compare_step_responses",
    "estimate_common_poles",
    "estimate_in_closed_loop",
    "estimate_transfer_function",
    "excitation_report",
    "fit_free_decay",
    "fit_frequency_modes",
    "fit_frequency_transfer_function",
    "identify",
    "map_records",
    "predict_amplitudes",
    "select_transfer_function",
    "stabilisation_chart",
    "subspace_model",
    "validate",
]
