"""Whose time a node follows, and what cannot be: one check for nodes, launch files and the commands that start them.

A device and its serial line keep real time. Only the simulator can run faster or slower; it then makes the time of
the whole graph on ``/clock``, and every other node follows that (``use_sim_time``).
"""

from __future__ import annotations

from beam_ros.errors import UsageError
from beam_ros.interfaces.graph import RigKind, nodes_of_rig
from beam_ros.rig.rig import Rig

KEEPERS_OF_REAL_TIME = ("hub_driver", "firmware_emulator")
MAKER_OF_TIME = "simulator"

NO_CLOCK = (
    "use_sim_time is true and nobody publishes /clock: expected a simulator with a simulation.real_time_factor other "
    "than 1, or a replay that publishes it; start one, or set use_sim_time to false"
)
"""What a node says that waits for a time which does not come."""


def follows_clock(executable: str, rig: Rig) -> bool:
    """Whether a node of this rig is to be started with ``use_sim_time``."""
    return rig.simulation.real_time_factor != 1.0 and executable != MAKER_OF_TIME


def check_time(executable: str, rig: Rig, *, uses_sim_time: bool) -> None:
    """Raise where a node cannot keep the time that it is given.

    Parameters
    ----------
    executable : str -- key of NODES
    rig : Rig -- only for those that keep real time the real-time factor is read
    uses_sim_time : bool -- value of its parameter ``use_sim_time``

    Raises
    ------
    UsageError
        A keeper of real time has a real-time factor or follows ``/clock``, or the simulator follows its own clock.
    """
    if executable in KEEPERS_OF_REAL_TIME:
        reason = "a device and its serial line keep real time; use the simulated rig"
        factor = rig.simulation.real_time_factor
        if factor != 1.0:
            raise UsageError(
                f"simulation.real_time_factor is {factor:g} with {executable}: expected 1, because {reason}"
            )
    elif executable == MAKER_OF_TIME:
        reason = "it makes the time on /clock itself; set simulation.real_time_factor"
    else:
        return
    if uses_sim_time:
        raise UsageError(f"use_sim_time is true for {executable}: expected false, because {reason}")


def check_time_of_rig(kind: RigKind, rig: Rig) -> None:
    """Raise what ``check_time`` raises for one of the nodes that make up a rig."""
    for executable in nodes_of_rig(kind):
        check_time(executable, rig, uses_sim_time=follows_clock(executable, rig))
