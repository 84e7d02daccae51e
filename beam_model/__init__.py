"""The physics of a flexible cantilever beam on a moving hub.

Parameters, clamped modes, Galerkin matrices, frequency responses, state spaces and exact stepping; the closed-form
response of the continuous beam as a yardstick; advice for experiments. NumPy and SciPy only, but for `figures`,
which imports Matplotlib when it draws.
"""

from __future__ import annotations

from .axis_dynamics import AxisStepper, EndStops, HubFriction, PositionServo
from .errors import BeamModelError, BeamParameterError, PhysicalFitError
from .exact import exact_frequency_response
from .experiment_advice import (
    ExperimentAdvice,
    PredictedLoads,
    advise,
    aliases,
    node_heights,
    predict_loads,
    suggest_marker_heights,
)
from .frequency_response import FrequencyResponse
from .galerkin import GalerkinMatrices, ModalBasis, ModalParameters
from .linear_forms import PoleResidueForm, StateSpace, ZerosPolesGain, state_space
from .model import BeamModel
from .nonlinear import AirDrag, NonlinearMotionStepper, NonlinearTerms
from .parameters import BeamParameters, Damping, PointMass
from .physical_fit import Identifiability, ModalMeasurement, PhysicalFit, Prior, fit_beam, identifiability
from .stepping import ForceStepper, HubAndBeam, MotionStepper
from .summary import ModelSummary, summarise
from .theory_comparison import TheoryComparison, UncertaintyBudget, compare_with_theory

__all__ = [
    "AirDrag",
    "AxisStepper",
    "BeamModel",
    "BeamModelError",
    "BeamParameterError",
    "BeamParameters",
    "Damping",
    "EndStops",
    "ExperimentAdvice",
    "ForceStepper",
    "FrequencyResponse",
    "GalerkinMatrices",
    "HubAndBeam",
    "HubFriction",
    "Identifiability",
    "ModalBasis",
    "ModalMeasurement",
    "ModalParameters",
    "ModelSummary",
    "MotionStepper",
    "NonlinearMotionStepper",
    "NonlinearTerms",
    "PhysicalFit",
    "PhysicalFitError",
    "PointMass",
    "PoleResidueForm",
    "PositionServo",
    "PredictedLoads",
    "Prior",
    "StateSpace",
    "TheoryComparison",
    "UncertaintyBudget",
    "ZerosPolesGain",
    "advise",
    "aliases",
    "compare_with_theory",
    "exact_frequency_response",
    "fit_beam",
    "identifiability",
    "node_heights",
    "predict_loads",
    "state_space",
    "suggest_marker_heights",
    "summarise",
]
