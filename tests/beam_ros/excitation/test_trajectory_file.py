"""A trajectory of one's own from its file to the axis: designed, refused with the place, simulated."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from beam_ros.bags.reading import Bag
from beam_ros.cli.main import main
from beam_ros.errors import RigError
from beam_ros.excitation.plan import plan_excitation
from beam_ros.excitation.recipes import describe_excitation
from beam_ros.rig.rig import Rig

T = 1e-3


def smooth(n: int = 401) -> tuple[np.ndarray, np.ndarray]:
    """Times [s] and velocities [m/s] of a move out and back."""
    times = T * np.arange(n)
    return times, 0.02 * np.sin(2.0 * np.pi * times / times[-1]) ** 2 * np.sign(times[-1] / 2 - times)


def rig_of(path: Path, **more: object) -> Rig:
    named = {f"excitation.{name}": value for name, value in more.items()}
    return Rig.from_file().with_values(
        {"excitation.kind": "file", "excitation.file": str(path), "excitation.still": 0.5, **named}
    )


@pytest.fixture
def file(tmp_path: Path) -> Path:
    times, speeds = smooth()
    path = tmp_path / "path.csv"
    rows = (f"{1e3 * t!r},{1e3 * v!r},{v!r}" for t, v in zip(times.tolist(), speeds.tolist(), strict=True))
    path.write_text("\n".join(("t_ms,v [mm/s],raw", *rows, "")))
    return path


@pytest.mark.parametrize("mode", ["acceleration", "velocity", "position"])
def test_a_file_is_played_as_it_says_in_every_command_mode(file: Path, mode: str) -> None:
    plan = plan_excitation(rig_of(file).with_values({"hub.command_mode": mode}))
    times, speeds = smooth()
    np.testing.assert_allclose(plan.sampled.velocities[: len(times)], speeds, atol=1e-13)
    np.testing.assert_array_equal(plan.values, plan.sampled.samples(mode))
    assert plan.recipe.to_dict()["source"].startswith("path.csv ")


def test_the_unit_may_be_given_and_then_names_the_column(file: Path) -> None:
    same = plan_excitation(rig_of(file, file_values="raw,unit=m/s", file_time="t_ms"))
    np.testing.assert_allclose(same.values, plan_excitation(rig_of(file)).values, atol=1e-12)
    info = same.info(rig_of(file, file_values="raw,unit=m/s"))
    said = describe_excitation(json.loads(json.dumps(info)))
    assert "-p excitation.file_values:=raw,unit=m/s" in said
    assert "file_time" not in said


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"file": ""}, "excitation.file is empty"),
        ({"file": "nowhere.csv"}, "nowhere.csv: is no file"),
        ({"file_values": "raw"}, "column 'raw' has no unit"),
        (
            {"file_values": "raw,unit=N"},
            "column 'raw' is in N; expected a position, velocity or acceleration",
        ),
        ({"file_values": "raw,mm"}, "expected a column and perhaps its unit"),
        (
            {"file_values": "v,unit=m/s"},
            "in mm/s by its heading and in m/s by what was given, 1000 times as much",
        ),
        ({"file_values": "raw,unit=km/s"}, "not known"),
    ],
)
def test_a_file_that_says_no_motion_is_refused(file: Path, change: dict[str, object], words: str) -> None:
    with pytest.raises(RigError, match=words):
        plan_excitation(rig_of(file, **change))


def test_a_limit_is_named_with_time_and_value(file: Path) -> None:
    with pytest.raises(
        RigError,
        match=r"peak travel 2 m is above the limit of 0.05 m, first at 0\.\d+ s; .* a thousand times smaller, as mm",
    ):
        plan_excitation(_scaled(file))
    with pytest.raises(RigError, match=r"hub.max_tip_deflection is .*; the limit is left at 0\.\d+ s"):
        plan_excitation(rig_of(file).with_values({"hub.max_tip_deflection": 0.0005}))


def _scaled(file: Path) -> Rig:
    """The millimetres of the file as metres: the slip that the message names."""
    text = file.read_text().replace("v [mm/s]", "v [m/s]")
    other = file.with_name("slip.csv")
    other.write_text(text)
    return rig_of(other)


def test_a_bad_row_is_refused_with_its_line(file: Path) -> None:
    lines = file.read_text().splitlines()
    lines[6] = lines[6].replace(",", ",x", 1)
    file.write_text("\n".join(lines))
    with pytest.raises(RigError, match=r"path.csv, line 7: 'v \[mm/s\]' is 'x"):
        plan_excitation(rig_of(file))


def test_two_motions_in_a_file_must_be_told_apart(tmp_path: Path) -> None:
    path = tmp_path / "two.csv"
    path.write_text("t_s,x_mm,v_mm_s\n0,0,0\n1,1,0\n2,0,0\n")
    with pytest.raises(
        RigError, match=r"2 columns have a unit of motion; name one with excitation.file_values"
    ):
        plan_excitation(rig_of(path))


@pytest.mark.slow
def test_design_and_simulation_play_a_file(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    told = ["-p", "excitation.kind:=file", "-p", f"excitation.file:={file}", "-p", "excitation.still:=0.5"]
    assert main(["design", *told, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["peaks"]["speed"][0] == pytest.approx(0.02, rel=1e-3)
    rig = rig_of(file)
    plan_file = tmp_path / "rig.yaml"
    rig.write(plan_file)
    assert main(["simulate", str(plan_file), "--bag", str(tmp_path / "bag")]) == 0
    with Bag(tmp_path / "bag") as bag:
        applied = bag.hub_samples("hub/applied")
        info = bag.excitation_info()
    assert info is not None
    assert info["recipe"]["kind"] == "file"
    assert applied.accelerations is not None
    played = applied.accelerations[np.flatnonzero(applied.accelerations)[0] :][:399]
    speeds = smooth()[1]
    np.testing.assert_allclose(
        played, np.diff(speeds)[np.flatnonzero(np.diff(speeds))[0] :][:399] / T, atol=1e-9
    )
