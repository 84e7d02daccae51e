"""Print the theory of a rig: natural frequencies, damping ratios, participation, and what the camera sees of it.

`--parameters` lists every parameter of the rig file with its unit, range, default and meaning.
"""

from __future__ import annotations

import argparse
import json
import math
from typing import Any

import numpy as np

from beam_ros import schema
from beam_ros.cli.options import add_rig_file, read_rig
from beam_ros.rig import Rig


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add_rig_file(parser)
    parser.add_argument(
        "--parameters",
        dest="lists_parameters",
        action="store_true",
        help="list the rig file's parameters and exit",
    )
    parser.add_argument("--json", action="store_true", help="print JSON")


def run(arguments: argparse.Namespace) -> int:
    """Run the verb."""
    if arguments.lists_parameters:
        print(_parameter_list())
        return 0
    theory = describe_theory(read_rig(arguments))
    print(json.dumps(theory, indent=2) if arguments.json else _text(theory))
    return 0


def describe_theory(rig: Rig) -> dict[str, Any]:
    """Collect the theory of a rig in plain numbers (Hz, ratios, metres)."""
    model = rig.beam_model()
    heights = list(rig.numbers("markers.heights"))
    rate = rig.number("camera.rate")
    hertz = 2.0 * math.pi
    frequencies = model.natural_frequencies / hertz
    shapes = model.shape(heights)
    largest = np.max(np.abs(model.shape(np.linspace(0.0, model.parameters.length, 301))), axis=0)
    return {
        "flexural_rigidity": model.parameters.flexural_rigidity,
        "mass_per_length": model.parameters.mass_per_length,
        "beam_mass": model.parameters.beam_mass,
        "clamped": [
            {
                "frequency_hz": float(f),
                "damping_ratio": float(zeta),
                "effective_mass_fraction": float(share),
                "seen_in_frames_at_hz": float(abs(f - rate * round(f / rate))),
                "relative_shape": {
                    name: float(shapes[j, k] / largest[k]) for j, name in enumerate(rig.marker_names)
                },
            }
            for k, (f, zeta, share) in enumerate(
                zip(frequencies, model.damping_ratios, model.effective_mass_fractions, strict=True)
            )
        ],
        "free_hub_frequencies_hz": (model.free_hub_natural_frequencies / hertz).tolist(),
        "camera_rate_hz": rate,
    }


def _text(theory: dict[str, Any]) -> str:
    names = list(theory["clamped"][0]["relative_shape"])
    lines = [
        f"EI {theory['flexural_rigidity']:.6g} N m^2, rho {theory['mass_per_length']:.6g} kg/m, "
        f"strip {theory['beam_mass'] * 1e3:.4g} g",
        "",
        "mode   clamped [Hz]   free hub [Hz]   zeta [%]   mass share   in frames [Hz]   shape at "
        + ", ".join(names),
    ]
    for k, (mode, free) in enumerate(
        zip(theory["clamped"], theory["free_hub_frequencies_hz"], strict=True), 1
    ):
        shape = "  ".join(f"{value:+.3f}" for value in mode["relative_shape"].values())
        alias = f"{mode['seen_in_frames_at_hz']:.3f}"
        if mode["frequency_hz"] > theory["camera_rate_hz"] / 2:
            alias += " alias"
        lines.append(
            f"{k:>4}   {mode['frequency_hz']:>12.4f}   {free:>13.4f}   {100 * mode['damping_ratio']:>8.4f}   "
            f"{100 * mode['effective_mass_fraction']:>8.2f} %   {alias:>14}   {shape}"
        )
    lines += [
        "",
        "A prescribed motion of the hub shows the clamped frequencies, a force on it the free hub's.",
        "Shapes are relative to each mode's largest; a marker near 0 hardly sees the mode.",
    ]
    return "\n".join(lines)


def _parameter_list() -> str:
    defaults = schema.packaged_defaults()
    lines = []
    for name, parameter in schema.RIG_PARAMETERS.items():
        default = defaults[name]
        shown = '""' if default == "" else str(default)
        lines.append(f"{name} = {shown}\n    {parameter.description}: {parameter.expectation()}")
    return "\n".join(lines)
