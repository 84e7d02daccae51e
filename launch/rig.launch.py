"""The nodes of a rig together: `ros2 launch beam_ros rig.launch.py rig:=simulated|emulated|real`."""

from __future__ import annotations

import tempfile
import uuid
from importlib import resources
from pathlib import Path

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from beam_ros.interfaces.graph import NODES, RigKind, emulated_port, nodes_of_rig
from beam_ros.rig.rig import Rig
from beam_ros.rig.time_keeping import check_time_of_rig, follows_clock
from launch import LaunchContext, LaunchDescription

PACKAGED_RIG = str(resources.files("beam_ros") / "config" / "rig.yaml")


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments `rig`, `params_file` and `namespace` and start what they name."""
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "rig",
                default_value=RigKind.SIMULATED.value,
                choices=[rig.value for rig in RigKind],
                description="what stands behind the node `hub` and the camera's topics",
            ),
            DeclareLaunchArgument(
                "params_file", default_value=PACKAGED_RIG, description="the rig's parameter file"
            ),
            DeclareLaunchArgument("namespace", default_value="", description="moves the whole rig"),
            OpaqueFunction(function=_nodes),
        ]
    )


def _nodes(context: LaunchContext) -> list[Node]:
    rig, params_file, namespace = (
        LaunchConfiguration(name).perform(context) for name in ("rig", "params_file", "namespace")
    )
    kind, values = RigKind(rig), Rig.from_file(Path(params_file))
    check_time_of_rig(kind, values)
    parameters: list[str | dict[str, object]] = [params_file]
    if kind is RigKind.EMULATED:
        # The emulator makes the link of this name, and takes it away when it ends.
        parameters.append(emulated_port(str(Path(tempfile.gettempdir()) / f"beam-rig-{uuid.uuid4().hex}")))
    has_images = kind is not RigKind.SIMULATED or values.simulation.images
    return [
        Node(
            package="beam_ros",
            executable=executable,
            name=NODES[executable].name,
            namespace=namespace,
            parameters=[*parameters, {"use_sim_time": follows_clock(executable, values)}],
            output="screen",
        )
        for executable in nodes_of_rig(kind, with_camera_images=has_images)
    ]
