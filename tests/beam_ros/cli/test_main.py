"""The `beam` command as a person meets it: exit status, one clear line; as a process where that may differ."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import pytest

from beam_ros.process.environment import child_environment
from beam_ros.process.executables import command
from tests.beam_ros.conftest import Beam, Ended


def beam_process(folder: Path, *arguments: str) -> Ended:
    return subprocess.run(
        [*command("beam"), *arguments],
        cwd=folder,
        env=child_environment(),
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


def strictly(ended: subprocess.CompletedProcess[str]) -> dict[str, Any]:
    """Read what `--json` printed as a strict reader does, which knows neither NaN nor Infinity."""
    return json.loads(ended.stdout, parse_constant=lambda word: pytest.fail(f"{word} is no JSON"))


def test_help_lists_the_verbs_and_needs_nothing(tmp_path: Path) -> None:
    ended = beam_process(tmp_path, "--help")
    assert ended.returncode == 0
    assert "beam demo" in ended.stdout


def _write(folder: Path, text: str) -> None:
    (folder / "rig.yaml").write_text(text)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("model", "beam.length:=0.2"), ("unrecognized", "given as `-p beam.length:=0.2`")),
        (("frobnicate",), ("unknown verb 'frobnicate'", "beam --help")),
        (("run", "frobnicator"), ("unknown node 'frobnicator'", "simulator")),
        (("run",), ("NODE", "--help")),
        (("model", "--rig-file", "nowhere.yaml"), ("nowhere.yaml", "no such file")),
        (("model", "--rig-file", "rig.yaml"), ("rig.yaml", "beam.length is 300", "0.01 to 5 m")),
        (("model", "-p", "beam.lenght:=0.3"), ("did you mean beam.length",)),
        (("design", "-p", "excitation.acceleration:=3.0"), ("predicted tip deflection", "lower")),
        (("design", "--optimal", "E"), ("criterion is 'E'", "expected D, A or c:NAME")),
        (("design", "--from", "model.json"), ("--from goes with --optimal alone",)),
        (("design", "--optimal", "--from", "nowhere.json"), ("nowhere.json", "is not there")),
        (("design", "--save", "rig.yaml"), ("rig.yaml exists", "another --save")),
        (("identify", "nowhere"), ("nowhere", "does not exist")),
        (("identify", "."), ("holds neither", "expected")),
        (("info", "rig.yaml"), ("rig.yaml", "no bag")),
        (("simulate", "--bag", "."), (".", "exist")),
        (("simulate",), ("--bag",)),
        (("export", "run"), ("--csv", "--flat-bag", "--model")),
        (("up", "--rig", "real"), ("serial.port",)),
        (("up", "--rig", "imaginary"), ("imaginary", "simulated")),
        (("demo", "--rig", "real"), ("real", "emulated")),
        (("demo", "--out", "."), ("not an empty folder",)),
        (("demo", "--out", "rig.yaml/run"), ("rig.yaml/run", "no folder for results")),
        (("model", "--plot", "rig.yaml/plots"), ("no folder for results",)),
        (("design", "-p", "excitation.end_frequency:=800.0"), ("500 Hz", "hub.period")),
        (
            ("demo", "--rig", "emulated", "-p", "simulation.real_time_factor:=0.5"),
            ("expected 1", "simulated rig"),
        ),
        (("axis", "conformance", "/dev/nowhere"), ("5 % of its travel", "--yes", "--no-motion")),
        (
            ("axis", "conformance", "/dev/nowhere", "--no-motion"),
            ("/dev/nowhere", "expected an existing port"),
        ),
        (("axis", "conformance", "x", "--yes", "--only", "sequences"), ("did you mean sequence?",)),
    ],
)
def test_a_fault_of_the_users_is_one_line_and_status_2(
    tmp_path: Path, beam: Beam, arguments: tuple[str, ...], words: tuple[str, ...]
) -> None:
    _write(tmp_path, "/**: {ros__parameters: {beam: {length: 300}}}")
    assert_refused(beam(*arguments), words)
    assert [path.name for path in tmp_path.iterdir()] == ["rig.yaml"], "something was left behind"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("run", "simulator", "--bogus"), ("--bogus", "--ros-args")),
        (("replay", "nowhere"), ("nowhere", "does not exist")),
        (("record", "rig.yaml"), ("exists already",)),
        (("identify", "nowhere"), ("nowhere", "does not exist")),
    ],
)
def test_a_process_ends_with_the_same_line_and_status(
    tmp_path: Path, arguments: tuple[str, ...], words: tuple[str, ...]
) -> None:
    _write(tmp_path, "")
    assert_refused(beam_process(tmp_path, *arguments), words)


def assert_refused(ended: Ended, words: tuple[str, ...]) -> None:
    assert ended.returncode == 2, ended.stderr
    assert len(ended.stderr.strip().splitlines()) == 1, ended.stderr
    assert "Traceback" not in ended.stderr
    for word in words:
        assert word in ended.stderr


@pytest.mark.slow
def test_simulate_identify_info_export_and_recover_work_together(tmp_path: Path, beam: Beam) -> None:
    quick = (
        "-p",
        "excitation.duration:=3.0",
        "-p",
        "excitation.still:=1.0",
        "-p",
        "excitation.end_frequency:=40.0",
    )
    made = beam("simulate", "--bag", "first", *quick)
    assert (made.returncode, made.stdout.strip()) == (0, "first")
    found = beam("identify", "first", "--json")
    assert found.returncode == 0, found.stderr
    assert strictly(found)["modes"][0]["frequency_hz"] == pytest.approx(4.3839, rel=1e-3)
    told = beam("info", "first")
    assert told.returncode == 0
    assert "hub/measured" in told.stdout
    assert "-p excitation.kind:=chirp -p excitation.acceleration:=0.7" in told.stdout
    counted = strictly(beam("info", "first", "--json"))
    csv = beam("export", "first", "--csv", "tables").stdout.split()
    measured = [path for path in csv if "measured" in path]
    signals = {signal["topic"]: signal for signal in counted["signals"]}
    assert len(measured) == 1
    n_lines = len((tmp_path / measured[0]).read_text().splitlines())
    assert n_lines == 1 + signals["/hub/measured"]["samples"]
    flat = beam("export", "first", "--flat-bag", "flat")
    assert (flat.returncode, flat.stdout.strip()) == (0, "flat")
    mended = beam("recover", "first", "--to", "second")
    assert mended.returncode == 0
    assert mended.stdout.splitlines()[0].startswith(f"second: {counted['message_count']} messages over ")
    assert "nothing was amiss" in mended.stdout


def test_model_prints_frequencies_and_their_aliases_in_the_frames(beam: Beam) -> None:
    theory = strictly(beam("model", "--json"))
    assert theory["frequencies_hz"][2] == pytest.approx(79.358, abs=1e-3)
    assert theory["aliases_hz"][2] == pytest.approx(20.642, abs=1e-3)
    assert "20.64 Hz" in beam("model").stdout


def test_model_lists_every_parameter(beam: Beam) -> None:
    told = beam("model", "--parameters").stdout
    assert "beam.length = 0.3" in told
    assert "0.01 to 5 m" in told
