"""What a bag says of itself, in the form of ROS 2 Jazzy's own recorder (metadata version 9)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from io import StringIO
from pathlib import Path, PurePath
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from beam_ros.interfaces.graph import QualityOfService
from beam_ros.process.remote_paths import AnyPath

METADATA_NAME = "metadata.yaml"
PROVENANCE_NOTE = "beam_ros/provenance"
"""Metadata record in every file that says how the bag came about: text by name."""

EMPTY_START_NS = 2**63 - 1
"""Starting time of a bag without messages, as rosbag2 writes it."""

_INFINITE = {"sec": 9223372036, "nsec": 854775807}


@dataclass(frozen=True)
class TopicRecord:
    """A topic of a bag: full name, type, its hash, the qualities of service offered, number of messages."""

    name: str
    type_name: str
    type_hash: str
    qos: tuple[QualityOfService, ...]
    message_count: int = 0


@dataclass(frozen=True)
class FileRecord:
    """A file of a bag: name, first receive time and time from there to the last [ns], number of messages."""

    name: str
    start_ns: int
    duration_ns: int
    message_count: int


def qos_profiles(qos: tuple[QualityOfService, ...]) -> list[dict[str, Any]]:
    """Return qualities of service as a bag's metadata holds them."""
    return [
        {
            # Discovery names no depth: rosbag2 writes what that means, and warns of 0 messages kept.
            "history": "keep_last" if item.depth else "unknown",
            "depth": item.depth,
            "reliability": "reliable" if item.is_reliable else "best_effort",
            "durability": "transient_local" if item.is_latched else "volatile",
            "deadline": dict(_INFINITE),
            "lifespan": dict(_INFINITE),
            "liveliness": "automatic",
            "liveliness_lease_duration": dict(_INFINITE),
            "avoid_ros_namespace_conventions": False,
        }
        for item in qos
    ]


def parse_qos_profiles(profiles: Any) -> tuple[QualityOfService, ...] | None:
    """Return qualities of service from a recording, as YAML or its text; None where they cannot be understood."""
    return _qos_of_text(profiles) if isinstance(profiles, str) else _qos_of(profiles)


@lru_cache(maxsize=256)
def _qos_of_text(text: str) -> tuple[QualityOfService, ...] | None:
    """Return what one text says, which most topics of a bag have in common, and every reading of it again."""
    try:
        return _qos_of(YAML(typ="safe").load(text))
    except YAMLError:
        return None


@lru_cache(maxsize=4)
def _file_names_of(text: str) -> tuple[str, ...]:
    """Return the storage files that one text names: a bag is opened several times in a run."""
    names = YAML(typ="safe").load(text)["rosbag2_bagfile_information"]["relative_file_paths"]
    return tuple(PurePath(str(name)).name for name in names)


def _qos_of(profiles: Any) -> tuple[QualityOfService, ...] | None:
    try:
        # Names since metadata version 9, rmw's numbers before.
        qos = tuple(
            QualityOfService(
                depth=int(item["depth"]),
                is_reliable=item["reliability"] not in ("best_effort", 2),
                is_latched=item["durability"] in ("transient_local", 1),
            )
            for item in profiles
        )
    except (TypeError, KeyError, ValueError):
        return None
    return qos or None


def read_topics(path: Path) -> tuple[TopicRecord, ...]:
    """Return the topics that a bag's ``metadata.yaml`` names, in its order; none where it cannot be read."""
    try:
        content = YAML(typ="safe").load(path.read_text(encoding="utf-8"))
        return tuple(
            TopicRecord(
                str(row["topic_metadata"]["name"]),
                str(row["topic_metadata"]["type"]),
                str(row["topic_metadata"].get("type_description_hash", "")),
                parse_qos_profiles(row["topic_metadata"].get("offered_qos_profiles")) or (),
                int(row["message_count"]),
            )
            for row in content["rosbag2_bagfile_information"]["topics_with_message_count"]
        )
    except (OSError, UnicodeDecodeError, YAMLError, TypeError, KeyError, ValueError):
        return ()


def read_file_names(path: AnyPath) -> tuple[str, ...]:
    """Return the storage files that a bag's ``metadata.yaml`` names, in its order; none where it cannot be read."""
    try:
        return _file_names_of(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, YAMLError, TypeError, KeyError, ValueError):
        return ()


def bag_information(
    files: Sequence[FileRecord], topics: list[TopicRecord], custom_data: Mapping[str, str]
) -> dict[str, Any]:
    """Return the content of ``rosbag2_bagfile_information``, in the order of rosbag2's own files."""
    count = sum(topic.message_count for topic in topics)
    filled = [file for file in files if file.message_count]
    start_ns = min((file.start_ns for file in filled), default=EMPTY_START_NS)
    duration_ns = max((file.start_ns + file.duration_ns - start_ns for file in filled), default=0)
    return {
        "version": 9,
        "storage_identifier": "mcap",
        "duration": {"nanoseconds": duration_ns},
        "starting_time": {"nanoseconds_since_epoch": start_ns},
        "message_count": count,
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": topic.name,
                    "type": topic.type_name,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": qos_profiles(topic.qos),
                    "type_description_hash": topic.type_hash,
                },
                "message_count": topic.message_count,
            }
            for topic in topics
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file.name for file in files],
        "files": [
            {
                "path": file.name,
                "starting_time": {"nanoseconds_since_epoch": file.start_ns},
                "duration": {"nanoseconds": file.duration_ns},
                "message_count": file.message_count,
            }
            for file in files
        ],
        "custom_data": dict(custom_data) or None,
        "ros_distro": "jazzy",
    }


def to_yaml(content: Any) -> str:
    """Return YAML text in block style, as rosbag2 writes it."""
    yaml = YAML()
    yaml.default_flow_style = False
    yaml.width = 4096
    stream = StringIO()
    yaml.dump(content, stream)
    return stream.getvalue()
