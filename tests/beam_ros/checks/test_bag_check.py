"""Verdicts on bags with faults that are put there on purpose, one by one."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from beam_ident import IdentificationError
from beam_ident.report.gates import Gate
from beam_ros import messages
from beam_ros.bags.errors import BagNotFoundError
from beam_ros.bags.reading import Bag
from beam_ros.bags.writing import BagWriter
from beam_ros.checks.bag_check import BagCheck, check_bag, format_check
from beam_ros.cli.main import main
from beam_ros.errors import UsageError
from beam_ros.messages import BagTypes, Displacement
from beam_ros.offline.identification import identification_of_bags
from beam_ros.offline.loading.options import FitOptions
from beam_ros.offline.simulation import simulate
from beam_ros.rig.rig import Rig
from beam_ros.signals.descriptions import Signals
from tests.beam_ros.signals import foreign_bags as foreign

WHOLE = Path(__file__).resolve().parents[3] / "bags" / "chirp_6s"
TYPES = BagTypes()


def gate(check: BagCheck, name: str) -> Gate:
    (found,) = [own for own in check.gates if own.name == name]
    return found


Change = Callable[[int, Displacement], Displacement | None]


def changed(path: Path, change: Change, leave_out: tuple[str, ...] = ()) -> Path:
    """Copy the recording with other displacements, by their number, and without some topics."""
    number = 0
    with Bag(WHOLE) as old, BagWriter(path) as new:
        for raw in old.raw_messages():
            topic = raw.topic.strip("/")
            if topic in leave_out:
                continue
            if topic != "beam/displacement":
                new.write(topic, raw.receive_ns, raw.data)
                continue
            row = messages.read_displacement(TYPES.deserialize(raw.data, raw.type_name))
            row = change(number, row)
            number += 1
            if row is not None:
                message = messages.displacement(TYPES, row.stamp_ns, row.names, row.positions)
                new.write_message(topic, raw.receive_ns, message)
    return path


def with_positions(row: Displacement, positions: Any) -> Displacement:
    return Displacement(row.stamp_ns, row.names, positions)


def test_a_whole_bag_passes_every_gate() -> None:
    check = check_bag(WHOLE)
    assert {own.verdict for own in check.gates} == {"passed"}
    assert check.can_be_identified
    assert check.verdict == "can be identified: yes"
    assert check.reasons == ()
    modes = [own.name for own in check.gates if own.name.startswith("mode at")]
    # The sweep ends at 45 Hz, below the third mode.
    assert modes == ["mode at 4.38 Hz", "mode at 28.3 Hz"]


def test_a_stamp_three_seconds_back_is_named_with_its_place(tmp_path: Path) -> None:
    def back(k: int, row: Displacement) -> Displacement:
        moved = -3_004_000_000 if k == 500 else 0
        return Displacement(row.stamp_ns + moved, row.names, row.positions)

    check = check_bag(changed(tmp_path / "bag", back))
    found = gate(check, "stamps in order")
    assert found.verdict == "doubtful"
    assert "/beam/displacement: 1 stamp cannot be right" in found.figure
    assert "2.994 s back at " in found.figure
    assert check.can_be_identified
    assert "stamps in order" in check.verdict


def test_markers_that_are_lost_are_counted_one_by_one_with_the_longest_gap(tmp_path: Path) -> None:
    def unseen(k: int, row: Displacement) -> Displacement:
        hidden = [300 <= k < 340, k % 3 == 0, False]
        return with_positions(row, np.where(hidden, np.nan, row.positions))

    check = check_bag(changed(tmp_path / "bag", unseen))
    assert "40 missing" in gate(check, "samples of z010").figure
    assert "longest 410 ms at " in gate(check, "samples of z010").figure
    assert gate(check, "samples of z010").verdict == "passed"  # a twentieth widens no interval by a tenth
    assert gate(check, "samples of z225").verdict == "doubtful"  # a third does
    assert gate(check, "samples of z285").figure.endswith("0 missing (0 %)")


@pytest.mark.slow
def test_gaps_of_the_hub_are_named_with_their_place(tmp_path: Path) -> None:
    with Bag(WHOLE) as old, BagWriter(tmp_path / "bag") as new:
        number = 0
        for raw in old.raw_messages():
            is_hub = raw.topic == "/hub/measured"
            number += is_hub
            if not (is_hub and 150 <= number < 175):
                new.write(raw.topic.strip("/"), raw.receive_ns, raw.data)
    found = gate(check_bag(tmp_path / "bag"), "gaps of hub")
    assert "1, 500 samples: at " in found.figure
    assert "(501 ms)" in found.figure


def test_a_marker_at_the_end_of_its_range_is_saturated(tmp_path: Path) -> None:
    def clipped(k: int, row: Displacement) -> Displacement:
        return with_positions(row, np.minimum(row.positions, [1.0, 1.0, 0.006]))

    found = gate(check_bag(changed(tmp_path / "bag", clipped)), "saturation")
    assert found.verdict == "doubtful"
    assert "z285 stand at 0.006" in found.figure


@pytest.mark.parametrize(("scale", "words"), [(1e3, "millimetres?"), (-1.0, "sign?")])
def test_units_that_cannot_be_are_named(tmp_path: Path, scale: float, words: str) -> None:
    def scaled(k: int, row: Displacement) -> Displacement:
        return with_positions(row, scale * row.positions)

    found = gate(check_bag(changed(tmp_path / "bag", scaled)), "units")
    assert found.verdict == "doubtful"
    assert words in found.figure


def test_frames_at_another_rate_than_the_rigs_are_named(tmp_path: Path) -> None:
    check = check_bag(changed(tmp_path / "bag", lambda k, row: row if k % 2 else None))
    found = gate(check, "rate of z010, z225, z285")
    assert found.verdict == "doubtful"
    assert "50 samples a second" in found.figure
    assert "100 frames a second" in found.expected


@pytest.mark.slow
def test_a_hub_that_stood_still_cannot_be_identified(tmp_path: Path) -> None:
    rig = Rig.from_file().with_values(
        {"excitation.duration": 2.0, "excitation.still": 1.0, "simulation.encoder_noise": 1e-6}
    )
    simulate(rig, tmp_path / "moving")
    with Bag(tmp_path / "moving") as old, BagWriter(tmp_path / "still") as new:
        rng = np.random.default_rng(0)
        for raw in old.raw_messages():
            if raw.topic == "/hub/measured":
                batch = messages.read_trajectory_batch(TYPES.deserialize(raw.data, raw.type_name))
                still = type(batch)(
                    batch.stamp_ns,
                    batch.period_ns,
                    batch.epoch,
                    positions=1e-6 * rng.standard_normal(len(batch)),
                )
                new.write_batch("hub/measured", raw.receive_ns, still)
            elif raw.topic != "/hub/applied":
                new.write(raw.topic.strip("/"), raw.receive_ns, raw.data)
    check = check_bag(tmp_path / "still", rig.with_values({"hub.encoder_resolution": 3e-6}))
    assert not check.can_be_identified
    assert gate(check, "input moved").verdict == "failed"
    assert check.verdict.startswith("can be identified: no, because of input moved")


def test_a_record_that_tells_nothing_of_its_modes_cannot_be_identified(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)

    def buried(k: int, row: Displacement) -> Displacement:
        return with_positions(row, row.positions + 2.0 * rng.standard_normal(3))

    check = check_bag(changed(tmp_path / "bag", buried))
    assert not check.can_be_identified
    assert {own.verdict for own in check.gates if own.name.startswith("mode at")} == {"failed"}
    assert gate(check, "noise of z285").verdict == "doubtful"


@pytest.mark.slow
def test_modes_of_an_output_whose_noise_nobody_knows_are_no_reason_to_refuse(tmp_path: Path) -> None:
    lost = set(np.random.default_rng(3).permutation(2000)[:600].tolist())
    check = check_bag(changed(tmp_path / "bag", lambda k, row: None if k in lost else row))
    assert gate(check, "noise of z225").verdict == "not judged"
    modes = [own for own in check.gates if own.name.startswith("mode at")]
    assert {own.verdict for own in modes} == {"not judged"}
    assert all("too many samples are missing" in own.figure for own in modes)
    assert check.can_be_identified
    assert len(identification_of_bags(tmp_path / "bag").content["modes"]) == len(modes)

    def one_seen(k: int, row: Displacement) -> Displacement:
        hidden = [k in lost, k in lost, False]
        return with_positions(row, np.where(hidden, np.nan, row.positions))

    check = check_bag(changed(tmp_path / "one", one_seen))
    assert {own.verdict for own in check.gates if own.name.startswith("mode at")} == {"passed"}


@pytest.mark.slow
def test_a_bag_without_a_rig_or_without_its_topics_is_checked_as_far_as_it_goes(tmp_path: Path) -> None:
    check = check_bag(changed(tmp_path / "bag", lambda k, row: row, ("excitation/info",)))
    assert check.can_be_identified
    assert gate(check, "resolution").verdict == "not judged"
    bare = check_bag(changed(tmp_path / "bare", lambda k, row: None))
    assert not bare.can_be_identified
    assert "/beam/displacement" in gate(bare, "content").figure


@pytest.mark.slow
def test_a_foreign_bag_is_checked_by_its_signals(tmp_path: Path) -> None:
    path = foreign.write(tmp_path / "bag", foreign.experiment(foreign.shaken(3.0), "/rig7"))
    signals = Signals.of("joint_states:position[axis]", ["range:range", "imu:linear_acceleration.x"])
    check = check_bag(path, options=FitOptions(signals=signals))
    assert check.can_be_identified, format_check(check)
    assert gate(check, "file").verdict == "passed"  # rosbags writes its summary without a checksum
    assert gate(check, "samples of imu:linear_acceleration.x").figure.endswith(" 0 missing (0 %)")
    assert gate(check, "excited band").verdict == "passed"
    with pytest.raises(UsageError, match="did you mean"):
        check_bag(path, options=FitOptions(signals=Signals.of("joint_states:positon[axis]", ["range:range"])))


def test_a_damaged_file_is_named_and_a_missing_one_is_the_users_fault(tmp_path: Path) -> None:
    shutil.copytree(WHOLE, tmp_path / "cut")
    file = tmp_path / "cut" / "chirp_6s_0.mcap"
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    check = check_bag(tmp_path / "cut")
    assert not check.can_be_identified
    assert gate(check, "file").verdict == "failed"
    assert "beam recover" in gate(check, "file").remedy
    with pytest.raises(BagNotFoundError):
        check_bag(tmp_path / "nowhere")


@pytest.mark.slow
def test_the_verb_prints_the_verdict_above_the_table_and_its_status_is_the_verdict(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["check", str(WHOLE)]) == 0
    printed = capsys.readouterr().out
    assert "passed      stamps in order" in printed
    assert printed.splitlines()[1] == "can be identified: yes"
    bare = changed(tmp_path / "bare", lambda k, row: None)
    assert main(["check", str(bare), "--json"]) == 1
    content = json.loads(capsys.readouterr().out)
    assert content["can_be_identified"] is False
    assert content["gates"][-1]["verdict"] == "failed"
    assert main(["check", str(tmp_path / "nowhere")]) == 2
    assert main(["check", str(WHOLE), "--output", "beam/displacement:position[z999]"]) == 2
    assert "expected one of z010, z225, z285" in capsys.readouterr().err


@pytest.mark.slow
def test_a_mode_that_the_frame_rate_folds_into_the_excitation_is_named(tmp_path: Path) -> None:
    values = {"excitation.kind": "multisine", "excitation.end_frequency": 24.0, "excitation.still": 2.0}
    for rate, is_folded in ((50.0, True), (100.0, False)):
        rig = Rig.from_file().with_values({**values, "excitation.duration": 5.0, "camera.rate": rate})
        simulate(rig, tmp_path / f"{rate:g}")
        said = [own for own in check_bag(tmp_path / f"{rate:g}").gates if "looks like" in own.figure]
        assert [own.name for own in said] == ["mode at 28.3 Hz"] * is_folded
        if is_folded:  # 50 - 28.26 = 21.74 Hz
            assert "21.7 Hz" in said[0].figure
            assert "film at more than 56.5" in said[0].remedy


def test_displacements_that_never_change_are_refused_by_the_check_as_by_the_fit(tmp_path: Path) -> None:
    bag = changed(tmp_path / "bag", lambda k, row: with_positions(row, 0.0 * np.asarray(row.positions)))
    check = check_bag(bag)
    assert not check.can_be_identified
    assert "is constant" in check.verdict
    with pytest.raises(IdentificationError, match="is constant"):
        identification_of_bags(bag)


@pytest.mark.parametrize("order", [[2, 1, 0], [1, 0, 2], [0, 2, 1]])
def test_markers_that_are_exchanged_move_as_others_should(order: list[int], tmp_path: Path) -> None:
    check = check_bag(
        changed(tmp_path / "bag", lambda k, row: with_positions(row, np.asarray(row.positions)[order]))
    )
    found = gate(check, "places")
    assert found.verdict == "doubtful"
    names = ("z010", "z225", "z285")
    for here, there in enumerate(order):
        assert (f"{names[here]} moves as {names[there]} should" in found.figure) == (here != there)


@pytest.mark.parametrize("name", ["multisine", "step", "decay", "drifting", "encoder_noise"])
def test_markers_in_their_places_are_not_taken_for_exchanged(name: str) -> None:
    assert gate(check_bag(WHOLE.parent / name), "places").verdict != "doubtful"
