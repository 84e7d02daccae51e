"""The moving hub: what it is to the rest of the suite, its simulation, and the line to a real one."""

from beam_ros.hub.axis import Snapshots, VirtualAxis
from beam_ros.hub.beam_points import BeamPoints
from beam_ros.hub.contract import (
    ClockSync,
    HostTime,
    Hub,
    HubEvent,
    HubReport,
    HubStatus,
    Outcome,
    SampleBatch,
    SequenceChunk,
    SequenceReport,
)
from beam_ros.hub.parameters import HubParameters
from beam_ros.hub.plant import BeamPlant, Plant, RigidPlant
from beam_ros.hub.sequences import format_chunk_name, parse_chunk_name
from beam_ros.hub.simulated_hub import SimulatedHub

__all__ = [
    "BeamPlant",
    "BeamPoints",
    "ClockSync",
    "HostTime",
    "Hub",
    "HubEvent",
    "HubParameters",
    "HubReport",
    "HubStatus",
    "Outcome",
    "Plant",
    "RigidPlant",
    "SampleBatch",
    "SequenceChunk",
    "SequenceReport",
    "SimulatedHub",
    "Snapshots",
    "VirtualAxis",
    "format_chunk_name",
    "parse_chunk_name",
]
