"""What messages promise and do not hold."""

from __future__ import annotations

from beam_ros.errors import RigError


class MessageContentError(RigError, ValueError):
    """A message has the right type, but not the content that its topic promises."""
