"""Run the simulated experiment straight into a bag, without ROS, as fast as the computer can.

PLAN.yaml is a ROS parameter file like the packaged rig.yaml; it needs only what differs, for instance the
`excitation` and `simulation` groups. Without it the packaged rig is simulated.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from beam_ros.cli.options import add_parameters
from beam_ros.process.progress import Progress
from beam_ros.rig.rig import Rig


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument("plan", nargs="?", type=Path, metavar="PLAN.yaml", help="rig and excitation")
    parser.add_argument("--bag", type=Path, required=True, metavar="OUT", help="folder of the new bag")
    parser.add_argument("--seed", type=int, help="seed of the noise (simulation.seed)")
    parser.add_argument(
        "--camera",
        action="store_true",
        help="render and track every frame, beam/markers too (needs OpenCV)",
    )
    add_parameters(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run the verb."""
    rig = Rig.from_file(arguments.plan).with_texts(arguments.parameters)
    if arguments.seed is not None:
        rig = rig.with_values({"simulation.seed": arguments.seed})
    from beam_ros.excitation.recipes import recipe_of_rig
    from beam_ros.offline.simulation import simulate

    length_s = recipe_of_rig(rig).total_s
    with Progress("simulate", length_s, "s") as stage:

        def show(done_s: float, total_s: float) -> None:
            stage.update(done_s * length_s / total_s)

        count = simulate(rig, arguments.bag, with_camera=arguments.camera, on_progress=show)
        stage.finish(f"{count} messages in {arguments.bag}")
    print(arguments.bag)
    return 0
