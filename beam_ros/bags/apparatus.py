"""What made the data of a bag, by its own testimony: a rig, or a simulation, and whether its dates are of a clock."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import datetime, timezone
from typing import Any

from beam_ros.bags.reading import Bag

SIMULATED_SEQUENCE = "simulated"
"""Name of the sequence of a bag that the simulator's core wrote, in a time of its own."""

_PLANTS = {"simulator": "simulated", "firmware_emulator": "emulated"}
_SENTENCES = {
    "simulated": "The data are simulated: no beam was measured.",
    "emulated": "The data are those of an emulated axis with a simulated beam: no beam was measured.",
}


@dataclass(frozen=True)
class Apparatus:
    """What a bag's data come from.

    Attributes
    ----------
    kind : str -- "simulated", "emulated", or "measured": no simulation is known of
    has_date : bool -- whether its stamps are of a clock; the simulator's core makes a time up
    """

    kind: str = "measured"
    has_date: bool = True

    @property
    def is_simulated(self) -> bool:
        """Whether the beam is a computed one, which has what its rig file says and nothing else."""
        return self.kind != "measured"

    @property
    def sentence(self) -> str:
        """What stands under the title of every page of such data; empty of measured ones."""
        return _SENTENCES.get(self.kind, "")

    def date(self, time_ns: int) -> str:
        """Return an instant [ns, UNIX] as a date, or why it is none."""
        if not self.has_date:
            return "no date: simulated, in a time of its own"
        return f"{datetime.fromtimestamp(time_ns * 1e-9, timezone.utc):%Y-%m-%d %H:%M:%S} UTC"


MEASURED = Apparatus()


def apparatus_of(bag: Bag, info: Mapping[str, Any]) -> Apparatus:
    """Return what made a bag's data: the simulator's core, or a node that holds a simulated beam.

    Parameters
    ----------
    bag : Bag -- open
    info : mapping -- what its ``excitation/info`` says; empty where there is none
    """
    if info.get("sequence_id") == SIMULATED_SEQUENCE:
        return Apparatus("simulated", has_date=False)
    nodes = {one.name.rpartition(": ")[2] for one in bag.healths()}
    return Apparatus(next((kind for node, kind in _PLANTS.items() if node in nodes), "measured"))


def simulated_line(all_of_them: Iterable[Apparatus]) -> str:
    """Return the sentence for a page about several bags; empty where all are measured."""
    several = list(all_of_them)
    simulated = [one for one in several if one.is_simulated]
    if len(simulated) == len(several):
        return " ".join(dict.fromkeys(one.sentence for one in simulated))
    return f"{len(simulated)} of {len(several)} bags hold simulated data, of no beam." if simulated else ""
