"""A bag back onto its topics: `ros2 launch beam_ros replay.launch.py bag:=my_bag start:=0.0 loop:=false`."""

from __future__ import annotations

from pathlib import Path

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from beam_ros.interfaces.graph import NODES
from launch import LaunchContext, LaunchDescription

NUMBERS = {"rate": ("1.0", "speed"), "start": ("0.0", "begin so many seconds after the first message")}
SWITCHES = {
    "loop": "begin anew at the end",
    "paused": "stand still at first",
    "clock": "the bag's time on /clock",
}


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments and start the player, which itself refuses to play beside a live hub."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("bag", description="folder of the bag"),
            DeclareLaunchArgument("namespace", default_value="", description="to play the rig's topics in"),
            *(
                DeclareLaunchArgument(name, default_value=default, description=meaning)
                for name, (default, meaning) in NUMBERS.items()
            ),
            *(
                DeclareLaunchArgument(
                    name, default_value="false", choices=["true", "false"], description=meaning
                )
                for name, meaning in SWITCHES.items()
            ),
            OpaqueFunction(function=_player),
        ]
    )


def _player(context: LaunchContext) -> list[Node]:
    def said(name: str) -> str:
        return str(LaunchConfiguration(name).perform(context))

    parameters: dict[str, object] = {"player.bag": str(Path(said("bag")).resolve())}
    parameters |= {f"player.{name}": float(said(name)) for name in NUMBERS}
    parameters |= {f"player.{name}": said(name) == "true" for name in SWITCHES}
    return [
        Node(
            package="beam_ros",
            executable="bag_player",
            name=NODES["bag_player"].name,
            namespace=said("namespace"),
            parameters=[parameters],
            output="screen",
        )
    ]
