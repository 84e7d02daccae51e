"""What a bag says of what made its data: the simulator's core, a node with a simulated beam, or a rig."""

from __future__ import annotations

from pathlib import Path

import pytest

from beam_ros import messages
from beam_ros.bags.apparatus import MEASURED, Apparatus, apparatus_of, simulated_line
from beam_ros.bags.reading import Bag
from beam_ros.bags.writing import BagWriter
from beam_ros.messages import BagTypes
from beam_ros.messages.health import Health

BAGS = Path(__file__).resolve().parents[3] / "bags"


def bag_of(path: Path, *nodes: str) -> Path:
    """Write a bag in which these nodes report that they are well."""
    types = BagTypes()
    with BagWriter(path) as bag:
        said = [Health(f"hub: {node}", "OK", "well", node) for node in nodes]
        bag.write_message("/diagnostics", 10**18, messages.diagnostics(types, 10**18, said))
    return path


@pytest.mark.parametrize(
    ("nodes", "kind"),
    [
        (("simulator", "vision_tracker"), "simulated"),
        (("hub_driver", "firmware_emulator"), "emulated"),
        (("hub_driver", "vision_tracker"), "measured"),
    ],
)
def test_the_node_that_holds_a_beam_tells_whether_it_is_one(
    nodes: tuple[str, ...], kind: str, tmp_path: Path
) -> None:
    with Bag(bag_of(tmp_path / "bag", *nodes)) as bag:
        found = apparatus_of(bag, {"sequence_id": "a1b2"})
    assert found == Apparatus(kind)
    assert found.date(1_700_000_000 * 10**9) == "2023-11-14 22:13:20 UTC"


def test_the_core_of_the_simulator_makes_its_time_up() -> None:
    with Bag(BAGS / "chirp_6s") as bag:
        found = apparatus_of(bag, bag.excitation_info() or {})
    assert found.is_simulated
    assert "2023" not in found.date(1_700_000_000 * 10**9)


def test_a_page_over_several_bags_says_how_many_are_simulated() -> None:
    assert simulated_line([MEASURED, MEASURED]) == ""
    assert simulated_line([Apparatus("simulated")] * 2) == Apparatus("simulated").sentence
    assert simulated_line([MEASURED, Apparatus("emulated")]).startswith("1 of 2 bags")
