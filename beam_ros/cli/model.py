"""Print the theory of a rig: natural frequencies, damping ratios, participation, and how best to measure them.

`--plot DIR` draws mode shapes, Bode plots and the pole map.
`--parameters` lists every parameter of the rig file with its unit, range, default and meaning.
"""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path
from typing import Any

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
    parser.add_argument(
        "--plot", type=Path, metavar="DIR", help="draw mode shapes, Bode plots and poles into DIR"
    )
    parser.add_argument("--json", action="store_true", help="print JSON")


def run(arguments: argparse.Namespace) -> int:
    """Run the verb."""
    if arguments.lists_parameters:
        print(_parameter_list())
        return 0
    rig = read_rig(arguments)
    theory = describe_theory(rig)
    if arguments.plot is not None:
        theory["figures"] = [str(path) for path in _draw(rig, arguments.plot)]
    print(json.dumps(theory, indent=2) if arguments.json else _text(theory))
    return 0


def describe_theory(rig: Rig) -> dict[str, Any]:
    """Collect the theory of a rig in plain numbers (Hz, ratios, metres)."""
    from beam_model.experiment_advice import advise, aliases, relative_amplitudes

    model = rig.beam_model()
    heights = rig.numbers("markers.heights")
    rate = rig.number("camera.rate")
    frequencies = model.natural_frequencies / (2.0 * math.pi)
    seen = relative_amplitudes(model, heights)
    advice = advise(model, min(3, model.n_modes))
    rows = zip(
        frequencies,
        model.damping_ratios,
        model.effective_mass_fractions,
        aliases(frequencies, rate),
        strict=True,
    )
    return {
        "flexural_rigidity": model.parameters.flexural_rigidity,
        "mass_per_length": model.parameters.mass_per_length,
        "beam_mass": model.parameters.beam_mass,
        "clamped": [
            {
                "frequency_hz": float(f),
                "damping_ratio": float(zeta),
                "effective_mass_fraction": float(share),
                "seen_in_frames_at_hz": float(alias),
                "relative_amplitude": {name: float(seen[j, k]) for j, name in enumerate(rig.marker_names)},
            }
            for k, (f, zeta, share, alias) in enumerate(rows)
        ],
        "free_hub_frequencies_hz": (model.free_hub_natural_frequencies / (2.0 * math.pi)).tolist(),
        "camera_rate_hz": rate,
        "advice": {
            "modes": advice.n_modes,
            "marker_heights": advice.marker_heights.tolist(),
            "frame_rate_hz": advice.frame_rate,
            "excitation_band_hz": list(advice.excitation_band),
            "settling_time": advice.settling_time,
        },
    }


def _draw(rig: Rig, folder: Path) -> list[Path]:
    from beam_model import figures

    model, heights = rig.beam_model(), rig.numbers("markers.heights")
    folder.mkdir(parents=True, exist_ok=True)
    drawn = {
        "mode_shapes.png": figures.mode_shape_figure(model, heights),
        "bode_motion.png": figures.bode_figure(model, heights),
        "bode_force.png": figures.bode_figure(model, heights, drive="force"),
        "poles.png": figures.pole_figure(model),
    }
    for name, figure in drawn.items():
        figure.savefig(folder / name, dpi=150)
    return [folder / name for name in drawn]


def _text(theory: dict[str, Any]) -> str:
    names = list(theory["clamped"][0]["relative_amplitude"])
    lines = [
        f"EI {theory['flexural_rigidity']:.6g} N m^2, rho {theory['mass_per_length']:.6g} kg/m, "
        f"strip {theory['beam_mass'] * 1e3:.4g} g",
        "",
        "mode   clamped [Hz]   free hub [Hz]   zeta [%]   mass share   in frames [Hz]   seen at "
        + ", ".join(names),
    ]
    for k, (mode, free) in enumerate(
        zip(theory["clamped"], theory["free_hub_frequencies_hz"], strict=True), 1
    ):
        shape = "  ".join(f"{value:.3f}" for value in mode["relative_amplitude"].values())
        alias = f"{mode['seen_in_frames_at_hz']:.3f}"
        if mode["frequency_hz"] > theory["camera_rate_hz"] / 2:
            alias += " alias"
        lines.append(
            f"{k:>4}   {mode['frequency_hz']:>12.4f}   {free:>13.4f}   {100 * mode['damping_ratio']:>8.4f}   "
            f"{100 * mode['effective_mass_fraction']:>8.2f} %   {alias:>14}   {shape}"
        )
    advice = theory["advice"]
    heights = ", ".join(f"{height * 1e3:.0f}" for height in advice["marker_heights"])
    low, high = advice["excitation_band_hz"]
    lines += [
        "",
        "A prescribed motion of the hub shows the clamped frequencies, a force on it the free hub's.",
        "`seen` is the amplitude over the mode's largest: a marker near 0 hardly sees the mode.",
        f"For {advice['modes']} modes: markers near the clamp and at {heights} mm, excitation from {low:.2g} to "
        f"{high:.0f} Hz, frames at {advice['frame_rate_hz']:.0f} Hz (fewer with exact stamps), "
        f"{advice['settling_time']:.0f} s to settle.",
        *theory.get("figures", []),
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
