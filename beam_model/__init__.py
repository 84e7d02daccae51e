"""The physics of a flexible cantilever beam on a moving hub.

Parameters, clamped modes, Galerkin matrices, frequency responses, state spaces and exact stepping; the closed-form
response of the continuous beam as a yardstick; advice for experiments. NumPy and SciPy only, but for ``figures``,
which imports Matplotlib when it draws.
"""

from beam_model.advice.experiment_advice import ExperimentAdvice as ExperimentAdvice
from beam_model.advice.experiment_advice import advise as advise
from beam_model.advice.experiment_advice import aliases as aliases
from beam_model.advice.experiment_advice import node_heights as node_heights
from beam_model.advice.experiment_advice import suggest_marker_heights as suggest_marker_heights
from beam_model.advice.loads import HeldLoads as HeldLoads
from beam_model.advice.loads import LoadTrace as LoadTrace
from beam_model.advice.loads import PredictedLoads as PredictedLoads
from beam_model.advice.loads import predict_loads as predict_loads
from beam_model.advice.summary import ModelSummary as ModelSummary
from beam_model.advice.summary import summarise as summarise
from beam_model.advice.validity import validity as validity
from beam_model.continuum.exact import exact_frequency_response as exact_frequency_response
from beam_model.dynamics.amplitude_laws import AmplitudeLaw as AmplitudeLaw
from beam_model.dynamics.amplitude_laws import amplitude_law as amplitude_law
from beam_model.dynamics.axis_dynamics import AxisStepper as AxisStepper
from beam_model.dynamics.axis_dynamics import EndStops as EndStops
from beam_model.dynamics.axis_dynamics import HubFriction as HubFriction
from beam_model.dynamics.axis_dynamics import PositionServo as PositionServo
from beam_model.dynamics.nonlinear import AirDrag as AirDrag
from beam_model.dynamics.nonlinear import NonlinearMotionStepper as NonlinearMotionStepper
from beam_model.dynamics.nonlinear import NonlinearTerms as NonlinearTerms
from beam_model.errors import BeamModelError as BeamModelError
from beam_model.errors import BeamParameterError as BeamParameterError
from beam_model.errors import PhysicalFitError as PhysicalFitError
from beam_model.fitting.physical_fit import Identifiability as Identifiability
from beam_model.fitting.physical_fit import ModalMeasurement as ModalMeasurement
from beam_model.fitting.physical_fit import ParameterPrior as ParameterPrior
from beam_model.fitting.physical_fit import PhysicalFit as PhysicalFit
from beam_model.fitting.physical_fit import fit_beam as fit_beam
from beam_model.fitting.physical_fit import identifiability as identifiability
from beam_model.fitting.theory_comparison import TheoryComparison as TheoryComparison
from beam_model.fitting.theory_comparison import UncertaintyBudget as UncertaintyBudget
from beam_model.fitting.theory_comparison import compare_with_theory as compare_with_theory
from beam_model.frequency_response import FrequencyResponse as FrequencyResponse
from beam_model.galerkin.linear_forms import PoleResidueForm as PoleResidueForm
from beam_model.galerkin.linear_forms import StateSpace as StateSpace
from beam_model.galerkin.linear_forms import ZerosPolesGain as ZerosPolesGain
from beam_model.galerkin.linear_forms import state_space as state_space
from beam_model.galerkin.matrices import GalerkinMatrices as GalerkinMatrices
from beam_model.galerkin.matrices import ModalBasis as ModalBasis
from beam_model.galerkin.matrices import ModalParameters as ModalParameters
from beam_model.galerkin.model import BeamModel as BeamModel
from beam_model.galerkin.stepping import ForceStepper as ForceStepper
from beam_model.galerkin.stepping import HubAndBeam as HubAndBeam
from beam_model.galerkin.stepping import MotionStepper as MotionStepper
from beam_model.parameters import BeamParameters as BeamParameters
from beam_model.parameters import Damping as Damping
from beam_model.parameters import PointMass as PointMass
from beam_model.parameters import Section as Section
from beam_model.parameters import StillAir as StillAir
