"""Exports say the same numbers as the bag, in forms that other tools read."""

from __future__ import annotations

import csv

import numpy as np
import pytest
from rosbags.rosbag2 import Reader

from beam_ros import messages
from beam_ros.bags.errors import BagExistsError, MissingTopicsError
from beam_ros.bags.reading import Bag
from beam_ros.bags.writing import BagWriter
from beam_ros.interfaces import graph
from beam_ros.offline.export import export_csv, export_flat_bag
from tests.beam_ros.bags.small_bags import START, TYPES, write_experiment


@pytest.fixture(scope="module")
def experiment(tmp_path_factory):
    return write_experiment(tmp_path_factory.mktemp("bags") / "run", namespace="rig1")


def test_csv_holds_every_sample_to_the_last_bit(experiment, tmp_path):
    shares = []
    with Bag(experiment) as bag:
        files = export_csv(bag, tmp_path / "csv", shares.append)
        samples, table = bag.hub_samples("hub/measured"), bag.displacements()
    assert [file.name for file in files] == ["hub_applied.csv", "hub_measured.csv", "beam_displacement.csv"]
    assert sorted(files) == sorted((tmp_path / "csv").iterdir())
    with files[1].open(newline="") as file:
        header, *rows = csv.reader(file)
    assert header == ["stamp_ns", "time_s", "position_m", "velocity_m_s"]
    np.testing.assert_array_equal([int(row[0]) for row in rows], samples.stamps_ns)
    np.testing.assert_array_equal([float(row[2]) for row in rows], samples.positions)
    read = np.genfromtxt(files[2], delimiter=",", names=True)
    np.testing.assert_array_equal(read["z285_m"], table.positions[:, 2])
    np.testing.assert_allclose(read["time_s"], np.arange(100) * 0.01, atol=1e-12)
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def test_flat_bag_has_a_message_for_each_sample_with_its_stamp_as_receive_time(experiment, tmp_path):
    with Bag(experiment) as bag:
        count = export_flat_bag(bag, tmp_path / "flat")
        samples, table = bag.hub_samples("hub/measured"), bag.displacements()
    assert count == 1000 + 1000 + 100 + 1 + 3 + 5
    measured = []
    with Reader(tmp_path / "flat") as reader:
        assert {c.topic: c.msgtype for c in reader.connections}["/rig1/hub/applied"] == graph.JOINT_STATE
        for connection, receive_ns, data in reader.messages():
            if connection.topic == "/rig1/hub/measured":
                message = TYPES.deserialize(data, connection.msgtype)
                assert messages.stamp_ns(message) == receive_ns
                assert list(message.name) == ["position_m", "velocity_m_s"]
                measured.append(message.position)
    np.testing.assert_array_equal(np.array(measured)[:, 0], samples.positions)
    with Bag(tmp_path / "flat") as flat:
        again = flat.displacements()
        assert flat.excitation_info() == {"kind": "chirp", "seed": 1}
    assert again.names == table.names
    np.testing.assert_array_equal(again.positions, table.positions)
    np.testing.assert_array_equal(again.stamps_ns, table.stamps_ns)


def test_existing_targets_are_refused(experiment, tmp_path):
    with Bag(experiment) as bag:
        for export in (export_csv, export_flat_bag):
            with pytest.raises(BagExistsError):
                export(bag, tmp_path)


def test_a_bag_without_signals_is_refused_and_leaves_nothing(tmp_path):
    with BagWriter(tmp_path / "run") as writer:
        writer.write_message("excitation/info", START, messages.json_text(TYPES, {}))
    with Bag(tmp_path / "run") as bag:
        for export in (export_csv, export_flat_bag):
            with pytest.raises(MissingTopicsError, match="no signal to export"):
                export(bag, tmp_path / "out")
    assert [path.name for path in tmp_path.iterdir()] == ["run"]
