"""What can go wrong between the suite and the hub: a branch of the rig's own tree."""

from __future__ import annotations

from beam_ros.errors import RigError, RigUnavailableError


class HubError(RigError):
    """Anything that the hub's room raises."""


class HubParameterError(HubError, ValueError):
    """A parameter, or a combination of them, that no hub can have."""


class HubProtocolError(HubError, OSError):
    """Bytes or messages that do not follow the line protocol."""


class HubConnectionError(HubError, RigUnavailableError):
    """A port that cannot be opened, or a device behind it that cannot be used."""


class SnapshotError(HubError, ValueError):
    """An instant that the simulated hub has not reached yet or no longer remembers."""
