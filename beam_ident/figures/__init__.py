"""Figures of results, made from the result objects alone.

Every function returns a ``matplotlib.figure.Figure`` made without pyplot, so that
nothing global is touched; matplotlib is imported only when a figure is asked for.
"""

from beam_ident.figures.excitation import excitation_figure
from beam_ident.figures.identification import (
    fit_figure,
    frequency_response_figure,
    pole_figure,
    residual_figure,
    spectrum_figure,
    time_figure,
)
from beam_ident.figures.modal_analysis import (
    assurance_figure,
    circle_figure,
    stabilisation_figure,
    synthesis_figure,
)
from beam_ident.figures.poles import pole_zero_figure
from beam_ident.figures.responses import coherence_figure, response_over_model_figure
from beam_ident.figures.validation import validation_figure

__all__ = [
    "assurance_figure",
    "circle_figure",
    "coherence_figure",
    "excitation_figure",
    "fit_figure",
    "frequency_response_figure",
    "pole_figure",
    "pole_zero_figure",
    "residual_figure",
    "response_over_model_figure",
    "spectrum_figure",
    "stabilisation_figure",
    "synthesis_figure",
    "time_figure",
    "validation_figure",
]
