from __future__ import annotations

import json
from pathlib import Path

import pytest

pytest.importorskip("matplotlib")

from beam_ros.cli.main import main
from beam_ros.errors import UsageError
from beam_ros.offline.identification import write_models
from beam_ros.offline.identification_summary import IdentificationOutcome
from beam_ros.reporting.comparison import compare


@pytest.fixture(scope="module")
def model(outcome: IdentificationOutcome, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_models(outcome, tmp_path_factory.mktemp("stored") / "model.json")


@pytest.mark.slow
def test_a_bag_is_compared_with_a_stored_model_on_page_and_as_json(
    model: Path, second_bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = ["compare", str(model.parent), str(second_bag), "--report", str(tmp_path / "out"), "--json"]
    assert main(given) == 0
    said = json.loads(capsys.readouterr().out)
    assert [one["name"] for one in said["models"]] == [model.parent.name, "second"]
    assert said["models"][1]["deflection_m"] > 1e-3
    differences = said["differences"][0]["modes"]
    assert [mode["mode"] for mode in differences] == [1, 2]
    assert all(abs(mode["frequency_z"]) < 5.0 for mode in differences)
    assert json.loads((tmp_path / "out" / "comparison.json").read_text()) == said
    assert "SHA-256" in (tmp_path / "out" / "comparison.html").read_text()
    assert main(given) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert main([*given, "--overwrite"]) == 0


def test_names_that_are_the_same_are_told_apart(model: Path) -> None:
    found = compare([model, model.parent])
    names = [trial.name for trial in found.trials]
    assert len(set(names)) == 2


def test_what_holds_no_model_is_refused(model: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.json"
    for text in ("[1, 2]", '{"model": {"type": "song"}}', "{"):
        other.write_text(text)
        with pytest.raises(UsageError, match=r"model\.json"):
            compare([model, other])
    with pytest.raises(UsageError, match="at least two"):
        compare([model])
