"""Check the rig's excitation against the hub's limits and the beam's predicted motion, before anything moves.

With --optimal, find the excitation of the same length, in the same band and within the same limits that leaves the
smallest uncertainty, from the rig's theory or from an identified model, and say how much it gains over a chirp.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beam_ident.design.prediction import half_power_bands, resolution_warning
from beam_ident.design.summary import excitation_report
from beam_ros.cli.options import add_rig_file, read_rig
from beam_ros.errors import UsageError
from beam_ros.excitation.recipes import KINDS, describe_excitation
from beam_ros.process.progress import Progress
from beam_ros.process.strict_json import strict_json
from beam_ros.rig.rig import Rig

if TYPE_CHECKING:
    from beam_ident import ModalModel
    from beam_ros.excitation.optimal import RigDesign


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add_rig_file(parser)
    width = max(map(len, KINDS))
    parser.epilog = "kinds of excitation, and what each reads of excitation.*:\n" + "\n".join(
        f"  {name:<{width}}  {' '.join(kind.reads)}" for name, kind in KINDS.items()
    )
    parser.add_argument(
        "--optimal",
        nargs="?",
        const="D",
        metavar="D|A|c:NAME",
        help="find the best excitation: for all natural frequencies and damping ratios together (D, by default), "
        "their mean relative variance (A), or one parameter, as c:zeta_1",
    )
    parser.add_argument(
        "--from",
        dest="known",
        type=Path,
        metavar="model.json",
        help="with --optimal: what `beam identify --report` found, in place of the rig's theory",
    )
    parser.add_argument(
        "--save",
        type=Path,
        metavar="FILE",
        help="write the rig with this excitation: a PLAN.yaml or --rig-file",
    )
    for name, what in (("frequency", "natural frequencies"), ("damping", "damping ratios")):
        parser.add_argument(
            f"--{name}-sd",
            type=float,
            metavar="SHARE",
            help=f"with --optimal: how well the {what} are known before, relative",
        )
    parser.add_argument(
        "--noise",
        type=float,
        metavar="METRES",
        help="with --optimal: standard deviation of a displacement; by default what was identified, or "
        "simulation.displacement_noise",
    )
    parser.add_argument("--json", action="store_true", help="print JSON")


def run(arguments: argparse.Namespace) -> int:
    """Run the verb."""
    rig = read_rig(arguments)
    if arguments.save and arguments.save.exists():
        raise UsageError(f"{arguments.save} exists and is not written over; give another --save")
    found = _optimal(rig, arguments)
    design = describe_design(found.rig if found else rig)
    if arguments.save:
        _save(found.rig if found else rig, arguments.save)
    if arguments.json:
        print(strict_json(design | ({"optimal": found.to_dict()} if found else {}), indent=2))
        return 0
    if found:
        print(f"{found.design}\n\nfrom {found.source}; the excitation:\n")
    print(_text(design))
    return 0


def _optimal(rig: Rig, arguments: argparse.Namespace) -> RigDesign | None:
    if arguments.optimal is None:
        given = [
            name for name in ("known", "frequency_sd", "damping_sd", "noise") if getattr(arguments, name)
        ]
        if given:
            flag = "--from" if given[0] == "known" else f"--{given[0].replace('_', '-')}"
            raise UsageError(f"{flag} goes with --optimal alone; give --optimal, or leave it out")
        return None
    from beam_ros.excitation.optimal import design_for_rig

    known = None if arguments.known is None else _known_model(arguments.known)
    stage = Progress("design", 100.0, "%")
    found = design_for_rig(
        rig,
        arguments.optimal,
        known,
        frequency_sd=arguments.frequency_sd,
        damping_sd=arguments.damping_sd,
        noise=arguments.noise,
        progress=lambda phrase, share: stage.update(100.0 * share, phrase),
    )
    stage.finish(f"{found.design.criterion}-optimal excitation from {found.source}")
    return found


def _known_model(file: Path) -> ModalModel:
    from beam_ident import ModalModel
    from beam_ros.reporting.comparison import stored_models

    models = [model for model in stored_models(file) if isinstance(model, ModalModel)]
    if not models:
        raise UsageError(f"{file}: holds no modal model; expected one of `beam identify --estimator modal`")
    return models[0]


def _save(rig: Rig, file: Path) -> None:
    try:
        rig.write(file)
    except OSError as err:
        raise UsageError(f"{file}: cannot be written ({err.strerror}); give another --save") from err


def describe_design(rig: Rig) -> dict[str, Any]:
    """Plan the excitation and collect its figures beside the limits (SI).

    Raises
    ------
    UsageError
        The excitation leaves a limit; the message names it.
    """
    from beam_ros.excitation.plan import plan_excitation

    plan = plan_excitation(rig)
    sampled, model = plan.sampled, rig.beam_model()
    report = excitation_report(sampled)
    bands = half_power_bands(plan.recipe, model.natural_frequencies, model.damping_ratios)
    low, high = report.band_hz
    reached = [low <= band.frequency_hz <= high for band in bands]
    warning = resolution_warning(
        [band for band, is_reached in zip(bands, reached, strict=True) if is_reached]
    )
    peaks = sampled.peaks()
    return {
        "excitation": describe_excitation(plan.info(rig)),
        "recipe": plan.recipe.to_dict(),
        "mode": plan.mode,
        "samples": len(plan.values),
        "duration": sampled.duration_s,
        "peaks": {
            "travel": [peaks["travel"][0], rig.hub.travel / 2, "m"],
            "speed": [peaks["speed"][0], rig.hub.max_speed, "m/s"],
            "acceleration": [peaks["acceleration"][0], rig.hub.max_acceleration, "m/s^2"],
            "jerk": [peaks["jerk"][0], rig.excitation.max_jerk or None, "m/s^3"],
            "tip deflection": [plan.prediction.tip_deflection, rig.hub.max_tip_deflection, "m"],
            "root strain": [plan.prediction.root_strain, rig.beam.max_root_strain, ""],
            "hub force": [plan.prediction.hub_force, rig.hub.max_effort, "N"],
        },
        "crest_factor": report.levels[0].crest_factor,
        "levels": [dataclasses.asdict(level) for level in report.levels],
        "band_hz": [low, high],
        "modes": [
            {
                "frequency_hz": band.frequency_hz,
                "half_power_band_hz": band.width_hz,
                "lines_in_band": band.lines,
                "is_in_band": is_reached,
                "settling_s": 5.0 / (math.pi * band.width_hz),
                "tip_amplitude": float(amplitude),
            }
            for band, is_reached, amplitude in zip(
                bands, reached, plan.prediction.modal_tip_deflections, strict=True
            )
        ],
        "warnings": [warning] if warning else [],
    }


def _millimetres(length: float) -> str:
    """Return a length [m] in mm; below a micrometre its digits mean nothing."""
    return "< 0.001" if length < 1e-6 else f"{length * 1e3:.4g}"


def _text(design: dict[str, Any]) -> str:
    crests = ", ".join(f"{level['quantity']} {level['crest_factor']:.2f}" for level in design["levels"])
    low, high = design["band_hz"]
    lines = [
        design["excitation"],
        f"{design['samples']} samples over {design['duration']:.3f} s, commanded in {design['mode']}, from {low:.3g} "
        f"to {high:.3g} Hz",
        f"crest factors: {crests}",
        "",
        "quantity             peak       limit",
    ]
    for name, (peak, limit, unit) in design["peaks"].items():
        allowed = "none" if limit is None else f"{limit:.4g}"
        lines.append(f"{name:<16} {peak:>9.4g}   {allowed:>9} {unit}")
    lines += [
        "",
        "mode   frequency [Hz]   half-power band [Hz]   lines in it   settling [s]   predicted tip [mm]",
    ]
    for k, mode in enumerate(design["modes"], 1):
        seen = f"{mode['lines_in_band']:.2g}" if mode["is_in_band"] else "not driven"
        lines.append(
            f"{k:>4}   {mode['frequency_hz']:>14.4f}   {mode['half_power_band_hz']:>20.4f}   {seen:>11}   "
            f"{mode['settling_s']:>12.1f}   {_millimetres(mode['tip_amplitude']):>18}"
        )
    if design["warnings"]:
        lines += ["", *design["warnings"]]
    return "\n".join(lines)
