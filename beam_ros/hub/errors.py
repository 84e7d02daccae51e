"""What can go wrong between the suite and the hub: a branch of the rig's own tree."""

from __future__ import annotations

from beam_ros.errors import RigError, RigUnavailableError
from beam_ros.hub.faults import Fault, fault


class HubError(RigError):
    """Anything that the hub's room raises."""


class HubParameterError(HubError, ValueError):
    """A parameter, or a combination of them, that no hub can have."""


class HubProtocolError(HubError, OSError):
    """Bytes or messages that do not follow the line protocol."""


class ConformanceError(HubProtocolError):
    """A device that does not do what the line protocol says."""


class HubConnectionError(HubError, RigUnavailableError):
    """A port that cannot be opened, or a device behind it that cannot be used.

    Parameters
    ----------
    message : str
        What, where, expected, remedy.
    cause : Fault
        The row of the table.
    """

    def __init__(self, message: str, cause: Fault = fault("port_unavailable")) -> None:  # noqa: B008 - a constant
        super().__init__(message)
        self.fault = cause


class PortDeniedError(HubConnectionError):
    """A port that is there and may not be used: somebody else has it, or the user has no right to it."""


class SnapshotError(HubError, ValueError):
    """An instant that the simulated hub has not reached yet or no longer remembers."""
