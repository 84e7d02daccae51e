"""Plans: what one says, and that a wrong one is refused with the place, before anything moves."""

from __future__ import annotations

from pathlib import Path

import pytest

from beam_ros.errors import ParameterFileError, UsageError
from beam_ros.experiments.plan import packaged_plans, read_plan
from beam_ros.interfaces.graph import RigKind

PLAN = """
title: A plan
recordings:
  E1:
    excitation: {kind: chirp, duration: 6 s, still: 2 s, end_frequency: 45 Hz}
    levels: [0.5, 1.0]
    repetitions: 2
  V1:
    excitation: {kind: multisine, duration: 6 s, still: 2 s, end_frequency: 45 Hz, acceleration: 0.3 m/s^2}
estimations:
  modal: {recordings: [E1-3, E1-4]}
validations:
  - {estimation: modal, recordings: [E1-1, V1]}
"""


def write(folder: Path, text: str = PLAN) -> Path:
    path = folder / "plan.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_levels_and_repetitions_make_bags_of_their_own_noise(tmp_path: Path) -> None:
    plan = read_plan(write(tmp_path))
    assert [own.name for own in plan.recordings] == ["E1-1", "E1-2", "E1-3", "E1-4", "V1"]
    assert [own.level for own in plan.recordings] == [0.5, 0.5, 1.0, 1.0, 1.0]
    half, full = plan.recordings[0].rig.excitation, plan.recordings[2].rig.excitation
    assert (half.acceleration, half.max_displacement) == (full.acceleration / 2, full.max_displacement / 2)
    assert full.duration == 6.0
    assert len({own.rig.simulation.seed for own in plan.recordings}) == 5
    assert plan.validations[0].recordings == ("E1-1", "V1")


@pytest.mark.slow
def test_the_digest_follows_all_that_decides_what_is_done_and_nothing_else(tmp_path: Path) -> None:
    path = write(tmp_path)
    same = read_plan(write(tmp_path, PLAN.replace("A plan", "A plan")))
    assert read_plan(path).digest() == same.digest()
    for other in (
        read_plan(path, seed=2),
        read_plan(path, parameters=["camera.rate:=50.0"]),
        read_plan(path, kind=RigKind.EMULATED),
        read_plan(write(tmp_path, PLAN.replace("6 s", "7 s"))),
        read_plan(write(tmp_path, PLAN.replace("modal: {", "modal: {modes: 2, "))),
    ):
        assert other.digest() != same.digest()


@pytest.mark.parametrize("name", packaged_plans())
def test_every_packaged_plan_is_inside_its_limits(name: str) -> None:
    plan = read_plan(Path(name))
    assert plan.recordings
    assert plan.name == name


def test_the_rig_file_is_found_beside_the_plan(tmp_path: Path) -> None:
    (tmp_path / "rig.yaml").write_text("/**: {ros__parameters: {camera: {rate: 50.0}}}")
    plan = read_plan(write(tmp_path, PLAN + "rig_file: rig.yaml\nparameters: {camera.exposure: 2 ms}\n"))
    assert (plan.rig.camera.rate, plan.rig.camera.exposure) == (50.0, 0.002)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("title", "titel", ("the plan has the unknown key 'titel'", "did you mean title?")),
        ("levels", "level", ("recordings.E1", "did you mean levels?")),
        (
            "duration: 6 s",
            "duration: 6 mm",
            ("recordings.E1.excitation", "excitation.duration", "not a unit"),
        ),
        ("duration: 6 s", "duration_s: 6", ("excitation.duration_s", "did you mean")),
        ("kind: chirp", "kind: chrip", ("excitation.kind", "did you mean chirp?")),
        ("45 Hz", "4500 Hz", ("recordings.E1.excitation", "end_frequency", "500 Hz")),
        ("0.3 m/s^2", "3 m/s^2", ("recordings.V1.excitation", "refused")),
        ("[0.5, 1.0]", "[0.5, 6.0]", ("recordings.E1.excitation at level 6", "refused")),
        ("[0.5, 1.0]", "[0]", ("recordings.E1.levels", "above 0")),
        ("repetitions: 2", "repetitions: 0", ("recordings.E1.repetitions", "from 1")),
        ("title: A plan", "rig: reel", ("rig is 'reel'", "did you mean real?")),
        ("title: A plan", "rig: real", ("serial.port",)),
        ("title: A plan", "rig_file: nowhere.yaml", ("nowhere.yaml", "no such file")),
        ("title: A plan", "calibration: {file: nowhere.yaml}", ("calibration.file", "no such file")),
        (
            "title: A plan",
            "calibration: {excitation: {kind: chirp}}",
            ("calibration.excitation.kind", "moves"),
        ),
        ("[E1-3, E1-4]", "[E3]", ("estimations.modal.recordings", "'E3'", "did you mean")),
        ("[E1-1, V1]", "[E1-3, V1]", ("estimated from E1-3 itself", "not seen")),
        (
            "{recordings: [E1-3",
            "{estimator: modul, recordings: [E1-3",
            ("estimations.modal.estimator", "modul"),
        ),
        ("estimation: modal", "estimation: model", ("entry 1", "did you mean modal?")),
        ("  V1:", "  V 1:", ("'V 1'", "expected letters")),
        ("  V1:", "  calibration:", ("belongs to the calibration",)),
        ("title: A plan", "title: [", ("no valid YAML",)),
    ],
)
def test_a_wrong_plan_is_refused_with_its_place(
    tmp_path: Path, old: str, new: str, words: tuple[str, ...]
) -> None:
    assert old in PLAN
    with pytest.raises((ParameterFileError, UsageError)) as caught:
        read_plan(write(tmp_path, PLAN.replace(old, new, 1)))
    text = str(caught.value)
    assert text.startswith(str(tmp_path / "plan.yaml"))
    assert "\n" not in text
    for word in words:
        assert word in text


def test_an_unknown_plan_is_suggested(tmp_path: Path) -> None:
    with pytest.raises(ParameterFileError, match="did you mean thesis"):
        read_plan(Path("thesys"))
