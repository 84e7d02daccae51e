"""Files of columns as bags: the same values at their stamps, where they come from, and nothing written over."""

from __future__ import annotations

import hashlib
import json
import re
from datetime import datetime, timezone
from pathlib import Path

import numpy as np
import pytest

from beam_ros.bags.errors import BagExistsError
from beam_ros.bags.reading import Bag
from beam_ros.cli.main import main
from beam_ros.errors import RigError
from beam_ros.files.errors import ColumnFileError
from beam_ros.offline.column_import import import_columns
from beam_ros.offline.loading.experiment import load_experiment
from beam_ros.offline.loading.options import FitOptions
from beam_ros.signals.descriptions import Signals
from beam_ros.signals.fields import read_field
from tests.beam_ros.files.tables import FORCE, TIP, WRITERS

HEAD = "t_ms,hub (mm),v_mm_s,acc/a [g],left acc [g],force_kN,note"
ROWS = np.random.default_rng(5).standard_normal((40, 6))
START = datetime(2026, 5, 3, 12, 0, 0, 250_000, timezone.utc)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "run 1.csv"
    rows = [f"{7 + 2 * k},{','.join(map(repr, row))}" for k, row in enumerate(ROWS[:, 1:].tolist())]
    path.write_text("\n".join((HEAD, *(f"{row},{k}" for k, row in enumerate(rows)), "")))
    return path


def test_every_column_with_a_unit_is_a_field_of_a_type_that_says_what_it_is(
    file: Path, tmp_path: Path
) -> None:
    found = import_columns(file, tmp_path / "bag", Signals(), start=START)
    assert found.n_rows == 40
    assert found.signals is None
    assert found.topics == (
        "/columns/position:position[hub]",
        "/columns/velocity:velocity[v]",
        "/columns/acc_a:accel.linear.x",
        "/columns/left_acc:accel.linear.x",
        "/columns/effort:effort[force]",
    )
    factors = (1e-3, 1e-3, 9.80665, 9.80665, 1e3)
    with Bag(tmp_path / "bag") as bag:
        for k, (text, factor) in enumerate(zip(found.topics, factors, strict=True), 1):
            topic, _, field = text.partition(":")
            samples = read_field(bag, topic, field)
            np.testing.assert_allclose(samples.values, ROWS[:, k] * factor, rtol=1e-15)
            begun_ns = 1_777_809_600_250_000_000
            np.testing.assert_array_equal(samples.stamps_ns, begun_ns + 2_000_000 * np.arange(40))


def test_a_bag_says_where_it_comes_from(file: Path, tmp_path: Path) -> None:
    import_columns(file, tmp_path / "bag", Signals(), operator="A. Person")
    with Bag(tmp_path / "bag") as bag:
        said = bag.provenance()
    assert (said["operator"], said["imported_from"], said["time"]) == ("A. Person", "run 1.csv", "t_ms")
    assert said["sha256"] == hashlib.sha256(file.read_bytes()).hexdigest()
    assert json.loads(said["columns"])["force_kN"] == {
        "unit": "kN",
        "si": "N",
        "field": "/columns/effort:effort[force]",
    }
    assert datetime.strptime(said["imported"], "%Y-%m-%d %H:%M:%S UTC")


@pytest.mark.parametrize("kind", WRITERS)
def test_a_bag_and_its_file_are_the_same_record(tmp_path: Path, kind: str) -> None:
    name, write = WRITERS[kind]
    write(tmp_path / name)
    prefix = "run." if kind == "mat" else ""
    signals = Signals.of(f"{prefix}force,sd=0.5,hold=linear", [f"{prefix}tip,delay=0.001,scale=-1"])
    time = f"{prefix}time"
    made = import_columns(tmp_path / name, tmp_path / "bag", signals, time=time)
    assert made.signals is not None
    from_bag = load_experiment(tmp_path / "bag", options=FitOptions(signals=Signals.of(file=made.signals)))
    from_file = load_experiment(tmp_path / name, options=FitOptions(signals=signals, time=time))
    for mine, theirs in (
        (from_bag.record.inputs, from_file.record.inputs),
        (from_bag.record.outputs, from_file.record.outputs),
    ):
        assert [own.name for own in mine] == [own.name for own in theirs]
        np.testing.assert_allclose(mine[0].values, theirs[0].values, rtol=1e-12)
        np.testing.assert_allclose(mine[0].times_s, theirs[0].times_s, atol=1e-9)
    assert from_bag.structure == from_file.structure
    np.testing.assert_allclose(from_file.record.inputs[0].values, FORCE, rtol=1e-12)
    assert from_file.record.inputs[0].sigma == 0.5
    assert len(TIP) == len(from_file.record.inputs[0].values)


def test_nothing_is_written_over_and_nothing_is_left_of_a_bad_file(file: Path, tmp_path: Path) -> None:
    (tmp_path / "taken").mkdir()
    with pytest.raises(BagExistsError):
        import_columns(file, tmp_path / "taken", Signals())
    file.write_text(file.read_text().replace("\n21,", "\n20,", 1))
    with pytest.raises(ColumnFileError, match=r"line 9: 't_ms' \(0.02 s\) comes unevenly"):
        import_columns(file, tmp_path / "bag", Signals())
    assert sorted(path.name for path in tmp_path.iterdir()) == [file.name, "taken"]


@pytest.mark.parametrize(
    ("outputs", "words"),
    [
        (["note"], "column 'note' has no unit; say it behind the column's name, as note,unit=mm"),
        (["note,unit=s"], "column 'note' is in s, neither motion nor force"),
        (["hub,name=a", "hub,name=b"], r"column 'hub \(mm\)' is named twice"),
    ],
)
def test_a_column_that_is_no_signal_is_refused(
    file: Path, tmp_path: Path, outputs: list[str], words: str
) -> None:
    with pytest.raises(RigError, match=words):
        import_columns(file, tmp_path / "bag", Signals.of("force", outputs))


def test_the_verb_says_how_to_go_on(file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["import", str(file), "--to", str(tmp_path / "bag"), "--input", "force", "--output", "hub"]
    assert main([*words, "--start", "2026-05-03T14:00:00+02:00"]) == 0
    said = capsys.readouterr().out
    assert re.search(r"beam identify \S+bag --signals \S+bag/signals.yaml", said)
    assert main(words) == 2
    assert "exists already" in capsys.readouterr().err
    assert main([*words[:3], str(tmp_path / "other"), "--start", "noon"]) == 2
    assert "expected a date with its time" in capsys.readouterr().err
