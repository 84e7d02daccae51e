"""The kinds of axis link in one table: how the node ``hub_driver`` comes to a hub from the rig.

A package of a laboratory's own adds a kind as an entry point of the group ``beam_ros.axis_links``: a callable
that takes the rig and the guard of its beam, and returns what implements
``beam_ros.hub.contract.Hub``. What every link needs of a host (requests that are repeated, a sequence that is
streamed, samples that are stamped) lies in ``beam_ros.hub.host``.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import rclpy

from beam_ident.plug_ins import find_kind
from beam_ros.errors import ParameterFileError, RigUnavailableError
from beam_ros.hub.contract import Hub
from beam_ros.hub.gate.beam_guard import BeamGuard
from beam_ros.hub.line.driver import DriverHub
from beam_ros.rig.rig import Rig

AxisLink = Callable[[Rig, BeamGuard], Hub]

_LOOK_AGAIN_S = 0.05


def beam_link(rig: Rig, guard: BeamGuard) -> Hub:
    """Open the suite's own protocol on a serial port, which may take ``serial.patience`` to appear."""
    port = Path(rig.serial.port)
    end = time.monotonic() + rig.serial.patience
    while not port.exists() and time.monotonic() < end and rclpy.ok():
        time.sleep(_LOOK_AGAIN_S)
    return DriverHub(rig.axis_parameters(), rig.link_parameters(), guard=guard)


AXIS_LINKS: dict[str, AxisLink] = {"beam": beam_link}
"""The suite's own kinds of axis link, by the value of ``axis.kind``."""


def open_axis(rig: Rig, guard: BeamGuard) -> Hub:
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
