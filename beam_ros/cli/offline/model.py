"""Print the theory of a rig: natural frequencies, damping ratios, participation, and how best to measure them.

`--plot DIR` draws mode shapes, Bode plots and the pole map.
`--fit model.json` fits the rig's stiffness and damping (--free: also a tip mass or the clamp's compliance, with
--prior) to the modes that `beam identify --report` found, says what they can tell apart, and sets them beside the rig
file's theory and its budget.
`--parameters` lists every parameter of the rig file with its unit, range, default and meaning.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from beam_model.advice.summary import summarise
from beam_model.fitting.physical_fit import FREE
from beam_ros.cli.options import add_rig_file, read_rig
from beam_ros.errors import UsageError
from beam_ros.interfaces.rig_parameters import RIG_PARAMETERS
from beam_ros.process.folders import make_folder
from beam_ros.process.strict_json import strict_json
from beam_ros.reporting.physical_fit import fit_rig, read_priors
from beam_ros.rig.rig import Rig


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
    parser.add_argument(
        "--fit",
        type=Path,
        metavar="MODEL",
        help="fit the beam to a model.json, or to the folder that holds one",
    )
    parser.add_argument(
        "--free",
        action="append",
        default=[],
        choices=FREE,
        help="with --fit: a parameter to fit; may be given several times (default: stiffness, viscous, internal)",
    )
    parser.add_argument(
        "--prior",
        action="append",
        default=[],
        metavar="NAME=MEAN:SD",
        help="with --fit: what is known of a parameter without the experiment, as tip_mass=0.003:0.0005",
    )
    parser.add_argument("--json", action="store_true", help="print JSON")


def run(arguments: argparse.Namespace) -> int:
    """Run the verb."""
    if arguments.lists_parameters:
        print(_parameter_list())
        return 0
    rig = read_rig(arguments)
    if arguments.fit is not None:
        fitted = fit_rig(rig, arguments.fit, arguments.free, read_priors(arguments.prior))
        print(strict_json(fitted.to_dict(), indent=2) if arguments.json else fitted.to_text())
        return 0
    if arguments.free or arguments.prior:
        raise UsageError("--free and --prior go with --fit MODEL")
    model = rig.beam_model()
    theory = summarise(
        model, rig.markers.heights, rig.camera.rate, min(3, model.n_modes), rig.hub.max_tip_deflection
    )
    figures = [] if arguments.plot is None else _draw(rig, arguments.plot)
    if arguments.json:
        content = {
            **theory.to_dict(),
            "marker_names": list(rig.markers.names),
            "figures": list(map(str, figures)),
        }
        print(strict_json(content, indent=2))
        return 0
    beam = model.parameters
    print(f"EI {beam.flexural_rigidity:.6g} N m^2, rho {beam.mass_per_length:.6g} kg/m, {beam.gravity}\n")
    print(theory.to_text())
    for path in figures:
        print(path)
    return 0


def _draw(rig: Rig, folder: Path) -> list[Path]:
    from beam_model.advice import figures

    model, heights = rig.beam_model(), rig.markers.heights
    make_folder(folder)
    drawn = {
        "mode_shapes.png": figures.mode_shape_figure(model, heights),
        "bode_motion.png": figures.bode_figure(model, heights),
        "bode_force.png": figures.bode_figure(model, heights, drive="force"),
        "poles.png": figures.pole_figure(model),
    }
    for name, figure in drawn.items():
        figure.savefig(folder / name, dpi=150)
    return [folder / name for name in drawn]


def _parameter_list() -> str:
    lines = []
    for name, default in Rig.from_file().values.items():
        parameter = RIG_PARAMETERS[name]
        shown = '""' if default == "" else str(list(default) if isinstance(default, tuple) else default)
        lines.append(f"{name} = {shown}\n    {parameter.description}: {parameter.expectation()}")
    return "\n".join(lines)
