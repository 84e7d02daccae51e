from __future__ import annotations

import sys

import numpy as np
import pytest

from beam_ident import EstimationError, figures
from beam_ident.modal_analysis import analyse_modes, circle_fit, stabilisation_chart
from tests.beam_ident.modal_analysis.chain import FREQUENCIES_HZ, LINES, noisy_record


@pytest.fixture(scope="module")
def analysis():
    chart = stabilisation_chart(noisy_record(0, inputs=(0, 2), omegas=LINES[:1600:4]), max_order=14)
    return chart, analyse_modes(chart)


def test_the_chart_shows_every_pole_the_modes_and_the_indicator(analysis):
    chart, found = analysis
    axis, behind = figures.stabilisation_figure(chart, found).axes
    marks = [line for line in axis.lines if line.get_linestyle() == "None"]
    assert sum(len(line.get_xdata()) for line in marks) == len(chart.poles)
    modes = [line.get_xdata()[0] for line in axis.lines if line.get_linestyle() == "--"]
    np.testing.assert_allclose(modes, found.frequencies_hz)
    assert len(behind.lines) == 2


def test_the_assurance_stands_in_the_cells(analysis):
    figure = figures.assurance_figure(analysis[1].assurance)
    assert figure.axes[0].texts[0].get_text() == "1.00"
    assert len(figure.axes[0].texts) == len(FREQUENCIES_HZ) ** 2
    with pytest.raises(EstimationError, match="matrix of modes"):
        figures.assurance_figure(np.zeros(3))


def test_the_model_is_drawn_through_the_measured_points(analysis):
    found = analysis[1]
    figure = figures.synthesis_figure(found, [("y2", "u1")])
    points, curve = figure.axes[0].lines[:2]
    np.testing.assert_array_equal(points.get_ydata(), np.abs(found.record.response[:, 1, 0]))
    np.testing.assert_array_equal(curve.get_ydata(), np.abs(found.modelled[:, 1, 0]))
    with pytest.raises(EstimationError, match="no response of 'y9'"):
        figures.synthesis_figure(found, [("y9", "u1")])


def test_a_circle_goes_through_its_points_without_pyplot(analysis, monkeypatch):
    monkeypatch.delitem(sys.modules, "matplotlib.pyplot", raising=False)
    fit = circle_fit(analysis[0].record, FREQUENCIES_HZ[0], 12.0)
    axis = figures.circle_figure(fit).axes[0]
    assert len(axis.lines[1].get_xdata()) == len(fit.points)
    assert "matplotlib.pyplot" not in sys.modules
