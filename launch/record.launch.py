"""The recorder beside a running rig: `ros2 launch beam_ros record.launch.py bag:=my_bag images:=true`."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from beam_ros.interfaces.graph import NODES
from beam_ros.launching.guards import refuse_existing
from launch import LaunchContext, LaunchDescription

PACKAGED_RIG = str(resources.files("beam_ros") / "config" / "rig.yaml")


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments and start the recorder."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("bag", default_value="", description="folder; empty: runs/<date>"),
            DeclareLaunchArgument(
                "images", default_value="false", choices=["true", "false"], description="camera frames too"
            ),
            DeclareLaunchArgument(
                "params_file", default_value=PACKAGED_RIG, description="the rig's, which the bag then carries"
            ),
            DeclareLaunchArgument("namespace", default_value="", description="of the rig"),
            OpaqueFunction(function=_recorder),
        ]
    )


def _recorder(context: LaunchContext) -> list[Node]:
    bag, images, params_file, namespace = (
        LaunchConfiguration(name).perform(context) for name in ("bag", "images", "params_file", "namespace")
    )
    refuse_existing(Path(bag) if bag else None)
    given: dict[str, object] = {"recorder.images": images == "true"}
    if bag:
        given["recorder.path"] = str(Path(bag).resolve())
    return [
        Node(
            package="beam_ros",
            executable="bag_recorder",
            name=NODES["bag_recorder"].name,
            namespace=namespace,
            parameters=[params_file, given],
            output="screen",
        )
    ]
