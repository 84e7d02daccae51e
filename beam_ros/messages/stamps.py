"""Stamps and headers: integer nanoseconds (UNIX, host) here, seconds and nanoseconds in messages."""

from __future__ import annotations

from typing import Any

from beam_ros.messages.message_types import MessageTypes

SECOND_NS = 1_000_000_000
TIME = "builtin_interfaces/msg/Time"
DURATION = "builtin_interfaces/msg/Duration"
_HEADER = "std_msgs/msg/Header"


def ros_time(types: MessageTypes, time_ns: int, type_name: str = TIME) -> Any:
    """Build a Time, or a Duration, from nanoseconds."""
    seconds, nanoseconds = divmod(int(time_ns), SECOND_NS)
    return types.make(type_name, sec=seconds, nanosec=nanoseconds)


def header(types: MessageTypes, stamp_ns: int, frame_id: str) -> Any:
    """Build a std_msgs/Header."""
    return types.make(_HEADER, stamp=ros_time(types, stamp_ns), frame_id=frame_id)


def time_ns(time: Any) -> int:
    """Return a Time or a Duration in nanoseconds."""
    return int(time.sec) * SECOND_NS + int(time.nanosec)


def stamp_ns(message: Any) -> int:
    """Return the header stamp of a message [ns, UNIX]."""
    return time_ns(message.header.stamp)
