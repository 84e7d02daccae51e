from __future__ import annotations

import pytest

from tests.pages import run_page


def test_the_page_on_the_frequency_domain_runs_from_top_to_bottom(capsys: pytest.CaptureFixture[str]) -> None:
    names = run_page("frequency-domain.md")
    printed = capsys.readouterr().out
    assert "no nonlinear distortion" in printed
    assert names["found"].response.frequencies_hz[-1] > 25.0  # type: ignore[attr-defined]
    stepped, beam = names["stepped"], names["beam"]
    truth = beam.frequency_response(stepped.omegas).response  # type: ignore[attr-defined]
    scores = abs(stepped.response[:, :, 0] - truth) / stepped.sd[:, :, 0]  # type: ignore[attr-defined]
    assert scores.max() < 3.5
    assert abs(names["decay"].damping_ratios[0] / 0.02 - 1.0) < 0.05  # type: ignore[attr-defined]


def test_the_page_on_distortion_runs_from_top_to_bottom(capsys: pytest.CaptureFixture[str]) -> None:
    best = run_page("best-linear.md")["best"]
    assert "nonlinear" in capsys.readouterr().out
    assert best.record("total") is not None  # type: ignore[attr-defined]


def test_the_page_on_modal_analysis_runs_from_top_to_bottom(capsys: pytest.CaptureFixture[str]) -> None:
    names = run_page("modal-analysis.md")
    assert "nothing to warn of" in capsys.readouterr().out
    analysis = names["analysis"]
    assert len(analysis.damping_ratios) == 5  # type: ignore[attr-defined]
    assert abs(names["circle"].damping_ratio / 0.017 - 1.0) < 0.05  # type: ignore[attr-defined]


@pytest.mark.slow
def test_the_page_on_amplitude_runs_from_top_to_bottom(capsys: pytest.CaptureFixture[str]) -> None:
    curves = run_page("amplitude.md")["curves"]
    assert "one pole does not describe the decay" in capsys.readouterr().out
    # -A'/A of the written amplitude at its start, where 1 + 0.4 (1 - e) = 1: 0.11 (1 + 0.4).
    assert abs(curves.damping_ratio_at(0.02) * 27.6 / (0.11 * 1.4) - 1.0) < 0.02  # type: ignore[attr-defined]


@pytest.mark.slow
def test_the_page_on_the_axis_runs_from_top_to_bottom(capsys: pytest.CaptureFixture[str]) -> None:
    axis = run_page("axis.md")["axis"]
    # The mass, friction and constant force that the page writes down; its steps of 50 us err by far less.
    truth = [2.0, 4.0, 1.5, 0.0]
    assert axis.estimates[:4] == pytest.approx(truth, abs=5e-3)
    assert "moving mass" in capsys.readouterr().out
