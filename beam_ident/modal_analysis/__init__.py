"""Experimental modal analysis: from measured frequency responses to modes with their uncertainty."""

from beam_ident.modal_analysis.circle_fit import CircleFit as CircleFit
from beam_ident.modal_analysis.circle_fit import circle_fit as circle_fit
from beam_ident.modal_analysis.mode_indicators import complex_mode_indicator as complex_mode_indicator
from beam_ident.modal_analysis.mode_indicators import (
    multivariate_mode_indicator as multivariate_mode_indicator,
)
from beam_ident.modal_analysis.polyreference import OrderPoles as OrderPoles
from beam_ident.modal_analysis.polyreference import polyreference_poles as polyreference_poles
from beam_ident.modal_analysis.refinement import ModalAnalysis as ModalAnalysis
from beam_ident.modal_analysis.refinement import analyse_modes as analyse_modes
from beam_ident.modal_analysis.shapes import modal_assurance as modal_assurance
from beam_ident.modal_analysis.shapes import normalised as normalised
from beam_ident.modal_analysis.shapes import phase_collinearity as phase_collinearity
from beam_ident.modal_analysis.stabilisation import ChartPole as ChartPole
from beam_ident.modal_analysis.stabilisation import StabilisationChart as StabilisationChart
from beam_ident.modal_analysis.stabilisation import StabilityCriteria as StabilityCriteria
from beam_ident.modal_analysis.stabilisation import stabilisation_chart as stabilisation_chart
