"""The physics of a flexible cantilever beam on a moving hub.

Parameters, clamped modes, Galerkin matrices, frequency responses and exact stepping. NumPy and SciPy only.
"""

from .errors import BeamModelError, BeamParameterError
from .frequency_response import FrequencyResponse
from .galerkin import GalerkinMatrices, ModalBasis
from .model import BeamModel
from .parameters import BeamParameters, Damping, PointMass
from .stepping import ForceStepper, HubAndBeam, MotionStepper

__all__ = [
    "BeamModel",
    "BeamModelError",
    "BeamParameterError",
    "BeamParameters",
    "Damping",
    "ForceStepper",
    "FrequencyResponse",
    "GalerkinMatrices",
    "HubAndBeam",
    "ModalBasis",
    "MotionStepper",
    "PointMass",
]
