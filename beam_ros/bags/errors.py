"""What can go wrong with a bag, as one small tree."""

from __future__ import annotations

from beam_ros.errors import RigError


class BagError(RigError, OSError):
    """Anything that the bags' room raises."""


class BagNotFoundError(BagError):
    """There is nothing at the path."""


class NotABagError(BagError):
    """What is at the path is no ROS 2 bag, or one of a kind that cannot be read."""


class BagTruncatedError(BagError):
    """A recording that was cut off, is still going on, or whose file is damaged."""


class BagExistsError(BagError):
    """A bag is to be written where something already is."""


class MissingTopicsError(BagError):
    """A bag lacks topics, or their content, that the work needs."""


class MessageDecodeError(BagError):
    """Bytes of a message that do not hold what their topic promises."""
