"""`beam shape` from the command line to a recorded move, and what the bag then shows."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from beam_ros.cli.main import main
from beam_ros.errors import UsageError
from beam_ros.offline.axis_following import following_of_bag
from beam_ros.offline.simulation import simulate
from beam_ros.offline.swing_after import swing_after
from beam_ros.reporting.shaping import known_model
from beam_ros.rig.rig import Rig

CHIRP = {"excitation.duration": 6.0, "excitation.still": 3.0, "simulation.images": False}


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("chirp") / "bag"
    simulate(Rig.from_file().with_values(CHIRP), path)
    return path


@pytest.mark.slow
def test_a_student_identifies_shapes_plays_and_finds_the_swing_that_was_predicted(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["identify", str(bag), "--modes", "3", "--report", str(tmp_path / "report")]) == 0
    model = tmp_path / "report" / "model.json"
    shape = ["shape", str(model), "--from", "0.0", "--to", "0.05", "--aim", "20e-6"]
    assert main([*shape, "--out", str(tmp_path / "move")]) == 0
    printed = capsys.readouterr().out
    assert "no move could be shorter than" in printed
    assert "tip deflection" in printed, "the S-curve is forbidden, and said to be"
    content = json.loads((tmp_path / "move" / "move.json").read_text())
    assert content["keeps_aim"]
    assert content["lower_bound_s"] <= content["chosen"]["duration_s"]
    assert (tmp_path / "move" / "report.html").read_text().count("<svg") == 2
    assert main([*shape, "--out", str(tmp_path / "move")]) == 2, "nothing is written over"
    assert "give another --out" in capsys.readouterr().err
    played = [str(tmp_path / "move" / "move.yaml"), "--bag", str(tmp_path / "played")]
    assert main(["simulate", *played, "-p", "simulation.images:=false", "-p", "excitation.still:=0.1"]) == 0
    after = swing_after(tmp_path / "played", known_model(model).model)
    assert np.max(after.swings) < 20e-6
    with pytest.raises(UsageError, match="expected a shaped_move"):
        swing_after(bag, known_model(model).model)


def test_an_axis_that_follows_exactly_has_no_lag(bag: Path) -> None:
    found = following_of_bag(bag)
    assert found is not None
    assert found.lag == 0.0
    assert found.scatters[0][1] < 1e-7
    assert found.scatters[0][0] == pytest.approx(0.7, rel=0.05)


@pytest.mark.slow
def test_frictions_lag_is_read_off_a_bag(tmp_path: Path) -> None:
    rig = Rig.from_file().with_values(
        {**CHIRP, "simulation.servo_frequency": 60.0, "simulation.friction_coulomb": 1.5}
    )
    simulate(rig, tmp_path / "bag")
    found = following_of_bag(tmp_path / "bag")
    stiffness = rig.beam_parameters().total_mass * (2 * np.pi * 60.0) ** 2
    assert found is not None
    assert found.lag == pytest.approx(1.5 / stiffness, rel=0.15)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--to", "0.02", "--aim", "20e-6", "--rehearsal", "there"], "goes with a MODEL"),
        (["--to", "0.02", "--aim", "20e-6", "--frequency-sd", "2"], "expected a share"),
        (["nowhere.json", "--to", "0.02", "--aim", "20e-6"], "is not there"),
        (["--to", "0.02", "--aim", "20e-6", "-p", "hub.command_mode:=effort"], "set hub.command_mode"),
        (["--to", "20", "--aim", "20e-6"], "travel ends at"),
    ],
)
def test_what_cannot_be_shaped_is_one_line_and_nothing_is_written(
    arguments: list[str], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["shape", *arguments, "--out", str(tmp_path / "out")]) == 2
    assert words in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
