"""The suite's messages, built and read in one place for the wire and for bags.

A node speaks rclpy's message classes, a bag is written and read with those of ``rosbags``; both have the same
fields. The builders here take a ``MessageTypes``, which hides the three differences (where a class comes from,
how an array of numbers and a byte are held), and the readers take whatever has the fields. Neither rclpy nor
rosbags is imported before it is asked for.

Stamps are integer nanoseconds (UNIX, host); everything else is SI. Positions, velocities, accelerations and
forces are positive along +x of the frame ``rig``.
"""

from beam_ros.messages.batches import BATCH_FIELDS as BATCH_FIELDS
from beam_ros.messages.batches import batch_from_columns as batch_from_columns
from beam_ros.messages.batches import format_batch_frame as format_batch_frame
from beam_ros.messages.batches import parse_batch_frame as parse_batch_frame
from beam_ros.messages.batches import read_trajectory_batch as read_trajectory_batch
from beam_ros.messages.batches import trajectory_batch as trajectory_batch
from beam_ros.messages.camera import camera_info as camera_info
from beam_ros.messages.camera import compressed_image as compressed_image
from beam_ros.messages.camera import image as image
from beam_ros.messages.clocks import clock_sync as clock_sync
from beam_ros.messages.clocks import read_clock_sync as read_clock_sync
from beam_ros.messages.commands import StampedSetpoint as StampedSetpoint
from beam_ros.messages.commands import chunk_frame as chunk_frame
from beam_ros.messages.commands import chunk_from_columns as chunk_from_columns
from beam_ros.messages.commands import read_sequence_chunk as read_sequence_chunk
from beam_ros.messages.commands import read_setpoint as read_setpoint
from beam_ros.messages.commands import sequence_chunk as sequence_chunk
from beam_ros.messages.commands import setpoint as setpoint
from beam_ros.messages.commands import split_sequence as split_sequence
from beam_ros.messages.errors import MessageContentError as MessageContentError
from beam_ros.messages.health import LEVELS as LEVELS
from beam_ros.messages.health import Health as Health
from beam_ros.messages.health import diagnostics as diagnostics
from beam_ros.messages.health import read_diagnostics as read_diagnostics
from beam_ros.messages.joint_states import Displacement as Displacement
from beam_ros.messages.joint_states import HubSample as HubSample
from beam_ros.messages.joint_states import displacement as displacement
from beam_ros.messages.joint_states import displacement_messages as displacement_messages
from beam_ros.messages.joint_states import hub_state as hub_state
from beam_ros.messages.joint_states import read_displacement as read_displacement
from beam_ros.messages.joint_states import read_hub_state as read_hub_state
from beam_ros.messages.live_identification import LiveIdentification as LiveIdentification
from beam_ros.messages.markers import MARKER_DTYPE as MARKER_DTYPE
from beam_ros.messages.markers import MarkerCloud as MarkerCloud
from beam_ros.messages.markers import beam_shape as beam_shape
from beam_ros.messages.markers import marker_cloud as marker_cloud
from beam_ros.messages.markers import marker_cloud_from_columns as marker_cloud_from_columns
from beam_ros.messages.markers import read_marker_cloud as read_marker_cloud
from beam_ros.messages.message_types import BagTypes as BagTypes
from beam_ros.messages.message_types import MessageTypes as MessageTypes
from beam_ros.messages.message_types import RosTypes as RosTypes
from beam_ros.messages.stamps import SECOND_NS as SECOND_NS
from beam_ros.messages.stamps import header as header
from beam_ros.messages.stamps import stamp_ns as stamp_ns
from beam_ros.messages.stamps import time_ns as time_ns
from beam_ros.messages.texts import hub_mode as hub_mode
from beam_ros.messages.texts import json_text as json_text
from beam_ros.messages.texts import read_json as read_json
from beam_ros.messages.texts import sequence_state as sequence_state
from beam_ros.messages.trajectories import MODE_FIELDS as MODE_FIELDS
