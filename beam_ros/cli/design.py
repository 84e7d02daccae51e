"""Check the rig's excitation against the hub's limits and the beam's predicted motion, before anything moves."""

from __future__ import annotations

import argparse
import json
import math
from typing import Any

import numpy as np

from beam_ros.cli.options import add_rig_file, read_rig
from beam_ros.rig import Rig


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add_rig_file(parser)
    parser.add_argument("--json", action="store_true", help="print JSON")


def run(arguments: argparse.Namespace) -> int:
    """Run the verb."""
    rig = read_rig(arguments)
    design = describe_design(rig)
    print(json.dumps(design, indent=2) if arguments.json else _text(design))
    return 0


def describe_design(rig: Rig) -> dict[str, Any]:
    """Plan the excitation and collect its figures beside the limits (SI).

    Raises
    ------
    UsageError
        The excitation leaves a limit; the message names it.
    """
    from beam_ros.excitation_plan import plan_excitation

    plan = plan_excitation(rig)
    sampled, model = plan.sampled, rig.beam_model()
    accelerations = sampled.accelerations
    moving = accelerations[: np.flatnonzero(accelerations)[-1] + 1]
    frequencies = model.natural_frequencies / (2.0 * math.pi)
    return {
        "recipe": plan.recipe.to_dict(),
        "mode": plan.mode,
        "samples": len(plan.values),
        "duration": sampled.duration_s,
        "peaks": {
            "travel": [float(np.max(np.abs(sampled.positions))), rig.number("hub.travel") / 2, "m"],
            "speed": [float(np.max(np.abs(sampled.velocities))), rig.number("hub.max_speed"), "m/s"],
            "acceleration": [
                float(np.max(np.abs(accelerations))),
                rig.number("hub.max_acceleration"),
                "m/s^2",
            ],
            "tip deflection": [plan.prediction.tip_deflection, rig.number("hub.max_tip_deflection"), "m"],
            "root strain": [plan.prediction.root_strain, rig.number("beam.max_root_strain"), ""],
            "hub force": [plan.prediction.hub_force, rig.number("hub.max_effort"), "N"],
        },
        "crest_factor": float(np.max(np.abs(moving)) / np.sqrt(np.mean(moving**2))),
        "modes": [
            {
                "frequency_hz": float(f),
                "half_power_band_hz": float(2.0 * zeta * f),
                "settling_s": float(5.0 / (2.0 * math.pi * zeta * f)),
                "tip_amplitude": float(amplitude),
            }
            for f, zeta, amplitude in zip(
                frequencies, model.damping_ratios, plan.prediction.modal_tip_deflections, strict=True
            )
        ],
    }


def _text(design: dict[str, Any]) -> str:
    recipe = ", ".join(f"{key} {value}" for key, value in design["recipe"].items() if key != "schema")
    lines = [
        recipe,
        f"{design['samples']} samples over {design['duration']:.3f} s, commanded in {design['mode']}, "
        f"crest factor {design['crest_factor']:.2f}",
        "",
        "quantity             peak       limit",
    ]
    for name, (peak, limit, unit) in design["peaks"].items():
        lines.append(f"{name:<16} {peak:>9.4g}   {limit:>9.4g} {unit}")
    lines += ["", "mode   frequency [Hz]   half-power band [Hz]   settling [s]   predicted tip [mm]"]
    for k, mode in enumerate(design["modes"], 1):
        lines.append(
            f"{k:>4}   {mode['frequency_hz']:>14.4f}   {mode['half_power_band_hz']:>20.4f}   "
            f"{mode['settling_s']:>12.1f}   {mode['tip_amplitude'] * 1e3:>18.4g}"
        )
    return "\n".join(lines)
