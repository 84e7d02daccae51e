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
