from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from beam_model import BeamModel, BeamParameterError, Damping
from beam_model.advice.summary import summarise
from tests.beam_model.rigs import HEIGHTS, strip

MODEL = BeamModel(strip(gravity="upright", damping=Damping(ratios=(0.005,))), 5)


def test_the_page_warns_of_the_marker_near_a_node() -> None:
    summary = summarise(MODEL, HEIGHTS)
    # 225 mm is 10 mm from the node of mode 2; 285 mm is not near any.
    assert summary.marker_amplitudes[1, 1] < 0.16
    assert summary.marker_amplitudes[2, 1] > 0.6
    assert np.all(np.abs(summary.nodes_mm[1] - 235.0) < 1.0)
    text = summary.to_text()
    assert "4.3839 Hz" in text
    assert "225.0 mm" in text
    # Modes 3 to 5 alias at 100 frames a second.
    assert text.count("as it is") == 2
    assert "20.64 Hz" in text


def test_the_machine_s_page_survives_json() -> None:
    undamped = summarise(BeamModel(strip(), 2))
    page = json.loads(json.dumps(undamped.to_dict(), allow_nan=False))
    assert page["advice"]["settling_time_s"] is None
    assert page["marker_heights_mm"] == []
    assert "never" in undamped.to_text()
    page = json.loads(json.dumps(summarise(MODEL, HEIGHTS).to_dict(), allow_nan=False))
    assert page["frequencies_hz"][0] == pytest.approx(4.3839366, abs=1e-6)
    assert len(page["residues"]) == 3
    assert len(page["advice"]["half_power_bandwidths_hz"]) == 3


def test_bad_markers_and_cameras_are_refused() -> None:
    with pytest.raises(BeamParameterError, match="heights"):
        summarise(MODEL, [0.4])
    with pytest.raises(BeamParameterError, match="frame_rate"):
        summarise(MODEL, frame_rate=0.0)


def test_the_documentation_s_example_runs(capsys: pytest.CaptureFixture[str]) -> None:
    page = (Path(__file__).parents[3] / "docs" / "beam-model.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    assert blocks
    for block in blocks:
        exec(compile(block, "docs/beam-model.md", "exec"), {})
    assert "[" in capsys.readouterr().out
