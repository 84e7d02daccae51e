"""The reference work's tables and figures: all of them, under their numbers, and right where the truth is known."""

from __future__ import annotations

import csv
import html
import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from beam_ros.calibration.from_bag import calibrate_from_bags
from beam_ros.errors import UsageError
from beam_ros.experiments.plan import packaged_plans, read_plan
from beam_ros.experiments.steps import record_by_core
from beam_ros.process.environment import child_environment
from beam_ros.process.executables import command
from beam_ros.thesis.contents import ENTRIES
from beam_ros.thesis.data import ThesisData, estimate_all, load_bags
from beam_ros.thesis.document import write_thesis
from beam_ros.thesis.figures import DRAWN, simulation_fit_percent
from beam_ros.thesis.tables import MADE
from tests.browser import faults_of_page, open_browser

pytestmark = pytest.mark.slow

pytest.importorskip("cv2")

FIRST_HZ, SECOND_HZ = 4.38394, 28.2619
"""Clamped frequencies of the default rig with gravity; see the theory's own tests."""


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Recordings of the packaged plan, shortened."""
    text = packaged_plans()["thesis"].read_text(encoding="utf-8")
    text = re.sub(r"duration: \d+ s, still: \d+ s", "duration: 10 s, still: 3 s", text)
    text = re.sub(r"still: 20 s", "still: 5 s", text)
    text = re.sub(r"waypoints: \[.*?\]", "waypoints: [-20 mm, 0, 20 mm, 0]", text, flags=re.DOTALL)
    folder = tmp_path_factory.mktemp("thesis")
    (folder / "thesis.yaml").write_text(text, encoding="utf-8")
    for own in read_plan(folder / "thesis.yaml").all_recordings:
        record_by_core(
            own.rig, folder / "bags" / own.name, with_frames=own.with_frames, report=lambda share, note: None
        )
    return folder / "bags"


@pytest.fixture(scope="module")
def data(bags: Path) -> ThesisData:
    fit, _ = calibrate_from_bags([bags / "calibration"])
    return estimate_all(load_bags(bags), fit, lambda phrase, share: None)


@pytest.fixture(scope="module")
def written(data: ThesisData, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    folder = tmp_path_factory.mktemp("document")
    return folder, write_thesis(data, folder)


def test_every_line_of_the_reference_lists_is_there_once_and_what_data_can_produce_is_made() -> None:
    numbers = [entry.number for entry in ENTRIES]
    assert len(set(numbers)) == len(numbers)
    wanted = {f"Table 4.{k}" for k in range(1, 9)} | {f"Figure 4.{k}" for k in range(1, 18)}
    assert {number for number in numbers if number.split()[1].startswith("4.")} == wanted
    assert set(MADE) == {f"Table 4.{k}" for k in range(1, 9)}
    assert set(DRAWN) - {"Figure 4.4"} == {f"Figure 4.{k}" for k in (1, 2, 3, *range(8, 18))}


def test_the_document_has_every_table_and_figure_under_its_number(
    written: tuple[Path, dict[str, Any]],
) -> None:
    folder, content = written
    page = (folder / "thesis.html").read_text(encoding="utf-8")
    assert content["missing"] == []
    for entry in ENTRIES:
        assert entry.number in page
        assert html.escape(entry.title) in page
    for number in DRAWN:
        svg = folder / "figures" / f"{number.lower().replace(' ', '-').replace('.', '-')}.svg"
        assert "<svg" in svg.read_text(encoding="utf-8")
    for k in range(1, 9):
        with (folder / "tables" / f"table-4-{k}.csv").open(encoding="utf-8") as stream:
            head, *rows = csv.reader(stream)
        assert rows
        assert all(len(row) == len(head) for row in rows)
    assert {"modal_E1", "modal_E2", "z010_E1", "z225_E2"} <= set(
        json.loads((folder / "model.json").read_text(encoding="utf-8"))["models"]
    )


def test_the_modal_parameters_are_those_of_the_beam(written: tuple[Path, dict[str, Any]]) -> None:
    rows = {row[0]: row[1:] for row in written[1]["tables"]["Table 4.7"]["rows"]}
    for name in (
        "transfer function at 225 mm, E1",
        "transfer function at 225 mm, E2",
        "all points at once, E2",
    ):
        for cell, truth in zip(rows[name], (FIRST_HZ, 0.5, SECOND_HZ, 0.5), strict=True):
            value, sd = (float(part) for part in cell.split(" ± "))
            assert abs(value - truth) < 2.0 * 1.96 * sd + 1e-5 * truth  # twice the 95 % interval
            assert sd < 0.05 * truth
    assert rows["theory"] == [f"{FIRST_HZ:.4f}", "0.5000", f"{SECOND_HZ:.4f}", "0.5000"]


def test_simulation_and_experiment_are_on_one_clock(data: ThesisData) -> None:
    # 5 um of noise on millimetres; a millisecond apart would leave percents.
    assert simulation_fit_percent(data, 0) > 99.0
    assert simulation_fit_percent(data, 1) > 99.5


def test_the_chosen_orders_have_both_modes_where_both_are_seen(written: tuple[Path, dict[str, Any]]) -> None:
    table = written[1]["tables"]["Table 4.3"]
    chosen = re.search(r"takes (\d) poles and (\d) zeros", table["notes"][0])
    assert chosen is not None
    assert chosen[1] in ("4", "6")  # six where the flank of the third mode is felt
    assert "lowest YIC has 2 and 2" in table["notes"][0]


def test_the_step_is_predicted_to_its_noise(written: tuple[Path, dict[str, Any]]) -> None:
    table = written[1]["tables"]["Table 4.8"]
    assert len(table["rows"]) == 8
    column = table["columns"].index("residual / noise")
    assert all(0.8 < float(row[column]) < 1.3 for row in table["rows"])


def test_the_same_bags_give_the_same_document(
    data: ThesisData, written: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    write_thesis(data, tmp_path)
    for name in ("thesis.html", "model.json"):
        assert (tmp_path / name).read_bytes() == (written[0] / name).read_bytes()


def test_without_a_calibration_its_figure_is_named_as_missing(data: ThesisData, tmp_path: Path) -> None:
    without = ThesisData(**{**vars(data), "calibration": None})
    assert write_thesis(without, tmp_path)["missing"] == ["Figure 4.8"]
    assert "Figure 4.8 is missing" in (tmp_path / "thesis.html").read_text(encoding="utf-8")


def test_bags_that_are_not_all_there_are_named(bags: Path, tmp_path: Path) -> None:
    (tmp_path / "E1").symlink_to(bags / "E1")
    with pytest.raises(UsageError, match="has no E2, V2, S"):
        load_bags(tmp_path)


def test_the_command_works_on_given_bags_and_overwrites_nothing(bags: Path, tmp_path: Path) -> None:
    shutil.copytree(bags, tmp_path / "given", ignore=shutil.ignore_patterns("V1", "calibration"))
    words = [*command("beam"), "thesis", "--bags", "given", "--out", "out"]

    def run(*more: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [*words, *more],
            cwd=tmp_path,
            env=child_environment(),
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )

    ended = run("--json")
    assert ended.returncode == 0, ended.stderr
    assert "Warning" not in ended.stderr
    assert json.loads(ended.stdout)["missing"] == ["Figure 4.8"]
    again = run()
    assert again.returncode == 2
    assert "not an empty folder" in again.stderr
    assert run("--resume").returncode == 2


@pytest.mark.verify
def test_the_document_reads_on_every_screen_and_on_paper(written: tuple[Path, dict[str, Any]]) -> None:
    with open_browser() as browser:
        assert faults_of_page(browser, written[0] / "thesis.html") == []


@pytest.mark.verify
def test_the_whole_command_takes_minutes_and_resumes_with_its_document(tmp_path: Path) -> None:
    words = [*command("beam"), "thesis", "--out", "out"]
    subprocess.run(words, cwd=tmp_path, env=child_environment(), timeout=900, check=True)
    first = (tmp_path / "out" / "thesis.html").read_bytes()
    subprocess.run([*words, "--resume"], cwd=tmp_path, env=child_environment(), timeout=900, check=True)
    assert (tmp_path / "out" / "thesis.html").read_bytes() == first
