from __future__ import annotations

import numpy as np
import pytest

from beam_model import BeamModel, BeamParameterError, Damping
from beam_model.advice.experiment_advice import (
    advise,
    aliases,
    node_heights,
    relative_amplitudes,
    suggest_marker_heights,
)
from tests.beam_model.rigs import strip

MODEL = BeamModel(strip(damping=Damping(ratios=(0.005,))), 5)


def test_nodes_are_those_of_the_textbook() -> None:
    # Blevins 1979, table 8-1: nodes of a cantilever in lengths.
    assert node_heights(MODEL, 0).size == 0
    assert node_heights(MODEL, 1) / 0.30 == pytest.approx([0.7834], abs=1e-4)
    assert node_heights(MODEL, 2) / 0.30 == pytest.approx([0.5035, 0.8677], abs=1e-4)
    assert node_heights(MODEL, 3).size == 3
    with pytest.raises(BeamParameterError, match="mode"):
        node_heights(MODEL, 5)


def test_aliases_are_where_the_reference_saw_them() -> None:
    assert aliases([79.4, 155.6, 257.3], 100.0) == pytest.approx([20.6, 44.4, 42.7])
    with pytest.raises(BeamParameterError, match="frame_rate"):
        aliases([1.0], 0.0)


@pytest.mark.parametrize("n_modes", [1, 2, 3, 5])
@pytest.mark.parametrize("n_markers", [1, 2, 3])
def test_suggested_heights_see_every_mode_better_than_any_other(n_modes: int, n_markers: int) -> None:
    heights = suggest_marker_heights(MODEL, n_modes, n_markers, lowest=0.05)
    assert heights.size == n_markers
    assert np.all(heights >= 0.05 - 1e-12)
    assert np.all(np.diff(heights) >= 0.02 - 1e-9)

    def worst(chosen: np.ndarray) -> float:
        return float(np.sum(relative_amplitudes(MODEL, chosen)[:, :n_modes] ** 2, axis=0).min())

    found = worst(heights)
    rng = np.random.default_rng(1)
    for _ in range(200):
        others = np.sort(rng.choice(np.linspace(0.05, 0.30, 61), n_markers, replace=False))
        if n_markers == 1 or np.diff(others).min() >= 0.02:
            assert worst(others) <= found + 1e-9


def test_advice_covers_the_wanted_modes() -> None:
    advice = advise(MODEL, 3)
    f = MODEL.natural_frequencies / (2.0 * np.pi)
    assert advice.excitation_band[0] < f[0]
    assert f[2] < advice.excitation_band[1] < f[3]
    assert advice.frame_rate > 2.0 * f[2]
    # 0.5 % of 4.53 Hz: 45 mHz between the half-power points
    assert advice.half_power_bandwidths[0] == pytest.approx(0.0453, abs=1e-4)
    assert advice.settling_time == pytest.approx(48.5, abs=0.2)
    assert np.all(advice.visibility > 0.5)
    assert advise(BeamModel(strip(), 2), 2).settling_time == np.inf


@pytest.mark.parametrize(
    ("keywords", "name"),
    [
        ({"n_modes": 6}, "n_modes"),
        ({"n_modes": 0}, "n_modes"),
        ({"n_modes": 2, "n_markers": 4}, "n_markers"),
        ({"n_modes": 2, "lowest": 0.4}, "lowest"),
        ({"n_modes": 2, "separation": 0.5}, "separation"),
    ],
)
def test_bad_wishes_are_refused(keywords: dict[str, float], name: str) -> None:
    with pytest.raises(BeamParameterError, match=name):
        suggest_marker_heights(MODEL, **keywords)  # type: ignore[arg-type]


def test_markers_may_stand_as_close_as_the_separation_allows_exactly() -> None:
    model = BeamModel(strip(), 2)
    # One pair is left: from the lowest height allowed to the tip.
    found = suggest_marker_heights(model, 2, lowest=0.1, separation=0.2)
    assert found == pytest.approx([0.1, 0.3], abs=1e-12)
