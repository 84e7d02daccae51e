"""Reading: signals come out as they were recorded, losses are seen, and faults have names and remedies."""

from __future__ import annotations

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer

from beam_ros import messages
from beam_ros.bags.errors import (
    BagError,
    BagNotFoundError,
    BagTruncatedError,
    MissingTopicsError,
    NotABagError,
)
from beam_ros.bags.reading import Bag
from beam_ros.bags.summary import summarise
from beam_ros.bags.writing import BagWriter
from beam_ros.hub.contract import SampleBatch
from tests.beam_ros.bags.small_bags import (
    BATCH,
    FRAME,
    NAMES,
    PERIOD,
    START,
    TYPES,
    batch,
    displacement_row,
    write_experiment,
)


@pytest.fixture(scope="module")
def experiment(tmp_path_factory):
    return write_experiment(tmp_path_factory.mktemp("bags") / "run")


def _write_batches(path, batches, *, topic="hub/measured"):
    with BagWriter(path) as bag:
        for k, item in enumerate(batches):
            bag.write_batch(topic, START + k, item)
    return path


# --- content


def test_hub_samples_are_the_concatenated_batches(experiment):
    with Bag(experiment) as bag:
        samples = bag.hub_samples("hub/measured")
        applied = bag.hub_samples("hub/applied")
    ticks = np.arange(50 * BATCH)
    np.testing.assert_array_equal(samples.stamps_ns, START + ticks * PERIOD)
    np.testing.assert_array_equal(samples.positions, ticks * 1e-6)
    assert samples.accelerations is None
    assert samples.period_ns == PERIOD
    assert (samples.lost, samples.duplicates, samples.unreadable.count) == (0, 0, 0)
    np.testing.assert_array_equal(applied.accelerations, np.repeat(0.1 * np.arange(50), BATCH))
    assert applied.positions is None


def test_displacements_are_a_table_with_unseen_markers_as_nan(experiment):
    with Bag(experiment) as bag:
        table = bag.displacements()
    assert table.names == NAMES
    np.testing.assert_array_equal(table.stamps_ns, START + np.arange(100) * FRAME)
    np.testing.assert_array_equal(table.positions, [displacement_row(k) for k in range(100)])


def test_texts_and_clocks(experiment):
    with Bag(experiment) as bag:
        assert bag.excitation_info() == {"kind": "chirp", "seed": 1}
        assert [state["state"] for state in bag.sequence_states()] == ["loading", "running", "done"]
        syncs = bag.clock_syncs()
    assert len(syncs) == 5
    assert {sync.epoch for sync in syncs} == {1}


def test_summary_says_rates_losses_and_drift(experiment):
    with Bag(experiment) as bag:
        info = summarise(bag)
    signals = {signal.topic: signal for signal in info.signals}
    assert signals["/hub/measured"].rate_hz == 1000
    assert signals["/hub/measured"].lost == 0
    assert signals["/beam/displacement"].rate_hz == 100
    assert signals["/beam/displacement"].unseen == (0, 0, 10)
    (clock,) = info.clocks
    assert clock.rate_ppm == pytest.approx(35.0, abs=0.01)  # device stamps are whole nanoseconds
    assert info.sequences == ("chirp-1: done",)
    plain = info.to_dict()
    assert plain["path"] == str(experiment)
    assert plain["message_count"] == 209


def test_a_lost_batch_is_a_gap_of_its_samples(tmp_path):
    path = _write_batches(tmp_path / "run", [batch(k) for k in (0, 1, 3, 4)])
    with Bag(path) as bag:
        samples = bag.hub_samples()
    (gap,) = samples.gaps
    assert gap.missing == samples.lost == BATCH
    assert gap.start_ns == START + (2 * BATCH - 1) * PERIOD
    assert gap.end_ns == START + 3 * BATCH * PERIOD
    assert len(samples.positions) == 4 * BATCH


@pytest.mark.parametrize(("late_ns", "is_gap"), [(400_000, False), (600_000, True)])
def test_loss_is_a_gap_of_more_than_half_a_period(tmp_path, late_ns, is_gap):
    late = SampleBatch(START + BATCH * PERIOD + late_ns, PERIOD, 1, np.zeros(BATCH))
    with Bag(_write_batches(tmp_path / "run", [batch(0, positions=np.zeros(BATCH)), late])) as bag:
        assert bool(bag.hub_samples().gaps) == is_gap


def test_batches_recorded_out_of_order_or_twice_are_sorted_and_counted(tmp_path):
    path = _write_batches(tmp_path / "run", [batch(k) for k in (2, 0, 1, 1, 3)])
    with Bag(path) as bag:
        samples = bag.hub_samples()
    np.testing.assert_array_equal(samples.positions, np.arange(4 * BATCH) * 1e-6)
    assert samples.duplicates == BATCH
    assert not samples.gaps


def test_a_restart_of_the_device_is_marked_in_its_gap(tmp_path):
    path = _write_batches(tmp_path / "run", [batch(0), batch(5, epoch=2)])
    with Bag(path) as bag:
        samples = bag.hub_samples()
    assert samples.gaps[0].is_new_epoch
    assert set(samples.epochs) == {1, 2}


def test_a_quantity_in_some_batches_only_is_nan_elsewhere(tmp_path):
    first = batch(0, positions=np.ones(BATCH))
    second = batch(1, positions=np.ones(BATCH), efforts=np.full(BATCH, 2.0))
    with Bag(_write_batches(tmp_path / "run", [first, second])) as bag:
        samples = bag.hub_samples()
    assert np.all(np.isnan(samples.efforts[:BATCH]))
    np.testing.assert_array_equal(samples.efforts[BATCH:], 2.0)


def test_single_sample_batches_join_by_the_period_they_name(tmp_path):
    ones = [SampleBatch(START + k * PERIOD, PERIOD, 1, np.array([float(k)])) for k in range(30)]
    with Bag(_write_batches(tmp_path / "run", ones)) as bag:
        samples = bag.hub_samples()
    assert samples.period_ns == PERIOD
    assert not samples.gaps


def test_samples_with_stamps_of_their_own_are_lost_only_where_far_more_than_usual_is_missing(tmp_path):
    rng = np.random.default_rng(2)
    stamps = START + np.cumsum(rng.integers(4_000_000, 7_000_000, 200))
    stamps[120:] += 30_000_000
    ones = [SampleBatch(int(stamp), 0, 1, np.array([float(k)])) for k, stamp in enumerate(stamps)]
    with Bag(_write_batches(tmp_path / "run", ones)) as bag:
        samples = bag.hub_samples()
        (signal,) = [signal for signal in summarise(bag).signals if signal.topic == "/hub/measured"]
    assert samples.period_ns == 0
    np.testing.assert_array_equal(samples.stamps_ns, stamps)
    (gap,) = samples.gaps
    assert (gap.start_ns, gap.end_ns) == (stamps[119], stamps[120])
    assert gap.missing == 6  # 35 ms at 5.5 ms
    assert signal.rate_hz == pytest.approx(1e9 / 5.5e6, rel=0.05)


def test_unreadable_and_unstamped_messages_are_left_out_and_counted(tmp_path):
    with BagWriter(tmp_path / "run") as bag:
        bag.write("hub/measured", START, b"\x00\x01\x00\x00rubbish")
        bag.write_batch("hub/measured", START, SampleBatch(0, PERIOD, 1, np.zeros(BATCH)))
        bag.write_batch("hub/measured", START, batch(0))
    with Bag(tmp_path / "run") as bag:
        samples = bag.hub_samples()
    assert len(samples.stamps_ns) == BATCH
    assert samples.unreadable.count == 2
    assert "no JointTrajectory" in samples.unreadable.first_reason


def test_displacements_of_a_rolling_shutter_have_a_row_for_each_time(tmp_path):
    with BagWriter(tmp_path / "run") as bag:
        for k in (1, 0):
            for j, name in enumerate(NAMES):
                stamp = START + k * FRAME + j * 1000
                message = messages.displacement(TYPES, stamp, [name], [k + 0.1 * j])
                bag.write_message("beam/displacement", START + k, message)
        twice = messages.displacement(TYPES, START, ["z010"], [99.0])
        bag.write_message("beam/displacement", START + 9, twice)
    with Bag(tmp_path / "run") as bag:
        table = bag.displacements()
    assert table.positions.shape == (6, 3)
    assert np.all(np.diff(table.stamps_ns) > 0)
    assert np.count_nonzero(~np.isnan(table.positions)) == 6
    assert table.positions[0, 0] == 0.0
    assert table.duplicates == 1


# --- other writers


@pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_bags_written_by_rosbags_are_read_in_both_storages(tmp_path, storage):
    with Writer(tmp_path / "run", version=9, storage_plugin=storage) as writer:
        connection = writer.add_connection(
            "/rig1/hub/measured", "trajectory_msgs/msg/JointTrajectory", typestore=TYPES.store
        )
        for k in range(3):
            message = messages.trajectory_batch(TYPES, batch(k))
            data = TYPES.serialize(message, "trajectory_msgs/msg/JointTrajectory")
            writer.write(connection, START + k, data)
    with Bag(tmp_path / "run") as bag:
        assert bag.namespace == "rig1"
        assert bag.storage == storage.name.lower()
        np.testing.assert_array_equal(bag.hub_samples().positions, np.arange(3 * BATCH) * 1e-6)


@pytest.mark.parametrize("name", ["run_0.mcap", "."])
def test_a_bag_without_metadata_is_read_by_its_file(tmp_path, name):
    path = write_experiment(tmp_path / "run")
    (path / "metadata.yaml").unlink()
    with Bag(path / name) as bag:
        assert len(bag.hub_samples().stamps_ns) == 1000


def test_two_rigs_in_one_bag_need_a_name(tmp_path):
    with BagWriter(tmp_path / "run") as bag:
        for rig in ("a", "b"):
            bag.add_topic(f"/{rig}/hub/measured", "trajectory_msgs/msg/JointTrajectory")
            bag.write_batch(f"/{rig}/hub/measured", START, batch(0))
    with pytest.raises(MissingTopicsError, match="/a, /b"):
        Bag(tmp_path / "run")
    with Bag(tmp_path / "run", namespace="b") as bag:
        assert bag.hub_samples().topic == "/b/hub/measured"


# --- faults


def test_no_such_bag(tmp_path):
    with pytest.raises(BagNotFoundError, match="does not exist"):
        Bag(tmp_path / "nothing")


def test_what_is_no_bag(tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "notes.txt").write_text("hello")
    (tmp_path / "fake.mcap").write_text("hello, this is no recording at all")
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "metadata.yaml").write_text("a: [")
    for name in ("empty", "notes.txt", "fake.mcap", "broken"):
        with pytest.raises(NotABagError) as caught:
            Bag(tmp_path / name)
        assert name in str(caught.value)


def test_missing_topics_say_what_is_there_and_what_is_needed(tmp_path):
    with BagWriter(tmp_path / "run") as bag:
        bag.write_batch("hub/measured", START, batch(0))
        bag.add_topic("hub/applied")
    with Bag(tmp_path / "run") as bag, pytest.raises(MissingTopicsError) as caught:
        bag.require("hub/measured", "hub/applied", "beam/displacement")
    text = str(caught.value)
    assert "no messages on /hub/applied, /beam/displacement" in text
    assert "/hub/measured (1)" in text
    assert "record with" in text


def test_a_topic_of_a_wrong_type_is_missing_with_its_reason(tmp_path):
    with BagWriter(tmp_path / "run") as bag:
        bag.add_topic("/hub/measured", "std_msgs/msg/String")
        bag.write_message("/hub/measured", START, messages.json_text(TYPES, {}))
    with Bag(tmp_path / "run") as bag, pytest.raises(MissingTopicsError, match=r"type std_msgs/msg/String"):
        bag.hub_samples()


def test_a_bag_in_the_making_is_refused_as_such(tmp_path):
    writer = BagWriter(tmp_path / "run")
    with pytest.raises(BagTruncatedError, match="still being recorded"):
        Bag(tmp_path / "run")
    writer.close()


def test_a_cut_recording_is_refused_with_its_remedy(tmp_path):
    path = write_experiment(tmp_path / "run")
    data = (path / "run_0.mcap").read_bytes()
    for length in (9, 100, len(data) // 2, len(data) - 1):
        (path / "run_0.mcap").write_bytes(data[:length])
        with pytest.raises(BagTruncatedError, match="beam recover"):
            Bag(path)
    (path / "run_0.mcap").unlink()
    with pytest.raises(BagError):
        Bag(path)


@pytest.mark.slow
def test_damage_in_the_middle_of_a_file_never_ends_in_a_foreign_exception(tmp_path):
    path = write_experiment(tmp_path / "run", batches=10)
    file = path / "run_0.mcap"
    whole = file.read_bytes()
    random = np.random.default_rng(7)
    refused = 0
    for position in random.integers(0, len(whole), size=80):
        damaged = bytearray(whole)
        damaged[position] ^= 1 << int(random.integers(8))
        file.write_bytes(bytes(damaged))
        try:
            with Bag(path) as bag:
                summarise(bag)
        except BagError:
            refused += 1
    assert refused > 25  # the chunks' checksums see to it


def test_frames_that_were_dropped_are_gaps_of_the_summary(tmp_path):
    frames = [0, 1, 2, 5, 6, 7, 8, 10, 11]  # two are missing in one place and one in another
    with BagWriter(tmp_path / "run") as bag:
        for k in frames:
            message = messages.displacement(TYPES, START + k * FRAME, NAMES, displacement_row(k))
            bag.write_message("beam/displacement", START + k * FRAME, message)
    with Bag(tmp_path / "run") as bag:
        (signal,) = summarise(bag).signals
    assert (signal.samples, signal.gaps, signal.lost) == (9, 2, 3)
    assert (signal.rate_hz, signal.duration_s) == pytest.approx((100.0, 0.11))
