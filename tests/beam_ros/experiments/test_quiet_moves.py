"""Moves of a plan: what one may say, and one that is shaped, played and judged on the simulator's core."""

from __future__ import annotations

import json
from datetime import datetime, timezone
from pathlib import Path

import pytest

from beam_ros.cli.main import main
from beam_ros.errors import ParameterFileError
from beam_ros.experiments.conduct import describe_plan
from beam_ros.experiments.plan import packaged_plans, read_plan

PLAN = """
title: Quiet
parameters:
  simulation: {images: false}
  excitation: {dwell: 1 s, still: 0.1 s}
recordings:
  E1:
    excitation: {kind: chirp, duration: 6 s, still: 2 s, end_frequency: 95 Hz}
  E2:
    excitation: {kind: moves, waypoints: [8 mm, 0 mm], acceleration: 2 m/s^2, speed: 0.5 m/s, jerk: 200, still: 4 s}
estimations:
  modal: {recordings: [E1], modes: 3}
moves:
  quiet: {estimation: modal, rehearsal: E2, from: 5 mm, to: -15 mm, aim: 30 um}
"""


def write(folder: Path, text: str = PLAN) -> Path:
    path = folder / "plan.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_move_is_shaped_played_unshaped_and_shaped_and_judged(tmp_path: Path) -> None:
    plan = read_plan(write(tmp_path))
    (move,) = plan.moves
    assert (move.start, move.end, move.aim) == pytest.approx((0.005, -0.015, 30e-6))
    assert (move.estimation, move.fit, move.rehearsal) == ("modal", "E1", "E2")
    assert describe_plan(plan)[-5:] == [
        "shape quiet",
        "play quiet-unshaped",
        "play quiet-shaped",
        "judge quiet",
        "report",
    ]
    assert plan.digest() != read_plan(write(tmp_path, PLAN.replace("30 um", "40 um"))).digest()
    assert "quiet-move" in packaged_plans()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("aim: 30 um", "aim: 30 kg", "not a unit"),
        (", aim: 30 um", "", "aim is missing"),
        ("to: -15 mm", "to: 5 mm", "goes nowhere"),
        ("to: -15 mm", "to: -15", "excitation.move_to"),
        ("rehearsal: E2", "rehearsal: E3", "moves.quiet.rehearsal"),
        ("{estimation: modal,", "{estimation: other,", "moves.quiet.estimation"),
        ("from: 5 mm", "form: 5 mm", "did you mean from"),
        ("  E2:", "  quiet-shaped:", "rehearsal"),
        ("recordings: [E1], modes: 3", "recordings: [E1, E2]", "expected one modal model"),
        ("{images: false}", "{images: false}\n  hub: {command_mode: effort}", "set hub.command_mode"),
    ],
)
def test_what_is_wrong_with_a_move_is_said_with_its_place(
    old: str, new: str, words: str, tmp_path: Path
) -> None:
    text = PLAN.replace(old, new)
    if "effort" in new:
        text = text.replace("acceleration: 2 m/s^2", "acceleration: 0.1 m/s^2").replace("8 mm", "1 mm")
        text = text.replace("end_frequency: 95 Hz", "end_frequency: 95 Hz, acceleration: 0.05 m/s^2")
    with pytest.raises(ParameterFileError, match=words.replace(".", r"\.")):
        read_plan(write(tmp_path, text))


@pytest.mark.slow
def test_the_report_holds_what_was_measured_against_what_was_predicted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    begun = datetime.now(timezone.utc)
    assert main(["experiment", str(write(tmp_path)), "--out", str(tmp_path / "out"), "--json"]) == 0
    outcome = json.loads(capsys.readouterr().out)
    (verdict,) = outcome["moves"]
    assert verdict == json.loads((tmp_path / "out" / "verdicts" / "quiet.json").read_text())
    assert verdict["is_below_aim"]
    assert verdict["keeps_aim_by_prediction"]
    assert verdict["reduction"] > 100.0
    assert verdict["lower_bound_s"] <= verdict["duration_s"]
    names = [own["name"] for own in outcome["recordings"]]
    assert names == ["E1", "E2", "quiet-unshaped", "quiet-shaped"]
    page = (tmp_path / "out" / "report.html").read_text()
    assert "Moves that do not ring" in page
    assert 'href="moves/quiet/report.html"' in page
    assert (tmp_path / "out" / "moves" / "quiet" / "report.html").stat().st_mtime >= begun.timestamp() - 1.0
