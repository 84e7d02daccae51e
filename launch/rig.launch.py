"""The nodes of a rig together: `ros2 launch beam_ros rig.launch.py rig:=simulated|emulated|real record:=true`."""

from __future__ import annotations

import tempfile
import uuid
from importlib import resources
from pathlib import Path

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from beam_ros.interfaces.graph import NODES, RigKind, emulated_port, nodes_of_rig
from beam_ros.launching.guards import refuse_live_hub, refuse_what_cannot_run
from beam_ros.rig.rig import Rig
from beam_ros.rig.time_keeping import follows_clock
from launch import LaunchContext, LaunchDescription

PACKAGED_RIG = str(resources.files("beam_ros") / "config" / "rig.yaml")


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments, refuse what `beam up` refuses, and start what they name."""
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
            DeclareLaunchArgument(
                "record", default_value="false", choices=["true", "false"], description="also record a bag"
            ),
            DeclareLaunchArgument("bag", default_value="", description="its folder; empty: runs/<date>"),
            OpaqueFunction(function=_look_round),
            OpaqueFunction(function=_nodes),
        ]
    )


def _look_round(context: LaunchContext) -> list[Node]:
    refuse_live_hub(LaunchConfiguration("namespace").perform(context))
    return []


def _nodes(context: LaunchContext) -> list[Node]:
    rig, params_file, namespace, record, bag = (
        LaunchConfiguration(name).perform(context)
        for name in ("rig", "params_file", "namespace", "record", "bag")
    )
    kind, values = RigKind(rig), Rig.from_file(Path(params_file))
    refuse_what_cannot_run(kind, values, Path(bag) if bag else None)
    parameters: list[str | dict[str, object]] = [params_file]
    if kind is RigKind.EMULATED:
        # The emulator makes the link of this name, and takes it away when it ends.
        parameters.append(emulated_port(str(Path(tempfile.gettempdir()) / f"beam-rig-{uuid.uuid4().hex}")))
    has_images = kind is not RigKind.SIMULATED or values.simulation.images
    executables = list(nodes_of_rig(kind, with_camera_images=has_images))
    if record == "true":
        executables.append("bag_recorder")
        if bag:
            parameters.append({"recorder.path": str(Path(bag).resolve())})
    return [
        Node(
            package="beam_ros",
            executable=executable,
            name=NODES[executable].name,
            namespace=namespace,
            parameters=[*parameters, {"use_sim_time": follows_clock(executable, values)}],
            output="screen",
        )
        for executable in executables
    ]
