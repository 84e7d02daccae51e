"""Options that several verbs share."""

from __future__ import annotations

import argparse
import math
import os
from collections.abc import Callable, Collection
from datetime import datetime
from pathlib import Path

from beam_ros.errors import UsageError, suggestion
from beam_ros.rig.rig import Rig


def add_rig_file(parser: argparse.ArgumentParser) -> None:
    """Add the rig file and single parameters on top of it."""
    parser.add_argument(
        "--rig-file",
        type=Path,
        metavar="FILE",
        help="ROS parameter file of the rig; what it leaves out comes from the packaged one",
    )
    add_parameters(parser)


def add_bag(parser: argparse.ArgumentParser, nargs: str | None = None) -> None:
    """Add the bag that is read, and which part of it."""
    parser.add_argument(
        "bag",
        nargs=nargs,
        metavar="BAG",
        help="folder of the bag, or a single .mcap or .db3 file; here, or by its URL (s3://...)",
    )
    add_span(parser)


def add_span(parser: argparse.ArgumentParser) -> None:
    """Add the two times between which a bag is read."""
    for option, what in (("from", "from this time on"), ("to", "before this time")):
        parser.add_argument(
            f"--{option}",
            dest=f"{option}_s",
            type=float,
            metavar="SECONDS",
            help=f"read only what was recorded {what}, counted from the bag's first message",
        )


def read_span(arguments: argparse.Namespace) -> tuple[float | None, float | None]:
    """Return what ``add_span``'s options say: beginning and end [s], as ``Bag`` takes them.

    Raises
    ------
    UsageError
        Nothing lies between the two times.
    """
    start_s, end_s = arguments.from_s, arguments.to_s
    if not 0.0 <= (start_s or 0.0) < (math.inf if end_s is None else end_s):
        raise UsageError(
            f"--from {start_s} --to {end_s}: expected 0 <= from < to, in seconds after the bag's first message"
        )
    return start_s, end_s


def add_parameters(parser: argparse.ArgumentParser) -> None:
    """Add single parameters on top of a rig or plan file."""
    parser.add_argument(
        "-p",
        dest="parameters",
        metavar="NAME:=VALUE",
        action="append",
        default=[],
        help="one parameter on top of the file, as for a node: -p camera.rate:=50.0",
    )


def one_of(what: str, known: Collection[str]) -> Callable[[str], str]:
    """Return the reader of an argument that names one of the known, and suggests the likeliest where it does not."""

    def read(name: str) -> str:
        if name not in known:
            raise argparse.ArgumentTypeError(f"unknown {what} {name!r} ({suggestion(name, known)})")
        return name

    return read


def read_rig(arguments: argparse.Namespace) -> Rig:
    """Read the rig that ``add_rig_file``'s options describe.

    Raises
    ------
    ParameterFileError
        The file or a parameter is wrong.
    """
    rig = Rig.from_file(arguments.rig_file)
    return rig.with_texts(arguments.parameters)


def run_folder(given: Path | None, name: str) -> Path:
    """Choose the folder for a run's results; it is created when there is something to write.

    Raises
    ------
    UsageError
        The folder exists and is not empty.
    """
    folder = given or Path("runs") / f"{datetime.now():%Y%m%d-%H%M%S}-{name}"
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise UsageError(f"{folder} exists and is not an empty folder; give another --out")
    return folder


def quiet_opencv(*, keeps_decoders: bool = False) -> None:
    """Keep what OpenCV and its decoders print of a damaged file off the terminal: the verb says it in one line.

    They read this when they are loaded; variables that are already set are kept, and show everything.

    Parameters
    ----------
    keeps_decoders : bool -- leave the decoders as they are: the verb catches what they say, and counts it
    """
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
    if not keeps_decoders:
        os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
