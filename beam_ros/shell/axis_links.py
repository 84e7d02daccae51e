"""The kinds of axis link in one table: how the node ``hub_driver`` comes to a hub from the rig.

A package of a laboratory's own adds a kind as an entry point of the group ``beam_ros.axis_links``: a callable
that takes the rig and the guard of its sequences, and returns what implements
``beam_ros.hub.contract.Hub``. What every link needs of a host (requests that are repeated, a sequence that is
streamed, samples that are stamped) lies in ``beam_ros.hub.host``.
"""

from __future__ import annotations

from collections.abc import Callable

from beam_ident.plug_ins import find_kind
from beam_ros.errors import ParameterFileError, RigUnavailableError
from beam_ros.hub.contract import Hub
from beam_ros.hub.line.driver import DriverHub
from beam_ros.hub.sequences import Guard
from beam_ros.rig.rig import Rig

AxisLink = Callable[[Rig, Guard], Hub]


def beam_link(rig: Rig, guard: Guard) -> Hub:
    """Open the suite's own protocol on a port, which may take ``serial.patience`` to appear."""
    return DriverHub(rig.axis_parameters(), rig.link_parameters(), guard=guard)


AXIS_LINKS: dict[str, AxisLink] = {"beam": beam_link}
"""The suite's own kinds of axis link, by the value of ``axis.kind``."""


def open_axis(rig: Rig, guard: Guard) -> Hub:
    """Make the hub behind the kind of link that ``axis.kind`` chooses.

    Raises
    ------
    ParameterFileError
        Neither the suite nor an installed package has the kind.
    RigUnavailableError
        The link's package cannot be loaded, or the axis cannot be reached.
    """
    errors = ParameterFileError, RigUnavailableError
    return find_kind("axis.kind", rig.axis.kind, AXIS_LINKS, "beam_ros.axis_links", *errors)(rig, guard)
