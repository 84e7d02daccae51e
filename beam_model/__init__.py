"""The physics of a flexible cantilever beam on a moving hub.

Parameters, clamped modes, Galerkin matrices, frequency responses, state spaces and exact stepping; the closed-form
response of the continuous beam as a yardstick; advice for experiments. NumPy and SciPy only, but for ``figures``,
which imports Matplotlib when it draws.
"""

from __future__ import annotations

from beam_model.advice.experiment_advice import (
    ExperimentAdvice,
    PredictedLoads,
    advise,
    aliases,
    node_heights,
    predict_loads,
    suggest_marker_heights,
)
from beam_model.advice.summary import ModelSummary, summarise
from beam_model.continuum.exact import exact_frequency_response
from beam_model.dynamics.axis_dynamics import AxisStepper, EndStops, HubFriction, PositionServo
from beam_model.dynamics.nonlinear import AirDrag, NonlinearMotionStepper, NonlinearTerms
from beam_model.errors import BeamModelError, BeamParameterError, PhysicalFitError
from beam_model.fitting.physical_fit import (
    Identifiability,
    ModalMeasurement,
    ParameterPrior,
    PhysicalFit,
    fit_beam,
    identifiability,
)
from beam_model.fitting.theory_comparison import TheoryComparison, UncertaintyBudget, compare_with_theory
from beam_model.frequency_response import FrequencyResponse
from beam_model.galerkin.linear_forms import PoleResidueForm, StateSpace, ZerosPolesGain, state_space
from beam_model.galerkin.matrices import GalerkinMatrices, ModalBasis, ModalParameters
from beam_model.galerkin.model import BeamModel
from beam_model.galerkin.stepping import ForceStepper, HubAndBeam, MotionStepper
from beam_model.parameters import BeamParameters, Damping, PointMass

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
    "ParameterPrior",
    "PhysicalFit",
    "PhysicalFitError",
    "PointMass",
    "PoleResidueForm",
    "PositionServo",
    "PredictedLoads",
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
