"""Losses in words, from the counters of the nodes and from a bag's summary."""

from __future__ import annotations

from pathlib import Path

from beam_ros.bags.reading import Bag
from beam_ros.bags.summary import summarise
from beam_ros.messages import Health
from beam_ros.view.losses import Loss, losses_of_bag, losses_of_nodes
from tests.beam_ros.bags.small_bags import write_experiment


def test_the_counters_of_the_nodes_say_what_was_lost_and_where():
    hub = Health("rig/hub: hub_driver", "OK", "", "hub", {"lost_ticks": "3", "remedy": "none", "fault": "0"})
    tracker = Health(
        "tracker", "OK", "", "tracker", {"dropped frames": 0, "z225 lost": 12, "z225 sigma_px": 0.01}
    )
    assert losses_of_nodes([tracker, hub]) == (
        Loss("hub", "samples of the hub lost on the line", 3),
        Loss("tracker", "camera frames that never came", 0),
        Loss("tracker", "frames without marker z225", 12),
    )


def test_a_bag_says_what_it_lacks(tmp_path: Path):
    with Bag(write_experiment(tmp_path / "bag")) as bag:
        found = losses_of_bag(summarise(bag))
    # The last marker of this bag is hidden in every tenth of its 100 frames.
    assert Loss("beam/displacement", "frames without marker z285", 10) in found
    assert Loss("hub/measured", "samples missing, in 0 gaps", 0) in found
