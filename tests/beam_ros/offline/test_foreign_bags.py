"""Bags of other people's sensors, from the file to the poles, against modes that are known in closed form.

And one of the suite's own recordings as other people's writers would leave it: the same answers in every form.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import CompressionType as ChunkCompression
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer
from ruamel.yaml import YAML

from beam_ros.bags.errors import MissingTopicsError
from beam_ros.bags.reading import Bag
from beam_ros.bags.writing import BagWriter
from beam_ros.checks.bag_check import check_bag
from beam_ros.cli.main import main
from beam_ros.errors import UsageError
from beam_ros.offline.identification import identification_of_bags
from beam_ros.offline.loading.options import FitOptions
from beam_ros.signals.descriptions import Signals
from tests.beam_ros.signals import foreign_bags as foreign

OURS = Path(__file__).resolve().parents[3] / "bags" / "step"
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


@pytest.mark.slow
@pytest.mark.parametrize("outputs", [(LASER,), (IMU,), (LASER, IMU)], ids=["laser", "imu", "both"])
def test_no_rig_file_is_needed_for_the_poles(bag: Path, outputs: tuple[str, ...]) -> None:
    result = identification_of_bags(bag, options=options(*outputs)).content
    holds_the_truth(result)
    assert result["outputs"] == [text.strip("/") for text in (IMU, LASER) if text in outputs]
    assert "theory_mode" not in result["modes"][0]
    assert ("accelerance" in " ".join(result["notes"])) == (IMU in outputs)


@pytest.mark.slow
def test_the_same_samples_in_mcap_give_the_same_poles(bag: Path, tmp_path: Path) -> None:
    with Bag(bag) as old, BagWriter(tmp_path / "copy") as new:
        for message in old.raw_messages():
            new.add_topic(message.topic, message.type_name)
            new.write(message.topic, message.receive_ns, message.data)
    first, second = (
        identification_of_bags(path, options=options(LASER)).content for path in (bag, tmp_path / "copy")
    )
    assert first["modes"] == second["modes"]


@pytest.mark.slow
def test_a_copy_cannot_judge_the_model_and_does_not_count_twice(bag: Path, tmp_path: Path) -> None:
    copy = foreign.write(tmp_path / "copy", foreign.experiment(foreign.shaken(5.0), "/rig7"))
    with pytest.raises(UsageError, match="cannot judge the model"):
        identification_of_bags(bag, options=options(LASER), validation=copy)
    with pytest.raises(UsageError, match="give each bag once"):
        identification_of_bags([bag, copy], options=options(LASER))


@pytest.mark.slow
def test_two_bags_are_one_fit_and_two_others_judge_it(bag: Path, tmp_path: Path) -> None:
    others = [
        foreign.write(tmp_path / f"bag{seed}", foreign.experiment(foreign.shaken(4.0, seed), "/rig7"))
        for seed in (1, 2, 3)
    ]
    alone = identification_of_bags(bag, options=options(LASER)).content
    both = identification_of_bags([bag, others[0]], options=options(LASER), validation=others[1:]).content
    holds_the_truth(both)
    assert both["bags"] == [str(bag), str(others[0])]
    for k in range(2):
        assert both["modes"][k]["frequency_sd_hz"] < alone["modes"][k]["frequency_sd_hz"]
    assert [unseen["bag"] for unseen in both["validation"]] == [str(path) for path in others[1:]]
    for unseen in both["validation"]:
        assert unseen["scores"]["rig7/laser/range:range"]["fit_percent"] > 99.0


@pytest.mark.slow
def test_a_known_delay_is_taken_off_and_an_unknown_one_found(tmp_path: Path) -> None:
    rows = foreign.experiment(foreign.shaken(4.0), "/rig7", laser_late_s=0.004)
    late = foreign.write(tmp_path / "late", rows)
    found = identification_of_bags(late, options=options(LASER)).content
    assert found["latency_s"] == pytest.approx(0.004, abs=1e-5)
    known = identification_of_bags(late, options=options(f"{LASER},delay=0.004")).content
    assert known["latency_s"] == pytest.approx(0.0, abs=1e-5)
    holds_the_truth(known)


@pytest.mark.slow
def test_segments_are_used_and_nothing_else(bag: Path) -> None:
    parts = identification_of_bags(bag, options=options(LASER, segments=((0.5, 2.0), (2.5, 4.5)))).content
    holds_the_truth(parts)
    whole = identification_of_bags(bag, options=options(LASER)).content
    assert parts["modes"][0]["frequency_sd_hz"] > whole["modes"][0]["frequency_sd_hz"]
    with pytest.raises(UsageError, match=r"segment 100:inf lies outside"):
        identification_of_bags(bag, options=options(LASER, segments=((100.0, np.inf),)))


@pytest.mark.slow
def test_a_transfer_function_of_degrees_that_are_asked_for_has_its_table(bag: Path) -> None:
    told = options(LASER, estimator="srivc", orders=((2, 2), (4, 4)))
    result = identification_of_bags(bag, options=told).content
    holds_the_truth(result, 1e-3)
    assert "FIT %" in result["orders"][0]


@pytest.mark.slow
def test_a_stamp_three_seconds_back_is_named_and_moves_no_pole(tmp_path: Path) -> None:
    rows = foreign.experiment(foreign.shaken(4.0), "/rig7")
    place = [k for k, row in enumerate(rows) if row[0].endswith("range")][700]
    topic, received, message = rows[place]
    wrong = foreign.laser_range(received - 400_000 - 3_000_700_000, message.range)
    rows[place] = (topic, received, wrong)
    result = identification_of_bags(foreign.write(tmp_path / "back", rows), options=options(LASER)).content
    (note,) = [note for note in result["notes"] if "cannot be right" in note]
    assert "2.996 s back" in note or "3.0" in note
    holds_the_truth(result)


@pytest.mark.slow
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
    (first,) = re.findall(r"^ +1 +([0-9.]+) \+-", capsys.readouterr().out, re.MULTILINE)
    assert float(first) == pytest.approx(6.0, abs=2e-5)
    written = (tmp_path / "out" / "model.json").read_bytes()
    assert main(["identify", str(bag), *words]) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert (tmp_path / "out" / "model.json").read_bytes() == written
    assert main(["identify", str(bag), *words, "--overwrite", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["checks"][0]["can_be_identified"] is True


def test_without_signals_a_foreign_bag_is_refused_with_what_it_holds(bag: Path) -> None:
    with pytest.raises(MissingTopicsError, match="/rig7/imu"):
        identification_of_bags(bag)


# --- one recording in every form


Rename = Callable[[str], str]
_STEADY = ("modes", "scores", "latency_s", "latency_sd_s", "clock_rate", "clock_rate_sd", "notes", "warnings")


def _same(topic: str) -> str:
    return topic


def _in_namespace(topic: str) -> str:
    return f"/lab/rig_3{topic}"


OTHER_NAMES = {"/hub/measured": "/stage/encoder", "/beam/displacement": "/vision/strip"}


def _other_name(topic: str) -> str:
    return OTHER_NAMES.get(topic, f"/other{topic}")


@dataclass(frozen=True)
class ByRosbags:
    """A bag that rosbags writes: one file, or several that metadata.yaml names."""

    storage: StoragePlugin = StoragePlugin.MCAP
    compression: CompressionMode = CompressionMode.NONE
    files: int = 1
    rename: Rename = _same

    def write(self, path: Path) -> None:
        with Reader(OURS) as reader:
            messages = list(reader.messages())
        share = -(-len(messages) // self.files)
        described = []
        for number in range(self.files):
            part = path if self.files == 1 else path.with_name(f"{path.name}_part{number}")
            writer = Writer(part, version=9, storage_plugin=self.storage)
            writer.set_compression(self.compression, CompressionFormat.ZSTD)
            with writer:
                connections: dict[str, Any] = {}
                for connection, receive_ns, data in messages[number * share : (number + 1) * share]:
                    if connection.topic not in connections:
                        connections[connection.topic] = writer.add_connection(
                            self.rename(connection.topic), connection.msgtype, typestore=foreign.STORE
                        )
                    writer.write(connections[connection.topic], receive_ns, data)
            described.append(part)
        if self.files > 1:
            _join(described, path)


def _join(parts: list[Path], path: Path) -> None:
    """Make one bag of several: their files, and a metadata.yaml that names them as ``ros2 bag record`` does."""
    path.mkdir()
    yaml = YAML(typ="safe")
    whole: dict[str, Any] = {}
    for part in parts:
        own = yaml.load((part / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
        (name,) = own["relative_file_paths"]
        (part / name).rename(path / name)
        if not whole:
            whole = own
            continue
        begin = whole["starting_time"]["nanoseconds_since_epoch"]
        end = own["starting_time"]["nanoseconds_since_epoch"] + own["duration"]["nanoseconds"]
        whole["duration"]["nanoseconds"] = end - begin
        whole["message_count"] += own["message_count"]
        whole["relative_file_paths"] += own["relative_file_paths"]
        whole["files"] += own["files"]
        for row in own["topics_with_message_count"]:
            topic = row["topic_metadata"]
            known = [
                other
                for other in whole["topics_with_message_count"]
                if other["topic_metadata"]["name"] == topic["name"]
            ]
            if known:
                known[0]["message_count"] += row["message_count"]
            else:
                whole["topics_with_message_count"].append(row)
    with (path / "metadata.yaml").open("w") as file:
        yaml.dump({"rosbag2_bagfile_information": whole}, file)


@dataclass(frozen=True)
class ByMcap:
    """A single file that mcap writes: no folder, no metadata.yaml."""

    compression: ChunkCompression = ChunkCompression.ZSTD
    is_chunked: bool = True

    def write(self, path: Path) -> None:
        path.mkdir()
        with Reader(OURS) as reader, (path / "foreign.mcap").open("wb") as stream:
            writer = McapWriter(
                stream, chunk_size=50_000, compression=self.compression, use_chunking=self.is_chunked
            )
            writer.start(profile="ros2", library="somebody else's")
            channels: dict[str, int] = {}
            for connection, receive_ns, data in reader.messages():
                if connection.topic not in channels:
                    schema = writer.register_schema(
                        connection.msgtype, "ros2msg", connection.msgdef.data.encode()
                    )
                    channels[connection.topic] = writer.register_channel(connection.topic, "cdr", schema)
                writer.add_message(channels[connection.topic], receive_ns, bytes(data), receive_ns)
            writer.finish()


IDENTIFIED = ("sqlite, three files", "mcap, zstd by message", "mcap alone, lz4")
"""Of the others, the checks see the same samples."""

FORMS: dict[str, ByRosbags | ByMcap] = {
    "sqlite": ByRosbags(StoragePlugin.SQLITE3),
    "sqlite, zstd by file": ByRosbags(StoragePlugin.SQLITE3, CompressionMode.FILE),
    "sqlite, zstd by message": ByRosbags(StoragePlugin.SQLITE3, CompressionMode.MESSAGE),
    "sqlite, three files": ByRosbags(StoragePlugin.SQLITE3, files=3),
    "mcap": ByRosbags(),
    "mcap, zstd by file": ByRosbags(compression=CompressionMode.FILE),
    "mcap, zstd by message": ByRosbags(compression=CompressionMode.MESSAGE),
    "mcap, zstd by chunk": ByRosbags(compression=CompressionMode.STORAGE),
    "mcap, three files": ByRosbags(files=3),
    "mcap, three files, zstd by file": ByRosbags(compression=CompressionMode.FILE, files=3),
    "mcap alone, zstd": ByMcap(),
    "mcap alone, lz4": ByMcap(ChunkCompression.LZ4),
    "mcap alone, no chunks": ByMcap(ChunkCompression.NONE, is_chunked=False),
    "sqlite in a namespace": ByRosbags(StoragePlugin.SQLITE3, rename=_in_namespace),
    "mcap in a namespace": ByRosbags(rename=_in_namespace),
}


@pytest.fixture(scope="module")
def original() -> dict[str, Any]:
    return identification_of_bags(OURS).content


def gates_of(path: Path) -> list[tuple[str, str]]:
    """Return name and verdict of every gate but that of the file itself."""
    return [(gate.name, gate.verdict) for gate in check_bag(path).gates if gate.name != "file"]


@pytest.fixture(scope="module")
def original_gates() -> list[tuple[str, str]]:
    return gates_of(OURS)


@pytest.mark.slow
@pytest.mark.parametrize("form", FORMS)
def test_our_recording_gives_the_same_answers_in_every_form(
    form: str, original: dict[str, Any], original_gates: list[tuple[str, str]], tmp_path: Path
) -> None:
    FORMS[form].write(tmp_path / "bag")
    assert gates_of(tmp_path / "bag") == original_gates
    if form in IDENTIFIED:
        found = identification_of_bags(tmp_path / "bag").content
        assert {name: found[name] for name in _STEADY} == {name: original[name] for name in _STEADY}


@pytest.mark.slow
@pytest.mark.parametrize("storage", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
def test_our_recording_under_other_names_gives_the_same_answers(
    storage: StoragePlugin, original: dict[str, Any], tmp_path: Path
) -> None:
    ByRosbags(storage, rename=_other_name).write(tmp_path / "bag")
    found = []
    for path, hub, beam in (
        (OURS, "/hub/measured", "/beam/displacement"),
        (tmp_path / "bag", *OTHER_NAMES.values()),
    ):
        outputs = [f"{beam}:position[{marker}],name={marker}" for marker in ("z010", "z225", "z285")]
        signals = Signals.of(f"{hub}:positions,name=axis", outputs)
        found.append(identification_of_bags(path, options=FitOptions(signals=signals)).content)
    assert {name: found[1][name] for name in _STEADY[:-2]} == {name: found[0][name] for name in _STEADY[:-2]}
    for mode, ours in zip(found[1]["modes"], original["modes"], strict=True):
        assert abs(mode["frequency_hz"] - ours["frequency_hz"]) < ours["frequency_sd_hz"]
        assert abs(mode["damping_ratio"] - ours["damping_ratio"]) < ours["damping_ratio_sd"]
