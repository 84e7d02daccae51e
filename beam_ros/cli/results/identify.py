"""Identify a continuous-time model from recorded bags, or from files of columns.

Prints the natural frequencies and damping ratios, beside the theory of the rig where the bag describes it; writes a
self-contained report.html into the folder of --report, and model.json, poles.csv, figures/ and, where the bag has
images, film.mp4 beside it. Several bags are one fit. Of a CSV, MAT, NPZ, UFF or TDMS file, --input and --output name
columns; --input none says that nothing drives its outputs, which ring freely. Every flag is a parameter of the node
`identifier`, too, and a rig file may set it.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beam_ros.cli.options import add_rig_file, add_span, read_rig, read_span
from beam_ros.interfaces.parameter import Parameter, parameters_of
from beam_ros.interfaces.rig_parameters import IdentifierSettings
from beam_ros.process.progress import Progress
from beam_ros.process.remote_paths import AnyPath
from beam_ros.process.strict_json import strict_json
from beam_ros.rig.rig import Rig

if TYPE_CHECKING:
    from beam_ros.offline.identification import Looked
    from beam_ros.offline.loading.options import FitOptions

_GROUP = "identifier"
_SEVERAL = {"outputs": "--output", "validate": "--validate"}
"""Parameters whose parts are given one by one here, and their flags."""
_METAVARS = {
    "report": "DIR",
    "estimator": "NAME",
    "validate": "BAG",
    "input": "TOPIC:FIELD",
    "time": "COLUMN",
    "outputs": "TOPIC:FIELD",
    "signals": "FILE",
    "modes": "N",
    "max_modes": "N",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments: the parameters of the node."""
    parser.add_argument(
        "bag",
        nargs="+",
        metavar="BAG",
        help="folder of the bag, or a single .mcap or .db3 file, here or by its URL, or a file of columns; several "
        "are one fit",
    )
    add_span(parser)
    add_options(parser, parameters())
    add_rig_file(parser)
    parser.add_argument("--json", action="store_true", help="print the result as JSON")


def add_options(parser: argparse.ArgumentParser, names: Iterable[str]) -> None:
    """Declare parameters of the identifier as flags, by their names without the group."""
    rows = parameters()
    for name in names:
        row = rows[name]
        flag = _SEVERAL.get(name, f"--{name.replace('_', '-')}")
        more: dict[str, Any] = {"metavar": _METAVARS.get(name, name.upper())}
        if row.kind is bool:
            more = {"action": "store_true", "default": None}
        elif name in _SEVERAL:
            more["action"] = "append"
        elif row.kind in (int, float):
            more["type"] = row.kind
        elif row.choices:
            more = {"choices": row.choices}
        parser.add_argument(flag, dest=name, help=row.description.partition("; `beam")[0], **more)


def read_settings(arguments: argparse.Namespace) -> tuple[IdentifierSettings, Rig | None]:
    """Return what ``add_options`` and ``add_rig_file`` were given; no rig where only the identifier's are given.

    Raises
    ------
    ParameterFileError
        The rig file or a parameter is wrong.
    """
    given_rig = read_rig(arguments)
    of_the_rig = [text for text in arguments.parameters if not text.startswith(f"{_GROUP}.")]
    given = {name: getattr(arguments, name, None) for name in parameters()}
    given |= {name: _joined(given[name]) for name in _SEVERAL}
    changes = {f"{_GROUP}.{name}": value for name, value in given.items() if value is not None}
    return given_rig.with_values(changes).identifier, given_rig if arguments.rig_file or of_the_rig else None


def bags_of(arguments: argparse.Namespace) -> str:
    """Return the bags of a verb as the identifier's parameter has them."""
    return _joined(arguments.bag) or ""


def parameters() -> dict[str, Parameter]:
    """Return the parameters that are flags, by their names without the group."""
    rows = parameters_of(IdentifierSettings, _GROUP)
    return {name: row for row in rows if (name := row.name.partition(".")[2]) != "bag"}


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
    from beam_ident import AxisResult
    from beam_ros.bags.apparatus import Apparatus
    from beam_ros.checks.bag_check import BagCheck, check_bag
    from beam_ros.offline.free_decay import format_decay, identify_decay
    from beam_ros.offline.identification_summary import format_table
    from beam_ros.reporting.identification import format_files, identify_told
    from beam_ros.signals.file_columns import NO_INPUT

    settings, rig = read_settings(arguments)
    settings = replace(settings, bag=bags_of(arguments))
    if settings.input == NO_INPUT:
        decay = identify_decay(settings, *read_span(arguments))
        print(strict_json(decay, indent=2) if arguments.json else format_decay(decay))
        return 0
    checks: list[BagCheck] = []

    def check(path: AnyPath, options: FitOptions) -> Looked:
        stage.update(0.0, f"checking {path}")
        checks.append(check_bag(path, rig, options, start_s=start_s, end_s=end_s))
        # Said before the fit, which may fail for just these reasons.
        for gate in checks[-1].gates:
            if gate.verdict in ("failed", "doubtful"):
                said = f"{gate.verdict}: {gate.name}: {gate.figure}; {gate.remedy}"
                print(said, file=sys.stderr if arguments.json else sys.stdout, flush=True)
        return checks[-1].looked

    start_s, end_s = read_span(arguments)
    with Progress("identify", 1.0) as stage:
        result = identify_told(
            settings,
            rig,
            progress=lambda phrase, share: stage.update(share, phrase),
            checked=check,
            start_s=start_s,
            end_s=end_s,
        )
        stage.finish(f"{len(result['modes'])} modes from {', '.join(result['outputs'])}")
    result["checks"] = [own.to_dict() for own in checks]
    if arguments.json:
        print(strict_json(result, indent=2))
        return 0
    for table in result.get("orders", ()):
        print(f"{table}\n")
    sentence = Apparatus(result["apparatus"]).sentence
    if sentence:
        print(sentence)
    print(result["verdict"]["text"])
    print(format_table(result))
    for name, score in result["scores"].items():
        deflection = score.get("deflection_fit_percent")
        of_deflection = "" if deflection is None else f", of the deflection {deflection:.2f} %"
        print(f"{name}   FIT {score['fit_percent']:.3f} %{of_deflection}")
    if "linearity" in result:
        print(result["linearity"]["verdict"])
    if "amplitude" in result:
        print(result["amplitude"]["verdict"])
    if "best_linear" in result:
        print(result["best_linear"]["verdict"])
        for line in result["best_linear"]["warnings"]:
            print(f"note: {line}")
    if "axis" in result:
        print(AxisResult.from_dict(result["axis"]).summary())
        for name, value in result.get("rig_values", {}).items():
            print(f"-p {name}:={value if isinstance(value, str) else format(value, '.6g')}")
    if result.get("misfit"):
        print(f"lines  residuals {result['misfit']:.2f} times what their noise alone would leave")
    for unseen in result.get("validation", ()):
        for name, score in unseen["scores"].items():
            print(f"{name} on {unseen['bag']}: {score['verdict']}")
    for line in (*result["notes"], *result["warnings"]):
        print(f"note: {line}")
    if "model" in result:
        print(format_files(result))
    return 0


def _joined(parts: Sequence[str | Path] | None) -> str | None:
    return None if parts is None else ";".join(map(str, parts))
