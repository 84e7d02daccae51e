"""Turn a file of columns (CSV, MAT, NPZ, UFF 58, TDMS) into a bag that says where it comes from.

Headings such as `tip [mm]`, `tip_mm` and `time (ms)` say names and units; values become SI. The bag holds the file's
name and SHA-256, its columns with their units, and who imported it when. Beside the bag, signals.yaml says which
column is the input and which are outputs: `beam identify BAG --signals BAG/signals.yaml`. A file of any length is
read once, a part at a time.
"""

from __future__ import annotations

import argparse
from datetime import datetime, timezone
from pathlib import Path

from beam_ros.errors import UsageError
from beam_ros.process.progress import Progress
from beam_ros.process.strict_json import strict_json
from beam_ros.signals.descriptions import Signals


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument("file", type=Path, metavar="FILE", help="CSV, MAT, NPZ, UFF or TDMS file")
    parser.add_argument("--to", type=Path, required=True, metavar="BAG", help="new folder of the bag")
    parser.add_argument(
        "--time",
        default="",
        metavar="COLUMN",
        help="column with the time, as t,unit=ms, or the rate of the rows, as rate=1000; by default by its name",
    )
    parser.add_argument(
        "--input", default="", metavar="COLUMN", help="column that is the input, as force,unit=kN"
    )
    parser.add_argument(
        "--output",
        action="append",
        default=[],
        metavar="COLUMN",
        help="column that is an output; for each its own. Without any named, every column with a unit is taken",
    )
    parser.add_argument(
        "--start",
        metavar="TIME",
        help="when the first row was taken, as 2026-05-03T14:00:00+02:00; by default the file's date",
    )
    parser.add_argument(
        "--operator", default="", metavar="NAME", help="who answers for it; by default the user"
    )
    parser.add_argument("--json", action="store_true", help="print JSON")


def run(arguments: argparse.Namespace) -> int:
    """Run the verb."""
    from beam_ros.offline.column_import import import_columns

    signals = Signals.of(arguments.input, arguments.output)
    with Progress("import", 1.0) as stage:
        found = import_columns(
            arguments.file,
            arguments.to,
            signals,
            time=arguments.time,
            start=_start(arguments.start),
            operator=arguments.operator,
            progress=stage.update,
        )
        stage.finish(f"{found.n_rows} rows of {arguments.file.name}")
    if arguments.json:
        print(
            strict_json(
                vars(found) | {"path": str(found.path), "signals": found.signals and str(found.signals)}
            )
        )
        return 0
    print(found.path)
    for topic in found.topics:
        print(f"  {topic}")
    for note in found.notes:
        print(f"note: {note}")
    if found.signals is not None:
        print(f"beam identify {found.path} --signals {found.signals}")
    return 0


def _start(text: str | None) -> datetime | None:
    if text is None:
        return None
    try:
        found = datetime.fromisoformat(text)
    except ValueError as err:
        raise UsageError(
            f"--start {text}: expected a date with its time, as 2026-05-03T14:00:00+02:00"
        ) from err
    return found if found.tzinfo else found.replace(tzinfo=timezone.utc)
