"""What was heard is read as the bag that it would have become."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from beam_ros.bags.errors import MissingTopicsError
from beam_ros.bags.live.heard import HeardBag
from beam_ros.bags.reading import Bag
from beam_ros.interfaces.graph import LIVE_NEEDS
from tests.beam_ros.bags.small_bags import write_experiment

CHIRP = Path(__file__).resolve().parents[4] / "bags" / "chirp_6s"


@pytest.fixture(scope="module")
def bag_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_experiment(tmp_path_factory.mktemp("heard") / "bag")


def test_pieces_that_are_read_in_between_make_what_the_whole_bag_makes(bag_path: Path) -> None:
    heard = HeardBag()
    with Bag(bag_path) as bag:
        names = {bag.full_name(topic): topic for topic in LIVE_NEEDS}
        for number, raw in enumerate(bag.raw_messages(*names.values())):
            heard.hear(names[raw.topic], raw.data, raw.receive_ns)
            if number % 30 == 29:
                heard.hub_samples("hub/measured")
        for topic in ("hub/measured", "hub/applied"):
            assert heard.count(topic) == bag.count(topic)
            found, expected = heard.hub_samples(topic), bag.hub_samples(topic)
            np.testing.assert_array_equal(found.stamps_ns, expected.stamps_ns)
            for name in ("positions", "accelerations"):
                if getattr(expected, name) is not None:
                    np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
            assert found.is_in_order
        np.testing.assert_array_equal(heard.displacements().positions, bag.displacements().positions)
        assert heard.displacements().names == bag.displacements().names
        assert heard.clock_syncs() == bag.clock_syncs()
        assert heard.excitation_info() == bag.excitation_info()
        assert heard.sequence_states() == bag.sequence_states()
        assert [raw.data for raw in heard.raw_messages("beam/displacement")] == [
            raw.data for raw in bag.raw_messages("beam/displacement")
        ]
        assert heard.message_count == sum(heard.count(topic) for topic in LIVE_NEEDS)
    heard.close()


def test_what_was_not_heard_is_missing_as_in_a_bag() -> None:
    heard = HeardBag()
    assert heard.texts("excitation/info") == ()
    assert heard.healths() == ()
    with pytest.raises(MissingTopicsError, match="what was heard has no messages on hub/measured"):
        heard.require("hub/measured")
    heard.close()


def test_what_is_forgotten_is_gone_from_arrays_and_files_and_what_is_latched_stays() -> None:
    memory_s = 2.0
    heard, all_of_it = HeardBag(memory_s=memory_s), HeardBag()
    with Bag(CHIRP) as bag:
        names = {bag.full_name(topic): topic for topic in LIVE_NEEDS}
        messages = list(bag.raw_messages(*names.values()))
    newest_ns = messages[-1].receive_ns - round(memory_s * 1e9)
    assert messages[0].receive_ns < newest_ns - 1e9  # else there is nothing to forget
    for number, raw in enumerate(messages):
        for own in (heard, all_of_it):
            own.hear(names[raw.topic], raw.data, raw.receive_ns)
        if number % 50 == 49:
            heard.hub_samples("hub/measured")
    newest = HeardBag()
    for raw in messages:
        if raw.receive_ns >= newest_ns:
            newest.hear(names[raw.topic], raw.data, raw.receive_ns)
    for topic in ("hub/measured", "hub/applied"):
        np.testing.assert_array_equal(heard.hub_samples(topic).stamps_ns, newest.hub_samples(topic).stamps_ns)
    np.testing.assert_array_equal(heard.displacements().positions, newest.displacements().positions)
    assert heard.clock_syncs() == newest.clock_syncs()
    assert heard.excitation_info() == all_of_it.excitation_info() is not None
    assert heard.sequence_states() == all_of_it.sequence_states()
    assert heard.duration_ns == all_of_it.duration_ns
    oldest_ns = next(iter(heard.raw_messages())).receive_ns
    assert messages[0].receive_ns < oldest_ns <= newest_ns
    for own in (heard, all_of_it, newest):
        own.close()
