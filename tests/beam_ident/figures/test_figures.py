"""Figures hold what they claim to show; how they look is for eyes."""

from __future__ import annotations

import sys

import numpy as np
import pytest

pytest.importorskip("matplotlib")

from beam_ident import EstimationError, LogChirp, estimate_transfer_function, figures, identify, validate
from beam_ident.data.records import InputSignal, OutputSignal, TimeRecord
from beam_ident.excitation import Prbs
from beam_ident.figures.canvas import axes_grid, drawn, plain_decades
from beam_ident.responses.local_polynomial import local_polynomial_response
from beam_ident.responses.spectral import welch_response
from tests.beam_ident import rao_garnier
from tests.beam_ident.truth import beam_record


@pytest.fixture(scope="module")
def modal():
    record = beam_record(1)
    return record, identify(record, n_modes=3)


@pytest.fixture(scope="module")
def rational():
    record = rao_garnier.benchmark_record(1, 10.0)
    return record, estimate_transfer_function(record, 4, 1).model


def test_pole_ellipses_are_centred_on_the_poles(rational):
    model = rational[1]
    figure = figures.pole_zero_figure(model)
    upper = sorted(p for p in model.poles if p.imag > 0.0)
    left = figure.axes[0]
    ellipses = [line for line in left.lines if len(line.get_xdata()) == 121]
    # Two complex poles and one real zero.
    assert len(ellipses) == 3
    centres = [complex(np.mean(e.get_xdata()[:-1]), np.mean(e.get_ydata()[:-1])) for e in ellipses]
    for pole in upper:
        assert min(abs(c - pole) for c in centres) < 1e-9 * abs(pole)
    assert len(figure.axes) == 3


@pytest.mark.slow
def test_modal_poles_have_ellipses_of_their_own_axes(modal):
    model = modal[1].model
    figure = figures.pole_zero_figure(model)
    assert len(figure.axes) == 1 + model.n_modes
    close = figure.axes[1]
    width = max(close.lines[1].get_xdata()) - min(close.lines[1].get_xdata())
    # 95 % of two dimensions is 2.448 sd; the real part is -zeta omega.
    sd = model.natural_frequencies[0] * model.damping_ratio_sd[0]
    assert width == pytest.approx(2 * 2.448 * sd, rel=0.05)


def test_a_response_stands_as_points_over_the_model(rational):
    record, model = rational
    estimate = local_polynomial_response(record)
    figure = figures.response_over_model_figure([estimate], model)
    points = [line for line in figure.axes[0].lines if line.get_marker() == "."]
    assert np.array_equal(points[0].get_ydata(), np.abs(estimate.response[:, 0, 0]), equal_nan=True)


def test_coherence_is_drawn_where_there_is_one_and_the_relative_sd_elsewhere(rational):
    record = rational[0]
    averaged = figures.coherence_figure([welch_response(record)])
    single = figures.coherence_figure([local_polynomial_response(record)])
    assert averaged.axes[2].get_ylabel() == "coherence"
    assert single.axes[2].get_ylabel() == "relative sd"


def test_a_validation_shows_every_output_with_its_scores(modal):
    result = validate(modal[1].model, beam_record(2))
    figure = figures.validation_figure(result)
    titles = [axis.get_title(loc="left") for axis in figure.axes]
    for output in result.outputs:
        assert any(f"FIT {output.scores.fit_percent:.2f} %" in title for title in titles)


def test_an_excitation_is_drawn_with_its_band_and_the_modes_of_a_model(modal):
    excitation = LogChirp(start_frequency=1.0, end_frequency=45.0, duration=4.0, still=1.0).sample(1e-3)
    figure = figures.excitation_figure(excitation, modal[1].model)
    assert len(figure.axes) == 4
    marks = [line.get_xdata()[0] for line in figure.axes[3].lines[1:]]
    assert np.allclose(marks, modal[1].model.frequencies_hz)
    force = Prbs(drive="force").sample_input(1e-3, 2.0, "N")
    assert len(figures.excitation_figure(force).axes) == 2


def test_estimates_of_other_signals_are_refused(rational, modal):
    estimate = local_polynomial_response(rational[0])
    with pytest.raises(EstimationError, match="own signals"):
        figures.response_over_model_figure([estimate], modal[1].model)
    with pytest.raises(EstimationError, match="at least one"):
        figures.coherence_figure([])


def test_no_figure_touches_pyplot(modal, monkeypatch):
    monkeypatch.delitem(sys.modules, "matplotlib.pyplot", raising=False)
    figures.time_figure(modal[0])
    assert "matplotlib.pyplot" not in sys.modules


def test_missing_samples_break_the_line_where_they_are_missing():
    times = np.delete(0.01 * np.arange(100), [40, 41, 42])
    at, values = drawn(times, np.ones(97))
    assert at[np.isnan(values)] == pytest.approx([0.41])
    back = np.concatenate([0.01 * np.arange(50), 0.01 * np.arange(50)])
    at, values = drawn(back, np.ones(100))
    assert np.all(np.diff(at) > 0.0)
    assert np.count_nonzero(np.isnan(values)) == 1


def test_few_points_of_a_long_record_keep_its_peaks_and_its_gaps():
    times = np.delete(1e-3 * np.arange(200_000), slice(77_000, 77_010))
    values = np.sin(2.0 * np.pi * 50.0 * times)
    values[123_457] = 9.0
    at, shown = drawn(times, values)
    assert len(at) < 5000
    assert np.nanmax(shown) == 9.0
    assert np.count_nonzero(np.isnan(shown)) == 1
    assert 76.999 < at[np.isnan(shown)][0] < 77.010
    # Every stretch still shows the whole swing: the oscillation does not look smaller or slower.
    parts = np.array_split(shown[np.isfinite(shown)], 50)
    assert all(np.min(part) < -0.99 and np.max(part) > 0.99 for part in parts)


def test_what_was_filled_in_is_not_drawn_as_measured():
    values = np.sin(0.05 * np.arange(1000))
    values[300:330] = np.nan
    drive = InputSignal("hub", "m", (0.0, 1e-3), values)
    output = OutputSignal("y", "m", np.delete(0.01 * np.arange(100), slice(50, 60)), np.ones(90))
    upper, lower = figures.time_figure(TimeRecord((drive,), (output,))).axes
    line = upper.lines[0]
    hidden = np.asarray(line.get_xdata())[np.isnan(np.asarray(line.get_ydata(), dtype=float))]
    assert np.min(hidden) >= 0.299
    assert np.max(hidden) <= 0.331
    shaded = lower.patches[0]
    assert shaded.get_x() == pytest.approx(0.49)
    assert shaded.get_width() == pytest.approx(0.11)


def test_the_zeros_of_a_modal_model_stand_beside_its_poles(modal):
    model = modal[1].model
    left = figures.pole_zero_figure(model).axes[0]
    shown = [line for line in left.lines if line.get_label() == "zeros of z225"]
    zeros = model.zpk("z225")[0]
    drawn_zeros = shown[0].get_xdata() + 1j * shown[0].get_ydata()
    assert len(drawn_zeros) >= 1
    assert all(np.min(np.abs(zeros - zero)) < 1e-9 * abs(zero) for zero in drawn_zeros)


def test_decades_are_labelled_in_plain_text() -> None:
    """The typeset `$10^{-3}$` costs a fifth of a report's time."""
    figure, ((axis,),) = axes_grid(1, 1, (4.0, 3.0))
    axis.loglog([1e-3, 1.0, 100.0], [1e-6, 1.0, 1e4])
    plain_decades(figure)
    axis.set_xlim(1e-3, 1e2)
    assert axis.xaxis.get_major_formatter()(1e-3) == "10⁻³"
    assert axis.yaxis.get_major_formatter()(1e4) == "10⁴"
