"""Turn a bag's signals into CSV files, or into a flat bag with one sample a message for plotting tools.

With --model, an identified model (model.json, or the folder of its report) becomes files of other tools, as many as
are named: MATLAB, universal files, FMU, Modelica, URDF, MuJoCo, Klipper, Marlin, RO-Crate. Nothing is written over.

With --viewers, no bag is needed: layouts of PlotJuggler, Foxglove and Lichtblick, a configuration of RViz, and the
qualities of service for `ros2 bag`, for the markers of the rig file.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from beam_ros.bags.reading import Bag
from beam_ros.cli.options import add_bag, add_rig_file, read_rig, read_span
from beam_ros.errors import UsageError
from beam_ros.model_files.formats import (
    FORMATS,
    MOTIONS,
    ModelFormat,
    WriteRequest,
    make_file,
    target_of,
    write_new,
)
from beam_ros.offline.export import export_csv, export_flat_bag
from beam_ros.process.checksums import checksum
from beam_ros.process.progress import Progress
from beam_ros.process.remote_paths import any_path
from beam_ros.viewers.layouts import write_layouts


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add_bag(parser, nargs="?")
    target = parser.add_mutually_exclusive_group()
    target.add_argument("--csv", type=Path, metavar="DIR", help="new folder for one CSV file a signal")
    target.add_argument("--flat-bag", type=Path, metavar="BAG", help="new bag with one sample a message")
    target.add_argument("--viewers", type=Path, metavar="DIR", help="new folder for the layouts of viewers")
    target.add_argument(
        "--model", type=Path, metavar="model.json", help="what `beam identify --report` found"
    )
    for own in FORMATS:
        parser.add_argument(
            f"--{own.flag}", type=Path, metavar=own.metavar, help=f"with --model: {own.meaning}"
        )
    parser.add_argument(
        "--driven-by",
        choices=MOTIONS,
        default="",
        help="with --model, of a moved base: the quantity that is the input; by default the acceleration",
    )
    parser.add_argument("--namespace", default="", metavar="NAME", help="of the rig, for --viewers")
    add_rig_file(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run the verb."""
    named = [own for own in FORMATS if _given(arguments, own) is not None]
    if (arguments.model is not None) != bool(named):
        flags = " ".join(f"--{own.flag}" for own in FORMATS)
        raise UsageError(f"--model goes with at least one of {flags}, and these with --model; give both")
    if arguments.model is not None:
        if arguments.bag is not None:
            raise UsageError("--model takes no bag; leave it out")
        return _export_model(arguments, named)
    if arguments.driven_by:
        raise UsageError("--driven-by goes with --model alone; leave it out")
    targets = (arguments.csv, arguments.flat_bag, arguments.viewers)
    if not any(targets):
        raise UsageError(
            "nothing says what to write; give --csv, --flat-bag, --viewers, or --model with a format"
        )
    if (arguments.bag is None) != (arguments.viewers is not None):
        raise UsageError("--viewers takes no bag, --csv and --flat-bag take one; give one or the other")
    if arguments.viewers is not None:
        names = read_rig(arguments).markers.names
        print("\n".join(map(str, write_layouts(arguments.viewers, names, arguments.namespace))))
        return 0
    start_s, end_s = read_span(arguments)
    with Bag(any_path(arguments.bag), start_s=start_s, end_s=end_s) as bag, Progress("export", 1.0) as stage:
        if arguments.csv is not None:
            files = export_csv(bag, arguments.csv, stage.update)
            stage.finish(f"{len(files)} files in {arguments.csv}")
            print("\n".join(str(path) for path in files))
        else:
            count = export_flat_bag(bag, arguments.flat_bag, stage.update)
            stage.finish(f"{count} messages in {arguments.flat_bag}")
            print(arguments.flat_bag)
    return 0


def _given(arguments: argparse.Namespace, own: ModelFormat) -> Path | None:
    given: Path | None = getattr(arguments, own.flag.replace("-", "_"))
    return given


def _export_model(arguments: argparse.Namespace, named: Sequence[ModelFormat]) -> int:
    """Write a model in the formats that are named; all targets are looked at before any is written."""
    from beam_ros.model_files.exported_model import checksummed_source, exported_model
    from beam_ros.reporting.comparison import stored_model_file, stored_models

    file = stored_model_file(arguments.model)
    source = checksummed_source(file, checksum(file)) if file.is_file() else str(file)
    model = exported_model(stored_models(file), source, arguments.driven_by)
    rig = read_rig(arguments)
    targets = [target_of(own, Path(_given(arguments, own) or "")) for own in named]
    for own, target in zip(named, targets, strict=True):
        write_new(target, make_file(own, WriteRequest(model, rig, target, file)))
    print("\n".join(map(str, targets)))
    return 0
