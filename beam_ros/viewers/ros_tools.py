"""What RViz and ``ros2 bag`` read: displays of the beam, and qualities of service for recording."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from beam_ros.bags.metadata import to_yaml
from beam_ros.interfaces.graph import RIG_FRAME, TOPICS, Topic

_DISPLAYS: tuple[tuple[str, str, str, dict[str, Any]], ...] = (
    ("Marker", "beam", "beam/shape", {}),
    ("PointCloud2", "markers", "beam/markers", {"Style": "Spheres", "Size (m)": 0.008}),
    ("Image", "tracker", "tracker/debug_image", {"Normalize Range": False}),
)
"""Kind of display, its name, its topic, and what else it is set to."""


def rviz_configuration(_markers: Sequence[str], namespace: str = "") -> str:
    """Return a configuration of RViz as YAML: the beam from the front, and the tracker's picture.

    Parameters
    ----------
    _markers : sequence of str -- not needed: RViz shows all there are
    namespace : str -- of the rig; empty for none
    """
    displays: list[dict[str, Any]] = [
        {
            "Class": "rviz_default_plugins/Grid",
            "Name": "grid",
            "Enabled": True,
            "Plane": "XZ",
            "Cell Size": 0.05,
            "Plane Cell Count": 10,
            "Reference Frame": RIG_FRAME,
        }
    ]
    displays += [
        {
            "Class": f"rviz_default_plugins/{kind}",
            "Name": name,
            "Enabled": True,
            "Topic": {"Value": _full_name(topic, namespace), **_policies(TOPICS[topic])},
            **more,
        }
        for kind, name, topic, more in _DISPLAYS
    ]
    return to_yaml(
        {
            "Panels": [{"Class": "rviz_common/Displays", "Name": "Displays"}],
            "Visualization Manager": {
                "Class": "",
                "Displays": displays,
                "Enabled": True,
                "Global Options": {
                    "Background Color": "248; 250; 252",
                    "Fixed Frame": RIG_FRAME,
                    "Frame Rate": 30,
                },
                "Name": "root",
                "Tools": [
                    {"Class": f"rviz_default_plugins/{tool}"} for tool in ("MoveCamera", "FocusCamera")
                ],
                "Views": {
                    "Current": {
                        "Class": "rviz_default_plugins/Orbit",
                        "Distance": 0.6,
                        "Focal Point": {"X": 0.0, "Y": 0.0, "Z": 0.15},
                        "Name": "Current View",
                        "Pitch": 0.0,
                        "Yaw": 4.71239,
                    }
                },
            },
            "Window Geometry": {"Width": 1400, "Height": 900},
        }
    )


def qos_overrides(_markers: Sequence[str], namespace: str = "") -> str:
    """Return qualities of service for ```ros2 bag record``` and ``play --qos-profile-overrides-path``, as YAML.

    Parameters
    ----------
    _markers : sequence of str -- not needed
    namespace : str -- of the rig; empty for none

    Notes
    -----
    Left to itself, ``ros2 bag record`` asks for what publishers offer when it begins, and a topic whose publisher
    comes later is not kept for late subscribers. Drawings are left out: they are made only while somebody listens.
    """
    return to_yaml(
        {
            _full_name(topic.name, namespace): {
                "history": "keep_last",
                "depth": topic.qos.depth,
                "reliability": "reliable" if topic.qos.is_reliable else "best_effort",
                "durability": "transient_local" if topic.qos.is_latched else "volatile",
            }
            for topic in TOPICS.values()
            if not topic.is_derived
        }
    )


def _full_name(topic: str, namespace: str) -> str:
    if topic.startswith("/"):
        return topic
    return f"/{namespace}/{topic}" if namespace else f"/{topic}"


def _policies(topic: Topic) -> dict[str, Any]:
    return {
        "Depth": topic.qos.depth,
        "History Policy": "Keep Last",
        "Reliability Policy": "Reliable" if topic.qos.is_reliable else "Best Effort",
        "Durability Policy": "Transient Local" if topic.qos.is_latched else "Volatile",
    }
