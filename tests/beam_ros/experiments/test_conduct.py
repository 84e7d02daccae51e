"""Experiments from plan to folder, interrupted after every step and in the middle of one."""

from __future__ import annotations

import json
import os
import resource
import shutil
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from beam_ros.errors import UsageError
from beam_ros.experiments.conduct import begin, conduct, describe_plan
from beam_ros.experiments.plan import Plan, read_plan
from beam_ros.experiments.progress_file import STATE_FILE, ProgressFile, files_below
from beam_ros.experiments.steps import Means, Report, record_by_core
from beam_ros.offline.identification import nothing_checked
from beam_ros.process.checksums import checksum
from beam_ros.process.environment import child_environment
from beam_ros.process.executables import command
from beam_ros.reporting.identification import report_identification
from tests.beam_ros.conftest import Beam
from tests.browser import faults_of_page, open_browser

PLAN = """
title: Short
recordings:
  E1:
    excitation: {kind: chirp, duration: 4 s, still: 1 s, end_frequency: 45 Hz, start_frequency: 2 Hz}
    levels: [0.5, 1.0]
  V1:
    excitation: {kind: multisine, duration: 4 s, still: 1 s, end_frequency: 45 Hz, acceleration: 0.3 m/s^2}
estimations:
  modal: {recordings: [E1], modes: 2}
  both: {recordings: [E1], modes: 2, together: true}
validations:
  - {estimation: modal, recordings: [V1]}
  - {estimation: both, recordings: [V1]}
"""
STEPS = [
    "record E1-1",
    "record E1-2",
    "record V1",
    "estimate modal from E1-1",
    "estimate modal from E1-2",
    "estimate both from all",
    "report",
]


def no_calibration(bag: Path, rig: Any, file: Path) -> int:
    raise AssertionError("the plan has none")


def no_shaping(*_arguments: object) -> str:
    raise AssertionError("the plan has no move")


BRIEF = """
title: Brief
recordings:
  E1:
    excitation: {kind: chirp, duration: 3 s, still: 1 s, end_frequency: 12 Hz, start_frequency: 2 Hz}
  V1:
    excitation: {kind: multisine, duration: 3 s, still: 1 s, end_frequency: 12 Hz, acceleration: 0.3 m/s^2}
estimations:
  modal: {recordings: [E1], modes: 1}
validations:
  - {estimation: modal, recordings: [V1]}
"""
BRIEF_STEPS = ["record E1", "record V1", "estimate modal from E1", "report"]

MEANS = Means(record_by_core, no_calibration, nothing_checked, report_identification, no_shaping)


class Interruption(Exception):
    """Stands for Ctrl-C."""


class Silent:
    """Shows nothing; may interrupt where a step has ended, or in the middle of one."""

    def __init__(self, after: str = "", within: str = "") -> None:
        self.after, self.within = after, within
        self.now: list[str] = []
        self.before: list[str] = []

    def step(self, number: int, count: int, name: str) -> Report:
        def report(share: float, note: str) -> None:
            if name == self.within:
                raise Interruption

        return report

    def done(self, number: int, count: int, name: str, said: str, *, was_done: bool) -> None:
        (self.before if was_done else self.now).append(name)
        if name == self.after and not was_done:
            raise Interruption


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> Plan:
    path = tmp_path_factory.mktemp("plan") / "short.yaml"
    path.write_text(PLAN)
    return read_plan(path)


@pytest.fixture(scope="module")
def brief(tmp_path_factory: pytest.TempPathFactory) -> Plan:
    path = tmp_path_factory.mktemp("plan") / "brief.yaml"
    path.write_text(BRIEF)
    return read_plan(path)


def go_on(plan: Plan, folder: Path, watcher: Silent, *, resume: bool) -> dict[str, Any]:
    # The working folder is the experiment's own parent, so that no path of this run enters a report.
    here = Path.cwd()
    folder.parent.mkdir(exist_ok=True)
    os.chdir(folder.parent)
    try:
        begun = begin(
            plan, Path(folder.name), resume=resume, overwrite=False, now="2026-01-01T00:00:00+00:00"
        )
        return conduct(plan, begun, MEANS, watcher)
    finally:
        os.chdir(here)


def contents(folder: Path) -> dict[str, str]:
    return {path.relative_to(folder).as_posix(): checksum(path) for path in files_below(folder)}


@pytest.fixture(scope="module")
def whole(plan: Plan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("whole") / "run"
    watcher = Silent()
    go_on(plan, folder, watcher, resume=False)
    assert watcher.now == STEPS
    return folder


@pytest.fixture(scope="module")
def whole_brief(brief: Plan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("whole_brief") / "run"
    watcher = Silent()
    go_on(brief, folder, watcher, resume=False)
    assert watcher.now == BRIEF_STEPS
    return folder


@pytest.mark.slow
def test_interrupted_after_every_step_it_comes_to_the_same_files(
    brief: Plan, whole_brief: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "run"
    for number, step in enumerate(BRIEF_STEPS):
        watcher = Silent(after=step)
        with pytest.raises(Interruption):
            go_on(brief, folder, watcher, resume=number > 0)
        assert watcher.now == [step]
        assert watcher.before == BRIEF_STEPS[:number]
    watcher = Silent()
    outcome = go_on(brief, folder, watcher, resume=True)
    assert watcher.now == []
    assert contents(folder) == contents(whole_brief)
    assert outcome == json.loads((whole_brief / "outcome.json").read_text())


@pytest.mark.slow
@pytest.mark.parametrize("step", ["record V1", "estimate modal from E1"])
def test_interrupted_within_a_step_it_comes_to_the_same_files(
    brief: Plan, whole_brief: Path, tmp_path: Path, step: str
) -> None:
    with pytest.raises(Interruption):
        go_on(brief, tmp_path / "run", Silent(within=step), resume=False)
    assert step not in json.loads((tmp_path / "run" / STATE_FILE).read_text())["steps"]
    go_on(brief, tmp_path / "run", Silent(), resume=True)
    assert contents(tmp_path / "run") == contents(whole_brief)


class PressesCtrlC(Silent):
    """Sends SIGINT to this process when a fit begins to look for its second mode."""

    def step(self, number: int, count: int, name: str) -> Report:
        def report(share: float, note: str) -> None:
            if name == self.within and note.endswith("mode 2"):
                os.kill(os.getpid(), signal.SIGINT)

        return report


@pytest.mark.slow
def test_a_fit_that_ctrl_c_has_cut_short_is_not_taken_for_a_finished_step(plan: Plan, tmp_path: Path) -> None:
    step = "estimate modal from E1-1"
    with pytest.raises(KeyboardInterrupt):
        go_on(plan, tmp_path / "run", PressesCtrlC(within=step), resume=False)
    assert list(json.loads((tmp_path / "run" / STATE_FILE).read_text())["steps"]) == STEPS[:3]
    assert not (tmp_path / "run" / "estimates").exists()


@pytest.mark.slow
def test_killed_again_and_again_the_command_comes_to_the_same_outcome(
    whole_brief: Path, tmp_path: Path
) -> None:
    (tmp_path / "brief.yaml").write_text(BRIEF)
    folder, kills = tmp_path / "run", 0
    words = [*command("beam"), "experiment", "brief.yaml", "--out", "run"]
    for number in range(len(BRIEF_STEPS)):
        process = subprocess.Popen(
            [*words, *(["--resume"] if number else [])],
            cwd=tmp_path,
            env=child_environment(),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        end = time.monotonic() + 60.0
        while process.poll() is None and _finished(folder) <= number and time.monotonic() < end:
            time.sleep(0.005)
        process.send_signal(signal.SIGKILL)
        kills += process.wait() == -signal.SIGKILL
    assert kills >= len(BRIEF_STEPS) - 2  # the last steps take no time
    ended = subprocess.run(
        [*words, "--resume", "--json"], cwd=tmp_path, env=child_environment(), capture_output=True, check=True
    )
    assert json.loads(ended.stdout) == json.loads((whole_brief / "outcome.json").read_text())
    kept = {
        name: digest
        for name, digest in contents(folder).items()
        if name != STATE_FILE and not name.endswith("report.html")
    }
    assert kept == {name: contents(whole_brief)[name] for name in kept}  # state and pages say when it began
    assert set(contents(folder)) == set(contents(whole_brief))


def _finished(folder: Path) -> int:
    state = ProgressFile.read(folder)
    return 0 if state is None else len(state.steps)


@pytest.mark.slow
def test_the_outcome_holds_what_was_estimated_and_the_page_shows_it(whole: Path) -> None:
    outcome = json.loads((whole / "outcome.json").read_text())
    frequencies = [[mode["frequency_hz"] for mode in own["modes"]] for own in outcome["estimates"]]
    assert frequencies == [pytest.approx([4.3839, 28.262], rel=3e-3)] * 3
    one, other, both = ([mode["frequency_sd_hz"] for mode in own["modes"]] for own in outcome["estimates"])
    assert all(joint < min(pair) for joint, *pair in zip(both, one, other, strict=True))
    assert [own["fit"] for own in outcome["estimates"]] == ["E1-1", "E1-2", "all"]
    assert outcome["estimates"][2]["recordings"] == ["E1-1", "E1-2"]
    assert [own["level"] for own in outcome["recordings"]] == [0.5, 1.0, 1.0]
    assert {own["unseen"] for own in outcome["validations"]} == {"V1"}
    assert all(own["scores"]["z225"]["fit_percent"] > 95.0 for own in outcome["validations"])
    # A page that was written before all is judged would say that the model was never tried.
    for own in ("modal/E1-1", "modal/E1-2", "both/all"):
        of_model = (whole / "estimates" / own / "report.html").read_text(encoding="utf-8")
        assert "Prediction of unseen data" in of_model
        assert "On V1" in of_model
        assert "not tried on data" not in of_model
        assert "not been tried" not in of_model
    page = (whole / "report.html").read_text(encoding="utf-8")
    for words in (
        "Linearity over levels",
        "Validation",
        "E1-2",
        "estimates/modal/E1-1/report.html",
        "both from all",
    ):
        assert words in page


@pytest.mark.verify
def test_the_page_reads_on_every_screen_and_on_paper(whole: Path) -> None:
    with open_browser() as browser:
        assert faults_of_page(browser, whole / "report.html") == []


@pytest.mark.verify
def test_the_packaged_plan_of_levels_shows_the_damping_rise_with_the_amplitude(tmp_path: Path) -> None:
    outcome = go_on(read_plan(Path("linearity")), tmp_path / "run", Silent(), resume=False)
    ((first,), (second,), (third,), (fourth,)) = (own["modes"] for own in outcome["estimates"])
    # Drag takes power with the cube of the speed: what it adds to the damping ratio doubles with each level.
    ratios = [mode["damping_ratio"] - 0.005 for mode in (first, second, third, fourth)]
    np.testing.assert_allclose(np.divide(ratios[1:], ratios[:-1]), 2.0, rtol=0.05)
    shifts = [mode["frequency_hz"] / first["frequency_hz"] - 1.0 for mode in (second, third, fourth)]
    assert np.max(np.abs(shifts)) < 1e-4


@pytest.mark.verify
def test_the_packaged_plan_of_repetitions_finds_the_scatter_that_is_stated(tmp_path: Path) -> None:
    outcome = go_on(read_plan(Path("repeatability")), tmp_path / "run", Silent(), resume=False)
    (found,) = outcome["repeatability"]
    assert found["verdict"].startswith("as stated")
    assert found["p_value"] > 0.01
    assert len(found["parameters"]) == 4


def _changed(folder: Path) -> None:
    (folder / "bags" / "E1-1" / "metadata.yaml").write_text("other")


def _foreign(folder: Path) -> None:
    (folder / STATE_FILE).unlink()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("prepare", "resume", "words"),
    [
        (lambda folder: None, False, ("1 finished steps", "--resume", "--overwrite")),
        (_changed, True, ("metadata.yaml: has changed since the step 'record E1-1'",)),
        (_foreign, False, ("not empty", "another --out")),
        (_foreign, True, ("not empty", "another --out")),
    ],
)
def test_a_folder_that_is_there_is_not_overwritten(
    plan: Plan, tmp_path: Path, prepare: Callable[[Path], None], resume: bool, words: tuple[str, ...]
) -> None:
    folder = tmp_path / "run"
    with pytest.raises(Interruption):
        go_on(plan, folder, Silent(after=STEPS[0]), resume=False)
    prepare(folder)
    before = contents(folder)
    with pytest.raises(UsageError) as caught:
        go_on(plan, folder, Silent(), resume=resume)
    for word in words:
        assert word in str(caught.value)
    assert contents(folder) == before


@pytest.mark.slow
def test_another_plan_does_not_go_on_in_the_same_folder_and_overwriting_takes_only_what_is_its_own(
    plan: Plan, tmp_path: Path
) -> None:
    with pytest.raises(Interruption):
        go_on(plan, tmp_path / "run", Silent(after=STEPS[0]), resume=False)
    path = tmp_path / "other.yaml"
    path.write_text(PLAN.replace("4 s", "3 s"))
    other = read_plan(path)
    with pytest.raises(UsageError, match="not this one"):
        begin(other, tmp_path / "run", resume=True, overwrite=False, now="")
    (tmp_path / "run" / "my notes.txt").write_text("mine")
    with pytest.raises(UsageError, match=r"my notes\.txt"):
        begin(other, tmp_path / "run", resume=False, overwrite=True, now="")
    assert (tmp_path / "run" / "bags" / "E1-1").is_dir()
    (tmp_path / "run" / "my notes.txt").unlink()
    begun = begin(other, tmp_path / "run", resume=False, overwrite=True, now="")
    assert begun.state.steps == {}
    assert not (tmp_path / "run" / "bags").exists()


@pytest.mark.slow
def test_a_second_process_is_refused_until_the_first_has_ended(plan: Plan, tmp_path: Path) -> None:
    first = begin(plan, tmp_path / "run", resume=False, overwrite=False, now="")
    before = contents(tmp_path / "run")
    for options in ({"resume": True, "overwrite": False}, {"resume": False, "overwrite": True}):
        with pytest.raises(UsageError, match=rf"process {os.getpid()} on .* is at work there"):
            begin(plan, tmp_path / "run", **options, now="")
    assert contents(tmp_path / "run") == before
    with pytest.raises(Interruption):
        conduct(plan, first, MEANS, Silent(after=STEPS[0]))
    assert begin(plan, tmp_path / "run", resume=True, overwrite=False, now="").state.steps.keys() == {
        STEPS[0]
    }


def test_an_experiment_that_cannot_fit_on_the_disk_is_refused(
    plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage._replace(free=2_000_000))
    with pytest.raises(UsageError, match=r"take about \d+ MB, and 2 MB are free"):
        begin(plan, tmp_path / "run", resume=False, overwrite=False, now="")
    assert not (tmp_path / "run").exists()


@pytest.mark.slow
def test_a_disk_that_fills_leaves_what_is_done_and_says_how_to_go_on(tmp_path: Path) -> None:
    (tmp_path / "short.yaml").write_text(PLAN)
    limited = subprocess.run(
        [*command("beam"), "experiment", "short.yaml", "--out", "run"],
        cwd=tmp_path,
        env=child_environment(),
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
        # Writing on beyond this size fails, as it does on a full disk.
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, resource.RLIM_INFINITY)),
    )
    assert limited.returncode == 2, limited.stderr
    assert "Traceback" not in limited.stderr
    assert "step 'record E1-1' failed" in limited.stderr
    assert "--resume" in limited.stderr.splitlines()[-1]
    assert _finished(tmp_path / "run") == 0
    assert not (tmp_path / "run" / "bags" / "E1-1").exists()


def test_what_a_real_axis_moved_for_is_kept_when_it_is_interrupted(plan: Plan, tmp_path: Path) -> None:
    live = Plan(**{**vars(plan), "over_ros": True})

    def record(rig: Any, bag: Path, *, with_frames: bool, report: Report) -> None:
        bag.mkdir()
        (bag / "samples").write_text("half")
        raise Interruption

    means = Means(record, no_calibration, nothing_checked, report_identification, no_shaping)
    begun = begin(live, tmp_path / "run", resume=False, overwrite=False, now="")
    with pytest.raises(Interruption):
        conduct(
            live,
            begun,
            means,
            Silent(),
        )
    begun = begin(live, tmp_path / "run", resume=True, overwrite=False, now="")
    with pytest.raises(Interruption):
        conduct(
            live,
            begun,
            means,
            Silent(),
        )
    kept = tmp_path / "run" / "interrupted" / "record-E1-1-1" / "bags" / "E1-1" / "samples"
    assert kept.read_text() == "half"


def test_the_check_lists_the_steps_and_what_the_beam_will_do(plan: Plan) -> None:
    lines = describe_plan(plan)
    assert len(lines) == len(STEPS)
    assert lines[0].startswith("record E1-1: chirp, ")
    assert "level 0.5, tip at most" in lines[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("experiment", "quikc"), ("did you mean quick?",)),
        (("experiment", "quick", "--out", "taken"), ("not an empty folder",)),
        (("experiment", "quick", "--out", "file"), ("file",)),
        (("experiment", "quick", "--out", "taken", "--overwrite"), ("no experiment",)),
        (("experiment", "quick", "--out", "new", "--resume"), ("no experiment to go on with",)),
        (("experiment", "quick", "--rig", "real"), ("serial.port",)),
        (("experiment", "quick", "--rig", "reel"), ("reel",)),
        (("experiment", "quick", "-p", "beam.lenght:=0.3"), ("did you mean beam.length",)),
    ],
)
def test_a_wrong_command_is_one_line_and_status_2(
    tmp_path: Path, beam: Beam, arguments: tuple[str, ...], words: tuple[str, ...]
) -> None:
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "mine").touch()
    (tmp_path / "file").touch()
    ended = beam(*arguments)
    assert ended.returncode == 2, ended.stderr
    assert ended.stderr.count("\n") == 1, ended.stderr
    for word in words:
        assert word in ended.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "taken"]
