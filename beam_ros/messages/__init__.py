"""The suite's messages, built and read in one place for the wire and for bags.

A node speaks rclpy's message classes, a bag is written and read with those of ``rosbags``; both have the same
fields. The builders here take a ``MessageTypes``, which hides the three differences (where a class comes from,
how an array of numbers and a byte are held), and the readers take whatever has the fields. Neither rclpy nor
rosbags is imported before it is asked for.

Stamps are integer nanoseconds (UNIX, host); everything else is SI. Positions, velocities, accelerations and
forces are positive along +x of the frame ``rig``.
"""

from __future__ import annotations

from beam_ros.messages.batches import (
    BATCH_FIELDS,
    batch_from_columns,
    format_batch_frame,
    parse_batch_frame,
    read_trajectory_batch,
    trajectory_batch,
)
from beam_ros.messages.camera import camera_info, image
from beam_ros.messages.clocks import clock_sync, read_clock_sync
from beam_ros.messages.commands import (
    StampedSetpoint,
    chunk_frame,
    chunk_from_columns,
    read_sequence_chunk,
    read_setpoint,
    sequence_chunk,
    setpoint,
    split_sequence,
)
from beam_ros.messages.errors import MessageContentError
from beam_ros.messages.health import LEVELS, Health, diagnostics, read_diagnostics
from beam_ros.messages.joint_states import (
    Displacement,
    HubSample,
    displacement,
    displacement_messages,
    hub_state,
    read_displacement,
    read_hub_state,
)
from beam_ros.messages.markers import (
    MARKER_DTYPE,
    MarkerCloud,
    beam_shape,
    marker_cloud,
    marker_cloud_from_columns,
    read_marker_cloud,
)
from beam_ros.messages.message_types import BagTypes, MessageTypes, RosTypes
from beam_ros.messages.stamps import SECOND_NS, header, stamp_ns, time_ns
from beam_ros.messages.texts import json_text, read_json, sequence_state
from beam_ros.messages.trajectories import MODE_FIELDS

__all__ = [
    "BATCH_FIELDS",
    "LEVELS",
    "MARKER_DTYPE",
    "MODE_FIELDS",
    "SECOND_NS",
    "BagTypes",
    "Displacement",
    "Health",
    "HubSample",
    "MarkerCloud",
    "MessageContentError",
    "MessageTypes",
    "RosTypes",
    "StampedSetpoint",
    "batch_from_columns",
    "beam_shape",
    "camera_info",
    "chunk_frame",
    "chunk_from_columns",
    "clock_sync",
    "diagnostics",
    "displacement",
    "displacement_messages",
    "format_batch_frame",
    "header",
    "hub_state",
    "image",
    "json_text",
    "marker_cloud",
    "marker_cloud_from_columns",
    "parse_batch_frame",
    "read_clock_sync",
    "read_diagnostics",
    "read_displacement",
    "read_hub_state",
    "read_json",
    "read_marker_cloud",
    "read_sequence_chunk",
    "read_setpoint",
    "read_trajectory_batch",
    "sequence_chunk",
    "sequence_state",
    "setpoint",
    "split_sequence",
    "stamp_ns",
    "time_ns",
    "trajectory_batch",
]
