"""The physics of a flexible cantilever beam on a moving hub.

Parameters, clamped modes, Galerkin matrices, frequency responses, state spaces and exact stepping; the closed-form
response of the continuous beam as a yardstick; advice for experiments. NumPy and SciPy only, but for `figures`,
which imports Matplotlib when it draws.
"""

from .errors import BeamModelError, BeamParameterError
from .exact import exact_frequency_response
from .experiment_advice import ExperimentAdvice, advise, aliases, node_heights, suggest_marker_heights
from .frequency_response import FrequencyResponse
from .galerkin import GalerkinMatrices, ModalBasis
from .linear_forms import PoleResidueForm, StateSpace, ZerosPolesGain, state_space
from .model import BeamModel
from .parameters import BeamParameters, Damping, PointMass
from .stepping import ForceStepper, HubAndBeam, MotionStepper

__all__ = [
    "BeamModel",
    "BeamModelError",
    "BeamParameterError",
    "BeamParameters",
    "Damping",
    "ExperimentAdvice",
    "ForceStepper",
    "FrequencyResponse",
    "GalerkinMatrices",
    "HubAndBeam",
    "ModalBasis",
    "MotionStepper",
    "PointMass",
    "PoleResidueForm",
    "StateSpace",
    "ZerosPolesGain",
    "advise",
    "aliases",
    "exact_frequency_response",
    "node_heights",
    "state_space",
    "suggest_marker_heights",
]
