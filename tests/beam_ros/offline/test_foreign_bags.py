"""Bags of other people's sensors, from the file to the poles, against modes that are known in closed form."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin

from beam_ros.bags.errors import MissingTopicsError
from beam_ros.bags.reading import Bag
from beam_ros.bags.writing import BagWriter
from beam_ros.cli.main import main
from beam_ros.errors import UsageError
from beam_ros.offline.identification import identify_bag
from beam_ros.offline.options import FitOptions
from beam_ros.signals.descriptions import Signals
from tests.beam_ros.signals import foreign_bags as foreign

AXIS = "/rig7/joint_states:position[axis]"
LASER = "/rig7/laser/range:range"
IMU = "/rig7/imu:linear_acceleration.x"


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Axis, laser and accelerometer in a namespace, in SQLite."""
    path = tmp_path_factory.mktemp("foreign") / "first"
    return foreign.write(path, foreign.experiment(foreign.shaken(5.0), "/rig7"), StoragePlugin.SQLITE3)


def options(*outputs: str, **more: Any) -> FitOptions:
    return FitOptions(signals=Signals.of(AXIS, outputs), n_modes=2, **more)


def holds_the_truth(result: dict[str, Any], rtol: float = 1e-4) -> None:
    found = np.array([[mode["frequency_hz"], mode["damping_ratio"]] for mode in result["modes"]])
    np.testing.assert_allclose(found[:, 0], foreign.FREQUENCIES_HZ, rtol=rtol)
    np.testing.assert_allclose(found[:, 1], foreign.DAMPING_RATIOS, rtol=100 * rtol)


@pytest.mark.parametrize("outputs", [(LASER,), (IMU,), (LASER, IMU)], ids=["laser", "imu", "both"])
def test_no_rig_file_is_needed_for_the_poles(bag: Path, outputs: tuple[str, ...]) -> None:
    result = identify_bag(bag, options=options(*outputs))
    holds_the_truth(result)
    assert result["outputs"] == [text.strip("/") for text in (IMU, LASER) if text in outputs]
    assert "theory_mode" not in result["modes"][0]
    assert ("accelerance" in " ".join(result["notes"])) == (IMU in outputs)


def test_the_same_samples_in_mcap_give_the_same_poles(bag: Path, tmp_path: Path) -> None:
    with Bag(bag) as old, BagWriter(tmp_path / "copy") as new:
        for message in old.raw_messages():
            new.add_topic(message.topic, message.type_name)
            new.write(message.topic, message.receive_ns, message.data)
    first, second = (identify_bag(path, options=options(LASER)) for path in (bag, tmp_path / "copy"))
    assert first["modes"] == second["modes"]


def test_a_copy_cannot_judge_the_model_and_does_not_count_twice(bag: Path, tmp_path: Path) -> None:
    copy = foreign.write(tmp_path / "copy", foreign.experiment(foreign.shaken(5.0), "/rig7"))
    with pytest.raises(UsageError, match="cannot judge the model"):
        identify_bag(bag, options=options(LASER), validation=copy)
    with pytest.raises(UsageError, match="give each bag once"):
        identify_bag([bag, copy], options=options(LASER))


def test_two_bags_are_one_fit_and_two_others_judge_it(bag: Path, tmp_path: Path) -> None:
    others = [
        foreign.write(tmp_path / f"bag{seed}", foreign.experiment(foreign.shaken(4.0, seed), "/rig7"))
        for seed in (1, 2, 3)
    ]
    alone = identify_bag(bag, options=options(LASER))
    both = identify_bag([bag, others[0]], options=options(LASER), validation=others[1:])
    holds_the_truth(both)
    assert both["bags"] == [str(bag), str(others[0])]
    for k in range(2):
        assert both["modes"][k]["frequency_sd_hz"] < alone["modes"][k]["frequency_sd_hz"]
    assert [unseen["bag"] for unseen in both["validation"]] == [str(path) for path in others[1:]]
    for unseen in both["validation"]:
        assert unseen["scores"]["rig7/laser/range:range"]["fit_percent"] > 99.0


def test_a_known_delay_is_taken_off_and_an_unknown_one_found(tmp_path: Path) -> None:
    rows = foreign.experiment(foreign.shaken(4.0), "/rig7", laser_late_s=0.004)
    late = foreign.write(tmp_path / "late", rows)
    found = identify_bag(late, options=options(LASER))
    assert found["latency_s"] == pytest.approx(0.004, abs=1e-5)
    known = identify_bag(late, options=options(f"{LASER},delay=0.004"))
    assert known["latency_s"] == pytest.approx(0.0, abs=1e-5)
    holds_the_truth(known)


def test_segments_are_used_and_nothing_else(bag: Path) -> None:
    parts = identify_bag(bag, options=options(LASER, segments=((0.5, 2.0), (2.5, 4.5))))
    holds_the_truth(parts)
    whole = identify_bag(bag, options=options(LASER))
    assert parts["modes"][0]["frequency_sd_hz"] > whole["modes"][0]["frequency_sd_hz"]
    with pytest.raises(UsageError, match=r"segment 100:inf lies outside"):
        identify_bag(bag, options=options(LASER, segments=((100.0, np.inf),)))


def test_a_transfer_function_of_degrees_that_are_asked_for_has_its_table(bag: Path) -> None:
    told = options(LASER, estimator="srivc", orders=((2, 2), (4, 4)))
    result = identify_bag(bag, options=told)
    holds_the_truth(result, 1e-3)
    assert "FIT %" in result["orders"][0]


def test_a_stamp_three_seconds_back_is_named_and_moves_no_pole(tmp_path: Path) -> None:
    rows = foreign.experiment(foreign.shaken(4.0), "/rig7")
    place = [k for k, row in enumerate(rows) if row[0].endswith("range")][700]
    topic, received, message = rows[place]
    wrong = foreign.laser_range(received - 400_000 - 3_000_700_000, message.range)
    rows[place] = (topic, received, wrong)
    result = identify_bag(foreign.write(tmp_path / "back", rows), options=options(LASER))
    (note,) = [note for note in result["notes"] if "cannot be right" in note]
    assert "2.996 s back" in note or "3.0" in note
    holds_the_truth(result)


def test_the_verb_reports_what_it_finds_and_writes_nothing_over(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("matplotlib")
    words = (
        "--input",
        AXIS,
        "--output",
        LASER,
        "--output",
        IMU,
        "--modes",
        "2",
        "--report",
        str(tmp_path / "out"),
    )
    assert main(["identify", str(bag), *words]) == 0
    assert "5.99999" in capsys.readouterr().out
    written = (tmp_path / "out" / "model.json").read_bytes()
    assert main(["identify", str(bag), *words]) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert (tmp_path / "out" / "model.json").read_bytes() == written
    assert main(["identify", str(bag), *words, "--overwrite", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["checks"][0]["can_be_identified"] is True


def test_without_signals_a_foreign_bag_is_refused_with_what_it_holds(bag: Path) -> None:
    with pytest.raises(MissingTopicsError, match="/rig7/imu"):
        identify_bag(bag)
