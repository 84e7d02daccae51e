"""Experimental modal analysis: from measured frequency responses to modes with their uncertainty."""

from beam_ident.modal_analysis.circle_fit import CircleFit, circle_fit
from beam_ident.modal_analysis.mode_indicators import complex_mode_indicator, multivariate_mode_indicator
from beam_ident.modal_analysis.polyreference import OrderPoles, polyreference_poles
from beam_ident.modal_analysis.refinement import ModalAnalysis, analyse_modes
from beam_ident.modal_analysis.shapes import modal_assurance, normalised, phase_collinearity
from beam_ident.modal_analysis.stabilisation import (
    ChartPole,
    StabilisationChart,
    StabilityCriteria,
    stabilisation_chart,
)

__all__ = [
    "ChartPole",
    "CircleFit",
    "ModalAnalysis",
    "OrderPoles",
    "StabilisationChart",
    "StabilityCriteria",
    "analyse_modes",
    "circle_fit",
    "complex_mode_indicator",
    "modal_assurance",
    "multivariate_mode_indicator",
    "normalised",
    "phase_collinearity",
    "polyreference_poles",
    "stabilisation_chart",
]
