"""Two tutorials start real processes."""

from tests.private_ros import executables, private_ros

__all__ = ["executables", "private_ros"]
