"""Call a service of the running rig, as `ros2 service call` does in a ROS 2 workspace.

`beam call hub/home`, `beam call hub/enable true`, `beam call excitation/start`, `beam call recorder/stop`.
"""

from __future__ import annotations

import argparse

from beam_ros.cli.options import one_of
from beam_ros.errors import UsageError
from beam_ros.interfaces.graph import SERVICES, SET_BOOL
from beam_ros.process.executables import INTERRUPTED
from beam_ros.process.interruption import end_with, signals_taken


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    width = max(map(len, SERVICES))
    rows = (f"  {name:<{width}}  {row.meaning}" for name, row in SERVICES.items())
    parser.epilog = "services:\n" + "\n".join(rows)
    parser.add_argument(
        "service", metavar="SERVICE", type=one_of("service", SERVICES), help="which service (listed below)"
    )
    parser.add_argument("value", nargs="?", choices=["true", "false"], help="for hub/enable")
    parser.add_argument("--namespace", default="", help="ROS namespace of the rig")
    parser.add_argument("--timeout", type=float, default=60.0, help="patience in seconds (default: 60)")


def run(arguments: argparse.Namespace) -> int:
    """Run the verb."""
    takes_value = SERVICES[arguments.service].type_name == SET_BOOL
    if takes_value != (arguments.value is not None):
        expected = "true or false" if takes_value else "no value"
        raise UsageError(
            f"{arguments.service}: expected {expected} after it; `beam call --help` lists the services"
        )
    with signals_taken(end_with(INTERRUPTED)):
        from beam_ros.launching.client import RigClient

    value = arguments.value == "true" if takes_value else None
    with RigClient(namespace=arguments.namespace) as client:
        print(client.call(arguments.service, value=value, timeout_s=arguments.timeout))
    return 0
