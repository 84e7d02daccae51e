"""The kinds of axis link in one table: how the node ``hub_driver`` comes to a hub from the rig.

A package of a laboratory's own adds a kind as an entry point of the group ``beam_ros.axis_links``: a callable
that takes the rig and the guard of its beam, and returns what implements
``beam_ros.hub.contract.Hub``. Its own settings stand in ``axis.options``, as ``rig.axis_options()`` gives them. What
every link needs of a host lies in ``beam_ros.hub.host``; ``beam_ros.hub.links`` adds states, plans and stop ramps
for a controller that has none.
"""

from __future__ import annotations

from collections.abc import Callable

from beam_ident.plug_ins import find_kind
from beam_ros.errors import ParameterFileError, RigUnavailableError
from beam_ros.hub.contract import Hub, HubCapabilities
from beam_ros.hub.gate.beam_guard import BeamGuard
from beam_ros.hub.line.driver import DriverHub
from beam_ros.hub.links.csv_board import CsvHub
from beam_ros.hub.links.dynamixel import DynamixelHub
from beam_ros.hub.links.odrive import OdriveHub
from beam_ros.rig.rig import Rig
from beam_ros.shell.trajectory_topics import TrajectoryLink

AxisLink = Callable[[Rig, BeamGuard], Hub]


def beam_link(rig: Rig, guard: BeamGuard) -> Hub:
    """Open the suite's own protocol on a port, which may take ``serial.patience`` to appear."""
    return DriverHub(rig.axis_parameters(), rig.link_parameters(), guard=guard)


def odrive_link(rig: Rig, guard: BeamGuard) -> Hub:
    """Drive an ODrive over its ASCII protocol."""
    return OdriveHub(rig.axis_parameters(), rig.link_parameters(), rig.odrive_parameters(), guard)


def dynamixel_link(rig: Rig, guard: BeamGuard) -> Hub:
    """Drive a Dynamixel servo over its Protocol 2.0."""
    return DynamixelHub(rig.axis_parameters(), rig.link_parameters(), rig.dynamixel_parameters(), guard)


def csv_link(rig: Rig, guard: BeamGuard) -> Hub:
    """Listen to a board that prints lines."""
    return CsvHub(rig.axis_parameters(), rig.link_parameters(), rig.csv_columns())


AXIS_LINKS: dict[str, AxisLink] = {
    "beam": beam_link,
    "trajectory_controller": TrajectoryLink,
    "odrive": odrive_link,
    "dynamixel": dynamixel_link,
    "csv": csv_link,
}
"""The suite's own kinds of axis link, by the value of ``axis.kind``."""


def open_axis(rig: Rig, guard: BeamGuard) -> Hub:
    """Make the hub behind the kind of link that ``axis.kind`` chooses.

    Raises
    ------
    ParameterFileError
        Neither the suite nor an installed package has the kind; the axis does not take the command mode, or keeps
        neither limits nor watchdog, and the rig file does not accept that.
    RigUnavailableError
        The link's package cannot be loaded, or the axis cannot be reached.
    """
    errors = ParameterFileError, RigUnavailableError
    hub = find_kind("axis.kind", rig.axis.kind, AXIS_LINKS, "beam_ros.axis_links", *errors)(rig, guard)
    objection = _objection(hub.capabilities, rig)
    if objection:
        hub.close()
        raise ParameterFileError(objection)
    return hub


def _objection(axis: HubCapabilities, rig: Rig) -> str:
    """Return why such an axis is not driven with this rig file; empty where it is, or takes no commands at all."""
    if not axis.modes:
        return ""
    if rig.hub.command_mode not in axis.modes:
        return (
            f"hub.command_mode is {rig.hub.command_mode} with axis.kind {axis.name}: expected one of "
            f"{', '.join(axis.modes)}; choose one of these"
        )
    if not (axis.keeps_limits or rig.axis.accept_no_device_limits):
        return (
            f"axis.kind {axis.name}: the controller does not keep travel, speed and acceleration by itself: expected "
            "axis.accept_no_device_limits: true of somebody who has set end switches and limits there; read "
            "docs/connect-your-axis.md first"
        )
    if not (axis.has_watchdog or rig.axis.accept_no_device_watchdog):
        return (
            f"axis.kind {axis.name}: the controller goes on when this host dies: expected "
            "axis.accept_no_device_watchdog: true of somebody who stands beside the emergency stop; read "
            "docs/connect-your-axis.md first"
        )
    return ""
