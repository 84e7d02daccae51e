"""Identify a continuous-time model from a recorded bag.

Prints the natural frequencies and damping ratios beside the theory of the rig that the bag describes; writes
model.json into the folder of --report and, with the estimator modal, a self-contained report.html.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from beam_ros.cli.options import add_bag, add_rig_file, read_rig, read_span
from beam_ros.process.progress import Progress
from beam_ros.process.remote_paths import any_path
from beam_ros.process.strict_json import strict_json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add_bag(parser)
    parser.add_argument("--validate", type=Path, metavar="BAG", help="another bag to score the model on")
    parser.add_argument("--report", type=Path, metavar="DIR", help="folder for model.json and report.html")
    parser.add_argument(
        "--estimator",
        default="modal",
        metavar="NAME",
        help="how to estimate (default: modal); they are listed below",
    )
    parser.add_argument("--modes", type=int, help="number of modes (default: from the data)")
    parser.add_argument(
        "--structure",
        choices=["auto", "base_motion", "acceleration", "velocity", "force"],
        default="auto",
        help="which model goes with which input (default: by the hub's command mode)",
    )
    add_rig_file(parser)
    parser.add_argument("--json", action="store_true", help="print the result as JSON")


def epilog() -> str:
    """Return the list of estimators, those of other packages included."""
    from beam_ident import estimator_meanings

    meanings = estimator_meanings()
    width = max(map(len, meanings))
    return "\n".join(
        ("estimators:", *(f"  {name:<{width}}  {meaning}" for name, meaning in meanings.items()))
    )


def run(arguments: argparse.Namespace) -> int:
    """Run the verb."""
    from beam_ros.offline.identification import format_files, format_table, identify_bag

    rig = read_rig(arguments) if arguments.rig_file or arguments.parameters else None
    start_s, end_s = read_span(arguments)
    with Progress("identify", 1.0) as stage:
        result = identify_bag(
            any_path(arguments.bag),
            estimator=arguments.estimator,
            rig=rig,
            structure=arguments.structure,
            n_modes=arguments.modes,
            folder=arguments.report,
            start_s=start_s,
            end_s=end_s,
            validation=arguments.validate,
            progress=lambda phrase, share: stage.update(share, phrase),
        )
        stage.finish(f"{len(result['modes'])} modes from {', '.join(result['outputs'])}")
    if arguments.json:
        print(strict_json(result, indent=2))
        return 0
    print(format_table(result))
    for name, score in result["scores"].items():
        deflection = score.get("deflection_fit_percent")
        of_deflection = "" if deflection is None else f", of the deflection {deflection:.2f} %"
        print(f"{name}   FIT {score['fit_percent']:.3f} %{of_deflection}")
    if result.get("misfit"):
        print(f"lines  residuals {result['misfit']:.2f} times what their noise alone would leave")
    for name, score in result.get("validation", {}).get("scores", {}).items():
        print(f"{name} on {arguments.validate}: {score['verdict']}")
    for line in (*result["notes"], *result["warnings"]):
        print(f"note: {line}")
    if arguments.report is not None:
        print(format_files(result))
    return 0
