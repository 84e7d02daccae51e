"""Which curves a viewer draws: numbers of JointStates, named by topic, joint and field."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from beam_ros.interfaces.graph import HUB_JOINT
from beam_ros.offline.export import QUANTITY_COLUMNS

COLOURS = ("#1d4ed8", "#c2410c", "#0f766e", "#7e22ce", "#b45309", "#4b5563")


@dataclass(frozen=True)
class Curve:
    """A number of a JointState.

    Attributes
    ----------
    topic : str -- relative name, of the table
    joint : str -- its name in the message
    index : int -- its place there
    field : str -- position, velocity or effort
    """

    topic: str
    joint: str
    index: int
    field: str = "position"


@dataclass(frozen=True)
class Plot:
    """Curves of one unit."""

    title: str
    curves: tuple[Curve, ...]


def live_plots(markers: Sequence[str]) -> tuple[Plot, ...]:
    """Return what is drawn of a running or replayed rig.

    Parameters
    ----------
    markers : sequence of str -- their names, in the order of the messages
    """
    hub = {field: (Curve("hub/state", HUB_JOINT, 0, field),) for field in ("position", "velocity", "effort")}
    seen = tuple(Curve("beam/displacement", name, k) for k, name in enumerate(markers))
    return (
        Plot("displacement of the markers [m]", seen),
        Plot("hub position [m]", hub["position"]),
        Plot("hub velocity [m/s]", hub["velocity"]),
        Plot("hub effort [N]", hub["effort"]),
    )


def flat_plots(markers: Sequence[str]) -> tuple[Plot, ...]:
    """Return what is drawn of a flat bag, where every tick of the hub is a message (``beam export --flat-bag``)."""
    return (
        live_plots(markers)[0],
        Plot("measured position [m]", (Curve("hub/measured", QUANTITY_COLUMNS["positions"], 0),)),
        Plot("applied acceleration [m/s^2]", (Curve("hub/applied", QUANTITY_COLUMNS["accelerations"], 0),)),
    )
