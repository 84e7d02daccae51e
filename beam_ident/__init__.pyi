"""Every public name of ``beam_ident``, written once: type checkers read this file, and so does ``__init__.py``."""

from beam_ident.amplitude.curves import AmplitudeCurves as AmplitudeCurves
from beam_ident.amplitude.curves import amplitude_curves as amplitude_curves
from beam_ident.amplitude.curves import driven_amplitude_curves as driven_amplitude_curves
from beam_ident.amplitude.linearity import Linearity as Linearity
from beam_ident.amplitude.linearity import ModeLinearity as ModeLinearity
from beam_ident.amplitude.linearity import linearity as linearity
from beam_ident.axis.axis_estimation import check_axis as check_axis
from beam_ident.axis.axis_estimation import identify_axis as identify_axis
from beam_ident.axis.axis_result import AxisCheck as AxisCheck
from beam_ident.axis.axis_result import AxisResult as AxisResult
from beam_ident.best_linear.approximation import best_linear_approximation as best_linear_approximation
from beam_ident.best_linear.result import BestLinearApproximation as BestLinearApproximation
from beam_ident.best_linear.result import LineVariances as LineVariances
from beam_ident.data.batches import map_records as map_records
from beam_ident.data.frequency_record import FrequencyRecord as FrequencyRecord
from beam_ident.data.growing_record import GrowingRecord as GrowingRecord
from beam_ident.data.prior import Prior as Prior
from beam_ident.data.records import InputSignal as InputSignal
from beam_ident.data.records import LowPass as LowPass
from beam_ident.data.records import OutputSignal as OutputSignal
from beam_ident.data.records import TimeRecord as TimeRecord
from beam_ident.design.experiment import ExperimentDesign as ExperimentDesign
from beam_ident.design.experiment import design_experiment as design_experiment
from beam_ident.design.limits import ExcitationLimits as ExcitationLimits
from beam_ident.design.limits import LimitedResponse as LimitedResponse
from beam_ident.design.precision import Observation as Observation
from beam_ident.design.precision import predicted_model as predicted_model
from beam_ident.design.prediction import half_power_bands as half_power_bands
from beam_ident.design.prediction import predict_amplitudes as predict_amplitudes
from beam_ident.design.summary import ExcitationReport as ExcitationReport
from beam_ident.design.summary import excitation_report as excitation_report
from beam_ident.errors import EstimationError as EstimationError
from beam_ident.errors import ExcitationError as ExcitationError
from beam_ident.errors import ExcitationLimitError as ExcitationLimitError
from beam_ident.errors import IdentificationError as IdentificationError
from beam_ident.errors import ModelFormatError as ModelFormatError
from beam_ident.errors import RecordError as RecordError
from beam_ident.estimators import ESTIMATORS as ESTIMATORS
from beam_ident.estimators import Estimator as Estimator
from beam_ident.estimators import EstimatorSettings as EstimatorSettings
from beam_ident.estimators import estimator_meanings as estimator_meanings
from beam_ident.estimators import find_estimator as find_estimator
from beam_ident.estimators import run_estimator as run_estimator
from beam_ident.evaluation.assumptions import Assumption as Assumption
from beam_ident.evaluation.assumptions import assumptions as assumptions
from beam_ident.evaluation.hold_out import OutputValidation as OutputValidation
from beam_ident.evaluation.hold_out import ValidationResult as ValidationResult
from beam_ident.evaluation.hold_out import validate as validate
from beam_ident.evaluation.model_comparison import ModelComparison as ModelComparison
from beam_ident.evaluation.model_comparison import compare_models as compare_models
from beam_ident.evaluation.repeatability import Repeatability as Repeatability
from beam_ident.evaluation.repeatability import assess_repeatability as assess_repeatability
from beam_ident.evaluation.step_comparison import StepComparison as StepComparison
from beam_ident.evaluation.step_comparison import compare_step_responses as compare_step_responses
from beam_ident.excitation import AxisLimits as AxisLimits
from beam_ident.excitation import BandLimitedNoise as BandLimitedNoise
from beam_ident.excitation import Doublet as Doublet
from beam_ident.excitation import HeldInput as HeldInput
from beam_ident.excitation import LinearChirp as LinearChirp
from beam_ident.excitation import LogChirp as LogChirp
from beam_ident.excitation import Multisine as Multisine
from beam_ident.excitation import PointToPoint as PointToPoint
from beam_ident.excitation import Prbs as Prbs
from beam_ident.excitation import Pulse as Pulse
from beam_ident.excitation import Recipe as Recipe
from beam_ident.excitation import SampledExcitation as SampledExcitation
from beam_ident.excitation import ShapedMultisine as ShapedMultisine
from beam_ident.excitation import Sine as Sine
from beam_ident.excitation import Step as Step
from beam_ident.excitation import SteppedSine as SteppedSine
from beam_ident.excitation import Trajectory as Trajectory
from beam_ident.excitation import crest_factor as crest_factor
from beam_ident.excitation import describe_recipe as describe_recipe
from beam_ident.excitation.shaped_move import ShapedMove as ShapedMove
from beam_ident.modal.aims import Aim as Aim
from beam_ident.modal.aims import aims_of as aims_of
from beam_ident.modal.free_decay_result import FreeDecay as FreeDecay
from beam_ident.modal.frequency_response import ModalFrequencyResponse as ModalFrequencyResponse
from beam_ident.modal.identification_result import FrequencyDomainResult as FrequencyDomainResult
from beam_ident.modal.identification_result import IdentificationResult as IdentificationResult
from beam_ident.modal.identification_result import OrderEntry as OrderEntry
from beam_ident.modal.identification_result import OutputFit as OutputFit
from beam_ident.modal.model import ModalModel as ModalModel
from beam_ident.modal.structure import ModalStructure as ModalStructure
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
from beam_ident.modal_estimation.free_decay import fit_free_decay as fit_free_decay
from beam_ident.modal_estimation.frequency_domain import fit_frequency_modes as fit_frequency_modes
from beam_ident.modal_identification.growing import GrowingIdentification as GrowingIdentification
from beam_ident.modal_identification.time_domain import identify as identify
from beam_ident.noise.scores import InputCorrelation as InputCorrelation
from beam_ident.noise.scores import Scores as Scores
from beam_ident.noise.scores import Whiteness as Whiteness
from beam_ident.report.identification import write_report as write_report
from beam_ident.responses.detection_lines import DistortionLevel as DistortionLevel
from beam_ident.responses.detection_lines import NonlinearDistortion as NonlinearDistortion
from beam_ident.responses.detection_lines import nonlinear_distortion as nonlinear_distortion
from beam_ident.responses.half_power import HalfPowerDamping as HalfPowerDamping
from beam_ident.responses.half_power import half_power_damping as half_power_damping
from beam_ident.responses.hammer import hammer_response as hammer_response
from beam_ident.responses.local_polynomial import local_polynomial_response as local_polynomial_response
from beam_ident.responses.periodic_averaging import PeriodicResponse as PeriodicResponse
from beam_ident.responses.periodic_averaging import periodic_response as periodic_response
from beam_ident.responses.spectral import welch_response as welch_response
from beam_ident.responses.stepped_sine import SineFit as SineFit
from beam_ident.responses.stepped_sine import fit_sine as fit_sine
from beam_ident.responses.stepped_sine import stepped_sine_response as stepped_sine_response
from beam_ident.results import LineResult as LineResult
from beam_ident.results import Result as Result
from beam_ident.results import TimeResult as TimeResult
from beam_ident.shaping.choice import Choice as Choice
from beam_ident.shaping.choice import choose_move as choose_move
from beam_ident.shaping.command import Move as Move
from beam_ident.shaping.command import s_curve as s_curve
from beam_ident.shaping.feedback import dampable_modes as dampable_modes
from beam_ident.shaping.known_beam import AxisErrors as AxisErrors
from beam_ident.shaping.known_beam import KnownBeam as KnownBeam
from beam_ident.shaping.known_beam import PoleDrift as PoleDrift
from beam_ident.shaping.known_beam import swing_law as swing_law
from beam_ident.shaping.residual import predict_residual as predict_residual
from beam_ident.shaping.shapers import shaped as shaped
from beam_ident.shaping.time_optimal import MoveTask as MoveTask
from beam_ident.stored_results import restore as restore
from beam_ident.subspace.model import SubspaceModel as SubspaceModel
from beam_ident.subspace.model import subspace_model as subspace_model
from beam_ident.summary import models_of as models_of
from beam_ident.transfer_function.model import TransferFunctionModel as TransferFunctionModel
from beam_ident.transfer_function.multi_input_model import MultiInputModel as MultiInputModel
from beam_ident.transfer_function.sampled_controller import SampledController as SampledController
from beam_ident.transfer_function_estimation.clsrivc import ClosedLoopResult as ClosedLoopResult
from beam_ident.transfer_function_estimation.clsrivc import estimate_in_closed_loop as estimate_in_closed_loop
from beam_ident.transfer_function_estimation.common_poles import CommonPoleResult as CommonPoleResult
from beam_ident.transfer_function_estimation.common_poles import (
    MultiInputCommonPoleResult as MultiInputCommonPoleResult,
)
from beam_ident.transfer_function_estimation.common_poles import (
    estimate_common_poles as estimate_common_poles,
)
from beam_ident.transfer_function_estimation.estimation import MultiInputResult as MultiInputResult
from beam_ident.transfer_function_estimation.estimation import (
    SeparateOutputsResult as SeparateOutputsResult,
)
from beam_ident.transfer_function_estimation.estimation import (
    TransferFunctionResult as TransferFunctionResult,
)
from beam_ident.transfer_function_estimation.estimation import (
    estimate_transfer_function as estimate_transfer_function,
)
from beam_ident.transfer_function_estimation.frequency_domain import (
    FrequencyTransferFunctionResult as FrequencyTransferFunctionResult,
)
from beam_ident.transfer_function_estimation.frequency_domain import (
    fit_frequency_transfer_function as fit_frequency_transfer_function,
)
from beam_ident.transfer_function_estimation.order_selection import OrderSelection as OrderSelection
from beam_ident.transfer_function_estimation.order_selection import StructureEntry as StructureEntry
from beam_ident.transfer_function_estimation.order_selection import (
    select_transfer_function as select_transfer_function,
)
