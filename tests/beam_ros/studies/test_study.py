"""Studies of the recorded bags: rows, what is wrong with a bag, going on after an interruption, table and page."""

from __future__ import annotations

import csv
import hashlib
import json
import multiprocessing
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from beam_ros.checks.bag_check import gates_of_bag
from beam_ros.cli.main import main
from beam_ros.errors import UsageError
from beam_ros.offline.simulation import simulate
from beam_ros.rig.rig import Rig
from beam_ros.studies.rows import Item, Row, Settings, _modes, find_bags, study_row
from beam_ros.studies.statistics import mode_statistics
from beam_ros.studies.study import open_study, run_study
from beam_ros.studies.summary import format_study, study_page
from beam_ros.studies.table import write_table
from tests.browser import faults_of_page, open_browser

BAGS = Path(__file__).resolve().parents[3] / "bags"


def settings_of(**options: object) -> Settings:
    """Return the settings of a study that is told some options of the identifier."""
    return Settings(
        Rig.from_file().with_values({f"identifier.{k}": v for k, v in options.items()}).identifier
    )


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory) -> list[Row]:
    bad = tmp_path_factory.mktemp("bad") / "cut"
    bad.mkdir()
    (bad / "cut_0.mcap").write_bytes((BAGS / "step" / "step_0.mcap").read_bytes()[:5000])
    return [
        study_row(Item(bag=bag), settings_of(), gates_of_bag)
        for bag in (BAGS / "step", BAGS / "drifting", bad)
    ]


@pytest.mark.slow
def test_a_row_holds_poles_quality_and_provenance(rows: list[Row]) -> None:
    expected = json.loads((BAGS / "expected.json").read_text())["drifting"]["identified"]
    row = rows[1]
    assert row["verdict"] == "passed"
    assert row["mode1_frequency_hz"] == pytest.approx(expected["modes"][0]["frequency_hz"], rel=1e-6)
    assert row["mode2_damping_ratio_sd"] == pytest.approx(expected["modes"][1]["damping_ratio_sd"], rel=0.1)
    assert row["fit_percent_z285"] == pytest.approx(expected["fit_percent"]["z285"], abs=0.05)
    assert (row["frames_lost"], row["markers_unseen"], row["hub_samples_lost"]) == (15, 91, 0)
    assert row["hub_clock_ppm"] == pytest.approx(400.0, abs=1.0)
    assert (row["gates_failed"], rows[0]["gates_doubtful"].count("mode at")) == ("", 3)
    assert len(row["sha256"]) == 64
    assert row["recorded"] is None  # the simulator's time is made up
    assert row["apparatus"] == "simulated"
    assert "excitation.kind:=chirp" in row["excitation"]


@pytest.mark.slow
def test_files_of_columns_are_rows_where_they_are_named(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    t, base = 0.01 * np.arange(2000), 1e-3 * lfilter([0.1], [1.0, -0.9], rng.standard_normal(2000))
    mode = cont2discrete(([-1.5, 0.0, 0.0], [1.0, 0.28, 784.0]), 0.01, method="foh")
    tip = base + lfilter(np.ravel(mode[0]), np.ravel(mode[1]), base) + 2e-6 * rng.standard_normal(2000)
    for name in ("a", "b"):
        columns = np.column_stack([t, 1e3 * base, 1e3 * tip])
        np.savetxt(tmp_path / f"{name}.csv", columns, delimiter=",", header="t_s,hub_mm,tip_mm", comments="")
    (tmp_path / "note.txt").write_text("seen at the rig")
    assert find_bags([str(tmp_path / "*.csv")]) == [tmp_path / "a.csv", tmp_path / "b.csv"]
    with pytest.raises(UsageError, match="names no bag"):
        find_bags([str(tmp_path)])
    row = study_row(Item(bag=tmp_path / "a.csv"), settings_of(input="hub", outputs="tip"), gates_of_bag)
    assert row["error"] is None
    # 784 is (28 rad/s)^2, 0.28 is 2 zeta omega.
    assert row["mode1_frequency_hz"] == pytest.approx(28.0 / (2.0 * np.pi), rel=1e-3)
    assert row["mode1_damping_ratio"] == pytest.approx(0.005, rel=0.02)
    assert len(row["sha256"]) == 64
    other = study_row(Item(bag=tmp_path / "b.csv"), settings_of(), gates_of_bag)
    table = write_table([row, other], tmp_path, True)
    assert "the input is not named" in table.read_text()


def test_a_bag_that_cannot_be_read_is_a_row_with_its_error(rows: list[Row]) -> None:
    assert rows[2]["verdict"] == "failed"
    assert "cut" in rows[2]["error"]
    assert "mode1_frequency_hz" not in rows[2]


def test_the_table_keeps_types_in_parquet_and_has_the_same_columns_in_csv(
    rows: list[Row], tmp_path: Path
) -> None:
    try:
        from pyarrow import parquet
    except ImportError as err:  # also where it wants another NumPy
        pytest.skip(str(err))
    table = parquet.read_table(write_table(rows, tmp_path)).to_pylist()
    assert [row["mode1_frequency_hz"] for row in table] == [row.get("mode1_frequency_hz") for row in rows]
    assert table[0]["converged"] is True
    assert table[2]["frames_lost"] is None
    with write_table(rows, tmp_path, as_csv=True).open(newline="") as file:
        lines = list(csv.DictReader(file))
    assert list(lines[0]) == list(table[0])
    assert float(lines[1]["mode1_frequency_hz"]) == table[1]["mode1_frequency_hz"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["study.csv", "study.parquet"]


def test_the_page_says_what_failed_and_how_the_modes_scatter(rows: list[Row], tmp_path: Path) -> None:
    text = study_page(rows, settings_of(), tmp_path / "study.csv").text()
    counts = [sum(row["verdict"] == word for row in rows) for word in ("passed", "doubtful", "failed")]
    assert "{} passed, {} doubtful and {} failed".format(*counts) in text
    for row in rows:  # the rule that stands above the table
        doubts = [row.get(name) for name in ("gates_failed", "gates_doubtful", "doubts")]
        assert row["verdict"] == ("failed" if row["error"] else "doubtful" if any(doubts) else "passed")
    assert str(rows[2]["error"]).split(":")[1][:20] in text
    assert text.count("<svg") == 2
    assert "1 failed" in format_study(rows)


@pytest.mark.verify
def test_the_page_reads_on_every_screen_and_on_paper(rows: list[Row], tmp_path: Path) -> None:
    page = study_page(rows, settings_of(), tmp_path / "study.csv").write(tmp_path / "index.html")
    with open_browser() as browser:
        assert faults_of_page(browser, page) == []


def test_coverage_counts_intervals_that_hold_the_truth() -> None:
    rng = np.random.default_rng(5)
    made: list[Row] = [
        {
            "mode1_frequency_hz": 10.0 + 0.1 * draw,
            "mode1_frequency_sd_hz": 0.1,
            "mode1_theory_frequency_hz": 10.0,
            "mode1_damping_ratio": 0.005 * (1.0 + 0.02 * draw),
            "mode1_damping_ratio_sd": 0.00005,
            "mode1_theory_damping_ratio": 0.005,
        }
        for draw in rng.standard_normal(2000)
    ]
    frequency, damping = mode_statistics(made)
    assert frequency.coverage == pytest.approx(0.95, abs=0.015)
    assert frequency.coverage_range[0] < 0.95 < frequency.coverage_range[1]
    assert frequency.scatter == pytest.approx(frequency.stated_sd, rel=0.05)
    assert damping.coverage == pytest.approx(0.673, abs=0.03)  # half of the true deviation is stated


def test_modes_without_a_theory_are_numbered_in_their_order_and_not_judged() -> None:
    found = _modes(
        [{"frequency_hz": 4.0, "frequency_sd_hz": 0.1, "damping_ratio": 0.01, "damping_ratio_sd": 0.001}]
    )
    assert found["mode1_frequency_hz"] == 4.0
    frequency, _ = mode_statistics([found, found])
    assert (frequency.count, frequency.judged, frequency.median) == (2, 0, 4.0)
    assert "–" in format_study([{"bag": "one", "verdict": "passed", "error": None, **found}])


def test_bags_are_found_by_path_folder_and_pattern(tmp_path: Path) -> None:
    everything = find_bags([str(BAGS)])
    assert {path.name for path in everything} == set(json.loads((BAGS / "expected.json").read_text()))
    assert find_bags([str(BAGS / "s*"), str(BAGS / "step")]) == [BAGS / "step"]
    with pytest.raises(UsageError, match="names no bag"):
        find_bags([str(tmp_path)])


@pytest.mark.slow
def test_a_study_goes_on_where_it_was_interrupted_and_sees_a_bag_that_changed(tmp_path: Path) -> None:
    shutil.copytree(BAGS / "step", tmp_path / "step")
    items = [Item(bag=tmp_path / "step"), Item(bag=BAGS / "decay")]
    folder, settings = tmp_path / "study", settings_of(modes=1)
    open_study(folder, settings)
    first = run_study(items[:1], settings, folder, gates_of_bag)
    stored = next((folder / "rows").iterdir())
    stored.write_text(json.dumps({**json.loads(stored.read_text()), "verdict": "kept"}))
    open_study(folder, settings)
    assert [row["verdict"] for row in run_study(items, settings, folder, gates_of_bag)] == [
        "kept",
        first[0]["verdict"],
    ]
    os.utime(tmp_path / "step" / "step_0.mcap", ns=(0, 1))
    assert run_study(items, settings, folder, gates_of_bag)[0]["verdict"] == first[0]["verdict"]
    with pytest.raises(UsageError, match="other options or another rig"):
        open_study(folder, settings_of(modes=2))
    open_study(folder, settings_of(modes=2), overwrite=True)
    assert not list((folder / "rows").iterdir())
    with open_study(folder, settings_of(modes=2)), pytest.raises(UsageError, match="at work there"):
        open_study(folder, settings_of(modes=2), overwrite=True)
    with pytest.raises(UsageError, match="holds no study"):
        open_study(tmp_path / "step", settings, overwrite=True)


@pytest.mark.slow
def test_seeds_take_the_place_of_bags(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    short = [
        "-p",
        "excitation.duration:=4.0",
        "-p",
        "excitation.still:=1.0",
        "-p",
        "excitation.end_frequency:=45.0",
    ]
    command = [
        "study",
        "--simulate",
        "2",
        "--csv",
        "--jobs",
        "1",
        "--out",
        str(tmp_path / "out"),
        "--json",
        *short,
    ]
    assert main(command) == 0
    statistics = json.loads(capsys.readouterr().out)["modes"]
    assert [own["count"] for own in statistics[:2]] == [2, 2]
    assert statistics[0]["largest_error"] < 1e-3
    assert (tmp_path / "out" / "index.html").is_file()
    # Begun anew, and then gone on with: how it was begun is none of the study's options.
    assert main([*command, "--overwrite"]) == 0
    assert main(command) == 0


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--csv"], "either bags or --simulate N"),
        (["nowhere", "--csv"], "nowhere names no bag"),
        (["bags", "--jobs", "0", "--csv"], "--jobs is 0: expected at least 1"),
    ],
)
def test_a_wrong_call_is_one_line(
    arguments: list[str], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["study", *arguments]) == 2
    assert told in capsys.readouterr().err


def test_without_pyarrow_one_line_names_the_extra(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    assert main(["study", str(BAGS), "--out", str(tmp_path / "out")]) == 2
    assert "the extra `study`" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def children(pid: int) -> list[int]:
    """Return the processes that work for a study."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            words = stat.read_text().rpartition(")")[2].split()
            command = (stat.parent / "cmdline").read_bytes()
        except OSError:
            continue
        if int(words[1]) == pid and b"spawn_main" in command:
            found.append(int(stat.parent.name))
    return found


def record_briefly(seed: int, folder: Path) -> None:
    """Record a step of 1.5 s: a small bag that no other seed has."""
    short = {"excitation.kind": "step", "excitation.duration": 1.5, "excitation.still": 0.5}
    simulate(Rig.from_file().with_values({**short, "simulation.seed": seed}), folder / f"{seed:04d}")


@pytest.mark.verify
@pytest.mark.skipif(sys.platform != "linux", reason="looks for the workers in /proc")
def test_a_thousand_bags_have_their_rows_though_workers_and_the_study_itself_are_killed(
    tmp_path: Path,
) -> None:
    count = int(os.environ.get("BEAM_STUDY_BAGS", "1000"))
    bags = tmp_path / "bags"
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as pool:
        list(pool.map(partial(record_briefly, folder=bags), range(count), chunksize=10))
    (no_bag,) = (bags / "0003").glob("*.mcap")
    no_bag.write_bytes(b"no bag")
    out = tmp_path / "study"
    command = [sys.executable, "-c", "from beam_ros.cli.main import main; raise SystemExit(main())", "study"]
    command += [str(bags), "--out", str(out), "--csv", "--jobs", "2", "--modes", "1"]
    rng = random.Random(7)
    killed = 0
    for is_last in (False, True):
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            due = 5
            while process.poll() is None:
                time.sleep(0.2)
                done = len(list(out.glob("rows/*.json")))
                workers = children(process.pid)
                if done >= due and workers:
                    os.kill(rng.choice(workers), signal.SIGKILL)
                    killed += 1
                    due = done + rng.randrange(5, count // 10 + 6)
                if not is_last and done > count // 2:
                    process.kill()
        finally:
            process.kill()
            process.wait(30.0)
    assert process.returncode == 0
    assert killed > 2
    with (out / "study.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [Path(row["bag"]).name for row in rows] == [f"{seed:04d}" for seed in range(count)]
    assert [Path(row["bag"]).name for row in rows if row["error"]] == ["0003"]
    good = [row for row in rows if not row["error"]]
    for row in good:
        (file_of_bag,) = Path(row["bag"]).glob("*.mcap")
        assert row["sha256"] == hashlib.sha256(file_of_bag.read_bytes()).hexdigest()
        # A tenth of a per cent: some forty of the deviations that a row states.
        assert float(row["mode1_frequency_hz"]) == pytest.approx(
            float(row["mode1_theory_frequency_hz"]), rel=1e-3
        )
    assert len({row["sha256"] for row in good}) == count - 1
    assert len({row["mode1_frequency_hz"] for row in good}) == count - 1
