"""Figures of results, made from the result objects alone.

Every function returns a ``matplotlib.figure.Figure`` made without pyplot, so that
nothing global is touched; matplotlib is imported only when a figure is asked for.
"""

from beam_ident.figures.amplitude import amplitude_figure as amplitude_figure
from beam_ident.figures.excitation import excitation_figure as excitation_figure
from beam_ident.figures.identification import FittedOutput as FittedOutput
from beam_ident.figures.identification import fit_figure as fit_figure
from beam_ident.figures.identification import frequency_response_figure as frequency_response_figure
from beam_ident.figures.identification import input_spectrum_figure as input_spectrum_figure
from beam_ident.figures.identification import pole_figure as pole_figure
from beam_ident.figures.identification import residual_figure as residual_figure
from beam_ident.figures.identification import spectrum_figure as spectrum_figure
from beam_ident.figures.identification import time_figure as time_figure
from beam_ident.figures.modal_analysis import assurance_figure as assurance_figure
from beam_ident.figures.modal_analysis import circle_figure as circle_figure
from beam_ident.figures.modal_analysis import stabilisation_figure as stabilisation_figure
from beam_ident.figures.modal_analysis import synthesis_figure as synthesis_figure
from beam_ident.figures.modes import mode_shape_figure as mode_shape_figure
from beam_ident.figures.modes import trend_figure as trend_figure
from beam_ident.figures.poles import pole_zero_figure as pole_zero_figure
from beam_ident.figures.responses import best_linear_figure as best_linear_figure
from beam_ident.figures.responses import coherence_figure as coherence_figure
from beam_ident.figures.responses import response_over_model_figure as response_over_model_figure
from beam_ident.figures.validation import validation_figure as validation_figure
