"""Columns of a file as signals: what they are taken for, and a foreign file identified in one line."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from beam_ros.checks.bag_check import check_bag
from beam_ros.cli.main import main
from beam_ros.errors import RigError
from beam_ros.files.errors import ColumnFileError
from beam_ros.files.formats import FORMATS
from beam_ros.model_files.formats import FORMATS as MODEL_FORMATS
from beam_ros.offline.loading.experiment import load_experiment
from beam_ros.offline.loading.options import FitOptions
from beam_ros.signals.descriptions import Signals
from beam_ros.signals.file_columns import read_file_signals
from tests.beam_ros.signals import foreign_bags as foreign

HEAD = "Zeit [ms];Kraft (N);hub_mm;tip_mm;accel_g;raw_V"


def write(path: Path, beam: foreign.Beam, noise: float = 1e-6, step: int = 2) -> Path:
    """Write what happened as a German instrument does: semicolons, decimal commas, milliseconds."""
    rng = np.random.default_rng(3)
    seen = beam.displacement + noise * rng.standard_normal(len(beam.displacement))
    columns = (
        1e3 * beam.times_s,
        beam.base_acceleration,
        1e3 * beam.base,
        1e3 * seen,
        beam.acceleration / 9.80665,
    )
    rows = [";".join(map(repr, row)) + ";0.5" for row in np.column_stack(columns)[::step].tolist()]
    path.write_text("\n".join((HEAD, *rows, "")).replace(".", ","))
    return path


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("files") / "measured.csv", foreign.shaken(5.0))


def test_units_say_what_a_column_is_and_values_are_si(file: Path) -> None:
    notes: list[str] = []
    found = read_file_signals(file, Signals.of("Kraft", ["tip", "accel_g,scale=-1,name=a"]), "", notes)
    told = [(source.title, source.input_kind, source.output_kind, source.factor) for source, _ in found]
    assert told[0][:2] == ("Kraft", "force")
    assert told[1] == ("tip", "position", "receptance", 1e-3)
    assert told[2] == ("a", "acceleration", "accelerance", -9.80665)
    stamps = found[0][1].stamps_ns
    assert stamps[1] - stamps[0] == 2_000_000
    assert not notes


def test_a_file_becomes_records_of_one_model_as_a_bag_does(file: Path) -> None:
    beam = foreign.shaken(5.0)
    options = FitOptions(signals=Signals.of("hub", ["tip_mm", "accel_g"]))
    found = load_experiment(file, options=options)
    assert found.structure == "base_motion"
    assert [own.output_names for own in found.records] == [("accel",), ("tip",)]
    tip = found.records[1].outputs[0]
    np.testing.assert_allclose(tip.values, np.interp(tip.times_s, beam.times_s, beam.displacement), atol=1e-5)
    assert (tip.unit, found.records[1].inputs[0].unit) == ("m", "m")
    assert "output accel is taken for accelerance, in m/s^2" in found.notes
    part = load_experiment(file, options=options, start_s=1.0, end_s=2.0)
    assert part.record.inputs[0].span_s[1] < 1.01


@pytest.mark.parametrize(
    ("drive", "outputs", "words"),
    [
        (
            "",
            ["tip"],
            r"the input is not named; name both with --input and --output, among its columns: Zeit",
        ),
        ("Kraft", [], "an output is not named"),
        ("Krat", ["tip"], "no column 'Krat'; did you mean"),
        (
            "Kraft",
            ["raw"],
            r"column 'raw_V' is in V, not a unit of an output; .*kind=accelerance,scale=",
        ),
        ("Kraft", ["tip,unit=m"], "in mm by its heading and in m by what was given, 1000 times as much"),
        ("Kraft", ["tip,kind=accelerance"], "kind is accelerance, but the unit mm is of another"),
        ("Zeit", ["tip"], "in ms, not a unit of an input"),
        ("Kraft", ["tip_mm", "tip_mm"], "two signals have the name"),
    ],
)
def test_what_cannot_be_meant_is_refused(file: Path, drive: str, outputs: list[str], words: str) -> None:
    with pytest.raises(RigError, match=words):
        read_file_signals(file, Signals.of(drive, outputs), "", [])


def test_a_voltage_with_a_kind_and_a_scale_is_an_output(file: Path) -> None:
    (_, (source, samples)) = read_file_signals(
        file, Signals.of("Kraft", ["raw,kind=accelerance,scale=98.1"]), "", []
    )
    assert source.output_unit == "m/s^2"
    assert samples.values[0] * source.factor == pytest.approx(49.05)


def test_the_check_judges_a_file_and_names_what_is_not_of_a_bag(file: Path) -> None:
    checked = check_bag(file, options=FitOptions(signals=Signals.of("hub", ["tip"])))
    assert checked.can_be_identified
    names = [gate.name for gate in checked.gates]
    assert names[0] == "file"
    assert "device clock" not in names
    far = check_bag(file, options=FitOptions(signals=Signals.of("hub", ["tip_mm,scale=1000"])))
    assert any("times as much as hub: millimetres?" in gate.figure for gate in far.gates)


def test_the_check_looks_at_the_part_that_is_asked_for(
    file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = [str(file), "--input", "hub", "--output", "tip", "--time", "rate=500", "--from", "1", "--to", "3"]
    assert main(["check", *given]) == 0
    assert re.search(r"frequencies 0\.5\d* Hz apart, 2 s", capsys.readouterr().out)


def test_a_value_that_is_missing_in_a_row_is_no_jump_of_a_clock(tmp_path: Path) -> None:
    path = tmp_path / "seen.csv"
    t = 0.01 * np.arange(400)
    seen = [f"{v:.9g}" for v in 1e-3 * np.sin(9.0 * t + 0.5)]
    seen[200] = ""
    rows = [f"{own:.2f},{np.sin(9.0 * own):.9g},{value}" for own, value in zip(t, seen, strict=True)]
    path.write_text("\n".join(["t_s,hub_mm,tip_m", *rows, ""]))
    checked = check_bag(path, options=FitOptions(signals=Signals.of("hub", ["tip"])))
    assert "clock jumps" not in [gate.name for gate in checked.gates]


def test_a_column_means_nothing_in_a_bag(tmp_path: Path) -> None:
    bag = foreign.write(tmp_path / "bag", [("/a", foreign.START, foreign.float64(1.0))])
    with pytest.raises(RigError, match="'tip_mm' names no field of a topic"):
        load_experiment(bag, options=FitOptions(signals=Signals.of("/a:data", ["tip_mm"])))


@pytest.mark.slow
def test_a_foreign_file_is_identified_in_one_line(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [
        str(file),
        "--input",
        "hub",
        "--output",
        "tip_mm",
        "--modes",
        "2",
        "--report",
        str(tmp_path / "report"),
    ]
    assert main(["identify", *words, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    np.testing.assert_allclose([m["frequency_hz"] for m in found["modes"]], foreign.FREQUENCIES_HZ, rtol=1e-4)
    np.testing.assert_allclose(
        [m["damping_ratio"] for m in found["modes"]], foreign.DAMPING_RATIOS, rtol=1e-2
    )
    assert "SHA-256 of measured.csv" in (tmp_path / "report" / "report.html").read_text()
    assert main(["identify", *words]) == 2
    assert "--overwrite" in capsys.readouterr().err


def test_a_bad_file_ends_the_verb_with_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "bad.csv"
    path.write_text("t_s,f_N,x_mm\n0,1,2\n0.1,1,2\n0.05,1,2\n")
    assert main(["identify", str(path), "--input", "f", "--output", "x"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "line 4: 't_s' (0.05 s) does not come after the row before it" in line
    with pytest.raises(ColumnFileError):
        load_experiment(path, options=FitOptions(signals=Signals.of("f", ["x"])))


PAGE = Path(__file__).resolve().parents[3] / "docs" / "files.md"


def test_the_page_lists_every_format_that_is_read_and_written() -> None:
    text = PAGE.read_text(encoding="utf-8")
    for own in FORMATS:
        for suffix in own.suffixes:
            assert f"`{suffix}`" in text
    for model_format in MODEL_FORMATS:
        assert f"`--{model_format.flag}`" in text


def test_the_code_of_the_page_runs() -> None:
    block = PAGE.read_text(encoding="utf-8").partition("```python\n")[2].partition("```")[0]
    exec(compile(block, str(PAGE), "exec"), {})
