"""Processes of the firmware's build for this machine."""

from tests.private_ros import executables, private_ros

__all__ = ["executables", "private_ros"]
