"""Continuous-time identification of vibrating structures from sampled records.

Every name is loaded from its module when it is first asked for: whoever makes a record or an excitation
does not wait for SciPy and the estimators.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # the same names as below, for tools that read the code without running it
    from beam_ident.batches import map_records as map_records
    from beam_ident.closed_loop import ClosedLoopResult as ClosedLoopResult
    from beam_ident.closed_loop import estimate_in_closed_loop as estimate_in_closed_loop
    from beam_ident.common_pole_fit import CommonPoleResult as CommonPoleResult
    from beam_ident.common_pole_fit import estimate_common_poles as estimate_common_poles
    from beam_ident.comparison import ModelComparison as ModelComparison
    from beam_ident.comparison import compare_models as compare_models
    from beam_ident.cross_validation import OutputValidation as OutputValidation
    from beam_ident.cross_validation import ValidationResult as ValidationResult
    from beam_ident.cross_validation import validate as validate
    from beam_ident.detection_lines import DistortionLevel as DistortionLevel
    from beam_ident.detection_lines import NonlinearDistortion as NonlinearDistortion
    from beam_ident.detection_lines import nonlinear_distortion as nonlinear_distortion
    from beam_ident.errors import EstimationError as EstimationError
    from beam_ident.errors import ExcitationError as ExcitationError
    from beam_ident.errors import ExcitationLimitError as ExcitationLimitError
    from beam_ident.errors import IdentificationError as IdentificationError
    from beam_ident.errors import ModelFormatError as ModelFormatError
    from beam_ident.errors import RecordError as RecordError
    from beam_ident.excitation import AxisLimits as AxisLimits
    from beam_ident.excitation import BandLimitedNoise as BandLimitedNoise
    from beam_ident.excitation import Doublet as Doublet
    from beam_ident.excitation import ExcitationReport as ExcitationReport
    from beam_ident.excitation import HeldInput as HeldInput
    from beam_ident.excitation import LinearChirp as LinearChirp
    from beam_ident.excitation import LogChirp as LogChirp
    from beam_ident.excitation import Multisine as Multisine
    from beam_ident.excitation import PointToPoint as PointToPoint
    from beam_ident.excitation import Prbs as Prbs
    from beam_ident.excitation import Pulse as Pulse
    from beam_ident.excitation import Recipe as Recipe
    from beam_ident.excitation import SampledExcitation as SampledExcitation
    from beam_ident.excitation import Sine as Sine
    from beam_ident.excitation import Step as Step
    from beam_ident.excitation import SteppedSine as SteppedSine
    from beam_ident.excitation import crest_factor as crest_factor
    from beam_ident.excitation import describe_recipe as describe_recipe
    from beam_ident.excitation import excitation_report as excitation_report
    from beam_ident.excitation import half_power_bands as half_power_bands
    from beam_ident.excitation import predict_amplitudes as predict_amplitudes
    from beam_ident.free_decay import FreeDecay as FreeDecay
    from beam_ident.free_decay import fit_free_decay as fit_free_decay
    from beam_ident.frequency_domain_fit import FrequencyDomainResult as FrequencyDomainResult
    from beam_ident.frequency_domain_fit import fit_frequency_modes as fit_frequency_modes
    from beam_ident.frequency_domain_transfer_function import (
        FrequencyTransferFunctionResult as FrequencyTransferFunctionResult,
    )
    from beam_ident.frequency_domain_transfer_function import (
        fit_frequency_transfer_function as fit_frequency_transfer_function,
    )
    from beam_ident.frequency_record import FrequencyRecord as FrequencyRecord
    from beam_ident.frequency_response import local_polynomial_response as local_polynomial_response
    from beam_ident.frequency_response import welch_response as welch_response
    from beam_ident.half_power import HalfPowerDamping as HalfPowerDamping
    from beam_ident.half_power import half_power_damping as half_power_damping
    from beam_ident.identification import identify as identify
    from beam_ident.identification_result import IdentificationResult as IdentificationResult
    from beam_ident.identification_result import OrderEntry as OrderEntry
    from beam_ident.identification_result import OutputFit as OutputFit
    from beam_ident.modal_analysis import CircleFit as CircleFit
    from beam_ident.modal_analysis import ModalAnalysis as ModalAnalysis
    from beam_ident.modal_analysis import StabilisationChart as StabilisationChart
    from beam_ident.modal_analysis import analyse_modes as analyse_modes
    from beam_ident.modal_analysis import circle_fit as circle_fit
    from beam_ident.modal_analysis import complex_mode_indicator as complex_mode_indicator
    from beam_ident.modal_analysis import modal_assurance as modal_assurance
    from beam_ident.modal_analysis import multivariate_mode_indicator as multivariate_mode_indicator
    from beam_ident.modal_analysis import phase_collinearity as phase_collinearity
    from beam_ident.modal_analysis import stabilisation_chart as stabilisation_chart
    from beam_ident.modal_fit import Prior as Prior
    from beam_ident.modal_frequency_response import ModalFrequencyResponse as ModalFrequencyResponse
    from beam_ident.modal_model import ModalModel as ModalModel
    from beam_ident.modal_structure import ModalStructure as ModalStructure
    from beam_ident.multi_input_model import MultiInputModel as MultiInputModel
    from beam_ident.order_selection import OrderSelection as OrderSelection
    from beam_ident.order_selection import StructureEntry as StructureEntry
    from beam_ident.order_selection import select_transfer_function as select_transfer_function
    from beam_ident.periodic_averaging import PeriodicResponse as PeriodicResponse
    from beam_ident.periodic_averaging import periodic_response as periodic_response
    from beam_ident.records import InputSignal as InputSignal
    from beam_ident.records import OutputSignal as OutputSignal
    from beam_ident.records import TimeRecord as TimeRecord
    from beam_ident.repeatability import Repeatability as Repeatability
    from beam_ident.repeatability import assess_repeatability as assess_repeatability
    from beam_ident.report import write_report as write_report
    from beam_ident.sampled_controller import SampledController as SampledController
    from beam_ident.step_comparison import StepComparison as StepComparison
    from beam_ident.step_comparison import compare_step_responses as compare_step_responses
    from beam_ident.stepped_sine import SineFit as SineFit
    from beam_ident.stepped_sine import fit_sine as fit_sine
    from beam_ident.stepped_sine import stepped_sine_response as stepped_sine_response
    from beam_ident.stored_results import restore as restore
    from beam_ident.subspace import SubspaceModel as SubspaceModel
    from beam_ident.subspace import subspace_model as subspace_model
    from beam_ident.transfer_function import TransferFunctionModel as TransferFunctionModel
    from beam_ident.transfer_function_fit import MultiInputResult as MultiInputResult
    from beam_ident.transfer_function_fit import TransferFunctionResult as TransferFunctionResult
    from beam_ident.transfer_function_fit import estimate_transfer_function as estimate_transfer_function
    from beam_ident.validation import InputCorrelation as InputCorrelation
    from beam_ident.validation import Scores as Scores
    from beam_ident.validation import Whiteness as Whiteness

_NAMES = {
    "batches": ("map_records",),
    "closed_loop": ("ClosedLoopResult", "estimate_in_closed_loop"),
    "common_pole_fit": ("CommonPoleResult", "estimate_common_poles"),
    "comparison": ("ModelComparison", "compare_models"),
    "cross_validation": ("OutputValidation", "ValidationResult", "validate"),
    "detection_lines": ("DistortionLevel", "NonlinearDistortion", "nonlinear_distortion"),
    "errors": (
        "EstimationError",
        "ExcitationError",
        "ExcitationLimitError",
        "IdentificationError",
        "ModelFormatError",
        "RecordError",
    ),
    "excitation": (
        "AxisLimits",
        "BandLimitedNoise",
        "Doublet",
        "ExcitationReport",
        "HeldInput",
        "LinearChirp",
        "LogChirp",
        "Multisine",
        "PointToPoint",
        "Prbs",
        "Pulse",
        "Recipe",
        "SampledExcitation",
        "Sine",
        "Step",
        "SteppedSine",
        "crest_factor",
        "describe_recipe",
        "excitation_report",
        "half_power_bands",
        "predict_amplitudes",
    ),
    "free_decay": ("FreeDecay", "fit_free_decay"),
    "frequency_domain_fit": ("FrequencyDomainResult", "fit_frequency_modes"),
    "frequency_domain_transfer_function": (
        "FrequencyTransferFunctionResult",
        "fit_frequency_transfer_function",
    ),
    "frequency_record": ("FrequencyRecord",),
    "frequency_response": ("local_polynomial_response", "welch_response"),
    "half_power": ("HalfPowerDamping", "half_power_damping"),
    "identification": ("identify",),
    "identification_result": ("IdentificationResult", "OrderEntry", "OutputFit"),
    "modal_analysis": (
        "CircleFit",
        "ModalAnalysis",
        "StabilisationChart",
        "analyse_modes",
        "circle_fit",
        "complex_mode_indicator",
        "modal_assurance",
        "multivariate_mode_indicator",
        "phase_collinearity",
        "stabilisation_chart",
    ),
    "modal_fit": ("Prior",),
    "modal_frequency_response": ("ModalFrequencyResponse",),
    "modal_model": ("ModalModel",),
    "modal_structure": ("ModalStructure",),
    "multi_input_model": ("MultiInputModel",),
    "order_selection": ("OrderSelection", "StructureEntry", "select_transfer_function"),
    "periodic_averaging": ("PeriodicResponse", "periodic_response"),
    "records": ("InputSignal", "OutputSignal", "TimeRecord"),
    "repeatability": ("Repeatability", "assess_repeatability"),
    "report": ("write_report",),
    "sampled_controller": ("SampledController",),
    "step_comparison": ("StepComparison", "compare_step_responses"),
    "stepped_sine": ("SineFit", "fit_sine", "stepped_sine_response"),
    "stored_results": ("restore",),
    "subspace": ("SubspaceModel", "subspace_model"),
    "transfer_function": ("TransferFunctionModel",),
    "transfer_function_fit": ("MultiInputResult", "TransferFunctionResult", "estimate_transfer_function"),
    "validation": ("InputCorrelation", "Scores", "Whiteness"),
}
_MODULE_OF = {name: module for module, names in _NAMES.items() for name in names}

__all__ = sorted(_MODULE_OF)


def __getattr__(name: str) -> Any:
    """Load an exported name from its module (PEP 562)."""
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
